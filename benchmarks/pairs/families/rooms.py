"""Verification: four rooms with slips at -1 a step, and FrozenLake 8x8 on slippery ice."""

from typing import Any

from gymnasium.envs.toy_text.frozen_lake import MAPS

from ..pair import Family
from ..worlds import by_cell, cropped, grid, redrawn

ROOMS = [
    ".....#.....",
    ".....#.....",
    "...........",
    ".....#.....",
    ".....#.....",
    "#.####.....",
    ".....###.##",
    ".....#.....",
    ".....#.....",
    "...........",
    "S....#....G",
]
LAKE = MAPS["8x8"]


def four_rooms() -> Family:
    """Return four rooms of 11x11 cells, 60,000 steps, from two starts."""
    family = Family("four-rooms", "verification")
    rules: dict[str, Any] = {"rewards": {}, "step": -1.0, "slip": 0.2, "time_limit": 300}
    anywhere = {**rules, "starts": ".S"}
    family.target("rooms", grid(ROOMS, **rules), 60_000)
    room = cropped(ROOMS, (6, 11), (6, 11), **anywhere)
    half = cropped(ROOMS, (0, 11), (5, 11), **anywhere)
    dry = grid(ROOMS, **{**anywhere, "slip": 0.0})
    away = grid(redrawn(ROOMS, {(10, 10): ".", (0, 0): "G"}), **anywhere)
    start = grid(redrawn(ROOMS, {(10, 10): ".", (8, 2): "G"}), **anywhere)
    family.add("near", "the goal's room", room, budget=6_000)
    family.add("near", "the goal's half", half, budget=15_000)
    family.add("far", "no slips", dry, budget=30_000)
    family.add("wrong goal", "the other corner", away, budget=15_000)
    family.add("wrong goal", "beside the start", start, budget=15_000)
    family.add("mirrored", "the goal's half, moves reversed", half, budget=15_000, turned=True)
    folded = by_cell(lambda row, column: (6 + row % 5, 6 + column % 5))
    family.add("useless", "one room for each", room, folded, budget=6_000)
    family.spoil("the goal's half")
    other = redrawn(ROOMS, {(10, 0): ".", (0, 0): "S"})
    family.target("rooms from the north", grid(other, **rules), 60_000)
    family.add("near", "from the north, the goal's half", half, budget=15_000)
    return family


def ice(lines: list[str], slip: float, origin: tuple[int, int] = (0, 0), **rules: Any) -> Any:
    """Return a lake whose holes end the episode; `slip` as in FrozenLake is 2/3."""
    settings = {"rewards": {"G": 1.0}, "ends": "GH", "starts": "SF", "time_limit": 200, **rules}
    return grid(lines, slip=slip, origin=origin, **settings)


def lakes() -> Family:
    """Return FrozenLake 8x8 on slippery ice, 100,000 steps; with fewer slips, 30,000."""
    family = Family("frozen-lake", "verification")
    family.target("8x8", ice(LAKE, 2 / 3, starts="S"), 100_000)
    crop = [line[3:] for line in LAKE[3:]]
    small, dry = ice(crop, 2 / 3, (3, 3)), ice(LAKE, 0.0, starts="S")
    corner = ice([line[5:] for line in LAKE[5:]], 2 / 3, (5, 5))
    away = ice(redrawn(LAKE, {(7, 7): "F", (7, 0): "G"}), 2 / 3)
    other = ice(MAPS["4x4"], 2 / 3)
    family.add("near", "a 5x5 crop", small, budget=15_000)
    family.add("near", "a dry lake", dry, budget=15_000)
    family.add("far", "a 3x3 crop", corner, budget=4_000)
    halved = by_cell(lambda row, column: (row // 2, column // 2))
    folded = by_cell(lambda row, column: (row % 4, column % 4))
    family.add("far", "the 4x4 lake, one for four", other, halved, budget=15_000)
    family.add("wrong goal", "another corner", away, budget=15_000)
    family.add("mirrored", "a 5x5 crop, moves reversed", small, budget=15_000, turned=True)
    family.add("useless", "the 4x4 lake four times", other, folded, budget=15_000)
    family.spoil("a 5x5 crop")
    family.target("8x8, fewer slips", ice(LAKE, 0.2, starts="S"), 30_000)
    family.add("near", "fewer slips, a dry crop", ice(crop, 0.0, (3, 3)), budget=5_000)
    return family
