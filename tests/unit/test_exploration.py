"""DeepSea by the rules of bsuite, RiverSwim by its paper's figure, and values in closed form."""

from itertools import product

import numpy as np
import pytest

from curricle import evaluate, solve
from curricle.tasks import DeepSea, RiverSwim
from tests.support.tasks import dense_of

# -- DeepSea ---------------------------------------------------------------------------------------


def dive(size, actions, *, fails=(), cost=0.01):
    """Return the cells and rewards of a dive by bsuite's rules; `fails` are steps that slip."""
    column, cells, rewards = 0, [(0, 0)], []
    for row, action in enumerate(actions):
        reward = 1.0 if column == size - 1 and action else 0.0
        if action:
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


@pytest.mark.parametrize(
    ("sea", "fails"),
    [
        *[(DeepSea(size), ()) for size in (1, 2, 5)],
        *[(DeepSea(5, slip=0.2), fails) for fails in ((), (0,), (1, 3), (4,))],
    ],
)
def test_every_dive_is_as_in_bsuite_and_slips_go_straight_down(sea, fails):
    treasures = 0
    for actions in product((0, 1), repeat=sea.size):
        cells, rewards = follow(sea, actions, fails)
        expected = dive(sea.size, actions, fails=fails)
        assert cells == expected[0]
        assert rewards == pytest.approx(expected[1])
        treasures += max(rewards) > 0.5
    assert treasures == (0 if fails and min(fails) < sea.size - 1 else 1)


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


def test_the_bottom_of_a_sea_is_part_of_it():
    sea = DeepSea(7)
    low, whole = solve(sea.bottom(3)), solve(sea)
    states = sea.states.encode(**sea.bottom(3).states.decode())
    assert low.action_values == pytest.approx(whole.action_values[states])


# -- RiverSwim -------------------------------------------------------------------------------------

LEFT, RIGHT = range(2)


def test_the_paper_s_figure():
    p, r = dense_of(RiverSwim().mdp)
    assert np.array_equal(p[:, LEFT], np.eye(6)[[0, 0, 1, 2, 3, 4]])
    right = [
        [0.7, 0.3, 0.0, 0.0, 0.0, 0.0],
        [0.1, 0.6, 0.3, 0.0, 0.0, 0.0],
        [0.0, 0.1, 0.6, 0.3, 0.0, 0.0],
        [0.0, 0.0, 0.1, 0.6, 0.3, 0.0],
        [0.0, 0.0, 0.0, 0.1, 0.6, 0.3],
        [0.0, 0.0, 0.0, 0.0, 0.7, 0.3],
    ]
    assert p[:, RIGHT] == pytest.approx(np.array(right), abs=1e-15)
    assert r[:, LEFT].tolist() == [5, 0, 0, 0, 0, 0]
    assert r[:, RIGHT] == pytest.approx([0, 0, 0, 0, 0, 3000])
    assert RiverSwim().mdp.start.tolist() == [0, 0.5, 0.5, 0, 0, 0]


def closed_form(n, discount, forward, back, leave, stay, reward):
    """Return V of always swimming right: V_i = A x^i + B y^i, with two boundary conditions.

    x and y are the roots of f g x^2 - (1 - g m) x + g b = 0, where g is the discount and f, m, b
    are the chances to move on, to stay and to be carried back.
    """
    middle = 1 - forward - back
    roots = np.roots([discount * forward, discount * middle - 1, discount * back])
    at = roots[:, None] ** np.arange(n)
    first = (1 - discount * (1 - leave)) * at[:, 0] - discount * leave * at[:, 1]
    last = (1 - discount * stay) * at[:, -1] - discount * (1 - stay) * at[:, -2]
    return np.linalg.solve(np.stack([first, last]), [0.0, stay * reward]) @ at


@pytest.mark.parametrize("n", [3, 6, 12])
@pytest.mark.parametrize(
    ("forward", "back", "leave", "stay"), [(0.3, 0.1, 0.3, 0.3), (0.35, 0.05, 0.6, 0.6)]
)
def test_swimming_right_is_worth_its_closed_form(n, forward, back, leave, stay):
    river = RiverSwim(n, forward, back, leave, stay, start="uniform")
    expected = closed_form(n, 0.95, forward, back, leave, stay, 10_000)
    assert evaluate(river, [RIGHT] * n).values == pytest.approx(expected, rel=1e-7)
    assert solve(river).values == pytest.approx(expected, rel=1e-7)  # with these rewards it is best


def test_a_crop_keeps_positions_and_the_rewards_of_the_banks_that_it_has():
    river = RiverSwim(size=8, start=np.array([2, 1]))
    assert river == RiverSwim(size=8)
    early, late = river.crop(positions=(0, 3)), river.crop(positions=(5, 8))
    assert (early.left_reward, early.right_reward) == (5, 0)
    assert (late.left_reward, late.right_reward) == (0, 10_000)
    assert late.states.decode()["position"].tolist() == [5, 6, 7]
    assert late.mdp.start.tolist() == pytest.approx([1 / 3] * 3)
    assert late.crop(positions=(6, 8), start=[7]).mdp.start.tolist() == [0, 1]
    p, _ = dense_of(late.mdp)
    assert p[1, RIGHT] == pytest.approx([0.1, 0.6, 0.3])
