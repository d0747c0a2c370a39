"""Tasks, and potentials that papers state: functions of the task that return phi."""

from functools import partial
from typing import Any

import numpy as np

import curricle as cr
from curricle.arrays import FloatArray
from curricle.tasks import Automaton, with_automaton

MOVES = {"up": (-1, 0), "right": (0, 1), "down": (1, 0), "left": (0, -1)}


# -- grids with slips ------------------------------------------------------------------------------


def grid(
    lines: list[str],
    *,
    start: tuple[int, int],
    slip: float,
    step: float,
    discount: float,
    goal_reward: float = 0.0,
    still: int = 0,
    time_limit: int | None = None,
    walls: Any = (),
) -> cr.FiniteMDP:
    """Return a grid in which an action is replaced by a random action with probability `slip`.

    ``#`` is a wall, ``T`` ends the episode, `walls` are pairs of a cell and a move that stays.
    `still` actions beside the four moves do nothing.
    """
    cells = [(r, c) for r, line in enumerate(lines) for c, sign in enumerate(line) if sign != "#"]
    number, moves = {cell: n for n, cell in enumerate(cells)}, [*MOVES, *["stay"] * still]
    terminal = np.array([lines[r][c] == "T" for r, c in cells])

    def after(cell: tuple[int, int], move: str) -> int:
        down, right = MOVES.get(move, (0, 0))
        wanted = cell[0] + down, cell[1] + right
        return number[cell] if (cell, move) in walls else number.get(wanted, number[cell])

    shape = len(cells), len(moves), len(cells)
    chance = np.zeros(shape)
    for cell in cells:
        for action, move in enumerate(moves):
            chance[number[cell], action, after(cell, move)] += 1 - slip
            for other in moves:
                chance[number[cell], action, after(cell, other)] += slip / len(moves)
    labels = (*MOVES, *(f"stay {n}" for n in range(still)))
    rows, columns = len(lines), max(map(len, lines))
    return cr.FiniteMDP.from_dense(
        chance,
        np.where(terminal, step + goal_reward, step)[None, None] + np.zeros(shape),
        terminal=terminal,
        start=number[start],
        discount=discount,
        time_limit=time_limit,
        states=cr.Space([cr.Component("row", rows), cr.Component("column", columns)], cells),
        actions=cr.Space([cr.Component("move", len(moves), labels=labels)]),
    )


# -- Ng, Harada, Russell 1999, section 5 -----------------------------------------------------------


def open_grid(size: int, *, slip: float = 0.2, discount: float = 0.999, **limit: Any) -> Any:
    """Return their grid: opposite corners, -1 a step, one action in five replaced by a random.

    They do not discount. Here .999 bounds the values, which some policy makes infinite otherwise.
    """
    lines = ["." * (size - 1) + "T"] + ["." * size] * (size - 1)
    return grid(lines, start=(size - 1, 0), slip=slip, step=-1.0, discount=discount, **limit)


def distance(task: cr.FiniteMDP) -> FloatArray:
    """Return their potential, minus the steps to the goal at .8 of a step towards it a step."""
    size = int(np.sqrt(task.states.size))
    row, column = np.divmod(np.arange(task.states.size), size)
    return -(row + size - 1 - column) / 0.8


def half_distance(task: cr.FiniteMDP) -> FloatArray:
    """Return half of their potential."""
    return distance(task) / 2


# -- Toro Icarte et al. 2022: the office -----------------------------------------------------------
#
# Nine rooms of 3 x 3 cells; coffee f, mail e, the office g, plants n that break. The task is the
# third of their four, mail and coffee to the office, which they also play alone. In the program all
# states that end are one, so that with mail and coffee a plant pays 1, as the office does: the
# shortest way is 23 steps, as in the published logs, and 29 as the text has it.

EVENTS = {"e": [(4, 7)], "f": [(6, 8), (2, 3)], "g": [(4, 4)]}
EVENTS["n"] = [(7, 4), (7, 7), (1, 4), (1, 7), (4, 1), (4, 10)]
"""Event -> its cells, rows from the north."""
EDGES = [
    ("neither", "e", "mail"),
    ("neither", "f", "coffee"),
    ("mail", "f", "both"),
    ("coffee", "e", "both"),
    ("both", "g", "home", 1.0),
    *((state, "n", "broken") for state in ("neither", "mail", "coffee")),
]


