"""Block Dude: an agent climbs to an exit over walls, with the help of blocks it can carry."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np

from curricle.arrays import IntArray, frozen
from curricle.checks import one_of
from curricle.errors import TaskError
from curricle.tasks.domain import Discount, Domain, TimeLimit, family_of, numbered_names
from curricle.tasks.family import ComponentsByName, FamilyMember, Rule
from curricle.tasks.grid import Cell, GridLayout, cut, read_map
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.spaces import Component, Space

CHARACTERS = "<>EB#."
FACING = {"<": -1, ">": 1}  # how the agent is drawn -> the columns that a step goes
LARGEST_SPACE = 1_000_000  # states at most; they are found one by one
LEVELS = (
    """
    .........................
    .........................
    ...#.......#.............
    E..#...#.B.#.B.>.........
    """,
    """
    .........................
    E........................
    #........................
    #...........#..B.........
    #...........#B.BB<.......
    #####...#################
    ....#..B#................
    """,
    """
    .................#.......
    .................#.......
    ................B#.......
    ...............BB#.......
    .###....<...#B.##........
    .#.#....#..#####.........
    .#.#BB.##..#.............
    E#.######.##.............
    """,
)
"""The three levels of BURLAP, which has them on 25x25 cells."""


class _State(NamedTuple):
    """Heights are rows counted upwards: row r of the whole map has the height -r."""

    column: int
    height: int
    facing: int
    holding: bool
    blocks: tuple[Cell, ...]  # column and height of each that is not carried, sorted


@dataclass(frozen=True)
class BlockDude(Domain):
    """An agent that carries blocks to climb to an exit, where the episode ends.

    The rules are those of BURLAP (``burlap.domain.singleagent.blockdude``, MacGlashan 2016), after
    the game for graphing calculators. The world is seen from the side: below the map is solid
    ground, above it open sky, and columns beside it cannot be entered.

    - West, east: the agent faces that way and moves one column, unless a brick or block is in front
      of it; it falls onto what lies below. A carried block, over its head, needs no room.
    - Up: the agent climbs onto what is in front of it, if that is one brick or block high and there
      is room above it: one cell, or two with a block.
    - Pick up: the block in front of the agent, at its height and with nothing above it.
    - Put down: the carried block falls in front of the agent, unless bricks or blocks there are
      higher than one.

    Everything else leaves the state as it is. Blocks are alike: states that differ only in which
    block is where are one state. Only states that can be reached are in the table.

    Parameters
    ----------
    level : {1, 2, 3} or str or sequence of str
        One of BURLAP's levels, or a map, one line a row, the highest first: ``<`` or ``>`` the
        agent and where it faces, ``E`` exit, ``B`` block, ``#`` brick, ``.`` free.
    step_reward, exit_reward : float
        Rewards of a step that does not / does enter the exit.
    start : {"map", "uniform"}
        As drawn, or any reachable state but the exit, dead ends included.
    origin : (int, int)
        Row and column of the top-left cell. A crop keeps the coordinates of the whole map.
    discount, time_limit
        As in :class:`FiniteMDP`.

    Examples
    --------
    >>> BlockDude(level=1).states.label(0)
    'row=3 column=15 facing=east holding=no block_1=(3,9) block_2=(3,13)'
    """

    level: Any = 1
    step_reward: float = -1.0
    exit_reward: float = -1.0
    start: Literal["map", "uniform"] = "map"
    origin: Cell = (0, 0)
    discount: Discount = 0.99
    time_limit: TimeLimit = 500

    ACTIONS = ("west", "east", "up", "pick up", "put down")

    def _check(self) -> None:
        level = self.level
        if not isinstance(level, str | list | tuple):
            one_of("level", level, range(1, len(LEVELS) + 1), TaskError)
            level = LEVELS[level - 1]
        object.__setattr__(self, "level", read_map(level, CHARACTERS))
        for noun, letters in (("agent < or >", "<>"), ("exit E", "E")):
            count = sum(line.count(letter) for line in self.level for letter in letters)
            if count != 1:
                raise TaskError(f"a map needs one {noun}: there are {count or 'none'}")
        first = self._first
        standing = {first[:2]: "agent", **dict.fromkeys(first.blocks, "block")}
        for (column, height), noun in standing.items():
            if self._below(first, column, height - 1) < height - 1:
                raise TaskError(
                    f"the {noun} needs ground, a brick or a block below it: there is none below "
                    f"row {-height}, column {column}"
                )

    def with_start(self, start: Any) -> Self:
        """Return the same level with another `start`."""
        return replace(self, start=start)

    def crop(self, *, columns: tuple[int, int], start: Literal["map", "uniform"] = "map") -> Self:
        """Return the part in the half-open range `columns`, which has the exit.

        An agent that would start outside starts as far right as it can, on top of what is drawn.
        """
        low, high = columns
        for agent in (None, *range(high - 1, low - 1, -1)):
            try:
                return self._cropped(columns, agent, start)
            except TaskError as error:
                last = error
        raise last

    def _cropped(
        self, columns: tuple[int, int], agent: int | None, start: Literal["map", "uniform"]
    ) -> Self:
        """Return a part in which the agent begins as drawn, or in the column `agent`."""
        rows = (self.origin[0], self.origin[0] + len(self.level))
        part = cut(self.level, self.origin, rows, columns)
        if agent is not None:
            column, letter = agent - columns[0], "<" if self._first.facing < 0 else ">"
            part = [line.replace(letter, ".") for line in part]
            if not 0 <= column < len(part[0]):
                raise TaskError(
                    f"the agent's column must lie in a crop of {len(part[0])} columns: got number "
                    f"{column}"
                )
            drawn = [line[column] for line in part]
            free = next((row for row, cell in enumerate(drawn) if cell != "."), len(drawn)) - 1
            if free < 0 or "E" in drawn[free + 1 : free + 2]:
                raise TaskError("the agent needs a free cell above what is drawn in its column")
            line = part[free]
            part[free] = f"{line[:column]}{letter}{line[column + 1 :]}"
        return replace(self, level=part, start=start, origin=(self.origin[0], columns[0]))

    @cached_property
    def _drawn(self) -> dict[Cell, str]:
        """What is drawn at (column, height), without free cells."""
        top, left = self.origin
        return {
            (left + column, -top - row): drawn
            for row, line in enumerate(self.level)
            for column, drawn in enumerate(line)
            if drawn != "."
        }

    @cached_property
    def _first(self) -> _State:
        """The state that is drawn."""
        (agent,) = (cell for cell, drawn in self._drawn.items() if drawn in FACING)
        blocks = sorted(cell for cell, drawn in self._drawn.items() if drawn == "B")
        return _State(*agent, FACING[self._drawn[agent]], False, tuple(blocks))

    def _below(self, state: _State, column: int, height: int) -> int:
        """Return the greatest height of a brick, a block or the ground, `height` at most."""
        ground, drawn = -self.origin[0] - len(self.level), self._drawn
        while height > ground:
            cell = column, height
            if drawn.get(cell) == "#" or cell in state.blocks:
                return height
            height -= 1
        return ground

    def _after(self, state: _State, action: str) -> _State:
        """Return the state that an action leads to."""
        column, height, _, holding, blocks = state
        if action in ("west", "east"):
            state = state._replace(facing=-1 if action == "west" else 1)
        there = column + state.facing
        if not 0 <= there - self.origin[1] < len(self.level[0]):
            return state
        if action in ("west", "east"):
            below = self._below(state, there, height)
            return state if below == height else state._replace(column=there, height=below + 1)
        if action == "up":
            below = self._below(state, there, height + 1 + holding)
            return state if below != height else state._replace(column=there, height=height + 1)
        if action == "pick up":
            above = (there, height + 1)
            covered = above in blocks or self._drawn.get(above) == "#"
            if holding or covered or (there, height) not in blocks:
                return state
            rest = tuple(block for block in blocks if block != (there, height))
            return state._replace(holding=True, blocks=rest)
        below = self._below(state, there, height + 1)
        if not holding or below > height:
            return state
        return state._replace(holding=False, blocks=tuple(sorted((*blocks, (there, below + 1)))))

    @cached_property
    def _reached(self) -> tuple[list[_State], IntArray]:
        """The states that can be reached, the drawn one first, and successors, (S, A) int64."""
        number, states, successors = {self._first: 0}, [self._first], list[list[int]]()
        for state in states:  # which grows meanwhile
            ended = self._drawn.get(state[:2]) == "E"
            after = [state if ended else self._after(state, action) for action in self.ACTIONS]
            for reached in after:
                if reached not in number:
                    number[reached] = len(states)
                    states.append(reached)
            successors.append([number[reached] for reached in after])
            if len(states) > LARGEST_SPACE:
                raise TaskError(
                    f"a level may have at most {LARGEST_SPACE:,} states that can be reached: this "
                    f"one, of {len(self.level[0])} columns and {len(self._first.blocks)} blocks, "
                    "has more"
                )
        return states, np.array(successors)

    @cached_property
    def _cells(self) -> IntArray:
        """Row and column of the agent and of each block, a carried one first, (S, 1 + k, 2)."""
        cells = [
            (state[:2], *[(state.column, state.height + 1)] * state.holding, *state.blocks)
            for state in self._reached[0]
        ]
        return frozen(np.array(cells)[:, :, ::-1] * np.array([-1, 1]))

    @cached_property
    def states(self) -> Space:
        """The agent's cell, where it faces, whether it carries a block, and each block's cell."""
        (rows, columns), blocks = self._cells[:, 0].T, self._cells[:, 1:]
        facing, holding = np.array([(s.facing > 0, s.holding) for s in self._reached[0]]).T
        axes = [
            Component("row", int(rows.max() - rows.min()) + 1, int(rows.min())),
            Component("column", len(self.level[0]), self.origin[1]),
            Component("facing", 2, labels=("west", "east")),
            Component("holding", 2, labels=("no", "yes")),
        ]
        carried = np.zeros(blocks.shape[:2], bool)
        carried[holding, :1] = True
        lie, number = np.unique(blocks[~carried], axis=0, return_inverse=True)
        values = np.zeros(carried.shape, np.int64)
        values[~carried] = 1 + number.ravel()
        labels = ("carried", *(f"({row},{column})" for row, column in lie.tolist()))
        axes += [Component(name, len(labels), labels=labels) for name in self.block_names]
        return Space(axes, np.column_stack([rows, columns, facing, holding, values]).astype(int))

    @property
    def block_names(self) -> tuple[str, ...]:
        """``block`` if there is one, else ``block_1``, ``block_2``, ..."""
        return numbered_names("block", len(self._first.blocks))

    @cached_property
    def layout(self) -> GridLayout:
        """Where the agent is in each state, for pictures."""
        top, left = self.origin
        first = min(top, int(self._cells[..., 0].min()))
        drawn = sorted(self._drawn.items())
        bricks = [(-height, column) for (column, height), symbol in drawn if symbol == "#"]
        exits = [(-height, column) for (column, height), symbol in drawn if symbol == "E"]
        return GridLayout(
            cells=self._cells[:, 0],
            components=("row", "column"),
            shape=(top + len(self.level) - first, len(self.level[0])),
            origin=(first, left),
            objects=tuple(("exit", *cell, True) for cell in exits),
            walls=np.array(bricks, dtype=np.int64).reshape(-1, 2),
            markers={name: self._cells[:, 1 + i] for i, name in enumerate(self.block_names)},
        )

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The level as tables: a row for entering each state, O = 1."""
        states, after = self._reached
        ended = np.array([self._drawn.get(state[:2]) == "E" for state in states])
        return self._tables(
            np.ones((len(states), 1)),
            np.arange(len(states))[:, None],
            np.where(ended, self.exit_reward, self.step_reward)[:, None],
            terminal=ended,
            starting=np.flatnonzero(~ended) if self.start == "uniform" else np.array([0]),
            outcome_row=after,
        )


