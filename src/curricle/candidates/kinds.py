"""The kinds of candidates for a source: generators of drafts, made from the target alone.

Parts of the target: easier members of its family, windows around the goal, starts near the goal
(Asada et al. 1996, "learning from easy missions"; Florensa et al. 2017, "reverse curriculum
generation for reinforcement learning"). Simpler models of the whole target: without hazards, a
predator or penalties, without chance, and with coarser tables.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from inspect import signature
from itertools import islice
from math import ceil
from typing import Any, NamedTuple, TypeVar

import numpy as np

from curricle.arrays import BoolArray, IntArray
from curricle.errors import TaskError
from curricle.tasks.exploration import DeepSea
from curricle.tasks.family import FamilyMember
from curricle.tasks.graph import reachable_states
from curricle.tasks.gridworld import OBJECTS, GridWorld
from curricle.tasks.mdp import FiniteMDP, Task, tables
from curricle.tasks.pursuit import Pursuit, predator_groups
from curricle.tasks.readers import Pairs
from curricle.tasks.rooms import FourRooms, KeyLockPit
from curricle.tasks.spaces import Component, Space
from curricle.tasks.start_states import GoalDistance, goal_distance, goal_states, with_start
from curricle.tasks.toy_text import CliffWalking, FrozenLake, Taxi
from curricle.text import counted
from curricle.transfer.bisimulation import merged_outcomes
from curricle.transfer.by_components import (
    ComponentMapping,
    family_mappings,
    identity,
    project,
    same_position,
)
from curricle.transfer.mapping import PairMapping, pair_mapping

MOST_LISTED = 10_000  # easier members to list; few of them are built
MOST_GOALS = 4  # goal cells around which parts are cut
AXES = {"rows": 0, "columns": 1, "positions": 1}
"""Parameter of `crop` -> the axis of the layout that it cuts."""
SWITCHES: dict[type, tuple[str, Any]] = {
    FrozenLake: ("slippery", False),
    CliffWalking: ("slippery", False),
    FourRooms: ("slip", 0.0),
    DeepSea: ("slip", 0.0),
    Taxi: ("rainy", False),
}
"""Type of a task -> its parameter for slipping, and the value without slipping."""
LARGEST_MERGED = 2_000_000  # outcomes of all pairs up to which tables are merged
FEWEST = 4  # fewest values of a component that is merged

Item = TypeVar("Item")
Range = tuple[int, int]
Places = tuple[tuple[int, int], ...]


# -- drafts --------------------------------------------------------------------------------------


class DesignTarget(NamedTuple):
    """A target, its tables and its goal, from which drafts are made."""

    task: Any
    member: FamilyMember | None  # the target's address, if it is a member of a family
    mdp: FiniteMDP
    goal: BoolArray  # (S,)


Made = tuple[Any, PairMapping | Sequence[PairMapping]]


class Draft(NamedTuple):
    """A candidate before its task is built."""

    kind: str
    name: str
    words: str
    build: Callable[[], Made]  # returns the task and its mappings, or raises CurricleError
    share: float | None = None
    member: FamilyMember | None = None


Mapped = TypeVar("Mapped", GridWorld, KeyLockPit, FrozenLake)  # tasks of a map


def paired(
    target: Task,
    make: Callable[[], Task],
    reads: Callable[[Any, Any], PairMapping] = identity,
) -> Callable[[], Made]:
    """Return a `build` for the task that `make` returns, with mapping `reads(target, source)`."""

    def build() -> Made:
        source = make()
        return source, reads(target, source)

    return build


def design_target(target: object) -> DesignTarget:
    """Return a task or member with its tables and goal; TaskError if it has no tables."""
    member = target if isinstance(target, FamilyMember) else None
    task = target if member is None else member.task
    mdp = tables(task)
    return DesignTarget(task, member, mdp, aims(mdp))


def aims(mdp: FiniteMDP) -> BoolArray:
    """Return the goal, (S,) bool: the best terminal states, else states of the largest reward."""
    try:
        return goal_states(mdp)
    except TaskError:
        mean = (mdp.probability * mdp.reward).sum(axis=1)[mdp.outcome_row].max(axis=1)
        live = ~mdp.terminal
        return np.asarray(live & (mean >= mean[live].max(initial=-np.inf)))


def spread(items: Iterable[Item]) -> list[Item]:
    """Return items, the middle item first, so that the first few are spread over all items."""
    items = list(items)
    order, parts = list[Item](), [(0, len(items))]
    for low, high in parts:  # `parts` grows during the loop
        if low < high:
            middle = (low + high - 1) // 2
            order.append(items[middle])
            parts += [(low, middle), (middle + 1, high)]
    return order


# -- members of the target's family --------------------------------------------------------------


def family_members(target: DesignTarget) -> Iterator[Draft]:
    """Yield members that are harder than the target in no parameter, in the order of `spread`."""
    if target.member is None:
        return
    parameters = target.member.parameters
    for source in spread(islice(target.member.family.easier(target.member), MOST_LISTED)):
        changes = ", ".join(
            f"{name} {value} instead of {parameters[name]}"
            for name, value in source.parameters.items()
            if value != parameters[name]
        )
        about = f"an easier member of the family: {changes}"
        build = partial(_member, target.member, source)
        yield Draft("member", str(source), about, build, member=source)


def _member(target: FamilyMember, source: FamilyMember) -> Made:
    return source.task, family_mappings(target, source)


# -- windows around the goal ---------------------------------------------------------------------


def crops(target: DesignTarget) -> Iterator[Draft]:
    """Yield windows around the goal of a task with `crop` and `layout`, half the size first."""
    task = target.task
    if isinstance(task, DeepSea):
        for rows in spread(range(1, task.size)):
            build = paired(task, partial(task.bottom, rows), project)
            about = f"the lowest {rows} rows alone"
            yield Draft("crop", f"lowest {rows} rows", about, build, rows / task.size)
        return
    axes = _axes(task, np.flatnonzero(target.goal))
    extents = {axis: extent for axis, (extent, _) in axes.items()}
    longest = max((high - low for low, high in extents.values()), default=0)
    reads = same_position if isinstance(task, GridWorld) else project
    cells = list(dict.fromkeys(zip(*(places for _, places in axes.values()), strict=True)))
    for side in spread(range(2, longest)):
        for cell in cells[:MOST_GOALS]:
            places = zip(extents, cell, strict=True)
            part = {axis: _window(extents[axis], side, place) for axis, place in places}
            if part != extents:
                name = ", ".join(f"{axis} {low}..{high - 1}" for axis, (low, high) in part.items())
                about = f"the part around the goal: {name}"
                build = paired(task, partial(task.crop, **part), reads)
                yield Draft("crop", name, about, build, side / longest)


def _axes(task: Any, goal: IntArray) -> dict[str, tuple[Range, list[int]]]:
    """Return the half-open range of each axis that `crop` cuts, and where the goal lies on it."""
    layout: Any = getattr(task, "layout", None)
    if layout is None or not hasattr(task, "crop"):
        return {}
    axes = dict[str, tuple[Range, list[int]]]()
    for name in (name for name in AXES if name in signature(task.crop).parameters):
        first, size = layout.origin[AXES[name]], layout.shape[AXES[name]]
        axes[name] = (first, first + size), layout.cells[goal, AXES[name]].tolist()
    return axes


def _window(extent: Range, side: int, place: int) -> Range:
    """Return the range of length `side` around a place, moved into the extent."""
    low, high = extent
    side = min(side, high - low)
    first = min(max(place - side // 2, low), high - side)
    return first, first + side


# -- starts near the goal ------------------------------------------------------------------------


def start_rings(target: DesignTarget) -> Iterator[Draft]:
    """Yield the target with starts 1 to d steps from the goal, half the largest d first."""
    far = int(goal_distance(target.mdp, target.goal)[target.mdp.start_states].max(initial=0))
    goal = np.flatnonzero(target.goal)
    for most in spread(range(1, far)):
        ring = "1" if most == 1 else f"1..{most}"
        about = f"episodes start {ring} step{'s' * (most > 1)} from the goal"
        start = GoalDistance(1, most, goal=goal)
        build = paired(target.task, partial(with_start, target.task, start))
        yield Draft("starts", f"starts {ring} from the goal", about, build, most / far)


# -- something removed -----------------------------------------------------------------------------
# Hazards are pits and fires of a GridWorld, holes of a FrozenLake and pits of a KeyLockPit. In a
# table where most steps have the same reward, lower rewards are penalties; a penalty is removed by
# putting the reward of most steps in its place.


def removals(target: DesignTarget) -> Iterator[Draft]:
    """Yield the target without a predator, all hazards, some of them, or penalties."""
    task, mdp = target.task, target.mdp
    if isinstance(task, Pursuit):
        for n in range(1, task.predators):
            about = f"the same grid with {n} of {task.predators} predators"
            fewer = partial(_with_predators, task, n)
            yield Draft("removed", counted(n, "predator"), about, fewer)
    yield from _without_hazards(task)
    row = mdp.outcome_row[~mdp.terminal]
    rewards = mdp.reward[row][mdp.probability[row] > 0]
    values, counts = np.unique(rewards, return_counts=True)
    most = int(counts.argmax()) if counts.size else 0
    if counts.size and 2 * counts[most] > counts.sum() and most > 0:  # some rewards are lower
        reward = np.maximum(mdp.reward, values[most])
        build = paired(task, partial(replace, mdp, reward=reward))
        yield Draft("removed", "no penalties", "no reward is below that of most steps", build)


def _without_hazards(task: Any) -> Iterator[Draft]:
    names = dict[str, str]()  # hazard's character on the map -> its name
    if isinstance(task, GridWorld):
        rewards = {"F": task.rewards.fire, "P": task.rewards.pit}
        names = {sign: OBJECTS[sign] for sign, reward in rewards.items() if reward < 0}
    elif isinstance(task, KeyLockPit) and task.pit_reward < 0:
        names = {"P": "pit"}
    elif isinstance(task, FrozenLake):
        names = {"H": "hole"}
    hazards = [
        (names[character], (row, column))
        for row, line in enumerate(task.map if names else ())
        for column, character in enumerate(line)
        if character in names
    ]
    kinds = sorted({name for name, _ in hazards})
    groups: list[tuple[str, Places]] = []
    if len(kinds) > 1:
        groups.append(("no hazards", tuple(place for _, place in hazards)))
    for kind in kinds:
        places = tuple(place for name, place in hazards if name == kind)
        if len(places) > 1 or len(kinds) > 1:
            groups.append((f"no {kind}", places))
    for kind, (row, column) in hazards:
        at = row + task.origin[0], column + task.origin[1]
        groups.append((f"no {kind} at {at}", ((row, column),)))
    reads = same_position if isinstance(task, GridWorld) else project
    for name, places in groups:
        about = f"the same map, {counted(len(places), 'hazard')} removed"
        yield Draft("removed", name, about, paired(task, partial(_cleared, task, places), reads))


def _cleared(task: Mapped, places: Places) -> Mapped:
    """Return the task with the map's cells at these places made free."""
    free = "F" if isinstance(task, FrozenLake) else "."
    lines = [list(line) for line in task.map]
    for row, column in places:
        lines[row][column] = free
    return replace(task, map=tuple("".join(line) for line in lines))


