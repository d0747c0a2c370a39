"""The commands; each imports what it needs of the library when it is called."""

import json
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

if TYPE_CHECKING:
    from curricle.study import StudyConfig

File = Annotated[Path, typer.Argument(help="The study, a TOML file.", show_default=False)]
Folder = Annotated[
    str, typer.Argument(help="A study's folder, or its URL: s3://bucket/name.", show_default=False)
]
Seeds = Annotated[
    str | None, typer.Option(help="Instead of the file's: a number of them, or 0-29, or 0,3,7.")
]
Changes = Annotated[
    list[str] | None,
    typer.Option("--set", help="key=value over the file's, such as tasks.chase.budget=1000."),
]


def new(
    kind: Annotated[
        Literal["maze", "pursuit", "gymnasium", "deep", "design"],
        typer.Argument(help="What the tasks are; or design, for a recipe."),
    ],
    file: Annotated[Path | None, typer.Argument(help="The file; KIND.toml by default.")] = None,
) -> None:
    """Write a commented study to start from, or a design, which runs as it is."""
    from curricle.study.config.templates import DESIGN, template

    path = file or Path(f"{kind}.toml")
    _write_new(path, template(kind), kind if kind == DESIGN else "study")
    first = f"curricle check {path}, then curricle run {path}"
    if kind == DESIGN:
        first = f"curricle design {path} --on miniatures --budget 3_000_000"
    typer.echo(f"Wrote {path}: {first}")


def check(file: File, seeds: Seeds = None, changes: Changes = None) -> None:
    """Validate a study; print its tasks, its cost and a forecast, without training the target.

    For the forecast the sources are trained at their budgets, where that takes seconds.
    """
    from curricle.cli.study_preview import print_preview

    _announce_imports()
    print_preview(_read(file, seeds, changes))


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
        list[str] | None, typer.Option(help="Also send curves to tensorboard, wandb or mlflow.")
    ] = None,
    resume: Annotated[bool, typer.Option(help="Go on with what the folder holds.")] = False,
    keep_stale: Annotated[
        bool, typer.Option(help="Use units that were trained before code changed.")
    ] = False,
    dry_run: Annotated[bool, typer.Option(help="Print what would be done; train nothing.")] = False,
) -> None:
    """Run a study into a folder; an interrupted run goes on with --resume.

    Results do not depend on the number of workers, on shards, or on how often the run was stopped.
    """
    from curricle.cli.progress_bars import run_with_bars
    from curricle.cli.study_preview import too_few, units_left
    from curricle.study.arms import Arms

    if on is not None and processes:
        raise typer.BadParameter(f"units are trained in one place: got --on {on} and --processes")
    _announce_imports()
    study = _read(file, seeds, changes)
    folder = out or f"{file.stem}-results"
    if dry_run:
        for line in units_left(study, folder, _part(shard), keep_stale=keep_stale):
            typer.echo(line)
        return
    if few := too_few(study, Arms.of(study)):
        typer.echo(f"curricle: {few}", err=True)
    run_with_bars(
        study,
        folder,
        resume=resume,
        keep_stale=keep_stale,
        workers=workers,
        processes=processes,
        on=on,
        shard=_part(shard),
        trackers=track or [],
    )
    typer.echo(f"Stored in {folder}: curricle show {folder}, curricle report {folder}")


def merge(
    out: Annotated[str, typer.Argument(help="Folder or URL for all of it.", show_default=False)],
    parts: Annotated[list[str], typer.Argument(help="Folders of the parts.", show_default=False)],
) -> None:
    """Merge the parts of a study that several machines ran with --shard."""
    from curricle.study import merge as merged

    results = merged(out, parts)
    typer.echo(f"{len(results.seeds)} seeds of {len(parts)} folders in {out}")


def schema() -> None:
    """Print the JSON Schema of study files, for editors that complete and check TOML."""
    from curricle.study import json_schema

    typer.echo(json.dumps(json_schema(), indent=1))


