"""The base of the domains that come with the library: a domain is one declaration.

The annotations of its fields (:class:`Rule`) say which values they take and which of these are
harder; :class:`Domain` checks a task by them, and :func:`family_of` makes the parameters of its
family of them.
"""

import re
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Annotated, Any, ClassVar, Literal, Self, get_args, get_origin

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, Frozen, IntArray, frozen
from curricle.checks import indices, one_of
from curricle.display import pictured
from curricle.errors import TaskError
from curricle.tasks.family import Parameter, Rule, TaskFamily, complete_parameters, rules_of
from curricle.tasks.live import LiveMDP
from curricle.tasks.mdp import FiniteMDP, generative_model, has_tables, tables
from curricle.tasks.models import LARGEST_REWARD, check_horizon
from curricle.tasks.spaces import MISSING, Component, Space, whole
from curricle.text import counted

Discount = Annotated[float, Rule(0, 1)]
TimeLimit = Annotated[int | None, Rule(1)]
MapStart = Annotated[Any, Rule(values=("map", "uniform"))]  # a word, or cells as (row, column)
MOVES = {"north": (-1, 0), "east": (0, 1), "south": (1, 0), "west": (0, -1)}
"""Name -> rows and columns that a move goes."""
Cell = tuple[int, int]  # row and column


class Domain(Frozen):
    """A task that is a frozen dataclass of its rules, which `_check` checks beyond annotations."""

    ACTIONS: ClassVar[tuple[str, ...]] = tuple(MOVES)
    __dataclass_fields__: ClassVar[dict[str, Any]]
    states: Any
    discount: float
    time_limit: int | None

    _repr_html_ = pictured

    def __post_init__(self) -> None:
        domain: Any = type(self)
        for name, checked in _checks(domain):
            object.__setattr__(self, name, checked(getattr(self, name)))
        check_horizon(self)
        self._check()

    def _check(self) -> None:
        """Raise TaskError where rules do not fit each other."""

    @cached_property
    def actions(self) -> Space:
        """The actions by name, one component."""
        return Space([Component("move", len(self.ACTIONS), labels=self.ACTIONS)])

    def _tables(
        self,
        probability: Any,
        next_state: Any,
        reward: Any,
        *,
        terminal: BoolArray,
        starting: IntArray,
        outcome_row: npt.NDArray[np.integer[Any]] | None = None,
    ) -> FiniteMDP:
        """Return the tables; episodes start in the states `starting`, equally likely.

        Without `outcome_row` every pair has its row: outcomes are (S, A, O), not (Y, O).
        """
        start = np.zeros(len(terminal))
        start[starting] = 1 / len(starting)
        settings: Any = {"terminal": terminal, "start": start}
        settings |= {"discount": self.discount, "time_limit": self.time_limit}
        spaces = self.states, self.actions
        if outcome_row is None:
            outcomes = np.broadcast_arrays(probability, next_state, reward)
            return FiniteMDP.one_row_a_pair(*spaces, *outcomes, **settings)
        return FiniteMDP(*spaces, outcome_row, probability, next_state, reward, **settings)


@cache
def _checks(domain: Any) -> tuple[tuple[str, Callable[[Any], Any]], ...]:
    """Return the checks of fields by annotations; kinds of several types check themselves."""
    checks, rules = list[tuple[str, Callable[[Any], Any]]](), rules_of(domain)
    for name in domain.__dataclass_fields__:
        kind, (low, high, *_), optional = rules[name]
        if name in ("discount", "time_limit"):  # check_horizon has their limits
            continue
        if kind is float and (low, high) == (None, None):
            low, high = -LARGEST_REWARD, LARGEST_REWARD
        if kind in (int, float, bool):
            checks.append((name, Parameter(name, kind, low, high, optional=optional).checked))
        elif get_origin(kind) is Literal:
            checks.append((name, Parameter(name, values=get_args(kind)).checked))
        elif name == "origin":
            checks.append((name, lambda origin: cell_of("origin", origin, "a row and a column")))
    return tuple(checks)


def name_of(domain: type[Domain]) -> str:
    """Return what the family of a domain, and its type in study files, are called."""
    return re.sub(r"(?<=.)(?=[A-Z])", "_", domain.__name__).lower()


