"""Certificates of a small maze: what is safe, what is not, by how much, and in which state."""

import dataclasses

import numpy as np
import pytest

import curricle as cr
from curricle.certificate import Certificate, ShapingReward, certify
from curricle.certificate.shaped_task import Reachable, look_ahead_sweep
from curricle.errors import SettingError
from curricle.paper import hacking
from tests.certificates import END, ENDED, MAZE, PAIRS, PHI, away, difference


@pytest.mark.parametrize(
    "shaping",
    [
        cr.StateShaping(cr.StatePotential(MAZE, PHI)),
        cr.QInitialisation(cr.StateActionPotential(MAZE, PAIRS)),
        cr.LookAheadAdvice(cr.StateActionPotential(MAZE, PAIRS)),
        cr.StateShaping(cr.StateActionPotential(MAZE, PAIRS)),
        cr.StateShaping(ENDED),
        cr.StateShaping(np.where(MAZE.mdp.terminal[:, None], 0.0, PAIRS)),
        cr.LookAheadAdvice(np.where(MAZE.mdp.terminal[:, None], 0.0, PAIRS)),
        ShapingReward(difference(ENDED)),
    ],
)
def test_potentials_are_safe(shaping):
    found = certify(MAZE, shaping)
    assert found
    assert found.holds is True
    assert (found.method, found.states, found.steps) == ("exact", 7, 0)
    assert found.shaping == type(shaping).__name__
    assert found.counterexample is None
    assert 0 <= found.loss <= found.error_bound <= found.tolerance / 4
    assert found.total_loss <= found.error_bound
    assert found.residual <= 1e-6
    assert str(found).startswith(
        "Safe: in all 7 reachable states the optimal actions of the shaped task are those of the "
        "task (values proven to "
    )


def test_states_that_cannot_be_reached_are_not_compared():
    walled = cr.GridWorld(["S.#.", "#T#."], discount=0.9)
    nowhere = np.flatnonzero(walled.cells[:, 1] == 3)

    def bonus(s, a, after):  # would be a trap, and is not asked about
        assert not np.isin(s, nowhere).any()
        assert not np.isin(after, nowhere).any()
        return np.where(np.isin(s, nowhere), np.nan, 0.0)

    found = certify(walled, ShapingReward(bonus))
    assert found.holds
    assert found.states == 2
    assert Reachable.of(walled.mdp).ends.tolist() == np.flatnonzero(walled.mdp.terminal).tolist()


@pytest.mark.parametrize(
    "shaping",
    [
        cr.StateShaping(cr.StatePotential(MAZE, 1e9 * PHI)),
        cr.LookAheadAdvice(cr.StateActionPotential(MAZE, 1e9 * PAIRS)),
    ],
)
def test_a_huge_potential_is_safe_with_a_larger_error(shaping):
    found = certify(MAZE, shaping)
    assert found.holds
    assert found.error_bound > 1e-7
    assert found.tolerance >= 4 * found.error_bound


def test_the_given_tolerance_is_used():
    found = certify(MAZE, cr.StateShaping(ENDED), tolerance=0.5)
    assert found.holds
    assert found.tolerance == 0.5
    slight = np.zeros((MAZE.states.size, 4))
    slight[0, 0] = 3.0  # worse by 1.9 without this
    assert not certify(MAZE, cr.DecayingAdvice(slight))
    assert certify(MAZE, cr.DecayingAdvice(slight), tolerance=5.0)
    with pytest.raises(SettingError, match=r"tolerance must be at least .*: got 1e-15"):
        certify(MAZE, cr.StateShaping(ENDED), tolerance=1e-15)


