"""The base of the domains that come with the library: a domain is one declaration.

The annotations of its fields (:class:`Rule`) say which values they take and which of these are
harder; :class:`Domain` checks a task by them, and :func:`family_of` makes the parameters of its
family of them.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, cached_property
from typing import Annotated, Any, ClassVar, Literal, Self, get_args, get_origin

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, Frozen, IntArray, frozen
from curricle.errors import TaskError
from curricle.tasks.family import Parameter, Rule, TaskFamily, parameters_of, rules_of
from curricle.tasks.grid import MOVES, Grid, GridLayout, cell_of, cut, read_map
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.models import LARGEST_REWARD, check_horizon
from curricle.tasks.spaces import MISSING, Component, Space

Discount = Annotated[float, Rule(0, 1)]
TimeLimit = Annotated[int | None, Rule(1)]
MapStart = Annotated[Any, Rule(values=("map", "uniform"))]  # a word, or cells as (row, column)


class Domain(Frozen):
    """A task that is a frozen dataclass of its rules, which `_check` checks beyond annotations."""

    ACTIONS: ClassVar[tuple[str, ...]] = tuple(MOVES)
    __dataclass_fields__: ClassVar[dict[str, Any]]
    states: Any
    discount: float
    time_limit: int | None

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
        kind, rule, optional = rules[name]
        if name in ("discount", "time_limit"):  # check_horizon has their limits
            continue
        if kind is float and (rule.low, rule.high) == (None, None):
            rule = Rule(-LARGEST_REWARD, LARGEST_REWARD)
        if kind in (int, float, bool):
            checks.append((name, Parameter(name, kind, rule, optional=optional).checked))
        elif get_origin(kind) is Literal:
            checks.append((name, Parameter(name, rule=Rule(values=get_args(kind))).checked))
        elif name == "origin":
            checks.append((name, lambda origin: cell_of("origin", origin, "a row and a column")))
    return tuple(checks)


def numbered_names(kind: str, count: int) -> tuple[str, ...]:
    """Return ``key`` if there is one, else ``key_1``, ``key_2``, ..."""
    return (kind,) if count == 1 else tuple(f"{kind}_{i + 1}" for i in range(count))


def name_of(domain: type[Domain]) -> str:
    """Return what the family of a domain, and its type in study files, are called."""
    return re.sub(r"(?<=.)(?=[A-Z])", "_", domain.__name__).lower()


def family_of(
    domain: type[Domain],
    factory: Callable[..., Any] | None = None,
    *,
    mapping: object = None,
    constraint: Callable[[dict[str, Any]], str | None] | None = None,
) -> TaskFamily:
    """Return the family of a domain, named after it; a factory's own parameters come first."""
    name = name_of(domain)
    parameters = {of.name: of for of in parameters_of(factory or domain, name)}
    for of in parameters_of(domain, name):
        parameters.setdefault(of.name, of)
    made = factory or domain, mapping, constraint, tuple(parameters.values())
    return TaskFamily(name, *made)


# -- domains of cells ------------------------------------------------------------------------------


