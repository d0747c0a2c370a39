"""Mappings between tasks whose components lie on paths of unequal lengths, without names.

In a row of a grid or a queue nearly every change leads from a value to a neighbouring value,
however values are numbered. Components and their directions are matched by the moves that change
them, values by the effects of actions: reward, next state, end of the episode. If the source is a
part of the target, its paths are windows of the target's paths. If it is a smaller version, the
target's paths are warped onto its paths by dynamic time warping (Sakoe, Chiba 1978), one path after
the other until nothing changes.
"""

from collections.abc import Iterator, Sequence
from itertools import permutations, product
from math import perm
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.arrays import FloatArray, IntArray
from curricle.errors import MappingError
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.spaces import MISSING, Space
from curricle.transfer.mapping import pair_mapping
from curricle.transfer.pair import Proposal, TaskPair

# -- the order of values ---------------------------------------------------------------------------

MOST_VALUES = 200  # most values of a component, whose pairs are all compared


class Path(NamedTuple):
    """A component of states whose values lie on a path."""

    place: int  # of the component
    values: IntArray  # (n,) the value at each position, numbered from 0
    position: IntArray  # (S,) of the states' values
    up: FloatArray  # (S, A) chance that the position rises; 0 in states that end the episode
    down: FloatArray  # (S, A) chance that it falls

    def reversed(self) -> "Path":
        """Return the same path, counted from its other end."""
        position = len(self.values) - 1 - self.position
        return Path(self.place, self.values[::-1], position, self.down, self.up)


def paths(mdp: FiniteMDP) -> list[Path]:
    """Return the components of states whose values lie on a path."""
    after = mdp.next_state[mdp.outcome_row]
    chance = np.where(mdp.terminal[:, None, None], 0.0, mdp.probability[mdp.outcome_row])
    on_paths = []
    for place, numbers in enumerate(numbered(mdp.states)):
        used, values = np.unique(numbers, return_inverse=True)  # rows of walls have no states
        size = len(used)
        if size > MOST_VALUES:
            continue
        moves = np.broadcast_to(values[:, None, None], after.shape) * size + values[after]
        weight = np.zeros((size, size))
        weight.ravel()[:] = np.bincount(moves.ravel(), chance.ravel(), minlength=size**2)
        order = path_order(weight + weight.T)
        if order is not None:
            position = order[values]
            step = position[after] - position[:, None, None]
            up, down = ((chance * moved).sum(axis=2) for moved in (step > 0, step < 0))
            on_paths.append(Path(place, used[np.argsort(order)], position, up, down))
    return on_paths


def numbered(space: Space) -> list[IntArray]:
    """Return each component's values at the n points of a space, numbered from 0, (n,) each."""
    values = space.decode()
    return [np.asarray(values[component.name] - component.low) for component in space.components]


def path_order(weight: FloatArray) -> IntArray | None:
    """Return the position of each value on the path of largest weights, (n,); None if no path."""
    # Pairs of values are joined from the heaviest pair on, a value to at most two other values,
    # never in a ring. The result is a path if all pairs left out weigh less. So moves that lead far
    # back do not hide the order of a row, but the cells of a grid have no order.
    first, second = np.triu_indices(len(weight), 1)
    part, beside = np.arange(len(weight)), [list[int]() for _ in weight]
    lightest, heaviest = np.inf, 0.0  # of pairs on the path; of pairs left out
    for pair in np.argsort(-weight[first, second], kind="stable"):
        a, b, weighs = int(first[pair]), int(second[pair]), float(weight[first[pair], second[pair]])
        if part[a] == part[b] or max(len(beside[a]), len(beside[b])) == 2:
            heaviest = max(heaviest, weighs)
        elif weighs > 0:
            lightest = weighs
            beside[a].append(b)
            beside[b].append(a)
            part[part == part[a]] = part[b]
    if (part != part[0]).any() or lightest <= heaviest:
        return None
    path = [min(range(len(weight)), key=lambda value: len(beside[value]))]
    while len(path) < len(weight):
        path.append(next(value for value in beside[path[-1]] if value not in path[-2:]))
    return np.argsort(path)


# -- paths laid side by side -----------------------------------------------------------------------

LARGEST = 50_000  # state-action pairs of a task
LARGEST_BOX = 2_000_000  # combinations of a source's values
MOST_ASSIGNMENTS = 10_000
MOST_LAID = 48  # most assignments whose values are matched, those of lowest cost
SLACK = 1.0  # most by which their cost may exceed the lowest cost
LARGEST_WORK = 20_000_000  # most pairs to compare for the windows of one assignment
KEPT = 4  # most windows, and most warps, to propose, those that fit best
NOWHERE = 2.0  # mismatch of a pair that reads a missing or terminal source state
STEP = 0.1
"""Cost, for each pair of a value, where a warp repeats or skips one source position."""
NEARER_SCALE = 1e-6  # cost that favours, among equal warps, the warp nearest to a linear scale
ROUNDS = 10


