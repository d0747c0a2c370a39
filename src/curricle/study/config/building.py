"""From a complete curriculum as data to the :class:`Curriculum`; what cannot be is refused."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from curricle.curriculum.curriculum import Curriculum
from curricle.learning.budget import limits, spacing
from curricle.study.config.document import Plan
from curricle.study.config.graph import Graph
from curricle.study.config.settings import Settings
from curricle.study.config.tables import Place

Refuse = Callable[[Place], AbstractContextManager[None]]
"""A place of the plan -> a context that notes what Curricle refuses there, and goes on."""


def build(plan: Plan, folder: Path, made: dict[str, Any], refuse: Refuse) -> Curriculum | None:
    """Return the curriculum; None where something was refused.

    Parameters
    ----------
    plan : Plan
    folder : Path
        Of the modules with the study's own functions.
    made : dict
        The tasks and mappings made so far, which arms share; more are added.
    refuse : callable
    """
    graph = Graph(
        {name: getattr(task, "of", None) for name, task in plan.tasks.items()},
        tuple((transfer.source, transfer.target) for transfer in plan.transfers),
    )
    tasks = _tasks(plan, graph, folder, made, refuse)
    settings = _settings(plan, graph, folder, refuse)
    transfers = []
    for index, transfer in enumerate(plan.transfers):
        if transfer.source in tasks and transfer.target in tasks:
            with refuse(("transfers", index)):
                target, source = tasks[transfer.target], tasks[transfer.source]
                words = transfer.model_dump_json(exclude={"scale", "shift", "calibrate"})
                words += _words(plan, graph, transfer.target) + _words(plan, graph, transfer.source)
                if words not in made:
                    made[words] = transfer.made(target, source, folder)
                transfers.append(transfer.build(made[words]))
    whole = len(tasks) == len(plan.tasks) and len(transfers) == len(plan.transfers)
    if whole and all(len(each) == len(graph.learnt) for each in settings.values()):
        with refuse(()):
            return Curriculum({name: tasks[name] for name in graph.learnt}, transfers, **settings)
    return None


def _tasks(
    plan: Plan, graph: Graph, folder: Path, made: dict[str, Any], refuse: Refuse
) -> dict[str, Any]:
    """Return the tasks that could be made, those that lend their drawing included."""
    tasks: dict[str, Any] = {}
    for name in sorted(plan.tasks, key=lambda name: len(graph.drawings(name))):
        words = _words(plan, graph, name)
        if graph.parts[name] in (None, *tasks):
            with refuse(("tasks", name)):
                if words not in made:
                    made[words] = plan.tasks[name].build(folder, tasks.__getitem__)
                tasks[name] = made[words]
    return tasks


def _words(plan: Plan, graph: Graph, name: str) -> str:
    """Return what is said of a task itself, and of the mazes that it is a part of."""
    return repr(
        [
            plan.tasks[drawing].model_dump_json(exclude=set(Settings.model_fields))
            for drawing in graph.drawings(name)
        ]
    )


def _settings(plan: Plan, graph: Graph, folder: Path, refuse: Refuse) -> dict[str, dict[str, Any]]:
    """Return each setting of each task that is learnt, where it could be made."""
    settings: dict[str, dict[str, Any]] = {which: {} for which in Settings.model_fields}
    taught = {target for _, target in graph.edges}
    for name in graph.learnt:
        found: dict[str, Any] = {}
        for which in settings:
            with refuse(("tasks", name, which)):
                value = plan.tasks[name].setting(which, folder)
                _check(which, value, found, name in taught)
                found[which] = value
        for which, value in found.items():
            settings[which][name] = value
    return settings


def _check(which: str, value: Any, found: dict[str, Any], taught: bool) -> None:
    """Check a setting with those before it, as :class:`Curriculum` will, where it has a place."""
    if which == "budget":
        limits(value)
    if which == "eval_freq" and "budget" in found:
        spacing(value, found["budget"])
    if which == "shaping" and taught and "learner" in found:
        value.check(found["learner"])
