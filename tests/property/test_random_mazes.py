"""Random mazes: always solvable, equal for equal seeds, and nested."""

from collections import deque

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from curricle.tasks import random_maze
from curricle.tasks.gridworld import CORNERS

MIXED = [(0.2, 0.05, 0.0), (0.3, 0.4, 0.3), (0.5, 0.2, 0.1)]
CHANCES = st.sampled_from([*MIXED, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])
SEEDS = st.integers(0, 2**63 - 1)


def made(size, chances, seed, **settings):
    walls, pits, fires = chances
    return random_maze(size, walls, pits, fires, seed, **settings)


def ways(lines):
    """Return the cells from which one can walk to the treasure past walls, pits and fires."""
    grid = np.array([list(line) for line in lines])
    first = tuple(np.argwhere(grid == "T")[0].tolist())
    seen, waiting = {first: 0}, deque([first])
    while waiting:
        row, column = cell = waiting.popleft()
        for other in ((row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)):
            inside = 0 <= other[0] < len(grid) and 0 <= other[1] < len(grid[0])
            if inside and other not in seen and grid[other] in ".S":
                seen[other] = seen[cell] + 1
                waiting.append(other)
    return grid, seen


@given(st.integers(2, 12), CHANCES, SEEDS, st.sampled_from(CORNERS))
@settings(max_examples=150, deadline=None)
def test_every_free_cell_has_a_way_to_the_treasure(size, chances, seed, corner):
    maze = made(size, chances, seed, corner=corner)
    grid, seen = ways(maze.map)
    free = {tuple(cell) for cell in np.argwhere((grid == ".") | (grid == "S")).tolist()}
    assert free <= seen.keys()
    assert (grid == "T").sum() == (grid == "S").sum() == 1
    start = tuple(np.argwhere(grid == "S")[0].tolist())
    assert seen[start] == max(seen.values())
    assert maze.state(0, 0) == int(np.flatnonzero(maze.mdp.terminal & maze.grid.holds("T"))[0])


@given(st.integers(2, 9), st.integers(0, 4), CHANCES, SEEDS, st.sampled_from(CORNERS))
@settings(max_examples=100, deadline=None)
def test_a_smaller_maze_is_the_part_of_a_larger_one_around_the_treasure(
    size, more, chances, seed, corner
):
    small = made(size, chances, seed, corner=corner, start="uniform")
    large = made(size + more, chances, seed, corner=corner, start="uniform")
    top, left = small.origin
    part = large.crop(rows=(top, top + size), columns=(left, left + size))
    assert part == small


def test_different_seeds_differ():
    maps = {random_maze(size=8, seed=seed).map for seed in range(50)}
    assert len(maps) == 50


def test_corners_are_mirror_images_of_each_other():
    north_east = random_maze(size=6, pits=0.1, seed=11).map
    mirrored = tuple(line[::-1] for line in north_east)
    assert random_maze(size=6, pits=0.1, seed=11, corner="north-west").map == mirrored
    assert random_maze(size=6, pits=0.1, seed=11, corner="south-east").map == north_east[::-1]
    assert random_maze(size=6, pits=0.1, seed=11, corner="south-west").map == mirrored[::-1]


def test_densities_are_those_asked_for_where_few_objects_block():
    counts = {"#": 0, "P": 0, "F": 0}
    cells = 0
    for seed in range(60):
        grid = "".join(random_maze(20, 0.08, 0.04, 0.02, seed).map)
        cells += len(grid)
        counts = {other: n + grid.count(other) for other, n in counts.items()}
    for other, chance in zip("#PF", (0.08, 0.04, 0.02), strict=True):
        assert counts[other] / cells == pytest.approx(chance, rel=0.15)
