"""Where an episode can get to."""

from typing import Any

import numpy as np
import numpy.typing as npt

BoolArray = npt.NDArray[np.bool_]


def reachable_states(
    start: npt.NDArray[np.float64],
    terminal: BoolArray,
    outcome_row: npt.NDArray[np.integer[Any]],
    probability: npt.NDArray[np.float64],
    next_state: npt.NDArray[np.integer[Any]],
    allowed: BoolArray | None = None,
) -> BoolArray:
    """Return which states the `allowed` actions can get to from the start, (S,) bool.

    Parameters
    ----------
    start, terminal, outcome_row, probability, next_state
        Tables of a :class:`FiniteMDP`.
    allowed : (S, A) bool array, optional
        All actions by default.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> mdp = GridWorld(["S#.", ".#T"]).mdp
    >>> tables = mdp.start, mdp.terminal, mdp.outcome_row, mdp.probability, mdp.next_state
    >>> reachable_states(*tables)  # the east lies behind a wall
    array([ True, False,  True, False])
    """
    found = start > 0
    frontier = np.flatnonzero(found & ~terminal)
    while frontier.size:
        rows = outcome_row[frontier]
        rows = np.unique(rows if allowed is None else rows[allowed[frontier]])
        after = np.unique(next_state[rows][probability[rows] > 0])
        new = after[~found[after]]
        found[new] = True
        frontier = new[~terminal[new]]
    return found
