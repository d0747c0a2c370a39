"""The sections of a page in words and numbers: findings, forecast, and what was swept or tuned."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from curricle.comparison.comparison import Comparison
from curricle.comparison.plan import numbered_seeds
from curricle.comparison.verdicts import not_asked
from curricle.learning.result import LearningResult
from curricle.plotting.scales import minus, rounded, without_seeds
from curricle.statistics.hypothesis_tests import smallest_p
from curricle.statistics.intervals import Interval
from curricle.study.config.sweeps import value_text
from curricle.study.effects import Effects, short
from curricle.study.record import Analysis, CurriculaRecord, SectionRecord
from curricle.study.tuning import TuningRecord
from curricle.text_tables import counted

# -- The findings of a comparison in words: sentences for each arm, and a table of all measures ----

MEASURES = {
    "strong_gain": ("gain", "mean return over all steps, above that of scratch"),
    "asymptotic_gain": ("asymptotic gain", "return at the end of all steps, above that of scratch"),
    "probability_of_improvement": (
        "P(improvement)",
        "probability that a run has a higher mean return than a run from scratch",
    ),
    "strong_steps_saved": (
        "steps saved",
        "steps to the threshold within the budget, fewer than from scratch",
    ),
    "mean_return": ("mean return", "mean height of the curve over all steps"),
    "weak_gain": ("gain", "mean return over target steps, above that of scratch"),
    "jumpstart": ("jumpstart", "return at the first target step, above that of scratch"),
    "weak_steps_saved": (
        "steps saved",
        "target steps to the threshold within the budget, fewer than from scratch",
    ),
}
"""Measure of :meth:`Comparison.rows` -> its name, and what it is."""
WEAK = ("weak_gain", "jumpstart", "weak_steps_saved")
"""Measures of weak transfer, which do not count source steps."""
TIMED = ("weak_steps_saved", "strong_steps_saved")


@dataclass(frozen=True)
class Finding:
    """The finding about one arm."""

    arm: str
    control: bool
    tone: str  # "pays", "costs" or "open"
    verdict: str
    sentences: tuple[str, ...]
    gain: Interval  # of strong transfer, in return


@dataclass(frozen=True)
class Cell:
    """One entry of the table: its text, and below that its interval or a note."""

    text: str
    below: str = ""


def headline(comparison: Comparison) -> str:
    """Return the comparison in one sentence: which curricula paid, and which most.

    Where there is no verdict it says why, and nothing else.
    """
    own = list(comparison.verdicts)
    if words := comparison.withheld:
        return f"{words[0].upper()}{words[1:]}."
    paid = [name for name, one in comparison.verdicts.items() if one.direction > 0]
    harmed = [name for name, one in comparison.verdicts.items() if one.direction < 0]
    counts = [
        f"{_count(found, own)} {words[len(found) > 1]}"
        for found, words in (
            (paid, ("pays for itself", "pay for themselves")),
            (harmed, ("costs more than it brings", "cost more than they bring")),
        )
        if found
    ]
    open_ = len(own) - len(paid) - len(harmed)
    if open_ and not counts:
        return "No curriculum is shown to differ from learning the target from scratch."
    if open_:
        counts.append(f"{open_} show{'s' * (open_ == 1)} no difference")
    summary = ", ".join(counts)
    most = max(
        paid or harmed, key=lambda name: abs(float(comparison.contrasts[name].strong_gain.estimate))
    )
    gain = signed(comparison.contrasts[most].strong_gain)
    leading = f"{most} most, " * (len(paid or harmed) > 1) or f"{most}, " * (len(own) > 1)
    several = len(comparison.scratches) > 1
    rival = (
        f"the best learner from {comparison.best_scratch}" if several else "learning from scratch"
    )
    return (
        f"{summary[0].upper()}{summary[1:]}: {leading}{gain} mean return against {rival}, source "
        "steps counted, over "
        f"{counted(comparison.seeds, 'seed')}.{_why(comparison)}"
    )


def _why(comparison: Comparison) -> str:
    """Return why those curricula pay that were asked, a sentence for each reason."""
    by_words: dict[str, list[str]] = {}
    for name, reason in comparison.reasons.items():
        if reason.words:
            by_words.setdefault(reason.words, []).append(name)
    if len(comparison.verdicts) == 1:
        return "".join(f" It pays {words}." for words in by_words)
    return "".join(
        f" {words[0].upper()}{words[1:]}: {', '.join(names)}." for words, names in by_words.items()
    )


def findings(comparison: Comparison) -> tuple[Finding, ...]:
    """Return the finding about each arm besides those from scratch, in their order."""
    rows = {row["arm"]: row for row in comparison.rows()}
    return tuple(_finding(comparison, name, rows) for name in comparison.contrasts)


def _finding(comparison: Comparison, name: str, rows: Mapping[str, dict[str, Any]]) -> Finding:
    contrast, row = comparison.contrasts[name], rows[name]
    tone = {"pays": "pays", "costs more than it brings": "costs"}.get(contrast.verdict, "open")
    tested = name in comparison.verdicts and not comparison.withheld
    sure = f" (p\xa0=\xa0{contrast.adjusted_p:.2g})" if tested else ""
    sentences = [
        f"{signed(contrast.strong_gain)} mean return over all {comparison.total:,} steps, its "
        f"{row['source_steps']:,.0f} source steps counted{sure}.",
        f"Over target steps only: {signed(contrast.weak_gain)}.",
        _reached(comparison, row, rows[comparison.best_scratch]),
    ]
    apart = map(comparison.cluster_sentence, (name, comparison.best_scratch))
    sentences += [f"{words[0].upper()}{words[1:]}." for words in apart if words]
    if name in comparison.control_verdicts:
        words = comparison.control_sentence(name).removeprefix(f"{name} ")
        sentences.append(f"{words[0].upper()}{words[1:]}.")
    if name in comparison.verdicts:
        sentences += _reason(comparison, name)
    if unlearnt := row["unlearnt"]:
        sentences.append(f"{unlearnt[0].upper()}{unlearnt[1:]}.")
    control = comparison[name].control
    return Finding(name, control, tone, contrast.answer, tuple(sentences), contrast.strong_gain)


def _reason(comparison: Comparison, name: str) -> list[str]:
    """Return the sentences about why a curriculum pays that the verdict does not hold."""
    reason, cheaper = comparison.reasons[name], comparison.cheaper_way(name)
    found = [f"{cheaper[0].upper()}{cheaper[1:]}."] if cheaper else []
    if reason.why in ("level", "mostly level") and reason.share < 1:
        found.append(f"At most {reason.share:.0%} of its gain is by what it knows.")
    if open_ := not_asked([reason]):
        found.append(f"{open_[0].upper()}{open_[1:]}.")
    return found


def _reached(comparison: Comparison, row: dict[str, Any], scratch: dict[str, Any]) -> str:
    """Return the sentence about the threshold."""
    threshold, seeds = rounded(comparison.threshold), comparison.seeds
    if not row["reached"] and not scratch["reached"]:
        return f"Neither it nor scratch reaches {threshold} in any seed."

    def when(one: dict[str, Any]) -> str:
        if not one["reached"]:
            return "in no seed"
        some = f" in {one['reached']} of {counted(seeds, 'seed')}" if one["reached"] < seeds else ""
        bound = "at least " if some else ""
        return f"after {bound}{one['steps_to_threshold']:,.0f} steps on average{some}"

    return f"Reaches {threshold} {when(row)}; scratch {when(scratch)}."


def too_few(comparison: Comparison) -> str:
    """Return why no difference could have been shown; empty if one could.

    The smallest p value of a sign-flip test depends on the number of seeds alone.
    """
    few = [one for one in comparison.verdicts.values() if one.withheld]
    if not few or comparison.interim:
        return ""
    if comparison.seeds == 1:
        return "One seed allows neither intervals nor tests."
    arms = len(few)
    least = min(1.0, arms * comparison.looks.adjusted_p(smallest_p(comparison.seeds)))
    return (
        f"{comparison.seeds} seeds are too few for any verdict: with {arms} "
        f"curricul{'a' if arms > 1 else 'um'} to test, no p value can be below {least:.2g}; "
        f"{few[0].needed} seeds or more are needed."
    )


def forest(found: Sequence[Finding]) -> tuple[float, dict[str, tuple[float, float, float]]]:
    """Return the places of 0 and of each gain's low, estimate and high on one axis, in percent."""
    ends: dict[str, list[float]] = {}
    for one in found:
        middle = float(one.gain.estimate)
        low, high = (float(end) for end in (one.gain.low, one.gain.high))
        ends[one.arm] = [middle if math.isnan(low) else low, middle, max(middle, high)]
    marks = [0.0, *(value for values in ends.values() for value in values)]
    low, width = min(marks), (max(marks) - min(marks)) or 1.0
    places = {arm: [100 * (value - low) / width for value in ends[arm]] for arm in ends}
    return 100 * -low / width, {arm: (a, b, c) for arm, (a, b, c) in places.items()}


