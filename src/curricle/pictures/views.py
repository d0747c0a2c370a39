"""Where the states of any task lie on a grid, and views: states, their cells, moving markers."""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import cycle
from typing import Any

import numpy as np

from curricle.arrays import BoolArray, IntArray
from curricle.checks import instance
from curricle.errors import SettingError
from curricle.tasks.grid import LETTERS, GridLayout
from curricle.tasks.live import is_live, reset_state
from curricle.tasks.mdp import generative_model, has_tables, tables
from curricle.tasks.spaces import MISSING, Component, Space, action_name

SIDES = (("row", "column"), ("row", "col"), ("y", "x"))
"""Components that say in which cell a state lies, by their names."""
MOST_STATES = 20_000_000  # states of a task whose cells are read off its components
MOST_STATES_OF_TABLES = 100_000  # states of a task whose ends are looked for in its tables
At = Mapping[str, Any]  # component -> its value: a number, a label, or a cell's (row, column)
Letters = tuple[tuple[str, int, int], ...]  # letter, row and column

STRIP, LONGEST_STRIP = 6, 60  # states without geometry stand in a strip: a row, at most
MOST_CELLS = 2500  # cells of a replayed grid at most
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
    letters: Letters = ()  # of the fixed components
    words: str = ""  # what is free and what is fixed, and what the letters mean
    is_map: bool = True  # whether cells are places of the task; in a strip they are states in order
    markers: tuple[Marker, ...] = ()  # what moves during an episode; empty if it is not replayed
    # Of a grid: name, row, column, and whether it ends the episode.
    objects: tuple[tuple[str, int, int, bool], ...] = ()
    # Cells in which no state lies and that are no walls, counted by rows, (m,).
    air: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    # Thin walls, numbered in (2, rows, columns): to the east of each cell, and to the south.
    bars: IntArray = field(default_factory=lambda: np.empty(0, np.int64))

    @classmethod
    def of(cls, task: object, at: At | None = None) -> "GridView":
        """Return the view of states that share the components `at`: number, label or cell."""
        fixed = {} if at is None else at
        instance("at", fixed, Mapping, SettingError)
        layout = layout_of(task)
        if layout is None or (not _says_where(task) and set(fixed) & set(layout.components)):
            return _of_components(task, fixed)
        return _of_layout(task, layout, fixed)

    @classmethod
    def for_replay(cls, task: object) -> "GridView | None":
        """Return a view with markers, to replay training in; None where that is too large."""
        space = generative_model(task).states
        if space.size > MOST_STATES:  # no tables of them are kept, so that nothing is replayed
            return None
        read = {component.name: labelled_cells(component) for component in space.components}
        labelled = {name: cells for name, cells in read.items() if cells is not None}
        if labelled and not _says_where(task):
            return _of_agents(task, space, labelled)
        if (layout := layout_of(task)) is not None:
            if layout.shape[0] * layout.shape[1] > MOST_CELLS:
                return None
            moving = {"agent": layout.cells, **layout.markers}
            return _with_markers(_of_layout(task, layout, {}), moving, ("agent",))
        return _strip(task, space)

    @property
    def walls(self) -> IntArray:
        """Row and column of the cells of a map in which no state lies, (m, 2)."""
        grid = np.full(self.shape, self.is_map)
        grid.flat[self.air] = False
        grid[tuple((self.cells - self.origin).T)] = False
        return np.asarray(np.argwhere(grid) + self.origin)


def stacked(letters: Iterable[tuple[str, int, int]]) -> dict[tuple[int, int], str]:
    """Return the letters in each cell, as (row, column) -> letters."""
    together: dict[tuple[int, int], str] = {}
    for letter, row, column in letters:
        together[row, column] = together.get((row, column), "") + letter
    return together