def family_of(
    domain: type[Domain],
    factory: Callable[..., Any] | None = None,
    *,
    mapping: Any = None,
    constraint: Callable[[dict[str, Any]], str | None] | None = None,
) -> TaskFamily:
    """Return the family of a domain, named after it; a factory's own parameters come first."""
    name, declared = name_of(domain), tuple[Parameter, ...]()
    if factory is not None:
        of_factory = {parameter.name for parameter in complete_parameters((), factory, name)}
        of_domain = complete_parameters((), domain, name)
        declared = tuple(parameter for parameter in of_domain if parameter.name not in of_factory)
    return TaskFamily(name, factory or domain, declared, mapping, constraint)


class DomainWithStart(Domain):
    """A domain one of whose rules is its `start`."""

    start: Any

    def with_start(self, start: Any) -> Self:
        """Return the same task with another `start`."""
        return replace(self, start=start)


# -- domains of cells ------------------------------------------------------------------------------


class GridDomain(DomainWithStart):
    """A domain whose agent is in a cell of the `_grid`, in which ``#`` is a wall."""

    OBJECTS: ClassVar[Mapping[str, str]] = {}  # character -> what it is in pictures
    ENDS: ClassVar[str] = ""  # characters of the cells that end an episode when they are entered
    LISTED: ClassVar[bool] = False
    """Whether the space of cells lists them even where none is a wall."""
    origin: Any

    def _check(self) -> None:
        """Check the start, which is a word of its annotation or cells, and sort its cells."""
        valid = rules_of(type(self))["start"][1].values or ()
        if not (isinstance(self.start, str) and self.start in valid):
            try:
                cells = np.array(list(self.start))
            except (TypeError, ValueError):
                cells = np.empty(0)
            if cells.ndim != 2 or cells.shape[1] != 2 or cells.dtype.kind not in "iu":
                raise TaskError(
                    f"start must be {', '.join(map(repr, valid))} or cells such as [(2, 1)]: got "
                    f"{self.start!r}"
                )
            listed = tuple(sorted({(int(row), int(column)) for row, column in cells}))
            object.__setattr__(self, "start", listed)
        self._start_states()

    @property
    def _grid(self) -> npt.NDArray[np.str_]:
        """The object in each cell, (rows, columns) characters."""
        raise NotImplementedError

    @property
    def _corner(self) -> Cell:
        """Row and column of the top-left cell."""
        corner: Cell = self.origin
        return corner

    @property
    def _ending(self) -> str:
        return self.ENDS

    @cached_property
    def cells(self) -> IntArray:
        """Row and column of each cell that is not a wall, (n, 2), in reading order."""
        return frozen(np.argwhere(self._grid != "#") + np.array(self._corner))

    @cached_property
    def _cell_space(self) -> Space:
        rows, columns = self._grid.shape
        listed = self.LISTED or len(self.cells) < rows * columns
        return cell_space(rows, columns, self._corner, self.cells if listed else None)

    @cached_property
    def _contents(self) -> npt.NDArray[np.str_]:
        """The character of each cell that is not a wall, (n,)."""
        return np.asarray(self._grid[self._grid != "#"])

    def _holds(self, characters: str) -> BoolArray:
        """Return which cells are drawn as one of some characters, (n,) bool."""
        return np.isin(self._contents, list(characters))

    @cached_property
    def objects(self) -> tuple[tuple[str, int, int], ...]:
        """Every object as (class, row, column), in reading order."""
        places = zip(self._contents, self.cells.tolist(), strict=True)
        return tuple((self.OBJECTS[drawn], *at) for drawn, at in places if drawn in self.OBJECTS)

    @cached_property
    def states(self) -> Space:
        """One state for each cell that is not a wall."""
        return self._cell_space

    @property
    def _ends(self) -> BoolArray:
        """Which states end an episode, (S,) bool."""
        return self._holds(self._ending)

    @property
    def _standing(self) -> BoolArray:
        """In which states an episode may start, (S,) bool."""
        return ~self._ends

    @cached_property
    def layout(self) -> "GridLayout":
        """Where the states lie, for pictures."""
        ending = {self.OBJECTS.get(character) for character in self._ending}
        names = self.states.names
        where = ("row", "column") if "row" in names else names
        values = (self.states if "row" in names else self._cell_space).decode()
        return GridLayout(
            cells=frozen(np.stack([values["row"], values["column"]], axis=1)),
            components=where,
            shape=self._grid.shape,
            origin=self._corner,
            objects=tuple((*drawn, drawn[0] in ending) for drawn in self.objects),
        )

    def _start_states(self) -> IntArray:
        """Return the states in which episodes start; TaskError where there are none."""
        # In an S ("map"), in any that ends none ("uniform"), in the first such (another word).
        standing = self._standing
        if isinstance(self.start, str) and self.start != "map":
            if not standing.any():
                raise TaskError(f"start={self.start!r} needs a state that does not end the episode")
            states = np.flatnonzero(standing)
            return states if self.start == "uniform" else states[:1]
        cells = self.cells[self._holds("S")] if self.start == "map" else np.array(self.start)
        if not len(cells):
            raise TaskError("start='map' needs an S on the map: there is none")
        states = self._states_of(*cells.T)
        bad = np.flatnonzero((states == MISSING) | ~standing[states])
        if bad.size:
            raise TaskError(
                "an episode starts in a free cell that does not end it: got "
                f"{tuple(map(int, cells[bad[0]]))}"
            )
        return states

    def _tables(self, *outcomes: Any, **settings: Any) -> FiniteMDP:
        """Return the tables; episodes end and start in the states of the cells that say so."""
        starting = self._start_states()
        return super()._tables(*outcomes, terminal=self._ends, starting=starting, **settings)

    def _states_of(self, row: IntArray, column: IntArray) -> IntArray:
        """Return the states in which episodes start in cells, `MISSING` where there is none."""
        return self._cell_space.encode(row=row, column=column)

    def _landing(self, moves: Mapping[str, Cell] = MOVES) -> IntArray:
        """Return the cell that each move leads to from each cell: the same if there is none."""
        to = landing(self._cell_space, moves)
        return np.where(to == MISSING, np.arange(len(to))[:, None], to)


