"""Block Dude: BURLAP's rules written out anew, on its levels and on random maps."""

from collections import deque

import pytest

from benchmarks.referee.block_dude import PARTS, BlockDude, block_dude_family
from curricle import solve
from curricle.tasks import goal_distance

WEST, EAST, UP, PICK_UP, PUT_DOWN = range(5)


# Walls (first y, last y, x), floors (first x, last x, y), bricks, agent (x, y, dir), exit, blocks.
BURLAP = {
    1: ((), ((0, 24, 0),), ((3, 1), (3, 2), (7, 1), (11, 1), (11, 2)),
        (15, 1, 1), (0, 1), [(9, 1), (13, 1)]),
    2: (((2, 5, 0), (0, 2, 4), (0, 2, 8), (2, 4, 12)), ((0, 4, 2), (4, 8, 0), (8, 24, 2)), (),
        (17, 3, 0), (0, 6), [(7, 1), (13, 3), (15, 3), (15, 4), (16, 3)]),
    3: (((0, 4, 1), (0, 4, 3), (0, 3, 8), (1, 3, 11), (5, 8, 17)),
        ((0, 1, 0), (1, 3, 4), (3, 8, 1), (8, 10, 0), (11, 15, 3)),
        ((7, 2), (10, 1), (12, 4), (15, 4), (16, 4)),
        (8, 4, 0), (0, 1), [(4, 2), (5, 2), (13, 4), (15, 5), (16, 5), (16, 6)]),
}  # fmt: skip


def burlap_level(number):
    """Return bricks [x][y], the agent (x, y, dir), the exit and the blocks of a level of BURLAP."""
    walls, floors, bricks, *things = BURLAP[number]
    grid = [[0] * 25 for _ in range(25)]
    cells = {(x, y) for first, last, x in walls for y in range(first, last + 1)}
    cells |= {(x, y) for first, last, y in floors for x in range(first, last + 1)}
    for x, y in cells.union(bricks):
        grid[x][y] = 1
    return grid, *things


class Burlap:
    """BURLAP's model: blocks are cells, a carried one is the cell above the agent."""

    def __init__(self, grid):
        self.grid = grid

    def height(self, blocks, x, most):
        """Return BURLAP's greatestHeightBelow."""
        brick = max((y for y in range(most + 1) if self.grid[x][y]), default=0)
        return max([brick, *(y for bx, y in blocks if bx == x and y <= most)])

    def act(self, state, action):
        (x, y, way, holding), blocks = state
        blocks = set(blocks)
        if action in (WEST, EAST):
            way = int(action == EAST)
            to = x + (1 if way else -1)
            if 0 <= to < len(self.grid) and (height := self.height(blocks, to, y)) < y:
                self.carry(blocks, holding, (x, y), (to, height + 1))
                x, y = to, height + 1
            return (x, y, way, holding), frozenset(blocks)
        front = x + (1 if way else -1)
        if not 0 <= front < len(self.grid):
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
    [(1, 788, 19), pytest.param(2, 172_100, 73, marks=pytest.mark.slow), (3, 14_199, 94)],
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


def test_parts_of_a_level_are_those_with_a_way_to_the_exit():
    level, solvable = 1, []
    for columns in range(2, 20):
        part = BlockDude(level).crop(columns=(0, columns))
        mdp, blocks = part.mdp, sum(line.count("B") for line in part.level)
        ends = blocks and mdp.terminal.any()
        if ends and goal_distance(mdp, mdp.terminal)[mdp.start_states[0]] > 0:
            solvable.append(columns)
    assert solvable == [columns for columns in PARTS[level] if columns < 20]
    members = block_dude_family.easier(block_dude_family(level=level, columns=solvable[-1]))
    of_level = [member["columns"] for member in members if member["level"] == level]
    assert of_level == solvable[:-1]
