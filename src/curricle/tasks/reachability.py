"""Where an episode can get to, and where it can go on for ever.

Both functions take a :class:`FiniteMDP` and which actions are allowed in each state, (S, A) bool;
all are by default.
"""

from typing import Any

import numpy as np

from curricle.array_types import BoolArray, IntArray


def reachable_states(mdp: Any, allowed: BoolArray | None = None) -> BoolArray:
    """Return which states the `allowed` actions can reach from the start, (S,) bool.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> reachable_states(GridWorld(["S#.", ".#T"]).mdp)  # the east lies behind a wall
    array([ True, False,  True, False])
    """
    # Imported here: every task is checked by this module, and the import takes a third of a second.
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import breadth_first_order

    n_states, n_rows = len(mdp.terminal), len(mdp.probability)
    pairs = np.repeat(~mdp.terminal[:, None], mdp.outcome_row.shape[1], axis=1)
    if allowed is not None:
        pairs &= allowed
    state, _ = np.nonzero(pairs)
    row, outcome = np.nonzero(mdp.probability > 0)
    first = np.flatnonzero(mdp.start > 0)
    # A graph of the states, then the outcome rows, then one node that leads to all first states.
    root = n_states + n_rows
    source = np.concatenate([state, n_states + row, np.full(len(first), root)])
    after = mdp.next_state[row, outcome]
    target = np.concatenate([n_states + mdp.outcome_row[pairs], after, first])
    edges = np.ones(len(source), np.bool_), (source, target)
    graph = csr_array(edges, shape=(root + 1, root + 1))
    met = np.zeros(root + 1, dtype=bool)
    met[breadth_first_order(graph, root, return_predecessors=False)] = True
    return met[:n_states]


def improper_states(mdp: Any, allowed: BoolArray | None = None) -> IntArray:
    """Return the states from which `allowed` actions can avoid all terminal states for ever.

    This is the largest set of states each of which has an allowed action whose every outcome stays
    in the set. It is empty exactly if every allowed policy is proper, which is to end with
    probability 1 (Bertsekas, Tsitsiklis 1991).

    Examples
    --------
    >>> from curricle import GridWorld
    >>> improper_states(GridWorld("S.T").mdp)
    array([0, 1])
    """
    staying = ~mdp.terminal
    impossible = mdp.probability == 0
    while True:
        row_stays = (staying[mdp.next_state] | impossible).all(axis=1)
        pair_stays = row_stays[mdp.outcome_row]
        if allowed is not None:
            pair_stays &= allowed
        remains = staying & pair_stays.any(axis=1)
        if (remains == staying).all():
            return np.flatnonzero(staying)
        staying = remains
