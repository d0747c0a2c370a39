"""Pairs that came after the rules by which mappings are chosen, and that changed nothing of them.

Mazes with walls drawn at random and a cliff of 20 columns, -1 a step; each from the part at its
goal. The verification families had been seen when the last of the rules was made.
"""

import numpy as np

from benchmarks.pairs import Pair
from benchmarks.pairs.pair import Family
from benchmarks.pairs.worlds import by_cell, cropped, grid, redrawn

SIZE, WALLS = 10, 16
CLIFF = [*["." * 20] * 3, "S" + "C" * 18 + "G"]


def drawn(seed: int) -> list[str]:
    """Return a maze from the south-west to the north-east, with walls at random."""
    cells = np.random.default_rng(seed).choice(SIZE * SIZE, WALLS, replace=False)
    walls = {(int(k) // SIZE, int(k) % SIZE): "#" for k in cells}
    last = SIZE - 1
    free = dict.fromkeys([(last - 1, 0), (last, 1), (1, last), (0, last - 1)], ".")
    return redrawn(["." * SIZE] * SIZE, {**walls, **free, (last, 0): "S", (0, last): "G"})


def unseen() -> list[Pair]:
    """Return the pairs."""
    family = Family("unseen", "verification")
    for seed in (11, 12, 13):
        for slip in (0.0, 0.2):
            rules = {"rewards": {}, "step": -1.0, "slip": slip, "time_limit": 150}
            lines, name = drawn(seed), f"walls {seed}, slip {slip:g}"
            maze = family.target(name, grid(lines, **rules), 30_000)
            part = cropped(lines, (0, 5), (5, 10), **{**rules, "starts": "."})
            family.add("near", name, part, by_cell(maze, part), budget=2_000)
    rules = {"rewards": {"C": -19.0}, "step": -1.0, "time_limit": 200}
    cliff = family.target("cliff", grid(CLIFF, back_to_start="C", **rules), 30_000)
    end = cropped(CLIFF, (0, 4), (13, 20), ends="GC", starts=".", **rules)
    family.add("near", "cliff of 20", end, by_cell(cliff, end), budget=2_000)
    return list(family.pairs.values())