def _with_predators(task: Pursuit, n: int) -> Made:
    """Return the pursuit of the first n predators, with a mapping for each group of n."""
    capture = min(task.capture, n) if isinstance(task.capture, int) else task.capture
    source = replace(task, predators=n, capture=capture)
    groups = predator_groups(task, source)
    return source, [ComponentMapping(task, source, group) for group in groups]


# -- no chance -------------------------------------------------------------------------------------


def likeliest_outcomes(target: DesignTarget) -> Iterator[Draft]:
    """Yield the target without chance; its build fails if likeliest outcomes are not unique."""
    task, mdp = target.task, target.mdp
    if (np.count_nonzero(mdp.probability, axis=1) <= 1).all():
        return
    parameter, plain = SWITCHES.get(type(task), ("", None))
    if parameter and getattr(task, parameter) != plain:
        name, about = "no slipping", "moves do what they are meant to"
        build = paired(task, partial(replace, task, **{parameter: plain}))
    else:
        name, about = "likeliest outcomes", "every action has its likeliest outcome"
        build = paired(task, partial(_likeliest, mdp))
    yield Draft("deterministic", name, about, build)


def _likeliest(mdp: FiniteMDP) -> FiniteMDP:
    """Return the tables with the likeliest outcome of each row; TaskError if two are equal."""
    after, chances = merged_outcomes(mdp.next_state, mdp.probability)
    best = chances.max(axis=1)
    ties = np.isclose(chances, best[:, None], rtol=1e-9, atol=0).sum(axis=1) > 1
    visited = reachable_states(mdp) & ~mdp.terminal
    bad = np.argwhere(ties[mdp.outcome_row] & visited[:, None])
    if len(bad):
        raise TaskError(
            "a likeliest outcome must be the only one: state "
            f"{bad[0][0]}, action {bad[0][1]} has several"
        )
    chosen = np.take_along_axis(after, chances.argmax(axis=1)[:, None], axis=1)
    chosen = np.maximum(chosen, 0)  # unused rows of terminal states may have no outcome
    share = np.where(mdp.next_state == chosen, mdp.probability, 0.0)
    total, chance = (x.sum(axis=1, keepdims=True) for x in (share * mdp.reward, share))
    reward = total / np.where(chance > 0, chance, 1.0)
    return replace(mdp, probability=np.ones_like(reward), next_state=chosen, reward=reward)


