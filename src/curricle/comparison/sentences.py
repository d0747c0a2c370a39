"""What is said of compared arms: columns of tables, sentences, findings, and words on figures.

Every fact has its words here and nowhere else. Tables are printed, drawn on the page of a study,
and returned as data (:meth:`Comparison.rows`); pages and figures put a minus sign for the hyphen.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from curricle.comparison.measures import (
    MEASURES,
    NAN,
    NO_CONTRAST,
    STATED,
    UNKNOWN,
    MeasuredArms,
)
from curricle.comparison.verdicts import (
    ASKING,
    NOT_KNOWN,
    SIGNIFICANT,
    Verdict,
    difference,
    seeds_to_show,
    steps_saved_share,
)
from curricle.learning.learners import OptimisticQLearning
from curricle.statistics.curves import ROUNDING, SCRATCH
from curricle.statistics.intervals import Interval, clusters, interquartile_interval
from curricle.text import counted, minus, or_dash, rounded

Row = Mapping[str, Any]  # of :func:`table_rows`


def short(interval: Interval) -> str:
    """Return an interval without its number of seeds; a dash if there is none."""
    return "-" if np.isnan(interval.estimate) else str(interval).rsplit(",", 1)[0]


def columns_of(key: str, interval: Interval) -> dict[str, float]:
    """Return an interval as columns of a row: name, name_low, name_high."""
    numbers = {"": interval.estimate, "_low": interval.low, "_high": interval.high}
    return {f"{key}{end}": float(number) for end, number in numbers.items()}


def interval_of(key: str, row: Row) -> Interval:
    """Return the interval that :func:`columns_of` wrote into a row."""
    return Interval(row[key], row[f"{key}_low"], row[f"{key}_high"], 0.95, row["seeds"])


def signed(interval: Interval) -> str:
    """Return an interval without its seeds, with a sign and no-break spaces."""
    return "+" * (float(interval.estimate) > 0) + minus(short(interval)).replace(" ", "\xa0")


# -- The table of arms -----------------------------------------------------------------------------

STRONG, WEAK = "strong transfer (source steps count)", "weak transfer (target steps only)"


class Column(NamedTuple):
    """A column of the table of arms; a new one is a row of `COLUMNS`."""

    head: str  # on the page
    meaning: str
    text: Callable[[str, MeasuredArms, Row], str]  # of the column's key
    transfer: str = STRONG  # the kind that it belongs to; empty where it is neither
    printed: str = ""  # head in the printed table; empty if it is not there
    # The measure of the arm with a name, for columns that no contrast has.
    of: Callable[[MeasuredArms, str], Interval] | None = None


def _interval(key: str, arms: MeasuredArms, row: Row) -> str:
    if COLUMNS[key].of is None and row["arm"] not in arms.contrasts:
        return ""
    return short(interval_of(key, row))


def _saved(key: str, arms: MeasuredArms, row: Row) -> str:
    text, both = _interval(key, arms, row), (row["arm"], row["against"])
    reached = any(arms.times(arm, strong=False).reached.any() for arm in both if arm)
    return text if reached or arms.nobody or not text else "never reached"


def _time(key: str, arms: MeasuredArms, row: Row) -> str:
    if np.isnan(arms.threshold):
        return "-"
    missed = row["seeds"] - row["reached"]
    return f"> {row[key]:,.0f} ({missed} never)" if missed else _steps(key, arms, row)


def _steps(key: str, arms: MeasuredArms, row: Row) -> str:
    return f"{row[key]:,.0f}"


def _p(key: str, arms: MeasuredArms, row: Row) -> str:
    tested = row["arm"] in arms.verdicts and not arms.withheld
    return f"{row[key]:.2g}" if tested else ""


ABOVE, FEWER = "above the best opponent's", "steps to the threshold, fewer than the best opponent's"
COLUMNS = {
    "strong_gain": Column(
        "gain",
        f"mean return over all steps, sources charged, {ABOVE}",
        _interval,
        STRONG,
        "strong gain",
    ),
    "adjusted_p": Column("p", "two-sided, of no gain, adjusted for the number of curricula", _p),
    "probability_of_improvement": Column(
        "P(improve&shy;ment)", f"probability that a run has a mean return {ABOVE}", _interval
    ),
    "asymptotic_gain": Column(
        "asymp&shy;totic gain", f"return at the end of all steps, {ABOVE}", _interval
    ),
    "mean_return": Column(
        "mean return",
        "the mean height of the learning curve: its area, divided by all steps",
        _interval,
        printed="mean return",
        of=MeasuredArms.mean_return,
    ),
    "steps_to_threshold": Column(
        "steps to threshold",
        "steps until the greedy return, smoothed, reaches the threshold, sources included; "
        '"> 1,000 (2 never)": 2 seeds do not get there and count with all their steps',
        _time,
        printed="steps to threshold",
    ),
    "share_of_steps_saved": Column(
        "share of steps saved",
        "of the steps to the threshold of the opponent that takes the fewest, sources charged",
        lambda key, arms, row: share_saved(arms, row["arm"]) if row["against"] else "",
    ),
    "weak_gain": Column(
        "gain",
        f"mean return over target steps, sources free, {ABOVE}",
        _interval,
        WEAK,
        "weak gain",
    ),
    "jumpstart": Column("jumpstart", f"return at the first target step, {ABOVE}", _interval, WEAK),
    "weak_steps_saved": Column("steps saved", f"target {FEWER}", _saved, WEAK),
    "source_steps": Column("source steps", "steps in the sources, mean over seeds", _steps, ""),
}
"""Key in :func:`table_rows` -> its column, in the page's order."""
FIRST, LAST = ("steps_to_threshold",), ("strong_gain", "weak_gain")
"""The columns that begin and that end the printed table, before the verdict."""
PRINTED = (
    *FIRST,
    *(key for key, column in COLUMNS.items() if column.printed and key not in (*FIRST, *LAST)),
    *LAST,
)
VERDICT, INTERVAL = "verdict", "[low, high]"
HEADS = ("", *(COLUMNS[key].printed for key in PRINTED), VERDICT)
EXPLAINED = {
    **{COLUMNS[key].printed: COLUMNS[key].meaning for key in FIRST},
    "threshold": "the return that counts as learnt; by default nine tenths of the way from the "
    "random policy's to the optimum",
    **{COLUMNS[key].printed: COLUMNS[key].meaning for key in PRINTED if key not in LAST},
    INTERVAL: "after a number: its interval of 95 % confidence over seeds",
    **{COLUMNS[key].printed: COLUMNS[key].meaning for key in LAST},
    VERDICT: "whether the arm gains more than each opponent, by a test over the seeds",
    "p =": "the probability of such a difference by chance, corrected for the number of arms",
}
"""Words of the printed table, and what each means."""


