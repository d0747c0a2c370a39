"""The section of a page on a sweep or a tuning: what was tried, what was best, main effects."""

from collections.abc import Sequence
from dataclasses import dataclass

from curricle.plotting.scales import minus
from curricle.study.config.varied_settings import value_text
from curricle.study.effects import Effects, Level, short
from curricle.study.tuning_record import TuningRecord
from curricle.study.units import numbered_seeds

NONE = "–"


@dataclass(frozen=True)
class BestRow:
    """The best settings that were found for an arm."""

    arm: str
    trials: int
    steps: str
    score: str
    values: tuple[str, ...]


@dataclass(frozen=True)
class EffectsSection:
    """What a sweep or a tuning shows."""

    effects: Effects
    rows: tuple[tuple[str, ...], ...]
    """Main effects: arm, setting, value, number of trials or arms, mean return, and its bounds."""
    best: tuple[BestRow, ...]  # of a tuning
    words: str  # on the tuning's seeds and steps


def effects_sections(
    found: Sequence[Effects], tuning: TuningRecord | None
) -> tuple[EffectsSection, ...]:
    """Return the sections of a page on a sweep and on a tuning, those that there are."""
    return tuple(
        EffectsSection(
            one,
            tuple(
                (arm, key, minus(level.text), f"{level.number}", *_mean(level))
                for arm, key, level in one.rows
            ),
            () if one.kind == "sweep" or tuning is None else _best(tuning),
            "" if one.kind == "sweep" or tuning is None else _words(tuning),
        )
        for one in found
    )


def _best(tuning: TuningRecord) -> tuple[BestRow, ...]:
    rows = []
    for name, arm in tuning.arms.items():
        values = (arm.best.values.get(key) for key in tuning.space)
        rows.append(
            BestRow(
                name,
                len(arm.trials),
                f"{tuning.steps(name):,}",
                NONE if arm.best.score is None else minus(short(arm.best.score)),
                tuple(_value(value) for value in values),
            )
        )
    return tuple(rows)


def _mean(level: Level) -> tuple[str, str]:
    low, mean, high = (minus(short(number)) for number in (level.low, level.mean, level.high))
    return mean, f"[{low}, {high}]"


def _value(value: object) -> str:
    if value is None:
        return NONE
    if isinstance(value, int) and not isinstance(value, bool):
        return minus(f"{value:,}")
    return minus(short(value) if isinstance(value, float) else value_text(value))


def _words(tuning: TuningRecord) -> str:
    return (
        f"Each trial was trained on {numbered_seeds(tuning.seeds)}, apart from those of the "
        f"study, for {tuning.total:,} steps a seed, sources included. Learning from scratch "
        "was tuned as every arm. These steps are stated here; the curves are not charged "
        "with them."
    )
