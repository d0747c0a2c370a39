"""The output of commands: tables as wide as the terminal, explained words, and results."""

import sys
from collections.abc import Iterable, Sequence
from shutil import get_terminal_size
from textwrap import fill

import numpy as np

from curricle.arrays import FloatArray
from curricle.checks import one_of
from curricle.comparison.comparison import ARM_MEASURES
from curricle.comparison.plan import numbered_seeds
from curricle.errors import StoreError
from curricle.statistics.curves import ROUNDING, SCRATCH
from curricle.study.cost import total_words
from curricle.study.results import StudyResults
from curricle.study.tuning import effects_of, tuning_words
from curricle.study_file.vary import value_text
from curricle.text import UNBOUNDED, counted, text_table

# -- Tables and texts on the terminal, as wide as it is; where there is none, nothing is folded ----

LINE = 80  # characters of a line of text where there is no terminal, and at most where there is one


def table_width() -> int:
    """Return the columns that a table may have."""
    return get_terminal_size().columns if sys.stdout.isatty() else UNBOUNDED


def line_width() -> int:
    """Return the characters that a line of text may have."""
    return min(LINE, table_width())


def print_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table of names and numbers to standard output."""
    for line in text_table(heads, rows, table_width()):
        print(line)


def print_text(text: str, indent: int = 0) -> None:
    """Print a paragraph, its lines after the first indented by two more."""
    print(wrapped(text, indent))


def wrapped(text: str, indent: int = 0) -> str:
    """Return a paragraph as lines that fit."""
    first, later = " " * indent, " " * (indent + 2)
    return fill(
        text, line_width(), initial_indent=first, subsequent_indent=later, break_on_hyphens=False
    )


# -- What the words under ``curricle check``, ``show`` and ``compare`` mean; the one place of it ---

INTERVAL = "[low, high]"
EXPLANATIONS = {
    "arm": "one of the ways to learn the target that the study compares",
    "scratch": "the arm that learns the target without any source",
    "aggregate": "how the values of several sources become one potential",
    "greedy return": "the mean return of an episode in which the best known action is always taken",
    "charged": "steps in sources count as steps of the arm, which starts that much later",
    "evaluations are free": "steps of episodes that only measure the policy are not counted",
    "steps to threshold": "steps until the greedy return, smoothed, reaches the threshold, "
    'sources included; "> 1,000 (2 never)": 2 seeds do not get there, so the mean is more',
    "threshold": "the return that counts as learnt; by default nine tenths of the way from the "
    "random policy's to the optimum",
    **{measure.head: measure.meaning for measure in ARM_MEASURES.values()},
    INTERVAL: "after a number: its interval of 95 % confidence over seeds",
    "strong gain": "mean return above the best opponent's, source steps charged (strong transfer)",
    "weak gain": "the same with the source steps free (weak transfer)",
    "verdict": "whether the arm gains more than each opponent, by a test over the seeds",
    "p =": "the probability of such a difference by chance, corrected for the number of arms",
    "whole checkpoints": "budgets are rounded up to a multiple of the steps between evaluations",
    "phi": "the potential: the sources' value of each state and action of the target",
    "gain": "strong gain in a trial, the comparison played in the model beforehand",
    "start": "greedy return of phi alone, before the first step of learning",
    "phi > Q*": "share of state-action pairs whose phi is above their optimal value",
    "excess": "the mean of phi - Q*; above 0 phi is optimistic",
    "rank": "rank correlation of phi and Q*: 1 is the right order everywhere, 0 none",
    "scale": "the factor with which phi would fit the returns of its own greedy policy; "
    '"none" if nothing fits',
    "mapped": "pairs of the target that have a counterpart in the source",
    "unmapped": "pairs of which the source knows nothing",
    "learnt": "how far a source came from the random policy's return to its optimum",
}
"""Words, and what each means."""


def print_words() -> None:
    """Print what the words mean."""
    print()
    for word, meaning in EXPLANATIONS.items():
        print_text(f"{word}: {meaning}")


# -- What ``curricle show`` prints of a sweep or a tuning ------------------------------------------

NONE = "–"


def print_effects(results: StudyResults) -> None:
    """Print the best trial of each arm and the main effects, of a study that has finished seeds."""
    tuned, effects = results.record.tuned, effects_of(results)
    if tuned is not None:
        print()
        print_text(
            f"tuned on {numbered_seeds(tuned.seeds)}, {tuned.total:,} steps a trial and seed, "
            "sources included; these steps are shown here and not charged to the curves"
        )
        best = list[tuple[str, ...]]()
        for name, arm in tuned.arms.items():
            settings = ", ".join(f"{key} = {_number(value)}" for key, value in arm.values.items())
            number, steps = f"{arm.trials}", f"{tuned.steps(name):,}"
            label = f"{name}: {settings or 'nothing to tune'}"
            best.append((label, number, steps, _number(arm.score)))
        print_table(("best trial", "of", "tuning steps", "mean return"), best)
    if effects:
        print()
        print_text(
            "main effects: mean return, sources charged, over all arms, 95 % intervals over seeds"
        )
        rows = [
            (f"{arm}: {key} = {text}", f"{n}", f"{mean:.4g}", f"[{low:.4g}, {high:.4g}]")
            for arm, key, text, n, mean, low, high in effects
        ]
        print_table(("", "arms", "mean return", ""), rows)


def _number(value: object) -> str:
    """Return a value that was tried, numbers in four significant digits."""
    if value is None:
        return NONE
    return f"{value:.4g}" if isinstance(value, float) else value_text(value)


# -- The tables and sentences of ``curricle show`` -------------------------------------------------


def print_results(results: StudyResults, arm: str | None, task: str | None) -> None:
    """Print a study's progress, what each task learnt, and the comparison if there is one."""
    _check(results, arm, task)
    record = results.record
    arms = "every arm" + " that has not failed" * bool(results.failed)
    total = counted(len(record.seeds), "seed")
    print_text(f"{record.name}: {len(results.seeds)} of {total} finished in {arms}")
    if yet_to_tune := tuning_words(results.store):
        print_text(yet_to_tune)
    if record.chosen:
        print(record.chosen)
    rows = [
        (
            f"{name}: {node}",
            f"{len(learnt.seeds)}",
            f"{learnt.steps_used.mean():,.0f}",
            f"{learnt.episodes_used.mean():,.0f}",
            _mean_and_deviation(learnt.greedy_return[:, -1]),
        )
        for name, nodes in results.results.items()
        for node, learnt in nodes.items()
        if arm in (None, name) and task in (None, node)
        if node == record.target or not record.arms[name].control_of  # else it is another's source
    ]
    if rows:
        print_table(("", "seeds", "steps", "episodes", "greedy return"), rows)
        print_text(
            "(means over seeds; evaluations are free; the greedy return with its standard "
            "deviation)"
        )
    else:
        print_text("no unit is stored yet")
    # Of a study that is yet to be tuned the total is not known: budgets may be searched for.
    budget = None if yet_to_tune else record.budget
    if budget is not None and record.total not in (None, budget):
        steps = budget, record.total, record.eval_freq
        sources = any(recorded.transfers for recorded in record.arms.values())
        print_text(total_words(record.target, *steps, sources=sources))
    compared = record.total is not None and SCRATCH in {*record.arms} - {*results.failed}
    if compared and results.seeds:
        print(f"\n{results.comparison.text(table_width())}")
        print_effects(results)
    else:
        for name, error in results.failed.items():
            print_text(f"{name} failed: {error}")


