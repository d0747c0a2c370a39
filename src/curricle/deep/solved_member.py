"""A miniature's tables and levels, solved, and how well a network acts in them."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from curricle.array_types import BoolArray, FloatArray, IntArray
from curricle.deep.knowledge import Knowledge
from curricle.errors import TaskError
from curricle.interop.tabulation.tabulate import tabulate
from curricle.interop.tabulation.tabulated_task import TabulatedTask
from curricle.planning.solution import Solution, evaluate, solve
from curricle.tasks.observation_task import ObservationTask, made_by


class Examined(NamedTuple):
    """Expected discounted returns on held-out levels of a member, from their starts.

    Where a member has a single level, on that.
    """

    member: ObservationTask
    levels: int
    states_a_level: float
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
    """A member's tables, their levels, and the optimum.

    Attributes
    ----------
    table : TabulatedTask
    level : (S,) int64
        The level of each state.
    training : (S,) bool
        Whether its level is not held out. False for ends.
    """

    member: ObservationTask
    table: TabulatedTask
    level: IntArray
    training: BoolArray

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
        rows = np.flatnonzero(self.training)
        if potential is None:
            solution = self.solution
            return Knowledge.of_states(self.table, rows, solution.action_values, solution.policy)
        assert self.table.observations is not None
        seen = self.table.observations.batch(rows)
        return Knowledge.read(replace(potential, unknown_value=np.nan), seen)

    def examined(self, values: Any) -> Examined:
        """Return how a network acts on the held-out levels."""
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
            (~self.table.mdp.terminal).sum() / self.levels,
            float(self.solution.values @ start / start.sum()),
            worth(random),
            worth(self.table.policy(values.policy)),
            worth(self.table.policy(values, deterministic=False))
            if values.kind == "value_net"
            else float("nan"),
        )


def levels_of(table: TabulatedTask) -> IntArray:
    """Return the level of each state, (S,): states that a path connects, ends left out.

    Examples
    --------
    >>> import curricle as cr
    >>> len(set(levels_of(cr.tabulate("FrozenLake-v1", discount=0.9)).tolist()))
    6
    """
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
