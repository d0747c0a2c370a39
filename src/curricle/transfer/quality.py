"""How realistic a potential is in its target: where it starts, what it overrates and underrates.

Against Q* where the target can be solved; else against what the potential's own policy earns.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from curricle.learning.potential_rollouts import (
    GreedyRollouts,
    PairPotential,
    greedy_rollouts,
    greedy_start,
)
from curricle.planning.solution import Solution, right_choices
from curricle.planning.target import Target
from curricle.tasks.reachable import reachable_states
from curricle.tasks.task import Task, tables

FloatArray = npt.NDArray[np.float64]
RANKED = 200_000
"""Pairs that a rank correlation is taken over at most; drawn without repetition where fewer."""


@dataclass(frozen=True)
class PotentialQuality:
    """How a potential compares with what its target is worth.

    Attributes
    ----------
    start : float
        Expected return of its greedy policy: where learning starts.
    optimistic : float
        Share of pairs (s, a) with phi > Q*.
    excess : float
        Mean of phi - Q*.
    size : float
        Mean of abs(V*), to see an excess against.
    rank : float
        Spearman's rank correlation of phi and Q*; NaN where one of them does not vary.
    right : float
        Share of states in which what phi prefers is optimal; NaN unless exact.
    largest_underestimate : float
        The worst that phi does to a state on the way of optimal policies: how much less it
        promises there than both the truth and silence (0) would. What is spoken ill of is avoided,
        and so the error stays. NaN unless exact.
    most_underestimated_state : int
        Where that is; -1 if nowhere.
    exact : bool
        Against Q*. Otherwise over the steps of its own greedy episodes, whose return from there
        on, which Q* exceeds, takes the place of Q*.

    Examples
    --------
    >>> from curricle import GridWorld, StateActionPotential
    >>> target = Target.of(GridWorld("S.T", discount=0.5))
    >>> phi = StateActionPotential(target.task, target.solution.action_values + 1)
    >>> found = potential_quality(phi, target)
    >>> found.start, found.optimistic, found.excess, round(found.rank, 3), found.right
    (98.5, 1.0, 1.0, 1.0, 1.0)
    """

    start: float
    optimistic: float
    excess: float
    size: float
    rank: float
    right: float
    largest_underestimate: float
    most_underestimated_state: int
    exact: bool


def potential_quality(
    potential: PairPotential, target: Target, *, seed: int = 0
) -> PotentialQuality:
    """Return how a potential compares with what its target is worth.

    Parameters
    ----------
    potential : StateActionPotential or MappedPotential
        Of the target's task.
    target : Target
    seed : int
        Of rollouts, where there are any, and of the pairs that are ranked.
    """
    start = greedy_start(potential, target.evaluation, seed=seed)
    if target.solution is None:
        episodes = target.evaluation.rollouts(target.task)
        met = greedy_rollouts(potential, episodes=episodes, seed=seed, stream="realism")
        return along_its_way(met, start, seed)
    mdp = tables(target.task)
    alive = ~mdp.terminal
    phi, q = potential.values[alive], target.solution.action_values[alive]
    # What the proven error of Q* cannot tell from Q* is not above it.
    above = phi > q + target.solution.error_bound
    gloom, where = _gloom(potential, target.solution, target.task)
    return PotentialQuality(
        start=start,
        optimistic=float(above.mean()),
        excess=float((phi - q).mean()),
        size=float(abs(target.solution.values[alive]).mean()),
        rank=_spearman(phi.ravel(), q.ravel(), seed),
        right=float(right_choices(phi, target.solution.optimal[alive]).mean()),
        largest_underestimate=gloom,
        most_underestimated_state=where,
        exact=True,
    )


def along_its_way(met: GreedyRollouts, start: float, seed: int = 0) -> PotentialQuality:
    """Return how a potential compares with what its own greedy policy earned.

    Parameters
    ----------
    met : GreedyRollouts
        Its greedy episodes.
    start : float
        The mean return of its greedy policy.
    seed : int
        Of the pairs that are ranked.
    """
    return_to_go = met.return_to_go + met.bootstrap_discount * met.bootstrapped_value
    return PotentialQuality(
        start=start,
        optimistic=float((met.predicted > return_to_go).mean()),
        excess=float((met.predicted - return_to_go).mean()),
        size=float(abs(return_to_go).mean()),
        rank=_spearman(met.predicted, return_to_go, seed),
        right=float("nan"),
        largest_underestimate=float("nan"),
        most_underestimated_state=-1,
        exact=False,
    )


def _gloom(potential: PairPotential, solution: Solution, task: Task) -> tuple[float, int]:
    """Return the worst of min(V*, 0) - max_a phi on the way of optimal policies, and where."""
    mdp = tables(task)
    on_the_way = reachable_states(
        mdp.start,
        mdp.terminal,
        mdp.outcome_row,
        mdp.probability,
        mdp.next_state,
        solution.optimal,
    )
    missing = np.minimum(solution.values, 0.0) - potential.values.max(axis=1)
    missing[~on_the_way | mdp.terminal] = 0.0
    where = int(missing.argmax())
    return (float(missing[where]), where) if missing[where] > 0 else (0.0, -1)


def _spearman(one: FloatArray, other: FloatArray, seed: int) -> float:
    """Return the rank correlation; ties get the mean of their ranks."""
    if one.size > RANKED:
        drawn = np.random.default_rng(seed).choice(one.size, RANKED, False, shuffle=False)
        one, other = one[drawn], other[drawn]
    ranks = np.stack([_ranks(one), _ranks(other)])
    spread = ranks.std(axis=1)
    if not spread.all():
        return float("nan")
    return float(((ranks - ranks.mean(axis=1, keepdims=True)).prod(axis=0)).mean() / spread.prod())


def _ranks(values: FloatArray) -> FloatArray:
    _, place, count = np.unique(values, return_inverse=True, return_counts=True)
    return np.asarray((np.cumsum(count) - (count - 1) / 2)[place])
