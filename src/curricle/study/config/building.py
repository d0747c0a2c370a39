"""From the tables of an arm to its :class:`Curriculum`."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from curricle.curriculum.curriculum import Curriculum
from curricle.learning.budget import limits, spacing
from curricle.study.config.settings import Settings
from curricle.study.config.study_tables import ArmTables
from curricle.study.config.tables import KeyPath
from curricle.study.config.task_names import NameGraph

Refuse = Callable[[KeyPath], AbstractContextManager[None]]
"""A key path in the arm -> a context that collects what the library refuses there."""


def build(arm: ArmTables, folder: Path, made: dict[str, Any], refuse: Refuse) -> Curriculum | None:
    """Return the curriculum; None where something was refused.

    Parameters
    ----------
    arm : ArmTables
    folder : Path
        Of the modules with the study's own functions.
    made : dict
        The tasks and mappings made so far, which arms share; more are added.
    refuse : callable
    """
    graph = NameGraph(
        {name: getattr(task, "of", None) for name, task in arm.tasks.items()},
        tuple((transfer.source, transfer.target) for transfer in arm.transfers),
    )
    tasks = _tasks(arm, graph, folder, made, refuse)
    settings = _settings(arm, graph, folder, refuse)
    transfers = []
    for index, transfer in enumerate(arm.transfers):
        if transfer.source in tasks and transfer.target in tasks:
            with refuse(("transfers", index)):
                target, source = tasks[transfer.target], tasks[transfer.source]
                key = transfer.model_dump_json(exclude={"scale", "shift", "calibrate"})
                key += _key(arm, graph, transfer.target) + _key(arm, graph, transfer.source)
                if key not in made:
                    made[key] = transfer.mapping_in(target, source, folder)
                transfers.append(transfer.transfer(made[key]))
    complete = len(tasks) == len(arm.tasks) and len(transfers) == len(arm.transfers)
    if complete and all(len(each) == len(graph.learnt) for each in settings.values()):
        with refuse(()):
            return Curriculum({name: tasks[name] for name in graph.learnt}, transfers, **settings)
    return None


def _tasks(
    arm: ArmTables, graph: NameGraph, folder: Path, made: dict[str, Any], refuse: Refuse
) -> dict[str, Any]:
    """Return the tasks that could be made, with the mazes that only crops are made of."""
    tasks: dict[str, Any] = {}
    for name in sorted(arm.tasks, key=lambda name: len(graph.drawings(name))):
        key = _key(arm, graph, name)
        if graph.parts[name] in (None, *tasks):
            with refuse(("tasks", name)):
                if key not in made:
                    made[key] = arm.tasks[name].build_in(folder, tasks.__getitem__)
                tasks[name] = made[key]
    return tasks


def _key(arm: ArmTables, graph: NameGraph, name: str) -> str:
    """Return all that a task depends on: its own keys, and the mazes that it is a part of."""
    return repr(
        [
            arm.tasks[drawing].model_dump_json(exclude=set(Settings.model_fields))
            for drawing in graph.drawings(name)
        ]
    )


def _settings(
    arm: ArmTables, graph: NameGraph, folder: Path, refuse: Refuse
) -> dict[str, dict[str, Any]]:
    """Return each setting of each task that is learnt, as far as it could be made."""
    settings: dict[str, dict[str, Any]] = {which: {} for which in Settings.model_fields}
    with_sources = {target for _, target in graph.edges}
    for name in graph.learnt:
        found: dict[str, Any] = {}
        for which in settings:
            with refuse(("tasks", name, which)):
                value = arm.tasks[name].setting(which, folder)
                _check(which, value, found, name in with_sources)
                found[which] = value
        for which, value in found.items():
            settings[which][name] = value
    return settings


def _check(which: str, value: Any, found: dict[str, Any], has_sources: bool) -> None:
    """Check a setting with those before it, as :class:`Curriculum` will, to report its key."""
    if which == "budget":
        limits(value)
    if which == "eval_freq" and "budget" in found:
        spacing(value, found["budget"])
    if which == "shaping" and has_sources and "learner" in found:
        value.check(found["learner"])