# -- coarser tables --------------------------------------------------------------------------------
# State aggregation as in Singh, Jaakkola, Jordan 1995, "reinforcement learning with soft state
# aggregation", with hard clusters: outcomes of a cluster are averaged over its states.


def coarser_tables(target: DesignTarget) -> Iterator[Draft]:
    """Yield the target with pairs of values merged, in all ordered components or in one."""
    # Values are ordered if they have no labels, or labels of `Bins`; ``state`` is not ordered.
    states = target.mdp.states
    names = list[str]()
    for component in states.components if states.names != ("state",) else ():
        labels = component.labels or ("below ", " and above")
        ordered = labels[0].startswith("below ") and labels[-1].endswith(" and above")
        if ordered and component.size >= FEWEST:
            names.append(component.name)
    groups = [tuple(names)] if names else []
    groups += [(name,) for name in names] if len(names) > 1 else []
    for group in groups:
        name = f"{', '.join(group)} by 2"
        about = f"a coarser table: each two values of {' and '.join(group)} are one"
        build = partial(_merged, target.task, target.mdp, group)
        yield Draft("coarser", name[:90], about, build)


def _merged(task: Task, mdp: FiniteMDP, names: tuple[str, ...]) -> Made:
    """Return the table with pairs of neighbouring values of these components merged."""
    if mdp.outcome_row.size * mdp.probability.shape[1] > LARGEST_MERGED:
        raise TaskError(
            f"tables are merged up to {LARGEST_MERGED:,} outcomes: this one has "
            f"{mdp.outcome_row.size * mdp.probability.shape[1]:,}"
        )
    space, cluster = _clusters(mdp, names)
    terminal, start = np.zeros(space.size, bool), np.zeros(space.size)
    terminal[cluster] = mdp.terminal  # terminal and other states are in different clusters
    np.add.at(start, cluster, mdp.start)
    probability, after, reward = _average(mdp, cluster, space.size)
    n_actions, available = mdp.outcome_row.shape[1], None
    if mdp.available is not None:  # what one of a cluster's states allows
        available = np.zeros((space.size, n_actions), bool)
        np.logical_or.at(available, cluster, mdp.available)
    source = replace(
        mdp,
        states=space,
        outcome_row=np.arange(space.size * n_actions).reshape(space.size, n_actions),
        probability=probability,
        next_state=after,
        reward=reward,
        terminal=terminal,
        start=start,
        available=available,
    )
    return source, pair_mapping(task, source, cluster[:, None], np.arange(n_actions))