class Assigned(NamedTuple):
    """The target components and moves that stand for the source's components and moves."""

    paths: tuple[Path, ...]  # for each source path the target's, in its direction
    actions: tuple[int, ...]  # for each source component of actions the target's
    moves: tuple[IntArray, ...]  # and the source value of each target value, or MISSING
    cost: float  # difference between the changes that the moves make


class Laid(NamedTuple):
    """Target paths whose positions are matched to positions of the source's paths."""

    assigned: Assigned
    rows: tuple[IntArray, ...]  # for each path the source position of each position, or -1
    mismatch: float  # mean mismatch over the pairs inside
    cost: float  # mismatch plus the cost of a warp's uneven steps


def by_component_warping(tasks: TaskPair) -> Iterator[Proposal]:
    """Yield mappings that match target components to source components along paths of values.

    The search assigns the source's components to target components in either direction and keeps
    the assignments whose moves make the same changes. Target pairs outside a window are unmapped.
    Warped paths are proposed only where they fit better than every window.

    Raises
    ------
    MappingError
        When the values of a source component do not lie on a path, when the target has fewer
        components, or when there are too many pairs, combinations of values or assignments.

    Examples
    --------
    >>> from curricle.tasks import KeyLockPit
    >>> tasks = TaskPair(KeyLockPit.room(8), KeyLockPit.room(6))
    >>> next(by_component_warping(tasks)).how
    'components in order, warped: row is row, column is column, key is key, lock is lock; ...'
    """
    target_paths, source_paths = _checked_paths(tasks)
    cheapest = attrgetter("cost")
    assignments = sorted(_assignments(tasks, target_paths, source_paths), key=cheapest)
    warped, windows = list[Laid](), list[Laid]()
    for assigned in assignments[:MOST_LAID]:
        if assigned.cost <= assignments[0].cost + SLACK:
            match = _Match(tasks, assigned, source_paths)
            warped.append(match.warped())
            windows += match.windows()
    fit = min((window.mismatch for window in windows), default=np.inf)
    better = [way for way in warped if way.mismatch < fit]
    for kind, ways in (("warped", better), ("window", windows)):
        for laid in sorted(ways, key=cheapest)[:KEPT]:
            yield _proposal(tasks, laid, source_paths, kind)


def _checked_paths(tasks: TaskPair) -> tuple[list[Path], list[Path]]:
    """Return the paths of both tasks; MappingError if they do not fit or are too many."""
    target, source = tasks.target_mdp, tasks.source_mdp
    for mdp in (target, source):
        if mdp.outcome_row.size > LARGEST:
            raise MappingError(
                f"components are laid side by side in tasks of up to {LARGEST:,} pairs: one has "
                f"{mdp.outcome_row.size:,}"
            )
    combinations = np.prod(source.states.shape)
    if combinations > LARGEST_BOX:
        raise MappingError(
            f"components are laid side by side for up to {LARGEST_BOX:,} combinations of a "
            f"source's values: got {combinations:,}"
        )
    target_paths, source_paths = paths(target), paths(source)
    on_paths = {source.states.names[path.place] for path in source_paths}
    for name in source.states.names:
        if name not in on_paths:
            raise MappingError(
                "components are laid side by side if their values lie on paths: those of the "
                f"source's {name!r} do not"
            )
    actions = len(target.actions.components), len(source.actions.components)
    if len(target_paths) < len(source_paths) or actions[0] < actions[1]:
        raise MappingError(
            "each component of the source is laid beside another of the target: the source has "
            f"{len(source_paths)} and {actions[1]} of actions, the target {len(target_paths)} on "
            f"paths and {actions[0]} of actions"
        )
    ways = perm(len(target_paths), len(source_paths)) * 2 ** len(source_paths) * perm(*actions)
    if ways > MOST_ASSIGNMENTS:
        raise MappingError(
            f"components are assigned in up to {MOST_ASSIGNMENTS:,} ways: there are {ways:,}"
        )
    return target_paths, source_paths


# -- the assignment of components ------------------------------------------------------------------


