"""Miniatures: small relatives of a task, solved exactly, that networks are distilled from.

:func:`miniatures` makes them, a :class:`SolvedMember` holds the tables and the optimum of one of
them, and :func:`learn_miniatures` distils networks from all.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.checks import instance, number, whole_number
from curricle.deep.knowledge import Knowledge
from curricle.deep.learner import DeepLearner
from curricle.deep.result import DeepResult
from curricle.errors import TaskError
from curricle.interop.tabulation.tabulate import tabulate
from curricle.interop.tabulation.tabulated_task import TabulatedTask
from curricle.learning.record import Record
from curricle.learning.result import learning_result
from curricle.learning.run import Outcome
from curricle.planning.solution import Solution, evaluate, solve
from curricle.progress import Progress, shown
from curricle.tasks.observation_task import ObservationTask, made_by

RESETS = 200
"""Resets of each miniature that levels are taken from."""
MOST_STATES = 100_000
"""States of a miniature at most."""
HELD_OUT = 0.2
"""Share of the levels that are held out."""
WORTH = 0.02
"""Of the way from random to optimal: what a network must regain on held-out levels at least."""


@dataclass(frozen=True)
class Miniatures(ObservationTask):
    """Small relatives of a task, made by :func:`miniatures`.

    In a :class:`Curriculum` it is a source like any other: it takes no steps, and what it hands on
    is a network of its learner's kind, fitted to exact answers (:func:`distil`).
    """

    members: tuple[ObservationTask, ...] = ()
    tested_on: tuple[ObservationTask, ...] = ()  # solved too, and all of whose levels are held out
    resets: int = RESETS
    held_out: float = HELD_OUT
    max_states: int = MOST_STATES
    shuffled: bool = False  # whether each observation has the answer of another: a placebo

    def __repr__(self) -> str:
        names = ", ".join(made_by(one.make) for one in self.members)
        placebo = ", shuffled" if self.shuffled else ""
        return f"Miniatures({names}; {self.resets} resets{placebo}, {self.shapes})"

    @cached_property
    def solved(self) -> "tuple[SolvedMember, ...]":
        """The members, solved; levels are drawn to be held out."""
        settings = self.resets, self.held_out, self.max_states
        return tuple(SolvedMember.of(one, *settings) for one in self.members)

    @cached_property
    def solved_tests(self) -> "tuple[SolvedMember, ...]":
        """The relatives that are only tested on, solved; all their levels are held out."""
        settings = self.resets, 1.0, self.max_states
        return tuple(SolvedMember.of(one, *settings) for one in self.tested_on)

    def knowledge(self, *, potential: Any = None, seed: int = 0) -> Knowledge:
        """Return what is distilled: exact answers, or what a potential says of these observations.

        `seed` is for the order of shuffled answers.
        """
        parts = [each.knowledge(potential) for each in self.solved]
        known = Knowledge.joined(parts)
        return known.shuffled(seed) if self.shuffled else known

    def examined(self, values: Any) -> "tuple[Examined, ...]":
        """Return how a network acts on held-out levels, by each member's tables.

        Those of `tested_on` come last. Returns are exact, and no step is taken.
        """
        return tuple(each.examined(values) for each in (*self.solved, *self.solved_tests))

    @property
    def transitions(self) -> int:
        """Steps of the small models: each action tried in each state, none of them charged."""
        return sum(each.table.record.transitions for each in self.solved)


def miniatures(
    *members: ObservationTask,
    resets: int = RESETS,
    held_out: float = HELD_OUT,
    max_states: int = MOST_STATES,
    tested_on: Sequence[ObservationTask] = (),
) -> Miniatures:
    """Return small relatives of a task as a source that takes no steps.

    Each member is tabulated (:func:`tabulate`) from so many resets and solved. Resets of the same
    level count once. A level is what can be reached from one reset; a share of the levels is held
    out, to see how well the network does there.

    Parameters
    ----------
    *members : ObservationTask
        With the observations and the actions of the task that is to learn from them.
    resets : int
    held_out : float
        Share of levels, up to 0.9; of each member at least one level is not held out.
    max_states : int
        Of each member; one with more is not small.
    tested_on : sequence of ObservationTask
        Relatives that are only tested on, best of growing size.

    Returns
    -------
    ObservationTask
        ``solved`` are its members with their tables and optima, ``knowledge()`` what is distilled
        of them, ``transitions`` the steps of their models, and ``examined(values)`` how a network
        acts on the levels held out.

    Raises
    ------
    TaskError
        When there is no member, or their spaces or discounts differ. When they are first asked for:
        a member cannot be tabulated.

    Examples
    --------
    >>> from curricle import observation_task
    >>> lakes = miniatures(observation_task("FrozenLake-v1", is_slippery=False), resets=1)
    >>> (lake,) = lakes.solved
    >>> lake.levels, lakes.transitions, float(lakes.knowledge().values.max())
    (1, 44, 1.0)
    """
    if not members:
        raise TaskError("miniatures need at least one member: got none")
    instance("tested_on of miniatures", tested_on, Sequence, TaskError)
    for one in (*members, *tested_on):
        instance("each of miniatures", one, ObservationTask, TaskError)
        if isinstance(one, Miniatures):
            raise TaskError(f"each of miniatures must be one environment: got {one}")
        if (one.observations, one.actions) != (members[0].observations, members[0].actions):
            raise TaskError(
                f"miniatures must have one space of observations and actions: {members[0]} and "
                f"{one} differ; an encoder makes observations alike"
            )
        if one.discount != members[0].discount:
            raise TaskError(f"miniatures must have one discount: {members[0]} and {one} differ")
    if members[0].n_actions is None:
        raise TaskError(f"miniatures need numbered actions: {members[0]} has {members[0].actions}")
    whole_number("resets of miniatures", resets, 1, TaskError)
    whole_number("max_states of miniatures", max_states, 1, TaskError)
    number("held_out of miniatures", held_out, TaskError, low=0, high=0.9)
    first = members[0]
    return Miniatures(
        first.make, first.discount, first.time_limit, tuple(members), tuple(tested_on), resets,
        held_out, max_states,
    )  # fmt: skip


class Examined(NamedTuple):
    """Expected discounted returns on held-out levels of a member, from their starts.

    Where none is held out, as of a member with a single level, on those that were trained on.
    """

    member: ObservationTask
    levels: int
    kind: str  # of level: "held-out level" or "training level"
    optimal: float
    random: float
    greedy: float
    sampled: float  # NaN without a policy of probabilities

    @property
    def best(self) -> float:
        """The better return of both ways to act."""
        return float(np.nanmax([self.greedy, self.sampled]))

    @property
    def regained(self) -> float:
        """Share of the way from the random policy to the optimum; NaN where they are equal."""
        gap = self.optimal - self.random
        if gap <= 1e-9 * max(abs(self.optimal), abs(self.random)):
            return float("nan")
        return (self.best - self.random) / gap


@dataclass(frozen=True, eq=False)
class SolvedMember:
    """A member's tables, their levels, and the optimum."""

    member: ObservationTask
    table: TabulatedTask
    level: IntArray  # (S,): of each state
    training: BoolArray  # (S,): whether the level is not held out; False for ends

    @classmethod
    def of(
        cls, member: ObservationTask, resets: int, held_out: float, max_states: int
    ) -> "SolvedMember":
        """Return a member solved, with a share of its levels held out."""
        try:
            table = tabulate(
                member.environment, discount=member.discount, seeds=resets, max_states=max_states
            )
        except TaskError as error:
            raise TaskError(
                f"the miniature {made_by(member.make)} has no tables: {error}"
            ) from error
        level = levels_of(table)
        levels = np.unique(level[table.mdp.start > 0])
        n_held = int(held_out * len(levels) + 0.5)
        if held_out < 1.0:
            n_held = min(n_held, len(levels) - 1)  # one is left to be distilled
        held = np.random.default_rng(0).permutation(levels)[:n_held]
        apart = np.isin(level, held)
        return cls(member, table, level, ~apart & ~table.mdp.terminal)

    @cached_property
    def solution(self) -> Solution:
        """The optimum of all levels."""
        return solve(self.table)

    @property
    def levels(self) -> int:
        """Different levels among the resets."""
        return len(np.unique(self.level[self.table.mdp.start > 0]))

    def knowledge(self, potential: Any = None) -> Knowledge:
        """Return what is known of the training levels; a potential may not know all states."""
        assert self.table.observations is not None
        rows = np.flatnonzero(self.training)
        seen = self.table.observations.batch(rows)
        if potential is None:
            q, policy = self.solution.action_values, self.solution.policy
            return Knowledge.of(seen, q[rows], policy[rows])
        return Knowledge.read(replace(potential, unknown_value=np.nan), seen)

    def examined(self, values: Any) -> Examined:
        """Return how a network acts on the held-out levels, on all where none is held out."""
        apart = np.where(self.training, 0.0, self.table.mdp.start)
        start = apart if apart.any() else self.table.mdp.start
        n_levels = len(np.unique(self.level[start > 0]))
        n_actions = self.table.actions.size
        random = np.full((self.table.states.size, n_actions), 1.0 / n_actions)

        def worth(policy: Any) -> float:
            found: FloatArray = evaluate(self.table, policy).values
            return float(found @ start / start.sum())

        return Examined(
            self.member,
            n_levels,
            "held-out level" if apart.any() else "training level",
            float(self.solution.values @ start / start.sum()),
            worth(random),
            worth(self.table.policy(values.policy)),
            worth(self.table.policy(values, deterministic=False))
            if values.kind == "value_net"
            else float("nan"),
        )


