"""Grid views: the states of a task that a grid shows, the cell of each, and what moves.

:mod:`curricle.plotting.grids` draws a view with Matplotlib, :mod:`curricle.report.svg` as SVG.
"""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import cycle
from typing import Any

import numpy as np

from curricle.arrays import BoolArray, IntArray
from curricle.checks import instance
from curricle.errors import SettingError
from curricle.tasks.grid_layout import LETTERS, GridLayout, layout_of
from curricle.tasks.live import is_live, reset_state
from curricle.tasks.spaces import MISSING, Component, Space, action_name
from curricle.tasks.task import generative_model, has_tables, tables

At = Mapping[str, Any]
"""Component name -> its value, a number, a label, or for a cell (row, column)."""

STRIP, LONGEST_STRIP = 6, 60
"""States without geometry stand in a strip: states a row, and states at most."""
MOST_CELLS = 2500
"""Cells of a replayed grid at most."""
DIRECTIONS = {"stay": 0, "noop": 0, "north": 1, "up": 1, "east": 2, "right": 2}
DIRECTIONS |= {"south": 3, "down": 3, "west": 4, "left": 4}
DIRECTIONS |= dict.fromkeys(("pick up", "put down", "drop off", "unlock"), 0)
AGENTS, OTHER = ("blue", "vermillion", "green", "purple"), "black"
"""Colours of markers that act, and of others, by their names in the palette of all figures."""

_CELL = re.compile(r"\((\d+), ?(\d+)\)")


@dataclass(frozen=True, eq=False)
class Marker:
    """Something that moves over a grid during an episode."""

    letter: str
    colour: str  # its name
    cells: IntArray  # (S,): row * columns + column in each state; -1 where that is not shown


@dataclass(frozen=True, eq=False)
class GridView:
    """Some states of a task as cells of a grid, seen from above."""

    states: IntArray  # (n,): at most one a cell
    ended: BoolArray  # (n,): whether the episode is over there
    cells: IntArray  # (n, 2): row and column of each
    origin: tuple[int, int]  # top-left cell
    shape: tuple[int, int]  # rows and columns
    actions: tuple[str, ...]  # A names
    directions: tuple[int, ...] | None  # (A,): 0 stay, 1 north ... 4 west; None where none moves
    letters: tuple[tuple[str, int, int], ...] = ()  # of the fixed components: letter, row, column
    words: str = ""  # what is free and what is fixed, and what the letters mean
    is_map: bool = True  # whether cells are places of the task; in a strip they are states in order
    markers: tuple[Marker, ...] = ()  # what moves during an episode; empty if it is not replayed
    objects: tuple[tuple[str, int, int, bool], ...] = ()
    """Of a grid: name, row, column, and whether it ends the episode."""
    air: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    """Cells in which no state lies and that are no walls, counted by rows, (m,)."""

    @classmethod
    def of(cls, task: Any, at: At | None = None) -> "GridView":
        """Return the view of the states that share the components `at`.

        A component is given by a number, a label, or a cell's row and column. Those left out make
        the grid: one that is a cell, or two, the first being the row. Where the task or names say
        where its states lie (:class:`GridLayout`), those left out are as an episode starts.
        """
        fixed = {} if at is None else at
        instance("at", fixed, Mapping, SettingError)
        layout = layout_of(task)
        if layout is None or (_by_components(task) and set(fixed) & set(layout.components)):
            return _of_components(task, fixed)
        return _of_layout(task, layout, fixed)

    @classmethod
    def for_replay(cls, task: Any) -> "GridView | None":
        """Return a view with markers, to replay training in; None where it has too many cells.

        A maze or a pursuit is shown as its grid, states without geometry as a strip. Of several
        cells in a state the first that an action moves is left free. Cells that no action moves are
        fixed in the middle, those of other agents in the corners.
        """
        space = generative_model(task).states
        read = {component.name: labelled_cells(component) for component in space.components}
        labelled = {name: found for name, found in read.items() if found is not None}
        if labelled and _by_components(task):
            return _of_agents(task, space, labelled)
        if (layout := layout_of(task)) is not None:
            if layout.shape[0] * layout.shape[1] > MOST_CELLS:
                return None
            moving = {"agent": layout.cells, **layout.markers}
            return _with_markers(_of_layout(task, layout, {}), moving, ("agent",))
        return _strip(task, space)

    @property
    def stacked_letters(self) -> dict[tuple[int, int], str]:
        """The letters on the grid, (row, column) -> those that share a cell."""
        return stacked(self.letters)

    @property
    def walls(self) -> IntArray:
        """Row and column of the cells of a map in which no state lies, (m, 2)."""
        grid = np.full(self.shape, self.is_map)
        grid.flat[self.air] = False
        grid[tuple((self.cells - self.origin).T)] = False
        return np.asarray(np.argwhere(grid) + self.origin)


def stacked(letters: Iterable[tuple[str, int, int]]) -> dict[tuple[int, int], str]:
    """Return the letters of each cell, (row, column) -> those that share it."""
    together: dict[tuple[int, int], str] = {}
    for letter, row, column in letters:
        together[row, column] = together.get((row, column), "") + letter
    return together


