"""How often a policy visits each state."""

from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.array_types import FloatArray
from curricle.frozen_arrays import frozen
from curricle.planning.solution import policy_table
from curricle.tasks.mdp import NO_LIMIT, FiniteMDP
from curricle.tasks.task import Task, tables

NEGLIGIBLE = 1e-13
"""Share of the visits so far below which those of later steps are left out."""


def visit_distribution(task: Task, policy: npt.ArrayLike | None = None) -> FloatArray:
    """Return the share of visits that a policy pays to each state, (S,) float64, summing to 1.

    mu(s) = eta(s) / sum_s' eta(s') with the expected discounted visits of an episode,
    eta(s) = sum_t gamma^t Pr(s_t = s), t below the time limit: the on-policy distribution, with
    discounting as a form of termination (Sutton & Barto 2018, section 9.2). It is 0 in terminal
    states. The visits of late steps are left out once they are less than 1e-13 of all.

    Parameters
    ----------
    task : Task
        Any task with tables.
    policy : (S,) int array or (S, A) float array, optional
        An action for each state, or the probability of each action; uniformly random by default.

    Raises
    ------
    SettingError
        When the policy is malformed.
    TaskError
        When the task has no tables.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> visit_distribution(GridWorld("S..T", discount=1.0), [1, 1, 1, 0])
    array([0.33333333, 0.33333333, 0.33333333, 0.        ])
    """
    mdp = tables(task)
    if policy is None:
        policy = np.full(mdp.outcome_row.shape, 1 / mdp.actions.size)
    chances = np.where(mdp.terminal[:, None], 0.0, policy_table(mdp, policy))
    step, now, visits = _transitions(mdp, chances), mdp.start, np.zeros(mdp.states.size)
    for _ in range(int(NO_LIMIT) if mdp.time_limit is None else mdp.time_limit):
        visits += now
        now = mdp.discount * (now @ step)
        if now.sum() <= NEGLIGIBLE * visits.sum():
            break
    return frozen(np.asarray(visits / visits.sum()))


def _transitions(mdp: FiniteMDP, chances: FloatArray) -> Any:
    """Return the chance of each next state that goes on, a sparse (S, S) array."""
    from scipy.sparse import csr_array  # takes time, and few need it

    n_states = mdp.states.size
    state, action = np.nonzero(chances)
    row = mdp.outcome_row[state, action]
    weight = chances[state, action][:, None] * mdp.probability[row]
    after = mdp.next_state[row]
    weight[mdp.terminal[after]] = 0.0
    source = np.repeat(state, after.shape[1])
    return csr_array((weight.ravel(), (source, after.ravel())), shape=(n_states, n_states))
