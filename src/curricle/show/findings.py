"""The sections of a page in words and numbers: findings, forecast, and what was swept or tuned."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from curricle.comparison.comparison import Comparison
from curricle.comparison.verdicts import not_asked
from curricle.show.graph import Learnt
from curricle.show.style import minus, rounded, without_seeds
from curricle.statistics.hypothesis_tests import smallest_p
from curricle.statistics.intervals import Interval
from curricle.study.record import Analysis, CurriculaRecord, SectionRecord
from curricle.study.tuning import Effects, TuningRecord, short
from curricle.study.vary import value_text
from curricle.text import counted

Row = Mapping[str, Any]  # of :meth:`Comparison.rows`

# -- the findings of a comparison in sentences -----------------------------------------------------


@dataclass(frozen=True)
class Finding:
    """The finding about one arm."""

    arm: str
    control: bool
    tone: str  # "pays", "costs" or "open"
    verdict: str
    sentences: tuple[str, ...]
    gain: Interval  # of strong transfer, in return


def headline(comparison: Comparison) -> str:
    """Return the comparison in a sentence: which curricula paid, or why there is no verdict."""
    verdicts = comparison.verdicts
    if comparison.withheld:
        return _sentence(comparison.withheld)
    paid = [name for name, verdict in verdicts.items() if verdict.direction > 0]
    harmed = [name for name, verdict in verdicts.items() if verdict.direction < 0]
    open_ = len(verdicts) - len(paid) - len(harmed)
    if open_ and not paid and not harmed:
        return "No curriculum is shown to differ from learning the target from scratch."
    counts = [
        f"{_count(names, len(verdicts))} {words[len(names) > 1]}"
        for names, words in (
            (paid, ("pays for itself", "pay for themselves")),
            (harmed, ("costs more than it brings", "cost more than they bring")),
        )
        if names
    ]
    if open_:
        counts.append(f"{open_} show{'s' * (open_ == 1)} no difference")
    gains = {name: comparison.contrasts[name].strong_gain for name in paid or harmed}
    most = max(gains, key=lambda name: abs(float(gains[name].estimate)))
    leading = f"{most} most, " * (len(gains) > 1) or f"{most}, " * (len(verdicts) > 1)
    rival = "learning from scratch"
    if len(comparison.scratches) > 1:
        rival = f"the best learner from {comparison.best_scratch}"
    return (
        f"{_sentence(', '.join(counts), ':')} {leading}{signed(gains[most])} mean return against "
        f"{rival}, source steps counted, over {counted(comparison.seeds, 'seed')}."
        f"{_why(comparison)}"
    )


def _sentence(words: str, end: str = ".") -> str:
    return f"{words[0].upper()}{words[1:]}{end}"


def _count(names: list[str], all_: int) -> str:
    if all_ == 1:
        return "the curriculum"
    if len(names) == all_ == 2:
        return "both curricula"
    return f"all {all_} curricula" if len(names) == all_ else f"{len(names)} of {all_}"


def _why(comparison: Comparison) -> str:
    """Return why those curricula pay that were asked, a sentence for each reason."""
    by_words: dict[str, list[str]] = {}
    for name, reason in comparison.reasons.items():
        if reason.words:
            by_words.setdefault(reason.words, []).append(name)
    if len(comparison.verdicts) == 1:
        return "".join(f" It pays {words}." for words in by_words)
    reasons = (f"{words}: {', '.join(names)}" for words, names in by_words.items())
    return "".join(f" {_sentence(reason)}" for reason in reasons)


def signed(interval: Interval) -> str:
    """Return an interval without its seeds, with a sign and no-break spaces."""
    sign = "+" * (float(interval.estimate) > 0)
    return (sign + without_seeds(interval)).replace(" ", "\xa0")


def findings(comparison: Comparison) -> tuple[Finding, ...]:
    """Return the finding about each arm besides those from scratch, in their order."""
    rows = {row["arm"]: row for row in comparison.rows()}
    return tuple(_finding(comparison, name, rows) for name in comparison.contrasts)


def _finding(comparison: Comparison, name: str, rows: Mapping[str, Row]) -> Finding:
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
    sentences += [_sentence(words) for words in apart if words]
    if name in comparison.control_verdicts:
        words = comparison.control_sentence(name).removeprefix(f"{name} ")
        sentences.append(_sentence(words))
    if name in comparison.verdicts:
        # Why a curriculum pays, as far as the verdict does not say it.
        reason, cheaper = comparison.reasons[name], comparison.cheaper_way(name)
        if cheaper:
            sentences.append(_sentence(cheaper))
        if reason.why in ("level", "mostly level") and reason.share < 1:
            sentences.append(f"At most {reason.share:.0%} of its gain is by what it knows.")
        if open_ := not_asked([reason]):
            sentences.append(_sentence(open_))
    if row["unlearnt"]:
        sentences.append(_sentence(row["unlearnt"]))
    control = comparison[name].control
    return Finding(name, control, tone, contrast.answer, tuple(sentences), contrast.strong_gain)


def _reached(comparison: Comparison, row: Row, scratch: Row) -> str:
    threshold, seeds = rounded(comparison.threshold), comparison.seeds
    if not row["reached"] and not scratch["reached"]:
        return f"Neither it nor scratch reaches {threshold} in any seed."

    def when(row: Row) -> str:
        if not row["reached"]:
            return "in no seed"
        some = f" in {row['reached']} of {counted(seeds, 'seed')}" if row["reached"] < seeds else ""
        bound = "at least " if some else ""
        return f"after {bound}{row['steps_to_threshold']:,.0f} steps on average{some}"

    return f"Reaches {threshold} {when(row)}; scratch {when(scratch)}."


def too_few(comparison: Comparison) -> str:
    """Return why no difference could have been shown; empty if one could."""
    few = [verdict for verdict in comparison.verdicts.values() if verdict.withheld]
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


def forest(answers: Sequence[Finding]) -> tuple[float, dict[str, tuple[float, float, float]]]:
    """Return the places of 0 and of each gain's low, estimate and high on an axis, in percent."""
    ends: dict[str, tuple[float, float, float]] = {}
    for finding in answers:
        low, middle, high = map(float, (finding.gain.low, finding.gain.estimate, finding.gain.high))
        ends[finding.arm] = (middle if math.isnan(low) else low, middle, max(middle, high))
    marks = [0.0, *(mark for triple in ends.values() for mark in triple)]
    least, width = min(marks), (max(marks) - min(marks)) or 1.0

    def percent(mark: float) -> float:
        return 100 * (mark - least) / width

    return percent(0.0), {
        arm: (percent(a), percent(b), percent(c)) for arm, (a, b, c) in ends.items()
    }


