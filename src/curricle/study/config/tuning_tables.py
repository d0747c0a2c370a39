"""Tuning: what is searched for every arm, and where that stands in its curriculum."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, ValidationError, model_validator

from curricle.learning.seeds import MOST_SEEDS
from curricle.statistics.curves import SCRATCH
from curricle.study.config.merging import Raw
from curricle.study.config.seed_numbers import seeds_of
from curricle.study.config.sweeps import Variant, places_from_scratch, swept_in
from curricle.study.config.tables import (
    Count,
    Flag,
    KeyPath,
    Table,
    Whole,
    shown,
    whole_number,
    wrong,
    wrong_at,
)
from curricle.study.config.task_names import table
from curricle.study.config.varied_settings import (
    Varied,
    places_of,
    value_text,
    varied_in,
    wrong_key,
)

FIRST_SEED = 1_000_000
"""Of the seeds for tuning, where the file says how many: studies have other ones."""
MOST_TRIALS = 1_000
HOME = ("tune", "space")


def _tuning_seeds(value: Any) -> tuple[int, ...]:
    if type(value) is int and 0 < value <= MOST_SEEDS:
        return tuple(range(FIRST_SEED, FIRST_SEED + value))
    return seeds_of(value)


def _bound(value: Any) -> int | float:
    """Return a finite number; whole ones stay whole."""
    if isinstance(value, bool) or not isinstance(value, int | float) or value - value != 0:
        raise wrong(f"must be a finite number: got {shown(value)}")
    return whole_number(value) if isinstance(value, int) else value


Bound = Annotated[int | float, BeforeValidator(_bound)]


class RangeTable(Table):
    """Numbers from `low` to `high`: whole ones if both are."""

    low: Bound = Field(description="The smallest value.")
    high: Bound = Field(description="The largest value.")
    log: Flag = Field(default=False, description="Whether equal ratios are equally likely.")

    @property
    def whole(self) -> bool:
        """Whether its numbers are whole."""
        return isinstance(self.low, int) and isinstance(self.high, int)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.low < self.high:
            raise wrong_at((("high",), f"must be above low, {self.low}: got {self.high}"))
        if self.log and self.low <= 0:
            raise wrong_at((("low",), f"must be above 0 in a logarithmic range: got {self.low}"))
        return self


class TuneTable(Table):
    """How settings are searched for every arm before it is run."""

    trials: Annotated[Count, Field(le=MOST_TRIALS)] = Field(
        default=20, description="Settings that are tried for each arm, learning from scratch too."
    )
    seeds: Annotated[
        tuple[int, ...],
        BeforeValidator(_tuning_seeds, json_schema_input_type=int | str | list[int]),
    ] = Field(
        default=tuple(range(FIRST_SEED, FIRST_SEED + 3)),
        description="Seeds of each trial: how many, a list, or ranges; none of the study's.",
    )
    seed: Whole = Field(default=0, ge=0, description="Of the search: the same seed, one outcome.")
    space: dict[str, Any] = Field(
        description="What is searched, by its keys in the file: lists of values, or tables with "
        "low, high and perhaps log = true."
    )


class Tuning(Table):
    """A tuning of which nothing is left to fill in."""

    trials: Count
    seeds: tuple[int, ...]
    seed: Whole
    space: dict[str, RangeTable | tuple[Any, ...]]
    places: dict[str, dict[str, tuple[KeyPath, ...]]]
    """Arm -> name of a setting -> where it stands in the arm's curriculum; none if nowhere."""

    def placed(self, arm: str, values: Mapping[str, Any]) -> dict[KeyPath, Any]:
        """Return the values of an arm's settings by their places in its curriculum."""
        places = self.places[arm]
        return {place: value for name, value in values.items() for place in places[name]}

    def keys(self, arm: str) -> tuple[str, ...]:
        """Return the names of the settings that an arm has."""
        return tuple(name for name, places in self.places[arm].items() if places)


def tuned_in(study: Raw) -> list[Varied]:
    """Return the settings that a study tunes."""
    return [*varied_in(table(study.get("tune")).get("space"), HOME)]


def wrong_tuning(study: Raw, complete: Mapping[str, Raw]) -> Iterator[tuple[KeyPath, str]]:
    """Yield what is wrong with the space of a study's tuning, each with its key path."""
    keys = tuned_in(study)
    if not keys and isinstance(table(study.get("tune")).get("space"), dict):
        yield HOME, "must name a setting to tune: got none"
    if "tune" in study and study.get("scratch") is False:
        yield (
            ("tune",),
            "needs learning from scratch, which is tuned as every arm: leave out scratch = false",
        )
    names, swept = [one.name for one in keys], {one.name for one in swept_in(study)}
    for number, one in enumerate(keys):
        if one.name in names[:number]:
            yield one.home, "is given twice"
        elif one.name in swept:
            yield one.home, "is swept already: leave out one of the two"
        elif wrong := [*_wrong_space(one)]:
            yield from wrong
        elif why := wrong_key(study, complete, one):
            yield one.home, why


def _wrong_space(one: Varied) -> Iterator[tuple[KeyPath, str]]:
    if isinstance(one.given, dict):
        try:
            RangeTable.model_validate(one.given)
        except ValidationError as error:
            yield from (((*one.home, *e["loc"]), e["msg"]) for e in error.errors(include_url=False))
        return
    texts = list(map(value_text, one.given)) if isinstance(one.given, list) else []
    if len(texts) < 2 or len(set(texts)) < len(texts):
        text = "must be a list of two or more different values, or { low, high }: got "
        yield one.home, text + shown(one.given)


def ends_of(space: Any) -> tuple[Any, ...]:
    """Return the values of a setting that tell whether all of them are allowed."""
    return (space.low, space.high) if isinstance(space, RangeTable) else tuple(space)


def places_of_tuning(
    study: Raw, variants: Mapping[str, Variant], scratches: Mapping[str, Variant]
) -> dict[str, dict[str, tuple[KeyPath, ...]]]:
    """Return where each tuned setting stands in the curriculum of each arm, from scratch too."""
    patches, keys = table(study.get("arms")), tuned_in(study)
    found = {
        name: {one.name: places_of(study, table(patches.get(own.arm)), one.key) for one in keys}
        for name, own in variants.items()
    }
    first = table(patches.get(next(iter(variants.values())).arm))
    learners = table(study.get("scratch_learners"))
    for name, own in scratches.items():
        given = learners.get(own.arm.removeprefix(f"{SCRATCH}, ")) if own.arm != SCRATCH else {}
        found[name] = {
            one.name: tuple(
                place
                for place in places_from_scratch(study, first, one, own.curriculum)
                if not _sets(given, place[3:])
            )
            for one in keys
        }
    return found


def _sets(learner: Any, path: KeyPath) -> bool:
    """Return whether a further learner from scratch sets a key itself."""
    for part in path:
        if not isinstance(learner, dict) or part not in learner:
            return False
        learner = learner[part]
    return bool(path)
