"""The file of a recipe: what a design found, in TOML that a person can read and change."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from curricle.checks import instance
from curricle.design.judgement import RECIPE
from curricle.design.ledger import Ledger
from curricle.design.recipe import Recipe
from curricle.design.recipe_design import BEST, RecipeDesign
from curricle.display import brief_repr
from curricle.errors import ConfigError
from curricle.frozen_arrays import Frozen
from curricle.learning.learners import Learner
from curricle.study.config.merging import Positions, Problems, assignment, line_numbers, merged
from curricle.study.config.reading import toml_of
from curricle.study.config.tables import KeyPath, Table, built
from curricle.study.config.tasks import family_of
from curricle.study.recipes.recipe_tables import (
    LAST,
    OfFamily,
    RecipeTable,
    TrendTable,
    recipe_data,
    rounded,
)
from curricle.study.recipes.toml_text import comments, header, pair, pairs
from curricle.tasks.families.family import TaskFamily

Kind = TypeVar("Kind", bound=Table)
MEANINGS = {
    "chain": "each source builds on the one before; false: the target reads all",
    "aggregate": "of the values that the target reads: mean, minimum, maximum, total",
    "scale": 'of these values; or "calibrated"',
    "shaping": "how they enter: initialise, guarded, look-ahead, state",
    "annealed": "sources are learnt with a falling learning rate",
    "share": "of the target",
    "steps": "a state of the source",
}


@dataclass(frozen=True, eq=False)
class StoredRecipe(Frozen):
    """A recipe with the family that it is for, and how it was found.

    Parameters
    ----------
    recipe : Recipe
    family : str
        Built in, or one's own as ``module:function``.
    defaults : dict
        Parameters that all members share.
    learner : dict
        As in a study file; empty for Q-learning as it is by default.
    judgement : dict
        What it saved on new seeds; empty for a recipe that was written by hand.
    ledger : Ledger, optional
        What the design spent, without processor time: that is another one each time.
    folder : Path
        Where a family of one's own is looked for.
    """

    recipe: Recipe
    family: str
    defaults: Mapping[str, Any] = field(default_factory=dict)
    learner: Mapping[str, Any] = field(default_factory=dict)
    judgement: Mapping[str, Any] = field(default_factory=dict)
    ledger: Ledger | None = None
    folder: Path = Path()

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        instance("the recipe of a file", self.recipe, Recipe, ConfigError)

    def of_family(self) -> TaskFamily:
        """Return the family, with the defaults of the file."""
        return family_of(self.family, self.folder, self.defaults)


# -- writing -----------------------------------------------------------------------------------


def recipe_text(stored: StoredRecipe, words: Sequence[str] = ()) -> str:
    """Return the file of a recipe; `words` stand above it as comments.

    Examples
    --------
    >>> from curricle.design import Relation, Stage
    >>> recipe = Recipe([Stage(Relation("crop", 0.5), 40)], scale=2)
    >>> print(recipe_text(StoredRecipe(recipe, "maze", {"pits": 0.2}), ["By hand."]))
    # By hand.
    <BLANKLINE>
    last_table = "end"          # a file without it was cut short
    family = "maze"
    chain = true                # each source builds on the one before; false: the target reads all
    aggregate = "mean"          # of the values that the target reads: mean, minimum, maximum, total
    scale = 2.0                 # of these values; or "calibrated"
    shaping = "initialise"      # how they enter: initialise, guarded, look-ahead, state
    annealed = false            # sources are learnt with a falling learning rate
    <BLANKLINE>
    [[stages]]
    kind = "crop"
    share = 0.5                 # of the target
    steps = 40.0                # a state of the source
    <BLANKLINE>
    [defaults]
    pits = 0.2
    <BLANKLINE>
    [end]
    <BLANKLINE>
    """
    return "\n".join([*comments(words), *[""] * bool(words), *_lines(stored)]) + "\n"


def _lines(stored: StoredRecipe) -> Iterator[str]:
    data = recipe_data(stored.recipe)
    stages = data.pop("stages")
    trends = {"scale": data.pop("scale")} if isinstance(data["scale"], dict) else {}
    yield pair("last_table", LAST, "a file without it was cut short")
    yield pair("family", stored.family)
    for key, value in data.items():
        yield pair(key, value, MEANINGS[key])
    for key, value in trends.items():
        yield from ("", header(key), *_trend(value, "of the target"))
    for one in stages:
        yield from ("", header("stages", listed=True))
        for key, value in one.items():
            if not isinstance(value, dict) or key == "changes":
                yield pair(key, value, MEANINGS.get(key, ""))
        if isinstance(one["steps"], dict):
            yield from (header("stages", "steps"), *_trend(one["steps"], "of the last source"))
    judgement = dict(stored.judgement)
    cost, saving = judgement.pop("cost", {}), judgement.pop("saving", {})
    ledger = {} if stored.ledger is None else stored.ledger.to_dict()
    for keys, content in (
        (("defaults",), stored.defaults),
        (("learner",), stored.learner),
        (("judgement",), judgement),
        (("judgement", "saving"), saving),
        (("judgement", "cost"), cost),
        (("ledger", "steps"), ledger.get("steps", {})),
        (("ledger", "prices"), ledger.get("prices", {})),
    ):
        if content:
            yield from ("", header(*keys), *pairs(content))
    yield from ("", header(LAST))


def _trend(given: dict[str, Any], whose: str) -> Iterator[str]:
    """Yield the lines of a number by size, with its interval in words."""
    trend = TrendTable.model_validate(given).trend()
    low, high = trend.interval(trend.around)
    interval = f"; 95 % interval {low:.3g} to {high:.3g}" if low == low else ""
    yield pair("level", given["level"], f"at {trend.around:,.4g} states {whose}{interval}")
    yield pair("slope", given["slope"], "level (S / around)^slope at S states")
    yield pair("around", given["around"])
    if "draws" in given:
        yield "# Levels of resamples, or level and slope of each: the intervals are theirs."
        yield pair("draws", given["draws"])


def judgement_data(found: RecipeDesign) -> dict[str, Any]:
    """Return what a design measured on new seeds as plain data.

    It is the saving of the recipe that is recommended, or of the best in the race where none is; of
    a standing recipe the best has a cost of its own.
    """
    judged, own = found.judgement, found.recommended
    saving, (paid, _) = judged.saving(own), judged.problems_paid(own)
    names = {RECIPE: BEST, own: RECIPE} if found.standing else {}
    bounds = {name: float(getattr(saving, name)) for name in ("estimate", "low", "high")}
    return {
        "problems": [one.name for one in found.races[0].problems],
        "seeds": int(judged.steps[RECIPE].shape[1]),
        "problems_paid": paid,
        "saving": {
            **{name: rounded(one) for name, one in bounds.items() if one == one},
            "confidence": saving.confidence,
            "n": saving.n,
        },
        "cost": {names.get(name, name): rounded(judged.cost(name)) for name in judged.steps},
    }


# -- reading -----------------------------------------------------------------------------------


def read_recipe(path: str | PathLike[str]) -> StoredRecipe:
    r"""Return the recipe that a TOML file holds.

    Raises
    ------
    ConfigError
        With a line for each mistake: file, line, key path and what is wrong.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "recipe.toml"
    ...     stage = "{ kind = 'crop', share = 0.5, steps = 9 }"
    ...     _ = path.write_text(f"family = 'maze'\nstages = [{stage}]")
    ...     print(read_recipe(path).recipe)
    crop 0.5: 9 steps a state
    scale 1; initialise
    """
    path = Path(path)
    data, positions = read_data(path, ())
    table = validated(RecipeTable, data, positions)
    return StoredRecipe(
        table.recipe(),
        table.family,
        table.defaults,
        data.get("learner", {}),
        {} if table.judgement is None else table.judgement.model_dump(exclude_none=True),
        None if table.ledger is None else table.ledger.ledger(),
        path.parent,
    )


def read_data(path: Path, changes: Sequence[str]) -> tuple[dict[str, Any], Positions]:
    """Return what a file says with changes, such as ``"training.steps=1000"``, over it.

    Raises
    ------
    ConfigError
        When it cannot be read, or is no TOML.
    """
    text, data = toml_of(path)
    given = list[KeyPath]()
    for change in changes:
        keys, value = assignment(change)
        given.append(keys)
        # Another family in a study's task has other keys; here all of them stay.
        data = {**data, **value} if keys == ("family",) else merged(data, value)
    return data, Positions(str(path), data, line_numbers(text), given)


def validated(kind: type[Kind], data: dict[str, Any], positions: Positions) -> Kind:
    """Return the table of a file; ConfigError with all that is wrong in it."""
    try:
        return kind.model_validate(data, context={"folder": Path(positions.file).parent})
    except ValidationError as error:
        found = Problems(positions)
        found.add((one["loc"], one["msg"]) for one in error.errors(include_url=False))
        found.raise_any()
        raise


def learner_of(table: OfFamily, positions: Positions) -> Learner:
    """Return the learner of a file; ConfigError names its key."""
    found, learner = Problems(positions), None
    with found.at("", ("learner",)):
        learner = built(table.learner, Path(positions.file).parent)
    found.raise_any()
    if not isinstance(learner, Learner):
        text = "must be tabular: a design trains tables"
        raise ConfigError(positions.sentence(("learner",), text))
    return learner
