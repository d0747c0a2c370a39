"""Certificates of rewards of one's own: whether a potential is behind them."""

import numpy as np
import pytest

import curricle as cr
from curricle.certificate import ShapingReward, certify
from curricle.certificate.shaped_task import Reachable
from curricle.errors import PotentialError
from tests.certificates import END, ENDED, MAZE, PHI, RNG, difference
from tests.tasks import tree

HUNT = cr.Pursuit(size=3, predators=2)


def test_a_reward_made_of_a_potential_is_recognised():
    found = certify(MAZE, ShapingReward(difference(ENDED)))
    states = Reachable.of(MAZE.mdp).states
    np.testing.assert_allclose(found.potential[states], ENDED[states], atol=1e-12)
    assert found.residual < 1e-12
    assert found.findings[0].startswith("F = 0.9 Phi(s') - Phi(s) with Phi = 0 at the ends, to ")


def test_a_reward_made_of_a_potential_with_open_ends_is_recognised():
    found = certify(MAZE, ShapingReward(difference(PHI)))
    met = Reachable.of(MAZE.mdp)
    everywhere = np.append(met.states, met.ends)
    np.testing.assert_allclose(found.potential[everywhere], PHI[everywhere], atol=1e-9)
    assert found.findings[-1] == (
        f"terminal state {END} (row 2, column 2) has Phi = {PHI[END]:.4g}, must be 0"
    )


@pytest.mark.parametrize("discount", [0.937, 1.0])
def test_only_the_ends_that_are_not_zero_are_named(discount):
    task = tree(discount)
    phi = np.append(RNG.normal(size=7), np.zeros(8))
    phi[9] = 3.25
    found = certify(task, ShapingReward(difference(phi, discount)))
    assert found.findings == ("terminal state 9 has Phi = 3.25, must be 0",)
    np.testing.assert_allclose(found.potential, phi, atol=1e-9)


def test_a_reward_of_the_action_has_no_potential():
    found = certify(MAZE, ShapingReward(lambda s, a, after: 1.0 * (a == 0)))
    assert found.potential is None
    assert found.findings[-1] == (
        "not potential-based: from state 0 (row 0, column 0) to state 0 (row 0, column 0), F is 1 "
        "by north and 0 by west; with a potential the action does not matter"
    )


def test_a_reward_with_different_sums_on_two_paths_has_no_potential():
    # 1 for standing in the east: the way there and back earns, staying in the west does not.
    found = certify(MAZE, ShapingReward(lambda s, a, after: np.sin(7.0 * s)))
    assert found.potential is None
    assert "not potential-based: from state" in found.findings[-1]
    assert found.residual > 0.1


def test_a_harmless_bonus_is_safe_but_not_potential_based():
    found = certify(MAZE, ShapingReward(lambda s, a, after: 0.01 * (a == 1)))
    assert found.holds is None  # of two ways that are as good it takes one
    assert 0 < found.loss < 1e-9
    assert str(found).startswith("Undecided within ")
    assert "first in state 0 (row 0, column 0): east is worth 3.851, under shaping" in str(found)
    lane = cr.GridWorld("S..T", discount=0.9)
    safe = certify(lane, ShapingReward(lambda s, a, after: 0.01 * (a == 1)))
    assert safe.holds
    assert safe.theorem is None
    assert "Not potential-based" in str(safe)


def test_a_potential_hides_no_difference_that_is_more_than_rounding():
    """F of a potential and a little more is that of a potential to 1e-10 only, and no theorem."""
    task = cr.FiniteMDP.from_outcomes(
        [[[(1.0, 1, 5e-11)], [(1.0, 2, 0.0)]], [[], []], [[], []]],
        terminal=[0, 1, 1], start=0, discount=0.9,
    )  # fmt: skip
    assert certify(task, ShapingReward(lambda s, a, after: -1.0)).theorem is not None
    flipped = certify(task, ShapingReward(lambda s, a, after: -1.0 + 1e-10 * a))
    assert "with Phi = 0 at the ends, to 1e-10" in flipped.findings[-1]
    assert flipped.holds is False
    assert flipped.loss == pytest.approx(5e-11, rel=0.01)


def two_ways(short):
    """Return a task of two ways to the end whose rewards are those of a potential and one less."""
    return cr.FiniteMDP.from_outcomes(
        [[[(1.0, 1, 1.0)], [(1.0, 2, 1.0)]], [[(1.0, 3, 1e-20)]] * 2,
         [[(1.0, 3, 1e-20 - short)]] * 2, [[], []]],
        terminal=[0, 0, 0, 1], start=0, discount=0.9,
    )  # fmt: skip


def test_a_tie_that_is_proven_stays_one_and_a_difference_too_small_to_be_known_is_undecided():
    reward = ShapingReward(difference(np.array([0.3, 0.7, 1.1, 0.0])))
    assert certify(two_ways(0.0), reward).theorem is not None
    close = certify(two_ways(1e-21), reward)
    assert close.holds is None
    assert "the shaping is safe, but beside numbers of" in close.findings[0]
    assert certify(two_ways(1e-21), reward, tolerance=1e-9)
    assert (
        certify(
            cr.GridWorld(["S...", "....", "...T"], discount=0.9),
            ShapingReward(difference(np.append(np.random.default_rng(0).normal(size=11), 0.0))),
        ).theorem
        is not None
    )


def test_a_reward_that_raises_is_named():
    with pytest.raises(PotentialError, match=r"it raised IndexError: index \d+ is out of bounds"):
        certify(MAZE, ShapingReward(lambda s, a, after: PHI[after + 99]))


def test_a_reward_is_called_in_chunks(monkeypatch):
    whole = certify(HUNT, ShapingReward(lambda s, a, after: 1.0 * (s == after)))
    asked = []

    def bonus(s, a, after):
        asked.append(len(s))
        return 1.0 * (s == after)

    monkeypatch.setattr("curricle.certificate.shaped_task.CHUNK", 5_000)
    parts = certify(HUNT, ShapingReward(bonus))
    assert len(asked) > 10
    assert max(asked) <= 5_000
    assert (parts.holds, parts.loss, parts.residual) == (whole.holds, whole.loss, whole.residual)
    assert parts.findings == whole.findings
