"""Controls: arms that equal a curriculum except for the part that is supposed to help.

- ``random_start``: the source is the target with a uniform start, for as many steps. If it helps as
  much, visiting many states helped, not the easier task.
- ``pretraining``: the source is the target itself, for as many steps. If it helps as much, the
  longer training helped.
- ``placebo``: phi's values shuffled over the target's pairs. If it helps as much, any values do.
- ``constant``: the mean of phi everywhere, and its maximum, over the pairs that learning can visit.
  If one helps as much, phi's optimism did it: a higher ``initial_value`` needs no source.
- ``scaled``: phi halved and doubled. If one of them is much better, phi had the wrong scale.
- ``negated``: -phi. It should do harm if phi helps.
- ``unrelated``: the exact values of a random task, by the best mapping that is found from there: a
  source whose pairs lead where other pairs of it led. If it helps as much, the search helped, which
  reads the target's model.

``placebo`` and ``constant`` know nothing of the task. In an observation task, which has no numbered
states, there is no ``random_start``, and a ``placebo`` only of miniatures: each observation has the
answer of another. ``scaled`` and ``constant`` need no dense tables.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, Self, get_args

import numpy as np

from curricle.arrays import FloatArray, IntArray
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.node import calibrated
from curricle.curriculum.result import CurriculumResult, Learnt, SourceValues
from curricle.deep.miniature import Miniatures
from curricle.errors import CurriculumError, MappingError
from curricle.learning.learners import Learner
from curricle.learning.potential import PairPotential, StateActionPotential
from curricle.learning.result import LearningResult, joined_results
from curricle.learning.shaping import LookAheadAdvice, QInitialisation, StateShaping
from curricle.learning.stopping import StoppingRule
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.planning.rollouts import random_rollouts
from curricle.tasks.gridworld import GridWorld
from curricle.tasks.mdp import generative_model, has_tables, reachable_states, tables
from curricle.tasks.observation_task import is_observation_task
from curricle.text import brief_repr
from curricle.transfer.by_components import identity
from curricle.transfer.calibration import AnyPotential, Calibration
from curricle.transfer.pair import TaskPair
from curricle.transfer.potential import ObservationPotential
from curricle.transfer.rollouts import ObservationTarget
from curricle.transfer.search import find_mappings
from curricle.transfer.transfer import Transfer

Control = Literal[
    "random_start", "pretraining", "placebo", "constant", "scaled", "negated", "unrelated"
]
CONTROLS: tuple[Control, ...] = get_args(Control)
PLACEBO, CONSTANT_MEAN, CONSTANT_MAXIMUM = "placebo", "constant mean", "constant maximum"
KNOW_NOTHING = (PLACEBO, CONSTANT_MEAN, CONSTANT_MAXIMUM)  # labels of controls that know nothing
UNRELATED = "unrelated"
WITHOUT_TABLES = ("constant", "scaled")  # controls that need no dense tables of the target
SOURCE = "control source"


def check_fit(controls: Sequence[str], arm: str, curriculum: Curriculum) -> None:
    """Raise CurriculumError unless a curriculum's target can be learnt with these controls."""
    name = curriculum.target
    if controls and not curriculum.in_edges(name):
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
        for edge in curriculum.in_edges(name) if UNRELATED in controls else ():
            tables(curriculum.tasks[edge.source])


def _check_observed(controls: Sequence[str], arm: str, curriculum: Curriculum) -> None:
    name, shaping = curriculum.target, curriculum.setting("shaping", curriculum.target)
    sources = [curriculum.tasks[edge.source] for edge in curriculum.in_edges(name)]
    all_miniatures = all(isinstance(source, Miniatures) for source in sources)
    for control in controls:
        if control == "placebo" and all_miniatures:
            continue
        if control in ("random_start", "placebo", UNRELATED):
            raise CurriculumError(
                f"a control {control!r} needs numbered states: {name!r}, the target of arm "
                f"{arm!r}, is seen through observations"
            )
        if control != "pretraining" and not shaping.reads_values:
            raise CurriculumError(
                f"a control {control!r} changes the values of a potential: the target of arm "
                f"{arm!r} has the shaping {shaping.name}, which does not read them"
            )


