"""The forecast of each curriculum next to what was measured, and whether its shaping is safe."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from curricle.learning.result import LearningResult
from curricle.plotting.scales import rounded
from curricle.study.record import Analysis, CurriculaRecord, ForecastRecord, SectionRecord


@dataclass(frozen=True)
class ForecastSection:
    """The forecast and certificates of arms with the same graph."""

    record: SectionRecord
    used: Mapping[str, tuple[str, ...]]  # name of a forecast row -> the arms with that potential
    measured: Mapping[str, float | None]
    """Arm -> greedy return at the first target step, mean over seeds; None where a guard begins
    without the potential."""
    other_sources: tuple[str, ...] = ()
    """Arms that train their sources differently: the forecast does not apply to them."""

    @property
    def arms(self) -> tuple[str, ...]:
        """The arms, which have the same graph."""
        return self.record.arms

    @property
    def same_sources(self) -> tuple[str, ...]:
        """The arms that train their sources as the forecast assumes."""
        return tuple(arm for arm in self.arms if arm not in self.other_sources)

    def starts(self, potential: str) -> str:
        """Return the measured starts of the arms with a potential, in words."""
        arms = self.used.get(potential, ())
        words = [
            "guarded" if (start := self.measured[arm]) is None else rounded(start) for arm in arms
        ]
        return ", ".join(dict.fromkeys(words) if {*words} == {"guarded"} else words)

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
    other_sources = tuple(
        arm for arm in record.arms if not _sources_alike(arm, record.arms[0], curricula)
    )
    for arm in record.arms:
        potential = curricula.arms[arm].potential
        if potential in names and arm not in other_sources:
            used[potential] = (*used.get(potential, ()), arm)
        *_, target = learnt[arm].values()
        guarded = np.isfinite(target.guard_share[:, 0]).any()
        measured[arm] = None if guarded else float(target.greedy_return[:, 0].mean())
    return ForecastSection(record, used, measured, other_sources)


def _sources_alike(arm: str, other: str, curricula: CurriculaRecord) -> bool:
    """Return whether two arms with the same tasks train their sources alike."""
    *sources, _ = curricula.arms[arm].nodes.items()
    there = curricula.arms[other].nodes
    return all(
        (node.key, node.settings) == (there[name].key, there[name].settings)
        for name, node in sources
    )