def _of_task(task: object, states: IntArray, mover: str | None, *, is_map: bool) -> dict[str, Any]:
    """Return the fields that a task determines: ended states, and the moves of `mover`."""
    generative = generative_model(task)
    terminal, actions = generative.terminal, generative.actions
    ended = np.zeros(len(states), bool) if terminal is None else terminal[states]
    names = tuple(action_name(actions, a).removeprefix("action ") for a in range(actions.size))
    alone = len(actions.names) == 1
    part = next((part for part in actions.components if part.name == mover or alone), None)
    directions: tuple[int, ...] | None = None
    if is_map and part is not None and set(part.labels or ("",)) <= set(DIRECTIONS):
        moves = actions.decode()[part.name].tolist()
        directions = tuple(DIRECTIONS[part.label(move)] for move in moves)
    return {"ended": ended, "actions": names, "directions": directions}


def _says_where(task: object) -> bool:
    return isinstance(getattr(task, "layout", None), GridLayout)


def _of_layout(task: Any, layout: GridLayout, fixed: At) -> GridView:
    """Return the view of a task that says where its states lie."""
    space = generative_model(task).states
    unplaced = [part for part in space.components if part.name not in layout.components]
    if fixed and not unplaced:
        raise SettingError(
            f"a {type(task).__name__} is drawn whole, without at: got at {dict(fixed)}"
        )
    _check_names(fixed, [part.name for part in unplaced])
    values = space.decode() if unplaced else {}
    start = 0  # a state that episodes start in; of a task given by functions the first state
    if unplaced and has_tables(task):
        start = int(tables(task).start_states[0])
    elif unplaced and is_live(task):
        start = reset_state(task)
    shown, keys = np.ones(space.size, bool), list[str]()
    for part in unplaced:
        value = _value(part, fixed.get(part.name, int(values[part.name][start])))
        shown &= values[part.name] == value
        if part.name not in layout.markers:
            keys.append(f"{part.name} {part.label(value)}")
    wall, at = np.zeros(layout.shape, bool), tuple((layout.cells - layout.origin).T)
    wall[tuple((layout.wall_cells - layout.origin).T)] = True
    states = np.flatnonzero(shown & ~wall[at])  # numbered, but never entered
    if not states.size:
        raise SettingError(f"at must leave a state to draw: none is as in {dict(fixed)}")
    letters, legend = _lettered({name: at[states[0]] for name, at in layout.markers.items()})
    cells, objects = layout.cells[states], dict.fromkeys(name for name, *_ in layout.objects)
    taken, air = np.concatenate([layout.wall_cells, cells]), np.ones(layout.shape, bool)
    air[tuple((taken - layout.origin).T)] = False
    return GridView(
        states=states,
        cells=cells,
        origin=layout.origin,
        shape=layout.shape,
        letters=letters,
        words=", ".join([*(f"{LETTERS[n]}: {n}" for n in objects), *legend.values(), *keys]),
        objects=layout.objects,
        air=np.flatnonzero(air),
        bars=bars_of(task, layout),
        **_of_task(task, states, None, is_map=True),
    )


def labelled_cells(component: Component) -> IntArray | None:
    """Return the row and column of each value, (size, 2); None if its labels are not cells."""
    matches = [match for label in component.labels or () if (match := _CELL.fullmatch(label))]
    if len(matches) < component.size:
        return None
    return np.array([match.groups() for match in matches], dtype=np.int64)


def _of_components(task: object, fixed: At, mover: str | None = None) -> GridView:
    """Return the view of the states whose other components are fixed."""
    space = generative_model(task).states
    _check_names(fixed, space.names)
    values = {name: _value(space.component(name), value) for name, value in fixed.items()}
    free = [component for component in space.components if component.name not in values]
    if len(free) == 1 and (places := labelled_cells(free[0])) is not None:
        cells, sides = places, {free[0].name: free[0].low + np.arange(free[0].size)}
    elif len(free) == 2 and all(labelled_cells(component) is None for component in free):
        ranges = [component.low + np.arange(component.size) for component in free]
        cells = np.stack(np.meshgrid(*ranges, indexing="ij"), axis=-1).reshape(-1, 2)
        sides = {free[0].name: cells[:, 0], free[1].name: cells[:, 1]}
    else:
        names = ", ".join(component.name for component in free)
        raise SettingError(
            "a picture is of one cell, or of a row and a column; at must fix all other components "
            f"of {', '.join(space.names)}: it leaves {names or 'none'}"
        )
    states = space.encode(**values, **sides)
    exists = states != MISSING
    (top, left), (bottom, right) = cells.min(axis=0).tolist(), cells.max(axis=0).tolist()
    kept = [part for part in space.components if part.name in values]
    labelled = [(part, labelled_cells(part)) for part in kept]
    letters, legend = _lettered(
        {p.name: at[values[p.name] - p.low] for p, at in labelled if at is not None}
    )
    texts = [legend.get(p.name, f"{p.name} {p.label(values[p.name])}") for p in kept]
    moving = f"cells: where {free[0].name} is" if len(free) == 1 else ""
    return GridView(
        states=states[exists],
        cells=cells[exists],
        origin=(top, left),
        shape=(bottom - top + 1, right - left + 1),
        letters=letters,
        words="; ".join(filter(None, (moving, ", ".join(texts)))),
        **_of_task(task, states[exists], mover, is_map=True),
    )