def table_rows(arms: MeasuredArms) -> list[dict[str, Any]]:
    """Return the table as data, as :meth:`Comparison.rows`."""
    table = list[dict[str, Any]]()
    for name, arm in arms.arms.items():
        times, contrast = arms.times(name), arms.contrasts.get(name, NO_CONTRAST)
        asked = arms.control_verdicts, arms.knowledge_verdicts
        over, by_knowledge = (None if arms.nobody else of.get(name) for of in asked)
        intervals = {
            "steps_to_threshold": UNKNOWN if arms.nobody else times.restricted_mean(),
            **{key: column.of(arms, name) for key, column in COLUMNS.items() if column.of},
            **{measure: getattr(contrast, measure) for measure in MEASURES},
            "gain_over_controls": UNKNOWN if over is None else over.gain,
            "gain_by_knowledge": UNKNOWN if by_knowledge is None else by_knowledge.gain,
        }
        row: dict[str, Any] = {
            "arm": name,
            "control": arm.control,
            "seeds": arms.seeds,
            "source_steps": float(arm.curve.source_steps.mean()),
            "reached": int(times.reached.sum()),
        }
        for measure, interval in intervals.items():
            row |= columns_of(measure, interval)
        for part in ("p", "adjusted_p", "verdict", "reason"):
            row[part] = getattr(contrast, part)
        row["unlearnt"] = unlearnt(arms, name)
        row["against"] = arms.best_opponent(name) if name in arms.contrasts else ""
        row["strongest_control"] = "" if over is None else over.rival
        row["beats_controls"] = "" if over is None else over.answer
        row["beats_controls_p"] = NAN if over is None else over.adjusted_p
        row["initial_value"] = NAN
        if arm.initial_values is not None:
            row["initial_value"] = float(arm.initial_values.mean())
        table.append(row)
    return table