def shuffled_miniatures(curriculum: Curriculum) -> Curriculum:
    """Return a curriculum with answers in its miniatures shuffled over observations."""
    tasks: dict[str, Any] = dict(curriculum.tasks)
    for name, task in tasks.items():
        if isinstance(task, Miniatures):
            tasks[name] = replace(task, shuffled=True)
    transfers = []
    for edge in curriculum.transfers:
        source, target = tasks[edge.source], tasks[edge.target]
        if isinstance(source, Miniatures) or isinstance(target, Miniatures):
            edge = replace(edge, mapping=replace(edge.mapping, source=source, target=target))
        transfers.append(edge)
    return replace(curriculum, tasks=tasks, transfers=transfers)


def source_control(curriculum: Curriculum, label: str, steps: int) -> Curriculum:
    """Return a curriculum whose only source is its target, trained for `steps`."""
    name, task = curriculum.target, curriculum.tasks[curriculum.target]
    source = task
    if label == "random start" and isinstance(task, GridWorld):
        source = task.with_start("uniform")
    elif label == "random start":
        mdp = tables(task)
        source = replace(mdp, start=~mdp.terminal / (~mdp.terminal).sum())
    storage = curriculum.setting("storage", name)
    both = {
        which: dict.fromkeys((SOURCE, name), curriculum.setting(which, name))
        for which in ("learner", "evaluation")
    }
    return Curriculum(
        tasks={SOURCE: source, name: task},
        transfers=[Transfer(SOURCE, name, identity(task, source))],
        shaping={name: curriculum.setting("shaping", name)},
        budget={SOURCE: StoppingRule(steps), name: curriculum.setting("budget", name)},
        eval_freq={SOURCE: steps, name: curriculum.setting("eval_freq", name)},
        storage={SOURCE: replace(storage, save_values=True), name: storage},
        **both,
    )


Change = Callable[[Any, int, "VisitedPairs"], AnyPotential]  # phi, seed, visited pairs -> another
CHANGES: dict[str, Change] = {
    PLACEBO: lambda phi, seed, _: _shuffled(phi, seed),
    CONSTANT_MEAN: lambda phi, _, pairs: phi.rescaled(0.0, float(pairs.values(phi).mean())),
    CONSTANT_MAXIMUM: lambda phi, _, pairs: phi.rescaled(0.0, float(pairs.values(phi).max())),
    "scaled x 0.5": lambda phi, *_: phi.rescaled(0.5),
    "scaled x 2": lambda phi, *_: phi.rescaled(2.0),
    "negated": lambda phi, *_: (
        phi.rescaled(-1.0)
        if isinstance(phi, ObservationPotential)
        else StateActionPotential(phi.task, -phi.values)
    ),
}
"""What the controls that change a potential do to it, by their labels."""
LABELS: dict[Control, tuple[str, ...]] = {
    "placebo": (PLACEBO,),
    "constant": (CONSTANT_MEAN, CONSTANT_MAXIMUM),
    "scaled": ("scaled x 0.5", "scaled x 2"),
    "negated": ("negated",),
    "unrelated": (UNRELATED,),
    "random_start": ("random start",),
    "pretraining": ("pretraining",),
}
"""The arms that each control stands for, in the order in which they follow their curriculum."""


def control_arms(
    controls: Sequence[Control], curriculum: Curriculum
) -> Iterator[tuple[str, Curriculum]]:
    """Yield the label of each control arm of a curriculum, and the curriculum that it learns by."""
    for control, labels in LABELS.items():
        for label in labels if control in controls else ():
            shuffled = is_shuffled(label, curriculum)
            yield label, shuffled_miniatures(curriculum) if shuffled else curriculum


def is_shuffled(label: str, curriculum: Curriculum) -> bool:
    """Return whether a control arm learns from miniatures with shuffled answers."""
    return label == PLACEBO and is_observation_task(curriculum.tasks[curriculum.target])