def office(*, as_run: bool = True) -> Any:
    """Return their office with the automaton of mail and coffee, as it was run or as described."""
    doors = {((r, c), "right") for r in (1, 7) for c in (2, 5, 8)}
    doors |= {((r, c + 1), "left") for (r, c), _ in [*doors]}
    upward = {((3, c), "up") for c in (1, 4, 7, 10)} | {((6, c), "up") for c in (1, 10)}
    doors |= upward | {((r - 1, c), "down") for (r, c), _ in upward}
    every = [(r, c) for r in range(9) for c in range(12)]
    walls = {((r, c), "left") for r, c in every if c % 3 == 0}
    walls |= {((r, c), "right") for r, c in every if c % 3 == 2}
    walls |= {((r, c), "up") for r, c in every if r % 3 == 0}
    walls |= {((r, c), "down") for r, c in every if r % 3 == 2}
    plan = grid(
        ["." * 12] * 9, start=(7, 2), slip=0.0, step=0.0, discount=0.9, time_limit=1000,
        walls=walls - doors,
    )  # fmt: skip

    def event(before: Any, action: Any, after: Any) -> Any:
        names = np.full((9, 12), "")
        for name, cells in EVENTS.items():
            names[tuple(np.transpose(cells))] = name
        return names[after["row"], after["column"]]

    broken = ("both", "n", "home", 1.0) if as_run else ("both", "n", "broken")
    return with_automaton(plan, Automaton([*EDGES, broken], event, terminal=["home", "broken"]))


def machine_values(task: Any) -> FloatArray:
    """Return their automatic potential: minus the value of the automaton's state, discount .9.

    The values of the four open states, in the order neither, mail, coffee, both, are those of the
    automaton alone with an edge a step.
    """
    of_state = dict.fromkeys(("home", "broken"), 0.0)
    for _ in range(4):
        for state in ("both", "mail", "coffee", "neither"):
            edges = [(*edge, 0.0)[:4] for edge in EDGES if edge[0] == state]
            of_state[state] = max(r + 0.9 * of_state.get(to, 0.0) for _, _, to, r in edges)
    order = task.automaton.states
    return -np.array([of_state[name] for name in order])[task.states.decode()["automaton"]]


# -- Cipollone et al. 2023: eight rooms ------------------------------------------------------------

ROOMS = """\
#########################
#gggg#bbbb######ooooo####
#gggggbbbb#pppppooooo####
#gggg#bbbb#pppp#ooooo####
#gggg#bbbb#pppp#ooooo####
###r#######pppp#o########
#rrrr#yyyy#pppp#BBBBB#GG#
#rrrrryyyy#ppppBBBBBBBGG#
#rrrr#yyyyypppp#BBBBB####
#rrrr#yyyy######BBBBB####
#########################""".splitlines()
LETTERS = "gbrypoBG"
DOORS = ["gb", "gr", "ry", "yp", "po", "oB", "pB", "BG"]


def plan(times: int) -> list[str]:
    """Return their plan with `times` cells in the place of one, on either side."""
    return ["".join(sign * times for sign in line) for line in ROOMS for _ in range(times)]


def rooms(*, times: int = 1) -> cr.FiniteMDP:
    """Return their eight rooms by cells: 1 for entering the last room, 70 steps at most.

    If the sides are `times` as long, there are as many times the steps.
    """
    lines = [line.replace("G", "T") for line in plan(times)]
    return grid(
        lines, start=(3 * times, 2 * times), slip=0.04, step=0.0, goal_reward=1.0, discount=0.98,
        still=2, time_limit=70 * times,
    )  # fmt: skip


def doors() -> cr.FiniteMDP:
    """Return their abstraction: a room is a state, an action goes to a room next to it."""
    n = len(LETTERS)
    chance = np.zeros((n, n, n))
    for room in range(n):
        for to in range(n):
            pair = {LETTERS[room] + LETTERS[to], LETTERS[to] + LETTERS[room]}
            chance[room, to, to if pair & {*DOORS} else room] += 0.9
            chance[room, to, room] += 0.1
    reward = np.zeros(chance.shape)
    reward[:, :, -1] = 1.0
    return cr.FiniteMDP.from_dense(
        chance, reward, terminal=np.arange(n) == n - 1, start=0, discount=0.9, time_limit=30,
        states=cr.Space([cr.Component("room", n, labels=tuple(LETTERS))]),
        actions=cr.Space([cr.Component("to", n, labels=tuple(LETTERS))]),
    )  # fmt: skip


def room_of(states: Any, actions: Any, times: int = 1) -> Any:
    """Map a cell to its room, and every action to the way towards the last room.

    Their potential is the value of the room, the largest of its actions.
    """
    best = cr.solve(doors()).policy.argmax(axis=1)
    number = np.array([[LETTERS.find(sign) for sign in line] for line in plan(times)])
    room = number[states["row"], states["column"]]
    return {"room": room}, {"to": best[room] + 0 * actions["move"]}


room_at_2, room_at_4 = partial(room_of, times=2), partial(room_of, times=4)
