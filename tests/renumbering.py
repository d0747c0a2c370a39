"""Tasks whose states, actions or components are numbered anew."""

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


def nameless(task, rng):
    """Return a task of shuffled, renamed components, and its states' and actions' new numbers."""
    (states, new), (actions, moved) = (
        _shuffled(space, rng) for space in (task.states, task.actions)
    )
    rows = task.outcome_row[np.argsort(new)][:, np.argsort(moved)]
    return _copy(task, states, actions, rows, new), new, moved


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


def _shuffled(space, rng):
    order = rng.permutation(len(space.components))
    values = space.decode()
    columns, components = [], []
    for place, one in enumerate(order):
        component = space.components[one]
        numbers = rng.permutation(component.size)
        columns.append(numbers[values[component.name] - component.low])
        components.append(Component(f"component_{place}", component.size))
    if space.is_box:
        made = Space(components)
    else:
        points = np.stack(columns, axis=1)
        made = Space(components, points[rng.permutation(len(points))])
    return made, made.encode(**dict(zip(made.names, columns, strict=True)))