def _clusters(mdp: FiniteMDP, names: tuple[str, ...]) -> tuple[Space, IntArray]:
    """Return the space of clusters, and the cluster of each state, (S,)."""
    values, components, columns = mdp.states.decode(), [], []
    for component in mdp.states.components:
        name, labels, column = component.name, component.labels, values[component.name]
        if name in names:
            if labels is not None:
                pairs = (labels[i : i + 2] for i in range(0, len(labels), 2))
                labels = tuple(" or ".join(pair) for pair in pairs)
            column = (column - component.low) // 2
            component = Component(name, ceil(component.size / 2), labels=labels)
        components.append(component)
        columns.append(column)
    points = np.column_stack(columns)
    _, cells = np.unique(points, axis=0, return_inverse=True)
    lives, ends = (np.bincount(cells.ravel(), sort) for sort in (~mdp.terminal, mdp.terminal))
    if ((lives > 0) & (ends > 0)).any():
        name = "ended"
        while name in mdp.states.names:
            name += "_"
        components.append(Component(name, 2, labels=("no", "yes")))
        points = np.column_stack([points, mdp.terminal])
    distinct, cluster = np.unique(points, axis=0, return_inverse=True)
    return Space(components, distinct), cluster.ravel().astype(np.int64)


def _average(mdp: FiniteMDP, cluster: IntArray, n: int) -> tuple[Any, Any, Any]:
    """Return chances, next clusters and mean rewards of n clusters' pairs, (n A, O') each."""
    n_actions, row = mdp.outcome_row.shape[1], mdp.outcome_row.ravel()
    pair = (cluster[:, None] * n_actions + np.arange(n_actions)).ravel()
    # An action counts where it is available; where no state of a cluster has it, all rows do.
    allowed = np.ones(pair.size) if mdp.available is None else mdp.available.ravel().astype(float)
    allowed[np.bincount(pair, allowed)[pair] == 0] = 1.0
    size = np.bincount(pair, allowed)[pair]
    chance = mdp.probability[row] * allowed[:, None] / size[:, None]
    reward, goes = mdp.reward[row], cluster[mdp.next_state[row]]
    # The rows of terminal states are never used, so their content is arbitrary.
    ends = np.repeat(mdp.terminal, n_actions)
    goes[ends] = np.repeat(cluster, n_actions)[ends, None]
    chance[ends], reward[ends] = 1.0, 0.0
    key, possible = (pair[:, None] * n + goes).ravel(), chance.ravel() > 0
    keys, which = np.unique(key[possible], return_inverse=True)
    total = np.bincount(which, chance.ravel()[possible])
    earned = np.bincount(which, (chance * reward).ravel()[possible])
    pairs = np.divmod(np.arange(n * n_actions), n_actions)
    counts = np.bincount(keys // n, minlength=n * n_actions)
    outcomes = total, keys % n, earned / total
    probability, after, mean = Pairs((n, n_actions), *pairs, counts, *outcomes).tables()[2]
    return probability / probability.sum(axis=1, keepdims=True), after, mean
