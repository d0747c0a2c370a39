"""Certificates: what is safe, what is not, by how much, in which state, by which potential."""

import numpy as np
import pytest

import curricle as cr
from curricle.certificate import ShapingReward, certify
from curricle.certificate.shaped_task import Reachable, check_shaping
from curricle.errors import SettingError
from curricle.paper import mazes
from tests.support.certificates import END, ENDED, MAZE, RNG, away, difference
from tests.support.tasks import tree


def test_states_that_cannot_be_reached_are_not_compared():
    walled = cr.GridWorld(["S.#.", "#T#."], discount=0.9)
    nowhere = np.flatnonzero(walled.cells[:, 1] == 3)

    def bonus(s, a, after):  # would be a trap, and is not asked about
        assert not np.isin(s, nowhere).any()
        assert not np.isin(after, nowhere).any()
        return np.where(np.isin(s, nowhere), np.nan, 0.0)

    certificate = certify(walled, ShapingReward(bonus))
    assert certificate.holds
    assert certificate.states == 2
    assert Reachable.of(walled.mdp).ends.tolist() == np.flatnonzero(walled.mdp.terminal).tolist()


def test_actions_that_are_not_available_are_not_asked_about():
    outcomes = [[[(1.0, 1, 0.0)], []], [[(1.0, 2, 1.0)]] * 2, [[], []]]
    ends, phi = [False, False, True], np.array([2.0, 3.0, 0.0])
    task = cr.FiniteMDP.from_outcomes(outcomes, terminal=ends, start=0, discount=0.9)

    def reward(s, a, after):
        return np.where((s == 0) & (a == 1), np.nan, 0.9 * phi[after] - phi[s])

    certificate = certify(task, ShapingReward(reward))
    assert certificate.holds
    assert certificate.theorem is not None


def test_a_loss_within_the_tolerance_is_allowed_for():
    slight = np.zeros((MAZE.states.size, 4))
    slight[1, 3] = 3.0  # worse by 2.92 without this
    assert certify(MAZE, cr.RewardBonus(slight)).holds is False
    certificate = certify(MAZE, cr.RewardBonus(slight), tolerance=5.0)
    assert certificate.holds
    assert certificate.loss == pytest.approx(2.9241)
    assert str(certificate).startswith("Safe within 5: in all 7 reachable states no action that is")
    assert "tolerance 5, largest possible loss 2.9" in str(certificate)
    assert certify(MAZE, cr.RewardBonus(slight), tolerance=1.0).holds is False
    # No tolerance is too small to be asked for.
    assert certify(MAZE, cr.StateShaping(ENDED), tolerance=1e-300)


def two_ways(rewards, bonus, ends=(1, 1)):
    """Return a task of one choice between two ends, and a bonus for the second action."""
    choice = [[(1.0, end, float(reward))] for end, reward in zip(ends, rewards, strict=True)]
    task = cr.FiniteMDP.from_outcomes(
        [choice, [[], []], [[], []]], terminal=[0, 1, 1], start=0, discount=0.9
    )
    return task, cr.RewardBonus(np.array([[0.0, bonus], [0.0, 0.0], [0.0, 0.0]]))


@pytest.mark.parametrize(
    ("rewards", "bonus", "loss"),
    [
        ((3.0, 3.0), 1e-15, 0.0),  # both equally good, or the first given up
        ((3.0, 3.0 - 1e-15), 1.0, 0.0),  # the second is chosen, and may lose nothing
        ((3.0, 2.0), 1.0, 1.0),  # the second may become as good, and loses 1
        ((3.0, 2.0), 1.0 - 1e-15, 1.0),
    ],
)
def test_values_too_close_to_tell_are_undecided(rewards, bonus, loss):
    certificate = certify(*two_ways(rewards, bonus))
    assert certificate.holds is None
    assert certificate.counterexample is None
    assert certificate.loss == pytest.approx(loss, abs=1e-6)
    assert certificate.loss >= loss
    assert str(certificate).startswith(
        f"Undecided within {2 * certificate.error_bound:.0e} (values proven to "
    )
    assert certificate.findings[0].startswith(
        "in 1 of 1 reachable states the values are too close to tell, first in state 0: "
        "action 0 is worth 3, under shaping 3 and action 1 is worth "
    )
    # With a tolerance above the error the same values are decided.
    assert certify(*two_ways(rewards, bonus), tolerance=1.5).holds is True


