"""Two tasks with their exact values, which searches for mappings read, and their proposals."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.checks import brief, whole_number
from curricle.errors import SettingError, TaskError
from curricle.planning.rollouts import UniformPolicy, simulate
from curricle.planning.solution import EPSILON, Solution, evaluate, greedy_policy, solve
from curricle.tasks.kernel import stream_start
from curricle.tasks.live import open_model
from curricle.tasks.mdp import (
    FiniteMDP,
    Task,
    generative_model,
    has_tables,
    reachable_states,
    tables,
)
from curricle.text import brief_repr
from curricle.transfer.mapping import UNMAPPED, StateActionMapping

NOT_PROVEN = float("nan")
ENDLESS = 1_000  # steps that stand for the horizon of a task with discount 1 and no time limit


@dataclass(frozen=True, eq=False)
class TaskPair:
    """A target and a source with tables; the values that searches need are computed once.

    A discount of 1 is taken as 1 - 1/L, L the time limit (1,000 steps without one), so that values
    are bounded and distances between states contract. Tables of a task that has none are estimated
    from `samples` steps of the random policy, drawn with `seed`.

    Raises
    ------
    TaskError
        When a task has no tables and is not to be sampled.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> TaskPair(GridWorld("S..T"), GridWorld("S.T")).source_solution.values[:2]
    array([196.01, 199.  ])
    """

    target: Task
    source: Task
    samples: int | None = None
    seed: int = 0
    target_mdp: FiniteMDP = field(init=False, repr=False)
    source_mdp: FiniteMDP = field(init=False, repr=False)
    sampled: "dict[str, SampledTables]" = field(init=False, repr=False)  # of tasks without tables

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        if self.samples is not None:
            whole_number("samples", self.samples, 1, SettingError)
        object.__setattr__(self, "sampled", {})
        for role, task in (("target", self.target), ("source", self.source)):
            if self.samples is None and not has_tables(task) and hasattr(task, "model"):
                raise TaskError(
                    f"the {role} has no tables, which find_mappings(..., samples=20_000) estimates "
                    f"from steps: {brief(task)}"
                )
            if self.samples is None or has_tables(task):
                mdp = tables(task)
            else:
                self.sampled[role] = sampled_tables(task, self.samples, seed=self.seed)
                mdp = self.sampled[role].mdp
            if mdp.discount == 1:
                mdp = replace(mdp, discount=1 - 1 / max(2, mdp.time_limit or ENDLESS))
            object.__setattr__(self, f"{role}_mdp", mdp)

    @property
    def steps(self) -> int:
        """Steps that were taken in both tasks to estimate their tables."""
        return sum(estimate.steps for estimate in self.sampled.values())

    @property
    def knows_target(self) -> bool:
        """Whether the target's own tables are read; estimates are paid for with their steps."""
        return "target" not in self.sampled

    @cached_property
    def target_solution(self) -> Solution:
        """Exact values of the target."""
        return solve(self.target_mdp)

    @cached_property
    def source_solution(self) -> Solution:
        """Exact values of the source."""
        return solve(self.source_mdp)

    @cached_property
    def values_without(self) -> FloatArray:
        """Values of the target's random or myopic policy, (S,): whichever has the larger mean."""
        mdp = self.target_mdp
        rewards = (mdp.probability * mdp.reward).sum(axis=1)[mdp.outcome_row]
        policies = np.full(rewards.shape, 1 / rewards.shape[1]), greedy_policy(rewards)
        values = [evaluate(mdp, policy).values for policy in policies]
        return max(values, key=lambda by_policy: float(by_policy[self.judged].mean()))

    @cached_property
    def judged(self) -> BoolArray:
        """The target's states that an episode can be in and that do not end it, (S,) bool."""
        # Of a target that was sampled, those in which every action was tried.
        live = reachable_states(self.target_mdp) & ~self.target_mdp.terminal
        return live & self.sampled["target"].tried if "target" in self.sampled else live

    @cached_property
    def own_solutions(self) -> tuple[Solution, Solution] | None:
        """Both at their own discounts; None where one is sampled or has no finite Q*."""
        if self.sampled:
            return None
        judged = (self.target, self.target_solution), (self.source, self.source_solution)
        try:
            of_target, of_source = (
                s if tables(task).discount < 1 else solve(task) for task, s in judged
            )
        except SettingError:
            return None
        return of_target, of_source

    def bound(self, index: IntArray) -> float:
        """Return a bound of abs(Q* - Q* of the pair read) over mapped pairs; or `NOT_PROVEN`."""
        mapped = (index != UNMAPPED) & ~self.target_mdp.terminal[:, None]
        if self.own_solutions is None or not mapped.any():
            return NOT_PROVEN
        most = apart(index, *self.own_solutions)[mapped].max()
        error = sum(solution.error_bound for solution in self.own_solutions)
        return float((most + error) * (1 + 4 * EPSILON))

    def proposal(self, index: IntArray, how: str) -> "Proposal":
        """Return the proposal to read the source through an index, (S, A), and how it was found."""
        mapping = StateActionMapping(
            self.target, self.source, index, how=how, knows_target=self.knows_target
        )
        return Proposal(mapping, how, self.bound(index))


