"""Candidates that are a part of the target: easier members, windows around the goal, near starts.

Starts near the goal, in rings from the goal outwards: Asada et al. 1996, "learning from easy
missions"; Florensa et al. 2017, "reverse curriculum generation for reinforcement learning".
"""

from collections.abc import Callable, Iterator
from functools import partial
from inspect import signature
from itertools import islice
from typing import Any

import numpy as np

from curricle.design.proposals import DesignTarget, Draft, Made, by_number, spread
from curricle.errors import TaskError
from curricle.tasks.deep_sea import DeepSea
from curricle.tasks.families.family import FamilyMember
from curricle.tasks.gridworld import GridWorld
from curricle.tasks.start_states import GoalDistance, goal_distance, with_start
from curricle.transfer.by_components import family_mappings, project
from curricle.transfer.mapping import same_position

MOST_LISTED = 10_000
"""Easier members that are listed at most; addresses alone, of which few are built."""
MOST_GOALS = 4
"""Cells of a goal around which parts are taken."""
COMPONENTS = {"rows": "row", "columns": "column", "positions": "position"}
"""The component of a state that an axis of `crop` cuts."""

Range = tuple[int, int]


# -- members of the target's family --------------------------------------------------------------


def family_members(target: DesignTarget) -> Iterator[Draft]:
    """Yield the members that are nowhere harder than the target, spread over all of them."""
    if target.member is None:
        return
    parameters = target.member.parameters
    for source in spread(islice(target.member.family.easier(target.member), MOST_LISTED)):
        changes = ", ".join(
            f"{name} {value} instead of {parameters[name]}"
            for name, value in source.parameters.items()
            if value != parameters[name]
        )
        words = f"an easier member of the family: {changes}"
        build = partial(_member, target.member, source)
        yield Draft("member", str(source), words, build, member=source)


def _member(target: FamilyMember, source: FamilyMember) -> Made:
    return source.task, family_mappings(target, source)


# -- windows around the goal ---------------------------------------------------------------------


def crops(target: DesignTarget) -> Iterator[Draft]:
    """Yield the windows around the goal of a task that has `crop`, half the size first.

    Windows are squares where the task has rows and columns, and as long in any other axis. A
    :class:`DeepSea` has `bottom` in its place. Tasks of other classes yield none.
    """
    task = target.task
    if isinstance(task, DeepSea):
        for rows in spread(range(1, task.size)):
            build = partial(_bottom, task, rows)
            words = f"the lowest {rows} rows alone"
            yield Draft("crop", f"lowest {rows} rows", words, build, rows / task.size)
        return
    extents = _extents(task)
    if not extents:
        return
    longest = max(high - low for low, high in extents.values())
    for side in spread(range(2, longest)):
        for goal in _goal_cells(target, extents):
            part = {axis: _window(extents[axis], side, place) for axis, place in goal.items()}
            if part != extents:
                name = ", ".join(f"{axis} {low}..{high - 1}" for axis, (low, high) in part.items())
                words = f"the part around the goal: {name}"
                yield Draft("crop", name, words, partial(_part, task, part), side / longest)


def _extents(task: Any) -> dict[str, Range]:
    """Return the half-open range of each axis that `crop` cuts; none where it is not ours."""
    crop: Callable[..., Any] | None = getattr(task, "crop", None)
    if crop is None or not hasattr(task, "states"):
        return {}
    axes = [name for name in signature(crop).parameters if name in COMPONENTS]
    layout = getattr(task, "layout", None)
    found = {}
    for axis in axes:
        name = COMPONENTS[axis]
        if name in task.states.names:
            component = task.states.component(name)
            found[axis] = (component.low, component.high + 1)
        elif layout is not None and name != "position":  # a state names objects, and no cell
            n = ("row", "column").index(name)
            found[axis] = (layout.origin[n], layout.origin[n] + layout.shape[n])
        else:
            return {}
    return found


def _goal_cells(target: DesignTarget, extents: dict[str, Range]) -> list[dict[str, int]]:
    """Return where the goal lies on each axis, a few cells of it."""
    states = np.flatnonzero(target.goal)
    values = target.task.states.decode(states)
    columns = []
    for axis in extents:
        name = COMPONENTS[axis]
        if name in values:
            columns.append(values[name])
        else:
            columns.append(target.task.layout.cells[states, ("row", "column").index(name)])
    cells = list(dict.fromkeys(zip(*(column.tolist() for column in columns), strict=True)))
    return [dict(zip(extents, cell, strict=True)) for cell in cells[:MOST_GOALS]]


def _window(extent: Range, side: int, place: int) -> Range:
    """Return a range of this length around a place, moved so that it lies in the extent."""
    low, high = extent
    side = min(side, high - low)
    first = min(max(place - side // 2, low), high - side)
    return first, first + side


def _part(task: Any, part: dict[str, Range]) -> Made:
    source = _cut(task, part)
    if isinstance(task, GridWorld):
        return source, same_position(task, source)
    return source, project(task, source)


def _cut(task: Any, part: dict[str, Range]) -> Any:
    """Return the part; where its agent must begin inside, as far from the goal as it can."""
    if "agent" not in signature(task.crop).parameters:
        return task.crop(**part)
    low, high = part["columns"]
    for column in (None, *range(high - 1, low - 1, -1)):
        try:
            return task.crop(**part, agent=column)
        except TaskError as error:
            last = error
    raise last


def _bottom(task: DeepSea, rows: int) -> Made:
    source = task.bottom(rows)
    return source, project(task, source)


# -- starts near the goal ------------------------------------------------------------------------


def start_rings(target: DesignTarget) -> Iterator[Draft]:
    """Yield the target with starts in 1 to d steps from the goal, half the way first.

    There is one for each d below the distance of the farthest start.
    """
    far = int(goal_distance(target.mdp, target.goal)[target.mdp.start_states].max(initial=0))
    for most in spread(range(1, far)):
        ring = "1" if most == 1 else f"1..{most}"
        words = f"episodes start {ring} step{'s' * (most > 1)} from the goal"
        build = partial(_ring, target, most)
        yield Draft("starts", f"starts {ring} from the goal", words, build, most / far)


def _ring(target: DesignTarget, most: int) -> Made:
    goal = np.flatnonzero(target.goal)
    source = with_start(target.task, GoalDistance(1, most, goal=goal))
    return source, by_number(target.task, source)
