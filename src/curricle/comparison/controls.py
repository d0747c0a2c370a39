"""Controls: arms that equal a curriculum except for what is supposed to help.

- ``random_start``: the source is the target itself with a uniform start, for as many steps. If it
  helps as much, visiting many states helped, not the easier task.
- ``pretraining``: the source is the target itself, for as many steps. If it helps as much, the
  longer training helped.
- ``placebo``: phi's values shuffled over the pairs of the target. If it helps as much, any values
  of that size do.
- ``constant``: the same value everywhere, once the mean of phi and once its maximum over the pairs
  that learning can visit (``curricle.comparison.levels`` says which). If one of them helps as much,
  phi's optimism did it: a higher ``initial_value`` does so without any source.
- ``scaled``: phi halved and doubled. If one of them is much better, phi had the wrong scale.
- ``negated``: -phi. It should do harm if phi helps.

``placebo`` and ``constant`` know nothing of the task. A curriculum that pays, and gains more than
they do, pays by what it knows.

An observation task has no numbered states, so ``random_start`` is refused there, and ``placebo``
unless its sources are miniatures: then each observation has the answer of another.
``scaled`` and ``constant`` need no dense tables.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np

from curricle.checks import one_of
from curricle.comparison.levels import Level, VisitedPairs, initial_value_of
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.result import CurriculumResult
from curricle.deep.miniature import Miniatures
from curricle.errors import CurriculumError, SettingError
from curricle.learning.potential import PairPotential, StateActionPotential
from curricle.learning.result import LearningResult
from curricle.learning.stopping import StoppingRule
from curricle.progress import Progress
from curricle.tasks.gridworld import GridWorld
from curricle.tasks.mdp import Task, tables
from curricle.tasks.observation_task import is_observation_task
from curricle.transfer.by_components import identity
from curricle.transfer.calibration import AnyPotential
from curricle.transfer.potential import ObservationPotential
from curricle.transfer.transfer import Transfer

Control = Literal["random_start", "pretraining", "placebo", "constant", "scaled", "negated"]
CONTROLS: tuple[Control, ...] = get_args(Control)
PLACEBO, CONSTANT_MEAN, CONSTANT_MAXIMUM = "placebo", "constant mean", "constant maximum"
KNOW_NOTHING = (PLACEBO, CONSTANT_MEAN, CONSTANT_MAXIMUM)
"""Labels of the controls that know nothing of the task."""
WITHOUT_TABLES = ("constant", "scaled")
"""Controls that need no dense tables of the target."""
SOURCE = "control source"


def check_controls(controls: Sequence[str]) -> None:
    """Raise SettingError unless all names are controls."""
    if isinstance(controls, str):
        raise SettingError(f"controls must be a list of names: got {controls!r}")
    for name in controls:
        one_of("a control", name, CONTROLS, SettingError)


def check_fit(controls: Sequence[str], arm: str, curriculum: Curriculum) -> None:
    """Raise CurriculumError unless a curriculum's target can be learnt with these controls.

    TaskError if the target has no tables, which all controls but ``constant`` and ``scaled`` need.
    """
    if not controls:
        return
    name = curriculum.target
    if not curriculum.in_edges(name):
        raise CurriculumError(
            f"controls need a transfer into the target: arm {arm!r} has none into {name!r}"
        )
    if is_observation_task(curriculum.tasks[name]):
        _check_observed(controls, arm, curriculum)
    elif any(control not in WITHOUT_TABLES for control in controls):
        tables(curriculum.tasks[name])
        if curriculum.setting("storage", name).kind == "sparse":
            raise CurriculumError(
                "controls other than 'constant' and 'scaled' need dense tables of the target: the "
                f"storage of {name!r} is sparse in arm {arm!r}"
            )


def _check_observed(controls: Sequence[str], arm: str, curriculum: Curriculum) -> None:
    name = curriculum.target
    shaping = curriculum.setting("shaping", name)
    for control in controls:
        if control == "placebo" and _all_miniatures(curriculum):
            continue
        if control in ("random_start", "placebo"):
            raise CurriculumError(
                f"a control {control!r} needs numbered states: {name!r}, the target of arm "
                f"{arm!r}, is seen through observations"
            )
        if control != "pretraining" and not shaping.reads_values:
            raise CurriculumError(
                f"a control {control!r} changes the values of a potential: the target of arm "
                f"{arm!r} has the shaping {shaping.name}, which does not read them"
            )


def _all_miniatures(curriculum: Curriculum) -> bool:
    """Return whether all that is carried over to the target comes from miniatures."""
    sources = [edge.source for edge in curriculum.in_edges(curriculum.target)]
    return all(isinstance(curriculum.tasks[name], Miniatures) for name in sources)


def shuffled_miniatures(curriculum: Curriculum) -> Curriculum:
    """Return a curriculum in whose miniatures each observation has the answer of another."""
    tasks: dict[str, Any] = dict(curriculum.tasks)
    for name, task in tasks.items():
        if isinstance(task, Miniatures):
            tasks[name] = replace(task, shuffled=True)
    transfers = [
        replace(
            edge,
            mapping=replace(edge.mapping, source=tasks[edge.source], target=tasks[edge.target]),
        )
        if isinstance(tasks[edge.source], Miniatures) or isinstance(tasks[edge.target], Miniatures)
        else edge
        for edge in curriculum.transfers
    ]
    return replace(curriculum, tasks=tasks, transfers=transfers)


def source_control(curriculum: Curriculum, control: Control, steps: int) -> Curriculum:
    """Return a curriculum whose only source is its target, trained for `steps`.

    The source starts uniformly for ``random_start``, as the target for ``pretraining``.
    """
    name = curriculum.target
    task = curriculum.tasks[name]
    source = _with_uniform_start(task) if control == "random_start" else task
    learner, evaluation = (curriculum.setting(which, name) for which in ("learner", "evaluation"))
    storage = curriculum.setting("storage", name)
    return Curriculum(
        tasks={SOURCE: source, name: task},
        transfers=[Transfer(SOURCE, name, identity(task, source))],
        shaping={name: curriculum.setting("shaping", name)},
        budget={SOURCE: StoppingRule(steps), name: curriculum.setting("budget", name)},
        eval_freq={SOURCE: steps, name: curriculum.setting("eval_freq", name)},
        storage={SOURCE: replace(storage, save_values=True), name: storage},
        learner={SOURCE: learner, name: learner},
        evaluation={SOURCE: evaluation, name: evaluation},
    )


Change = Callable[[AnyPotential, int], AnyPotential]
"""phi and a seed -> another phi."""


def value_controls(
    controls: Sequence[Control], pairs: VisitedPairs
) -> Iterator[tuple[str, Change]]:
    """Yield the name and the function of each control that changes phi's values.

    `pairs` are those of the target that learning can visit.
    """
    if "placebo" in controls and not is_observation_task(pairs.task):
        yield PLACEBO, _shuffled
    if "constant" in controls:
        yield CONSTANT_MEAN, lambda phi, _: phi.rescaled(0.0, float(pairs.values(phi).mean()))
        yield CONSTANT_MAXIMUM, lambda phi, _: phi.rescaled(0.0, float(pairs.values(phi).max()))
    if "scaled" in controls:
        yield "scaled x 0.5", lambda phi, _: phi.rescaled(0.5)
        yield "scaled x 2", lambda phi, _: phi.rescaled(2.0)
    if "negated" in controls:
        yield "negated", _negated


def changed_potentials(result: CurriculumResult, change: Change) -> list[AnyPotential]:
    """Return the potential of each seed of a curriculum's target, changed."""
    name = result.curriculum.target
    pairs = zip(result.potentials[name], result[name].seeds, strict=True)
    return [change(phi, k) for phi, k in pairs]


