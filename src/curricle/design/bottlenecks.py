"""Candidates whose goal is a bottleneck of the target: a doorway between its parts.

States on many shortest paths are subgoals (McGovern & Barto 2001, "automatic discovery of subgoals
in reinforcement learning using diverse density", find them by visits on successful paths). Simsek
& Barto 2008, "skill characterization based on betweenness", take local maxima of betweenness, which
is computed here by counting shortest paths (Brandes 2001, "a faster algorithm for betweenness
centrality"), for a block of first states at once.

One thing is not theirs: betweenness is divided by the number of neighbouring states. In the cells
before a doorway it is a little higher than in the doorway itself, since paths within the room cross
there too; but they have more neighbours.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from curricle.array_types import FloatArray
from curricle.design.proposals import DesignTarget, Draft, Made
from curricle.errors import TaskError
from curricle.frozen_arrays import frozen
from curricle.tasks.mdp import FiniteMDP, Task, reachable_states, tables
from curricle.tasks.start_states import goal_distance
from curricle.transfer.mapping import UNMAPPED, StateActionMapping, pair_mapping

LARGEST = 20_000
"""States up to which bottlenecks are looked for."""
MOST_FIRST, FEWEST_FIRST = 1_000, 50
"""States that paths are counted from; of more, so many that are spread evenly over their list."""
MOST_EDGES = 200_000_000
"""Edges of all states that paths are counted from, so that they are fewer in dense graphs."""
BLOCK = 128
"""Of them at a time."""
MOST_BOTTLENECKS = 12
ROUNDING = 1e-9
"""Share of a betweenness that counts as none: sums are made in one order or another."""


def betweenness(task: Task) -> FloatArray:
    """Return the share of shortest paths between other states that lead through each, (S,) float64.

    Of the paths by possible outcomes, between states that the task's start can reach; none leads
    through a terminal state. Where they are more than 1,000, paths from 1,000 of them count; from
    fewer, at least 50, where many states can follow each.
    """
    mdp = tables(task)
    if len(mdp.terminal) > LARGEST:
        raise TaskError(
            f"bottlenecks are found in tasks of up to {LARGEST:,} states: this one has "
            f"{len(mdp.terminal):,}"
        )
    met = reachable_states(mdp)
    first = np.flatnonzero(met & ~mdp.terminal)
    edges = _edges(mdp)
    most = min(MOST_FIRST, max(FEWEST_FIRST, MOST_EDGES // max(1, edges.nnz)))
    if len(first) > most:
        first = first[np.linspace(0, len(first) - 1, most).astype(np.int64)]
    total = np.zeros(len(met))
    for begin in range(0, len(first), BLOCK):
        total += _dependencies(edges, first[begin : begin + BLOCK])
    pairs = max(1, len(first) * (int(met.sum()) - 1))
    return frozen(total / pairs)


def bottlenecks(target: DesignTarget) -> Iterator[Draft]:
    """Yield the target with a bottleneck as its goal, the strongest first.

    Entering the bottleneck ends the episode, and pays what entering the goal pays at best. Of its
    pairs the source knows nothing; the mapping leaves them unmapped.
    """
    mdp = target.mdp
    if len(mdp.terminal) > LARGEST:
        return
    share = betweenness(mdp)
    each, strongest = _by_neighbours(mdp, share)
    found = (each > 0) & (each >= strongest * (1 - ROUNDING)) & ~mdp.terminal & ~target.goal
    # Stable, and without differences by rounding, so that of equal ones the first state is first.
    order = np.argsort(-each.round(9), kind="stable")
    way = goal_distance(mdp, target.goal)
    far = max(1, int(way[mdp.start_states].max(initial=1)))
    for state in order[found[order]][:MOST_BOTTLENECKS].tolist():
        name = mdp.states.label(state)
        words = f"the goal is a bottleneck, on {share[state]:.0%} of shortest paths: {name}"
        build = partial(_ending_in, target, state, int(way[state]))
        title = f"to {name}"
        title = title if len(title) <= 90 else f"{title[:87]}..."
        yield Draft("bottleneck", title, words, build, float(way[state]) / far)


def _edges(mdp: FiniteMDP) -> Any:
    """Return which states can follow each, (S, S) sparse: 1 from a live state to another."""
    from scipy.sparse import csr_array  # takes time, and few need it

    n_states, n_actions = mdp.outcome_row.shape
    live = np.flatnonzero(~mdp.terminal)
    row = mdp.outcome_row[live].ravel()
    state = np.repeat(live, n_actions)
    pair, outcome = np.nonzero(mdp.probability[row] > 0)
    before, after = state[pair], mdp.next_state[row[pair], outcome]
    other = before != after
    ones = np.ones(int(other.sum()))
    found = csr_array((ones, (before[other], after[other])), shape=(n_states, n_states))
    found.sum_duplicates()
    found.data[:] = 1.0
    return found


def _dependencies(edges: Any, first: Any) -> FloatArray:
    """Return for each state the share of shortest paths through it, summed over ends, (S,).

    Brandes' recursion, level by level: delta(v) = sum over w one level farther, next to v, of
    paths(v) / paths(w) (1 + delta(w)).
    """
    n = edges.shape[0]
    forward = edges.T.tocsr()
    place = first, np.arange(len(first))
    paths, level = np.zeros((n, len(first))), np.full((n, len(first)), -1)
    paths[place], level[place] = 1.0, 0
    front, deepest = paths.copy(), 0
    while True:
        front = np.where(level < 0, forward @ front, 0.0)
        new = front > 0
        if not new.any():
            break
        deepest += 1
        level[new], paths[new] = deepest, front[new]
    delta, safe = np.zeros_like(paths), np.maximum(paths, 1.0)
    for now in range(deepest, 0, -1):
        share = np.where(level == now, (1 + delta) / safe, 0.0)
        delta += np.where(level == now - 1, paths * (edges @ share), 0.0)
    delta[place] = 0.0
    return np.asarray(delta.sum(axis=1))


def _by_neighbours(mdp: FiniteMDP, share: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return betweenness by neighbouring state, and the largest of that of neighbours, (S,) each.

    States are neighbours if one can follow the other.
    """
    edges = _edges(mdp)
    one, other = (edges + edges.T).nonzero()
    each = share / np.maximum(np.bincount(one, minlength=len(share)), 1)
    strongest = np.zeros(len(share))
    np.maximum.at(strongest, one, each[other])
    return each, strongest


