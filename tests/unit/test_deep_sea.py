"""DeepSea: the rules of bsuite, step by step, and its optimum in closed form."""

from itertools import product

import numpy as np
import pytest

from curricle import evaluate, solve
from curricle.errors import TaskError
from curricle.tasks import DeepSea
from tests.refusals import check_refusal


def dive(size, actions, *, right=None, fails=(), cost=0.01):
    """Return the cells and rewards of a dive by bsuite's rules; `fails` are steps that slip."""
    column, cells, rewards = 0, [(0, 0)], []
    for row, action in enumerate(actions):
        goes_right = action == (1 if right is None else right[row, column])
        reward = 1.0 if column == size - 1 and goes_right else 0.0
        if goes_right:
            if row not in fails:
                column = min(max(column + 1, 0), size - 1)
            reward -= cost / size
        else:
            column = min(max(column - 1, 0), size - 1)
        cells.append((row + 1, column))
        rewards.append(reward)
    return cells, rewards


def follow(sea, actions, fails=()):
    """Return the same by the tables of a sea, of whose outcomes the second is a slip."""
    mdp, state = sea.mdp, 0
    cells, rewards = [tuple(sea.states.points[0].tolist())], []
    for step, action in enumerate(actions):
        assert not mdp.terminal[state]
        row = mdp.outcome_row[state, action]
        outcome = 1 if step in fails and mdp.probability[row, -1] > 0 else 0
        rewards.append(mdp.reward[row, outcome])
        state = mdp.next_state[row, outcome]
        cells.append(tuple(sea.states.points[state].tolist()))
    assert mdp.terminal[state]
    return cells, rewards


@pytest.mark.parametrize("size", [1, 2, 5])
def test_every_dive_is_as_in_bsuite_and_one_finds_the_treasure(size):
    sea, found = DeepSea(size), 0
    for actions in product((0, 1), repeat=size):
        cells, rewards = follow(sea, actions)
        expected = dive(size, actions)
        assert cells == expected[0]
        assert rewards == pytest.approx(expected[1])
        found += max(rewards) > 0.5
    assert found == 1


@pytest.mark.parametrize("fails", [(), (0,), (1, 3), (4,)])
def test_slips_go_straight_down_and_pay_the_same(fails):
    sea = DeepSea(5, slip=0.2)
    for actions in product((0, 1), repeat=5):
        cells, rewards = follow(sea, actions, fails)
        expected = dive(5, actions, fails=fails)
        assert cells == expected[0]
        assert rewards == pytest.approx(expected[1])


def test_a_seed_says_cell_by_cell_which_action_is_right():
    right = np.random.RandomState(3).binomial(1, 0.5, [6, 6])  # as bsuite draws it
    assert 0 < right.sum() < 36
    sea = DeepSea(6, mapping_seed=3)
    for actions in product((0, 1), repeat=6):
        cells, rewards = follow(sea, actions)
        expected = dive(6, actions, right=right)
        assert cells == expected[0]
        assert rewards == pytest.approx(expected[1])
    assert sea.right[:-6].tolist() == [right[r, c] for r in range(6) for c in range(r + 1)]
    low = sea.bottom(2)
    assert low.right[:3].tolist() == [right[4, 4], right[5, 4], right[5, 5]]
    assert solve(sea).values == pytest.approx(solve(DeepSea(6)).values)


@pytest.mark.parametrize("size", [1, 2, 10, 30])
@pytest.mark.parametrize("discount", [1.0, 0.9])
def test_the_optimum_in_closed_form(size, discount):
    sea = DeepSea(size, discount=discount, move_cost=0.01 * discount**size)
    costs = sea.move_cost / size * (discount ** np.arange(size)).sum()
    values = solve(sea).values
    assert sea.states.size == size * (size + 3) // 2
    assert values[0] == pytest.approx(discount ** (size - 1) - costs, abs=1e-7)
    row, column = sea.states.points.T
    assert values[(column < row)] == pytest.approx(0, abs=1e-7)  # the treasure is out of reach


@pytest.mark.parametrize("size", [2, 10])
def test_the_stochastic_optimum_in_closed_form(size):
    sea = DeepSea(size, slip=1 / size, noise=1.0, discount=1.0)
    kept, cost = 1 - 1 / size, 0.01 / size
    goes_on = cost * sum(kept**step for step in range(size))  # after a slip nothing is left to win
    assert solve(sea).values[0] == pytest.approx(kept ** (size - 1) - goes_on, abs=1e-7)
    # The figure that bsuite calls optimal is of always going right.
    always = evaluate(sea, sea.right).values[0]
    assert always == pytest.approx(kept ** (size - 1) - 0.01, abs=1e-7)


def test_noise_is_in_the_ends_of_the_last_row_and_has_mean_0():
    quiet, sea = DeepSea(4, slip=0.25).mdp, DeepSea(4, slip=0.25, noise=2.0).mdp
    mean = [(one.probability * one.reward).sum(axis=1) for one in (quiet, sea)]
    assert mean[0] == pytest.approx(mean[1])
    variance = (sea.probability * sea.reward**2).sum(axis=1) - mean[1] ** 2
    more = variance - ((quiet.probability * quiet.reward**2).sum(axis=1) - mean[0] ** 2)
    noisy = np.flatnonzero(abs(more) > 1e-9)
    cells = {tuple(DeepSea(4).states.points[row // 2].tolist()) for row in noisy}
    assert cells == {(3, 0), (3, 3)}
    assert more[noisy] == pytest.approx(4.0)


def test_the_bottom_of_a_sea_is_part_of_it():
    sea = DeepSea(7)
    low, whole = solve(sea.bottom(3)), solve(sea)
    states = sea.states.encode(**sea.bottom(3).states.decode())
    assert low.action_values == pytest.approx(whole.action_values[states])


REFUSED = [
    (lambda: DeepSea(start="bottom"), "'surface', 'uniform' or cells"),
    (lambda: DeepSea(start=[1, 2]), r"cells such as"),
    (lambda: DeepSea(start=[(2, 3)]), r"free cell .*got \(2, 3\)"),
    (lambda: DeepSea(4).bottom(5), r"part of a sea must lie in \[1, 4\]"),
    (lambda: DeepSea(4).bottom(0), "rows of a part of a sea .*at least 1"),
]


@pytest.mark.parametrize(("call", "says"), REFUSED)
def test_what_makes_no_sea_is_refused(call, says):
    check_refusal(TaskError, call, says)