def decision_lines(
    results: StudyResults, arm: str | None, task: str | None, seed: int | None
) -> list[str]:
    """Return why tasks went on or stopped: all decisions of a seed, or each seed's last."""
    _check(results, arm, task)
    lines = [
        f"{name}: {node}, seed {number}: {reason}"
        for name, node in results.record.keys
        if arm in (None, name) and task in (None, node)
        for number, reasons in results.decisions(name, node).items()
        if seed in (None, number)
        for reason in (reasons[-1:] if seed is None else reasons)
    ]
    if not lines:
        raise StoreError(
            f"{results.store.path} holds no decision of arm {arm or 'any'}, task {task or 'any'}, "
            f"seed {'any' if seed is None else seed}"
        )
    return lines


def _check(results: StudyResults, arm: str | None, task: str | None) -> None:
    """Raise StoreError unless the study has the arm and the task."""
    if arm is not None:
        one_of("an arm", arm, results.record.arms, StoreError)
    if task is not None:
        one_of("a task", task, dict.fromkeys(name for _, name in results.record.keys), StoreError)


def _mean_and_deviation(returns: FloatArray) -> str:
    """Return mean and deviation, 0 if seeds differ only by rounding; a dash for no number."""
    mean, deviation = float(np.mean(returns)), float(np.std(returns))
    if np.isnan(mean):
        return "-"
    if len(returns) == 1:  # which has no deviation
        return f"{mean:.4g}"
    return f"{mean:.4g} ± {deviation if deviation > ROUNDING * abs(mean) else 0.0:.2g}"
