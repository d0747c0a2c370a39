"""What a portfolio compares, scores of turns, and what share of the turns follows from it."""

import math

import numpy as np
import pytest

import curricle as cr
from curricle.learning.portfolio import (
    OTHER,
    SOURCE,
    UNDECIDED,
    Tally,
    Turn,
    add_turn,
    longest_turn,
    source_share,
)
from curricle.tasks.kernel import compiled
from curricle.tasks.mdp import NO_LIMIT

PORTFOLIO = cr.Portfolio().kernel
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


def share_after(other, source, starts=(0,), portfolio=PORTFOLIO):
    """Return the share after the returns of each learner, in turns, in compiled code."""
    turns = [(m, x) for pair in zip(other, source, strict=True) for m, x in enumerate(pair)]
    tally = Tally.empty(3)
    members, returns = (np.array(x) for x in zip(*turns, strict=True))
    states = np.resize(starts, len(turns)).astype(np.uint64)
    share = compiled(_share_after, False)(
        tally, members.astype(np.uint64), states, returns.astype(float), portfolio
    )
    return share, tally


def _share_after(tally, members, states, returns, portfolio):
    for k in range(len(members)):
        add_turn(portfolio, tally, Turn(members[k], states[k], 1, returns[k]))
    return source_share(tally)


@pytest.mark.parametrize("n", [2, 5, 20])
def test_the_share_is_the_normal_probability_that_the_source_earns_more(n):
    other, source = np.random.default_rng(n).normal([[0.0], [0.4]], size=(2, n))
    share, tally = share_after(other, source)
    errors = tally.variance / (1 / tally.squares - 1)
    z = (tally.mean[SOURCE] - tally.mean[OTHER]) / np.sqrt(errors.sum())
    assert share == pytest.approx(0.5 + 0.5 * math.erf(z / math.sqrt(2)))
    np.testing.assert_allclose(tally.squares, 1 / n)  # all turns count alike, below the memory


def test_a_score_is_the_return_less_what_turns_from_its_state_returned():
    """Two starts of very different returns, which are noise otherwise."""
    noise = np.random.default_rng(0).normal(scale=0.1, size=(2, 30))
    level = np.resize([0.0, 0.0, 100.0], 60)[: 2 * 30].reshape(30, 2).T
    other, source = level + noise + [[0.0], [1.0]]
    of_states, of_all = (
        share_after(other, source, starts)[1].variance[SOURCE] for starts in ((0, 0, 1), (0,))
    )
    assert of_states < 0.01 * of_all


def test_shares_at_the_ends():
    assert share_after([1.0], [1.0])[0] == UNDECIDED  # too few turns
    assert share_after([1.0] * 5, [1.0] * 5)[0] == UNDECIDED
    assert share_after([0.0] * 30, [9.0, 8.0, 8.5] * 10)[0] > 0.999
    assert share_after([9.0, 8.0, 8.5] * 10, [0.0] * 30)[0] < 0.001


@pytest.mark.parametrize("scale", [1e-100, 1.0, 1e100])
def test_the_share_does_not_depend_on_the_unit_of_returns(scale):
    other, source = np.random.default_rng(1).normal([[0.0], [0.3]], size=(2, 8))
    share = share_after(other, source)[0]
    assert 0.01 < share < 0.99
    assert share_after(other * scale, source * scale)[0] == pytest.approx(share)


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