class GridDomain(Domain):
    """A domain whose agent is in a cell of its `grid`; by default state and cell are the same."""

    OBJECTS: ClassVar[Mapping[str, str]] = {}  # character -> what it is in pictures
    ENDS: ClassVar[str] = ""  # characters of the cells that end an episode when they are entered
    start: Any

    @property
    def grid(self) -> Grid:
        """The cells, and what lies in them."""
        raise NotImplementedError

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
        self._starting()

    def with_start(self, start: object) -> Self:
        """Return the same task with another `start`."""
        return replace(self, start=start)

    def can_start_in(self, states: IntArray) -> bool:
        """Return whether each state is one cell, and episodes may start in the cells of these."""
        return self.states.size == len(self.cells) and bool(self._standing[states].all())

    def start_in(self, states: IntArray) -> Self:
        """Return the same task with starts in the cells of these states, equally likely."""
        return self.with_start([(int(row), int(column)) for row, column in self.cells[states]])

    @property
    def cells(self) -> IntArray:
        """Row and column of each cell that is not a wall, (n, 2), in reading order."""
        return self.grid.cells

    @cached_property
    def objects(self) -> tuple[tuple[str, int, int], ...]:
        """Every object as (class, row, column), in reading order."""
        places = zip(self.grid.contents, self.cells.tolist(), strict=True)
        return tuple((self.OBJECTS[drawn], *at) for drawn, at in places if drawn in self.OBJECTS)

    @cached_property
    def states(self) -> Space:
        """One state for each cell that is not a wall."""
        return self.grid.space

    @cached_property
    def layout(self) -> GridLayout:
        """Where the states lie, for pictures."""
        ending = {self.OBJECTS.get(character) for character in self._ending}
        placed = "row" in self.states.names
        values = (self.states if placed else self.grid.space).decode()
        return GridLayout(
            cells=frozen(np.stack([values["row"], values["column"]], axis=1)),
            components=("row", "column") if placed else self.states.names,
            shape=self.grid.drawn.shape,
            origin=self.grid.corner,
            objects=tuple((*drawn, drawn[0] in ending) for drawn in self.objects),
        )

    @property
    def _ending(self) -> str:
        return self.ENDS

    @property
    def _ends(self) -> BoolArray:
        """Which states end an episode, (S,) bool."""
        return self.grid.holds(self._ending)

    @property
    def _standing(self) -> BoolArray:
        """In which states an episode may start, (S,) bool."""
        return ~self._ends

    def states_at(self, row: npt.ArrayLike, column: npt.ArrayLike) -> IntArray:
        """Return the states of these cells, `MISSING` off the map and in walls."""
        return self.grid.space.encode(row=row, column=column)

    def _starting(self) -> IntArray:
        """Return the states in which episodes start; TaskError where there are none."""
        # In an S ("map"), in any that ends none ("uniform"), in the first such (another word).
        standing = self._standing
        if isinstance(self.start, str) and self.start != "map":
            if not standing.any():
                raise TaskError(f"start={self.start!r} needs a state that does not end the episode")
            states = np.flatnonzero(standing)
            return states if self.start == "uniform" else states[:1]
        cells = self.cells[self.grid.holds("S")] if self.start == "map" else np.array(self.start)
        if not len(cells):
            raise TaskError("start='map' needs an S on the map: there is none")
        states = self.states_at(*cells.T)
        bad = np.flatnonzero((states == MISSING) | ~standing[states])
        if bad.size:
            raise TaskError(
                "an episode starts in a free cell that does not end it: got "
                f"{tuple(map(int, cells[bad[0]]))}"
            )
        return states

    def _tables(self, *outcomes: Any, **settings: Any) -> FiniteMDP:
        """Return the tables; episodes end and start in the states of the cells that say so."""
        return super()._tables(
            *outcomes, terminal=self._ends, starting=self._starting(), **settings
        )


class MapDomain(GridDomain):
    """A domain whose grid is drawn as a text map, on which ``#`` is a wall."""

    CHARACTERS: ClassVar[str]  # what a map is drawn with
    map: Any
    origin: Any

    def _read_map(
        self, drawn: object, needed: str, rule: str, legend: Mapping[str, str] | None = None
    ) -> None:
        """Check the map, which has one of the characters `needed`."""
        lines = read_map(drawn, self.CHARACTERS, legend)
        if not any(character in line for line in lines for character in needed):
            raise TaskError(f"{rule}: there is none")
        object.__setattr__(self, "map", lines)

    def crop(
        self, *, rows: tuple[int, int], columns: tuple[int, int], start: object = "uniform"
    ) -> Self:
        """Return the part in the half-open ranges `rows` x `columns`, in this map's coordinates.

        Objects outside are removed: fire just outside no longer counts as near, keys outside count
        as held. The default start is uniform, as in the paper's source tasks.
        """
        part = cut(self.map, self.origin, rows, columns)
        return replace(self, map=part, start=start, origin=(rows[0], columns[0]))

    @cached_property
    def grid(self) -> Grid:
        """The cells, and what lies in them."""
        return Grid(np.array([list(line) for line in self.map]), self.origin)
