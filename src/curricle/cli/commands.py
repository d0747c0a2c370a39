"""The commands; each imports what it needs of the library when it is called."""

import json
from collections import Counter
from pathlib import Path
from shlex import quote
from typing import Annotated

import typer

from curricle.checks import listed
from curricle.cli.options import (
    Changes,
    Explain,
    File,
    Folder,
    Seeds,
    announce_imports,
    part_of,
    read,
    write_new,
)

KINDS = ("maze", "pursuit", "gymnasium", "deep")
"""What a shell completes after `curricle new`; a test holds that these are all."""


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
    from curricle.text_tables import text_table

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
    further = ["show", "report"] if results.has_baseline else ["show"]
    pasted = ", ".join(f"curricle {each} {quote(str(folder))}" for each in further)
    typer.echo(f"Stored in {folder}: {pasted}")


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


def merge(
    out: Annotated[str, typer.Argument(help="Folder or URL for all of it.", show_default=False)],
    parts: Annotated[list[str], typer.Argument(help="Folders of the parts.", show_default=False)],
) -> None:
    """Merge the parts of a study that several machines ran with --shard."""
    from curricle.study import merge as merged
    from curricle.text_tables import counted

    results = merged(out, parts)
    seeds, folders = counted(len(results.seeds), "seed"), counted(len(parts), "folder")
    typer.echo(f"{seeds} of {folders} in {out}")


def schema() -> None:
    """Print the JSON Schema of study files, for editors that complete and check TOML."""
    from curricle.study.config.study_config import json_schema

    typer.echo(json.dumps(json_schema(), indent=1))


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


def report(
    folder: Folder,
    out: Annotated[
        Path | None, typer.Option(help="The page; report.html in the folder by default.")
    ] = None,
) -> None:
    """Write a study's report, one HTML page that works offline."""
    from curricle.report.study_report import write_report

    typer.echo(f"Open {write_report(folder, out)}")


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


def paper(
    figure: Annotated[str, typer.Option(help="1, 2, 3, 4, trust, hacking or all.")] = "all",
    seeds: Annotated[int, typer.Option(help="Seeds for everything that is learnt.")] = 30,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("paper-results"),
    workers: Annotated[int | None, typer.Option(help="Threads; all processors by default.")] = None,
) -> None:
    """Reproduce the paper: figures, data, and a verdict on each of its claims.

    Writes index.html, claims.json, each figure as PNG and SVG and its data as Parquet. An
    interrupted run goes on where it was; a folder with results of other settings is refused.
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


COMMANDS = (
    new,
    check,
    run,
    watch,
    merge,
    schema,
    show,
    play,
    report,
    compare,
    paper,
)
