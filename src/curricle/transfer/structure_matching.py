"""Mappings by structure alone: semi-relaxed Gromov-Wasserstein matching of states, with POT.

States of the target are matched to states of the source so that states which lie near each other in
the one lie near each other in the other (Vincent-Cuaz et al. 2022; POT: Flamary et al. 2021), and
so that the rewards of their actions are alike. The problem is not convex, so that it is solved from
several beginnings. Needs the extra ``match``.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from curricle.array_types import FloatArray, IntArray
from curricle.errors import MappingError
from curricle.tasks.mdp import FiniteMDP
from curricle.transfer.mapping import pair_mapping
from curricle.transfer.proposal import Proposal, SearchedMapping
from curricle.transfer.task_pair import TaskPair

LARGEST = 4_000_000
"""States of the target times states of the source."""
BEGINNINGS = 6
"""Beginnings from which a matching is sought; the first is the even one."""
STRUCTURE = 0.5
"""Weight of distances against rewards."""
REWARD = 1.0
"""Weight of a reward against where a pair leads, when actions are matched."""


def by_structure(tasks: TaskPair) -> Iterator[Proposal]:
    """Yield a mapping for each matching of states that is found; actions are matched in each state.

    Not among the searches that :func:`find_mappings` makes by default: add it to `searches`.

    Raises
    ------
    MappingError
        When POT is not installed, or the tasks are too large.

    Examples
    --------
    >>> from curricle.transfer import find_mappings
    >>> found = find_mappings(target, source, searches=[by_structure])  # doctest: +SKIP
    """
    try:
        from ot.gromov import semirelaxed_fused_gromov_wasserstein
    except ImportError:
        raise MappingError(
            'matching by structure needs POT: pip install "curricle[match]"'
        ) from None
    own, other = tasks.target_mdp, tasks.source_mdp
    if own.states.size * other.states.size > LARGEST:
        raise MappingError(
            f"structures are matched for up to {LARGEST:,} pairs of states: these tasks have "
            f"{own.states.size * other.states.size:,}"
        )
    apart = [distances(mdp) for mdp in (own, other)]
    scale = max(float(each.max()) for each in apart)
    unlike = _unlike_rewards(own, other)
    rng = np.random.default_rng(tasks.seed)
    shape = own.states.size, other.states.size
    weights = np.full(shape[0], 1 / shape[0])
    seen: set[bytes] = set()
    for beginning in range(BEGINNINGS):
        first = None
        if beginning:
            drawn = rng.dirichlet(np.ones(shape[1]), size=shape[0])
            first = drawn * weights[:, None]
        plan = semirelaxed_fused_gromov_wasserstein(
            unlike, apart[0] / scale, apart[1] / scale, weights, alpha=STRUCTURE, G0=first,
            max_iter=500,
        )  # fmt: skip
        state = np.asarray(plan).argmax(axis=1)
        if state.tobytes() not in seen:
            seen.add(state.tobytes())
            yield _proposal(tasks, state, beginning)


def distances(mdp: FiniteMDP) -> FloatArray:
    """Return how many steps states are apart, in either direction the fewer, (S, S) float64.

    A step may be any outcome of any action; terminal states lead nowhere. States that are not
    connected are one step further apart than the most distant ones that are.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> distances(GridWorld("S.T").mdp)
    array([[0., 1., 2.],
           [1., 0., 1.],
           [2., 1., 0.]])
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import shortest_path

    n = mdp.states.size
    state = np.repeat(np.flatnonzero(~mdp.terminal), mdp.actions.size)
    row = mdp.outcome_row[~mdp.terminal].ravel()
    possible = mdp.probability[row] > 0
    ends = np.repeat(state[:, None], possible.shape[1], axis=1)[possible]
    graph = csr_array((np.ones(len(ends)), (ends, mdp.next_state[row][possible])), shape=(n, n))
    steps = shortest_path(graph, unweighted=True)
    steps = np.minimum(steps, steps.T)
    known = np.isfinite(steps)
    return np.asarray(np.where(known, steps, steps[known].max() + 1))


def _unlike_rewards(own: FiniteMDP, other: FiniteMDP) -> FloatArray:
    """Return how much the rewards of states' actions differ, in order of size, (S, S') float64."""
    quantiles = np.linspace(0, 1, 5)
    profiles = []
    for mdp in (own, other):
        reward = (mdp.probability * mdp.reward).sum(axis=1)[mdp.outcome_row]
        profile = np.quantile(reward, quantiles, axis=1).T
        profiles.append(np.where(mdp.terminal[:, None], 0.0, profile))
    unlike = abs(profiles[0][:, None, :] - profiles[1][None, :, :]).mean(axis=2)
    ends = own.terminal[:, None] != other.terminal
    unlike[ends] = unlike.max(initial=0.0) + 1
    return np.asarray(unlike / max(float(unlike.max()), 1e-300))


def _proposal(tasks: TaskPair, state: IntArray, beginning: int) -> Proposal:
    """Return the mapping of a matching of states, each action to the likeliest of the source's."""
    own, other = tasks.target_mdp, tasks.source_mdp
    action = np.zeros(own.outcome_row.shape, np.int64)
    rewards: list[Any] = [(m.probability * m.reward).sum(axis=1) for m in (own, other)]
    spread = max(float(np.ptp(rewards[0])), float(np.ptp(rewards[1])), 1e-300)
    apart = distances(other)
    for s in np.flatnonzero(~own.terminal):
        rows, others = own.outcome_row[s], other.outcome_row[state[s]]
        cost = REWARD * abs(rewards[0][rows][:, None] - rewards[1][others]) / spread
        # The mean distance between where the two lead, in the source.
        leads = state[own.next_state[rows]]
        far = apart[leads[:, None, :, None], other.next_state[others][None, :, None, :]]
        chance = own.probability[rows][:, None, :, None] * other.probability[others][:, None, :]
        cost = cost + (far * chance).sum(axis=(2, 3)) / max(1.0, float(apart.max()))
        action[s] = cost.argmin(axis=1)
    index = pair_mapping(own, other, state[:, None], action).index
    how = f"structure of states, beginning {beginning + 1}"
    return Proposal(SearchedMapping(tasks.target, tasks.source, index, how=how), how)
