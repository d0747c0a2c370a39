"""Tasks that several families are made of: grids with slips, and tasks on a line."""

from collections.abc import Callable
from typing import Any

import numpy as np

import curricle as cr

MOVES = {"north": (-1, 0), "east": (0, 1), "south": (1, 0), "west": (0, -1)}
Cell = tuple[int, int]


def task_of(
    points: list[tuple[int, ...]],
    names: tuple[str, ...],
    actions: cr.Component,
    outcomes: Callable[[tuple[int, ...], int], list[tuple[float, tuple[int, ...], float]]],
    *,
    ends: Callable[[tuple[int, ...]], bool] = lambda point: False,
    starts: Callable[[tuple[int, ...]], bool],
    discount: float,
    time_limit: int,
) -> cr.FiniteMDP:
    """Return the task on these points, whose components have these names.

    `outcomes(point, action)` lists (probability, next point, reward); each start is equally likely.
    """
    number = {point: i for i, point in enumerate(points)}
    terminal = np.array([ends(point) for point in points])
    start = np.array([starts(point) and not ends(point) for point in points], float)
    low, high = np.min(points, axis=0), np.max(points, axis=0)
    components = [
        cr.Component(name, int(b - a) + 1, low=int(a))
        for name, a, b in zip(names, low, high, strict=True)
    ]
    return cr.FiniteMDP.from_outcomes(
        [
            [
                [] if terminal[i] else [(p, number[to], float(r)) for p, to, r in outcomes(at, a)]
                for a in range(actions.size)
            ]
            for i, at in enumerate(points)
        ],
        terminal=terminal,
        start=start / start.sum(),
        discount=discount,
        time_limit=time_limit,
        states=cr.Space(components, np.array(points)),
        actions=cr.Space([actions]),
    )


def explored(
    first: list[tuple[int, ...]],
    names: tuple[str, ...],
    actions: cr.Component,
    outcomes: Callable[[Any, int], list[tuple[float, tuple[int, ...], float]]],
    *,
    ends: Callable[[Any], bool] = lambda point: False,
    discount: float,
    time_limit: int,
) -> cr.FiniteMDP:
    """Return the task on the points that lead on from the first ones, where it starts."""
    points, known = list(first), set(first)
    for point in points:  # grows meanwhile
        for action in range(0 if ends(point) else actions.size):
            for chance, after, _ in outcomes(point, action):
                if chance > 0 and after not in known:
                    known.add(after)
                    points.append(after)

    def possible(point: Any, action: int) -> Any:
        return [outcome for outcome in outcomes(point, action) if outcome[0] > 0]

    return task_of(
        sorted(points), names, actions, possible, ends=ends,
        starts=lambda point: point in first, discount=discount, time_limit=time_limit,
    )  # fmt: skip


def cells_of(lines: list[str], origin: Cell = (0, 0)) -> dict[Cell, str]:
    """Return the characters of a map by cell, but for walls; the first cell is at `origin`."""
    return {
        (origin[0] + i, origin[1] + j): character
        for i, line in enumerate(lines)
        for j, character in enumerate(line)
        if character != "#"
    }


def grid(
    lines: list[str],
    *,
    rewards: dict[str, float],
    slip: float = 0.0,
    ends: str = "G",
    starts: str = "S",
    step: float = 0.0,
    wind: dict[int, float] | None = None,
    back_to_start: str = "",
    discount: float = 0.99,
    time_limit: int = 100,
    origin: Cell = (0, 0),
) -> cr.FiniteMDP:
    """Return the grid that a map draws, with components ``row``, ``column`` and ``move``.

    `rewards` are those for entering a cell, by its character, on top of `step`; ``#`` is a wall.
    With probability `slip` a move goes to one of its sides. `wind` is the chance, by column, of one
    cell further north. Cells of `back_to_start` lead to the (only) start.
    """
    cells = cells_of(lines, origin)
    home = next((cell for cell, character in cells.items() if character in starts), None)
    moves = list(MOVES.values())

    def entered(cell: Cell, move: Cell) -> Cell:
        after = cell[0] + move[0], cell[1] + move[1]
        return after if after in cells else cell

    def outcomes(cell: Any, action: int) -> Any:
        ways = [(1 - slip, action), (slip / 2, (action + 1) % 4), (slip / 2, (action - 1) % 4)]
        blown = (wind or {}).get(cell[1], 0.0)
        found = []
        for chance, way in ways:
            still = entered(cell, moves[way])
            for p, after in (1 - blown, still), (blown, entered(still, moves[0])):
                if chance * p > 0:
                    reward = step + rewards.get(cells[after], 0.0)
                    to = home if cells[after] in back_to_start else after
                    found.append((chance * p, to, reward))
        return found

    return task_of(
        list(cells),
        ("row", "column"), cr.Component("move", 4, labels=tuple(MOVES)), outcomes,
        ends=lambda cell: cells[cell] in ends, starts=lambda cell: cells[cell] in starts,
        discount=discount, time_limit=time_limit,
    )  # fmt: skip


def cropped(
    lines: list[str], rows: tuple[int, int], columns: tuple[int, int], **rules: Any
) -> cr.FiniteMDP:
    """Return a part of a grid, in the whole map's coordinates."""
    part = [line[slice(*columns)] for line in lines[slice(*rows)]]
    return grid(part, origin=(rows[0], columns[0]), **rules)


def redrawn(lines: list[str], changes: dict[Cell, str]) -> list[str]:
    """Return the map with other characters in some cells."""
    rows = [list(line) for line in lines]
    for (i, j), character in changes.items():
        rows[i][j] = character
    return ["".join(row) for row in rows]


def by_cell(cell: Any = lambda row, column: (row, column)) -> Any:
    """Return how a cell reads a cell of the source, moves as they are."""

    def read(state: Any, action: Any) -> Any:
        row, column = cell(state["row"], state["column"])
        return {"row": row, "column": column}, action

    return read


def at_first(component: str) -> Any:
    """Return how a state is read as that with the first value of a component."""

    def read(state: Any, action: Any) -> Any:
        return {**state, component: 0 * state[component]}, action

    return read


def by_value(value: Any = lambda x: x, action: Any = lambda x: x) -> Any:
    """Return how every component of a state is read, and those of an action."""

    def changed(parts: Any, change: Any) -> Any:
        return {name: change(part) for name, part in parts.items()}

    return lambda state, move: (changed(state, value), changed(move, action))