def _check_names(fixed: At, names: Sequence[str]) -> None:
    unknown = [name for name in fixed if name not in names]
    if unknown:
        raise SettingError(
            f"at must name components of a state, {', '.join(names)}: got {unknown[0]!r}"
        )


def _value(component: Component, value: object) -> int:
    """Return a component's value from a number, a label, or a cell's row and column."""
    if isinstance(value, tuple | list | np.ndarray):
        value = f"({','.join(str(int(part)) for part in value)})"
    return component.value(value)


def _lettered(places: Mapping[str, IntArray]) -> tuple[Letters, dict[str, str]]:
    """Return letters for the components fixed in cells, name -> (row, column), and a legend."""
    letters = marker_letters(places)
    letters_at = [(letters[name], int(row), int(column)) for name, (row, column) in places.items()]
    return tuple(letters_at), {name: f"{letter}: {name}" for name, letter in letters.items()}


def marker_letters(names: Iterable[str]) -> dict[str, str]:
    """Return for each name the number it ends in, or its first letter that is not taken yet."""
    letters = dict[str, str]()
    for name in names:
        candidates = re.findall(r"\d+$", name) + [char.upper() for char in name if char.isalnum()]
        letters[name] = next((char for char in candidates if char not in letters.values()), "?")
    return letters


