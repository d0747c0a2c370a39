"""A study's tables for the terminal."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from curricle.checks import one_of
from curricle.errors import StoreError
from curricle.statistics.curves import ROUNDING, SCRATCH
from curricle.study.runner.study import Study


def study_lines(study: Study, arm: str | None, node: str | None) -> Iterator[str]:
    """Yield how far a study is, what each task learnt, and the comparison if there is one."""
    _check(study, arm, node)
    document = study.file.document
    wanted = len(document.seeds)
    yield f"{document.name}: {len(study.seeds)} of {wanted} seeds finished in every arm"
    yield f"{'':<30}{'seeds':>7}{'steps':>12}{'episodes':>11}{'greedy return':>16}"
    for name, result in study.results.items():
        for task, learnt in result.nodes.items():
            if arm in (None, name) and node in (None, task):
                last = learnt.greedy_return[:, -1]
                spread = _spread(last)
                yield (
                    f"{name + ': ' + task:<30}{len(learnt.seeds):>7}"
                    f"{learnt.steps_used.mean():>12,.0f}{learnt.episodes_used.mean():>11,.0f}"
                    f"{spread:>16}"
                )
    yield "(means over seeds; the greedy return with its standard deviation)"
    if SCRATCH in study.arms.curricula and study.seeds:
        yield ""
        yield str(study.comparison)


def decision_lines(
    study: Study, arm: str | None, node: str | None, seed: int | None
) -> Iterator[str]:
    """Yield why tasks went on and ended: every decision of one seed, or the last of each."""
    _check(study, arm, node)
    found = False
    for name, curriculum in study.arms.curricula.items():
        for task in curriculum.order:
            if arm not in (None, name) or node not in (None, task):
                continue
            for number, words in study.decisions(name, task).items():
                if seed in (None, number):
                    found = True
                    for one in words if seed is not None else words[-1:]:
                        yield f"{name}: {task}, seed {number}: {one}"
    if not found:
        raise StoreError(
            f"{study.folder.path} holds no decision of arm {arm or 'any'}, task {node or 'any'}, "
            f"seed {'any' if seed is None else seed}"
        )


def _check(study: Study, arm: str | None, node: str | None) -> None:
    """Raise StoreError unless the study has the arm and the task asked for."""
    curricula = study.arms.curricula
    if arm is not None:
        one_of("an arm", arm, curricula, StoreError)
    if node is not None:
        tasks = [name for one in curricula.values() for name in one.order]
        one_of("a task", node, dict.fromkeys(tasks), StoreError)


def _spread(returns: npt.NDArray[np.float64]) -> str:
    """Return a mean with its standard deviation, none where seeds differ by rounding alone."""
    mean, deviation = float(np.mean(returns)), float(np.std(returns))
    return f"{mean:.4g} ± {deviation if deviation > ROUNDING * abs(mean) else 0.0:.2g}"
