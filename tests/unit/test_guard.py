"""What a guard compares, discounted returns, and what share of the steps follows from it."""

import numpy as np
import pytest

import curricle as cr
from curricle.learning.guard import (
    UNDECIDED,
    Tally,
    add_return,
    longest_turn,
    shaped_share,
)
from curricle.tasks.kernel import compiled
from curricle.tasks.mdp import NO_LIMIT

GUARD = cr.Guard().kernel
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

    Judged by undiscounted returns, as in 0.1.0, phi is ahead.
    """
    task = temptation(0.6)
    phi = cr.solve(task).action_values.copy()
    assert phi[0].argmax() == 0
    phi[0, 0] = -1e4
    shaping = cr.QInitialisation(phi, guard=cr.Guard())
    share = cr.learn(
        task, cr.QLearning(learning_rate=0.01), 2000, seeds=5, shaping=shaping
    ).source_share
    assert (share[:, 0] == UNDECIDED).all()
    assert (share[:, 10:] == cr.Guard().share_behind).mean() > 0.9


def share_after(scratch, shaped, guard=GUARD):
    """Return the share after the returns of each learner, in compiled code."""
    return compiled(_share_after, False)(np.asarray(scratch), np.asarray(shaped), guard)


def _share_after(scratch, shaped, guard):
    tally = Tally(np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2))
    for returned in scratch:
        add_return(tally, 0, returned, guard.forgetting)
    for returned in shaped:
        add_return(tally, 1, returned, guard.forgetting)
    return shaped_share(guard, tally)


@pytest.mark.parametrize("n", [2, 5, 30])
def test_the_share_is_the_probability_that_phi_earns_more(n):
    """Of Student's t with two degrees of freedom, by adding up its density."""
    scratch, shaped = np.random.default_rng(n).normal([[0.0], [0.4]], size=(2, n))
    shaped += max(0.0, 0.1 - (shaped.mean() - scratch.mean()))  # ahead
    t = shaped.mean() - scratch.mean()
    t /= np.sqrt(scratch.var() / (n - 1) + shaped.var() / (n - 1))
    x = np.linspace(0, t, 20_001)
    density = (2 + x**2) ** -1.5
    probability = 0.5 + np.trapezoid(density, x)
    assert share_after(
        scratch, shaped, GUARD._replace(forgetting=0.0, share_ahead=1.0)
    ) == pytest.approx(probability)


def test_shares_at_the_ends():
    assert share_after([1.0, 2.0], [1.0, 1.9]) == GUARD.share_behind
    assert share_after([1.0, 1.0], [1.0, 1.0]) == GUARD.share_behind  # in doubt, the other one
    assert share_after([0.0, 1.0], [1e-9, 1.0 - 1e-12]) > UNDECIDED
    assert share_after([1.0, 1.0], [1.0 + 1e-9, 1.0 + 1e-9]) == GUARD.share_ahead
    assert share_after([0.0, 1.0, 0.5], [9.0, 8.0, 8.5]) == GUARD.share_ahead


@pytest.mark.parametrize("scale", [1e-100, 1.0, 1e100])
def test_the_share_does_not_depend_on_the_unit_of_returns(scale):
    scratch, shaped = np.random.default_rng(1).normal([[0.0], [0.3]], size=(2, 8))
    share = share_after(scratch, shaped)
    assert UNDECIDED < share < GUARD.share_ahead
    assert share_after(scratch * scale, shaped * scale) == pytest.approx(share)


def test_two_turns_of_equal_learners_have_a_large_share_as_seldom_as_it_says():
    """A share of 0.8 or more in a fifth of pairs; 20,000 pairs: 4 standard errors are 0.011."""
    pairs = np.random.default_rng(5).normal(size=(20_000, 2, 2))
    share = np.array([share_after(*pair) for pair in pairs])
    assert (share > UNDECIDED).mean() == pytest.approx(0.5, abs=0.014)
    assert (share >= GUARD.share_ahead).mean() == pytest.approx(0.2, abs=0.011)


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
