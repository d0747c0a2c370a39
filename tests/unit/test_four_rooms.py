"""Four rooms: the paper's plan, distances by hand, and values by another planner."""

import numpy as np
import pytest

from curricle import solve
from curricle.errors import TaskError
from curricle.tasks import FourRooms
from curricle.tasks.mdp import reachable_states
from tests.refusals import check_refusal

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
CELLS = [(r, c) for r, line in enumerate(PLAN) for c, what in enumerate(line) if what == " "]


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
            row, found = mdp.outcome_row[state, action], np.zeros(104)
            np.add.at(found, mdp.next_state[row], mdp.probability[row])
            assert found == pytest.approx(expected)
            assert mdp.reward[row].tolist() == [
                float(CELLS[after] == (7, 9)) for after in mdp.next_state[row]
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
            assert [cells[one] for one in to] == [there if there in cells else cell] * 4
    assert part.mdp.start.max() == pytest.approx(1 / (part.states.size - 1))
    assert part.crop(rows=(7, 9), columns=(8, 11), start=[(8, 8)]).mdp.start.sum() == 1


REFUSED = [
    (lambda: FourRooms(goal="up"), "one of the hallways 'north', .*got 'up'"),
    (lambda: FourRooms(goal=(0, 3)), r"goal needs a free .*got \(0, 3\)"),
    (
        lambda: FourRooms(goal=(1, 2, 3)),
        "goal must be one of the hallways .*, or a row and a column",
    ),
    (lambda: FourRooms(start=[(1, 1), (6, 6)]), r"free cell that does not end it: got \(6, 6\)"),
    (lambda: FourRooms(start="map"), "'corner', 'uniform' or cells such as .*: got 'map'"),
    (lambda: FourRooms(rows=(0, 1)), "a crop needs a free cell: rows 0..1"),
    (lambda: FourRooms(rows=(3, 9)).crop(rows=(2, 8), columns=(0, 13)), r"rows 3..9: got 2..8"),
    (lambda: FourRooms(columns=(3,)), "a first and an end"),
    (lambda: FourRooms(rows=(7, 8), columns=(9, 10)), "needs a state that does not end"),
]


@pytest.mark.parametrize(("call", "says"), REFUSED)
def test_what_makes_no_rooms_is_refused(call, says):
    check_refusal(TaskError, call, says)
