"""Choice flips: states in which a greedy choice became right, or wrong, between two times.

A mean return falls for many reasons. The states whose greedy choice was optimal and no longer is
show where learning lost something.
"""

import numpy as np
import numpy.typing as npt

from curricle.array_types import BoolArray, FloatArray, IntArray
from curricle.checks import numbers
from curricle.errors import SettingError
from curricle.planning.policy_evaluation import NEGLIGIBLE, GreedyEvaluation
from curricle.planning.solution import policy_table, right_choices
from curricle.tasks.task import Task, tables


def right_states(values: npt.ArrayLike, optimal: npt.ArrayLike) -> BoolArray:
    """Return the states, (S,) bool, in which every action of the highest value is optimal.

    Arguments and errors are those of :func:`flips`.
    """
    table, best = numbers("values", values, SettingError), np.asarray(optimal)
    if best.dtype != np.bool_:
        raise SettingError(f"optimal must be an array of booleans: got {best.dtype}")
    if table.ndim != 2 or table.shape != best.shape or not table.size:
        raise SettingError(
            f"values and optimal must both have shape (S, A): got {table.shape} and {best.shape}"
        )
    unknown = np.isnan(table).any(axis=1)
    if unknown.any():
        raise SettingError(f"values must not be NaN: state {np.argmax(unknown)} has one that is")
    return right_choices(table, best)


def flips(before: npt.ArrayLike, after: npt.ArrayLike, optimal: npt.ArrayLike) -> IntArray:
    """Return where the greedy choice became right (+1) or wrong (-1) between two times.

    flip(s) = right_after(s) - right_before(s), where a choice is right if every action of the
    highest value is optimal (:func:`right_states`).

    Parameters
    ----------
    before, after : (S, A) float64
        The values of one learner at two times.
    optimal : (S, A) bool
        As :attr:`Solution.optimal`.

    Returns
    -------
    (S,) int64

    Raises
    ------
    SettingError
        If the shapes are not one (S, A), a value is NaN, or `optimal` is not boolean.

    Notes
    -----
    Values of an earlier time need not be stored: :func:`learn` with a smaller budget in steps and
    the same other arguments (seeds, stream, potential) returns exactly the table that the longer
    training had then. Before the first step it is the initial value, or phi if Q starts at phi.

    Examples
    --------
    >>> optimal = [[True, False], [True, False], [True, True]]
    >>> flips([[1.0, 2.0], [5.0, 1.0], [0.0, 0.0]], [[3.0, 2.0], [1.0, 1.0], [0.0, 9.0]], optimal)
    array([ 1, -1,  0])
    """
    was, now = right_states(before, optimal), right_states(after, optimal)
    return now.astype(np.int64) - was


def expected_visits(task: Task, policy: npt.ArrayLike) -> FloatArray:
    """Return the expected number of visits to each state in an episode of a policy, (S,).

    n(s) = sum_t P(s_t = s), s not terminal, up to the task's time limit. Without one the sum ends
    when a discounted reward would weigh less than 1e-9, or P(not yet terminated) is below that.

    The task must have tables; `policy` is (S,) or (S, A) as in :func:`evaluate`.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> expected_visits(GridWorld("S.T"), [1, 1, 0])  # east, east
    array([1., 1., 0.])
    """
    mdp = tables(task)
    chosen = policy_table(mdp, policy)
    there: FloatArray = mdp.start.copy()
    visits = np.zeros(mdp.states.size)
    for _ in range(GreedyEvaluation().horizon(task)):
        there[mdp.terminal] = 0.0
        if there.sum() < NEGLIGIBLE:
            break
        visits += there
        weights = (there[:, np.newaxis] * chosen).ravel()
        rows = np.bincount(mdp.outcome_row.ravel(), weights, minlength=len(mdp.next_state))
        arriving = (rows[:, np.newaxis] * mdp.probability).ravel()
        after = np.bincount(mdp.next_state.ravel(), arriving, minlength=mdp.states.size)
        there = after.astype(np.float64)
    return visits