# -- the table of all measures ---------------------------------------------------------------------

STRONG, WEAK = "strong transfer (source steps count)", "weak transfer (target steps only)"


class Cell(NamedTuple):
    """An entry of the table: its text, and below that its interval or a note."""

    text: str
    below: str = ""


def _interval(measure: str, comparison: Comparison, row: Row) -> Cell:
    numbers = (row[measure], row[f"{measure}_low"], row[f"{measure}_high"])
    if math.isnan(numbers[0]):
        return Cell("")
    text, _, bounds = without_seeds(Interval(*numbers, 0.95, row["seeds"])).partition(" ")
    return Cell(text, bounds)


def _saved(measure: str, comparison: Comparison, row: Row) -> Cell:
    cell, strong = _interval(measure, comparison, row), measure.startswith("strong")
    arms = (row["arm"], comparison.best_scratch)
    if cell.text and not any(comparison.times(arm, strong=strong).reached.any() for arm in arms):
        return Cell("–", "never reached")
    return cell


def _time(measure: str, comparison: Comparison, row: Row) -> Cell:
    missed = row["seeds"] - row["reached"]
    below = f"{missed} of {row['seeds']} never" if missed else ""
    return Cell("> " * (missed > 0) + f"{row[measure]:,.0f}", below)


def _p(measure: str, comparison: Comparison, row: Row) -> Cell:
    tested = row["arm"] in comparison.verdicts and not comparison.withheld
    return Cell(f"{row[measure]:.2g}" if tested else "")


def _whole(measure: str, comparison: Comparison, row: Row) -> Cell:
    return Cell(f"{row[measure]:,.0f}")


class Column(NamedTuple):
    """A column of the table: a new measure is a row of `COLUMNS`, which the page loops over."""

    head: str
    meaning: str  # below the table; with {threshold} and {window} of the comparison
    cell: Callable[[str, Comparison, Row], Cell]  # of the column's key
    transfer: str = STRONG  # the kind that it belongs to; empty where it is neither