def _assignments(
    tasks: TaskPair, target_paths: list[Path], source_paths: list[Path]
) -> Iterator[Assigned]:
    """Yield every assignment of components, with the moves that agree best."""
    from scipy.optimize import linear_sum_assignment  # its slow import is rarely needed

    shares = _shares(target_paths, tasks.target_mdp.actions)
    source_shares = _shares(source_paths, tasks.source_mdp.actions)
    for chosen in permutations(range(len(target_paths)), len(source_paths)):
        for turned in product((False, True), repeat=len(source_paths)):
            turns = list(zip(chosen, turned, strict=True))
            laid = tuple(
                target_paths[i].reversed() if turn else target_paths[i] for i, turn in turns
            )
            for actions in permutations(range(len(shares)), len(source_shares)):
                cost, moves = 0.0, []
                for c, theirs in zip(actions, source_shares, strict=True):
                    ours = np.stack([shares[c][i][:: -1 if turn else 1] for i, turn in turns])
                    table = abs(ours[..., :, None] - theirs[..., None, :]).sum(axis=(0, 1))
                    matched = linear_sum_assignment(table)
                    moves.append(np.full(len(table), MISSING))
                    moves[-1][matched[0]] = matched[1]
                    cost += float(table[matched].sum())
                yield Assigned(laid, actions, tuple(moves), cost)


def _shares(on_paths: list[Path], actions: Space) -> list[FloatArray]:
    """Return for each component of actions the shares of each path's rises and falls by value."""
    shares = []
    for values, component in zip(numbered(actions), actions.components, strict=True):
        moves = [(path.up.sum(axis=0), path.down.sum(axis=0)) for path in on_paths]
        sums = np.array([[np.bincount(values, m, component.size) for m in pair] for pair in moves])
        total = sums.sum(axis=2, keepdims=True)
        shares.append(np.divide(sums, total, out=np.zeros_like(sums), where=total > 0))
    return shares


# -- the matching of values ------------------------------------------------------------------------


class _Match:
    """Matches the target paths of an assignment to the source's paths."""

    def __init__(self, tasks: TaskPair, assigned: Assigned, source_paths: list[Path]):
        target, source = tasks.target_mdp, tasks.source_mdp
        self.assigned, live = assigned, ~target.terminal
        self.position = [path.position[live] for path in assigned.paths]
        self.sizes = [len(path.values) for path in assigned.paths]
        self.others = [len(path.values) for path in source_paths]
        paid = np.concatenate([_rewards(mdp)[~mdp.terminal].ravel() for mdp in (target, source)])
        scale = float(np.ptp(paid)) or 1.0
        action = _source_actions(tasks, assigned)
        self.mine = _described(target, assigned.paths, scale)[live]
        self.theirs = _described(source, source_paths, scale)[:, np.maximum(action, 0)]
        self.lacking = action == MISSING
        # The nonterminal source state at each combination of positions, -1 if there is none.
        self.state = np.full(self.others, -1)
        here = np.where(source.terminal, -1, np.arange(len(source.terminal)))
        self.state[tuple(path.position for path in source_paths)] = here

    def warped(self) -> Laid:
        """Return the warp that fits best, searched from the linear scale."""
        rows = [
            np.rint(np.linspace(0, there - 1, here)).astype(np.int64)
            for here, there in zip(self.sizes, self.others, strict=True)
        ]
        for _ in range(ROUNDS):
            before = [*rows]
            for i in range(len(rows)):
                rows[i] = self._warped_along(i, rows)
            if all(map(np.array_equal, before, rows)):
                break
        mismatch = float(self._mismatch(rows).mean())
        uneven = sum(float(abs(np.diff(row) - 1).sum()) / len(row) for row in rows)
        return Laid(self.assigned, tuple(rows), mismatch, mismatch + STEP * uneven)

    def windows(self) -> list[Laid]:
        """Return the source at every place within a larger target; [] if it does not fit."""
        free = [here - there + 1 for here, there in zip(self.sizes, self.others, strict=True)]
        if min(free) < 1 or max(free) == 1 or np.prod(free) * self.mine.size > LARGEST_WORK:
            return []
        fits = []
        for first in np.ndindex(*free):
            rows = []
            for size, there, at in zip(self.sizes, self.others, first, strict=True):
                row = np.arange(size) - at
                rows.append(np.where((row >= 0) & (row < there), row, -1))
            place = np.stack([row[at] for row, at in zip(rows, self.position, strict=True)])
            inside = (place >= 0).all(axis=0)
            if inside.any():
                mismatch = float(self._mismatch(rows, inside).mean())
                fits.append(Laid(self.assigned, tuple(rows), mismatch, mismatch))
        return fits

    def _mismatch(self, rows: list[IntArray], states: Any = slice(None)) -> FloatArray:
        """Return how much the effects of each pair differ from those of its source pair, (S, A)."""
        state = self.state[tuple(r[at[states]] for r, at in zip(rows, self.position, strict=True))]
        mismatch = abs(self.mine[states] - self.theirs[np.maximum(state, 0)]).sum(axis=2)
        mismatch[state < 0] = NOWHERE
        mismatch[:, self.lacking] = NOWHERE
        return np.asarray(mismatch)

    def _warped_along(self, i: int, rows: list[IntArray]) -> IntArray:
        """Return the warp of path i that fits best, with the other paths fixed."""
        size, other = self.sizes[i], self.others[i]
        costs = np.empty((size, other))
        for position in range(other):
            here = np.full(size, position)
            cost = self._mismatch([*rows[:i], here, *rows[i + 1 :]]).sum(axis=1)
            costs[:, position] = np.bincount(self.position[i], cost, size)
        in_scale = np.linspace(0, other - 1, size)[:, None]
        costs += NEARER_SCALE * abs(in_scale - np.arange(other))
        return warp(costs, STEP * self.mine.shape[0] * self.mine.shape[1] / size)


