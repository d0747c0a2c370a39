"""Block Dude: levels of BURLAP have the states and shortest ways that its rules lead to."""

import pytest

from benchmarks.referee.block_dude import PARTS, BlockDude, block_dude_family
from curricle import solve
from curricle.tasks import goal_distance


@pytest.mark.parametrize(
    ("number", "reached", "moves"),
    [(1, 788, 19), pytest.param(2, 172_100, 73, marks=pytest.mark.slow), (3, 14_199, 94)],
)
def test_levels_have_the_states_and_the_optimum_of_burlap_s_rules(number, reached, moves):
    task = BlockDude(number)
    assert task.states.size == reached
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
