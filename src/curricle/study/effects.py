"""The main effects of the settings of a sweep or a tuning: the mean return with each value."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from curricle.array_types import FloatArray
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
    low: float
    high: float
    """Of its range."""
    log: bool
    is_range: bool

    def level(self, value: Any) -> str:
        """Return the level that a value belongs to."""
        if not self.is_range:
            return value_text(value)
        low, high, here = ((math.log(x) if self.log else x) for x in (self.low, self.high, value))
        number = int((here - low) / (high - low) * len(self.levels))
        return self.levels[min(max(number, 0), len(self.levels) - 1)]


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
    arms, returns = list[str](), list[FloatArray]()
    values = list[dict[str, Any]]()
    for name, one in record.arms.items():
        if one.variant is not None and name in comparison.arms:
            arms.append(one.variant.arm)
            values.append({k: v for k, v in one.variant.values.items() if k not in tuned})
            returns.append(comparison.returns[name])
    settings = tuple(
        _listed(key, values) for key in dict.fromkeys(k for one in values for k in one)
    )
    if not settings:
        return None
    levels = {}
    for arm, setting in _pairs(arms, values, settings):
        levels[arm, setting.key] = tuple(
            _over_seeds(text, [returns[n] for n in where])
            for text, where in _where(arm, setting, arms, values)
        )
    return Effects(SWEEP, settings, levels)


def tuning_effects(tuning: TuningRecord) -> Effects:
    """Return what a tuning shows.

    The levels of a range are its thirds; each has the mean of its trials, the lowest and the
    highest. Trials crowd where returns are high, so they are no fair sample of a range.
    """
    arms, values, scores = list[str](), list[dict[str, Any]](), list[float]()
    for tuned in tuning.arms.values():
        for trial in tuned.trials:
            if trial.score is not None:
                arms.append(tuned.arm)
                values.append(dict(trial.values))
                scores.append(trial.score)
    settings = tuple(_searched(key, one) for key, one in tuning.space.items())
    levels = {}
    for arm, setting in _pairs(arms, values, settings):
        levels[arm, setting.key] = tuple(
            Level(text, len(where), float(np.mean(of)), min(of), max(of))
            for text, where in _where(arm, setting, arms, values)
            if (of := [scores[n] for n in where])
        )
    return Effects(TUNING, settings, levels)


def _listed(key: str, values: Sequence[Mapping[str, Any]]) -> Setting:
    texts = dict.fromkeys(value_text(one[key]) for one in values if key in one)
    return Setting(key, tuple(texts), 0.0, 0.0, False, False)


def _searched(key: str, space: SpaceRecord) -> Setting:
    if space.values:
        return _listed(key, [{key: one} for one in space.values])
    low, high = float(space.low or 0.0), float(space.high or 0.0)
    bounds = (np.geomspace if space.log else np.linspace)(low, high, THIRDS + 1)
    texts = tuple(f"{short(a)} to {short(b)}" for a, b in pairwise(bounds.tolist()))
    return Setting(key, texts, low, high, space.log, True)


def short(number: float) -> str:
    """Return a number in three significant digits, or as a whole number.

    Examples
    --------
    >>> short(0.12345), short(1234.5)
    ('0.123', '1,234')
    """
    return f"{number:,.0f}" if abs(number) >= 1000 else f"{number:.3g}"


def _pairs(
    arms: Sequence[str], values: Sequence[Mapping[str, Any]], settings: Sequence[Setting]
) -> Iterator[tuple[str, Setting]]:
    """Yield each arm with each setting that it has."""
    has = {(arm, key) for arm, one in zip(arms, values, strict=True) for key in one}
    for arm in dict.fromkeys(arms):
        yield from ((arm, setting) for setting in settings if (arm, setting.key) in has)


def _where(
    arm: str, setting: Setting, arms: Sequence[str], values: Sequence[Mapping[str, Any]]
) -> Iterator[tuple[str, list[int]]]:
    """Yield each level of a setting, and the numbers of what was tried there for an arm."""
    own = [n for n, one in enumerate(values) if arms[n] == arm and setting.key in one]
    for text in setting.levels:
        where = [n for n in own if setting.level(values[n][setting.key]) == text]
        if where:
            yield text, where


def _over_seeds(text: str, returns: Sequence[FloatArray]) -> Level:
    found = mean_interval(np.mean(returns, axis=0))
    return Level(text, len(returns), float(found.estimate), float(found.low), float(found.high))
