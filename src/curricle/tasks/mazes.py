"""The family of random mazes, which are always solvable; a small maze is a part of a larger one."""

from collections import deque
from collections.abc import Iterator
from itertools import count
from typing import Annotated, Any, Literal, get_args

from curricle.checks import number, one_of, whole_number
from curricle.errors import TaskError
from curricle.tasks.domain import Discount, TimeLimit
from curricle.tasks.family import Rule, TaskFamily
from curricle.tasks.gridworld import GridWorld, Rewards
from curricle.tasks.kernel import STRIDE, splitmix64, stream_start, uniform

LARGEST_MAZE = 200
Corner = Literal["north-west", "north-east", "south-west", "south-east"]
CORNERS = get_args(Corner)
Share = Annotated[float, Rule(0, 1, "larger")]

_Cell = tuple[int, int]


def random_maze(
    size: Annotated[int, Rule(2, LARGEST_MAZE, "larger")] = 6,
    walls: Share = 0.2,
    pits: Share = 0.05,
    fires: Share = 0.0,
    seed: Annotated[int, Rule(0)] = 0,
    *,
    corner: Corner = "north-east",
    start: Literal["far", "uniform"] = "far",
    step: float = -1.0,
    treasure: float = 200.0,
    fire: float = -500.0,
    near_fire: float = -250.0,
    pit: float = -2500.0,
    discount: Discount = 0.99,
    time_limit: TimeLimit = 200,
) -> GridWorld:
    r"""Return a random maze: a square with the treasure in a corner, walls, pits and fires.

    It grows from the treasure outwards, one row and one column at a time. Each of their cells gets
    an object with the given chances; then objects are taken away at random until every free cell
    of them has a way to the treasure that enters neither pit nor fire. So every maze is solvable
    from every free cell, and **a smaller maze with the same seed is the part of a larger one around
    the treasure**, as the paper's source tasks are parts of their target. The treasure has the
    coordinates (0, 0) in all of them.

    Parameters
    ----------
    size : int
        Cells per side, 2 to 200.
    walls, pits, fires : float
        Chances that a cell becomes one, together at most 1; fewer remain where they are many.
    seed : int
        At least 0. Mazes with different seeds are independent.
    corner : {"north-west", "north-east", "south-west", "south-east"}
        Where the treasure lies.
    start : {"far", "uniform"}
        Episodes start in the free cell from which the way is the longest, or in any cell that does
        not end the episode.
    step, treasure, fire, near_fire, pit : float
        As in :class:`Rewards`.
    discount, time_limit
        As in :class:`GridWorld`.

    Raises
    ------
    TaskError
        When a value is out of range, or the chances sum to more than 1.

    Examples
    --------
    >>> maze = random_maze(size=5, seed=3)
    >>> print("\n".join(maze.map))
    .#..T
    .....
    .#.#.
    ...##
    S....
    >>> random_maze(size=4, seed=3, start="uniform").map == maze.crop(
    ...     rows=(0, 4), columns=(-3, 1)).map
    True
    """
    size = whole_number("size of a maze", size, 2, TaskError)
    number("size of a maze", size, TaskError, 2, LARGEST_MAZE)
    seed = whole_number("seed of a maze", seed, 0, TaskError)
    chances = {"walls": walls, "pits": pits, "fires": fires}
    for name, chance in chances.items():
        number(f"{name} of a maze", chance, TaskError, 0, 1)
    if refused := _chances_sum(chances):
        raise TaskError(f"{refused}: got {walls}, {pits} and {fires}")
    one_of("corner of a maze", corner, CORNERS, TaskError)
    one_of("start of a maze", start, ("far", "uniform"), TaskError)
    cells = {(0, 0): "T"}
    for n in range(1, size):
        _grow(cells, n, {"#": walls, "P": pits, "F": fires}, seed)
    far = _farthest(cells)
    if start == "far":
        cells[far] = "S"
    vertical, horizontal = corner.split("-")
    return GridWorld(
        _lines(cells, down=vertical == "north", right=horizontal == "west"),
        rewards=Rewards(step=step, treasure=treasure, fire=fire, near_fire=near_fire, pit=pit),
        start="map" if start == "far" else "uniform",
        origin=(
            0 if vertical == "north" else 1 - size,
            0 if horizontal == "west" else 1 - size,
        ),
        discount=discount,
        time_limit=time_limit,
    )


def _grow(cells: dict[_Cell, str], n: int, chances: dict[str, float], seed: int) -> None:
    """Add the cells at distance n, the larger of the distances in rows and columns.

    Each of them borders on one at distance n - 1, of which at least one is free and has a way to
    the treasure. So if all objects were taken away, all would have one.
    """
    shell = [(n, column) for column in range(n)] + [(row, n) for row in range(n + 1)]
    draws = _draws(seed, n)
    for cell in shell:
        drawn, cells[cell] = next(draws), "."
        for character, chance in chances.items():
            if drawn < chance:
                cells[cell] = character
                break
            drawn -= chance
    objects = sorted((next(draws), cell) for cell in shell if cells[cell] != ".")
    while not _joined(cells, shell, n):
        cells[objects.pop()[1]] = "."


def _joined(cells: dict[_Cell, str], shell: list[_Cell], n: int) -> bool:
    """Return whether cells of the shell are free, and all of them have a way to the treasure."""
    free = {cell for cell in shell if cells[cell] == "."}
    first = [
        cell
        for cell in free
        if any(max(near) < n and cells.get(near, "#") in ".T" for near in _beside(cell))
    ]
    joined = _distances(first, free)
    return bool(free) and joined.keys() == free


def _lines(cells: dict[_Cell, str], *, down: bool, right: bool) -> list[str]:
    """Return the map; it reaches from the treasure down or up, and to the right or to the left."""
    size = max(cells)[0] + 1
    lines = ["".join(cells[row, column] for column in range(size)) for row in range(size)]
    lines = lines if right else [line[::-1] for line in lines]
    return lines if down else lines[::-1]


def _farthest(cells: dict[_Cell, str]) -> _Cell:
    """Return the free cell whose way to the treasure is the longest."""
    free = {cell for cell, character in cells.items() if character == "."}
    distance = _distances([(0, 0)], free)
    return max(distance, key=lambda cell: (distance[cell], cell))


def _distances(first: list[_Cell], free: set[_Cell]) -> dict[_Cell, int]:
    """Return the steps from the first cells to each free one that has a way from there."""
    waiting, distance = deque(first), dict.fromkeys(first, 0)
    while waiting:
        cell = waiting.popleft()
        for near in _beside(cell):
            if near in free and near not in distance:
                distance[near] = distance[cell] + 1
                waiting.append(near)
    return distance


def _beside(cell: _Cell) -> Iterator[_Cell]:
    """Yield the cells that share an edge with one, off the map too."""
    row, column = cell
    yield from ((row - 1, column), (row, column + 1), (row + 1, column), (row, column - 1))


def _draws(seed: int, n: int) -> Iterator[float]:
    """Yield uniform numbers of the stream of the shell n."""
    for state in count(stream_start(seed, f"maze/{n}"), int(STRIDE)):
        yield float(uniform(splitmix64(state % 2**64)))


def _chances_sum(parameters: dict[str, Any]) -> str | None:
    """Return what is wrong where the chances of objects sum to more than 1."""
    total = sum(parameters[name] for name in ("walls", "pits", "fires"))
    return None if total <= 1 else "walls, pits and fires of a maze must sum to at most 1"


maze_family = TaskFamily("maze", random_maze, constraint=_chances_sum)
"""Random mazes (:func:`random_maze`); members map cell by cell, counted from the treasure."""