class CellDomain(GridDomain):
    """A domain with a state for each cell; state and cell have the same number."""

    def start_in(self, states: npt.ArrayLike) -> Self:
        """Return the same task with starts in these states, by number, equally likely."""
        chosen = self.cells[indices("start states", states, len(self.cells), TaskError)]
        return self.with_start([(int(row), int(column)) for row, column in chosen])


class MapDomain(GridDomain):
    """A domain drawn as a text map, on which ``#`` is a wall."""

    CHARACTERS: ClassVar[str]  # what a map is drawn with
    map: Any

    def _read_map(
        self, drawn: Any, needed: str, rule: str, legend: Mapping[str, str] | None = None
    ) -> None:
        """Check the map, which has one of the characters `needed`."""
        lines = read_map(drawn, self.CHARACTERS, legend)
        if not any(character in line for line in lines for character in needed):
            raise TaskError(f"{rule}: there is none")
        object.__setattr__(self, "map", lines)

    def crop(
        self, *, rows: tuple[int, int], columns: tuple[int, int], start: Any = "uniform"
    ) -> Self:
        """Return the part in the half-open ranges `rows` x `columns`, in this map's coordinates.

        Objects outside are removed: fire just outside no longer counts as near, keys outside count
        as held. The default start is uniform, as in the paper's source tasks.
        """
        part = cut(self.map, self.origin, rows, columns)
        return replace(self, map=part, start=start, origin=(rows[0], columns[0]))

    @cached_property
    def _grid(self) -> npt.NDArray[np.str_]:
        return np.array([list(line) for line in self.map])


def cell_space(
    rows: int, columns: int, corner: Cell = (0, 0), cells: IntArray | None = None
) -> Space:
    """Return the space of a grid's cells: all of them, or only these, (n, 2)."""
    row, column = corner
    return Space([Component("row", rows, row), Component("column", columns, column)], cells)


def landing(cells: Space, moves: Mapping[str, Cell] = MOVES) -> IntArray:
    """Return the cell that each move leads to from each cell, (n, moves) int64, or MISSING."""
    row, column = (values[:, None] for values in cells.decode().values())
    down, right = np.array(list(moves.values())).T
    return frozen(cells.encode(row=row + down, column=column + right))