def _of_agents(task: object, space: Space, cells: Mapping[str, IntArray]) -> GridView | None:
    """Return the view of a task in whose states one or several agents stand on cells."""
    agents = [name for name in generative_model(task).actions.names if name in cells]
    free = agents[0] if agents else next(iter(cells))
    rows, columns = cells[free].max(axis=0)
    corners = cycle([(0, 0), (0, columns), (rows, columns), (rows, 0)])
    at: dict[str, Any] = {part.name: part.low for part in space.components if part.name != free}
    for name in [name for name in at if name in cells]:
        wanted = next(corners) if name in agents else (rows // 2, columns // 2)
        distance = abs(cells[name] - wanted).sum(axis=1)
        at[name] = tuple(cells[name][distance.argmin()].tolist())
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
    colours, letters = cycle(AGENTS), marker_letters(cells)
    markers = [
        Marker(
            letters[name],
            next(colours) if len(cells) == 1 or name in agents else OTHER,
            (where - view.origin) @ np.array([columns, 1]),
        )
        for name, where in cells.items()
    ]
    return replace(view, markers=tuple(markers))


def _strip(task: object, space: Space) -> GridView:
    """Return the view of a task without geometry: its first states in rows."""
    states = np.arange(min(space.size, LONGEST_STRIP))
    cells = np.stack(np.divmod(states, STRIP), axis=1)
    shape = (int(cells[-1, 0]) + 1, min(STRIP, len(states)))
    rest = f", the first {len(states)} of {space.size:,}" * (len(states) < space.size)
    place = np.full(space.size, -1)
    place[states] = cells @ np.array([shape[1], 1])
    return GridView(
        states=states,
        cells=cells,
        origin=(0, 0),
        shape=shape,
        words=f"cells: states by number{rest}",
        is_map=False,
        markers=(Marker("", AGENTS[0], place),),
        **_of_task(task, states, None, is_map=False),
    )


# -- where states lie: as a task says, or by its components and tables -----------------------------


def layout_of(task: object) -> GridLayout | None:
    """Return where states lie, as a task says or by its row and column; None if it has neither."""
    layout = getattr(task, "layout", None)
    if isinstance(layout, GridLayout):
        return layout
    states = generative_model(task).states
    sides = next((names for names in SIDES if set(names) <= set(states.names)), None)
    if sides is None or states.size > MOST_STATES:
        return None
    values = states.decode()
    cells = np.stack([values[name] for name in sides], axis=1)
    origin, last = cells.min(axis=0), cells.max(axis=0)
    moving = dict[str, IntArray]()
    for up, across in SIDES:  # such as key_row and key_column; a key out of the grid is carried
        ends = f"_{up}", f"_{across}"
        for name in [name.removesuffix(ends[0]) for name in values if name.endswith(ends[0])]:
            if name + ends[1] in values:
                places = np.stack([values[name + end] for end in ends], axis=1)
                inside = ((places >= origin) & (places <= last)).all(axis=1, keepdims=True)
                moving[name] = np.where(inside, places, cells)
    rows, columns = (last - origin + 1).tolist()
    corner = int(origin[0]), int(origin[1])
    objects = _ends_of(task, cells)
    return GridLayout(cells, sides, (rows, columns), corner, objects, markers=moving)


def bars_of(task: object, layout: GridLayout) -> IntArray:
    """Return the thin walls between neighbouring cells, (m,) as in a :class:`GridView`.

    A wall keeps those where they are who go east from the one cell or west from the other, and no
    action leads from the one to the other.
    """
    moves, (_, columns) = generative_model(task).actions.components, layout.shape
    known = len(moves) == 1 and set(moves[0].labels or ("",)) <= set(DIRECTIONS)
    if not known or not has_tables(task) or len(layout.cells) > MOST_STATES_OF_TABLES:
        return np.empty(0, np.int64)
    mdp, n = tables(task), int(np.prod(layout.shape))
    directions = np.array([DIRECTIONS[label] for label in moves[0].labels or ()])
    at = (layout.cells - layout.origin) @ np.array([columns, 1])
    happens = (mdp.probability > 0)[mdp.outcome_row] & ~mdp.terminal[:, None, None]
    before, after = at[:, None, None], at[mdp.next_state][mdp.outcome_row]  # (S, A, O)
    stays, joined = (happens & (before == after)).any(axis=2), (before * n + after)[happens]
    bars = np.zeros((2, n), bool)
    for side, (way, back, further) in enumerate([(2, 4, 1), (3, 1, columns)]):
        from_here, from_there = (
            np.unique(at[stays[:, directions == direction].any(axis=1)])
            for direction in (way, back)
        )
        here = np.intersect1d(from_here, from_there - further)
        here = here[(side == 1) | (here % columns < columns - 1)]
        there = here + further
        bars[side, here] = ~np.isin([here * n + there, there * n + here], joined).any(axis=0)
    return np.flatnonzero(bars)


Objects = tuple[tuple[str, int, int, bool], ...]


def _ends_of(task: object, cells: IntArray) -> Objects:
    """Return the cells of a task with tables that end every episode: goals, or pits that pay less.

    A goal pays the most of them, and no less than steps do as a rule.
    """
    if not has_tables(task) or generative_model(task).states.size > MOST_STATES_OF_TABLES:
        return ()
    mdp = tables(task)
    going = np.unique(cells[~mdp.terminal], axis=0).tolist()
    ends = [cell for cell in np.unique(cells[mdp.terminal], axis=0).tolist() if cell not in going]
    paid, happens = list[float](), mdp.probability > 0
    for cell in ends:
        into = happens & (cells == cell).all(axis=1)[mdp.next_state]
        paid.append(float(mdp.reward[into].max(initial=-np.inf)))
    least = max([*paid, float(np.median(mdp.reward[happens]))])
    reached = [(cell, pays) for cell, pays in zip(ends, paid, strict=True) if np.isfinite(pays)]
    return tuple(("goal" if pays >= least else "pit", *cell, True) for cell, pays in reached)
