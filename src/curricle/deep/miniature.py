"""Miniatures: small relatives of a task, which are solved exactly and distilled into networks."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from hashlib import blake2b
from typing import Any, NamedTuple, Self
from weakref import WeakSet

import numpy as np

from curricle.arrays import BoolArray, FloatArray, Frozen, IntArray, adopted
from curricle.checks import instance, number, whole_number
from curricle.errors import TaskError
from curricle.interop.play import without_counters
from curricle.interop.tabulated_task import TabulatedTask, assembled, parts_of
from curricle.interop.tabulation import MOST_SECONDS, Plan, tabulate
from curricle.planning.solution import Solution, evaluate, solve
from curricle.tasks.graph import edges_of
from curricle.tasks.observation_task import ObservationTask, made_by
from curricle.text import brief_repr

RESETS = 200  # resets of each miniature that levels are taken from
MOST_STATES = 100_000  # states of a miniature at most
HELD_OUT = 0.2  # share of the levels that are held out
TABLES = Plan(RESETS, max_states=MOST_STATES)  # how the tables of each member are made


@dataclass(frozen=True, eq=False)
class Knowledge(Frozen):
    """Values, action values and a policy over n different observations."""

    observations: Any  # n, stacked
    values: FloatArray  # (n,) V
    action_values: FloatArray  # (n, A) Q
    policy: FloatArray  # (n, A) the probability of each action
    states: IntArray  # (n,) how many states have this observation: its values are their mean

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        for name in ("values", "action_values", "policy"):
            object.__setattr__(self, name, adopted(getattr(self, name), np.float64))
        object.__setattr__(self, "states", adopted(self.states, np.int64))

    @classmethod
    def of(cls, observations: object, action_values: FloatArray, policy: FloatArray) -> Self:
        """Return the knowledge in action values and a policy, (S, A) each, of S observations."""
        q, states = np.asarray(action_values, np.float64), np.ones(len(action_values), int)
        return cls._merged(observations, q.max(axis=1), q, np.asarray(policy), states)

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Return the knowledge of all parts, with means weighted by the parts' states."""
        leaves_of = [parts_of(part.observations) for part in parts]
        stacked = {
            name: np.concatenate([leaves[name] for leaves in leaves_of]) for name in leaves_of[0]
        }
        names = "values", "action_values", "policy", "states"
        columns = (np.concatenate([getattr(part, name) for part in parts]) for name in names)
        return cls._merged(assembled(stacked), *columns)

    @property
    def alike(self) -> float:
        """The share of states that have the observation of another state."""
        return float(self.states[self.states > 1].sum() / self.states.sum())

    def shuffled(self, seed: int) -> Self:
        """Return the same values and policies in random order over the observations."""
        order = np.random.default_rng(seed).permutation(len(self.values))
        columns = self.values[order], self.action_values[order], self.policy[order]
        return type(self)(self.observations, *columns, self.states[order])

    @classmethod
    def _merged(
        cls,
        observations: object,
        values: FloatArray,
        action_values: FloatArray,
        policy: FloatArray,
        states: IntArray,
    ) -> Self:
        """Return the means over equal observations, weighted by the states that each stands for."""
        leaves = [np.ascontiguousarray(part) for part in parts_of(observations).values()]
        numbers = dict[bytes, int]()
        group = np.empty(len(states), np.int64)
        for row in range(len(states)):
            # Digests: observations may be pictures, and all their bytes would be kept twice.
            key = blake2b(b"".join(leaf[row].tobytes() for leaf in leaves), digest_size=16).digest()
            group[row] = numbers.setdefault(key, len(numbers))
        weight = np.bincount(group, states)

        def mean(column: FloatArray) -> FloatArray:
            total = np.zeros((len(numbers), *column.shape[1:]))
            np.add.at(total, group, (column.T * states).T)
            return np.asarray((total.T / weight).T)

        first = np.unique(group, return_index=True)[1]
        means = mean(values), mean(action_values), mean(policy)
        return cls(rows_of(observations, first), *means, weight)


def rows_of(observations: object, rows: IntArray | BoolArray) -> Any:
    """Return some of n stacked observations."""
    return assembled({name: part[rows] for name, part in parts_of(observations).items()})


