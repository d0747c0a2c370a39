"""The tables of a recipe's file, and a recipe as plain data."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Annotated, Any, Self

import numpy as np
from pydantic import (
    ConfigDict,
    Field,
    JsonValue,
    TypeAdapter,
    ValidationError,
    model_validator,
)

from curricle.design.ledger import Ledger
from curricle.design.recipe import AGGREGATES, SHAPINGS, Recipe, Stage
from curricle.design.relations import Relation
from curricle.design.trends import Trend
from curricle.errors import CurricleError
from curricle.study.config.settings import LEARNERS, AnyLearner
from curricle.study.config.tables import (
    Choice,
    Flag,
    Number,
    Table,
    Whole,
    shown,
    suggestion,
    unknown,
    word,
    wrong,
    wrong_at,
)
from curricle.study.config.tasks import NONE, FamilyTable
from curricle.tasks.families.built_in import BUILT_IN

CALIBRATED = "calibrated"
QUANTILES = np.linspace(0, 100, 41)
"""Percentiles that are kept of a constant: every 2.5 of them, so that the 95 % interval stays."""
LAST = "end"
"""The empty table that closes a file: one that was cut short would be a shorter recipe."""
DIGITS = 4
"""Of the numbers of a recipe that are kept."""

# -- as plain data -----------------------------------------------------------------------------


def recipe_data(recipe: Recipe) -> dict[str, Any]:
    """Return a recipe as plain data, from which :class:`RecipeTable` makes an equal one.

    Examples
    --------
    >>> recipe_data(Recipe([Stage(Relation("member", changes={"size": "0.5 n"}), 40)]))["stages"]
    [{'kind': 'member', 'size': '0.5 n', 'steps': 40.0}]
    """
    scale = recipe.scale if recipe.scale == CALIBRATED else _number(recipe.scale)
    return {
        "chain": recipe.chain,
        "aggregate": recipe.aggregate,
        "scale": scale,
        "shaping": recipe.shaping,
        "annealed": recipe.annealed,
        "stages": [_stage(one) for one in recipe.stages],
    }


def _stage(stage: Stage) -> dict[str, Any]:
    one = stage.relation
    changes = {name: NONE if value is None else value for name, value in one.changes}
    if any(name in StageTable.model_fields for name in changes):
        changes = {"changes": changes}
    return {
        "kind": one.kind,
        **({} if one.share is None else {"share": float(one.share)}),
        **({"which": one.which} if one.which else {}),
        **changes,
        "steps": _number(stage.steps),
        **({"settled": True} if stage.settled else {}),
    }


def _number(trend: Trend) -> float | dict[str, Any]:
    """Return a number by size: itself where it is a constant, else what it is made of."""
    draws = np.asarray(trend.draws)
    if trend.slope == 0 and trend.around == 1 and not len(draws):
        return float(trend.level)
    found: dict[str, Any] = {
        name: float(getattr(trend, name)) for name in ("level", "slope", "around")
    }
    if len(draws):
        levels = (draws[:, 1] == trend.slope).all()
        found["draws"] = (draws[:, 0] if levels else draws).tolist()
    return found


def compact(recipe: Recipe) -> Recipe:
    """Return a recipe whose numbers have four digits, and keep less of what intervals rest on.

    Of a constant 41 percentiles, which have the same 95 % interval; of a trend all draws.
    """
    stages = [Stage(one.relation, _compact(one.steps), one.settled) for one in recipe.stages]
    scale = recipe.scale if recipe.scale == CALIBRATED else _compact(recipe.scale)
    return replace(recipe, stages=stages, scale=scale)


def _compact(trend: Trend) -> Trend:
    draws = np.asarray(trend.draws)
    if len(draws) > len(QUANTILES) and (draws[:, 1] == draws[0, 1]).all():
        levels = np.percentile(draws[:, 0], QUANTILES)
        draws = np.stack([levels, np.full(len(levels), draws[0, 1])], axis=1)
    kept = [[rounded(one) for one in row] for row in draws.tolist()]
    return Trend(rounded(trend.level), rounded(trend.slope), rounded(trend.around), kept)


def rounded(number: float) -> float:
    """Return a number with the digits that are kept."""
    return float(f"{number:.{DIGITS}g}")


@contextmanager
def refused() -> Iterator[None]:
    """Turn what the library refuses in this context into what is wrong with a table."""
    try:
        yield
    except CurricleError as error:
        raise wrong(f"is refused: {error}") from None


# -- the tables --------------------------------------------------------------------------------


class TrendTable(Table):
    """A number by size: level (S / around)^slope for S states."""

    level: Number
    slope: Number = 0.0
    around: Number = 1.0
    draws: tuple[Number, ...] | tuple[tuple[Number, Number], ...] = Field(
        default=(), description="Levels of resamples, or each with its slope."
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        with refused():
            self.trend()
        return self

    def trend(self) -> Trend:
        """Return the number."""
        draws = [one if isinstance(one, tuple) else (one, self.slope) for one in self.draws]
        return Trend(self.level, self.slope, self.around, draws)


_PLAIN = TypeAdapter[float](Number)


def _positive(value: Any) -> float:
    """Return a number above 0."""
    if isinstance(value, str):
        raise wrong(f"must be a number, or a table with level, slope and around: got {value!r}")
    number = _PLAIN.validate_python(value)
    if number <= 0:
        raise wrong(f"must be above 0: got {shown(value)}")
    return number


def _scale(value: Any) -> Any:
    if value == CALIBRATED:
        return value
    if isinstance(value, str):
        raise wrong(
            f"must be a number, a table, or {CALIBRATED!r}: got "
            f"{shown(value)}{suggestion(value, [CALIBRATED])}"
        )
    return _positive(value)


def _trend_or(simple: Any) -> Choice:
    return Choice((TrendTable,), lambda _: TrendTable, simple, float)


def _by_size(value: Any) -> Any:
    return value.trend() if isinstance(value, TrendTable) else value


class StageTable(Table):
    """One source of a recipe; its other keys are parameters of a member."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, JsonValue]

    kind: str
    share: Number | None = None
    which: str = ""
    steps: Annotated[Any, _trend_or(_positive)]
    settled: Flag = False
    changes: dict[str, JsonValue] = Field(default={})

    @model_validator(mode="after")
    def _fits(self) -> Self:
        with refused():
            self.stage()
        return self

    @property
    def terms(self) -> dict[str, Any]:
        """The parameters of a member, by those of its target."""
        given = {**self.changes, **self.__pydantic_extra__}
        return {name: None if value == NONE else value for name, value in given.items()}

    def stage(self) -> Stage:
        """Return the stage."""
        relation = Relation(self.kind, self.share, self.which, self.terms)
        return Stage(relation, _by_size(self.steps), self.settled)