def train_control(
    label: str,
    curriculum: Curriculum,
    seeds: Sequence[int],
    sources: Mapping[str, SourceValues],
    potentials: Sequence[AnyPotential] = (),
    calibrations: Sequence[Calibration] = (),
    **how: Any,
) -> tuple[LearningResult, IntArray, "Level | None"]:
    """Return the results of seeds in the target of a control arm, their charges, and its level."""
    # Every control is charged the steps of the curriculum's `sources`.
    name = curriculum.target
    spent = CurriculumResult(curriculum, {}, {}, given=sources).source_steps(name)
    if is_shuffled(label, curriculum):
        trained = curriculum.train(seeds, only=name, trained=sources, charge=True, **how)
        return trained[name], spent, None
    if label == UNRELATED:
        numbers, parts = np.array(seeds), []
        for draw in np.unique(numbers % DRAWS).tolist():
            some = numbers % DRAWS == draw
            taken, edges = unrelated_transfers(curriculum, numbers[some].tolist(), draw)
            of_draw = taken[edges[0].source].seeds, spent[some]
            phi, fitted = entering(curriculum, name, taken, *of_draw, edges)
            warm_ups = [calibration.warm_up for calibration in fitted]
            charged = {"warm_ups": warm_ups, "charged": spent[some]}
            parts.append(curriculum.node(name).train(of_draw[0], phi, **charged, **how))
        return joined_results(parts), spent, None
    if label not in CHANGES:
        parts = []
        for steps in np.unique(spent):
            some = [seeds[k] for k in np.flatnonzero(spent == steps).tolist()]
            changed_source = source_control(curriculum, label, int(steps))
            parts.append(changed_source.train(some, charge=True, **how)[name])
        return joined_results(parts), spent, None
    node, pairs = curriculum.node(name), VisitedPairs.of(curriculum)
    if not potentials:
        potentials, calibrations = entering(curriculum, name, sources, seeds, spent)
    changed = [CHANGES[label](phi, k, pairs) for phi, k in zip(potentials, seeds, strict=True)]
    warm_ups = [calibration.warm_up for calibration in calibrations]
    result = node.train(seeds, changed, warm_ups=warm_ups, charged=spent, **how)
    if label not in KNOW_NOTHING:
        return result, spent, None
    # A constant potential is another initial value where a table learns and the shaping allows it.
    constant, learner = label != PLACEBO, node.learner
    same = constant and isinstance(node.shaping, SAME_AS_INITIAL_VALUE)
    base = learner.initial_value if same and isinstance(learner, Learner) else None
    means = np.array([pairs.values(phi).mean() for phi in changed])
    return result, spent, Level(means, base, constant)


def entering(
    curriculum: Curriculum,
    name: str,
    sources: Mapping[str, Learnt],
    seeds: Sequence[int],
    spent: IntArray | None = None,
    transfers: Sequence[Transfer] | None = None,
) -> tuple[Sequence[Any], list[Calibration]]:
    """Return the potentials that seeds begin a task with, and their calibrations, if any."""
    potentials = curriculum.potentials(name, sources, transfers=transfers)
    if (settings := curriculum.calibration(name)) is None:
        return potentials, []
    calibrations = calibrated(curriculum.node(name), potentials, settings, seeds, spent)
    return [calibration.potential for calibration in calibrations], calibrations


DRAWS = 3  # unrelated tasks, which seeds take in turn: not all may be as easy to map


def unrelated_transfers(
    curriculum: Curriculum, seeds: Sequence[int], draw: int
) -> tuple[dict[str, SourceValues], list[Transfer]]:
    """Return unrelated sources with their exact values, and transfers by the mappings found."""
    target, sources, edges = curriculum.tasks[curriculum.target], dict[str, SourceValues](), []
    for edge in curriculum.in_edges(curriculum.target):
        mdp = tables(curriculum.tasks[edge.source])
        rows, live = mdp.outcome_row.copy(), ~mdp.terminal
        rng = np.random.default_rng([draw, 2])
        rows[live] = rng.permutation(rows[live].ravel()).reshape(-1, rows.shape[1])
        task = replace(mdp, outcome_row=rows)
        if not len(best := find_mappings(target, task, keep=1)):
            raise MappingError(
                f"a control {UNRELATED!r} needs a mapping from a random task of the size of "
                f"{edge.source!r}: no search finds any"
            )
        mapping, fits = best[0].mapping, best[0].unmapped_value
        if fits is not None and edge.mapping.unmapped_value is not None:
            mapping = mapping.with_unmapped_value(fits)
        edges.append(replace(edge, mapping=mapping))
        values = TaskPair(target, task).source_solution.action_values
        copies = np.broadcast_to(values, (len(seeds), *values.shape))
        no_steps = np.zeros(len(seeds), np.int64)
        sources[edge.source] = SourceValues(task, tuple(seeds), copies, no_steps)
    return sources, edges