def printed_rows(arms: MeasuredArms) -> list[tuple[str, ...]]:
    """Return the rows of the printed table: as many texts as `HEADS` has."""
    return [
        (
            f"{row['arm']}{_started(arms, row['arm'])}",
            *(COLUMNS[key].text(key, arms, row) for key in PRINTED),
            _verdict(arms, row),
        )
        for row in table_rows(arms)
        if row["arm"] in arms.shown
    ]


def _verdict(arms: MeasuredArms, row: Row) -> str:
    """Return an arm's verdict with its p-value and reason; or that it is the best opponent."""
    name, sure = row["arm"], _p("adjusted_p", arms, row)
    if name in arms.contrasts:
        verdict = row["verdict"] + (f" (p = {sure})" if sure else "")
        return f"{verdict}, {row['reason']}" if row["reason"] else verdict
    if name not in arms.best_opponents or len(arms.scratches) == 1 or arms.nobody:
        return ""
    if not arms.controls:
        return "the best learner"
    over = [arm for arm in arms.controls if arms.best_opponent(arm) == name]
    of = "" if len(over) == len(arms.controls) else f" of {', '.join(over)}"
    return f"the best opponent{of}: gains are over it"


class Cell(NamedTuple):
    """An entry of the page's table: its text, and below that its interval or a note."""

    text: str
    below: str = ""


def page_table(arms: MeasuredArms) -> dict[str, dict[str, Cell]]:
    """Return the entries of the page's table: arm -> column -> entry."""
    table = dict[str, dict[str, Cell]]()
    for row in table_rows(arms):
        texts = {key: minus(column.text(key, arms, row)) for key, column in COLUMNS.items()}
        parts = {key: re.split(r" (?=[\[(])", text, maxsplit=1) for key, text in texts.items()}
        table[row["arm"]] = {key: Cell(*part) for key, part in parts.items()}
    return table


def meanings(arms: MeasuredArms) -> list[tuple[str, str]]:
    """Return what the page says of its table: of the threshold, and of each column."""
    smoothed = f"curves are smoothed over {counted(arms.window, 'checkpoint')} to find it"
    columns = [
        (column.head.replace("&shy;", "") + " (weak)" * (column.transfer == WEAK), column.meaning)
        for column in COLUMNS.values()
    ]
    return [("threshold", f"{threshold_words(arms)}; {smoothed}"), *columns]


def threshold_words(arms: MeasuredArms) -> str:
    """Return the threshold and its source as text."""
    if arms.nobody:
        return f"none, as {arms.nobody}"
    source = f" ({arms.threshold_from})" * bool(arms.threshold_from)
    return f"{rounded(arms.threshold)}{source}"


# -- Sentences -------------------------------------------------------------------------------------


def title(arms: MeasuredArms) -> str:
    """Return the title of the printed table: target, total of steps, seeds and threshold."""
    return (
        f"{arms.target!r} in {arms.total:,} steps, sources charged, evaluations free; "
        f"{counted(arms.seeds, 'seed')}; threshold {or_dash(arms.threshold, '.4g')}"
        f"{arms.threshold_from and f' ({arms.threshold_from})'}"
    )