def _ending_in(target: DesignTarget, state: int, way: int) -> Made:
    """Return the target as a task that ends in a state, `way` steps from the goal; its mapping."""
    if way < 0:
        raise TaskError(f"a bottleneck must be on a way to the goal: state {state} is on none")
    mdp = target.mdp
    used = np.zeros(len(mdp.probability), bool)
    used[mdp.outcome_row[~mdp.terminal]] = True
    possible = used[:, None] & (mdp.probability > 0)
    at_goal = possible & target.goal[mdp.next_state]
    prize = mdp.reward[at_goal if at_goal.any() else possible].max()
    start = np.where(np.arange(len(mdp.start)) == state, 0.0, mdp.start)
    if not start.any():
        raise TaskError(f"a bottleneck must not be the only start: state {state} is")
    source = replace(
        mdp,
        reward=np.where(mdp.next_state == state, prize, mdp.reward),
        terminal=mdp.terminal | (np.arange(len(mdp.terminal)) == state),
        start=start / start.sum(),
    )
    n_states, n_actions = mdp.outcome_row.shape
    index = pair_mapping(target.task, source, np.arange(n_states)[:, None], np.arange(n_actions))
    unmapped = np.where(np.arange(n_states)[:, None] == state, UNMAPPED, index.index)
    return source, StateActionMapping(target.task, source, unmapped)