def level_of(
    label: str, changed: Sequence[AnyPotential], pairs: VisitedPairs, curriculum: Curriculum
) -> Level | None:
    """Return the level of a control that knows nothing, from its potentials; else None."""
    if label not in KNOW_NOTHING:
        return None
    means = np.array([pairs.values(phi).mean() for phi in changed])
    constant = label != PLACEBO
    return Level(means, initial_value_of(curriculum) if constant else None, constant)


def learn_changed(
    result: CurriculumResult,
    changed: Sequence[AnyPotential],
    workers: int | None,
    progress: Progress = None,
) -> LearningResult:
    """Return the target trained as in its curriculum, sources charged, from other potentials."""
    curriculum: Curriculum = result.curriculum
    name = curriculum.target
    return curriculum.node(name).train(
        result[name].seeds,
        changed,
        warm_ups=[one.warm_up for one in result.calibrations.get(name, ())],
        charged=result.source_steps(name),
        workers=workers,
        progress=progress,
    )


def _negated(phi: AnyPotential, _: int) -> AnyPotential:
    if isinstance(phi, ObservationPotential):
        return phi.rescaled(-1.0)
    return StateActionPotential(phi.task, -phi.values)


def _shuffled(phi: PairPotential, seed: int) -> PairPotential:
    """Return phi with its values permuted over all pairs that are not terminal."""
    values, ends = phi.values.copy(), tables(phi.task).terminal
    alive = values[~ends]
    values[~ends] = np.random.default_rng([seed, 1]).permutation(alive.ravel()).reshape(alive.shape)
    return StateActionPotential(phi.task, values)


def _with_uniform_start(task: Task) -> Task:
    if isinstance(task, GridWorld):
        return task.with_start("uniform")
    mdp = tables(task)
    return replace(mdp, start=~mdp.terminal / (~mdp.terminal).sum())