def lines_below(arms: MeasuredArms) -> list[str]:
    """Return what stands below the table: what was not learnt, controls, and clusters of seeds."""
    lines = [nothing_learnt(arms), best_learner(arms), _looks(arms), _other_opponents(arms)]
    lines += dict.fromkeys(headroom_sentence(arms, name) for name in arms.controls)
    lines += [saved_sentence(arms, name) for name in arms.controls]
    costly = (name for name, verdict in arms.verdicts.items() if verdict.direction < 0)
    lines += [f"instead of {name}, {instead(arms, name)}" for name in costly]
    lines += [cluster_sentence(arms, name) for name in arms.shown]
    of_controls = {} if arms.nobody else arms.control_verdicts
    lines += [_gains_more(name, verdict, "controls") for name, verdict in of_controls.items()]
    lines += [
        _gains_more(name, verdict, "placebos" + " and constants" * (not arms[name].network))
        for name, verdict in arms.knowledge_verdicts.items()
        if arms.verdicts[name].direction > 0
    ]
    lines += [unlearnt(arms, name) or _level_sentence(arms, name) for name in arms.controls]
    lines += [why_unknown(arms, list(arms.reasons)), *arms.remarks]
    return [line for line in dict.fromkeys(lines) if line]  # a placebo may be the only control


def why_unknown(arms: MeasuredArms, names: Sequence[str]) -> str:
    """Return a sentence on what tells why curricula pay; empty where it is known."""
    if all(arms.reasons[name].why != "not known" for name in names):
        return ""
    of_files = "a placebo: pretraining that teaches nothing"
    return f"{NOT_KNOWN} {of_files if arms.remarks else ASKING}"


def nothing_learnt(arms: MeasuredArms) -> str:
    """Return a sentence on arms that did not learn; empty if one reaches the threshold."""
    if arms.nobody:
        return (
            f"{arms.nobody}: no arm is above random play ({arms.reference.random_return:.4g}) by "
            "more than noise, so that there is no threshold and no gain; all need a larger budget, "
            "a learner that explores more, or an easier target"
        )
    reached = any(arms.times(name).reached.any() for name in arms.arms)
    if np.isnan(arms.threshold) or reached or arms.reference.nothing_to_learn:
        return ""
    lower = ", or a lower threshold" * (arms.threshold_from == STATED)
    return (
        f"no arm reaches the threshold of {arms.threshold:.4g} in any seed, so that the gains "
        f"are between arms that did not learn: all may need a larger budget{lower}"
    )


def best_learner(arms: MeasuredArms) -> str:
    """Return the verdict of arms without a source, which name the best learner; else empty."""
    if arms.controls or arms.nobody:
        return ""
    learner, written = without_source(arms, arms.baseline)
    in_file = f" (in a study file: {written.rstrip(', ')})" * bool(written and not arms.remarks)
    verdict = arms.best_learner
    sure = "" if verdict is None else f"; better than each other learner: {verdict}"
    if len(arms.arms) == 1:
        return "no arm has a source, and no other learner was compared: scratch_learners names more"
    return f"no arm has a source; the best learner without one is {learner}{in_file}{sure}"


def _looks(arms: MeasuredArms) -> str:
    """Return a sentence on verdicts before seeds were added; empty if there were none."""
    if not arms.earlier or arms.interim:
        return ""
    numbers = " and ".join(map(str, arms.earlier))
    return (
        f"seeds were added after verdicts with {numbers} seeds could be seen: "
        f"p values are multiplied by {len(arms.earlier) + 1}, the number of looks"
    )


def _other_opponents(arms: MeasuredArms) -> str:
    """Return a sentence on the constants that are not shown; empty if there are none."""
    others = [
        f"{name}{_started(arms, name)} {arms.returns[name].mean():.4g}"
        for name in arms.scratches
        if name not in arms.shown
    ]
    return f"mean return of other constants: {'; '.join(others)}" if others else ""


