"""Four rooms by the paper's drawing; keys, locks and pits by hand and by breadth-first search."""

from collections import deque

import numpy as np
import pytest

from curricle import project, solve
from curricle.tasks import FourRooms, KeyLockPit
from curricle.tasks.graph import reachable_states

# -- four rooms ------------------------------------------------------------------------------------

PLAN = """\
#############
#     #     #
#     #     #
#           #
#     #     #
#     #     #
## ####     #
#     ### ###
#     #     #
#     #     #
#           #
#     #     #
#############""".splitlines()
"""Of Sutton, Precup, Singh 1999, figure 2."""
WAYS = ((-1, 0), (0, 1), (1, 0), (0, -1))
CELLS = [(r, c) for r, line in enumerate(PLAN) for c, thing in enumerate(line) if thing == " "]


def beside(cell, way):
    """Return where a move goes in the drawing."""
    row, column = cell[0] + way[0], cell[1] + way[1]
    return (row, column) if PLAN[row][column] == " " else cell


def test_the_plan_is_the_paper_s():
    rooms = FourRooms()
    assert len(CELLS) == 104
    assert list(map(tuple, rooms.states.points.tolist())) == CELLS
    assert rooms.goal_cell == (7, 9)
    assert rooms.mdp.start_states.tolist() == [CELLS.index((1, 1))]


@pytest.mark.parametrize("slip", [1 / 3, 0.0, 0.75])
def test_moves_slip_as_in_the_drawing(slip):
    mdp = FourRooms(slip=slip).mdp
    for state, cell in enumerate(CELLS):
        for action in range(4):
            expected = np.zeros(104)
            for way, step in enumerate(WAYS):
                chance = 1 - slip if way == action else slip / 3
                expected[CELLS.index(beside(cell, step))] += chance
            row, reached = mdp.outcome_row[state, action], np.zeros(104)
            np.add.at(reached, mdp.next_state[row], mdp.probability[row])
            assert reached == pytest.approx(expected)
            assert mdp.reward[row].tolist() == [
                float(CELLS[after] == (7, 9) != cell and chance > 0)
                for after, chance in zip(mdp.next_state[row], mdp.probability[row], strict=True)
            ]


def test_values_are_those_of_a_planner_that_reads_the_drawing():
    goal = (7, 9)
    values = dict.fromkeys(CELLS, 0.0)
    for _ in range(400):  # 0.9^400 = 5e-19
        worth = {cell: 1.0 if cell == goal else 0.9 * v for cell, v in values.items()}
        for cell in CELLS:
            ways = [worth[beside(cell, way)] for way in WAYS]
            if cell != goal:
                values[cell] = max((2 / 3) * w + (sum(ways) - w) / 9 for w in ways)
    expected = [values[cell] for cell in CELLS]
    assert solve(FourRooms()).values == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("size", [7, 8, 9, 10, 11, 12, 13, 20, 31])
def test_every_size_has_four_rooms_and_four_hallways(size):
    rooms = FourRooms(size, slip=0.0)
    inside, half = size - 2, size // 2
    walls = inside + (half - 1) + (size - 2 - half)  # one south to north, two parts west to east
    assert rooms.states.size == inside**2 - walls + 4
    assert reachable_states(rooms.mdp).all()
    (north, _), (_, east), (south, _), (_, west) = rooms.hallways.values()
    assert 0 < north < half < half + 1 < south < size - 1
    assert 0 < west < half < east < size - 1
    free = set(map(tuple, rooms.states.points.tolist()))
    for name, (row, column) in rooms.hallways.items():
        across, along = [(0, -1), (0, 1)], [(-1, 0), (1, 0)]
        ways, sides = (across, along) if name in ("north", "south") else (along, across)
        assert all((row + down, column + right) in free for down, right in ways)
        assert not any((row + down, column + right) in free for down, right in sides)


def test_a_crop_moves_as_the_whole_does_and_stays_inside():
    rooms = FourRooms()
    part = rooms.crop(rows=(6, 12), columns=(6, 12))
    cells = list(map(tuple, part.states.points.tolist()))
    for cell in cells:
        for way, step in enumerate(WAYS):
            there = beside(cell, step)
            to = part.mdp.next_state[part.mdp.outcome_row[cells.index(cell)], way]
            assert [cells[state] for state in to] == [there if there in cells else cell] * 4
    assert part.mdp.start.max() == pytest.approx(1 / (part.states.size - 1))
    assert part.crop(rows=(7, 9), columns=(8, 11), start=[(8, 8)]).mdp.start.sum() == 1


# -- keys, locks and pits --------------------------------------------------------------------------

NORTH, EAST, SOUTH, WEST, PICK_UP, UNLOCK = range(6)


def follow(task, *actions):
    """Return the rewards of actions, and the state they lead to, in words."""
    mdp = task.mdp
    (state,), paid = mdp.start_states, []
    for action in actions:
        assert not mdp.terminal[state]
        row = mdp.outcome_row[state, action]
        assert mdp.probability[row].tolist() == [1.0]
        paid.append(float(mdp.reward[row, 0]))
        state = mdp.next_state[row, 0]
    return paid, task.states.label(state), bool(mdp.terminal[state])


def test_the_rewards_of_the_literature():
    task = KeyLockPit("SKL")
    paid, where, ended = follow(task, PICK_UP, EAST, UNLOCK, PICK_UP, PICK_UP, EAST, UNLOCK)
    assert paid == [-10, -10, -10, 500, -10, -10, 1000]
    assert where == "row=0 column=2 key=held lock=open"
    assert ended


