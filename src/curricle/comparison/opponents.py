"""Opponents: learners of the target that need no source, and so are charged no step.

A curriculum pays if it gains more than the best opponent. The target's own learner, the learners
that a user adds, and by default all of these but the last are opponents:

- ``constant``: the target's learner with a constant initial Q: for each seed the mean, the minimum
  or the maximum of a curriculum's potential over the pairs that learning can visit.
- ``bounds``: the target's learner with a constant initial Q: the lowest or the highest value that
  the task's rewards allow.
- ``optimistic``: :class:`OptimisticQLearning`.
- ``model-based``: :class:`RMax`, a step of which takes 2 to 17 times as long.

A target that a network learns has none of these; a target without dense tables has only constants.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, fields, is_dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from curricle.arrays import FloatArray, IntArray
from curricle.checks import fit_name, instance, one_of
from curricle.curriculum.curriculum import OF_TARGETS, SETTINGS, Curriculum, TrainingOptions
from curricle.errors import CurriculumError, SettingError, TaskError
from curricle.learning.learners import Learner, OptimisticQLearning, RMax, value_bounds
from curricle.learning.potential import MOST_SHARED
from curricle.learning.result import LearningResult
from curricle.learning.shaping import QInitialisation
from curricle.planning.rollouts import random_rollouts
from curricle.statistics.curves import SCRATCH
from curricle.tasks.graph import reachable_states
from curricle.tasks.mdp import Task, generative_model, has_tables, tables
from curricle.tasks.observation_task import is_observation_task
from curricle.transfer.potential import AnyPotential

Opponent = Literal["constant", "bounds", "optimistic", "model-based"]
OFFERED: tuple[Opponent, ...] = get_args(Opponent)
OPPONENTS = OFFERED[:3]  # that play by default
CONSTANTS: dict[str, Callable[[FloatArray], Any]] = {
    "constant mean": np.mean,
    "constant minimum": np.min,
    "constant maximum": np.max,
}
"""Label of a constant -> the initial Q, computed from phi of the pairs that learning can visit."""


def check_opponents(opponents: object) -> tuple[Opponent, ...]:
    """Return opponents as a tuple, or raise SettingError."""
    if isinstance(opponents, str) or not isinstance(opponents, Collection):
        raise SettingError(f"opponents must be a list of names: got {opponents!r}")
    for opponent in opponents:
        one_of("an opponent", opponent, OFFERED, SettingError)
    return tuple(opponent for opponent in OFFERED if opponent in opponents)


# -- Learners from scratch: the target's own, a user's further learners, and the default ones ------

Learners = Sequence[Any] | Mapping[str, Any]  # further learners from scratch, by name in a dict


def from_scratch(curriculum: Curriculum, learner: object = None) -> Curriculum:
    """Return a curriculum's target without its sources, by default with its own learner."""
    target = curriculum.target
    which = [setting for setting in SETTINGS if setting not in OF_TARGETS]
    settings: Any = {setting: {target: curriculum.setting(setting, target)} for setting in which}
    if learner is not None:
        settings["learner"] = {target: learner}
    return Curriculum({target: curriculum.tasks[target]}, **settings)


def scratch_curricula(learners: Learners, first: Curriculum) -> dict[str, Curriculum]:
    """Return the arms of further learners from scratch by name, ``scratch, NAME``."""
    if not isinstance(learners, Mapping):
        instance("scratch, unless it names learners in a dict,", learners, Sequence, SettingError)
        named: Iterable[tuple[str, Any]] = [(_name(learner), learner) for learner in learners]
    else:
        named = learners.items()
    usual, arms = first.setting("learner", first.target), dict[str, Curriculum]()
    for name, learner in named:
        fit_name("a learner from scratch", name, SettingError)
        label = f"{SCRATCH}, {name}"
        if label in arms:
            raise SettingError(f"learners from scratch must differ: {name} is there twice")
        if learner == usual:
            raise SettingError(
                f"a further learner from scratch must differ from the target's own: {name} is "
                f"{usual}, which learns from scratch anyway"
            )
        try:
            arms[label] = from_scratch(first, learner)
        except (CurriculumError, SettingError) as error:
            raise SettingError(f"learner {name} from scratch: {error}") from None
    return arms