def _of_task(task: Any, states: IntArray, mover: str | None, *, is_map: bool) -> dict[str, Any]:
    """Return the fields that are read off a task: which states end, and what its actions do.

    `mover` is the component of an action that moves what the cells stand for.
    """
    generative = generative_model(task)
    terminal, actions = generative.terminal, generative.actions
    ended = np.zeros(len(states), bool) if terminal is None else terminal[states]
    names = tuple(action_name(actions, one).removeprefix("action ") for one in range(actions.size))
    alone = len(actions.names) == 1
    own = [one for one in actions.components if one.name == mover or alone]
    directions: tuple[int, ...] | None = None
    if is_map and own and set(own[0].labels or ("",)) <= set(DIRECTIONS):
        moves = actions.decode()[own[0].name]
        directions = tuple(DIRECTIONS[own[0].label(int(move))] for move in moves)
    return {"ended": ended, "actions": names, "directions": directions}


def _by_components(task: Any) -> bool:
    """Return whether a task does not say itself where its states lie."""
    return not isinstance(getattr(task, "layout", None), GridLayout)


def _of_layout(task: Any, layout: GridLayout, fixed: At) -> GridView:
    """Return the view of a task that says where its states lie.

    Components that are neither fixed nor part of the grid are as an episode starts.
    """
    space = generative_model(task).states
    others = [part for part in space.components if part.name not in layout.components]
    if fixed and not others:
        raise SettingError(
            f"a {type(task).__name__} is drawn whole, without at: got at {dict(fixed)}"
        )
    _check_names(fixed, [part.name for part in others])
    values = space.decode() if others else {}
    start = _start_of(task) if others else 0
    shown, keys = np.ones(space.size, bool), list[str]()
    for part in others:
        given = fixed.get(part.name, int(values[part.name][start]))
        value = _value(part, given)
        shown &= values[part.name] == value
        if part.name not in layout.markers:
            keys.append(f"{part.name} {part.label(value)}")
    states, letters = np.flatnonzero(shown), list[tuple[str, int, int]]()
    if not states.size:
        raise SettingError(f"at must leave a state to draw: none is as in {dict(fixed)}")
    for name in layout.markers:
        row, column = layout.markers[name][states[0]].tolist()
        letters.append((_letter_of(name, [taken for taken, *_ in letters]), row, column))
    cells, objects = layout.cells[states], dict.fromkeys(name for name, *_ in layout.objects)
    legend = [f"{LETTERS[name]}: {name}" for name in objects]
    legend += [
        f"{letter}: {name}" for (letter, *_), name in zip(letters, layout.markers, strict=True)
    ]
    return GridView(
        states=states,
        cells=cells,
        origin=layout.origin,
        shape=layout.shape,
        letters=tuple(letters),
        words=", ".join(legend + keys),
        objects=layout.objects,
        air=_air(layout, cells),
        **_of_task(task, states, None, is_map=True),
    )


def _start_of(task: Any) -> int:
    """Return a state that episodes start in; of a task given by functions the first state."""
    if has_tables(task):
        return int(tables(task).start_states[0])
    return reset_state(task) if is_live(task) else 0


def _air(layout: GridLayout, cells: IntArray) -> IntArray:
    """Return the places, counted by rows, that are neither walls nor among the `cells`."""
    air = np.ones(layout.shape, bool)
    for taken in (layout.wall_cells, cells):
        air[tuple((taken - layout.origin).T)] = False
    return np.flatnonzero(air)


def labelled_cells(component: Component) -> IntArray | None:
    """Return the row and column of each value, (size, 2); None if its labels are no cells."""
    found = [match for label in component.labels or () if (match := _CELL.fullmatch(label))]
    if len(found) < component.size:
        return None
    return np.array([match.groups() for match in found], dtype=np.int64)


def _of_components(task: Any, fixed: At, mover: str | None = None) -> GridView:
    """Return the view of the states whose other components are fixed."""
    space = generative_model(task).states
    _check_names(fixed, space.names)
    given = {name: _value(space.component(name), value) for name, value in fixed.items()}
    free = [component for component in space.components if component.name not in given]
    cells, values = _grid_of(free, space)
    states = space.encode(**given, **values)
    letters, words = _letters(space, given, free)
    there = states != MISSING
    (top, left), (bottom, right) = cells.min(axis=0).tolist(), cells.max(axis=0).tolist()
    shape = (bottom - top + 1, right - left + 1)
    return GridView(
        states=states[there],
        cells=cells[there],
        origin=(top, left),
        shape=shape,
        letters=letters,
        words=words,
        **_of_task(task, states[there], mover, is_map=True),
    )


def _check_names(fixed: At, known: Sequence[str]) -> None:
    """Raise SettingError where `fixed` names what is no component to fix."""
    unknown = [name for name in fixed if name not in known]
    if unknown:
        raise SettingError(
            f"at must name components of a state, {', '.join(known)}: got {unknown[0]!r}"
        )


