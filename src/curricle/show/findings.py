"""The text and tables of a page: findings, forecast, and main effects of sweeps and tunings."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup

from curricle.comparison.comparison import ARM_MEASURES, Comparison
from curricle.comparison.verdicts import not_known
from curricle.show.graph import Learnt
from curricle.show.style import minus, rounded, without_seeds
from curricle.statistics.curves import SCRATCH
from curricle.statistics.intervals import Interval
from curricle.study.record import Analysis, CurriculaRecord, TunedRecord
from curricle.study.tuning import Level, short
from curricle.study_file.vary import value_text
from curricle.text import counted

Row = Mapping[str, Any]  # of :meth:`Comparison.rows`

# -- the findings of a comparison in sentences -----------------------------------------------------


@dataclass(frozen=True)
class Finding:
    """The finding about an arm."""

    arm: str
    control: bool
    tone: str  # "pays", "costs" or "open"
    verdict: str
    sentences: tuple[str, ...]
    gain: Interval  # of strong transfer, in return


def headline(comparison: Comparison) -> str:
    """Return sentences on which curricula paid, or why there is no verdict."""
    warning = comparison.nothing_learnt
    return _paid(comparison) + (warning and f" {_sentence(warning)}")


def _paid(comparison: Comparison) -> str:
    verdicts = comparison.verdicts
    if comparison.withheld:
        return _sentence(comparison.withheld)
    paid = [name for name, verdict in verdicts.items() if verdict.direction > 0]
    harmed = [name for name, verdict in verdicts.items() if verdict.direction < 0]
    open_ = len(verdicts) - len(paid) - len(harmed)
    if open_ and not paid and not harmed:
        return "No curriculum is shown to differ from its opponents."
    counts = [
        f"{_count(names, len(verdicts))} {verbs[len(names) > 1]}"
        for names, verbs in (
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
    rival = f"the best opponent, {comparison.best_opponent(most)}"
    if comparison.best_opponent(most) == SCRATCH:
        rival = "learning from scratch"
    # Why curricula pay, where controls tell: a sentence for each reason.
    reasons: dict[str, list[str]] = {}
    for name, reason in comparison.reasons.items():
        if reason.words:
            reasons.setdefault(reason.words, []).append(name)
    why = [" " + _sentence(f"{reason}: {', '.join(names)}") for reason, names in reasons.items()]
    if len(verdicts) == 1:
        why = [f" It pays {reason}." for reason in reasons]
    return (
        f"{_sentence(', '.join(counts), ':')} {leading}{signed(gains[most])} mean return against "
        f"{rival}, source steps counted, over {counted(comparison.seeds, 'seed')}."
        f"{''.join(why)}"
    )


def _sentence(text: str, end: str = ".") -> str:
    return f"{text[0].upper()}{text[1:]}{end}"


def _count(names: list[str], all_: int) -> str:
    if all_ == 1:
        return "the curriculum"
    if len(names) == all_ == 2:
        return "both curricula"
    return f"all {all_} curricula" if len(names) == all_ else f"{len(names)} of {all_}"


def signed(interval: Interval) -> str:
    """Return an interval without its seeds, with a sign and no-break spaces."""
    sign = "+" * (float(interval.estimate) > 0)
    return (sign + without_seeds(interval)).replace(" ", "\xa0")


def findings(comparison: Comparison) -> tuple[Finding, ...]:
    """Return the finding about each arm that does not learn from scratch, in order."""
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
        _reached(comparison, row, rows[row["against"]]),
    ]
    remarks = [*map(comparison.cluster_sentence, (name, row["against"]))]
    if name in comparison.control_verdicts:
        remarks.append(comparison.control_sentence(name).removeprefix(f"{name} "))
    if name in comparison.verdicts:
        remarks.append(not_known([comparison.reasons[name]]))
    sentences += map(_sentence, filter(None, (*remarks, row["unlearnt"])))
    control = comparison[name].control
    return Finding(name, control, tone, contrast.answer, tuple(sentences), contrast.strong_gain)


def _reached(comparison: Comparison, row: Row, rival: Row) -> str:
    threshold, seeds = rounded(comparison.threshold), comparison.seeds
    if not row["reached"] and not rival["reached"]:
        return f"Neither it nor {rival['arm']} reaches {threshold} in any seed."

    def when(row: Row) -> str:
        if not row["reached"]:
            return "in no seed"
        some = f" in {row['reached']} of {counted(seeds, 'seed')}" if row["reached"] < seeds else ""
        bound = "at least " if some else ""
        return f"after {bound}{row['steps_to_threshold']:,.0f} steps on average{some}"

    return f"Reaches {threshold} {when(row)}; {rival['arm']} {when(rival)}."


def forest(answers: Sequence[Finding]) -> tuple[float, dict[str, list[float]]]:
    """Return the positions of 0 and each gain's low, estimate and high, in percent of an axis."""
    gains = [finding.gain for finding in answers]
    low, middle, high = np.array([(g.low, g.estimate, g.high) for g in gains], float).T
    # One seed has no interval.
    ends = np.stack([np.where(np.isnan(low), middle, low), middle, np.fmax(middle, high)], axis=1)
    least = min(0.0, float(ends.min()))
    width = (max(0.0, float(ends.max())) - least) or 1.0
    percent = (100 * (ends - least) / width).tolist()
    arms = [finding.arm for finding in answers]
    return 100 * (0.0 - least) / width, dict(zip(arms, percent, strict=True))


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
    arms = (row["arm"], row["against"] or SCRATCH)
    if cell.text and not any(comparison.times(arm, strong=strong).reached.any() for arm in arms):
        return Cell("–", "never reached")
    return cell


