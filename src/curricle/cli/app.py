"""The commands, their exit codes, and errors as one sentence.

A command imports the library when it is called, so that a shell that completes a word or shows the
help does not wait for it. The help ends with the exit codes.
"""

import gc
import json
import os
import sys
import traceback
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import asdict
from importlib.metadata import version
from io import StringIO, TextIOWrapper
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, BadParameter, Option, echo
from typer.core import TyperGroup

from curricle.checks import listed
from curricle.study.templates import KINDS, file_name, new_study

if TYPE_CHECKING:
    from curricle.study import StudyConfig


class _Commands(TyperGroup):
    """The commands, which end at once when interrupted; the help shows no type of their flags."""

    def get_params(self, ctx: Any) -> Any:
        return _untyped(super().get_params(ctx))

    def get_command(self, ctx: Any, name: str) -> Any:
        command = super().get_command(ctx, name)
        if command is not None:
            _untyped(command.get_params(ctx))
        return command

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            echo("curricle: interrupted; what was stored before is whole", err=True)
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(130)  # or Python would wait for units in compiled loops


def _untyped(options: Any) -> Any:
    """Return options of a command, its flags without the type that Typer's help shows."""
    for option in options:
        if getattr(option, "is_flag", False):
            option.metavar = ""
    return options


app = typer.Typer(
    cls=_Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Curriculum learning by potential-based reward shaping.",
    epilog="Exit codes: 0 done, 1 refused, 2 wrong command line, 3 the study's own code failed, "
    "its cluster was lost or its results cannot be written any more, 130 interrupted.",
)