def _shuffled(phi: PairPotential, seed: int) -> AnyPotential:
    """Return phi with its values permuted over all pairs that are not terminal."""
    values, ends = phi.values.copy(), tables(phi.task).terminal
    alive = values[~ends]
    values[~ends] = np.random.default_rng([seed, 1]).permutation(alive.ravel()).reshape(alive.shape)
    return StateActionPotential(phi.task, values)


# -- How optimistic a potential is -----------------------------------------------------------------
#
# Its values over the pairs of the states that some policy can reach from a start and in which no
# episode ends, each pair counted once, with what stands where no mapping knows anything: all that a
# learner of the target can meet, and nothing that it cannot. Where a target has no dense tables,
# they are the pairs of the states that rollouts of the uniformly random policy visit; with
# observations, those of the policy that the potential gives, as a forecast reads it. No learner is
# charged for them.

EPISODES, LENGTH = 100, 1000  # random rollouts without dense tables, and their most steps
SAME_AS_INITIAL_VALUE = (QInitialisation, LookAheadAdvice, StateShaping)  # (Wiewiora 2003)


@dataclass(frozen=True, eq=False)
class Level:
    """The constants that a control without knowledge adds to every value, for K seeds."""

    values: FloatArray  # (K,): mean of its potential over the pairs that learning can visit
    # The learner's own initial value, to which it is added; None where the control is not the same
    # as another initial value.
    base: float | None
    constant: bool  # whether every pair has this value

    __repr__ = brief_repr

    @property
    def mean(self) -> float:
        """The mean over seeds."""
        return float(self.values.mean())

    @property
    def initial_value(self) -> float | None:
        """The initial value that equals it, on average over seeds; None if there is none."""
        return None if self.base is None else self.base + self.mean

    @property
    def arrays(self) -> dict[str, FloatArray]:
        """The arrays that a file holds, with a number for each seed: NaN for no base."""
        base = np.nan if self.base is None else self.base
        return {"level": self.values, "level_base": np.full(len(self.values), base)}

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, Any], constant: bool) -> Self:
        """Return the level that a file holds; ValueError where its arrays do not fit."""
        for name in ("level", "level_base"):
            array = arrays.get(name)
            if array is None or array.shape != arrays["seeds"].shape or array.dtype != "float64":
                raise ValueError(f"{name} must be a number of float64 for each seed")
        base = float(arrays["level_base"][0])
        return cls(arrays["level"], None if np.isnan(base) else base, constant)


@dataclass(frozen=True, eq=False)
class VisitedPairs:
    """The pairs of a task that learning can visit."""

    task: Any
    dense: bool  # whether all that can be reached is counted, rather than what rollouts visit

    @classmethod
    def of(cls, curriculum: Curriculum) -> Self:
        """Return the pairs of a curriculum's target."""
        task = curriculum.tasks[curriculum.target]
        sparse = curriculum.setting("storage", curriculum.target).kind == "sparse"
        return cls(task, has_tables(task) and not sparse and not is_observation_task(task))

    @cached_property
    def states(self) -> IntArray:
        """The states of these pairs without repetition, (n,) int64; tasks with numbered states."""
        if self.dense:
            mdp = tables(self.task)
            return np.flatnonzero(reachable_states(mdp) & ~mdp.terminal)
        limit = min(generative_model(self.task).time_limit or LENGTH, LENGTH)
        rollouts = random_rollouts(self.task, episodes=EPISODES, length=limit)
        return np.unique(rollouts.states[:, :-1][rollouts.taken])

    def values(self, phi: AnyPotential) -> FloatArray:
        """Return phi of these pairs, a float64 array with one value for each."""
        if not isinstance(phi, ObservationPotential):
            return np.asarray(phi.pairs(self.states))
        seen = ObservationTarget(self.task, GreedyEvaluation()).observations(phi)
        return np.asarray(phi.pairs(seen) if phi.of_actions else phi.v(seen))
