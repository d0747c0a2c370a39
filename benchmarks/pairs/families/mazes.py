"""Development: mazes with random pits and fires, as in the paper; large rewards of both signs."""

import numpy as np

import curricle as cr

from ..pair import Family
from ..worlds import by_cell, redrawn

SIZE = 9
REWARDS = cr.Rewards(step=-1.0, treasure=200.0, fire=-30.0, near_fire=-10.0, pit=-100.0)


def drawn(seed: int) -> list[str]:
    """Return a maze: start at the south-west, treasure in the north-east, nothing beside either."""
    rng = np.random.default_rng(seed)
    cells = [(i, j) for i in range(SIZE) for j in range(SIZE)]
    far = [(i, j) for i, j in cells if i + j > 1 or i > 1]
    free = [(i, j) for i, j in far if abs(i - 8) + j > 2 and abs(j - 7) + abs(i - 1) > 1]
    chosen = rng.choice(len(free), 16, replace=False)
    objects = {free[k]: "P" if n < 9 else "F" for n, k in enumerate(chosen)}
    return redrawn(["." * SIZE] * SIZE, {**objects, (SIZE - 1, 0): "S", (1, 7): "T"})


def mazes() -> Family:
    """Return the family; two mazes, 30,000 steps each."""
    family = Family("mazes", "development")
    for seed in (1, 2):
        lines = drawn(seed)
        maze = cr.GridWorld(lines, rewards=REWARDS)
        family.target(f"maze {seed}", maze, 30_000)
        corner = maze.crop(rows=(0, 5), columns=(4, 9))
        treasure = maze.crop(rows=(0, 3), columns=(6, 9))
        lost = redrawn(lines, {(1, 7): ".", (7, 7): "T"})
        elsewhere = cr.GridWorld(lost, rewards=REWARDS, start="uniform")
        in_corner, at_treasure, same = (
            cr.same_position(maze, source) for source in (corner, treasure, elsewhere)
        )
        family.add("near", f"{seed}, corner", corner, in_corner, budget=4_000)
        family.add("far", f"{seed}, treasure", treasure, at_treasure, budget=1_500)
        family.add("wrong goal", f"{seed}, elsewhere", elsewhere, same, budget=6_000)
        family.spoil(f"{seed}, corner")
        if seed == 1:
            safe = cr.GridWorld(
                [line.replace("P", ".").replace("F", ".") for line in lines], rewards=REWARDS
            )
            same = cr.same_position(maze, safe)
            other = cr.GridWorld(drawn(7), rewards=REWARDS, start="uniform")
            across = by_cell(lambda row, column: (column, row))
            family.add("near", "1, no dangers", safe, same, budget=6_000)
            family.add(
                "mirrored", "1, corner mirrored", corner, in_corner, budget=4_000, turned=True
            )
            family.add("useless", "1, another maze turned", other, across, budget=6_000)
    return family
