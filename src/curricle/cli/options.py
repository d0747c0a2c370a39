"""What several commands take, and what they do first."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
