"""Commands that make and run studies: new, check, run, merge, schema."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

if TYPE_CHECKING:
    from curricle.study.config.study_config import StudyConfig

File = Annotated[Path, typer.Argument(help="The study, a TOML file.", show_default=False)]
Seeds = Annotated[
    str | None, typer.Option(help="Instead of the file's: a number of them, or 0-29, or 0,3,7.")
]
Changes = Annotated[
    list[str] | None,
    typer.Option("--set", help="key=value over the file's, such as tasks.chase.budget=1000."),
]


def new(
    kind: Annotated[
        Literal["maze", "pursuit", "gymnasium", "deep"], typer.Argument(help="What the tasks are.")
    ],
    file: Annotated[Path | None, typer.Argument(help="The file; KIND.toml by default.")] = None,
) -> None:
    """Write a commented study to start from, which runs as it is."""
    from curricle.errors import StoreError
    from curricle.study.config.templates import template

    path = file or Path(f"{kind}.toml")
    try:
        with path.open("x", encoding="utf-8") as file_:
            file_.write(template(kind))
    except FileExistsError:
        raise StoreError(f"a new study needs a new file: {path} is there already") from None
    except OSError as error:
        raise StoreError(f"a study cannot be written to {path}: {error.strerror}") from None
    typer.echo(f"Wrote {path}: curricle check {path}, then curricle run {path}")


def check(file: File, seeds: Seeds = None, changes: Changes = None) -> None:
    """Validate a study; print its tasks, its cost and a forecast, without training anything."""
    from curricle.cli.study_preview import print_preview

    print_preview(_read(file, seeds, changes))


def run(
    file: File,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results; FILE-results by default.")
    ] = None,
    seeds: Seeds = None,
    changes: Changes = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Threads; all processors by default.")
    ] = None,
    processes: Annotated[bool, typer.Option(help="Processes instead of threads.")] = False,
    shard: Annotated[
        str, typer.Option(help="i/n: the i-th of n parts of the seeds, to be merged later.")
    ] = "1/1",
    track: Annotated[
        list[str] | None, typer.Option(help="Also send curves to tensorboard, wandb or mlflow.")
    ] = None,
    resume: Annotated[bool, typer.Option(help="Go on with what the folder holds.")] = False,
    dry_run: Annotated[bool, typer.Option(help="Print what would be done; train nothing.")] = False,
) -> None:
    """Run a study into a folder; an interrupted run goes on with --resume.

    Results do not depend on the number of workers, on shards, or on how often the run was stopped.
    """
    from curricle.cli.progress_bars import run_with_bars
    from curricle.cli.study_preview import units_left

    study = _read(file, seeds, changes)
    folder = out or Path(f"{file.stem}-results")
    if dry_run:
        for line in units_left(study, folder, _part(shard)):
            typer.echo(line)
        return
    run_with_bars(
        study,
        folder,
        resume=resume,
        workers=workers,
        processes=processes,
        shard=_part(shard),
        track=track or [],
    )
    typer.echo(f"Stored in {folder}: curricle show {folder}, curricle report {folder}")


def merge(
    out: Annotated[Path, typer.Argument(help="Folder for all of it.", show_default=False)],
    parts: Annotated[list[Path], typer.Argument(help="Folders of the parts.", show_default=False)],
) -> None:
    """Merge the parts of a study that several machines ran with --shard."""
    from curricle.study.shards import merge as merged

    results = merged(out, parts)
    typer.echo(f"{len(results.store.units())} units of {len(parts)} folders in {out}")


def schema() -> None:
    """Print the JSON Schema of study files, for editors that complete and check TOML."""
    from curricle.study.config.study_tables import json_schema

    typer.echo(json.dumps(json_schema(), indent=1))


def _read(file: Path, seeds: str | None, changes: list[str] | None) -> "StudyConfig":
    from curricle.study.config.reading import read_study

    number = seeds is not None and seeds.isdecimal()
    given = [] if seeds is None else [f"seeds={seeds}" if number else f'seeds="{seeds}"']
    return read_study(file, set=[*(changes or []), *given])


def _part(shard: str) -> tuple[int, int]:
    part, slash, parts = shard.partition("/")
    numbers = slash and part.isdecimal() and parts.isdecimal()
    if not numbers or not 1 <= int(part) <= int(parts):
        raise typer.BadParameter(f"a shard is i/n, i from 1 to n, such as 1/4: got {shard!r}")
    return int(part), int(parts)