@pytest.mark.parametrize("kind", [cr.StateShaping, cr.QInitialisation, cr.LookAheadAdvice])
def test_an_end_that_is_not_zero_is_named_and_its_effect_proven(kind):
    pairs = np.repeat(away(100.0)[:, None], 4, axis=1)
    found = certify(MAZE, kind(away(100.0) if kind is cr.StateShaping else pairs))
    assert found.holds is False
    assert f"terminal state {END} (row 2, column 2) has Phi = -100, must be 0" in str(
        found
    ).lower() or (f"Terminal state {END} (row 2, column 2) has Phi = -100, must be 0" in str(found))
    # The treasure is now a loss: whoever stands before it turns away.
    worst = found.counterexample
    assert worst.lost > 1
    assert worst.values[0] > worst.values[1]
    assert worst.shaped_values[0] < worst.shaped_values[1]
    assert str(found).startswith(f"NOT safe: in {worst.place} shaping prefers {worst.actions[1]}")
    assert found.residual > 1


def test_an_end_that_is_not_zero_may_do_no_harm_and_is_named_all_the_same():
    found = certify(MAZE, cr.StateShaping(-away(1.0)))
    assert found.holds
    assert found.findings == (f"terminal state {END} (row 2, column 2) has Phi = 1, must be 0",)


def test_ends_of_the_librarys_potentials_are_zero():
    assert certify(MAZE, cr.StateShaping(cr.StatePotential(MAZE, away(100.0)))).findings == ()


def test_a_second_discount_is_named_and_its_effect_proven():
    # 0.1 Phi(s') is missing: as good as a fine for entering places with a high Phi.
    hint = np.where(MAZE.mdp.terminal, 0.0, 100.0 - 30 * abs(MAZE.cells - 2).sum(axis=1))
    phi = cr.StatePotential(MAZE, hint)
    assert certify(MAZE, cr.StateShaping(phi))
    found = certify(MAZE, cr.StateShaping(phi), shaping_discount=0.3)
    assert found.holds is False
    expected = "shaped with a second discount: F = 0.3 Phi(s') - Phi(s), the task's discount is 0.9"
    assert found.findings == (expected,)
    # The same as a reward of one's own: found out.
    taken_apart = certify(MAZE, ShapingReward(difference(hint, 0.3)))
    assert taken_apart.findings == (expected,)
    assert taken_apart.holds is False
    assert taken_apart.loss == pytest.approx(found.loss, abs=1e-6)
    np.testing.assert_allclose(taken_apart.potential[Reachable.of(MAZE.mdp).states],
                               hint[Reachable.of(MAZE.mdp).states], atol=1e-6)  # fmt: skip


def test_the_worst_state_is_the_one_named():
    # Two states with two ways as good; a bonus takes one of them, more so in the second.
    two = [[[(1.0, s + 1, 0.0)] for _ in range(2)] for s in range(2)]
    task = cr.FiniteMDP.from_outcomes(
        [*two, [[], []]], terminal=[False, False, True], start=0, discount=0.5
    )
    slight = np.array([[1.0, 0.0], [5.0, 0.0], [0.0, 0.0]])
    found = certify(task, cr.RewardBonus(slight))
    assert (found.counterexample.state, found.counterexample.action) == (1, 1)
    other = certify(task, cr.RewardBonus(slight[[1, 0, 2]]))
    assert (other.counterexample.state, other.counterexample.lost) == (0, 0.0)


def test_actions_that_rounding_alone_tells_apart_are_tied():
    choice = [[(1.0, 1, 0.2)], [(1.0, 1, 0.0)]]
    task = cr.FiniteMDP.from_outcomes([choice, [[], []]], terminal=[0, 1], start=0, discount=0.5)
    bonus = np.array([[0.1, 0.3], [0.0, 0.0]])
    assert 0.2 + bonus[0, 0] > bonus[0, 1]  # in double precision
    found = certify(task, cr.RewardBonus(bonus))
    assert found.holds is False
    assert found.loss == pytest.approx(0.2)
    assert found.total_loss == pytest.approx(0.2)


