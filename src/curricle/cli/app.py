"""The commands, their exit codes, and errors as one sentence.

Each command imports what it needs of the library when it is called.

=====  =============================================================================
0      done
1      a file, a folder or a setting was refused
2      the command line was wrong
3      the study's own code failed, its cluster was lost, or its results cannot be
       written any more; what was stored is whole
130    interrupted; what was stored before is whole
=====  =============================================================================
"""

import json
import os
import sys
import traceback
from collections import Counter
from importlib.metadata import version
from io import TextIOWrapper
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from curricle.checks import listed

if TYPE_CHECKING:
    from curricle.study import StudyConfig


class _Commands(TyperGroup):
    """The commands, which end at once when interrupted."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            typer.echo("curricle: interrupted; what was stored before is whole", err=True)
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(130)  # or Python would wait for units in compiled loops


app = typer.Typer(
    cls=_Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Curriculum learning by potential-based reward shaping.",
    epilog="Exit codes: 0 done, 1 refused, 2 wrong command line, 3 the study's own code failed, "
    "its cluster was lost or its results cannot be written any more, 130 interrupted.",
)


def _print_version(wanted: bool) -> None:
    """Print the version and end, if that is wanted."""
    if wanted:
        typer.echo(f"curricle {version('curricle')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    pass


# -- What several commands take, and what they do first --------------------------------------------

File = Annotated[
    Path, typer.Argument(help="A TOML file. It is code: modules it names run.", show_default=False)
]
Folder = Annotated[
    str, typer.Argument(help="A study's folder, or its URL: s3://bucket/name.", show_default=False)
]
Seeds = Annotated[
    str | None, typer.Option(help="Instead of the file's: a number of them, or 0-29, or 0,3,7.")
]
Changes = Annotated[
    list[str] | None,
    typer.Option("--set", help="key=value over the file's, such as tasks.hunt.size=5."),
]
Explain = Annotated[bool, typer.Option("--explain", help="Also what the words mean.")]


def write_new(path: Path, text: str) -> None:
    """Write a study that was not there; StoreError if it was, or cannot be written."""
    from curricle.errors import StoreError

    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise StoreError(f"a new study needs a new file: {path} is there already") from None
    except OSError as error:
        raise StoreError(f"a study cannot be written to {path}: {error.strerror}") from None


def read(file: Path, seeds: str | None, changes: list[str] | None) -> "StudyConfig":
    """Return the study of a file, with what the command line changes."""
    from curricle.study import read_study

    number = seeds is not None and seeds.isdecimal()
    given = [] if seeds is None else [f"seeds={seeds}" if number else f'seeds="{seeds}"']
    return read_study(file, set=[*(changes or []), *given])


def announce_imports() -> None:
    """Print which modules a study names before they are imported."""
    import logging

    from curricle.study.config.tables import LOGGER

    if not LOGGER.handlers:
        LOGGER.addHandler(logging.StreamHandler())
        LOGGER.setLevel(logging.INFO)


def part_of(shard: str) -> tuple[int, int]:
    """Return (i, n) of i/n."""
    part, slash, parts = shard.partition("/")
    numbers = slash and part.isdecimal() and parts.isdecimal()
    if not numbers or not 1 <= int(part) <= int(parts):
        raise typer.BadParameter(f"a shard is i/n, i from 1 to n, such as 1/4: got {shard!r}")
    return int(part), int(parts)


# -- The commands ----------------------------------------------------------------------------------

KINDS = ("maze", "pursuit", "gymnasium", "deep")
"""What a shell completes after `curricle new`; a test holds that these are all."""


@app.command()
def new(
    kind: Annotated[
        str | None,
        typer.Argument(
            help="maze, pursuit, gymnasium or deep; or any id of Gymnasium's registry. "
            "Left out, they are listed.",
            autocompletion=lambda: list(KINDS),
            show_default=False,
        ),
    ] = None,
    file: Annotated[Path | None, typer.Argument(help="The file; KIND.toml by default.")] = None,
) -> None:
    """Write a commented study to start from, which runs as it is."""
    if kind is None:
        typer.echo(_what_new_writes())
        return
    name, text = _new_study(kind)
    path = file or Path(name)
    write_new(path, text)
    typed = quote(str(path))
    typer.echo(f"Wrote {path}: curricle check {typed}, then curricle run {typed}")


def _what_new_writes() -> str:
    """Return the studies that can be written, as a table."""
    from curricle.cli.tables import line_width
    from curricle.study.config import templates
    from curricle.text import text_table

    environments = (
        "or the id of an environment of Gymnasium's registry: FrozenLake-v1, CartPole-v1, "
        "MiniGrid-DoorKey-5x5-v0"
    )
    rows = [*templates.KINDS.items(), ("ID", environments)]
    return "\n".join(text_table(("curricle new", "writes"), rows, line_width(), words=True))


def _new_study(kind: str) -> tuple[str, str]:
    """Return the name and the text of a file; ConfigError if nothing is called so."""
    from curricle.errors import ConfigError
    from curricle.study.config import templates
    from curricle.study.config.tables import suggestion

    if kind in templates.KINDS:
        return f"{kind}.toml", templates.template(kind)
    from curricle.study.config.templates.of_environment import environment_study

    if kind.isalpha() and kind.islower() and (meant := suggestion(kind, templates.KINDS)):
        raise ConfigError(f"there is no study {kind!r} to start from{meant}")
    text = environment_study(kind)
    return f"{kind.rpartition(':')[2].replace('/', '-')}.toml", text


@app.command()
def check(
    file: File, seeds: Seeds = None, changes: Changes = None, explain: Explain = False
) -> None:
    """Validate a study; print its tasks, its cost and a forecast, without training the target.

    For the forecast the sources are trained at their budgets, where that takes seconds.
    """
    from curricle.cli.progress_bars import announce_compilation
    from curricle.cli.study_preview import print_preview
    from curricle.cli.tables import explained

    announce_imports()
    announce_compilation()
    with explained(explain):
        print_preview(read(file, seeds, changes))


@app.command()
def run(
    file: File,
    out: Annotated[
        str | None, typer.Option(help="Folder or URL for the results; FILE-results by default.")
    ] = None,
    seeds: Seeds = None,
    changes: Changes = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Threads; all processors by default.")
    ] = None,
    processes: Annotated[bool, typer.Option(help="Processes instead of threads.")] = False,
    on: Annotated[
        str | None,
        typer.Option(help="A cluster: dask or ray, or dask://host:8786, ray://host:10001."),
    ] = None,
    shard: Annotated[
        str, typer.Option(help="i/n: the i-th of n parts of the seeds, to be merged later.")
    ] = "1/1",
    track: Annotated[
        list[str] | None, typer.Option(help="Also log curves in a tool: tensorboard.")
    ] = None,
    resume: Annotated[bool, typer.Option(help="Go on with what the folder holds.")] = False,
    keep_stale: Annotated[
        bool, typer.Option(help="Use units that were trained before code changed.")
    ] = False,
    dry_run: Annotated[bool, typer.Option(help="Print what would be done; train nothing.")] = False,
    show_page: Annotated[
        bool,
        typer.Option("--open", help="Open report.html, which is written anew as units end."),
    ] = False,
) -> None:
    """Run a study into a folder; an interrupted run goes on with --resume.

    Results do not depend on the number of workers, on shards, or on how often the run was stopped.
    """
    from curricle.cli.progress_bars import run_with_bars
    from curricle.cli.study_preview import too_few, units_left
    from curricle.study.arms import Arms

    if on is not None and processes:
        raise typer.BadParameter(f"units are trained in one place: got --on {on} and --processes")
    announce_imports()
    study = read(file, seeds, changes)
    folder = out or study.results_folder
    if dry_run:
        for line in units_left(study, folder, part_of(shard), keep_stale=keep_stale):
            typer.echo(line)
        return
    if few := too_few(study, Arms.of(study)):
        typer.echo(f"curricle: {few}", err=True)
    results = run_with_bars(
        study,
        folder,
        resume=resume,
        keep_stale=keep_stale,
        workers=workers,
        processes=processes,
        on=on,
        shard=part_of(shard),
        trackers=track or [],
        page=show_page,
    )
    report = f", curricle report {quote(folder)}" * results.has_baseline
    typer.echo(f"Stored in {folder}: curricle show {quote(folder)}{report}")


@app.command()
def watch(
    folder: Folder,
    out: Annotated[
        Path | None, typer.Option(help="The page; in a temporary folder by default.")
    ] = None,
) -> None:
    """Open a study's report, and write it anew while units are stored, until the run is over.

    It reads the folder alone, so the study may run anywhere. Ctrl-C ends it, and not the run.
    """
    from curricle.cli.progress_bars import watch_results
    from curricle.study import StudyResults

    StudyResults(folder)  # refused before a page is opened
    watch_results(folder, out)


@app.command()
def merge(
    out: Annotated[str, typer.Argument(help="Folder or URL for all of it.", show_default=False)],
    parts: Annotated[list[str], typer.Argument(help="Folders of the parts.", show_default=False)],
) -> None:
    """Merge the parts of a study that several machines ran with --shard."""
    from curricle.study import merge as merged
    from curricle.text import counted

    results = merged(out, parts)
    seeds, folders = counted(len(results.seeds), "seed"), counted(len(parts), "folder")
    typer.echo(f"{seeds} of {folders} in {out}")


@app.command()
def schema() -> None:
    """Print the JSON Schema of study files, for editors that complete and check TOML."""
    from curricle.study.config.study_config import json_schema

    typer.echo(json.dumps(json_schema(), indent=1))


@app.command()
def show(
    folder: Folder,
    decisions: Annotated[bool, typer.Option(help="Why each task went on or stopped.")] = False,
    arm: Annotated[str | None, typer.Option(help="Of this arm only.")] = None,
    task: Annotated[str | None, typer.Option(help="Of this task only.")] = None,
    seed: Annotated[
        int | None, typer.Option(help="With --decisions: all those of this seed.")
    ] = None,
    explain: Explain = False,
) -> None:
    """Print a study's progress, what each task learnt, and the comparison of its arms."""
    from curricle.cli.tables import decision_lines, explained, print_results
    from curricle.study import StudyResults

    if seed is not None and not decisions:
        raise typer.BadParameter(f"a seed is that of --decisions: got --seed {seed} alone")
    results = StudyResults(folder)
    if not decisions:
        with explained(explain):
            print_results(results, arm, task)
        return
    for line in decision_lines(results, arm, task, seed):
        typer.echo(line)


