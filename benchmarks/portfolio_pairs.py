"""Families written before the portfolio's present rule was made, to judge it; not changed since.

In labyrinths with pits an episode sees little, so that optimism needs many before its first reward.
Beside a near prize the source is ahead at first, and overtaken late. Reservoirs never end. A game
of dice has returns of large variance. A burglar and a guard have more pairs than can all be tried.
"""

from typing import Any

import numpy as np

import curricle as cr
from benchmarks.pairs.pair import Family
from benchmarks.pairs.worlds import at_first, by_cell, by_value, cropped, grid, redrawn, task_of

SIZE = 12


def labyrinth(seed: int) -> list[str]:
    """Return walls and pits at random between the north-west and the south-east."""
    rng, last = np.random.default_rng(seed), SIZE - 1
    cells = [divmod(int(k), SIZE) for k in rng.choice(SIZE * SIZE, 34, replace=False)]
    marks = {cell: "#" if k < 22 else "O" for k, cell in enumerate(cells)}
    way = [*((k, 0) for k in range(SIZE)), *((last, k) for k in range(SIZE))]  # is always free
    return redrawn(
        ["." * SIZE] * SIZE, {**marks, **dict.fromkeys(way, "."), (0, 0): "S", (last, last): "G"}
    )


def labyrinths() -> Family:
    """Return two labyrinths, 40,000 steps each, of episodes of 50 steps at most."""
    family = Family("labyrinths", "verification")
    rules: dict[str, Any] = {"rewards": {"G": 1.0}, "ends": "GO", "time_limit": 50}
    for seed, slip in ((31, 0.1), (32, 0.3)):
        lines = labyrinth(seed)
        family.target(f"{seed}", grid(lines, slip=slip, **rules), 40_000)
        part = cropped(lines, (6, SIZE), (6, SIZE), slip=slip, starts=".", **rules)
        dry = grid([line.replace("O", ".") for line in lines], slip=slip, starts="S.", **rules)
        sure = grid(lines, slip=0.0, starts="S.", **rules)
        family.add("near", f"{seed}, the goal's quarter", part, budget=4_000)
        family.add("far", f"{seed}, without pits", dry, budget=4_000)
        family.add("near", f"{seed}, without slips", sure, budget=4_000)
    return family


ROOM = [
    "..........",
    "..........",
    "..N.......",
    "..S....#..",
    ".......#..",
    "....####..",
    "..........",
    "........#F",
]


def prizes() -> Family:
    """Return a room with a near prize of .3 and a far prize of 1, 40,000 and 20,000 steps."""
    family = Family("prizes", "verification")

    def room(far: float = 1.0, slip: float = 0.1, starts: str = "S.") -> cr.FiniteMDP:
        rewards = {"N": 0.3, "F": far}
        return grid(ROOM, rewards=rewards, ends="NF", slip=slip, starts=starts, discount=0.97)

    near, sure, half = room(far=0.0), room(far=0.0, slip=0.0), room(far=0.5)
    rules: dict[str, Any] = {"rewards": {"N": 0.3}, "ends": "N", "starts": "S.", "slip": 0.1}
    part = cropped(ROOM, (0, 5), (0, 6), discount=0.97, **rules)
    clipped = by_cell(lambda row, column: (np.minimum(row, 4), np.minimum(column, 5)))
    for name, slip, budget in (("slips", 0.1, 40_000), ("many slips", 0.25, 20_000)):
        family.target(name, room(slip=slip, starts="S"), budget)
        family.add("near", f"{name}, near prize alone", near, budget=2_000)
        family.add("far", f"{name}, near prize alone, sure", sure, budget=2_000)
        family.add("near", f"{name}, far prize of half", half, budget=2_000)
        family.add("far", f"{name}, the near part", part, clipped, budget=2_000)
    return family


INFLOW = {"wet": (0.1, 0.2, 0.4, 0.3), "dry": (0.5, 0.3, 0.2, 0.0), "mean": (0.3, 0.25, 0.3, 0.15)}


def reservoir(
    room: int, seasons: tuple[str, ...] = ("wet", "dry"), *, flood: float = 5.0, power: float = 1.0
) -> cr.FiniteMDP:
    """Return a reservoir that never ends: release 0 to 4; floods and an empty lake cost."""

    def outcomes(point: Any, action: int) -> Any:
        level, season = point
        released = min(action, level)
        earned = power * released**0.7 - (2.0 if level == 0 else 0.0)
        found: list[Any] = []
        for k, turn in ((season, 0.9), (1 - season, 0.1)) if len(seasons) == 2 else ((0, 1.0),):
            for rain, p in enumerate(INFLOW[seasons[season]]):
                full = level - released + rain
                if p:
                    paid = earned - flood * max(full - room, 0)
                    found.append((p * turn, (min(full, room), k), paid))
        return found

    return task_of(
        [(level, k) for level in range(room + 1) for k in range(len(seasons))],
        ("level", "season"), cr.Component("release", 5), outcomes,
        starts=lambda point: point[0] == room // 2, discount=0.95, time_limit=400,
    )  # fmt: skip


