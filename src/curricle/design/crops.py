"""Candidates that are parts of the target around its goal."""

from collections.abc import Callable, Iterator
from functools import partial
from inspect import signature
from typing import Any

import numpy as np

from curricle.design.proposals import DesignTarget, Draft, Made, spread
from curricle.errors import TaskError
from curricle.tasks.deep_sea import DeepSea
from curricle.tasks.gridworld import GridWorld
from curricle.transfer.component_mapping import project
from curricle.transfer.mapping import same_position

MOST_GOALS = 4
"""Cells of a goal around which parts are taken."""
COMPONENTS = {"rows": "row", "columns": "column", "positions": "position"}
"""The component of a state that an axis of `crop` cuts."""

Range = tuple[int, int]


def crops(target: DesignTarget) -> Iterator[Draft]:
    """Yield the windows around the goal of a task that has `crop`, half the size first.

    Windows are squares where the task has rows and columns, and as long in any other axis. A
    :class:`DeepSea` has `bottom` in its place. Tasks of other classes yield none.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.design.proposals import design_target
    >>> [draft.name for draft in crops(design_target(GridWorld(["S...T", ".....", "....."])))]
    ['rows 0..2, columns 2..4', 'rows 0..1, columns 3..4', 'rows 0..2, columns 1..4']
    """
    task = target.task
    if isinstance(task, DeepSea):
        for rows in spread(range(1, task.size)):
            build = partial(_bottom, task, rows)
            words = f"the lowest {rows} rows alone"
            yield Draft("crop", f"lowest {rows} rows", words, build, "", rows / task.size)
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
                yield Draft("crop", name, words, partial(_part, task, part), "", side / longest)


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
    """Return a range of this length around a place, moved so that it lies in the extent.

    Examples
    --------
    >>> _window((0, 10), 4, 5), _window((0, 10), 4, 9), _window((0, 3), 4, 1)
    ((3, 7), (6, 10), (0, 3))
    """
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