def table(comparison: Comparison) -> dict[str, dict[str, Cell]]:
    """Return the metrics of :meth:`Comparison.rows` as text: arm -> column -> entry.

    Columns are those of `MEASURES`, and ``time``, ``p`` and ``source_steps``.
    """
    found = {}
    for row in comparison.rows():
        name, missed = row["arm"], row["seeds"] - row["reached"]
        cells = {measure: _measured(comparison, row, measure) for measure in MEASURES}
        cells["time"] = Cell(
            "> " * (missed > 0) + f"{row['steps_to_threshold']:,.0f}",
            f"{missed} of {row['seeds']} never" if missed else "",
        )
        p = row["adjusted_p"]
        tested = name in comparison.verdicts and not comparison.withheld
        cells["p"] = Cell(f"{p:.2g}" if tested else "")
        cells["source_steps"] = Cell(f"{row['source_steps']:,.0f}")
        found[name] = cells
    return found


def signed(interval: Interval) -> str:
    """Return an interval without its seeds, with a sign and no-break spaces."""
    sign = "+" * (float(interval.estimate) > 0)
    return (sign + without_seeds(interval)).replace(" ", "\xa0")


def _measured(comparison: Comparison, row: dict[str, Any], measure: str) -> Cell:
    numbers = (row[measure], row[f"{measure}_low"], row[f"{measure}_high"])
    if math.isnan(numbers[0]):
        return Cell("")
    text, _, bounds = without_seeds(Interval(*numbers, 0.95, row["seeds"])).partition(" ")
    if measure not in TIMED:
        return Cell(text, bounds)
    arm, scratch = (
        comparison.times(name, strong=measure not in WEAK).reached
        for name in (row["arm"], comparison.best_scratch)
    )
    if not arm.any() and not scratch.any():
        return Cell("–", "never reached")
    return Cell(text, bounds)