@dataclass(frozen=True)
class Miniatures(ObservationTask):
    """Small relatives of a task, made by :func:`miniatures`."""

    members: tuple[ObservationTask, ...] = ()
    tested_on: tuple[ObservationTask, ...] = ()  # solved too, and all of whose levels are held out
    plan: Plan = TABLES
    held_out: float = HELD_OUT
    charged: int = 1  # steps that an arm pays for each action in each state
    shuffled: bool = False  # whether each observation has the answer of another: a placebo

    def __repr__(self) -> str:
        names = ", ".join(made_by(member.make) for member in self.members)
        kind = ", not charged" * (not self.charged) + ", shuffled" * self.shuffled
        return f"Miniatures({names}; {len(self.plan.seeds)} resets{kind}, {self.shapes})"

    @cached_property
    def solved(self) -> "tuple[SolvedMember, ...]":
        """The solved members, some of whose levels are held out at random."""
        return tuple(SolvedMember.of(member, self.plan, self.held_out) for member in self.members)

    @cached_property
    def solved_tests(self) -> "tuple[SolvedMember, ...]":
        """The solved relatives for tests only, all of whose levels are held out."""
        return tuple(SolvedMember.of(member, self.plan, 1.0) for member in self.tested_on)

    def knowledge(self, *, seed: int = 0) -> Knowledge:
        """Return the knowledge to distil: exact values and policies of all training levels."""
        knowledge = Knowledge.joined([member.knowledge() for member in self.solved])
        return knowledge.shuffled(seed) if self.shuffled else knowledge

    def examined(self, values: object) -> "tuple[Examined, ...]":
        """Return a network's exact returns on held-out levels; `tested_on` come last."""
        return tuple(member.examined(values) for member in (*self.solved, *self.solved_tests))

    @property
    def transitions(self) -> int:
        """Steps in the small models, each action in each state once, or as often as is sampled."""
        tries = self.plan.samples or 1
        return tries * sum(member.table.record.transitions for member in self.solved)

    @property
    def cost(self) -> int:
        """The steps that an arm is charged: `transitions`, each `charged` times."""
        return self.transitions * self.charged


