"""Whether an episode must end: the states from which it can go on for ever."""

from typing import Any

import numpy as np
import numpy.typing as npt

BoolArray = npt.NDArray[np.bool_]


def endless_states(
    terminal: BoolArray,
    outcome_row: npt.NDArray[np.integer[Any]],
    probability: npt.NDArray[np.float64],
    next_state: npt.NDArray[np.integer[Any]],
    allowed: BoolArray | None = None,
) -> npt.NDArray[np.int64]:
    """Return the states from which the `allowed` actions can avoid every terminal for ever.

    The largest set of states each of which has an allowed action whose every outcome stays in
    the set; it is empty just when every allowed policy ends with probability 1.

    Parameters
    ----------
    terminal, outcome_row, probability, next_state
        Tables of a :class:`FiniteMDP`.
    allowed : (S, A) bool array, optional
        All actions by default.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> mdp = GridWorld("S.T").mdp
    >>> endless_states(mdp.terminal, mdp.outcome_row, mdp.probability, mdp.next_state)
    array([0, 1])
    """
    staying = ~terminal
    impossible = probability == 0
    while True:
        row_stays = (staying[next_state] | impossible).all(axis=1)
        pair_stays = row_stays[outcome_row]
        if allowed is not None:
            pair_stays &= allowed
        remains = staying & pair_stays.any(axis=1)
        if (remains == staying).all():
            return np.flatnonzero(staying)
        staying = remains