def numbered_names(kind: str, count: int) -> tuple[str, ...]:
    """Return ``key`` if there is one, else ``key_1``, ``key_2``, ..."""
    return (kind,) if count == 1 else tuple(f"{kind}_{i + 1}" for i in range(count))


def in_proportion(values: IntArray, marks: list[int], images: list[int]) -> IntArray:
    """Return values moved so that each mark becomes its image, in proportion between them."""
    rising, first = np.unique(marks, return_index=True)
    read = np.interp(values, rising, np.array(images)[first])
    return np.asarray(np.rint(read), dtype=np.int64)


# -- maps drawn in text ----------------------------------------------------------------------------

MARK = "\ufeff"  # the byte order mark, with which some editors begin a file


def read_map(
    drawn: Any, characters: str, legend: Mapping[str, str] | None = None
) -> tuple[str, ...]:
    """Return the lines of a map, given as text or as a list of lines; TaskError if it is none.

    A `legend` says which of the `characters` others stand for, where the domain has one.
    """
    if not isinstance(drawn, str | list | tuple) or not all(isinstance(x, str) for x in drawn):
        raise TaskError(f"a map must be text or a list of lines: got {drawn!r}")
    if isinstance(drawn, str):
        drawn = [line.strip() for line in drawn.lstrip(MARK).strip().splitlines()]
    meant = str.maketrans(dict(legend or {}))
    lines = tuple(line.lstrip(MARK).translate(meant) for line in drawn)
    for row, line in enumerate(lines):
        if len(line) != len(lines[0]):
            raise TaskError(
                f"all lines of a map must be equally long: line {row} has "
                f"{counted(len(line), 'character')}, line 0 has {len(lines[0])}"
            )
        for column, character in enumerate(line):
            if character not in characters:
                says = (
                    "" if legend is None else f"; legend={{{character!r}: 'wall'}} makes it a wall"
                )
                raise TaskError(
                    f"a map is drawn with {' '.join(characters)}: row {row}, column {column} has "
                    f"{character!r}{says}"
                )
    return lines


def cell_of(name: str, value: Any, rule: str) -> Cell:
    """Return a row and a column as ints; TaskError if they are none."""
    cell = np.empty(0) if isinstance(value, str) else whole(value, f"the {name}'s row and column")
    if cell.shape != (2,):
        raise TaskError(f"{name} must be {rule}: got {value!r}")
    return int(cell[0]), int(cell[1])


def cut(lines: tuple[str, ...], origin: Cell, rows: Any, columns: Any) -> list[str]:
    """Return the lines of the part of a map in half-open ranges of its rows and columns."""
    top, bottom = part_of("rows", rows, origin[0], len(lines))
    left, right = part_of("columns", columns, origin[1], len(lines[0]))
    part = lines[top - origin[0] : bottom - origin[0]]
    return [line[left - origin[1] : right - origin[1]] for line in part]


def part_of(name: str, part: Any, first: int, size: int) -> tuple[int, int]:
    """Return a half-open range of the rows or columns of a map; TaskError if it is none."""
    if whole(part, f"a crop's {name}").shape != (2,):
        raise TaskError(f"a crop's {name} must be a first and an end: got {part!r}")
    low, high = map(int, part)
    if not first <= low < high <= first + size:
        raise TaskError(
            f"a crop must lie within the map's {name} {first}..{first + size}: got {low}..{high}"
        )
    return low, high


# -- where the states of a task lie on a grid: what pictures need to know of it --------------------

LETTERS = {"treasure": "T", "fire": "F", "pit": "P", "goal": "G", "key": "K", "lock": "L"}
LETTERS |= {"exit": "E"}
"""Of the objects on a grid."""
SIDES = (("row", "column"), ("row", "col"), ("y", "x"))
"""Components that say in which cell a state lies, by their names."""
MOST_STATES = 20_000_000  # states of a task whose cells are read off its components
MOST_STATES_OF_TABLES = 100_000  # states of a task whose ends are looked for in its tables
NAMED = {
    "wall": {"wall", "obstacle", "blocked"},
    "goal": {"goal", "target", "exit", "treasure"},
    "pit": {"pit", "hole", "hazard", "trap", "lava", "cliff"},
    "fire": {"fire"},
    "key": {"key"},
    "lock": {"lock", "door"},
}
"""What the attributes of an environment are drawn as, by words in their names, in the singular."""
COLLECTIONS = (list, tuple, set, frozenset, dict, np.ndarray)  # what may hold cells