def headroom_sentence(arms: MeasuredArms, name: str) -> str:
    """Return a sentence on the most that an arm can gain; empty if that is unknown."""
    share, best, worst = arms.headroom(name), arms.reference.optimum, arms.reference.random_return
    if np.isnan(share) or best is None or worst is None or arms.nobody:
        return ""
    return (
        f"the best learner without a source, {without_source(arms, name)[0]}, leaves "
        f"{round(share, 3):g} of the way from random play to the optimum in this budget "
        f"({share * (best - worst):.3g} in mean return)"
        f"{': no source can gain more' * arms.reference.optimum_bounds}"
    )


def share_saved(arms: MeasuredArms, name: str, rival: str = "") -> str:
    """Return the share of an opponent's steps that an arm saves, by default the quickest's."""
    times = [arms.times(arm) for arm in (name, rival or arms.quickest_opponent(name))]
    arm_learnt, rival_learnt = (of.reached.all() for of in times)
    share = arms.contrasts[name].share_of_steps_saved
    if rival:
        share = steps_saved_share(times[0], times[1:])
    if np.isnan(share.estimate):
        return "-" if arms.nobody or arm_learnt else "unknown (seeds of both never get there)"
    least = share.estimate < 1 and not rival_learnt
    return "at most " * (not arm_learnt) + "at least " * bool(least) + short(share)


def saved_sentence(arms: MeasuredArms, name: str) -> str:
    """Return a sentence on the steps to the threshold that an arm saves; empty without any."""
    share, rival = share_saved(arms, name), arms.quickest_opponent(name)
    whose = (
        f"the quickest opponent's ({rival})" if arms.opponents(name)[1:] else f"those of {rival}"
    )
    sentence = f"steps to the threshold saved by {name}, as a share of {whose}: {share}"
    return "" if share == "-" or nothing_learnt(arms) else sentence


def instead(arms: MeasuredArms, name: str) -> str:
    """Return the advice to use an arm's best opponent, and how to write that in a study file."""
    learner, written = without_source(arms, name)
    in_file = f" (in a study file: {written}no sources)" * (not arms.remarks)
    return f"use {learner} without a source{in_file}"


def without_source(arms: MeasuredArms, name: str) -> tuple[str, str]:
    """Return an arm's best opponent as a learner, and as settings of a study file."""
    best, own_learner = arms.best_opponent(name), "the target's own learner"
    if best == SCRATCH:
        return own_learner, ""
    label = (_started(arms, best).strip(" ()") or best).removeprefix(f"{SCRATCH}, ")
    if label.startswith("initial_value="):
        return f"{own_learner} with {label}", f"learner.{label.replace('=', ' = ')}, "
    # A table that changed the type alone would keep the other learner's settings.
    return label, f'learner = {{ type = "{label}" }}, ' * (label == OptimisticQLearning.__name__)


def _started(arms: MeasuredArms, name: str) -> str:
    """Return the initial value of an opponent that starts at a constant, as text."""
    values = arms[name].initial_values
    return "" if values is None else f" (initial_value={values.mean():.4g})"


def _level_sentence(arms: MeasuredArms, name: str) -> str:
    """Return a sentence on a potential that is constant where learning goes; empty if it varies."""
    of_name = (arm for arm in arms.arms.values() if arm.curriculum == name)
    levels = [arm.initial_values for arm in of_name if arm.initial_values is not None]
    if len(levels) < 2 or not np.allclose(levels, levels[0], rtol=1e-12, atol=0):
        return ""
    return f"{name} has one value in all pairs that learning can visit: check its mapping"


LEAST_APART = 0.01  # of the range of returns: clusters that are closer are of no interest