@app.command()
def play(
    folder: Folder,
    arm: Annotated[str | None, typer.Option(help="The arm; needed if there are several.")] = None,
    task: Annotated[str | None, typer.Option(help="The task; the target by default.")] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="The seed that learnt it; with --study any.")
    ] = None,
    study: Annotated[
        Path | None, typer.Option(help="The study's file: the task is made and played.")
    ] = None,
    changes: Changes = None,
    out: Annotated[Path | None, typer.Option(help="Write the episode as a GIF instead.")] = None,
) -> None:
    """Show one episode of what an arm learnt, drawn with characters or as a GIF.

    Without --study it is the episode that the folder stores, of the first seed: nothing is made or
    imported. With it the learnt policy plays in the task itself.
    """
    from curricle.study import StudyResults
    from curricle.study.analysis import played_episode, stored_episode

    if changes and study is None:
        raise typer.BadParameter(f"--set changes the file of --study: got --set {changes[0]} alone")
    results = StudyResults(folder)
    arms = list(results.record.arms)
    if arm is None and len(arms) > 1:
        raise typer.BadParameter(f"--arm must be one of {listed(arms)}: got none")
    arm = arms[0] if arm is None else arm
    task = results.record.target if task is None else task
    if study is None:
        seed, episode = stored_episode(results, arm, task, seed)
    else:
        announce_imports()
        seed, episode = played_episode(results, read(study, None, changes), arm, task, seed)
    words = f"{arm}: {task}, learnt by seed {seed}"
    if out is None:
        typer.echo(f"{words}\n\n{episode}")
    else:
        typer.echo(f"{words}: {episode!r}\nOpen {episode.save(out)}")