def test_pits_walls_and_maps_without_locks_or_keys():
    assert follow(KeyLockPit("SPK"), EAST) == ([-200], "row=0 column=1 key=lying", True)
    paid, where, ended = follow(KeyLockPit(["S#", "K."]), NORTH, EAST, WEST)
    assert (paid, where, ended) == ([-10] * 3, "row=0 column=0 key=lying", False)
    assert follow(KeyLockPit("SK"), EAST, PICK_UP) == ([-10, 500], "row=0 column=1 key=held", True)
    assert follow(KeyLockPit("SL"), EAST, UNLOCK)[0] == [-10, 1000]
    held = KeyLockPit("SKL", keys_held=True)
    assert follow(held, EAST, PICK_UP, EAST, UNLOCK)[0] == [-10, -10, -10, 1000]


def test_a_lock_needs_its_keys():
    task = KeyLockPit("SKLKL")
    assert follow(task, EAST, PICK_UP, EAST, UNLOCK)[0] == [-10, 500, -10, -10]
    way = EAST, PICK_UP, EAST, EAST, PICK_UP, EAST, UNLOCK
    paid, where, _ = follow(task, *way)
    assert paid == [-10, 500, -10, -10, 500, -10, 1000]
    assert where == "row=0 column=4 key_1=held key_2=held lock_1=locked lock_2=open"


def search(lines):
    """Return by the papers' rules how many states can be met, the shortest way, the best return."""
    # Picking up and opening pay once each: the best return is that less 10 a move.
    cells = {(r, c): thing for r, line in enumerate(lines) for c, thing in enumerate(line)}
    keys = [cell for cell, thing in cells.items() if thing == "K"]
    locks = [cell for cell, thing in cells.items() if thing == "L"]
    (start,) = [cell for cell, thing in cells.items() if thing == "S"]
    first = (start, frozenset(), frozenset())
    steps, waiting, shortest = {first: 0}, deque([first]), None
    while waiting:
        here, held, opened = state = waiting.popleft()
        if len(opened) == len(locks):
            shortest = steps[state] if shortest is None else shortest
            continue
        if cells[here] == "P":
            continue
        after = []
        for down, right in WAYS:
            there = (here[0] + down, here[1] + right)
            after.append((there if cells.get(there, "#") != "#" else here, held, opened))
        if here in keys:
            after.append((here, held | {here}, opened))
        if here in locks and len(held) == len(keys):
            after.append((here, held, opened | {here}))
        for other in after:
            if other not in steps:
                steps[other] = steps[state] + 1
                waiting.append(other)
    useful = len(keys) + len(locks)
    best = (
        None if shortest is None else 500 * len(keys) + 1000 * len(locks) - 10 * (shortest - useful)
    )
    return len(steps), shortest, best


MAPS = {
    "room": KeyLockPit().map,
    "two keys": ("S.#K", ".P..", "KL.."),
    "two locks": ("SPL", "K..", "..L"),
    "behind a wall": ("S.K", "###", "..L"),
}


@pytest.mark.parametrize("name", MAPS)
def test_counts_and_optima_agree_with_a_search(name):
    task = KeyLockPit(MAPS[name], discount=0.999, time_limit=None)
    met, shortest, best = search(MAPS[name])
    assert reachable_states(task.mdp).sum() == met
    if name == "two keys":
        # Without both keys the lock is closed: 3 sets of keys in 11 cells; with both it is open
        # only at its own cell.
        assert task.states.size == 11 * (3 + 1) + 1
    if shortest is None:
        assert solve(task).values[task.mdp.start_states[0]] < 500
        return
    state, paid, policy = int(task.mdp.start_states[0]), [], solve(task).policy
    while not task.mdp.terminal[state]:
        row = task.mdp.outcome_row[state, int(policy[state].argmax())]
        paid.append(float(task.mdp.reward[row, 0]))
        state = int(task.mdp.next_state[row, 0])
    assert (len(paid), sum(paid)) == (shortest, best)


def test_a_crop_keeps_coordinates_and_the_keys_that_it_has():
    task = KeyLockPit(["SK.L", "..K.", "L..."])
    part = task.crop(rows=(0, 2), columns=(2, 4))
    assert part.map == (".L", "K.")
    assert part.origin == (0, 2)
    assert part.states.decode()["column"].min() == 2
    assert task.crop(rows=(0, 1), columns=(2, 4)).states.names == ("row", "column", "lock")
    assert KeyLockPit().crop(rows=(2, 8), columns=(5, 8)).states.names == ("row", "column", "lock")
    room = KeyLockPit()
    mapping = project(room, room.crop(rows=(0, 8), columns=(0, 6)))
    assert mapping.coverage().mapped > 0


def test_starts():
    task = KeyLockPit("S.KL")
    assert task.mdp.start_states.size == 1
    # 4 cells without the key, 4 with it.
    assert task.with_start("uniform").mdp.start_states.size == 8
    held = KeyLockPit("S.KL", start="uniform", keys_held=True)
    assert (held.states.decode(held.mdp.start_states)["key"] == 1).all()
    cells = task.with_start([(0, 1), (0, 2)]).mdp
    assert task.states.decode(cells.start_states)["column"].tolist() == [1, 2]
    assert np.unique(cells.start[cells.start_states]).tolist() == [0.5]
