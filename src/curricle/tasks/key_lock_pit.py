"""A room with keys, locks and pits, drawn as text: pick up the keys, open the locks, do not fall.

Narvekar, Sinapov, Stone 2017, "Autonomous task sequencing for customized curriculum design in
reinforcement learning" (also Narvekar and Stone 2019, "Learning curriculum policies for
reinforcement learning"). The agent moves one cell north, east, south or west; a wall or the edge
leaves it where it is. In a cell with a key it can pick the key up (+500). In a cell with a lock it
can open the lock (+1000), if it holds the keys that the lock depends on. Moving into a pit ends the
episode (-200). All other actions cost 10, also picking up or opening where there is nothing to pick
up or to open. The episode ends when all locks are open. The papers' beacons are features for
function approximation and have no counterpart in a table.

For source tasks a map may lack one of them: without locks the episode ends when all keys are held,
and a lock without keys on the map is opened by an agent that holds none.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any, Self

import numpy as np

from curricle.arrays import BoolArray, IntArray, frozen
from curricle.checks import instance, number, whole_number
from curricle.errors import TaskError
from curricle.tasks.domain import (
    MOVES,
    Cell,
    MapDomain,
    check_starts,
    cut,
    landing_or_staying,
    numbered_names,
    read_start,
    tables_of,
)
from curricle.tasks.grid_layout import GridLayout
from curricle.tasks.mdp import FiniteMDP, check_horizon
from curricle.tasks.outcomes import check_numbers
from curricle.tasks.spaces import MISSING, Component, Space, whole

OBJECTS = {"K": "key", "L": "lock", "P": "pit"}
CHARACTERS = "SKLP#."
ACTIONS = (*MOVES, "pick up", "unlock")
SMALLEST_ROOM, LARGEST_ROOM = 4, 1000
LARGEST_SPACE = 5_000_000
"""States at most; keys and locks double them."""


def _room(side: int) -> tuple[str, ...]:
    """Return the lines of a square room with one key, one lock and a wall of pits between them."""
    drawn = np.full((side, side), ".")
    drawn[2:, side // 2] = "P"
    drawn[1, 1], drawn[-1, 0], drawn[-1, -1] = "K", "S", "L"
    return tuple("".join(line) for line in drawn)


ROOM = "\n".join(_room(8))


@dataclass(frozen=True)
class KeyLockPit(MapDomain):
    """Keys, locks and pits in a room drawn as a text map.

    Parameters
    ----------
    map : str or sequence of str
        One line a row, north first. ``S`` start, ``K`` key, ``L`` lock, ``P`` pit, ``#`` wall,
        ``.`` free; at least one key or lock.
    needs : "all" or lists of int
        For each lock, in reading order, the keys that it depends on, numbered in reading order from
        1; by default all of them.
    key_reward, lock_reward, pit_reward : float
        Of picking up a key, of opening a lock and of falling into a pit.
    step_reward : float
        Of every other action.
    start : "map", "uniform" or cells
        At an ``S``, in any state in which the episode goes on, or at one of the given
        ``(row, column)`` cells; all are equally likely.
    keys_held : bool
        Whether episodes start with all keys held, as in the second half of a task.
    origin : (int, int)
        Row and column of the top-left cell. A crop keeps the coordinates of the whole map.
    discount, time_limit
        As in :class:`FiniteMDP`.

    Raises
    ------
    TaskError
        On a map, a reward, a start or keys of a lock that make no sense.

    Examples
    --------
    >>> task = KeyLockPit()
    >>> task.states  # 64 cells without the key, 64 with it, and the lock when it is open
    Space(129 points: row[8] x column[8] x key[2] x lock[2])
    >>> task.actions.components[0].labels
    ('north', 'east', 'south', 'west', 'pick up', 'unlock')
    """

    map: Any = ROOM
    needs: Any = "all"
    key_reward: float = 500.0
    lock_reward: float = 1000.0
    pit_reward: float = -200.0
    step_reward: float = -10.0
    start: Any = "map"
    keys_held: bool = False
    origin: Cell = (0, 0)
    discount: float = 0.99
    time_limit: int | None = 200

    def __post_init__(self) -> None:
        self._read_map(self.map, CHARACTERS, "KL", "a map needs a key K or a lock L")
        check_numbers(self, ("key_reward", "lock_reward", "pit_reward", "step_reward"))
        instance("keys_held", self.keys_held, bool, TaskError)
        check_horizon(self)
        if not isinstance(self.needs, str) or self.needs != "all":
            object.__setattr__(self, "needs", self._read_needs())
        read_start(self)
        things = len(self._keys) + len(self._locks)
        if 2**things * len(self.cells) > LARGEST_SPACE:
            raise TaskError(
                f"a map may have at most {LARGEST_SPACE:,} states: {len(self.cells):,} cells and "
                f"{things} keys and locks make up to 2^{things} times as many"
            )
        self._start_states()

    @classmethod
    def room(cls, size: int = 8, **rules: Any) -> Self:
        """Return a square room: the key in the north-west, the lock behind pits in the south-east.

        Parameters
        ----------
        size : int
            Cells per side, 4 to 1000.
        **rules
            The other parameters of the class.

        Examples
        --------
        >>> KeyLockPit.room(5).map
        ('.....', '.K...', '..P..', '..P..', 'S.P.L')
        """
        side = whole_number("size", size, SMALLEST_ROOM, TaskError)
        side = int(number("size", side, TaskError, SMALLEST_ROOM, LARGEST_ROOM))
        return cls(map=_room(side), **rules)

    # -- variants ------------------------------------------------------------------------------

    def crop(
        self, *, rows: tuple[int, int], columns: tuple[int, int], start: Any = "uniform"
    ) -> Self:
        """Return the part in the half-open ranges `rows` x `columns`, in this map's coordinates.

        Objects outside the part are removed; a key outside counts as held.

        Raises
        ------
        TaskError
            When the part exceeds the map, is empty, or has no key and no lock.

        Examples
        --------
        >>> KeyLockPit().crop(rows=(2, 8), columns=(5, 8)).states
        Space(19 points: row[6] x column[3] x lock[2])
        """
        part = cut(self.map, self.origin, rows, columns)

        def kept(cells: IntArray) -> list[int]:
            inside = (cells >= (rows[0], columns[0])) & (cells < (rows[1], columns[1]))
            return np.flatnonzero(inside.all(axis=1)).tolist()

        keys, needs = kept(self._keys), self.needs
        if needs != "all":
            needs = tuple(
                tuple(keys.index(key - 1) + 1 for key in needs[lock] if key - 1 in keys)
                for lock in kept(self._locks)
            )
        return replace(self, map=part, needs=needs, start=start, origin=(rows[0], columns[0]))

    # -- spaces --------------------------------------------------------------------------------

    @cached_property
    def states(self) -> Space:
        """The agent's cell, which keys it holds and which locks are open.

        An open lock's keys are held, and when the last lock is open the agent is at a lock.
        """
        axes = [*self._cell_space.components]
        axes += [Component(name, 2, labels=("lying", "held")) for name in self._key_names]
        axes += [Component(name, 2, labels=("locked", "open")) for name in self._lock_names]
        last = self._locks if len(self._locks) else self._keys
        points = [
            np.column_stack([cells, np.tile(status, (len(cells), 1))])
            for status in self._statuses
            for cells in [last if all(status) else self.cells]
        ]
        return Space(axes, np.concatenate(points))

    @cached_property
    def actions(self) -> Space:
        """The four moves, picking up a key and opening a lock."""
        return Space([Component("move", len(ACTIONS), labels=ACTIONS)])

    @cached_property
    def layout(self) -> GridLayout:
        """Where the states lie, for pictures."""
        objects = [
            (name, row, column, name == "pit")
            for character, name in OBJECTS.items()
            for row, column in self._at(character).tolist()
        ]
        return GridLayout(
            cells=frozen(self.states.points[:, :2].copy()),
            components=("row", "column"),
            shape=self._grid.shape,
            origin=self.origin,
            objects=tuple(objects),
            walls=self._at("#"),
        )

    @cached_property
    def _keys(self) -> IntArray:
        return self._at("K")

    @cached_property
    def _locks(self) -> IntArray:
        return self._at("L")

    @property
    def _key_names(self) -> tuple[str, ...]:
        return numbered_names("key", len(self._keys))

    @property
    def _lock_names(self) -> tuple[str, ...]:
        return numbered_names("lock", len(self._locks))

    @property
    def _keys_of(self) -> list[set[int]]:
        """The keys of each lock, numbered from 0."""
        if self.needs == "all":
            return [set(range(len(self._keys)))] * len(self._locks)
        return [{key - 1 for key in keys} for keys in self.needs]

    @cached_property
    def _statuses(self) -> tuple[tuple[int, ...], ...]:
        """Which keys are held (1) and which locks open, where open locks have their keys held."""
        keys = len(self._keys)
        return tuple(
            status
            for status in product((0, 1), repeat=keys + len(self._locks))
            if all(
                not opened or all(status[key] for key in needed)
                for opened, needed in zip(status[keys:], self._keys_of, strict=True)
            )
        )

    # -- tables --------------------------------------------------------------------------------

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The task as tables: a row for entering each state by a move, one for using its object."""
        states, n_states = self.states, self.states.size
        values, here = states.decode(), np.arange(n_states)
        cell = self._cell_space.encode(row=values["row"], column=values["column"])
        after = landing_or_staying(self._cell_space)[cell]
        others = {name: values[name][:, None] for name in states.names[2:]}
        row, column = self.cells[after].transpose(2, 0, 1)
        entered = states.encode(row=row, column=column, **others)
        entered = np.where(entered == MISSING, here[:, None], entered)  # of states that ended
        used, paid = here.copy(), np.full(n_states, self.step_reward)
        picked, opened = self._use(used, paid)
        use = [np.where(does, n_states + here, here)[:, None] for does in (picked, opened)]
        move_reward = np.where(self._fallen, self.pit_reward, self.step_reward)
        return tables_of(
            self,
            np.ones((2 * n_states, 1)),
            np.concatenate([here, used])[:, None],
            np.concatenate([move_reward, paid])[:, None],
            terminal=self._ended,
            starting=self._start_states(),
            outcome_row=np.concatenate([entered, *use], axis=1),
        )

    def _use(self, used: IntArray, paid: Any) -> tuple[BoolArray, BoolArray]:
        """Write where using the object of a cell leads, and what it pays; return where it is done.

        The first array says where a key is picked up, the second where a lock is opened, (S,).
        """
        values = self.states.decode()
        picked, opened = np.zeros(len(used), bool), np.zeros(len(used), bool)

        def use(name: str, cell: IntArray, keys: Iterable[int], pays: float) -> BoolArray:
            here = (values["row"] == cell[0]) & (values["column"] == cell[1])
            can: BoolArray = here & (values[name] == 0)
            for key in keys:
                can &= values[self._key_names[key]] == 1
            changed = {**values, name: np.ones_like(values[name])}
            used[can] = self.states.encode(**{n: v[can] for n, v in changed.items()})
            paid[can] = pays
            return can

        for name, cell in zip(self._key_names, self._keys, strict=True):
            picked |= use(name, cell, (), self.key_reward)
        for name, cell, keys in zip(self._lock_names, self._locks, self._keys_of, strict=True):
            opened |= use(name, cell, keys, self.lock_reward)
        return picked, opened

    @property
    def _fallen(self) -> BoolArray:
        """Whether the agent is in a pit, (S,) bool."""
        row, column = (self.states.points[:, :2] - np.array(self.origin)).T
        return np.asarray(self._grid[row, column] == "P")

    @property
    def _ended(self) -> BoolArray:
        """In a pit, or with all locks open (all keys held where there is no lock), (S,) bool."""
        first = 2 + (len(self._keys) if len(self._locks) else 0)
        return np.asarray(self._fallen | self.states.points[:, first:].all(axis=1))

    def _start_states(self) -> IntArray:
        """Return the states in which episodes start; TaskError where there are none."""
        keys = len(self._keys)
        held = self.states.points[:, 2 : 2 + keys]
        going_on = ~self._ended
        if self.keys_held:
            going_on &= held.all(axis=1)
        if self.start == "uniform":
            found = np.flatnonzero(going_on)
            if not found.size:
                raise TaskError("start='uniform' needs a state that does not end the episode")
            return found
        cells = self._at("S")
        if self.start != "map":
            cells = np.array(self.start)
        elif not len(cells):
            raise TaskError("start='map' needs an S on the map: there is none")
        status = dict.fromkeys(self._key_names, int(self.keys_held))
        status |= dict.fromkeys(self._lock_names, 0)
        states = self.states.encode(row=cells[:, 0], column=cells[:, 1], **status)
        rule = "an episode starts in a free cell of the map and does not end there"
        return check_starts(states, going_on, cells, rule)

    def _read_needs(self) -> tuple[tuple[int, ...], ...]:
        """Return the keys of each lock, sorted; TaskError if they make no sense."""
        keys, locks = len(self._keys), len(self._locks)
        given: list[Any] = [*self.needs] if isinstance(self.needs, list | tuple) else [None]
        if len(given) != locks or not all(isinstance(one, list | tuple) for one in given):
            raise TaskError(
                f"needs must be 'all' or a list of keys for each of the {locks} locks: got "
                f"{self.needs!r}"
            )
        found = list[tuple[int, ...]]()
        for one in given:
            listed = whole(list(one), "the keys of a lock")
            if listed.ndim != 1 or ((listed < 1) | (listed > keys)).any():
                raise TaskError(f"the keys of a lock must be numbers from 1 to {keys}: got {one!r}")
            found.append(tuple(sorted(set(listed.tolist()))))
        return tuple(found)