def cluster_sentence(arms: MeasuredArms, name: str) -> str:
    """Return a sentence on two clusters of an arm's seeds; empty if there are none."""
    values = arms.returns[name]
    if (groups := clusters(values)) is None:
        return ""
    high, low = (f"{some.mean():.4g}" for some in reversed(groups))
    apart, possible = np.ptp([some.mean() for some in groups]), np.ptp(arms.within)
    if high == low or apart < LEAST_APART * possible < np.inf:  # or apart by less than is printed
        return ""
    sentence = (
        f"the seeds of {name} are in two clusters, mean return of {len(groups[1])} near {high} "
        f"and of {len(groups[0])} near {low}"
    )
    if min(map(len, groups)) > arms.seeds // 4:
        return sentence
    middle = interquartile_interval(values)
    return f"{sentence}; interquartile mean, without the few: {short(middle)}"


def unlearnt(arms: MeasuredArms, name: str) -> str:
    """Return a sentence on sources that did not learn their tasks; empty if all did."""
    shares = {source: seeds for source, seeds in arms[name].unlearnt.items() if seeds.any()}
    parts = [f"{source} in {n.sum()} of {counted(n.size, 'seed')}" for source, n in shares.items()]
    return f"sources of {name} that did NOT learn: {', '.join(parts)}" if parts else ""


def _gains_more(name: str, verdict: Verdict, controls: str) -> str:
    """Return a sentence on whether an arm gains more than its rivals, called `controls`."""
    strongest = verdict.rival.removeprefix(f"{name}, ")
    if verdict.rivals == 1:
        return f"{name} gains more than its {strongest}: {verdict}"
    several = f"each of its {verdict.rivals} {controls}"
    return f"{name} gains more than {several}: {verdict}; the strongest is {strongest}"


# -- What a page says: its context, a headline, and a finding about each arm -----------------------


def context(arms: MeasuredArms) -> str:
    """Return what all arms share: their steps, their opponents, seeds and tests."""
    best, n = ", ".join(arms.best_opponents), len(arms.scratches)
    many = f"the best of {n} learners that learn the target from scratch ({best})"
    with_whom = many if n > 1 else "learning the target from scratch"
    tested = f", p values are of {_test(arms)}" * (not arms.interim)
    how = f"; brackets are 95\xa0% intervals over seeds{tested}" * (arms.seeds > 1)
    return (
        f"Every arm spends {arms.total:,} steps, source steps included and evaluations free, and "
        f"is compared with {with_whom}. {counted(arms.seeds, 'seed')}{how}."
    )


def _test(arms: MeasuredArms) -> str:
    """Return which test gives p values, and how they are adjusted."""
    n = len(arms.verdicts)
    adjusted = f", adjusted for {n} curricula by Holm's rule" * (n > 1)
    looks = f", multiplied by {len(arms.earlier) + 1} for looks with fewer seeds" * bool(
        arms.earlier
    )
    return f"a sign-flip test of the paired differences{adjusted}{looks}"


@dataclass(frozen=True)
class Finding:
    """The finding about an arm."""

    arm: str
    tone: str  # "pays", "costs" or "open"
    verdict: str
    sentences: tuple[str, ...]


def headline(arms: MeasuredArms) -> str:
    """Return sentences on which curricula paid, or why there is no verdict."""
    warning = nothing_learnt(arms)
    return " ".join(filter(None, (_paid(arms), warning and _sentence(warning))))


