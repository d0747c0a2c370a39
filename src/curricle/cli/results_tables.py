"""The tables and sentences of ``curricle show``."""

import numpy as np

from curricle.array_types import FloatArray
from curricle.checks import one_of
from curricle.cli.effects_tables import print_effects
from curricle.cli.terminal_tables import print_table, print_text, table_width
from curricle.errors import StoreError
from curricle.statistics.curves import ROUNDING, SCRATCH
from curricle.study.cost import total_words
from curricle.study.results import StudyResults
from curricle.study.tuning_record import tuning_words
from curricle.text_tables import counted


def print_results(results: StudyResults, arm: str | None, task: str | None) -> None:
    """Print a study's progress, what each task learnt, and the comparison if there is one."""
    _check(results, arm, task)
    record = results.record
    arms = "every arm" + " that has not failed" * bool(results.failed)
    total = counted(len(record.seeds), "seed")
    print_text(f"{record.name}: {len(results.seeds)} of {total} finished in {arms}")
    if yet_to_tune := tuning_words(results.store):
        print_text(yet_to_tune)
    rows = list[tuple[str, ...]]()
    for name, found in results.results.items():
        for node, learnt in found.items():
            if arm in (None, name) and task in (None, node):
                rows.append(
                    (
                        f"{name}: {node}",
                        f"{len(learnt.seeds)}",
                        f"{learnt.steps_used.mean():,.0f}",
                        f"{learnt.episodes_used.mean():,.0f}",
                        _mean_and_deviation(learnt.greedy_return[:, -1]),
                    )
                )
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
        sources = any(one.transfers for one in record.arms.values())
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
    """Return why tasks went on or stopped: all decisions of one seed, or the last of each seed."""
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
    """Raise StoreError unless the study has the arm and the task asked for."""
    if arm is not None:
        one_of("an arm", arm, results.record.arms, StoreError)
    if task is not None:
        tasks = [name for _, name in results.record.keys]
        one_of("a task", task, dict.fromkeys(tasks), StoreError)


def _mean_and_deviation(returns: FloatArray) -> str:
    """Return mean and deviation, 0 where seeds differ by rounding alone; a dash for no number.

    One seed has no deviation.
    """
    mean, deviation = float(np.mean(returns)), float(np.std(returns))
    if np.isnan(mean):
        return "-"
    if len(returns) == 1:
        return f"{mean:.4g}"
    return f"{mean:.4g} ± {deviation if deviation > ROUNDING * abs(mean) else 0.0:.2g}"