def _steps(measure: str, comparison: Comparison, row: Row) -> Cell:
    missed = (row["seeds"] - row["reached"]) * (measure == "steps_to_threshold")
    below = f"{missed} of {row['seeds']} never" if missed else ""
    return Cell("> " * (missed > 0) + f"{row[measure]:,.0f}", below)


def _p(measure: str, comparison: Comparison, row: Row) -> Cell:
    tested = row["arm"] in comparison.verdicts and not comparison.withheld
    return Cell(f"{row[measure]:.2g}" if tested else "")


class Column(NamedTuple):
    """A column of the table: a new one is a row of `COLUMNS`, which the page loops over."""

    head: str
    meaning: str  # below the table; with {threshold} and {window} of the comparison
    cell: Callable[[str, Comparison, Row], Cell]  # of the column's key
    transfer: str = STRONG  # the kind that it belongs to; empty where it is neither


TIME = (
    "total steps to a return of {threshold}, smoothed over {window} checkpoints; a seed that never "
    "reaches it counts with all its steps, hence >; so it does in steps saved"
)
CHANCE = "probability that a run has a higher mean return than a run of the best opponent"
SAVED = "steps to the threshold within the budget, fewer than by the best opponent"
ABOVE = "above that of the best opponent"
COLUMNS = {
    "strong_gain": Column("gain", f"mean return over all steps, {ABOVE}", _interval),
    "adjusted_p": Column("p", "two-sided, of no gain, adjusted for the number of curricula", _p),
    "probability_of_improvement": Column("P(improve&shy;ment)", CHANCE, _interval),
    "asymptotic_gain": Column(
        "asymp&shy;totic gain", f"return at the end of all steps, {ABOVE}", _interval
    ),
    **{key: Column(made.head, made.meaning, _interval) for key, made in ARM_MEASURES.items()},
    "steps_to_threshold": Column("steps to threshold", TIME, _steps),
    "strong_steps_saved": Column("steps saved", SAVED, _saved),
    "weak_gain": Column("gain", f"mean return over target steps, {ABOVE}", _interval, WEAK),
    "jumpstart": Column("jumpstart", f"return at the first target step, {ABOVE}", _interval, WEAK),
    "weak_steps_saved": Column("steps saved", f"target {SAVED}", _saved, WEAK),
    "source_steps": Column("source steps", "steps in the sources, mean over seeds", _steps, ""),
}
"""Key in :meth:`Comparison.rows` -> its column."""