def unasked_learners(
    opponents: Collection[Opponent], scratches: Mapping[str, Curriculum]
) -> Iterator[tuple[str, Curriculum]]:
    """Yield the learners of opponents without a potential that no arm from scratch has yet."""
    usual = scratches[SCRATCH]
    task, learner = usual.tasks[usual.target], usual.setting("learner", usual.target)
    learners_so_far = [arm.setting("learner", arm.target) for arm in scratches.values()]
    if not starts_anywhere(learner) or not has_tables(task) or is_large(usual):
        return
    learners = list[Learner]()
    if "bounds" in opponents:
        with suppress(SettingError, TaskError):  # without a horizon rewards do not bound values
            learners += [replace(learner, initial_value=bound) for bound in value_bounds(task)]
    for name, optimist in (("optimistic", OptimisticQLearning()), ("model-based", RMax())):
        with suppress(SettingError, TaskError):
            learners += [optimist] if name in opponents and optimist.for_task(task) else []
    for opponent in learners:
        if opponent not in learners_so_far:
            learners_so_far.append(opponent)
            bound = not opponent.asks_task
            name = f"initial_value={opponent.initial_value:.4g}" if bound else _name(opponent)
            yield name, from_scratch(usual, opponent)


def starts_anywhere(learner: object) -> bool:
    """Return whether a learner's Q can start at any constant."""
    return isinstance(learner, Learner) and not learner.asks_task


def is_large(curriculum: Curriculum) -> bool:
    """Return whether a target has too many pairs for learners that keep several tables."""
    model = generative_model(curriculum.tasks[curriculum.target])
    sparse = curriculum.setting("storage", curriculum.target).kind == "sparse"
    return sparse or model.states.size * model.actions.size > MOST_SHARED


def _name(learner: object) -> str:
    """Return a learner as text, with the settings that are not the defaults of its class."""
    parts = []
    for setting in fields(learner) if is_dataclass(learner) else ():
        factory, value = setting.default_factory, getattr(learner, setting.name)
        if value != (setting.default if factory is MISSING else factory()):
            parts.append(f"{setting.name}={value}")
    return type(learner).__name__ + f"({', '.join(parts)})" * bool(parts)


# -- Constants: the level of a potential without its differences between pairs --------------------


def constants_of(
    opponents: Collection[Opponent], curriculum: Curriculum
) -> Iterator[tuple[str, Curriculum]]:
    """Yield the label of each constant of a curriculum, and the curriculum with that constant."""
    target = curriculum.target
    if "constant" not in opponents or is_observation_task(curriculum.tasks[target]):
        return
    if curriculum.has_potential(target) and starts_anywhere(curriculum.setting("learner", target)):
        plain = curriculum.replace(target, shaping=QInitialisation())
        yield from ((label, plain) for label in CONSTANTS)


def train_constant(
    label: str,
    curriculum: Curriculum,
    seeds: Sequence[int],
    potentials: Sequence[AnyPotential],
    options: TrainingOptions,
) -> tuple[LearningResult, FloatArray]:
    """Return the result in the target from a constant, and each seed's initial Q, (K,)."""
    node = curriculum.node(curriculum.target)
    states = visited_states(node.task, dense=node.storage.kind != "sparse")
    levels = [float(CONSTANTS[label](np.asarray(phi.pairs(states)))) for phi in potentials]
    # phi times 0 plus the level is a constant that is stored like phi.
    constants = [phi.rescaled(0.0, level) for phi, level in zip(potentials, levels, strict=True)]
    return node.train(seeds, constants, options), np.array(levels) + node.learner.initial_value


# The pairs that a learner of the target can visit: all pairs of the nonterminal states that some
# policy reaches from a start, unmapped pairs included. Where a target has no dense tables, they are
# the pairs of the states that rollouts of the uniformly random policy visit. Each pair counts once.
# No learner is charged for the rollouts.

EPISODES, LENGTH = 100, 1000  # number and longest length of the random rollouts


def visited_states(task: Task, *, dense: bool) -> IntArray:
    """Return the states of these pairs, every state once, (n,) int64."""
    if dense and has_tables(task):
        mdp = tables(task)
        return np.flatnonzero(reachable_states(mdp) & ~mdp.terminal)
    limit = min(generative_model(task).time_limit or LENGTH, LENGTH)
    steps, _ = random_rollouts(task, episodes=EPISODES, length=limit)
    return np.unique(steps.states)
