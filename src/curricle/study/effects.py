"""The main effects of the settings of a sweep or a tuning: the mean return with each value."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from curricle.arrays import FloatArray
from curricle.comparison.comparison import Comparison
from curricle.statistics.intervals import mean_interval
from curricle.study.config.sweeps import value_text
from curricle.study.record import CurriculaRecord
from curricle.study.tuning import SpaceRecord, TuningRecord

THIRDS = 3
SWEEP, TUNING = "sweep", "tuning"


@dataclass(frozen=True)
class Setting:
    """A setting that was varied, and the values that it had."""

    key: str
    """As in the study's file."""
    levels: tuple[str, ...]
    """The values in words, or parts of its range."""
    range: SpaceRecord | None = None

    def level(self, value: Any) -> str:
        """Return the level that a value belongs to."""
        if self.range is None:
            return value_text(value)
        ends: tuple[Any, ...] = self.range.low, self.range.high, value
        low, high, here = (math.log(x) if self.range.log else x for x in ends)
        number = int((here - low) / (high - low) * len(self.levels))
        return self.levels[min(max(number, 0), len(self.levels) - 1)]


class Tried(NamedTuple):
    """The arm that values of settings were tried for, and what came of it."""

    arm: str
    values: Mapping[str, Any]
    result: Any


@dataclass(frozen=True)
class Level:
    """The mean return with one value of a setting, whatever the others are."""

    text: str
    number: int
    """Of arms or trials."""
    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class Effects:
    """What a sweep or a tuning shows."""

    kind: str  # SWEEP or TUNING
    settings: tuple[Setting, ...]
    levels: Mapping[tuple[str, str], tuple[Level, ...]]
    """(arm, key) -> the main effect of a setting: its levels, in order."""

    @property
    def rows(self) -> Iterator[tuple[str, str, Level]]:
        """The levels of each setting for each arm: arm, key and level."""
        arms = dict.fromkeys(arm for arm, _ in self.levels)
        for setting in self.settings:
            for arm in arms:
                for level in self.levels.get((arm, setting.key), ()):
                    yield arm, setting.key, level


def effects_of(
    comparison: Comparison, record: CurriculaRecord, tuning: TuningRecord | None
) -> tuple[Effects, ...]:
    """Return what the sweep and the tuning of a study show, those that there are."""
    swept = sweep_effects(comparison, record, tuning)
    tuned = None if tuning is None else tuning_effects(tuning)
    return tuple(one for one in (swept, tuned) if one is not None)


def sweep_effects(
    comparison: Comparison, record: CurriculaRecord, tuning: TuningRecord | None
) -> Effects | None:
    """Return what the sweep of a study shows; None if it has none.

    A main effect is the mean over all arms with a value, with its 95 % interval over seeds.
    """
    tuned = set() if tuning is None else {*tuning.space}
    tried = [
        Tried(
            one.variant.arm,
            {key: value for key, value in one.variant.values.items() if key not in tuned},
            comparison.returns[name],
        )
        for name, one in record.arms.items()
        if one.variant is not None and name in comparison.arms
    ]
    keys = dict.fromkeys(key for one in tried for key in one.values)
    settings = tuple(
        _listed(key, [one.values[key] for one in tried if key in one.values]) for key in keys
    )
    return Effects(SWEEP, settings, _levels(tried, settings, _over_seeds)) if settings else None


def tuning_effects(tuning: TuningRecord) -> Effects:
    """Return what a tuning shows.

    The levels of a range are its thirds; each has the mean of its trials, the lowest and the
    highest. Trials crowd where returns are high, so they are no fair sample of a range.
    """
    tried = [
        Tried(tuned.arm, trial.values, trial.score)
        for tuned in tuning.arms.values()
        for trial in tuned.trials
        if trial.score is not None
    ]
    settings = tuple(_searched(key, one) for key, one in tuning.space.items())
    return Effects(TUNING, settings, _levels(tried, settings, _over_trials))


def _levels(
    tried: Sequence[Tried], settings: Sequence[Setting], level_of: Callable[[str, Any], Level]
) -> dict[tuple[str, str], tuple[Level, ...]]:
    """Return the main effect of each setting on each arm; `level_of` sums up what came of it."""
    found = {}
    for arm in dict.fromkeys(one.arm for one in tried):
        for setting in settings:
            own = [one for one in tried if one.arm == arm and setting.key in one.values]
            places = [setting.level(one.values[setting.key]) for one in own]
            results = [
                (
                    text,
                    [one.result for one, place in zip(own, places, strict=True) if place == text],
                )
                for text in setting.levels
            ]
            if own:
                found[arm, setting.key] = tuple(level_of(*each) for each in results if each[1])
    return found


def _listed(key: str, values: Iterable[Any]) -> Setting:
    return Setting(key, tuple(dict.fromkeys(map(value_text, values))))


def _searched(key: str, space: SpaceRecord) -> Setting:
    if space.values:
        return _listed(key, space.values)
    low, high = float(space.low or 0.0), float(space.high or 0.0)
    bounds = (np.geomspace if space.log else np.linspace)(low, high, THIRDS + 1)
    texts = tuple(f"{short(a)} to {short(b)}" for a, b in pairwise(bounds.tolist()))
    return Setting(key, texts, space)


def short(number: float) -> str:
    """Return a number in three significant digits, or as a whole number."""
    return f"{number:,.0f}" if abs(number) >= 1000 else f"{number:.3g}"


def _over_seeds(text: str, returns: Sequence[FloatArray]) -> Level:
    found = mean_interval(np.mean(returns, axis=0))
    return Level(text, len(returns), float(found.estimate), float(found.low), float(found.high))


def _over_trials(text: str, scores: Sequence[float]) -> Level:
    return Level(text, len(scores), float(np.mean(scores)), min(scores), max(scores))
