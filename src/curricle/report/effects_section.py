"""The section of a page on a sweep or a tuning: what was tried, what was best, main effects."""

from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from curricle.plotting.effects import (
    draw_main_effects,
    draw_parallel_coordinates,
    effect_colours,
)
from curricle.plotting.scales import minus
from curricle.report.svg import inline_svg
from curricle.study.config.varied_settings import value_text
from curricle.study.effects import Effects, short
from curricle.study.tuning_record import TuningRecord
from curricle.study.units import numbered_seeds

WIDTHS = {"wide": 8.6, "narrow": 3.4}
"""Of figures on a desktop and on a phone, in inches."""
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
    """What a sweep or a tuning shows, drawn."""

    effects: Effects
    colours: dict[str, str]
    lines: dict[str, Markup]  # width -> parallel coordinates
    main: dict[str, Markup]  # width -> main effects
    best: tuple[BestRow, ...]  # of a tuning
    words: str  # on the tuning's seeds and steps


def effects_sections(
    found: Sequence[Effects], tuning: TuningRecord | None
) -> tuple[EffectsSection, ...]:
    """Return the sections of a page on a sweep and on a tuning, those that there are."""
    return tuple(
        EffectsSection(
            one,
            effect_colours(one),
            {
                size: inline_svg(
                    draw_parallel_coordinates(one, width=width),
                    f"{one.kind}-lines-{size}",
                    "A line for each combination of values, across an axis for each setting, to "
                    "its mean return.",
                )
                for size, width in WIDTHS.items()
            },
            {
                size: inline_svg(
                    draw_main_effects(one, width=width),
                    f"{one.kind}-main-{size}",
                    "The mean return over the values of each setting; curricle show prints it.",
                )
                for size, width in WIDTHS.items()
            },
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
