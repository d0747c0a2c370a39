"""Designing a recipe from a file into a file: a killed design goes on where it was."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from curricle.design.recipe_design import RecipeDesign, design_recipe
from curricle.design.search_budget import SearchBudget
from curricle.errors import ConfigError, CurriculumError, StoreError
from curricle.files import write_whole
from curricle.study.config.merging import assignment
from curricle.study.recipes.design_file import read_design

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

    Raises
    ------
    StoreError
        When there are trainings already, or a recipe, and it is not to be resumed; when another
        process designs it.
    CurricleError
        When the file is wrong, or the budget too small.
    """
    trainings = out.with_suffix(TRAININGS)
    there = next((one for one in (trainings, out) if one.exists()), None)
    if there is not None and not resume:
        raise StoreError(
            f"{there} is there already: go on with --resume, or give another file with --out"
        )
    plan = read_design(file, on, set=set)
    try:
        with FileLock(out.with_name(f".{out.name}.lock"), timeout=0):
            search = SearchBudget(budget, workers=workers, journal=trainings)
            try:
                found = design_recipe(plan.problems, search, seed=seed)
            except CurriculumError as error:
                if there is None and _lines(trainings) <= len(plan.problems):
                    trainings.unlink(missing_ok=True)  # refused before anything raced
                raise ConfigError(f"{file}: {on}: {error}") from error
            write_whole(out, plan.recipe_file(found, budget, seed).encode())
    except Timeout:
        raise StoreError(f"another process designs {out} at the moment") from None
    return found


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
        keys, value = assignment(part.strip())
        if len(keys) != 1 or keys[0] in found:
            raise ConfigError(f"parameters are given as size=10, predators=3: got {text!r}")
        found |= value
    return found