class IntervalTable(Table):
    """An estimate and its interval, which is left out where there is none."""

    estimate: Number
    low: Number | None = None
    high: Number | None = None
    confidence: Number
    n: Whole


class JudgementTable(Table):
    """What a recipe saves on new seeds, as shares of what learning from scratch takes."""

    problems: tuple[str, ...]
    seeds: Whole
    problems_paid: Whole
    saving: IntervalTable
    cost: dict[str, Number]


class LedgerTable(Table):
    """What the design spent."""

    steps: dict[str, Whole] = Field(default={})
    prices: dict[str, Number] = Field(default={})

    @model_validator(mode="after")
    def _fits(self) -> Self:
        with refused():
            self.ledger()
        return self

    def ledger(self) -> Ledger:
        """Return the ledger."""
        return Ledger.from_dict(self.model_dump())


class OfFamily(Table):
    """A file about members of one family."""

    family: str = Field(description="Built in, or one's own as module:function.")
    defaults: dict[str, JsonValue] = Field(default={}, description="What all members share.")
    learner: AnyLearner = Field(default=LEARNERS[0](), description="Of all tasks.")

    @model_validator(mode="after")
    def _known_parameters(self) -> Self:
        if "family" in self.defaults:
            raise wrong_at((("defaults", "family"), "must stand above the tables"))
        try:
            FamilyTable.model_validate({"family": self.family, **self.defaults})
        except ValidationError as error:
            found = [(one["loc"], one["msg"]) for one in error.errors(include_url=False)]
            places = [path if path == ("family",) else ("defaults", *path) for path, _ in found]
            raise wrong_at(
                *((place, text) for place, (_, text) in zip(places, found, strict=True))
            ) from None
        return self


class EndTable(Table):
    """The end of a file."""


class RecipeTable(OfFamily):
    """The file of a recipe."""

    last_table: str = Field(default="", description="That closes it; none where it is by hand.")

    chain: Flag = True
    aggregate: Annotated[str, word(f"be one of {', '.join(AGGREGATES)}", AGGREGATES)] = "mean"
    scale: Annotated[Any, _trend_or(_scale)] = 1.0
    shaping: Annotated[str, word(f"be one of {', '.join(SHAPINGS)}", SHAPINGS)] = "initialise"
    annealed: Flag = False
    stages: tuple[StageTable, ...] = ()
    judgement: JudgementTable | None = None
    ledger: LedgerTable | None = None
    end: EndTable | None = None

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if self.last_table not in ("", LAST):
            raise wrong_at((("last_table",), f"must be {LAST!r}: got {shown(self.last_table)}"))
        if self.last_table and self.end is None:
            raise wrong_at(((LAST,), "is missing, the last table: the file was cut short"))
        return self

    @model_validator(mode="after")
    def _known_changes(self) -> Self:
        if self.family in BUILT_IN:
            names = [one.name for one in BUILT_IN[self.family].parameters]
            for number, stage in enumerate(self.stages):
                for name in stage.terms:
                    if name not in names:
                        raise wrong_at((("stages", number, name), unknown(name, names)))
        return self

    def recipe(self) -> Recipe:
        """Return the recipe."""
        return Recipe(
            [one.stage() for one in self.stages],
            self.chain,
            self.aggregate,
            _by_size(self.scale),
            self.shaping,
            self.annealed,
        )