@app.command()
def report(
    folder: Folder,
    out: Annotated[
        Path | None, typer.Option(help="The page; report.html in the folder by default.")
    ] = None,
) -> None:
    """Write a study's report, one HTML page that works offline."""
    from curricle.report.study_report import write_report

    typer.echo(f"Open {write_report(folder, out)}")


@app.command()
def compare(
    folders: Annotated[
        list[str], typer.Argument(help="Folders of studies of one target.", show_default=False)
    ],
    against: Annotated[
        str | None, typer.Option(help="Also whether each other arm gains more than this one.")
    ] = None,
    explain: Explain = False,
) -> None:
    """Compare the arms of several studies of one target with learning it from scratch."""
    from curricle.cli.tables import explained, table_width
    from curricle.study import StudyResults, compare_studies

    found = compare_studies([StudyResults(folder) for folder in folders])
    answers = {} if against is None else found.against(against)
    with explained(explain):
        print(found.text(table_width()))
        for name, verdict in answers.items():
            print(f"{name} gains more than {against}: {verdict}")


@app.command()
def paper(
    figure: Annotated[str, typer.Option(help="1, 2, 3, 4, trust, hacking or all.")] = "all",
    seeds: Annotated[int, typer.Option(help="Seeds for everything that is learnt.")] = 30,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("paper-results"),
    workers: Annotated[int | None, typer.Option(help="Threads; all processors by default.")] = None,
) -> None:
    """Reproduce the paper: figures, data, and a verdict on each of its claims.

    Writes index.html, claims.json, each figure as PNG and SVG and its data as Parquet, all of it
    in the end, in the place of those of an earlier run.
    """
    from curricle.cli.progress_bars import bars_with_words
    from curricle.cli.tables import print_text
    from curricle.paper.reproduce import FIGURES, reproduce, seeds_words

    wanted = FIGURES if figure == "all" else [figure]
    with bars_with_words() as bars:
        claims = reproduce(out, figures=wanted, seeds=seeds, workers=workers, progress=bars)
    for claim in claims:
        typer.echo(f"{claim['verdict']:>15}  {claim['id']}")
    counts = Counter(claim["verdict"] for claim in claims)
    typer.echo(", ".join(f"{n} {verdict}" for verdict, n in counts.items()))
    print_text(seeds_words(seeds))
    typer.echo(f"Open {out / 'index.html'}")


def main() -> None:
    """Run the command; errors of the library become one sentence and an exit code."""
    from curricle.errors import CurricleError, EngineError, LostStoreError, StudyError

    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # ? for signs that an encoding lacks
    try:
        app(standalone_mode=True)
    except CurricleError as error:
        failed = isinstance(error, StudyError) and error.__cause__ is not None
        if failed:
            traceback.print_exception(error.__cause__)
        typer.echo(f"curricle: {error}", err=True)
        lost = isinstance(error, EngineError | LostStoreError)
        sys.exit(3 if failed or lost else 1)
    except OSError as error:  # of a path that the command line names
        named = f"{error.filename} cannot be used: " if error.filename else ""
        typer.echo(f"curricle: {named}{error.strerror or error}", err=True)
        sys.exit(1)
    except MemoryError:
        typer.echo("curricle: there is not enough memory for this study on this machine", err=True)
        sys.exit(1)