def apart(index: IntArray, of_target: Solution, of_source: Solution) -> FloatArray:
    """Return abs(Q*(s, a) - Q* of the pair that it reads), (S, A); NaN where it reads none."""
    read = np.where(index >= 0, of_source.action_values.ravel()[np.maximum(index, 0)], 0.0)
    return np.asarray(abs(of_target.action_values - np.where(index == UNMAPPED, np.nan, read)))


# -- what a search proposes ------------------------------------------------------------------------


class Proposal(NamedTuple):
    """A mapping that a search proposes.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.transfer import identity
    >>> Proposal(identity(GridWorld("S.T")), "by hand").how
    'by hand'
    """

    mapping: StateActionMapping
    how: str  # how it was found
    bound: float = NOT_PROVEN  # as in :class:`FoundMapping`, which computes it itself


def search_steps(transfers: Iterable[Any]) -> int:
    """Return the steps that the searches for the mappings of transfers took."""
    of_edge: dict[tuple[str, str], int] = {}
    for transfer in transfers:
        edge = transfer.source, transfer.target
        of_edge[edge] = max(of_edge.get(edge, 0), transfer.mapping.steps)
    return sum(of_edge.values())


# -- tables estimated from steps -------------------------------------------------------------------

LARGEST = 2_000_000  # state-action pairs of a task that is sampled
LONGEST = 1_000  # steps of an episode where the task has no time limit


@dataclass(frozen=True, eq=False)
class SampledTables:
    """Tables estimated from random steps in a task."""

    mdp: FiniteMDP  # outcomes by their frequencies; an untried pair stays, at the lowest reward
    tried: BoolArray  # (S,) states in which every action was taken at least once
    steps: int


def sampled_tables(task: Task, steps: int, *, seed: int = 0) -> SampledTables:
    """Return tables estimated from so many steps of the uniformly random policy."""
    steps = whole_number("steps to sample", steps, 1, SettingError)
    generative = generative_model(task)
    n_states, n_actions = generative.states.size, generative.actions.size
    n_pairs = n_states * n_actions
    if n_pairs > LARGEST:
        raise TaskError(
            f"tables are estimated for up to {LARGEST:,} pairs: the task has {n_pairs:,}"
        )
    states, actions, rewards, after, ended, starts = _transitions(generative, steps, seed)
    left, entered, ends = (
        np.bincount(visits, minlength=n_states) for visits in (states, after, after[ended])
    )
    terminal = (ends > entered / 2) & (left == 0)
    outcomes = (states * n_actions + actions) * n_states + after
    distinct, place, counts = np.unique(outcomes, return_inverse=True, return_counts=True)
    pair, reached = np.divmod(distinct, n_states)
    at = pair, np.arange(len(pair)) - np.searchsorted(pair, pair)  # numbered within each pair
    shape = n_pairs, int(at[1].max()) + 1
    chance, reward = np.zeros(shape), np.full(shape, float(rewards.min()))
    next_state = np.repeat(np.arange(n_pairs) // n_actions, shape[1]).reshape(shape)
    chance[at], next_state[at] = counts, reached
    reward[at] = np.bincount(place, weights=rewards) / counts
    tried = chance.sum(axis=1) > 0
    chance[~tried, 0] = 1.0
    mdp = FiniteMDP(
        states=generative.states,
        actions=generative.actions,
        outcome_row=np.arange(n_pairs).reshape(n_states, n_actions),
        probability=chance / chance.sum(axis=1, keepdims=True),
        next_state=next_state,
        reward=reward,
        terminal=terminal,
        start=np.bincount(starts, minlength=n_states) / len(starts),
        discount=min(generative.discount, 1 - 1 / max(2, generative.time_limit or LONGEST)),
        time_limit=generative.time_limit,
    )
    return SampledTables(mdp, tried.reshape(n_states, n_actions).all(axis=1), len(states))


def _transitions(task: Any, steps: int, seed: int) -> tuple[Any, ...]:
    """Return states, actions, rewards, next states, which ended, and the starts of episodes."""
    first = stream_start(seed, "sampled_tables")
    policy, stream = UniformPolicy(np.uint64(task.actions.size)), np.array([first], np.uint64)
    episodes, left = list[tuple[Any, ...]](), steps
    with open_model(task, first) as model:
        while left > 0:
            limit = min(left, task.time_limit or LONGEST)
            record, ends = simulate(model, policy, stream, episodes=1, limit=limit)
            n = len(record.states)
            if n == 0:  # the environment failed; leaving the context says why
                break
            after = np.append(record.states[1:], ends.last_states[0])
            ended = np.append(np.zeros(n - 1, bool), ends.terminated[0])
            episodes.append((*record, after, ended, record.states[:1]))
            left -= n
    return tuple(map(np.concatenate, zip(*episodes, strict=True)))