def _paid(arms: MeasuredArms) -> str:
    verdicts, n = arms.verdicts, len(arms.verdicts)
    if arms.nobody and not arms.interim:
        return ""
    if arms.withheld:
        return _sentence(arms.withheld)
    if not verdicts:
        return _sentence(best_learner(arms))
    paid = [name for name, verdict in verdicts.items() if verdict.direction > 0]
    harmed = [name for name, verdict in verdicts.items() if verdict.direction < 0]
    undecided = len(verdicts) - len(paid) - len(harmed)
    if undecided and not paid and not harmed:
        return "No curriculum is shown to differ from its opponents."
    counts = [
        f"{f'{len(names)} of {n} curricula' if n > 1 else 'the curriculum'} {verbs[len(names) > 1]}"
        for names, verbs in (
            (paid, ("pays for itself", "pay for themselves")),
            (harmed, ("costs more than it brings", "cost more than they bring")),
        )
        if names
    ]
    if undecided:
        counts.append(f"{undecided} show{'s' * (undecided == 1)} no difference")
    gains = {name: arms.contrasts[name].strong_gain for name in paid or harmed}
    most = max(gains, key=lambda name: abs(float(gains[name].estimate)))
    leading = f"{most} most, " * (len(gains) > 1) or f"{most}, " * (len(verdicts) > 1)
    rival = f"the best opponent, {arms.best_opponent(most)}"
    if arms.best_opponent(most) == SCRATCH:
        rival = "learning from scratch"
    # Why curricula pay, where controls tell: a sentence for each reason.
    reasons: dict[str, list[str]] = {}
    for name, reason in arms.reasons.items():
        if reason.words:
            reasons.setdefault(reason.words, []).append(name)
    why = [" " + _sentence(f"{reason}: {', '.join(names)}") for reason, names in reasons.items()]
    if len(verdicts) == 1:
        why = [f" It pays {reason}." for reason in reasons]
    return (
        f"{_sentence(', '.join(counts), ':')} {leading}{signed(gains[most])} mean return against "
        f"{rival}, source steps counted, over {counted(arms.seeds, 'seed')}.{''.join(why)}"
    )


def _sentence(text: str, end: str = ".") -> str:
    return f"{text[0].upper()}{text[1:]}{end}"


def findings(arms: MeasuredArms) -> tuple[Finding, ...]:
    """Return the finding about each arm that does not learn from scratch, in order."""
    rows = table_rows(arms)
    return tuple(_finding(arms, row) for row in rows if row["arm"] in arms.contrasts)


def _finding(arms: MeasuredArms, row: Row) -> Finding:
    name, rival = row["arm"], row["against"]
    contrast, sure = arms.contrasts[name], _p("adjusted_p", arms, row)
    tone = {"pays": "pays", "costs more than it brings": "costs"}.get(contrast.verdict, "open")
    of_p = f" (p\xa0=\xa0{sure})" if sure else ""
    if arms.nobody:
        return Finding(name, tone, "", (_sentence(f"{arms.nobody}, so that there is no gain"),))
    lines = [
        f"{signed(contrast.strong_gain)} mean return over all {arms.total:,} steps, its "
        f"{row['source_steps']:,.0f} source steps counted{of_p}.",
        f"Over target steps only: {signed(contrast.weak_gain)}.",
        f"Steps to {rounded(arms.threshold)}: {_expected(arms, name)}; {rival}: "
        f"{_expected(arms, rival)}.",
    ]
    remarks = [saved_sentence(arms, name)]
    remarks += [cluster_sentence(arms, arm) for arm in (name, rival)]
    if name in arms.control_verdicts:
        remark = _gains_more(name, arms.control_verdicts[name], "controls")
        remarks.append(remark.removeprefix(f"{name} "))
    if name in arms.verdicts:
        remarks += [headroom_sentence(arms, name), why_unknown(arms, [name])]
        remarks.append(instead(arms, name) * (tone == "costs"))
    lines += map(_sentence, filter(None, (*remarks, row["unlearnt"])))
    return Finding(name, tone, contrast.answer, tuple(lines))


# -- What a forecast says of its trial -------------------------------------------------------------


def likely(gain: Interval) -> str:
    """Return in a few words whether a gain with this interval pays."""
    if gain.low > 0:
        return "likely pays"
    return "likely costs more than it brings" if gain.high < 0 else "whether it pays is open"