def test_a_hint_paid_outright_is_refused_and_as_a_potential_accepted():
    hint = hacking.nearness()
    paid = certify(hacking.MAZE, cr.RewardBonus(hint))
    assert paid.holds is False
    worst = paid.counterexample
    assert worst.components == dict(
        zip(("row", "column"), hacking.MAZE.cells[worst.state].tolist(), strict=True)
    )
    # A policy of the shaped optimum goes on for ever: -1 a step, instead of the way to 20.
    shaped = cr.FiniteMDP(**{
        **{f.name: getattr(hacking.MAZE.mdp, f.name) for f in dataclasses.fields(cr.FiniteMDP)},
        "reward": hacking.MAZE.mdp.reward[hacking.MAZE.mdp.outcome_row.ravel()]
        + hint.values.ravel()[:, None],
        "outcome_row": np.arange(hint.values.size).reshape(hint.values.shape),
        "probability": np.ones((hint.values.size, 1)),
        "next_state": hacking.MAZE.mdp.next_state[hacking.MAZE.mdp.outcome_row.ravel()],
    })  # fmt: skip
    followed = cr.evaluate(hacking.MAZE, cr.solve(shaped).policy)
    best = cr.solve(hacking.MAZE)
    states = Reachable.of(hacking.MAZE.mdp).states
    assert followed.values[states] == pytest.approx(-20.0)
    assert paid.total_loss == pytest.approx((best.values - followed.values)[states].max())
    assert paid.loss == pytest.approx(worst.lost)
    assert certify(hacking.MAZE, cr.StateShaping(hint.to_state()))
    assert certify(hacking.MAZE, cr.LookAheadAdvice(hint))


def test_at_discount_1_every_policy_must_end():
    ends = cr.FiniteMDP.from_outcomes(
        [[[(1.0, 1, 0.0)], [(1.0, 2, 1.0)]], [[(1.0, 2, 3.0)], [(1.0, 2, 0.0)]], [[], []]],
        terminal=[False, False, True], start=0, discount=1.0,
    )  # fmt: skip
    phi = cr.StatePotential(ends, [5.0, -7.0, 0.0])
    assert certify(ends, cr.StateShaping(phi))
    # At discount 1 a constant is no matter, the same at one end: a shift of all.
    assert certify(ends, cr.StateShaping([6.0, -6.0, 1.0]))
    halved = certify(ends, ShapingReward(difference(np.array([0.0, 10.0, 0.0]), 0.5)))
    assert halved.holds is False
    assert "F = 0.5 Phi(s') - Phi(s), the task's discount is 1" in halved.findings[0]
    endless = cr.GridWorld(["S..", "..T"], discount=1)
    found = certify(endless, cr.StateShaping(cr.StatePotential(endless, np.arange(6.0))))
    assert (found.holds, found.method) == (None, "sampled")
    assert "an episode can go on for ever at discount 1" in str(found)
    with pytest.raises(SettingError, match="discount 1 needs every policy considered to end"):
        certify(endless, cr.StateShaping(np.zeros(6)), method="exact")


def test_records_are_frozen_and_conditions():
    found = certify(MAZE, cr.StateShaping(away(100.0)))
    with pytest.raises(dataclasses.FrozenInstanceError):
        found.holds = True
    with pytest.raises(dataclasses.FrozenInstanceError):
        found.counterexample.state = 0
    for holds, truth in ((True, True), (False, False), (None, False)):
        assert bool(dataclasses.replace(found, holds=holds)) is truth
    assert not certify(MAZE, ShapingReward(difference(ENDED))).potential.flags.writeable
    assert isinstance(found, Certificate)


def test_the_literal_sweep_pays_what_an_end_says():
    two = cr.FiniteMDP.from_outcomes(
        [[[(1.0, 1, 2.0)]], [[]]], terminal=[0, 1], start=0, discount=0.5
    )
    phi = np.array([[3.0], [8.0]])
    assert look_ahead_sweep(two, phi, np.zeros((2, 1)))[:, 0].tolist() == [2.0 + 0.5 * 8 - 3, 0.0]