def miniatures(
    *members: ObservationTask,
    resets: int = RESETS,
    held_out: float = HELD_OUT,
    max_states: int = MOST_STATES,
    max_seconds: float = MOST_SECONDS,
    state: object = None,
    samples: int | None = None,
    charged: int = 1,
    tested_on: Sequence[ObservationTask] = (),
) -> Miniatures:
    """Return small relatives of a task as a source that takes no steps in an environment.

    Each member is tabulated (:func:`tabulate`) from its resets and solved. A level is the set of
    states that can be reached from a reset. A share of the levels is held out, to test the network.

    Parameters
    ----------
    *members : ObservationTask
        Relatives with the observations and the actions of the task that is to learn from them.
    resets : int
        Resets of each member.
    max_states, max_seconds, state : optional
        Limits of each member's table, and how its states are saved, as in :func:`tabulate`; but by
        default without counters of steps, which nothing else may depend on.
    samples : int, optional
        Steps from which each action's outcomes in each state are estimated where they are random;
        as many are charged.
    held_out : float
        Share of levels to hold out, up to 0.9; at least one level of each member is not held out.
    charged : int
        Steps of the source that each action in each state counts as, once however many seeds are
        distilled from it; :func:`compare` charges them as it charges learning. It is n for members
        each of whose actions is held for n steps; 0 leaves the models' steps out.
    tested_on : sequence of ObservationTask
        Relatives for tests only, best in the order of their size.

    Returns
    -------
    ObservationTask
        ``solved`` are its members with tables and optima, ``knowledge()`` is distilled,
        ``transitions`` are the steps in the models, to which those of `tested_on` do not belong,
        ``examined(values)`` are the returns of a network on held-out levels.

    Raises
    ------
    TaskError
        When there is no member, their spaces or discounts differ, or (later) a member has no table.

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
    first = members[0]
    for member in (*members, *tested_on):
        instance("each of miniatures", member, ObservationTask, TaskError)
        if isinstance(member, Miniatures):
            raise TaskError(f"a member of miniatures must be one environment: got {member}")
        if (member.observations, member.actions) != (first.observations, first.actions):
            raise TaskError(
                f"miniatures must have one space of observations and actions: {first} and "
                f"{member} differ; an encoder makes observations alike"
            )
        if member.discount != first.discount:
            raise TaskError(f"miniatures must have one discount: {first} and {member} differ")
    if first.n_actions is None:
        raise TaskError(f"miniatures need numbered actions: {first} has {first.actions}")
    whole_number("resets of miniatures", resets, 1, TaskError)
    number("held_out of miniatures", held_out, TaskError, low=0, high=0.9)
    whole_number("charged of miniatures", charged, 0, TaskError)
    plan = Plan(resets, state, samples=samples, max_states=max_states, max_seconds=max_seconds)
    return Miniatures(
        first.make, first.discount, first.time_limit, tuple(members), tuple(tested_on), plan,
        held_out, charged,
    )  # fmt: skip


class Examined(NamedTuple):
    """Expected discounted returns on a member's held-out levels, or on its training levels."""

    member: ObservationTask
    levels: int
    kind: str  # of level: "held-out level" or "training level"
    optimal: float
    random: float
    greedy: float
    sampled: float  # NaN without a policy of probabilities

    @property
    def best(self) -> float:
        """The higher return of acting greedily and of sampling actions."""
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
    settings: tuple[Plan, float]  # and the share held out
    table: TabulatedTask
    level: IntArray  # (S,): of each state
    training: BoolArray  # (S,): whether the level is not held out; False for ends

    @classmethod
    def of(cls, member: ObservationTask, plan: Plan, held_out: float) -> "SolvedMember":
        """Return a member solved, with a share of its levels held out."""
        for solved in list(IN_USE):
            if solved.settings == (plan, held_out) and solved.member == member:
                return solved
        try:
            with closing(member.environment()) as env:
                state = plan.state or without_counters(env)
            table = tabulate(
                member.make,
                discount=member.discount,
                time_limit=member.time_limit or "own",
                **{**vars(plan), "state": state},
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
        training = ~np.isin(level, held) & ~table.mdp.terminal
        solved = cls(member, (plan, held_out), table, level, training)
        IN_USE.add(solved)
        return solved

    @cached_property
    def solution(self) -> Solution:
        """The optimum of all levels."""
        return solve(self.table)

    @property
    def levels(self) -> int:
        """Different levels among the resets."""
        return len(np.unique(self.level[self.table.mdp.start > 0]))

    def knowledge(self) -> Knowledge:
        """Return the knowledge of training levels."""
        assert self.table.observations is not None
        rows = np.flatnonzero(self.training)
        q, policy = self.solution.finite_action_values, self.solution.policy
        return Knowledge.of(self.table.observations.batch(rows), q[rows], policy[rows])

    def examined(self, values: Any) -> Examined:
        """Return a network's returns on the held-out levels, or on all if none is held out."""
        held_out_start = np.where(self.training, 0.0, self.table.mdp.start)
        held_out = bool(held_out_start.any())
        start = held_out_start if held_out else self.table.mdp.start
        size = self.table.states.size, self.table.actions.size

        def worth(policy: object) -> float:
            return float(evaluate(self.table, policy).values @ start / start.sum())

        sampled = float("nan")
        if values.kind == "value_net":
            sampled = worth(self.table.policy(values, deterministic=False))
        return Examined(
            self.member,
            levels=len(np.unique(self.level[start > 0])),
            kind="held-out level" if held_out else "training level",
            optimal=float(self.solution.values @ start / start.sum()),
            random=worth(np.full(size, 1.0 / size[1])),
            greedy=worth(self.table.policy(values.policy)),
            sampled=sampled,
        )


IN_USE: WeakSet[SolvedMember] = WeakSet()
"""Members that some miniatures hold: arms and placebos with equal members share their tables."""


def levels_of(table: TabulatedTask) -> IntArray:
    """Return the level of each state, (S,): states connected by paths that avoid ends."""
    from scipy.sparse import coo_array  # takes time, and few need it
    from scipy.sparse.csgraph import connected_components

    mdp, (state, successor) = table.mdp, edges_of(table.mdp)
    ends = np.concatenate([mdp.terminal, np.zeros(len(mdp.probability), bool)])
    inner = ~ends[successor]
    edges = np.ones(int(inner.sum())), (state[inner], successor[inner])
    graph = coo_array(edges, shape=(len(ends), len(ends))).tocsr()
    labels = connected_components(graph, directed=False)[1]
    return np.asarray(labels[: len(mdp.terminal)], np.int64)
