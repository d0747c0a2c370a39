"""Candidates that are simpler models of the whole target: something removed, no chance, coarser.

What a hazard or an agent is depends on the task: pits and fires of a :class:`GridWorld` and holes
of a :class:`FrozenLake`, pits of a :class:`KeyLockPit`, and a predator of a :class:`Pursuit`. Of
any other table only this is defined: where most steps have one and the same reward, a penalty is a
lower one, and without penalties it is that reward.

Coarser tables are state aggregation as in Singh, Jaakkola, Jordan 1995, "reinforcement learning
with soft state aggregation", with hard clusters: a cluster goes on as its states do on average.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from math import ceil
from typing import Any

import numpy as np

from curricle.array_types import FloatArray, IntArray
from curricle.design.proposals import DesignTarget, Draft, Made, by_number
from curricle.errors import TaskError
from curricle.tasks.cliff_walking import CliffWalking
from curricle.tasks.deep_sea import DeepSea
from curricle.tasks.four_rooms import FourRooms
from curricle.tasks.frozen_lake import FrozenLake
from curricle.tasks.gridworld import OBJECTS, GridWorld
from curricle.tasks.key_lock_pit import KeyLockPit
from curricle.tasks.mdp import FiniteMDP, reachable_states
from curricle.tasks.pursuit import Pursuit
from curricle.tasks.spaces import Component, Space
from curricle.tasks.taxi import Taxi
from curricle.text_tables import counted
from curricle.transfer.bisimulation import merged_outcomes
from curricle.transfer.by_components import ComponentMapping, project
from curricle.transfer.mapping import pair_mapping, same_position

SWITCHES: dict[type, tuple[str, Any]] = {
    FrozenLake: ("slippery", False),
    CliffWalking: ("slippery", False),
    FourRooms: ("slip", 0.0),
    DeepSea: ("slip", 0.0),
    Taxi: ("rainy", False),
}
"""The parameter by which a task says that moves do what they are meant to."""
LARGEST = 2_000_000
"""Outcomes of all pairs up to which a table is merged."""
FEWEST = 4
"""Values of a component that is worth merging."""

Places = tuple[tuple[int, int], ...]


def removals(target: DesignTarget) -> Iterator[Draft]:
    """Yield the target without hazards, without each of them, a predator, or penalties."""
    task = target.task
    if isinstance(task, Pursuit):
        yield from _fewer_predators(task)
    yield from _without_hazards(task)
    usual = usual_reward(target.mdp)
    if usual is not None and _has_less(target.mdp, usual):
        words = "no reward is below that of most steps"
        build = partial(_without_penalties, task, target.mdp, usual)
        yield Draft("removed", "no penalties", words, build)


# -- hazards on a map ----------------------------------------------------------------------------


def _without_hazards(task: Any) -> Iterator[Draft]:
    names = _hazards(task)
    found = [
        (names[character], (row, column))
        for row, line in enumerate(task.map if names else ())
        for column, character in enumerate(line)
        if character in names
    ]
    groups: list[tuple[str, Places]] = []
    kinds = sorted({name for name, _ in found})
    if len(kinds) > 1:
        groups.append(("no hazards", tuple(place for _, place in found)))
    for kind in kinds:
        places = tuple(place for name, place in found if name == kind)
        if len(places) > 1 or len(kinds) > 1:
            groups.append((f"no {kind}", places))
    for kind, (row, column) in found:
        at = row + task.origin[0], column + task.origin[1]
        groups.append((f"no {kind} at {at}", ((row, column),)))
    for name, places in groups:
        count = f"{counted(len(places), 'hazard')} removed"
        build = partial(_cleared, task, places)
        yield Draft("removed", name, f"the same map, {count}", build)


def _hazards(task: Any) -> dict[str, str]:
    """Return the characters of a task's map that are hazards, and their names."""
    if isinstance(task, GridWorld):
        rewards = {"F": task.rewards.fire, "P": task.rewards.pit}
        return {one: OBJECTS[one] for one, reward in rewards.items() if reward < 0}
    if isinstance(task, KeyLockPit):
        return {"P": "pit"} if task.pit_reward < 0 else {}
    if isinstance(task, FrozenLake):
        return {"H": "hole"}
    return {}


def _cleared(task: Any, places: Places) -> Made:
    """Return the task with free cells in these places of its map."""
    free = "F" if isinstance(task, FrozenLake) else "."
    lines = [list(line) for line in task.map]
    for row, column in places:
        lines[row][column] = free
    source = replace(task, map=tuple("".join(line) for line in lines))
    if isinstance(task, GridWorld):
        return source, same_position(task, source)
    return source, project(task, source)


# -- predators -----------------------------------------------------------------------------------


def _fewer_predators(task: Pursuit) -> Iterator[Draft]:
    if callable(task.prey) or (task.prey != "uniform" and len(task.prey) != task.cells):
        return  # a prey that looks at the predators has no policy without one of them
    for n in range(1, task.predators):
        name = counted(n, "predator")
        words = f"the same grid with {n} of {task.predators} predators"
        yield Draft("removed", name, words, partial(_with_predators, task, n))


