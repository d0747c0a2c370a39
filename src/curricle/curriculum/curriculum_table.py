"""A curriculum and what training it gave: in a few words, and as HTML for a notebook."""

from typing import Any

import numpy as np

from curricle.display import beside, block, brief_value, shortened, table
from curricle.errors import CurricleError
from curricle.learning.result import learnt_curve, learnt_table
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.task import generative_model
from curricle.text_tables import counted
from curricle.transfer.calibration import Calibration

MOST_CURVES = 4
"""Tasks whose curves are shown beside each other, the last ones of a curriculum."""


def graph_in_brief(graph: Any) -> str:
    """Return the tasks of a curriculum and its transfers in a few words."""
    edges = [f"{one.source} -> {one.target}" for one in graph.transfers]
    parts = [", ".join(graph.order), *([", ".join(edges)] if edges else [])]
    return shortened(f"{type(graph).__name__}({'; '.join(parts)})")


def curriculum_html(curriculum: Any) -> str:
    """Return a curriculum as a table of its tasks and one of its transfers."""
    tasks = [
        (
            name,
            _task_in_words(curriculum.tasks[name]),
            type(curriculum.setting("learner", name)).__name__,
            _budget_in_words(curriculum.node(name).budget),
        )
        for name in curriculum.order
    ]
    transfers = [
        (one.source, one.target, brief_value(one.mapping), one.scale, one.shift, _calibrated(one))
        for one in curriculum.transfers
    ]
    head = ["source", "target", "mapping", "scale", "shift", "calibrated"]
    return block(
        f"Curriculum: {counted(len(tasks), 'task')}, {counted(len(transfers), 'transfer')}",
        table(["task", "", "learner", "budget"], tasks, wide=["budget"]),
        transfers and table(head, transfers, wide=["mapping"]),
    )


def _task_in_words(task: Any) -> str:
    if is_observation_task(task):
        return brief_value(task)
    model = generative_model(task)
    states, actions = counted(model.states.size, "state"), counted(model.actions.size, "action")
    return f"{type(task).__name__}, {states}, {actions}"


def _budget_in_words(budget: Any) -> str:
    return counted(budget, "step") if isinstance(budget, int) else str(budget)


def _calibrated(transfer: Any) -> str:
    return "yes" if transfer.calibrate else "no"


def result_in_brief(result: Any) -> str:
    """Return what training gave in a few words: seeds, and the last return of each task."""
    seeds = len(next(iter(result.nodes.values())).seeds) if result.nodes else 0
    last = [f"{name} {one.greedy_return[:, -1].mean():.4g}" for name, one in result.nodes.items()]
    returns = f"last greedy returns: {', '.join(last)}" if last else "nothing was trained"
    return shortened(f"CurriculumResult({counted(seeds, 'seed')}; {returns})")


def result_html(result: Any) -> str:
    """Return what training gave: curves, a table of the tasks, and what calibration came to."""
    shown = dict([*result.nodes.items()][-MOST_CURVES:])
    ended = {name: _ended(result, name) for name in result.nodes}
    given = [name for name in result.given if name not in result.nodes]
    return block(
        f"Training of {' -> '.join(result.curriculum.order)}",
        beside({name: learnt_curve(one) for name, one in shown.items()}),
        learnt_table(result.nodes, ended),
        given and f"learnt before: {', '.join(given)}",
        *(f"{name}: {_calibration(each)}" for name, each in result.calibrations.items()),
        *(
            f"{name}: sources retrained for {one.extra.mean():,.0f} steps a seed"
            for name, one in result.retrained.items()
        ),
    )


def _ended(result: Any, name: str) -> str:
    """Return what ended a task's training in words; nothing where no rule did."""
    if name not in result.curriculum.tasks:
        return ""
    try:
        return str(result.decisions(name).in_words)
    except CurricleError:  # a rule that cannot be judged any more
        return ""


def _calibration(each: list[Calibration]) -> str:
    refused = sum(bool(one.refusal) for one in each)
    scale = np.mean([one.scale for one in each])
    words = f"calibrated to scale {scale:.3g} on average over {counted(len(each), 'seed')}"
    return f"{words}, of which {refused} could not be" if refused else words
