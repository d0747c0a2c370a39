"""How long a turn of a portfolio is, and what is evaluated."""

import pytest

import curricle as cr
from curricle.learning.portfolio import longest_turn
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


@pytest.mark.parametrize(("discount", "first"), [(0.6, 0), (0.99, 1)])
def test_the_members_are_judged_by_discounted_returns(discount, first):
    """At 0.6 the 1 now is worth more (5 * 0.6^9 = 0.05), at .99 the 5 later."""
    task = temptation(discount)
    phi = cr.solve(task).action_values
    assert phi[0].argmax() == first
    for sign in (1, -1):
        shaping = cr.QInitialisation(sign * phi, portfolio=cr.Portfolio())
        learnt = cr.learn(task, budget=2000, seeds=5, shaping=shaping)
        assert (learnt.values[:, 0].argmax(axis=1) == first).all()
        assert not learnt.source_share[:, -10:].any() or sign == 1


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
