"""RiverSwim: the figure of the paper, and its values in closed form."""

import numpy as np
import pytest

from curricle import evaluate, solve
from curricle.errors import TaskError
from curricle.tasks import RiverSwim
from tests.refusals import cases, check_refusal, check_values
from tests.tasks import dense_of

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


def test_swimming_left_is_worth_its_closed_form_where_it_is_best():
    river = RiverSwim(right_reward=1.0)
    assert solve(river).values == pytest.approx(5 * 0.95 ** np.arange(6) / 0.05, rel=1e-7)


def test_the_swimmer_is_where_detailed_balance_says():
    p, r = dense_of(RiverSwim().mdp)
    stationary = np.array([1, 3, 9, 27, 81, 81 * 3 / 7])
    stationary /= stationary.sum()
    assert stationary @ p[:, RIGHT] == pytest.approx(stationary)
    assert stationary @ r[:, RIGHT] == pytest.approx(3000 * (243 / 7) / (121 + 243 / 7))


def test_a_crop_keeps_positions_and_the_rewards_of_the_banks_that_it_has():
    river = RiverSwim(size=8)
    early, late = river.crop(positions=(0, 3)), river.crop(positions=(5, 8))
    assert (early.left_reward, early.right_reward) == (5, 0)
    assert (late.left_reward, late.right_reward) == (0, 10_000)
    assert late.states.decode()["position"].tolist() == [5, 6, 7]
    assert late.mdp.start.tolist() == pytest.approx([1 / 3] * 3)
    assert late.crop(positions=(6, 8), start=[7]).mdp.start.tolist() == [0, 1]
    p, _ = dense_of(late.mdp)
    assert p[1, RIGHT] == pytest.approx([0.1, 0.6, 0.3])


REFUSED = {
    "chances above 1": (
        lambda: RiverSwim(forward=0.7, back=0.4),
        "at most 1 together: got 0.7 and 0.4",
    ),
    "a crop beyond": (
        lambda: RiverSwim().crop(positions=(4, 7)),
        r"positions 0..6: got \(4, 7\)",
    ),
    "no discount": (lambda: RiverSwim(discount=1, time_limit=None).mdp, "needs a time limit"),
}


@pytest.mark.parametrize(("error", "call", "says"), cases({TaskError: REFUSED}))
def test_what_makes_no_river_is_refused(error, call, says):
    check_refusal(error, call, says)


def test_wrong_values_are_named():
    check_values(TaskError, RiverSwim, {"start": [[6], (), [[1], [2, 3]], [1.5], 1]})
