"""Candidates that are coarser tables: states merged along ordered components.

State aggregation as in Singh, Jaakkola, Jordan 1995, "reinforcement learning with soft state
aggregation", with hard clusters: a cluster goes on as its states do on average.
"""

from collections.abc import Iterator
from functools import partial
from math import ceil
from typing import Any

import numpy as np

from curricle.array_types import IntArray
from curricle.design.proposals import DesignTarget, Draft, Made
from curricle.errors import TaskError
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.spaces import Component, Space
from curricle.transfer.mapping import pair_mapping

LARGEST = 2_000_000
"""Outcomes of all pairs up to which a table is merged."""
FEWEST = 4
"""Values of a component that is worth merging."""


def coarser_tables(target: DesignTarget) -> Iterator[Draft]:
    """Yield the target with neighbouring values merged, of all ordered components and of each.

    A component is ordered if its values have no labels, or those that :class:`Bins` gives them.
    The only component of a table without names, ``state``, is a numbering and no order. A terminal
    state is never merged with one that is not.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.design.proposals import design_target
    >>> target = design_target(GridWorld(["S...", "....", "....", "...T"]))
    >>> [draft.name for draft in coarser_tables(target)]
    ['row, column by 2', 'row by 2', 'column by 2']
    """
    names = ordered_components(target.mdp.states)
    groups = [names] if names else []
    groups += [(name,) for name in names] if len(names) > 1 else []
    for group in groups:
        name = f"{', '.join(group)} by 2"
        words = f"a coarser table: each two values of {' and '.join(group)} are one"
        build = partial(_merged, target.task, target.mdp, group)
        yield Draft("coarser", name[:90], words, build, name)


def ordered_components(states: Space) -> tuple[str, ...]:
    """Return the components whose neighbouring values are alike, as far as a space tells.

    Examples
    --------
    >>> ordered_components(Space([Component("x", 9), Component("move", 4, labels=tuple("NESW"))]))
    ('x',)
    >>> ordered_components(Space([Component("state", 9)]))
    ()
    """
    if states.names == ("state",):
        return ()
    return tuple(one.name for one in states.components if one.size >= FEWEST and _ordered(one))


def _ordered(component: Component) -> bool:
    labels = component.labels
    if labels is None:
        return True
    return labels[0].startswith("below ") and labels[-1].endswith(" and above")


def _merged(task: Any, mdp: FiniteMDP, names: tuple[str, ...]) -> Made:
    """Return the table with pairs of neighbouring values of these components merged."""
    if mdp.outcome_row.size * mdp.probability.shape[1] > LARGEST:
        raise TaskError(
            f"tables are merged up to {LARGEST:,} outcomes: this one has "
            f"{mdp.outcome_row.size * mdp.probability.shape[1]:,}"
        )
    space, cluster = _clusters(mdp, names)
    terminal = np.zeros(space.size, bool)
    terminal[cluster] = mdp.terminal  # a cluster has states of one sort
    start = np.zeros(space.size)
    np.add.at(start, cluster, mdp.start)
    probability, after, reward = _average(mdp, cluster, space.size)
    n_actions = mdp.outcome_row.shape[1]
    source = FiniteMDP(
        states=space,
        actions=mdp.actions,
        outcome_row=np.arange(space.size * n_actions).reshape(space.size, n_actions),
        probability=probability,
        next_state=after,
        reward=reward,
        terminal=terminal,
        start=start,
        discount=mdp.discount,
        time_limit=mdp.time_limit,
    )
    return source, pair_mapping(task, source, cluster[:, None], np.arange(n_actions))


def _clusters(mdp: FiniteMDP, names: tuple[str, ...]) -> tuple[Space, IntArray]:
    """Return the space of clusters, and the cluster of each state, (S,)."""
    values = mdp.states.decode()
    components, columns = [], []
    for one in mdp.states.components:
        if one.name in names:
            labels = None if one.labels is None else _joint_labels(one.labels)
            components.append(Component(one.name, ceil(one.size / 2), labels=labels))
            columns.append((values[one.name] - one.low) // 2)
        else:
            components.append(one)
            columns.append(values[one.name])
    points = np.column_stack(columns)
    _, cells = np.unique(points, axis=0, return_inverse=True)
    lives = np.bincount(cells.ravel(), ~mdp.terminal)
    ends = np.bincount(cells.ravel(), mdp.terminal)
    if ((lives > 0) & (ends > 0)).any():
        components.append(Component(_free("ended", mdp.states.names), 2, labels=("no", "yes")))
        points = np.column_stack([points, mdp.terminal])
    found, cluster = np.unique(points, axis=0, return_inverse=True)
    return Space(components, found), cluster.ravel().astype(np.int64)


def _average(mdp: FiniteMDP, cluster: IntArray, n: int) -> tuple[Any, Any, Any]:
    """Return chances, next clusters and rewards of the pairs of clusters, (n A, O') each.

    A reward is the mean over the outcomes of a pair that lead to the same cluster.
    """
    n_actions = mdp.outcome_row.shape[1]
    size = np.bincount(cluster, minlength=n)
    pair = (cluster[:, None] * n_actions + np.arange(n_actions)).ravel()
    chance = mdp.probability[mdp.outcome_row.ravel()] / size[cluster].repeat(n_actions)[:, None]
    reward = mdp.reward[mdp.outcome_row.ravel()]
    goes = cluster[mdp.next_state[mdp.outcome_row.ravel()]]
    # The rows of terminal states are never used, and may say anything.
    ends = np.repeat(mdp.terminal, n_actions)
    goes[ends] = np.repeat(cluster, n_actions)[ends, None]
    chance[ends], reward[ends] = 1.0, 0.0
    key = (pair[:, None] * n + goes).ravel()
    possible = chance.ravel() > 0
    keys, which = np.unique(key[possible], return_inverse=True)
    total = np.bincount(which, chance.ravel()[possible])
    earned = np.bincount(which, (chance * reward).ravel()[possible])
    rows = keys // n
    place = np.arange(len(keys)) - np.searchsorted(rows, rows)
    shape = n * n_actions, int(place.max()) + 1
    probability, after, mean = np.zeros(shape), np.zeros(shape, np.int64), np.zeros(shape)
    probability[rows, place], after[rows, place] = total, keys % n
    mean[rows, place] = earned / total
    return probability / probability.sum(axis=1, keepdims=True), after, mean


def _joint_labels(labels: tuple[str, ...]) -> tuple[str, ...]:
    """Return a label for each two neighbouring values."""
    pairs = (labels[i : i + 2] for i in range(0, len(labels), 2))
    return tuple(" or ".join(pair) for pair in pairs)


def _free(name: str, taken: tuple[str, ...]) -> str:
    while name in taken:
        name += "_"
    return name