def _grid_of(free: list[Component], space: Space) -> tuple[IntArray, dict[str, IntArray]]:
    """Return all cells that the free components make, (n, 2), and their values, (n,) each."""
    if len(free) == 1 and (cells := labelled_cells(free[0])) is not None:
        return cells, {free[0].name: free[0].low + np.arange(free[0].size)}
    if len(free) == 2 and all(labelled_cells(component) is None for component in free):
        sides = [component.low + np.arange(component.size) for component in free]
        cells = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)
        return cells, {free[0].name: cells[:, 0], free[1].name: cells[:, 1]}
    names = [component.name for component in free]
    raise SettingError(
        "a picture is of one cell, or of a row and a column; at must fix all other components of "
        f"{', '.join(space.names)}: it leaves {', '.join(names) or 'none'}"
    )


def _value(component: Component, given: Any) -> int:
    """Return a component's value from a number, a label, or a cell's row and column."""
    label, labels = given, component.labels or ()
    if isinstance(given, tuple | list | np.ndarray):
        label = f"({','.join(str(int(part)) for part in given)})"
    if isinstance(label, str) and label in labels:
        return component.low + labels.index(label)
    high = component.low + component.size - 1
    if isinstance(given, int | np.integer) and component.low <= given <= high:
        return int(given)
    raise SettingError(
        f"{component.name} runs from {component.label(component.low)} to {component.label(high)}: "
        f"got {given!r}"
    )


def _letters(
    space: Space, given: Mapping[str, int], free: list[Component]
) -> tuple[tuple[tuple[str, int, int], ...], str]:
    """Return the letters of the fixed cells, and the legend of the picture."""
    letters, keys = list[tuple[str, int, int]](), list[str]()
    for component in space.components:
        if component.name not in given:
            continue
        value, cells = given[component.name], labelled_cells(component)
        if cells is None:
            keys.append(f"{component.name} {component.label(value)}")
            continue
        letter = _letter_of(component.name, [taken for taken, *_ in letters])
        row, column = cells[value - component.low]
        letters.append((letter, int(row), int(column)))
        keys.append(f"{letter}: {component.name}")
    what = f"cells: where {free[0].name} is" if len(free) == 1 else ""
    return tuple(letters), "; ".join(filter(None, (what, ", ".join(keys))))


def _letter_of(name: str, taken: list[str]) -> str:
    """Return the number that a name ends in, or its first letter that is not taken yet."""
    candidates = re.findall(r"\d+$", name) + [char.upper() for char in name if char.isalnum()]
    return next((one for one in candidates if one not in taken), "?")


def _of_agents(task: Any, space: Space, cells: Mapping[str, IntArray]) -> GridView | None:
    """Return the view of a task in whose states one or several agents stand on cells."""
    agents = [name for name in generative_model(task).actions.names if name in cells]
    free = agents[0] if agents else next(iter(cells))
    rows, columns = cells[free].max(axis=0)
    corners = cycle([(0, 0), (0, columns), (rows, columns), (rows, 0)])
    at = dict[str, Any]()
    for component in space.components:
        if component.name == free:
            continue
        if component.name not in cells:
            at[component.name] = component.low
            continue
        wanted = next(corners) if component.name in agents else (rows // 2, columns // 2)
        distance = abs(cells[component.name] - wanted).sum(axis=1)
        at[component.name] = tuple(cells[component.name][distance.argmin()].tolist())
    values = space.decode()
    by_state = {
        name: where[values[name] - space.component(name).low] for name, where in cells.items()
    }
    return _with_markers(_of_components(task, at, free), by_state, agents)


def _with_markers(
    view: GridView, cells: Mapping[str, IntArray], agents: Collection[str]
) -> GridView | None:
    """Return a view with markers on `cells`, name -> (S, 2); None if it is too large."""
    rows, columns = view.shape
    if rows * columns > MOST_CELLS:
        return None
    colours = cycle(AGENTS)
    markers = list[Marker]()
    for name, where in cells.items():
        acts = len(cells) == 1 or name in agents
        letter = _letter_of(name, [marker.letter for marker in markers])
        colour = next(colours) if acts else OTHER
        markers.append(Marker(letter, colour, (where - view.origin) @ np.array([columns, 1])))
    return replace(view, markers=tuple(markers))


def _strip(task: Any, space: Space) -> GridView:
    """Return the view of a task without geometry: its first states in rows."""
    states = np.arange(min(space.size, LONGEST_STRIP))
    cells = np.stack(np.divmod(states, STRIP), axis=1)
    shape = (int(cells[-1, 0]) + 1, min(STRIP, len(states)))
    words = "cells: states by number"
    if len(states) < space.size:
        words += f", the first {len(states)} of {space.size:,}"
    place = np.full(space.size, -1)
    place[states] = cells @ np.array([shape[1], 1])
    return GridView(
        states=states,
        cells=cells,
        origin=(0, 0),
        shape=shape,
        words=words,
        is_map=False,
        markers=(Marker("", AGENTS[0], place),),
        **_of_task(task, states, None, is_map=False),
    )