@pytest.mark.parametrize("kind", [cr.StateShaping, cr.QInitialisation, cr.LookAheadAdvice])
def test_an_end_that_is_not_zero_is_judged_as_learning_reads_it_or_as_given(kind):
    pairs = np.repeat(away(100.0)[:, None], 4, axis=1)
    shaping = kind(away(100.0) if kind is cr.StateShaping else pairs)
    learned = certify(MAZE, shaping)
    assert learned.holds  # learn() sets it to 0
    assert learned.findings == (
        f"terminal state {END} (row 2, column 2) has Phi = -100, which learn() reads as 0; "
        "ends='given' judges a tool that does not",
    )
    assert cr.learn(MAZE, budget=3000, shaping=shaping).greedy_return[0, -1] > 3.8
    certificate = certify(MAZE, shaping, ends="given")
    assert certificate.holds is False
    assert f"Terminal state {END} (row 2, column 2) has Phi = -100, must be 0" in str(certificate)
    assert ("masks terminated steps" in str(certificate)) is (kind is not cr.StateShaping)
    # The treasure is now a loss: whoever stands before it turns away.
    worst = certificate.counterexample
    assert worst.lost > 1
    assert worst.values[0] > worst.values[1]
    assert worst.shaped_values[0] < worst.shaped_values[1]
    assert str(certificate).startswith(
        f"NOT safe: in {worst.place} shaping prefers {worst.actions[1]}"
    )
    assert certificate.residual > 1


def test_a_hint_paid_outright_is_refused_and_as_a_potential_accepted():
    hint = mazes.nearness()
    paid = certify(mazes.GRID, cr.RewardBonus(hint))
    assert paid.holds is False
    worst = paid.counterexample
    assert worst.components == dict(
        zip(("row", "column"), mazes.GRID.cells[worst.state].tolist(), strict=True)
    )
    assert paid.loss == pytest.approx(worst.lost)
    assert certify(mazes.GRID, cr.StateShaping(hint.to_state()))
    assert certify(mazes.GRID, cr.LookAheadAdvice(hint))


def test_at_discount_1_every_policy_must_end():
    ends = cr.FiniteMDP.from_outcomes(
        [[[(1.0, 1, 0.0)], [(1.0, 2, 1.0)]], [[(1.0, 2, 3.0)], [(1.0, 2, 0.0)]], [[], []]],
        terminal=[False, False, True], start=0, discount=1.0,
    )  # fmt: skip
    phi = cr.StatePotential(ends, [5.0, -7.0, 0.0])
    assert certify(ends, cr.StateShaping(phi))
    # At discount 1 a constant is no matter, the same at one end: a shift of all.
    assert certify(ends, cr.StateShaping([6.0, -6.0, 1.0]), ends="given")
    halved = certify(ends, ShapingReward(difference(np.array([0.0, 10.0, 0.0]), 0.5)))
    assert halved.holds is False
    assert "not potential-based" in halved.findings[0]
    endless = cr.GridWorld(["S..", "..T"], discount=1)
    certificate = certify(endless, cr.StateShaping(cr.StatePotential(endless, np.arange(6.0))))
    assert certificate.holds is None
    assert "an episode can go on for ever at discount 1" in str(certificate)
    # Going round costs without bound, so that both tasks have finite values to compare.
    line = cr.GridWorld("S.T", discount=1)
    certificate = certify(line, cr.StateShaping(np.arange(3.0)), method="exact")
    assert (certificate.holds, certificate.theorem) == (True, None)
    paid = cr.RewardBonus(np.full((6, 4), 2.0))
    with pytest.raises(SettingError, match="discount 1 needs every policy considered to end"):
        certify(endless, paid, method="exact")


@pytest.mark.parametrize("value", [1.0, 1e4, 1e6])
def test_a_potential_that_hides_a_difference_in_double_precision_is_not_called_safe(value):
    """The values 1e14 + 1e4 and 1e14 + 1e4 - 0.001 are one number of double precision."""
    task, _ = two_ways((value, value - 0.001), 0.0, ends=(1, 2))
    phi = cr.StateShaping([1e14, 0.0, 0.0])
    certificate = certify(task, phi)
    assert certificate.holds is None
    assert certificate.loss == pytest.approx(0.001, rel=0.01)
    assert "beside numbers of 1e+14 differences of 0.001 between actions vanish" in str(certificate)
    assert certify(task, phi, tolerance=0.01).holds