def _with_predators(task: Pursuit, n: int) -> Made:
    """Return the pursuit with the first n predators; each group of them reads it in turn."""
    capture = min(task.capture, n) if isinstance(task.capture, int) else task.capture
    source = replace(task, predators=n, capture=capture)
    own, fewer = task.predator_names, source.predator_names
    groups = (
        {name: own[(first + i) % len(own)] for i, name in enumerate(fewer)}
        for first in range(len(own))
    )
    return source, [ComponentMapping(task, source, group) for group in groups]


# -- penalties of any table ----------------------------------------------------------------------


def usual_reward(mdp: FiniteMDP) -> float | None:
    """Return the reward of more than half of all possible outcomes of live pairs, else None."""
    row = mdp.outcome_row[~mdp.terminal]
    rewards = mdp.reward[row][mdp.probability[row] > 0]
    values, counts = np.unique(rewards, return_counts=True)
    most = int(counts.argmax()) if counts.size else 0
    return float(values[most]) if counts.size and 2 * counts[most] > counts.sum() else None


def _has_less(mdp: FiniteMDP, usual: float) -> bool:
    """Return whether a possible outcome of a live pair has less than the usual reward."""
    row = mdp.outcome_row[~mdp.terminal]
    return bool((mdp.reward[row][mdp.probability[row] > 0] < usual).any())


def _without_penalties(task: Any, mdp: FiniteMDP, usual: float) -> Made:
    source = replace(mdp, reward=np.maximum(mdp.reward, usual))
    return source, by_number(task, source)


# -- no chance -----------------------------------------------------------------------------------


def likeliest_outcomes(target: DesignTarget) -> Iterator[Draft]:
    """Yield the target without chance, if there is any in it.

    A task with a parameter for slipping has it switched off. In any other each pair goes to its
    likeliest next state, with the mean reward of going there. That is not defined where two next
    states are equally likely in a state that can be reached, as those of a prey that moves at
    random: the draft then fails.
    """
    if (np.count_nonzero(target.mdp.probability, axis=1) <= 1).all():
        return
    switch = SWITCHES.get(type(target.task))
    if switch and getattr(target.task, switch[0]) != switch[1]:
        build = partial(_switched, target.task, *switch)
        yield Draft("deterministic", "no slipping", "moves do what they are meant to", build)
        return
    words = "every action has its likeliest outcome"
    build = partial(_likeliest, target.task, target.mdp)
    yield Draft("deterministic", "likeliest outcomes", words, build)


def _switched(task: Any, name: str, value: Any) -> Made:
    source = replace(task, **{name: value})
    return source, by_number(task, source)


def _likeliest(task: Any, mdp: FiniteMDP) -> Made:
    """Return the tables with one outcome a row; TaskError where two are equally likely."""
    after, chances = merged_outcomes(mdp.next_state, mdp.probability)
    best = chances.max(axis=1)
    ties = np.isclose(chances, best[:, None], rtol=1e-9, atol=0).sum(axis=1) > 1
    met = reachable_states(mdp) & ~mdp.terminal
    bad = np.argwhere(ties[mdp.outcome_row] & met[:, None])
    if len(bad):
        raise TaskError(
            "a likeliest outcome must be the only one: state "
            f"{bad[0][0]}, action {bad[0][1]} has several"
        )
    chosen = np.take_along_axis(after, chances.argmax(axis=1)[:, None], axis=1)
    chosen = np.maximum(chosen, 0)  # rows of terminal states may have no outcome: none is used
    source = replace(
        mdp,
        probability=np.ones((len(chosen), 1)),
        next_state=chosen,
        reward=_mean_reward(mdp, chosen),
    )
    return source, by_number(task, source)


def _mean_reward(mdp: FiniteMDP, chosen: IntArray) -> FloatArray:
    """Return the mean reward of each row where it goes to the chosen state, (Y, 1)."""
    share = np.where(mdp.next_state == chosen, mdp.probability, 0.0)
    total = (share * mdp.reward).sum(axis=1, keepdims=True)
    chance = share.sum(axis=1, keepdims=True)
    return np.asarray(total / np.where(chance > 0, chance, 1.0))


# -- coarser tables ------------------------------------------------------------------------------


def coarser_tables(target: DesignTarget) -> Iterator[Draft]:
    """Yield the target with neighbouring values merged, of all ordered components and of each.

    A component is ordered if its values have no labels, or those that :class:`Bins` gives them.
    The only component of a table without names, ``state``, is a numbering and no order. A terminal
    state is never merged with one that is not.
    """
    names = ordered_components(target.mdp.states)
    groups = [names] if names else []
    groups += [(name,) for name in names] if len(names) > 1 else []
    for group in groups:
        name = f"{', '.join(group)} by 2"
        words = f"a coarser table: each two values of {' and '.join(group)} are one"
        build = partial(_merged, target.task, target.mdp, group)
        yield Draft("coarser", name[:90], words, build)


def ordered_components(states: Space) -> tuple[str, ...]:
    """Return the components whose neighbouring values are alike, as far as a space tells."""
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