def levels_of(table: TabulatedTask) -> IntArray:
    """Return the level of each state, (S,): states that a path connects, ends left out."""
    from scipy.sparse import coo_array  # takes time, and few need it
    from scipy.sparse.csgraph import connected_components

    mdp = table.mdp
    live = np.flatnonzero(~mdp.terminal)
    rows = mdp.outcome_row[live]
    after = mdp.next_state[rows].reshape(len(live), -1)
    likely = mdp.probability[rows].reshape(len(live), -1) > 0
    connected = likely & ~mdp.terminal[after]
    here = np.repeat(live, connected.sum(axis=1))
    n = len(mdp.terminal)
    edges = coo_array((np.ones(len(here)), (here, after[connected])), shape=(n, n))
    _, found = connected_components(edges.tocsr(), directed=False)
    return np.asarray(found, np.int64)


def learn_miniatures(
    task: Miniatures,
    learner: DeepLearner,
    seeds: Sequence[int],
    potentials: Sequence[Any] = (),
    *,
    eval_freq: int = 1,
    progress: Progress = None,
) -> DeepResult:
    """Return networks fitted to what is known of miniatures, one for each seed, in no steps.

    ``greedy_return`` has one checkpoint: the exact discounted return of the network's policy on
    held-out levels, as :class:`Examined` has it, mean over members. Where there are `potentials`,
    one for each seed, the networks are fitted to what they say of the observations, instead of
    exact answers. TaskError when a network acts no better than at random there.
    """
    from curricle.deep.distillation import distil  # loads torch

    outcomes = []
    with shown(progress) as bars:
        grow = bars.bar("distilling", len(seeds))
        for k, seed in enumerate(seeds):
            known = task.knowledge(potential=potentials[k] if potentials else None, seed=seed)
            values = distil(known, task, learner, seed=seed)
            outcomes.append(_outcome(task, values))
            grow()
            bars.tell(seed)
    each: Any = tuple(one.values for one in outcomes)
    found = learning_result(task, learner, tuple(seeds), each, outcomes, eval_freq)  # type: ignore[arg-type]
    return DeepResult.of(found)


def _outcome(task: Miniatures, values: Any) -> Outcome:
    """Return what one seed learnt; TaskError if it is worth nothing."""
    examined = task.examined(values)[: len(task.members)]
    record = Record.empty(1)
    record.greedy_return[0] = np.mean([one.best for one in examined])
    shares = [one.regained for one in examined if not np.isnan(one.regained)]
    regained = np.mean(shares) if shares else 1.0
    if regained < WORTH and not task.shuffled:
        raise TaskError(
            "a network distilled from miniatures must act better than at random, on held-out "
            f"levels if any: it regains {regained:.0%} of the way to the optimum of {task}"
        )
    return Outcome(record, values, 0, 0, out_of_memory=False, evaluation_steps=0)
