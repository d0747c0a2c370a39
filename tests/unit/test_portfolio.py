"""What a portfolio compares, and how long a turn is."""

import pytest

import curricle as cr
from curricle.learning.portfolio import UNDECIDED, longest_turn
from curricle.tasks.mdp import NO_LIMIT

STEPS = 10
"""Of the way to the later reward."""


def temptation(discount):
    """Return a task where the first action ends with 1, the other with 5 after ten steps."""
    end = STEPS + 1
    ways = [[[(1.0, end, 1.0)], [(1.0, 1, 0.0)]]]
    ways += [[[(1.0, s + 1, 5.0 * (s == STEPS))]] * 2 for s in range(1, STEPS + 1)]
    return cr.FiniteMDP.from_outcomes(
        [*ways, [[], []]], terminal=[*[False] * end, True], start=0, discount=discount
    )


def test_the_learners_are_judged_by_discounted_returns():
    """At 0.6 the 1 now is worth more (5 * 0.6^9 = 0.05), which phi hides for 2,000 steps and more.

    Judged by undiscounted returns phi would be ahead.
    """
    task = temptation(0.6)
    phi = cr.solve(task).action_values.copy()
    assert phi[0].argmax() == 0
    phi[0, 0] = -1e4
    shaping = cr.QInitialisation(phi, portfolio=cr.Portfolio())
    share = cr.learn(
        task, cr.QLearning(learning_rate=0.01), 2000, seeds=5, shaping=shaping
    ).source_share
    assert (share[:, 0] == UNDECIDED).all()
    assert (share[:, 10:] < 0.05).mean() > 0.9


@pytest.mark.parametrize(
    ("discount", "time_limit", "expected"),
    [
        (0.9, 100, 100),  # an episode has 10 / (1 - 0.9) steps at most
        (0.9, 101, 30),
        (0.99, 200, 200),
        (0.99, NO_LIMIT, 300),
        (0.0, NO_LIMIT, 3),
        (1.0, 10_000, 10_000),
        (1.0, NO_LIMIT, NO_LIMIT),
    ],
)
def test_the_longest_turn(discount, time_limit, expected):
    assert longest_turn(discount, time_limit) == expected
