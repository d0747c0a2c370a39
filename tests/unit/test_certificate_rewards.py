"""Certificates of rewards of one's own: whether a potential is behind them."""

import numpy as np
import pytest

import curricle as cr
from curricle.certificate import ShapingReward, certify
from curricle.certificate.shaped_task import Reachable, shaping_rewards
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
    assert found.findings == (
        f"terminal state {END} (row 2, column 2) has Phi = {PHI[END]:.4g}, must be 0",
    )


def test_both_mistakes_at_once_are_recognised():
    found = certify(MAZE, ShapingReward(difference(PHI, 0.97)))
    assert "F = 0.97 Phi(s') - Phi(s), the task's discount is 0.9" in found.findings[0]
    assert f"has Phi = {PHI[END]:.4g}, must be 0" in found.findings[1]


def test_undiscounted_shaping_is_recognised():
    found = certify(MAZE, ShapingReward(difference(ENDED, 1.0)))
    assert "F = 1 Phi(s') - Phi(s), the task's discount is 0.9" in found.findings[0]
    # Where nothing ends every loop leaves a constant open.
    endless = two_ways_round(discount=0.9)
    phi = np.array([3.0, -1.0, 7.0, 2.0])
    found = certify(endless, ShapingReward(difference(phi, 1.0)))
    assert "F = 1 Phi(s') - Phi(s), the task's discount is 0.9" in found.findings[0]
    assert np.ptp(found.potential - phi) < 1e-9


def two_ways_round(**settings):
    """Four states in a ring, forth or back or staying; nothing ends."""
    outcomes = [
        [[(1.0, (s + move) % 4, 0.0)] for move in (1, -1, 0)] for s in range(4)
    ]  # fmt: skip
    return cr.FiniteMDP.from_outcomes(outcomes, terminal=[False] * 4, start=0, **settings)


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
    assert found.findings == (
        "not potential-based: from state 0 (row 0, column 0) to state 0 (row 0, column 0), F is 1 "
        "by north and 0 by west; with a potential the action does not matter",
    )


def test_a_reward_with_different_sums_on_two_paths_has_no_potential():
    # 1 for standing in the east: the way there and back earns, staying in the west does not.
    found = certify(MAZE, ShapingReward(lambda s, a, after: np.sin(7.0 * s)))
    assert found.potential is None
    assert "not potential-based: from state" in found.findings[0]
    assert found.residual > 0.1


def test_a_harmless_bonus_is_safe_but_not_potential_based():
    found = certify(MAZE, ShapingReward(lambda s, a, after: 0.01 * (a == 1)))
    assert found.holds is False  # of two ways that were as good it takes one
    assert found.loss == pytest.approx(0, abs=1e-6)
    assert found.counterexample.lost == 0
    assert str(found).startswith(
        "NOT the same, though no return is lost: in state 0 (row 0, column"
    )
    assert "shaping gives up south, which is as good as any" in str(found)
    lane = cr.GridWorld("S..T", discount=0.9)
    safe = certify(lane, ShapingReward(lambda s, a, after: 0.01 * (a == 1)))
    assert safe.holds
    assert "Not potential-based" in str(safe)


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


def test_a_scalar_reward_stands_for_all():
    nothing = np.zeros(3, np.int64)
    assert shaping_rewards(MAZE, lambda s, a, t: 2, nothing, nothing, nothing).tolist() == [2.0] * 3