def table(comparison: Comparison) -> dict[str, dict[str, Cell]]:
    """Return the entries of the table: arm -> column -> entry."""
    return {
        row["arm"]: {key: column.cell(key, comparison, row) for key, column in COLUMNS.items()}
        for row in comparison.rows()
    }


def meanings(comparison: Comparison) -> list[tuple[str, str]]:
    """Return the name and the meaning of each column."""
    why = f" ({comparison.threshold_from})" * bool(comparison.threshold_from)
    terms = {"threshold": rounded(comparison.threshold) + why, "window": comparison.window}
    weak = {key: " (weak)" * (column.transfer == WEAK) for key, column in COLUMNS.items()}
    return [
        (column.head.replace("&shy;", "") + weak[key], column.meaning.format(**terms))
        for key, column in COLUMNS.items()
    ]


# -- the forecast of each curriculum next to what was measured -------------------------------------


def forecast_sections(
    analysis: Analysis, curricula: CurriculaRecord, learnt: Learnt
) -> list[Mapping[str, Any]]:
    """Return forecasts and certificates of arms with the same graph, with the measured starts."""
    sections = list[Mapping[str, Any]]()
    for record in analysis.sections:
        if not set(record.arms) <= curricula.arms.keys():
            continue
        names = [] if record.forecast is None else [row.name for row in record.forecast.rows]
        used: dict[str, list[str]] = {}  # a row of the forecast -> the arms with that potential
        measured: dict[str, str] = {}  # arm -> mean return at the first target step
        sources = {
            arm: [(name, node.key, node.settings) for name, node in graph.nodes.items()][:-1]
            for arm, graph in curricula.arms.items()
        }
        # The forecast assumes the sources of the first arm.
        same = [arm for arm in record.arms if sources[arm] == sources[record.arms[0]]]
        for arm in record.arms:
            if curricula.arms[arm].potential in names and arm in same:
                used.setdefault(curricula.arms[arm].potential, []).append(arm)
            *_, target = learnt[arm].values()
            shared = np.isfinite(target.source_share[:, 0]).any()  # it begins without phi
            start = target.greedy_return[:, 0].mean()
            measured[arm] = "portfolio" if shared else rounded(float(start))
        starts = {name: [measured[arm] for arm in arms] for name, arms in used.items()}
        for name, texts in starts.items():
            if {*texts} == {"portfolio"}:
                starts[name] = ["portfolio"]
        other = [arm for arm in record.arms if arm not in same]
        section = {"record": record, "used": used, "starts": starts}
        sections.append({**section, "same_sources": same, "other_sources": other})
    return sections


# -- what was swept or tuned: what was tried, what was best, main effects --------------------------

Texts = list[tuple[str, ...]]


def effects_rows(effects: Sequence[Level]) -> Texts:
    """Return the rows of the table of a sweep."""
    rows: Texts = []
    for name, key, text, number, *ends in effects:
        mean, low, high = (minus(short(end)) for end in ends)
        both = "" if np.isnan(ends[1]) else Markup("<small>[{}, {}]</small>").format(low, high)
        with_ends = Markup("{}{}").format(mean, both)
        rows.append((name, key, text, f"{number}", with_ends))
    return rows


def tuning_rows(tuned: TunedRecord | None) -> list[Sequence[str]]:
    """Return the heads and the rows of the table of the best trials; none without a tuning."""
    if tuned is None:
        return []
    keys = dict.fromkeys(key for arm in tuned.arms.values() for key in arm.values)
    rows: list[Sequence[str]] = [("best of", "trials", "tuning steps", "mean return", *keys)]
    for name, arm in tuned.arms.items():
        spent = f"{arm.trials}", f"{tuned.steps(name):,}"
        rows.append((name, *spent, *map(_value, (arm.score, *map(arm.values.get, keys)))))
    return rows


def _value(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, int) and not isinstance(value, bool):
        return minus(f"{value:,}")
    return minus(short(value)) if isinstance(value, float) else value_text(value)
