"""Block Dude: the rules on small maps, and BURLAP's levels against its rules written out anew."""

from collections import deque

import numpy as np
import pytest

from curricle import solve
from curricle.errors import TaskError
from curricle.tasks import BlockDude
from tests.refusals import check_refusal

WEST, EAST, UP, PICK_UP, PUT_DOWN = range(5)


def follow(task, *actions):
    """Return the states that actions lead to, as row, column, facing, holding and blocks."""
    mdp, state, found = task.mdp, 0, []
    for action in actions:
        assert not mdp.terminal[state]
        state = mdp.next_state[mdp.outcome_row[state, action], 0]
        found.append(task.states.label(state).replace("=", " "))
    return found


def where(task, *actions):
    """Return the row and column of the agent after actions."""
    state = 0
    for action in actions:
        state = task.mdp.next_state[task.mdp.outcome_row[state, action], 0]
    return tuple(task.layout.cells[state].tolist())


# -- the rules, on maps to check by hand ----------------------------------------------------------


def test_moves_turn_first_and_bricks_and_blocks_stop_them():
    task = BlockDude("E.#>B")
    assert follow(task, EAST, WEST) == [
        "row 0 column 3 facing east holding no block (0,4)",
        "row 0 column 3 facing west holding no block (0,4)",
    ]
    assert where(BlockDude(">E"), WEST) == (0, 0)


def test_the_agent_falls_and_climbs_one_but_not_two():
    task = BlockDude(["<....", "##...", "##.#E"])
    assert where(task, EAST) == (0, 1)
    assert where(task, EAST, EAST) == (2, 2)
    assert where(task, EAST, EAST, UP) == (1, 3)
    assert where(task, EAST, EAST, WEST, UP) == (2, 2)
    assert where(task, EAST, EAST, EAST) == (2, 2)


def test_up_needs_room_above_the_step_and_more_with_a_block():
    assert where(BlockDude(["..#.", ".>..", ".##E"][1:]), UP) == (0, 1)
    low = BlockDude([".#..", "....", ">#.E"])
    assert where(low, UP) == (1, 1)
    carrying = BlockDude(["..#..", ".....", "B>#.E"])
    assert where(carrying, UP) == (1, 2)
    assert where(carrying, WEST, PICK_UP, EAST, UP) == (2, 1)


def test_only_a_free_block_at_the_agent_s_height_is_picked_up():
    assert follow(BlockDude(["B...", "B<.E"]), PICK_UP) == [
        "row 1 column 1 facing west holding no block_1 (1,0) block_2 (0,0)"
    ]
    picked = follow(BlockDude(["B<..", "B#.E"]), PICK_UP, PICK_UP, EAST)
    assert picked == [
        "row 0 column 1 facing west holding yes block_1 carried block_2 (1,0)",
        "row 0 column 1 facing west holding yes block_1 carried block_2 (1,0)",
        "row 1 column 2 facing east holding yes block_1 carried block_2 (1,0)",
    ]
    assert follow(BlockDude(["#...", "B<.E"]), PICK_UP)[0].endswith("holding no block (1,0)")


def test_a_block_put_down_falls_and_is_stacked_one_high():
    deep = BlockDude(["...B<", "...##", "E..##"])
    assert follow(deep, PICK_UP, WEST, WEST)[-1].endswith("holding yes block carried")
    assert follow(deep, PICK_UP, WEST, PUT_DOWN)[-1] == (
        "row 0 column 3 facing west holding no block (2,2)"
    )
    stacked = BlockDude(["......", "B<B..E"])
    assert follow(stacked, PICK_UP, EAST, PUT_DOWN)[-1] == (
        "row 1 column 1 facing east holding no block_1 (1,2) block_2 (0,2)"
    )
    walled = BlockDude(["..#..", "B<#.E"])
    assert follow(walled, PICK_UP, EAST, PUT_DOWN)[-1].endswith("holding yes block carried")


def test_a_carried_block_needs_no_room_under_a_ceiling():
    task = BlockDude(["..#..", "B>..E"])
    assert where(task, WEST, PICK_UP, EAST, EAST, EAST) == (1, 4)


def test_nothing_happens_beside_the_map():
    task = BlockDude(".B>E").with_start("map")
    edge = BlockDude("B<E")
    carried = follow(edge, PICK_UP, WEST, PUT_DOWN, UP, PICK_UP)
    assert carried[1:] == ["row 0 column 0 facing west holding yes block carried"] * 4
    assert where(task, EAST) == (0, 3)


def test_there_is_room_above_the_map():
    task = BlockDude(["B<B..E"])
    assert where(task, PICK_UP, EAST, UP) == (-1, 2)
    assert task.layout.origin == (-2, 0)  # a block carried on top of another
    assert task.layout.shape == (3, 6)