@dataclass(frozen=True, eq=False)
class GridLayout:
    """The cell of each state of a task, and the objects in cells; a task offers it as `layout`."""

    cells: IntArray  # row and column of the agent in each state, (S, 2)
    components: tuple[str, ...]
    """The components of a state that say where the agent is; a picture fixes the others."""
    shape: tuple[int, int]  # rows and columns
    origin: Cell = (0, 0)  # row and column of the top-left cell
    objects: tuple[tuple[str, int, int, bool], ...] = ()
    """Name (treasure, goal, exit, pit, fire, key or lock), row and column of an object in a cell,
    and whether entering it ends the episode."""
    walls: IntArray | None = None
    """Rows and columns of walls, (m, 2); None where all cells without a state are walls."""
    markers: Mapping[str, IntArray] = field(default_factory=dict)
    """Other moving objects: name -> row and column in each state, (S, 2)."""

    def __post_init__(self) -> None:
        for name, *_ in self.objects:
            one_of("an object of a layout", name, tuple(LETTERS), TaskError)

    @property
    def wall_cells(self) -> IntArray:
        """Row and column of each wall, (m, 2)."""
        if self.walls is not None:
            return self.walls
        free = np.zeros(self.shape, bool)
        free[tuple((self.cells - self.origin).T)] = True
        return np.argwhere(~free) + self.origin


def layout_of(task: Any) -> GridLayout | None:
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
                there = np.stack([values[name + end] for end in ends], axis=1)
                inside = ((there >= origin) & (there <= last)).all(axis=1, keepdims=True)
                moving[name] = np.where(inside, there, cells)
    objects, walls = _ends_of(task, cells), None
    if isinstance(task, LiveMDP):
        across_first = states.names.index(sides[1]) < states.names.index(sides[0])
        objects, blocked = _named_in(task, last + 1, across_first=across_first)
        if blocked:
            walls, last = np.array(blocked), np.maximum(last, np.max(blocked, axis=0))
            origin = np.minimum(origin, np.min(blocked, axis=0))
    rows, columns = (last - origin + 1).tolist()
    corner = int(origin[0]), int(origin[1])
    return GridLayout(cells, sides, (rows, columns), corner, objects, walls, moving)


Objects = tuple[tuple[str, int, int, bool], ...]


def _ends_of(task: Any, cells: IntArray) -> Objects:
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


def _named_in(task: LiveMDP, shape: IntArray, *, across_first: bool) -> tuple[Objects, list[Cell]]:
    """Return the objects and walls of a task's environment: cells under a name such as ``goal``."""
    with closing(task.make()) as environment:
        environment.reset(seed=0)
        held = dict(vars(getattr(environment, "unwrapped", environment)))
    objects, walls = list[tuple[str, int, int, bool]](), list[Cell]()
    for name, value in held.items():
        parts = {part.removesuffix("s") for part in name.lower().split("_")}
        if getattr(value, "dtype", None) == "S1" and value.shape == tuple(shape):  # a frozen lake
            for letter, drawn in ((b"H", "pit"), (b"G", "goal")):
                there = np.argwhere(value == letter).tolist()
                objects += [(drawn, row, column, False) for row, column in there]
        kind = next((kind for kind, words in NAMED.items() if parts & words), None)
        if kind is None or not isinstance(value, COLLECTIONS):
            continue
        try:
            cells = np.atleast_2d(np.array(list(value)))
        except ValueError:  # its parts differ in length
            continue
        if cells.dtype == bool and cells.shape == tuple(shape):
            cells = np.argwhere(cells)
        elif cells.dtype.kind != "i" or cells.ndim != 2 or cells.shape[1] != 2:
            continue
        elif across_first:  # as in the observation
            cells = cells[:, ::-1]
        if kind == "wall":
            walls += [(row, column) for row, column in cells.tolist()]
        elif (cells >= 0).all() and (cells < shape).all():
            objects += [(kind, *cell, False) for cell in cells.tolist()]  # what ends is not known
    return tuple(objects), walls