def _count(found: list[str], own: list[str]) -> str:
    if len(own) == 1:
        return "the curriculum"
    if len(found) == len(own) == 2:
        return "both curricula"
    return f"all {len(own)} curricula" if len(found) == len(own) else f"{len(found)} of {len(own)}"


# -- The forecast of each curriculum next to what was measured, and whether its shaping is safe ----


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
    def same_sources(self) -> tuple[str, ...]:
        """The arms that train their sources as the forecast assumes."""
        return tuple(arm for arm in self.record.arms if arm not in self.other_sources)

    def starts(self, potential: str) -> str:
        """Return the measured starts of the arms with a potential, in words."""
        arms = self.used.get(potential, ())
        words = [
            "guarded" if (start := self.measured[arm]) is None else rounded(start) for arm in arms
        ]
        return ", ".join(dict.fromkeys(words) if {*words} == {"guarded"} else words)


def forecast_sections(
    analysis: Analysis,
    curricula: CurriculaRecord,
    learnt: Mapping[str, Mapping[str, LearningResult]],
) -> tuple[ForecastSection, ...]:
    """Return the sections of an analysis, with what was measured."""
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


# -- The section of a page on a sweep or a tuning: what was tried, what was best, main effects -----

NONE = "–"


@dataclass(frozen=True)
class EffectsSection:
    """What a sweep or a tuning shows."""

    effects: Effects
    rows: tuple[tuple[str, ...], ...]
    """Main effects: arm, setting, value, number of trials or arms, mean return, and its bounds."""
    # Of a tuning, the best of each arm: arm, trials, steps, mean return, and the settings.
    best: tuple[tuple[str, ...], ...]
    words: str  # on the tuning's seeds and steps


def effects_sections(
    found: Sequence[Effects], tuning: TuningRecord | None
) -> tuple[EffectsSection, ...]:
    """Return the sections of a page on a sweep and on a tuning, those that there are."""
    return tuple(
        EffectsSection(
            one,
            tuple(
                (
                    *(arm, key, minus(level.text), f"{level.number}", minus(short(level.mean))),
                    f"[{minus(short(level.low))}, {minus(short(level.high))}]",
                )
                for arm, key, level in one.rows
            ),
            () if one.kind == "sweep" or tuning is None else _best(tuning),
            "" if one.kind == "sweep" or tuning is None else _words(tuning),
        )
        for one in found
    )


def _best(tuning: TuningRecord) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (
            *(name, f"{len(arm.trials)}", f"{tuning.steps(name):,}"),
            NONE if arm.best.score is None else minus(short(arm.best.score)),
            *(_value(arm.best.values.get(key)) for key in tuning.space),
        )
        for name, arm in tuning.arms.items()
    )


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