def _print_version(wanted: bool) -> None:
    if wanted:
        echo(f"curricle {version('curricle')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


# -- What several commands take, and what they do first --------------------------------------------

File = Annotated[
    Path, Argument(help="A TOML file. It is code: modules it names run.", show_default=False)
]
Folder = Annotated[
    str, Argument(help="A study's folder, or its URL: s3://bucket/name.", show_default=False)
]
Seeds = Annotated[
    str | None, Option(help="Seeds instead of the file's: a number, or 0-29, or 0,3,7.")
]
Changes = Annotated[
    list[str] | None, Option("--set", help="key=value over the file's, such as tasks.hunt.size=5.")
]
OnlyArms = Annotated[
    list[str] | None, Option("--arm", help="Only this arm of the file; may be repeated.")
]
LONGEST_SHARD = 20  # characters of --shard
Explain = Annotated[bool, Option("--explain", help="Also explain the words.")]
AsJson = Annotated[bool, Option("--json", help="Print the answer as one JSON object instead.")]


def _hush(context: typer.Context, quiet: bool) -> None:
    """Take standard error away until the command has ended; an error is printed after that."""
    if quiet:
        context.with_resource(redirect_stderr(StringIO()))


Quiet = Annotated[bool, Option("--quiet", callback=_hush, help="Print only errors to stderr.")]


def _read(
    file: Path, seeds: str | None, changes: list[str] | None, arms: list[str] | None = None
) -> "StudyConfig":
    """Return the study of a file, with the changes of the command line."""
    from curricle.study import read_study

    if seeds is not None:
        changes = [*(changes or []), f"seeds={seeds}" if seeds.isdecimal() else f'seeds="{seeds}"']
    return read_study(file, set=changes or [], arms=arms or [])


def _announce_imports() -> None:
    """Print which modules a study names before they are imported."""
    import logging

    from curricle.study_file.own_code import LOGGER

    if not LOGGER.handlers:
        handler = logging.Handler()
        handler.emit = lambda record: echo(handler.format(record), err=True)  # type: ignore[method-assign]
        LOGGER.addHandler(handler)
        LOGGER.setLevel(logging.INFO)
        LOGGER.propagate = False  # or what a module does to the root logger would say it again


# -- The commands ----------------------------------------------------------------------------------


@app.command()
def new(
    kind: Annotated[
        str | None,
        Argument(
            help="maze, pursuit, gymnasium, deep or stages; any id of Gymnasium's registry; or a "
            "class of yours, module:Class. Left out, they are listed.",
            autocompletion=lambda: list(KINDS),
            show_default=False,
        ),
    ] = None,
    file: Annotated[Path | None, Argument(help="The file; KIND.toml by default.")] = None,
) -> None:
    """Write a commented study to start from, which runs as it is.

    An environment is played, tabulated if that takes seconds, and tried with easier arguments.
    """
    from curricle.errors import StoreError

    if kind is None:
        from curricle.cli.output import line_width
        from curricle.text import text_table

        environments = (
            "or the id of an environment of Gymnasium's registry: FrozenLake-v1, CartPole-v1, "
            "MiniGrid-DoorKey-5x5-v0"
        )
        classes = "or an environment of your own: the class, or a function that makes it"
        rows = [*KINDS.items(), ("ID", environments), ("module:Class", classes)]
        echo("\n".join(text_table(("curricle new", "writes"), rows, line_width(), prose=True)))
        return
    path = file or Path(file_name(kind))
    if path.exists():  # before a search that takes seconds
        raise StoreError(f"a new study needs a new file: {path} is there already")
    if ":" in kind:
        _announce_imports()
    if kind not in KINDS:
        from curricle.progress import compilation

        compilation().prints = True
    # A class that is played may print something at each step.
    with open(os.devnull, "w", encoding="utf-8") as nowhere, redirect_stdout(nowhere):
        _, text, notes = new_study(kind, path.parent, lambda step: echo(f"... {step}", err=True))
    try:
        with path.open("x", encoding="utf-8") as written:
            written.write(text)
    except OSError as error:
        raise StoreError(f"a study cannot be written to {path}: {error.strerror}") from None
    for note in notes:
        echo(note)
    typed = quote(str(path))
    echo(f"Wrote {path}: curricle check {typed}, then curricle run {typed}")


@app.command()
def check(
    file: File,
    seeds: Seeds = None,
    changes: Changes = None,
    arms: OnlyArms = None,
    forecast: Annotated[
        bool, Option("--forecast", help="Make the whole forecast, however long it takes.")
    ] = False,
    explain: Explain = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Validate a study; print its tasks, its cost and a forecast, without training the target.

    The forecast trains the sources at their budgets if that takes seconds, or with --forecast.
    """
    from curricle.cli.output import json_alone, print_preview, print_words
    from curricle.progress import compilation

    _announce_imports()
    compilation().prints = True
    with json_alone(as_json) as answer:
        answer |= print_preview(_read(file, seeds, changes, arms), forecast=forecast)
        if explain:
            print_words()


@app.command()
def choose(
    file: File,
    out: Annotated[
        Path | None,
        Option(help="Also write the chosen study to this new file.", show_default=False),
    ] = None,
    seed: Annotated[int, Option(min=0, help="Equal seeds give equal choices.")] = 0,
    changes: Changes = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Choose which curriculum to learn a study's target with, if any, by trials in its model.

    Candidates are sources that are made from the target, and the arms of the file. No seed of the
    study is used up.
    """
    from curricle.cli.output import comparison_data, json_alone, table_width
    from curricle.errors import StoreError
    from curricle.study.tuning import choose as chosen_of, chosen_file

    _announce_imports()
    if out is not None and out.exists():
        raise StoreError(f"a new study needs a new file: {out} is there already")
    if out is not None and not out.parent.is_dir():  # before trials that take minutes
        raise StoreError(f"a new study needs a folder that exists: {out.parent} is none")
    with json_alone(as_json) as answer:
        study = _read(file, None, changes)
        choice = chosen_of(study, seed=seed, progress=True)
        print(choice.text(table_width()))
        answer |= {name: getattr(choice, name) for name in ("name", "alone", "sentence", "rows")}
        answer["comparison"] = comparison_data(choice.comparison)
        if out is not None:
            out.write_text(chosen_file(study, choice, out.parent), encoding="utf-8")
            typed = quote(str(out))
            echo(f"Wrote {out}: curricle check {typed}, then curricle run {typed}")


@app.command()
def run(
    file: File,
    out: Annotated[
        str | None, Option(help="Folder or URL for the results; FILE-results by default.")
    ] = None,
    seeds: Seeds = None,
    changes: Changes = None,
    arms: OnlyArms = None,
    workers: Annotated[
        int | None, Option(min=1, help="Threads; all processors by default.")
    ] = None,
    processes: Annotated[bool, Option("--processes", help="Processes instead of threads.")] = False,
    on: Annotated[
        str | None, Option(help="A Dask cluster: dask, or its scheduler, as dask://host:8786.")
    ] = None,
    shard: Annotated[
        str, Option(help="i/n: the i-th of n parts of the seeds, to be merged later.")
    ] = "1/1",
    resume: Annotated[bool, Option("--resume", help="Go on with the units in the folder.")] = False,
    show_page: Annotated[
        bool, Option("--open", help="Open report.html, which is written anew as units end.")
    ] = False,
    dry_run: Annotated[
        bool, Option("--dry-run", help="Print the units to train; train nothing.")
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Run a study into a folder; an interrupted run goes on with --resume.

    Results do not depend on the number of workers, on shards, or on how often the run was stopped.
    """
    from curricle.cli.output import (
        seeds_left,
        sources_are_dear,
        too_few,
        total_words,
        units_left,
    )
    from curricle.cli.progress_bars import run_with_bars
    from curricle.study.arms import Arms

    if on is not None and processes:
        raise BadParameter(
            f"--on and --processes exclude each other: got --on {on} and --processes"
        )
    _announce_imports()
    study = _read(file, seeds, changes, arms)
    i, slash, n = shard.partition("/")
    numbers = slash and i.isdecimal() and n.isdecimal() and len(shard) < LONGEST_SHARD
    if not numbers or not 1 <= int(i) <= int(n):
        raise BadParameter(f"a shard must be i/n, i from 1 to n, such as 1/4: got {shard!r}")
    part, folder = (int(i), int(n)), out or study.results_folder
    if dry_run:
        for line in units_left(study, folder, part):
            echo(line)
        return
    planned = Arms.of(study)
    if few := too_few(study, planned):
        echo(f"curricle: {few}", err=True)
    budget, total = planned.budget, planned.total
    if budget and total and sources_are_dear(budget, total):
        sentence = total_words(planned.target, budget, total, planned.eval_freq, sources=True)
        echo(f"curricle: {sentence}", err=True)
    results = run_with_bars(
        study,
        folder,
        resume=resume,
        shard=part,
        processes=processes,
        workers=workers,
        on=on,
        page=show_page,
    )
    if part == (1, 1) and (lacking := seeds_left(results)):
        echo(f"curricle: {len(results.seeds)} seeds finished in every arm{lacking}", err=True)
    report = f", curricle report {quote(folder)}" * results.has_baseline
    echo(f"Stored in {folder}: curricle show {quote(folder)}{report}")


@app.command()
def audit(
    file: File,
    out: Annotated[str | None, Option(help="Folder of the results; FILE-audit by default.")] = None,
    seeds: Seeds = None,
    changes: Changes = None,
    trials: Annotated[
        int, Option(min=1, max=100, help="Trials of every arm for each setting of the largest.")
    ] = 10,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Run a study as configured, then against fair opponents, and say what of it survives.

    Fair: every arm, scratch and the optimistic learner too, is tuned by equally many trials, all
    opponents and placebos play, and an optimist that explores by the arm's potential. An audit that
    was stopped goes on.
    """
    from curricle.cli.output import comparison_data, json_alone, table_width
    from curricle.cli.progress_bars import run_with_bars
    from curricle.show.report import write_audit
    from curricle.study import audit as audited

    _announce_imports()
    with json_alone(as_json) as answer:
        study = _read(file, seeds, changes)
        folder = out or f"{Path(study.file).stem}-audit"
        made = audited(study, folder, trials=trials, run=run_with_bars)
        print(made.text(table_width()))
        answer["sentence"] = made.sentence
        answer["configured"] = comparison_data(made.configured.comparison)
        answer["fair"] = comparison_data(made.fair.comparison)
        echo(f"Open {write_audit(made, Path(folder) / 'audit.html')}")


@app.command()
def merge(
    out: Annotated[str, Argument(help="Folder or URL of the merged study.", show_default=False)],
    parts: Annotated[list[str], Argument(help="Folders of the parts.", show_default=False)],
) -> None:
    """Merge the parts of a study that several machines ran with --shard."""
    from curricle.study import merge as merged
    from curricle.text import counted

    results = merged(out, parts)
    echo(f"{counted(len(results.seeds), 'seed')} of {counted(len(parts), 'folder')} in {out}")


@app.command()
def schema() -> None:
    """Print the JSON Schema of study files, for editors that complete and check TOML."""
    from curricle.study.config import json_schema

    echo(json.dumps(json_schema(), indent=1))


@app.command()
def show(
    folder: Folder,
    decisions: Annotated[
        bool, Option("--decisions", help="Why each task went on or stopped.")
    ] = False,
    arm: Annotated[str | None, Option(help="Only this arm.")] = None,
    task: Annotated[str | None, Option(help="Only this task.")] = None,
    seed: Annotated[int | None, Option(help="With --decisions: all of this seed's.")] = None,
    explain: Explain = False,
    as_json: AsJson = False,
) -> None:
    """Print a study's progress, what each task learnt, and the comparison of its arms."""
    from curricle.cli.output import decision_lines, json_alone, print_results, print_words
    from curricle.study import StudyResults

    if seed is not None and not decisions:
        raise BadParameter(f"--seed needs --decisions: got --seed {seed} alone")
    results = StudyResults(folder)
    with json_alone(as_json) as answer:
        if decisions:
            answer["decisions"] = decision_lines(results, arm, task, seed)
            echo("\n".join(answer["decisions"]))
            return
        answer |= print_results(results, arm, task)
        if explain:
            print_words()


@app.command("list")
def list_results(
    folder: Annotated[Path, Argument(exists=True, file_okay=False)] = Path(),
) -> None:
    """Print the results folders here and one level below: arms, seeds and verdicts."""
    from curricle.cli.output import print_folders

    print_folders(folder)


@app.command()
def play(
    folder: Folder,
    arm: Annotated[
        str | None, Option(help="The arm; needed if there are several curricula.")
    ] = None,
    task: Annotated[str | None, Option(help="The task; the target by default.")] = None,
    seed: Annotated[
        int | None, Option(min=0, help="The seed that learnt it; with --study any.")
    ] = None,
    study: Annotated[
        Path | None, Option(help="The study's file, to play in the task itself.")
    ] = None,
    changes: Changes = None,
    out: Annotated[Path | None, Option(help="Write the episode as a GIF instead.")] = None,
) -> None:
    """Show one episode of what an arm learnt, drawn with characters or as a GIF.

    Without --study it is the folder's stored episode of the first seed; no task is made and no
    module imported. With --study the learnt policy plays in the task itself.
    """
    from curricle.study import StudyResults
    from curricle.study.analysis import played_episode, stored_episode
    from curricle.study.tuning import settled_before

    if changes and study is None:
        raise BadParameter(f"--set needs --study: got --set {changes[0]} alone")
    results = StudyResults(folder)
    arms, record = list(results.record.arms), results.record.arms
    arms = [name for name in arms if not (record[name].scratch or record[name].control_of)] or arms
    if arm is None and len(arms) > 1:
        raise BadParameter(f"--arm must be one of {listed(arms)}: got none")
    arm = arms[0] if arm is None else arm
    task = results.record.target if task is None else task
    if study is None:
        seed, episode = stored_episode(results, arm, task, seed)
    else:
        _announce_imports()
        run = settled_before(_read(study, None, changes), results.store.path)
        seed, episode = played_episode(results, run, arm, task, seed)
    title = f"{arm}: {task}, learnt by seed {seed}"
    if out is None:
        echo(f"{title}\n\n{episode}")
    else:
        echo(f"{title}: {episode!r}\nOpen {episode.save(out)}")


@app.command()
def report(
    folder: Folder,
    out: Annotated[
        Path | None, Option(help="The page; report.html in the folder by default.")
    ] = None,
) -> None:
    """Write a study's report, one HTML page that works offline."""
    from curricle.show.report import write_report

    echo(f"Open {write_report(folder, out)}")


@app.command()
def compare(
    folders: Annotated[
        list[str], Argument(help="Folders of studies of one target.", show_default=False)
    ],
    against: Annotated[
        str | None, Option(help="Also whether each other arm gains more than this one.")
    ] = None,
    explain: Explain = False,
    as_json: AsJson = False,
) -> None:
    """Compare the arms of several studies of one target with learning it from scratch."""
    from curricle.cli.output import comparison_data, json_alone, print_words, table_width
    from curricle.study import StudyResults, compare_studies

    comparison = compare_studies([StudyResults(folder) for folder in folders])
    answers = {} if against is None else comparison.against(against)
    with json_alone(as_json) as answer:
        print(comparison.text(table_width()))
        for name, verdict in answers.items():
            print(f"{name} gains more than {against}: {verdict}")
        if explain:
            print_words()
        answer |= comparison_data(comparison)
        answer["against"] = {name: asdict(verdict) for name, verdict in answers.items()}


@app.command()
def verdict(
    files: Annotated[
        list[Path],
        Argument(
            help="CSV or Parquet with arm, seed, step and return; evaluations.npz or Monitor files "
            "in ARM/SEED or ARM_SEED; or folders of them.",
            show_default=False,
        ),
    ],
    charge: Annotated[list[str] | None, Option(help="ARM=STEPS of pretraining.")] = None,
    curriculum: Annotated[
        list[str] | None, Option(help="An arm to judge that nothing is charged to.")
    ] = None,
    threshold: Annotated[float | None, Option(help="The return that counts as learnt.")] = None,
    out: Annotated[Path | None, Option(help="Also write the report, one HTML page.")] = None,
    explain: Explain = False,
    as_json: AsJson = False,
) -> None:
    """Judge runs of any program: did pretraining pay, its steps charged against the other arms.

    Steps are charged by --charge, or by a column "charged" of a table.
    """
    from curricle.cli.output import comparison_data, json_alone, print_words, table_width
    from curricle.comparison.other_runs import compare_files

    charged = dict(text.rpartition("=")[::2] for text in charge or [])
    comparison = compare_files(files, charged, curriculum or [], threshold)
    with json_alone(as_json) as answer:
        print(comparison.text(table_width()))
        answer |= comparison_data(comparison)
        if explain:
            print_words()
        if out is not None:
            from curricle.show.report import page_of_runs, write_page

            echo(f"Open {write_page(page_of_runs(comparison), out)}")


@app.command()
def paper(
    figure: Annotated[str, Option(help="1, 2, 3, 4, trust, hacking or all.")] = "all",
    seeds: Annotated[int, Option(help="Seeds for everything that is learnt.")] = 30,
    out: Annotated[Path, Option(help="Folder for the results.")] = Path("paper-results"),
    workers: Annotated[int | None, Option(help="Threads; all processors by default.")] = None,
    quiet: Quiet = False,
) -> None:
    """Reproduce the paper: figures, data, and a verdict on each of its claims.

    Runs the paper's studies into the folder "studies", where a stopped run goes on. In the end
    writes index.html, claims.json, each figure as PNG and SVG and its data as Parquet.
    """
    from curricle.cli.output import print_text
    from curricle.cli.progress_bars import bars_with_words
    from curricle.paper.reproduce import FIGURES, reproduce, seeds_words

    figures = FIGURES if figure == "all" else [figure]
    with bars_with_words() as bars:
        claims = reproduce(out, figures=figures, seeds=seeds, workers=workers, progress=bars)
    for claim in claims:
        echo(f"{claim['verdict']:>15}  {claim['id']}")
    counts = Counter(claim["verdict"] for claim in claims)
    echo(", ".join(f"{n} {verdict}" for verdict, n in counts.items()))
    print_text(seeds_words(seeds))
    echo(f"Open {out / 'index.html'}")


def main() -> None:
    """Run the command; errors of the library become one sentence and an exit code."""
    from curricle import errors

    # Imports make objects that stay: searching them took a tenth of the time.
    gc.set_threshold(50_000, 20, 50)
    if sys.stdout is None or sys.stderr is None:  # closed by the caller
        nowhere = open(os.devnull, "w")  # noqa: SIM115  as long as the process
        sys.stdout, sys.stderr = sys.stdout or nowhere, sys.stderr or nowhere
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # ? for signs that an encoding lacks
    code = 1
    try:
        app(standalone_mode=True)
        return
    except errors.CurricleError as error:
        failed = isinstance(error, errors.StudyError) and error.__cause__ is not None
        if failed:
            traceback.print_exception(error.__cause__)
        sentence = str(error)
        code = 3 if isinstance(error, errors.StudyError | errors.LostStoreError) else 1
    except OSError as error:  # of a path that the command line names
        place = f"{error.filename} cannot be used: " if error.filename else ""
        sentence = f"{place}{error.strerror or error}"
    except MemoryError:
        sentence = "there is not enough memory for this study on this machine"
    except (Exception, GeneratorExit) as error:
        if not (errors.place_of(error) or isinstance(error, errors.ForeignError)):
            raise  # a mistake of the library
        sentence = errors.in_words(error)
    echo(f"curricle: {sentence}", err=True)
    sys.exit(code)
