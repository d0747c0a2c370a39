"""How a potential compares with Q* of its target, or with the returns of its own greedy policy."""

from dataclasses import dataclass

import numpy as np

from curricle.arrays import FloatArray
from curricle.learning.potential_rollouts import (
    GreedyRollouts,
    PairPotential,
    greedy_rollouts,
    greedy_start,
)
from curricle.planning.solution import Solution, right_choices
from curricle.planning.target import Target
from curricle.tasks.mdp import reachable_states
from curricle.tasks.task import Task, tables
from curricle.transfer.observation_rollouts import ObservationTarget, greedy_observation_rollouts
from curricle.transfer.potentials import ObservationPotential

MAX_RANKED = 200_000
"""Pairs over which a rank correlation is taken at most; a sample of more."""
STREAM = "potential_quality"
"""Name of the random stream of rollouts."""
NAN = float("nan")


@dataclass(frozen=True)
class PotentialQuality:
    """How a potential compares with the values of its target."""

    start: float  # expected return of its greedy policy: where learning starts
    optimistic: float  # share of pairs (s, a) with phi > Q*
    excess: float  # mean of phi - Q*
    mean_absolute_value: float  # of V*, to compare an excess with
    rank: float  # Spearman's correlation of phi and Q*; NaN where one of them does not vary
    greedy_agreement: float = NAN  # share of states whose greedy actions are all optimal, if exact
    # The largest min(V*, 0) - max_a phi over the states that optimal policies visit: how far phi
    # lies below both the truth and an initial value of 0. Such a state is avoided, so learning does
    # not correct its value. NaN unless exact.
    largest_underestimate: float = NAN
    most_underestimated_state: int = -1  # where that is; -1 if nowhere
    # Whether it is compared with Q*, and not with the return to go of greedy rollouts, which Q*
    # exceeds, over the steps of these.
    exact: bool = False


def potential_quality(
    potential: PairPotential | ObservationPotential,
    target: Target | ObservationTarget,
    *,
    seed: int = 0,
) -> PotentialQuality:
    """Return how a potential compares with the values of its target.

    All NaN where an ObservationPotential has no action values, and so no greedy policy.
    """
    if isinstance(target, ObservationTarget):
        assert isinstance(potential, ObservationPotential)
        return _of_observations(potential, target, seed)
    assert not isinstance(potential, ObservationPotential)
    start = greedy_start(potential, target.evaluation, seed=seed)
    if target.solution is None:
        episodes = target.evaluation.rollouts(target.task)
        rollouts = greedy_rollouts(potential, episodes=episodes, seed=seed, stream=STREAM)
        return _by_rollouts(rollouts, start, seed)
    mdp = tables(target.task)
    alive = ~mdp.terminal
    phi, q = potential.values[alive], target.solution.action_values[alive]
    underestimate, state = _largest_underestimate(potential, target.solution, target.task)
    return PotentialQuality(
        start=start,
        # A difference within the proven error of Q* does not count.
        optimistic=float((phi > q + target.solution.error_bound).mean()),
        excess=float((phi - q).mean()),
        mean_absolute_value=float(abs(target.solution.values[alive]).mean()),
        rank=_rank_correlation(phi.ravel(), q.ravel(), seed),
        greedy_agreement=float(right_choices(phi, target.solution.optimal[alive]).mean()),
        largest_underestimate=underestimate,
        most_underestimated_state=state,
        exact=True,
    )


def _of_observations(
    potential: ObservationPotential, target: ObservationTarget, seed: int
) -> PotentialQuality:
    if not potential.of_actions:
        return PotentialQuality(NAN, NAN, NAN, NAN, NAN)
    episodes = target.episodes
    rollouts = greedy_observation_rollouts(potential, episodes=episodes, seed=seed, stream=STREAM)
    first = np.cumsum(rollouts.lengths) - rollouts.lengths
    discounted = target.evaluation.discounted
    returns = rollouts.return_to_go[first] if discounted else rollouts.returns
    return _by_rollouts(rollouts, float(returns.mean()), seed)


def _by_rollouts(rollouts: GreedyRollouts, start: float, seed: int) -> PotentialQuality:
    """Return the comparison with the returns to go; `start` is the greedy policy's mean return."""
    return_to_go = rollouts.return_to_go + rollouts.bootstrap_discount * rollouts.bootstrapped_value
    return PotentialQuality(
        start=start,
        optimistic=float((rollouts.predicted > return_to_go).mean()),
        excess=float((rollouts.predicted - return_to_go).mean()),
        mean_absolute_value=float(abs(return_to_go).mean()),
        rank=_rank_correlation(rollouts.predicted, return_to_go, seed),
    )


def _largest_underestimate(
    potential: PairPotential, solution: Solution, task: Task
) -> tuple[float, int]:
    """Return the largest min(V*, 0) - max_a phi where optimal policies lead, and its state."""
    mdp = tables(task)
    visited = reachable_states(mdp, solution.optimal)
    below = np.minimum(solution.values, 0.0) - potential.values.max(axis=1)
    below[~visited | mdp.terminal] = 0.0
    state = int(below.argmax())
    return (float(below[state]), state) if below[state] > 0 else (0.0, -1)


def _rank_correlation(one: FloatArray, other: FloatArray, seed: int) -> float:
    """Return Spearman's rank correlation, of a sample where there are many."""
    if one.size > MAX_RANKED:
        drawn = np.random.default_rng(seed).choice(one.size, MAX_RANKED, False, shuffle=False)
        one, other = one[drawn], other[drawn]
    if not (np.ptp(one) > 0 and np.ptp(other) > 0):
        return NAN
    from scipy.stats import rankdata  # half a second that few need

    return float(np.corrcoef(rankdata(one), rankdata(other))[0, 1])
