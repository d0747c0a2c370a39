"""From the tasks and curricula of a study to its record in plain data."""

from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import Any

from curricle.comparison.comparing import OF_OPTIMUM, STATED, threshold_of_optimum
from curricle.comparison.task_differences import plain_text, task_summary
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.defaults import OF_TARGETS, SETTINGS
from curricle.deep.learner import DeepLearner
from curricle.deep.shaping import PolicyReuse
from curricle.statistics.curves import SCRATCH
from curricle.study.arms import Arms
from curricle.study.config.study_config import StudyConfig
from curricle.study.record import (
    ArmRecord,
    CurriculaRecord,
    NodeRecord,
    StudyRecord,
    TaskRecord,
    TransferRecord,
    VariantRecord,
    ViewRecord,
)
from curricle.study.store import seeds_per_file
from curricle.tasks.grid_view import GridView
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.task import generative_model, same_task
from curricle.text_tables import counted
from curricle.transfer.edges import Transfer, same_transfer, transfer_words
from curricle.transfer.observation_rollouts import target_of

Keys = Mapping[tuple[str, str], str]


def study_record(study: StudyConfig, arms: Arms) -> StudyRecord:
    """Return the record of a study, before it is run."""
    controls = {name: arm.of for name, arm in arms.arms.items()}
    curricula = curricula_record(
        arms.curricula, arms.keys, arms.scratches, study.variants or {}, controls
    )
    first = next(iter(arms.curricula.values()))
    threshold, level = study.threshold, STATED
    if threshold is None and arms.total is not None and SCRATCH in arms.curricula:
        node = first.node(arms.target)
        threshold, level = threshold_of_optimum(target_of(node.task, node.evaluation)), OF_OPTIMUM
    of_study = {name: getattr(study, name) for name in ("name", "seeds", "window", "snapshots")}
    of_arms = {name: getattr(arms, name) for name in ("target", "budget", "total", "eval_freq")}
    problem = task_summary(first.tasks[arms.target])
    both = {"tasks": curricula.tasks, "arms": curricula.arms, **of_study, **of_arms}
    return StudyRecord(threshold=threshold, threshold_from=level, problem=problem, **both)


def curricula_record(
    curricula: Mapping[str, Curriculum],
    keys: Keys,
    scratches: Collection[str] = (),
    variants: Mapping[str, VariantRecord] = MappingProxyType({}),
    controls: Mapping[str, str] = MappingProxyType({}),
) -> CurriculaRecord:
    """Return the record of curricula by arm; `keys` are those of the stored results, if any.

    `scratches` are the arms that learn the target from scratch, `variants` the settings that a
    sweep or a tuning gave to arms, `controls` the arm that each control is of.
    """
    tasks, edges, arms = list[Any](), list[Transfer](), {}
    for arm, curriculum in curricula.items():
        nodes = {
            name: NodeRecord(
                task=_number(curriculum.tasks[name], tasks, same_task),
                key=keys.get((arm, name), ""),
                settings=_settings(curriculum, name),
                aggregate=_aggregate(curriculum, name),
                seeds_per_file=seeds_per_file(curriculum.node(name)),
            )
            for name in curriculum.order
        }
        transfers = tuple(
            TransferRecord(
                source=one.source,
                target=one.target,
                words=transfer_words(one),
                number=_number(one, edges, same_transfer),
            )
            for one in curriculum.transfers
        )
        arms[arm] = ArmRecord(
            nodes=nodes,
            transfers=transfers,
            potential=_potential(curriculum),
            scratch=arm in scratches,
            depends_on_total=_depends_on_total(curriculum),
            variant=variants.get(arm),
            control_of=controls.get(arm, ""),
        )
    return CurriculaRecord(tasks=tuple(map(_task, tasks)), arms=arms)


def _number(one: Any, known: list[Any], same: Any) -> int:
    """Return the place of an object among those that differ, to which it is added if it is new."""
    for number, other in enumerate(known):
        if same(one, other):
            return number
    known.append(one)
    return len(known) - 1


def _task(task: Any) -> TaskRecord:
    if is_observation_task(task):
        kind = f"observations, {task.shapes.replace('->', '→')}"
        return TaskRecord(kind=kind, text=plain_text(task), states=0, actions=0, view=None)
    generative = generative_model(task)
    states, actions = generative.states.size, generative.actions.size
    view = GridView.for_replay(task)
    return TaskRecord(
        kind=f"{type(task).__name__}, {counted(states, 'state')} × {counted(actions, 'action')}",
        text=plain_text(task),
        states=states,
        actions=actions,
        view=None if view is None else ViewRecord.of(view),
    )


def _settings(curriculum: Curriculum, name: str) -> dict[str, str]:
    """Return the settings of a task's training in words."""
    sources = curriculum.in_edges(name)
    return {
        which: _setting_text(curriculum.setting(which, name))
        for which in SETTINGS
        if sources or which not in OF_TARGETS
    }


def _setting_text(value: Any) -> str:
    """Return a setting as text: functions by name, numbers with commas."""
    if value is None:
        return "default"
    if isinstance(value, int):
        return f"{value:,}"
    name = getattr(value, "__name__", None)
    return str(name) if name else value if isinstance(value, str) else plain_text(value)


def _aggregate(curriculum: Curriculum, name: str) -> str | None:
    if len(curriculum.in_edges(name)) < 2:
        return None
    return getattr(curriculum.setting("aggregate", name), "__name__", "a custom aggregate")


def _depends_on_total(curriculum: Curriculum) -> str:
    """Return why what a target learns by a step depends on its budget; empty if it does not."""
    target = curriculum.target
    learner, shaping = (curriculum.setting(one, target) for one in ("learner", "shaping"))
    if curriculum.calibration(target) is not None:
        return "its calibration may take a share of the total"
    if isinstance(learner, DeepLearner) and learner.scheduled:
        return f"a schedule of {learner.algorithm} runs over the total"
    guided = isinstance(shaping, PolicyReuse) and "buffer_size" in learner.takes
    if guided or getattr(shaping, "kl", 0) > 0:
        return "its sources' policy is followed in the first half of the total"
    return ""


def _potential(curriculum: Curriculum) -> str:
    """Return the name that a forecast gives to the potential of a curriculum's target."""
    function = curriculum.setting("aggregate", curriculum.target)
    calibrated = curriculum.calibration(curriculum.target) is not None
    return getattr(function, "__name__", "") + ", calibrated" * calibrated