def reservoirs() -> Family:
    """Return a reservoir of 20 units (20,000 steps) and one of 10 with dear floods (10,000)."""
    family = Family("reservoirs", "verification")
    for room, flood, budget in ((20, 5.0, 20_000), (10, 20.0, 10_000)):
        family.target(f"{room} units", reservoir(room, flood=flood), budget)
        half, cheap = reservoir(room // 2, flood=flood), reservoir(room, flood=flood, power=0.3)
        even = reservoir(room, ("mean",), flood=flood)

        def halved(state: Any, action: Any) -> Any:
            return {**state, "level": state["level"] // 2}, action

        def lower(state: Any, action: Any, most: int = room // 2) -> Any:
            return {**state, "level": np.minimum(state["level"], most)}, action

        family.add("near", f"{room}, half the room", half, halved, budget=1_500)
        family.add("near", f"{room}, cheap power", cheap, budget=1_500)
        family.add("far", f"{room}, one season", even, at_first("season"), budget=1_500)
        family.add("far", f"{room}, the lower half", half, lower, budget=1_500)
    return family


def dice(goal: int, faces: int = 6, lost: int = 1, fee: float = 0.0) -> cr.FiniteMDP:
    """Return the game of Pig alone: roll for more, or bank what is rolled; -1 for each turn.

    Of the faces the lowest `lost` lose what was rolled in the turn; `fee` is the price of a roll.
    """

    def outcomes(point: Any, action: int) -> Any:
        banked, rolled = point
        if action == 0:
            return [(1.0, (banked + rolled, 0), -1.0)]
        found = [(lost / faces, (banked, 0), -1.0 - fee)] if lost else []
        reached = [min(rolled + face, goal - banked) for face in range(lost + 1, faces + 1)]
        return found + [(1 / faces, (banked, points), -fee) for points in reached]

    return task_of(
        [(b, r) for b in range(goal + 1) for r in range(goal + 1 - b)],
        ("banked", "rolled"), cr.Component("choice", 2, labels=("bank", "roll")), outcomes,
        ends=lambda point: point[0] == goal, starts=lambda point: point == (0, 0),
        discount=0.98, time_limit=150,
    )  # fmt: skip


def games() -> Family:
    """Return Pig to 24 points (40,000 steps), and to 16 with a fee for each roll (20,000)."""
    family = Family("dice", "verification")
    for goal, fee, budget in ((24, 0.0, 40_000), (16, 0.2, 20_000)):
        family.target(f"to {goal}", dice(goal, fee=fee), budget)
        half, safe = dice(goal // 2, fee=fee), dice(goal, lost=0, fee=fee)
        small, risky = dice(goal, faces=4, fee=fee), dice(goal, lost=2, fee=fee)
        halved = by_value(lambda points: points // 2)
        family.add("near", f"{goal}, two for one", half, halved, budget=2_000)
        family.add("far", f"{goal}, nothing is lost", safe, budget=4_000)
        family.add("near", f"{goal}, four faces", small, budget=4_000)
        family.add("near", f"{goal}, two faces lose", risky, budget=4_000)
    return family


HOUSE = 6
STEPS = ((-1, 0), (0, 1), (1, 0), (0, -1), (0, 0))


def burglary(
    *, awake: float = 0.8, guards: bool = True, caught: float = -1.0, loaded: bool = False
) -> cr.FiniteMDP:
    """Return a burglar who takes +1 of loot home, chased by a guard who walks at random.

    The guard moves with probability `awake`; a burglar who meets her is `caught`. Sources may begin
    with the loot (`loaded`), or be without a guard.
    """
    last = HOUSE - 1
    rooms = [(i, j) for i in range(HOUSE) for j in range(HOUSE)]

    def entered(cell: Any, step: Any) -> Any:
        after = cell[0] + step[0], cell[1] + step[1]
        return after if after in rooms else cell

    def outcomes(point: Any, action: int) -> Any:
        cell, loot, guard = entered(point[:2], STEPS[action]), point[2], point[3:]
        loot = max(loot, int(cell == (last, last)))
        if cell == (0, 0) and loot:
            return [(1.0, (*cell, 2, *guard), 1.0)]
        if not guards:
            return [(1.0, (*cell, loot), 0.0)]
        found = []
        for p, step in [(1 - awake, (0, 0)), *((awake / 4, step) for step in STEPS[:4])]:
            there = entered(guard, step)
            met = there == cell or (there == point[:2] and cell == guard)
            found.append((p, (*cell, 2 if met else loot, *there), caught if met else 0.0))
        return [outcome for outcome in found if outcome[0] > 0]

    points = [(*cell, loot) for cell in rooms for loot in (0, 1, 2)]
    if guards:
        points = [(*point, *cell) for point in points for cell in rooms]
    middle = (HOUSE // 2, HOUSE // 2)
    first = (last, last, 1) if loaded else (0, 0, 0)
    return task_of(
        points, ("row", "column", "loot", "guard row", "guard column")[: len(points[0])],
        cr.Component("move", 5), outcomes,
        ends=lambda point: point[2] == 2,
        starts=lambda point: point[:3] == first and point[3:] in ((), middle),
        discount=0.97, time_limit=100,
    )  # fmt: skip


def burglars() -> Family:
    """Return a burglar and a guard, awake or sleepy, 60,000 steps each."""
    family = Family("burglars", "verification")
    alone, calm = burglary(guards=False), burglary(awake=0.2)
    back, mild = burglary(loaded=True), burglary(caught=0.0)

    def without(state: Any, action: Any) -> Any:
        return {part: state[part] for part in ("row", "column", "loot")}, action

    for name, awake in (("awake", 0.9), ("sleepy", 0.5)):
        family.target(name, burglary(awake=awake), 60_000)
        family.add("near", f"{name}, without a guard", alone, without, budget=3_000)
        family.add("near", f"{name}, a calm guard", calm, budget=6_000)
        family.add("far", f"{name}, the way back", back, budget=6_000)
        family.add("far", f"{name}, a mild guard", mild, budget=6_000)
    return family


UNSEEN = (labyrinths, prizes, reservoirs, games, burglars)
