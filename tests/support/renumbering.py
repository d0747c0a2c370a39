"""Tasks whose states and actions are numbered anew."""

import numpy as np

from curricle import Component, FiniteMDP, Space


def renumbered(task, rng):
    """Return a task renumbered, where each state went (S,), and each pair's old action (S, A)."""
    n_states, n_actions = task.outcome_row.shape
    new = rng.permutation(n_states)
    old = np.argsort(new)
    actions = np.argsort(rng.random((n_states, n_actions)), axis=1)
    spaces = Space([Component("state", n_states)]), Space([Component("action", n_actions)])
    rows = np.take_along_axis(task.outcome_row[old], actions, axis=1)
    return _copy(task, *spaces, rows, new), new, actions


def _copy(task, states, actions, outcome_row, new):
    """Return a task with other spaces and rows of outcomes, its states numbered `new`."""
    old = np.argsort(new)
    return FiniteMDP(
        states=states,
        actions=actions,
        outcome_row=outcome_row,
        probability=task.probability,
        next_state=new[task.next_state],
        reward=task.reward,
        terminal=task.terminal[old],
        start=task.start[old],
        discount=task.discount,
        time_limit=task.time_limit,
    )
