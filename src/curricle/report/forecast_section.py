"""The forecast of each curriculum next to what was measured, and whether its shaping is safe."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from curricle.learning.result import LearningResult
from curricle.study.record import Analysis, CurriculaRecord, ForecastRecord, SectionRecord


@dataclass(frozen=True)
class ForecastSection:
    """The forecast and certificates of arms with the same graph."""

    record: SectionRecord
    used: Mapping[str, tuple[str, ...]]  # name of a forecast row -> the arms with that potential
    measured: Mapping[str, float | None]
    """Arm -> greedy return at the first target step, mean over seeds; None where a guard begins
    without the potential."""

    @property
    def arms(self) -> tuple[str, ...]:
        """The arms, which share the forecast."""
        return self.record.arms

    @property
    def forecast(self) -> ForecastRecord | None:
        """The forecast; None where it was left out."""
        return self.record.forecast


def forecast_sections(
    analysis: Analysis,
    curricula: CurriculaRecord,
    learnt: Mapping[str, Mapping[str, LearningResult]],
) -> tuple[ForecastSection, ...]:
    """Return the sections of an analysis, with what was measured.

    Parameters
    ----------
    analysis : Analysis
    curricula : CurriculaRecord
    learnt : dict of str to dict of str to LearningResult
        Arm -> task -> its training.
    """
    known = [one for one in analysis.sections if set(one.arms) <= curricula.arms.keys()]
    return tuple(_section(one, curricula, learnt) for one in known)


def _section(
    record: SectionRecord,
    curricula: CurriculaRecord,
    learnt: Mapping[str, Mapping[str, LearningResult]],
) -> ForecastSection:
    names = [] if record.forecast is None else [one.name for one in record.forecast.rows]
    used: dict[str, tuple[str, ...]] = {}
    measured: dict[str, float | None] = {}
    for arm in record.arms:
        potential = curricula.arms[arm].potential
        if potential in names:
            used[potential] = (*used.get(potential, ()), arm)
        *_, target = learnt[arm].values()
        guarded = np.isfinite(target.guard_share[:, 0]).any()
        measured[arm] = None if guarded else float(target.greedy_return[:, 0].mean())
    return ForecastSection(record, used, measured)