def test_rewards():
    task = BlockDude(">.E", step_reward=-2, exit_reward=7, discount=0.5)
    assert solve(task).values[0] == pytest.approx(-2 + 7 / 2)
    # From the exit and beside it, seen from both sides.
    assert task.with_start("uniform").mdp.start_states.size == task.states.size - 1


# -- BURLAP's levels -------------------------------------------------------------------------------


def floor_segment(grid, first, last, y):
    for x in range(first, last + 1):
        grid[x][y] = 1


def wall_segment(grid, first, last, x):
    for y in range(first, last + 1):
        grid[x][y] = 1


def burlap_level(number):
    """Return bricks [x][y], the agent (x, y, dir), the exit and the blocks of a level of BURLAP."""
    grid = [[0] * 25 for _ in range(25)]
    if number == 1:
        floor_segment(grid, 0, 24, 0)
        for x, y in ((3, 1), (3, 2), (7, 1), (11, 1), (11, 2)):
            grid[x][y] = 1
        return grid, (15, 1, 1), (0, 1), [(9, 1), (13, 1)]
    if number == 2:
        walls = ((2, 5, 0), (0, 2, 4), (0, 2, 8), (2, 4, 12))
        floors = ((0, 4, 2), (4, 8, 0), (8, 24, 2))
        agent, way_out, blocks = (17, 3, 0), (0, 6), [(7, 1), (13, 3), (15, 3), (15, 4), (16, 3)]
    else:
        walls = ((0, 4, 1), (0, 4, 3), (0, 3, 8), (1, 3, 11), (5, 8, 17))
        floors = ((0, 1, 0), (1, 3, 4), (3, 8, 1), (8, 10, 0), (11, 15, 3))
        for x, y in ((7, 2), (10, 1), (12, 4), (15, 4), (16, 4)):
            grid[x][y] = 1
        agent, way_out = (8, 4, 0), (0, 1)
        blocks = [(4, 2), (5, 2), (13, 4), (15, 5), (16, 5), (16, 6)]
    for wall in walls:
        wall_segment(grid, *wall)
    for floor in floors:
        floor_segment(grid, *floor)
    return grid, agent, way_out, blocks


class Burlap:
    """BURLAP's model: blocks are cells, a carried one is the cell above the agent."""

    def __init__(self, grid):
        self.grid = grid

    def height(self, blocks, x, most):
        """Return BURLAP's greatestHeightBelow."""
        found = max((y for y in range(most + 1) if self.grid[x][y]), default=0)
        return max([found, *(y for bx, y in blocks if bx == x and y <= most)])

    def act(self, state, action):
        (x, y, way, holding), blocks = state
        blocks = set(blocks)
        if action in (WEST, EAST):
            way = int(action == EAST)
            to = x + (1 if way else -1)
            if 0 <= to < 25 and (height := self.height(blocks, to, y)) < y:
                self.carry(blocks, holding, (x, y), (to, height + 1))
                x, y = to, height + 1
            return (x, y, way, holding), frozenset(blocks)
        front = x + (1 if way else -1)
        if not 0 <= front < 25:
            return state
        if action == UP and self.height(blocks, front, y + 1 + holding) == y:
            self.carry(blocks, holding, (x, y), (front, y + 1))
            x, y = front, y + 1
        elif action == PICK_UP and not holding and (front, y) in blocks:
            if (front, y + 1) not in blocks and not self.grid[front][y + 1]:
                blocks.remove((front, y))
                blocks.add((x, y + 1))
                holding = True
        elif action == PUT_DOWN and holding:
            height = self.height(blocks, front, y + 1)
            if height <= y:
                blocks.remove((x, y + 1))
                blocks.add((front, height + 1))
                holding = False
        return (x, y, way, holding), frozenset(blocks)

    def carry(self, blocks, holding, before, after):
        if holding:
            blocks.remove((before[0], before[1] + 1))
            blocks.add((after[0], after[1] + 1))


def search(number):
    """Return how many states BURLAP's rules reach, how many are at the exit, the shortest way."""
    grid, agent, way_out, blocks = burlap_level(number)
    model, first = Burlap(grid), ((*agent, False), frozenset(blocks))
    steps, waiting, ends = {first: 0}, deque([first]), []
    while waiting:
        state = waiting.popleft()
        if state[0][:2] == way_out:
            ends.append(steps[state])
            continue
        for action in range(5):
            after = model.act(state, action)
            if after not in steps:
                steps[after] = steps[state] + 1
                waiting.append(after)
    return len(steps), len(ends), min(ends)