def test_a_theorem_decides_what_the_errors_of_values_cannot():
    """In a long corridor the differences of actions are of all sizes, down to 0.5^60."""
    corridor = cr.GridWorld("S" + "." * 60 + "T", rewards=cr.Rewards(step=0), discount=0.5)
    phi = 1e5 * np.random.default_rng(1).normal(size=(6, corridor.states.size))
    certificates = [
        certify(corridor, cr.StateShaping(cr.StatePotential(corridor, row))) for row in phi
    ]
    assert all(certificates)
    assert all(certificate.loss == 0 for certificate in certificates)


def test_a_changing_potential_is_compared_as_it_ends():
    frames, weight = RNG.normal(size=(3, 8)), cr.learning.linear(1.0, 0.5, steps=40)
    phi = cr.StatePotential(MAZE, frames, weight=weight, frame_steps=(0, 15, 300))
    certificate = certify(MAZE, cr.StateShaping(phi))
    assert certificate.holds
    sentence = "the potential changes while learning; its last values were compared"
    assert certificate.findings == (sentence,)
    ends_as = check_shaping(MAZE, cr.StateShaping(phi)).phi
    np.testing.assert_array_equal(ends_as, 0.5 * np.where(MAZE.mdp.terminal, 0, frames[2]))


HUNT = cr.Pursuit(size=3, predators=2)


@pytest.mark.parametrize("discount", [0.937, 1.0])
def test_only_the_ends_that_are_not_zero_are_named(discount):
    task = tree(discount)
    phi = np.append(RNG.normal(size=7), np.zeros(8))
    phi[9] = 3.25
    certificate = certify(task, ShapingReward(difference(phi, discount)))
    assert certificate.findings == ("terminal state 9 has Phi = 3.25, must be 0",)
    np.testing.assert_allclose(certificate.potential, phi, atol=1e-9)


def test_a_reward_of_the_action_has_no_potential():
    certificate = certify(MAZE, ShapingReward(lambda s, a, after: 1.0 * (a == 0)))
    assert certificate.potential is None
    assert certificate.findings[-1] == (
        "not potential-based: from state 0 (row 0, column 0) to state 0 (row 0, column 0), F is 1 "
        "by north and 0 by west; with a potential the action does not matter"
    )


def test_a_harmless_bonus_is_safe_but_not_potential_based():
    certificate = certify(MAZE, ShapingReward(lambda s, a, after: 0.01 * (a == 1)))
    assert certificate.holds is None  # of two ways that are as good it takes one
    assert 0 < certificate.loss < 1e-9
    assert str(certificate).startswith("Undecided within ")
    assert "first in state 0 (row 0, column 0): east is worth 3.851, under shaping" in str(
        certificate
    )
    lane = cr.GridWorld("S..T", discount=0.9)
    safe = certify(lane, ShapingReward(lambda s, a, after: 0.01 * (a == 1)))
    assert safe.holds
    assert safe.theorem is None
    assert "Not potential-based" in str(safe)


def nearly_a_potential(short):
    """Return a task of two ways to the end whose rewards are those of a potential and one less."""
    return cr.FiniteMDP.from_outcomes(
        [[[(1.0, 1, 1.0)], [(1.0, 2, 1.0)]], [[(1.0, 3, 1e-20)]] * 2,
         [[(1.0, 3, 1e-20 - short)]] * 2, [[], []]],
        terminal=[0, 0, 0, 1], start=0, discount=0.9,
    )  # fmt: skip


def test_a_tie_that_is_proven_stays_one_and_a_difference_too_small_to_be_known_is_undecided():
    reward = ShapingReward(difference(np.array([0.3, 0.7, 1.1, 0.0])))
    assert certify(nearly_a_potential(0.0), reward).theorem is not None
    close = certify(nearly_a_potential(1e-21), reward)
    assert close.holds is None
    assert "the shaping is safe, but beside numbers of" in close.findings[0]
    assert certify(nearly_a_potential(1e-21), reward, tolerance=1e-9)
    assert (
        certify(
            cr.GridWorld(["S...", "....", "...T"], discount=0.9),
            ShapingReward(difference(np.append(np.random.default_rng(0).normal(size=11), 0.0))),
        ).theorem
        is not None
    )


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
