"""Designing a recipe from a file into a file: a killed design goes on where it was."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from curricle.design.recipe_design import RecipeDesign, design_recipe
from curricle.design.search_budget import SearchBudget
from curricle.errors import (
    ConfigError,
    CurricleError,
    CurriculumError,
    StoreError,
    StudyError,
    in_words,
)
from curricle.files import write_whole
from curricle.progress import Progress
from curricle.study.config.merging import assignment
from curricle.study.recipes.design_file import read_design
from curricle.tasks.families.built_in import BUILT_IN

TRAININGS = ".trainings.jsonl"
"""Ending of the file beside a recipe to which its trainings are written."""


def run_design(
    file: Path,
    on: str,
    out: Path,
    *,
    budget: float,
    seed: int = 0,
    workers: int | None = None,
    resume: bool = False,
    set: Sequence[str] = (),
    progress: Progress = None,
) -> RecipeDesign:
    """Return what the design of a file found, and write its recipe.

    Every training is written to a file beside the recipe before the next one begins. With `resume`
    those that are there are not made again; the recipe is the same, byte for byte.

    Parameters
    ----------
    file : Path
        As :func:`read_design` reads it.
    on : str
        The table with the members.
    out : Path
        The recipe.
    budget : float
        Steps of all trainings together.
    seed, workers
        As in :func:`design_recipe` and :class:`SearchBudget`.
    resume : bool
    set : sequence of str
        Changes of the file.
    progress : bool or callable, optional
        As in :func:`design_recipe`.

    Raises
    ------
    StoreError
        When there are trainings already, or a recipe, and it is not to be resumed; when it would
        take the place of another file; when another process designs it.
    StudyError
        When a family of one's own fails in the design.
    CurricleError
        When the file is wrong, or the budget too small.
    """
    trainings = _trainings_of(out, file, resume=resume)
    begun = trainings.exists()
    plan = read_design(file, on, set=set)
    try:
        with FileLock(out.with_name(f".{out.name}.lock"), timeout=0):
            search = SearchBudget(budget, workers=workers, journal=trainings)
            try:
                with _own_code(plan.family):
                    found = design_recipe(plan.problems, search, seed=seed, progress=progress)
            except CurriculumError as error:
                if not begun and _lines(trainings) <= len(plan.problems):
                    trainings.unlink(missing_ok=True)  # refused before anything raced
                raise ConfigError(f"{file}: {on}: {error}") from error
            write_whole(out, plan.recipe_file(found, budget, seed).encode())
    except Timeout:
        raise StoreError(f"another process designs {out} at the moment") from None
    return found


def _trainings_of(out: Path, file: Path, *, resume: bool) -> Path:
    """Return the file of the trainings; StoreError if a recipe would take another file's place."""
    if out.is_dir() or out.resolve() == file.resolve():
        what = "a folder" if out.is_dir() else "the file of the design"
        raise StoreError(f"a recipe needs a file of its own: {out} is {what}")
    trainings = out.with_suffix(TRAININGS)
    there = next((one for one in (trainings, out) if one.exists()), None)
    if there is not None and not resume:
        raise StoreError(
            f"{there} is there already: go on with --resume, or give another file with --out"
        )
    if there == out:
        raise StoreError(
            f"{out} cannot be resumed: its trainings, {trainings.name}, are not beside it; give "
            "another file with --out"
        )
    return trainings


@contextmanager
def _own_code(family: str) -> Iterator[None]:
    """Turn what a family of the user's raises for a source into a StudyError with its cause."""
    try:
        yield
    except (CurricleError, OSError, MemoryError):
        raise
    except Exception as error:
        if family in BUILT_IN:
            raise
        raise StudyError(
            f"{family} failed in a design, whose trainings are kept: {in_words(error)}"
        ) from error


def _lines(path: Path) -> int:
    return path.read_bytes().count(b"\n") if path.exists() else 0


def parameters_of(text: str) -> dict[str, Any]:
    """Return parameters that are written as ``size=10, predators=3``.

    Raises
    ------
    ConfigError
        When a part of it is no assignment, or a parameter is there twice.

    Examples
    --------
    >>> parameters_of("size=10, torus=true, capture=any")
    {'size': 10, 'torus': True, 'capture': 'any'}
    """
    found = dict[str, Any]()
    for part in text.split(","):
        named = part.partition("=")[0].strip()
        if "=" not in part or not named or "." in named or named in found:
            raise ConfigError(f"parameters are given as size=10, predators=3: got {text!r}")
        _, value = assignment(part.strip())
        found |= value
    return found