@pytest.mark.parametrize(
    ("number", "reached", "moves"),
    [
        (1, 788, 19),
        pytest.param(2, 172_100, 73, marks=pytest.mark.slow),
        (3, 14_199, 94),
    ],
)
def test_levels_agree_with_a_search_by_burlap_s_rules(number, reached, moves):
    task = BlockDude(number)
    count, ends, shortest = search(number)
    assert task.states.size == count == reached
    assert task.mdp.terminal.sum() == ends
    assert shortest == moves
    # -1 a step: V = -(1 - 0.99^n) / (1 - 0.99).
    expected = -(1 - 0.99**moves) / 0.01
    assert solve(task).values[0] == pytest.approx(expected, rel=1e-7)


def test_the_first_level_solved_by_hand():
    onto_the_wall = [WEST, PICK_UP, WEST, PUT_DOWN, UP, UP]
    to_the_second_block = [WEST, PICK_UP, WEST, WEST, UP]
    over_the_wall = [WEST, WEST, PUT_DOWN, UP, UP, WEST, WEST, WEST]
    plan = [*onto_the_wall, *to_the_second_block, *over_the_wall]
    task = BlockDude(1)
    assert len(plan) == 19
    assert where(task, *onto_the_wall) == (1, 11)
    assert where(task, *onto_the_wall, *to_the_second_block) == (2, 7)
    assert where(task, *plan) == (3, 0)


def test_random_play_is_burlap_s():
    rng = np.random.default_rng(0)
    for number in (1, 3):
        task, (grid, agent, way_out, blocks) = BlockDude(number), burlap_level(number)
        model, here, state = Burlap(grid), ((*agent, False), frozenset(blocks)), 0
        for action in rng.integers(5, size=3_000).tolist():
            here = model.act(here, action)
            state = int(task.mdp.next_state[task.mdp.outcome_row[state, action], 0])
            (x, y, way, holding), cells = here
            found = task.states.decode(state)
            rows = len(task.level)
            assert [int(v) for v in list(found.values())[:4]] == [rows - y, x, way, holding]
            drawn = {tuple(where[state]) for where in task.layout.markers.values()}
            assert drawn == {(rows - by, bx) for bx, by in cells}
            if (x, y) == way_out:
                break


# -- variants, pictures, mistakes -----------------------------------------------------------------


def test_a_crop_is_the_part_with_its_coordinates():
    part = BlockDude(1).crop(columns=(0, 12), agent=10)
    assert part.level == ("............", "............", "...#.......#", "E..#...#.B>#")
    half = solve(part)
    assert part.states.component("column").size == 12
    # The second half of the plan by hand: turn to the block, then as there.
    assert half.values[0] == pytest.approx(-(1 - 0.99**13) / 0.01)
    right = BlockDude([">.E.", "#..."]).crop(columns=(1, 4), agent=3)
    assert right.origin == (0, 1)
    assert right.level == (".E.", "..>")
    kept = BlockDude("..<.E").crop(columns=(2, 5))
    assert kept.level == ("<.E",)


REFUSED = [
    (lambda: BlockDude(4), "level must be one of 1, 2, 3: got 4"),
    (lambda: BlockDude(True), "got True"),
    (lambda: BlockDude("E<>"), "one agent < or >: there are 2"),
    (lambda: BlockDude("<.."), "one exit E: there are none"),
    (lambda: BlockDude("<.T"), "drawn with < > E B # .: row 0, column 2 has 'T'"),
    (lambda: BlockDude(["..B", "<E."]), "the block needs ground, .* below row 0, column 2"),
    (lambda: BlockDude([".<.", "..E"], origin=(2, 3)), "needs ground, .* below row 2, column 4"),
    (lambda: BlockDude(start="corner"), "start must be one of map, uniform"),
    (lambda: BlockDude(1).crop(columns=(0, 10), agent=10), "agent's column must lie in a crop"),
    (lambda: BlockDude(["#<.", "##E"]).crop(columns=(0, 3), agent=0), "cell above what is drawn"),
    (lambda: BlockDude(1, discount=1, time_limit=None).mdp, "discount 1 needs a time limit"),
]


@pytest.mark.parametrize(("call", "says"), REFUSED)
def test_what_makes_no_level_is_refused(call, says):
    check_refusal(TaskError, call, says)


def test_too_many_states_are_refused_in_one_sentence(monkeypatch):
    monkeypatch.setattr("curricle.tasks.block_dude.LARGEST_SPACE", 500)
    says = "at most 500 states that can be reached: this one, of 25 columns and 2 blocks, has more"
    check_refusal(TaskError, lambda: BlockDude(1).states, says)