# -- the family: levels and their parts around the exit --------------------------------------------

WIDTH = 25  # columns of the levels
PARTS: dict[int, tuple[int, ...]] = {
    1: (10, 11, 12, *range(15, WIDTH)),
    2: tuple(range(17, WIDTH)),
    3: tuple(range(17, WIDTH)),
}
"""Level -> the columns of its parts that have blocks and a way to the exit."""


def part_of_level(
    level: Annotated[Literal[1, 2, 3], Rule(harder="later")] = 1,
    columns: Annotated[int | None, Rule(2, WIDTH - 1, "larger")] = None,
    **rules: Any,
) -> BlockDude:
    """Return one of BURLAP's levels, or so many of its columns from the exit on."""
    whole = BlockDude(level, **rules)
    if columns is None:
        return whole
    return whole.crop(columns=(0, columns), start=whole.start)


def _block_mapping(target: FamilyMember, source: FamilyMember) -> ComponentsByName:
    """Return how a level reads another: by name, blocks in their order from the exit on."""
    blocks, source_blocks = target.task.block_names, source.task.block_names
    if len(source_blocks) > len(blocks):
        raise TaskError(
            f"a level reads levels with at most its {len(blocks)} blocks: got {source}, which has "
            f"{len(source_blocks)}"
        )
    pairs = zip(source_blocks, blocks, strict=False)
    return ComponentsByName(renaming={theirs: ours for theirs, ours in pairs if theirs != ours})


def _has_a_way(parameters: dict[str, Any]) -> str | None:
    """Return the mistake, a sentence, if a part has no way to the exit."""
    valid = PARTS[parameters["level"]]
    if parameters["columns"] is None or parameters["columns"] in valid:
        return None
    return (
        f"columns of level {parameters['level']} of block_dude must be one of "
        f"{', '.join(map(str, valid))}, as other parts have no block or no way to the exit"
    )


block_dude_family = family_of(
    BlockDude, part_of_level, mapping=_block_mapping, constraint=_has_a_way
)
"""BURLAP's levels of :class:`BlockDude`, or their `columns` around the exit, 2 or more.

Members map by name, blocks in their order from the exit on.
"""
