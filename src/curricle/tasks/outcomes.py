"""Reading outcome lists, the form in which Gymnasium's toy-text tasks give their tables."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.errors import TaskError

FloatArray = npt.NDArray[np.float64]


def outcome_tables(
    outcomes: Any, terminal: npt.ArrayLike | None
) -> tuple[FloatArray, npt.NDArray[np.int64], FloatArray, npt.NDArray[np.bool_]]:
    """Return probabilities, successors and rewards, (S, A, O) each, and terminal flags, (S,).

    Parameters
    ----------
    outcomes : nested sequences or dicts
        As :meth:`FiniteMDP.from_outcomes` takes them.
    terminal : (S,) bool array, optional
        Collected from the outcomes where not given.

    Raises
    ------
    TaskError
        When states list different numbers of actions, or a flag is missing or contradicts another.
    """
    n_states, n_actions = len(outcomes), len(outcomes[0])
    for s in range(n_states):
        if len(outcomes[s]) != n_actions:
            raise TaskError(
                f"every state must list the same number of actions: state {s} lists "
                f"{len(outcomes[s])}, state 0 lists {n_actions}"
            )
    lists = [[outcomes[s][a] for a in range(n_actions)] for s in range(n_states)]
    shape = (n_states, n_actions, max(1, max(len(pair) for row in lists for pair in row)))
    p, successor, r = np.zeros(shape), np.zeros(shape, dtype=np.int64), np.zeros(shape)
    for s, row in enumerate(lists):
        for a, pair in enumerate(row):
            for o, outcome in enumerate(pair):
                p[s, a, o], successor[s, a, o], r[s, a, o] = outcome[:3]
    return p, successor, r, _terminal_states(lists) if terminal is None else np.asarray(terminal)


def _terminal_states(lists: Sequence[Any]) -> npt.NDArray[np.bool_]:
    """Collect the ``terminated`` flags of outcome lists into one flag a state."""
    flags: dict[int, bool] = {}
    for s, row in enumerate(lists):
        for a, pair in enumerate(row):
            for outcome in pair:
                if len(outcome) < 4:
                    raise TaskError(
                        "outcomes need a terminated flag where no terminal array is given: state "
                        f"{s}, action {a} has {outcome}"
                    )
                if flags.setdefault(outcome[1], outcome[3]) != outcome[3]:
                    # Gymnasium's tables let absorbing states loop on themselves either way.
                    if outcome[1] == s:
                        continue
                    raise TaskError(
                        "entering a state must end the episode always or never: state "
                        f"{outcome[1]} does both, the second time from state {s}, action {a}"
                    )
    return np.array([flags.get(s, False) for s in range(len(lists))])