def warp(costs: FloatArray, step: float) -> IntArray:
    """Return the cheapest column for each row, (n,), columns never falling (time warping)."""
    ahead = np.arange(costs.shape[1])[:, None] - np.arange(costs.shape[1])  # to, from
    price = np.where(ahead >= 0, step * abs(ahead - 1), np.inf)
    total, came = costs[0], list[IntArray]()
    for cost in costs[1:]:
        ways = total + price
        came.append(ways.argmin(axis=1))
        total = ways.min(axis=1) + cost
    way = [int(total.argmin())]
    for back in reversed(came):
        way.append(int(back[way[-1]]))
    return np.array(way[::-1])


def _described(mdp: FiniteMDP, laid: Sequence[Path], scale: float) -> npt.NDArray[np.float32]:
    """Return the effects of each pair, (S, A, 2 + C): end, reward, and moves along each path."""
    ends = (mdp.probability * mdp.terminal[mdp.next_state]).sum(axis=1)[mdp.outcome_row]
    along = [path.up - path.down for path in laid]
    return np.stack([ends, _rewards(mdp) / scale, *along], axis=2).astype(np.float32)


def _rewards(mdp: FiniteMDP) -> FloatArray:
    return np.asarray((mdp.probability * mdp.reward).sum(axis=1)[mdp.outcome_row])


# -- proposals -------------------------------------------------------------------------------------


def _source_actions(tasks: TaskPair, assigned: Assigned) -> IntArray:
    """Return the source action of each target action, (A,), or `MISSING`."""
    values, space = numbered(tasks.target_mdp.actions), tasks.source_mdp.actions
    moves = zip(assigned.actions, assigned.moves, strict=True)
    return _encoded(space, [move[values[c]] for c, move in moves])


def _encoded(space: Space, values: list[IntArray]) -> IntArray:
    """Return the points of a space with these values, numbered from 0; `MISSING` if negative."""
    numbers = np.stack(values)
    shifted = np.maximum(numbers, 0) + np.array([[part.low] for part in space.components])
    points = space.encode(**dict(zip(space.names, shifted, strict=True)))
    return np.where((numbers >= 0).all(axis=0), points, MISSING)


def _proposal(tasks: TaskPair, laid: Laid, source_paths: list[Path], kind: str) -> Proposal:
    """Return the proposal of the mapping that matched paths make."""
    target, source, chosen = tasks.target_mdp, tasks.source_mdp, laid.assigned
    values = [
        np.where(row >= 0, there.values[row], -1)[path.position]
        for path, row, there in zip(chosen.paths, laid.rows, source_paths, strict=True)
    ]
    state = _encoded(source.states, values)
    # Nonterminal target states must not read terminal source states.
    state = np.where(source.terminal[state] & ~target.terminal, MISSING, state)
    index = pair_mapping(tasks.target, tasks.source, state[:, None], _source_actions(tasks, chosen))
    laid_beside = [path.place for path in chosen.paths]
    states = _in_words(source.states, target.states, laid_beside)
    actions = _in_words(source.actions, target.actions, chosen.actions)
    how = f"components in order, {kind}: {states}; actions: {actions}"
    return tasks.proposal(index.index, how)


def _in_words(source: Space, target: Space, places: Sequence[int]) -> str:
    """Return as text which target components, at these places, stand for the source's."""
    names = zip(source.names, (target.names[place] for place in places), strict=True)
    return ", ".join(f"{theirs} is {ours}" for theirs, ours in names)