def steps_and_gain(arms: MeasuredArms, name: str) -> str:
    """Return a sentence on an arm's steps to the threshold, its best opponent's, and its gain."""
    gained = f"gain in mean return {short(arms.contrasts[name].strong_gain)}"
    if arms.nobody:
        return nothing_learnt(arms)
    if arms.reference.nothing_to_learn:
        return f"nothing to learn, as the random policy is optimal; {gained}"
    best = arms.best_opponent(name)
    by = f"by {best}" if best != SCRATCH else "from scratch"
    times, alone = arms.times(name), arms.times(best)
    spent = arms[name].curve.source_steps.mean()
    aid = "sources" if spent else "the potential"
    if not (times.reached.any() or alone.reached.any()):
        return (
            f"the threshold {arms.threshold:.4g} is never reached within {arms.total:,} steps, "
            f"with {aid} or {by}; {gained}"
        )
    aid += f" (their {spent:,.0f} steps included)" * bool(spent)
    return (
        f"expected steps to the threshold {arms.threshold:.4g}: {_expected(arms, name)} with "
        f"{aid}, {_expected(arms, best)} {by}; share of steps saved "
        f"{share_saved(arms, name, best)}; {gained}"
    )


def seeds_sentence(arms: MeasuredArms, name: str, questions: int, seeds: int) -> str:
    """Return a sentence on the seeds that a study like this trial needs, and those it has."""
    if arms.nobody or name not in arms.contrasts or arms.seeds == 1:
        return ""
    rivals = arms.opponents(name)
    apart = np.stack([difference(arms.returns[name], arms.returns[rival]) for rival in rivals])
    gain, half = float(apart.mean(axis=1).min()), ""
    if gain <= 0:
        half = ", half a standard deviation of its opponent's runs,"
        of_rival = arms.returns[arms.best_opponent(name)]
        deviation = float(of_rival.std(ddof=1))
        if not deviation > ROUNDING * np.abs(of_rival).max():  # all its seeds have equal returns
            return ""
        apart, gain = apart - gain + deviation / 2, deviation / 2
    return (
        f"about {counted(seeds_to_show(apart, questions), 'seed')} show a gain of {gain:.3g}{half} "
        f"in 80 % of studies of this spread; this study has {seeds}"
    )


def _expected(arms: MeasuredArms, name: str) -> str:
    times = arms.times(name)
    missed = int((~times.reached).sum())
    if missed == len(times.reached):
        return f"never within {arms.total:,} steps"
    text = short(times.restricted_mean())
    seeds = counted(len(times.reached), "seed")
    return f"at least {text} ({missed} of {seeds} never)" if missed else text


# -- Words on figures ------------------------------------------------------------------------------


def gain_columns(arms: MeasuredArms, names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the texts beside a figure's gains, heads first: each arm's gain and p-value."""
    by_arm = {row["arm"]: row for row in table_rows(arms)}

    def texts(key: str) -> list[str]:
        return [minus(COLUMNS[key].text(key, arms, by_arm[name])) for name in names]

    references = ["reference" * (name in arms.best_opponents) for name in names]
    gains = [gain or other for gain, other in zip(texts("strong_gain"), references, strict=True)]
    head, p_head = "gain" + " [95 %]" * (arms.seeds > 1), "p (Holm)" * (not arms.withheld)
    return [(head, *gains), (p_head, *texts("adjusted_p"))]


def caption(arms: MeasuredArms, *, profiles: bool = True) -> str:
    """Return the caption of a comparison's figure, with or without profiles of final returns."""
    how, sure = "One seed, which allows neither intervals nor tests.", ""
    if arms.seeds > 1:
        shares = " and Wilson's for shares" * profiles
        kinds = "curves and profiles" if profiles else "curves"
        how = (
            f"{arms.seeds} seeds; bands and bars are nominal 95 % intervals over seeds, "
            f"Student's for means{shares}, pointwise for {kinds}."
        )
        tests = f"p values of {_test(arms)}; filled where p < {SIGNIFICANT:g}"
        sure = f"; {arms.withheld or tests}"
    controls = any(arm.control for arm in arms.arms.values())
    finals = " Middle: final is the mean over the last tenth of the checkpoints." * profiles
    return (
        f"{how} Left: means over seeds; dotted, steps in the sources, at the random policy's "
        f"return; circle, where the first seed begins the target.{finals} Right: the mean return "
        f"is the mean height of the left curve{sure}.{' Dashed and greyer: controls.' * controls}"
    )
