"""The graph of a task's transitions: states lead to outcome rows, and rows to next states."""

from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, IntArray


class OutcomeTables(Protocol):
    """The tables of a task: S states, A actions, Y rows of O outcomes."""

    @property
    def outcome_row(self) -> npt.NDArray[np.integer[Any]]: ...  # noqa: D102
    @property
    def probability(self) -> FloatArray: ...  # noqa: D102
    @property
    def next_state(self) -> npt.NDArray[np.integer[Any]]: ...  # noqa: D102
    @property
    def terminal(self) -> BoolArray: ...  # noqa: D102
    @property
    def start(self) -> FloatArray: ...  # noqa: D102


def rows_in_use(
    outcome_row: npt.NDArray[np.integer[Any]], terminal: BoolArray, n_rows: int
) -> BoolArray:
    """Return which outcome rows states name that are not terminal, (Y,) bool."""
    used = np.zeros(n_rows, dtype=bool)
    used[outcome_row[~terminal]] = True
    return used


def edges_of(mdp: OutcomeTables, allowed: BoolArray | None = None) -> tuple[IntArray, IntArray]:
    """Return where the edges of a graph of S states and Y rows (node S + y) begin and end."""
    pairs = np.repeat(~mdp.terminal[:, None], mdp.outcome_row.shape[1], axis=1)
    if allowed is not None:
        pairs &= allowed
    state, (row, outcome) = np.nonzero(pairs)[0], np.nonzero(mdp.probability > 0)
    rows = len(mdp.terminal) + mdp.outcome_row[pairs]
    source = np.concatenate([state, len(mdp.terminal) + row])
    return source, np.concatenate([rows, mdp.next_state[row, outcome]])


def reachable_states(mdp: OutcomeTables, allowed: BoolArray | None = None) -> BoolArray:
    """Return which states the `allowed` actions can reach from the start, (S,) bool."""
    # Imported where it is needed: every task needs this module, and it takes a third of a second.
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import breadth_first_order

    # One more node leads to all first states.
    root, first = len(mdp.terminal) + len(mdp.probability), np.flatnonzero(mdp.start > 0)
    source, target = edges_of(mdp, allowed)
    source, target = np.append(source, np.full(len(first), root)), np.append(target, first)
    graph = csr_array((np.ones(len(source), bool), (source, target)), shape=(root + 1, root + 1))
    order = breadth_first_order(graph, root, return_predecessors=False)
    return np.isin(np.arange(len(mdp.terminal)), order)


def improper_states(mdp: OutcomeTables) -> IntArray:
    """Return the states from which some policy avoids all terminal states for ever."""
    # The largest set whose states can stay in it. It is empty exactly if every policy ends with
    # probability 1, is proper (Bertsekas, Tsitsiklis 1991).
    staying = ~mdp.terminal
    impossible = mdp.probability == 0
    while True:
        row_stays = (staying[mdp.next_state] | impossible).all(axis=1)
        remains = staying & row_stays[mdp.outcome_row].any(axis=1)
        if (remains == staying).all():
            return np.flatnonzero(staying)
        staying = remains


def steps_to(
    mdp: OutcomeTables,
    goal: BoolArray,
    among: BoolArray | None = None,
    *,
    taken: BoolArray | None = None,
) -> FloatArray:
    """Return the fewest steps to `goal`, (S,), or infinity where no way leads there.

    A way leads only through the states `among`, (S,), and by the pairs `taken`, (S, A).
    """
    among = np.ones(len(goal), bool) if among is None else among
    steps = np.where(goal & among, 0.0, np.inf)
    while True:
        after = np.where(mdp.probability > 0, steps[mdp.next_state], np.inf).min(axis=1)
        shortest = after[mdp.outcome_row]
        shortest = shortest if taken is None else np.where(taken, shortest, np.inf)
        nearer = np.minimum(steps, 1 + shortest.min(axis=1))
        nearer[~among] = np.inf
        if (nearer == steps).all():
            return steps
        steps = nearer