def show(
    folder: Folder,
    decisions: Annotated[bool, typer.Option(help="Why each task went on or stopped.")] = False,
    arm: Annotated[str | None, typer.Option(help="Of this arm only.")] = None,
    task: Annotated[str | None, typer.Option(help="Of this task only.")] = None,
    seed: Annotated[int | None, typer.Option(help="Of this seed only.")] = None,
) -> None:
    """Print a study's progress, what each task learnt, and the comparison of its arms."""
    from curricle.cli.results_tables import decision_lines, print_results
    from curricle.study import StudyResults

    results = StudyResults(folder)
    if not decisions:
        print_results(results, arm, task)
        return
    for line in decision_lines(results, arm, task, seed):
        typer.echo(line)


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
) -> None:
    """Compare the arms of several studies of one target with learning it from scratch."""
    from curricle.study import StudyResults, compare_studies

    found = compare_studies([StudyResults(folder) for folder in folders])
    answers = {} if against is None else found.against(against)
    typer.echo(str(found))
    for name, verdict in answers.items():
        typer.echo(f"{name} gains more than {against}: {verdict}")


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
    from curricle.paper.reproduce import FIGURES, reproduce

    wanted = FIGURES if figure == "all" else [figure]
    claims = reproduce(out, figures=wanted, seeds=seeds, workers=workers)
    for claim in claims:
        typer.echo(f"{claim['verdict']:>15}  {claim['id']}")
    counts = Counter(claim["verdict"] for claim in claims)
    typer.echo(", ".join(f"{n} {verdict}" for verdict, n in counts.items()))
    typer.echo(f"Open {out / 'index.html'}")


def design(
    file: Annotated[
        Path, typer.Argument(help="A family and its miniatures, a TOML file.", show_default=False)
    ],
    budget: Annotated[int, typer.Option(min=0, help="Steps of all trainings together, at most.")],
    on: Annotated[str, typer.Option(help="The table of the file with the members.")] = "miniatures",
    out: Annotated[Path, typer.Option(help="The recipe.")] = Path("recipe.toml"),
    seed: Annotated[int, typer.Option(min=0, help="The same seed, the same recipe.")] = 0,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Threads; all processors by default.")
    ] = None,
    resume: Annotated[bool, typer.Option(help="Go on with a design that was interrupted.")] = False,
    changes: Changes = None,
) -> None:
    """Design a recipe on small members of a family: which sources, and how long each.

    Every training is kept beside the recipe, so that an interrupted design goes on with --resume.
    Beside it is a page too, on how it was found.
    """
    from curricle.report.design_report import write_design_report
    from curricle.study.recipes.designing import run_design

    _announce_imports()
    found = run_design(
        file, on, out, budget=budget, seed=seed, workers=workers, resume=resume, set=changes or []
    )
    typer.echo(str(found))
    typer.echo(f'Wrote {out}: curricle apply {out} --to "PARAMETER=VALUE, ..."')
    page = out.with_suffix(".html" if out.suffix != ".html" else ".report.html")
    typer.echo(f"Open {write_design_report(found, page)}")


def apply(
    recipe: Annotated[Path, typer.Argument(help="The recipe, a TOML file.", show_default=False)],
    to: Annotated[str, typer.Option(help="The member by its parameters: size=10, predators=3.")],
    budget: Annotated[int, typer.Option(min=1, help="Steps of the target.")] = 200_000,
    seeds: Annotated[int, typer.Option(min=1, help="How many.")] = 30,
    out: Annotated[Path, typer.Option(help="The study.")] = Path("study.toml"),
) -> None:
    """Write the study of one member of a recipe's family, to be read, changed and run."""
    from curricle.study import read_recipe, study_text
    from curricle.study.recipes.designing import parameters_of

    _announce_imports()
    stored = read_recipe(recipe)
    text = study_text(stored, parameters_of(to), budget=budget, seeds=seeds, file=out)
    _write_new(out, text, "study")
    if not stored.recipe.stages:
        typer.echo("The recipe has no sources: the study learns the target alone.")
    typer.echo(f"Wrote {out}: curricle check {out}, then curricle run {out}")


COMMANDS = (new, check, run, merge, schema, show, report, compare, design, apply, paper)


def _write_new(path: Path, text: str, what: str) -> None:
    """Write a file that was not there; StoreError if it was, or cannot be written."""
    from curricle.errors import StoreError

    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise StoreError(f"a new {what} needs a new file: {path} is there already") from None
    except OSError as error:
        raise StoreError(f"a {what} cannot be written to {path}: {error.strerror}") from None


def _read(file: Path, seeds: str | None, changes: list[str] | None) -> "StudyConfig":
    from curricle.study import read_study

    number = seeds is not None and seeds.isdecimal()
    given = [] if seeds is None else [f"seeds={seeds}" if number else f'seeds="{seeds}"']
    return read_study(file, set=[*(changes or []), *given])


def _announce_imports() -> None:
    """Print which modules a study names before they are imported."""
    import logging

    from curricle.study.config.references import LOGGER

    if not LOGGER.handlers:
        LOGGER.addHandler(logging.StreamHandler())
        LOGGER.setLevel(logging.INFO)


def _part(shard: str) -> tuple[int, int]:
    part, slash, parts = shard.partition("/")
    numbers = slash and part.isdecimal() and parts.isdecimal()
    if not numbers or not 1 <= int(part) <= int(parts):
        raise typer.BadParameter(f"a shard is i/n, i from 1 to n, such as 1/4: got {shard!r}")
    return int(part), int(parts)