TIME = (
    "total steps to a return of {threshold}, smoothed over {window} checkpoints; a seed that never "
    "reaches it counts with all its steps, hence >; so it does in steps saved"
)
CHANCE = "probability that a run has a higher mean return than a run from scratch"
SAVED = "steps to the threshold within the budget, fewer than from scratch"
ABOVE = "above that of scratch"
COLUMNS = {
    "strong_gain": Column("gain", f"mean return over all steps, {ABOVE}", _interval),
    "adjusted_p": Column("p", "two-sided, of no gain, adjusted for the number of curricula", _p),
    "probability_of_improvement": Column("P(improve&shy;ment)", CHANCE, _interval),
    "asymptotic_gain": Column(
        "asymp&shy;totic gain", f"return at the end of all steps, {ABOVE}", _interval
    ),
    "mean_return": Column("mean return", "mean height of the curve over all steps", _interval),
    "steps_to_threshold": Column("steps to threshold", TIME, _time),
    "strong_steps_saved": Column("steps saved", SAVED, _saved),
    "weak_gain": Column("gain", f"mean return over target steps, {ABOVE}", _interval, WEAK),
    "jumpstart": Column("jumpstart", f"return at the first target step, {ABOVE}", _interval, WEAK),
    "weak_steps_saved": Column("steps saved", f"target {SAVED}", _saved, WEAK),
    "source_steps": Column("source steps", "steps in the sources, mean over seeds", _whole, ""),
}
"""Key in :meth:`Comparison.rows` -> its column."""


def table(comparison: Comparison) -> dict[str, dict[str, Cell]]:
    """Return the entries of the table: arm -> column -> entry."""
    return {
        row["arm"]: {key: column.cell(key, comparison, row) for key, column in COLUMNS.items()}
        for row in comparison.rows()
    }


def meanings(comparison: Comparison) -> list[tuple[str, str]]:
    """Return the name of each column, and what it means."""
    why = f" ({comparison.threshold_from})" * bool(comparison.threshold_from)
    terms = {"threshold": rounded(comparison.threshold) + why, "window": comparison.window}
    return [
        (
            column.head.replace("&shy;", "") + " (weak)" * (column.transfer == WEAK),
            column.meaning.format(**terms),
        )
        for column in COLUMNS.values()
    ]


# -- the forecast of each curriculum next to what was measured -------------------------------------


@dataclass(frozen=True)
class ForecastSection:
    """The forecast and certificates of arms with the same graph."""

    record: SectionRecord
    used: Mapping[str, tuple[str, ...]]  # name of a forecast row -> the arms with that potential
    # Arm -> mean greedy return at the first target step; None where a guard begins without phi.
    measured: Mapping[str, float | None]
    other_sources: tuple[str, ...] = ()  # arms to which the forecast does not apply

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
    analysis: Analysis, curricula: CurriculaRecord, learnt: Learnt
) -> tuple[ForecastSection, ...]:
    """Return the sections of an analysis, with what was measured."""
    known = [record for record in analysis.sections if set(record.arms) <= curricula.arms.keys()]
    return tuple(_section(record, curricula, learnt) for record in known)


def _section(record: SectionRecord, curricula: CurriculaRecord, learnt: Learnt) -> ForecastSection:
    names = [] if record.forecast is None else [row.name for row in record.forecast.rows]
    used: dict[str, tuple[str, ...]] = {}
    measured: dict[str, float | None] = {}
    sources = {
        arm: [(name, node.key, node.settings) for name, node in curricula.arms[arm].nodes.items()]
        for arm in record.arms
    }
    first = sources[record.arms[0]][:-1]  # without the target
    other_sources = tuple(arm for arm in record.arms if sources[arm][:-1] != first)
    for arm in record.arms:
        potential = curricula.arms[arm].potential
        if potential in names and arm not in other_sources:
            used[potential] = (*used.get(potential, ()), arm)
        *_, target = learnt[arm].values()
        guarded = np.isfinite(target.guard_share[:, 0]).any()
        measured[arm] = None if guarded else float(target.greedy_return[:, 0].mean())
    return ForecastSection(record, used, measured, other_sources)


# -- what was swept or tuned: what was tried, what was best, main effects --------------------------

Texts = list[tuple[str, ...]]


def effects_sections(
    effects: Sequence[Effects], tuning: TuningRecord | None
) -> list[tuple[Effects, Texts, Texts]]:
    """Return for a sweep and for a tuning, where there are any, the rows of their tables."""
    best: Texts = []
    if tuning is not None:
        for name, arm in tuning.arms.items():
            spent = f"{len(arm.trials)}", f"{tuning.steps(name):,}"
            values = [_value(arm.best.values.get(key)) for key in tuning.space]
            best.append((name, *spent, _value(arm.best.score), *values))
    return [
        (
            kind,
            [
                (
                    *(arm, key, minus(text), f"{number}", minus(short(mean))),
                    f"[{minus(short(low))}, {minus(short(high))}]",
                )
                for arm, key, text, number, mean, low, high in kind.levels
            ],
            best if kind.kind != "sweep" else [],
        )
        for kind in effects
    ]


def _value(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, int) and not isinstance(value, bool):
        return minus(f"{value:,}")
    return minus(short(value) if isinstance(value, float) else value_text(value))
