"""Certificates of hand-sized tasks, of the paper's kind of bonus, of large tasks; bad input."""

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

import curricle as cr
from curricle.certificate.certification import Certificate, certify
from curricle.certificate.given import READ, ShapingReward, checked
from curricle.certificate.shaped import bonus_values, look_ahead_sweep, reached, ways_in
from curricle.deep import WeightTransfer
from curricle.errors import PotentialError, SettingError, TaskError
from curricle.paper import hacking
from curricle.planning.rollouts import random_rollouts
from curricle.transfer.potentials import mapped_potential

EXAMPLES = Path(__file__).parents[2] / "examples"
MAZE = cr.GridWorld(["S..", ".#.", "..T"], rewards=cr.Rewards(treasure=10), discount=0.9)
HUNT = cr.Pursuit(size=3, predators=2)
LARGE = cr.Pursuit(size=10, predators=3)
END = int(np.flatnonzero(MAZE.mdp.terminal)[0])
RNG = np.random.default_rng(5)
PHI = RNG.normal(size=MAZE.states.size) * 5
PAIRS = RNG.normal(size=(MAZE.states.size, 4)) * 5
ENDED = np.where(MAZE.mdp.terminal, 0.0, PHI)


def difference(phi, discount=0.9):
    return lambda s, a, after: discount * phi[after] - phi[s]


def away(distance=1.0):
    """A potential that calls the end worse than all else by so much."""
    return np.where(np.arange(MAZE.states.size) == END, -distance, 0.0)


# -- what is safe --------------------------------------------------------------------------------


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
    assert reached(walled.mdp).ends.tolist() == np.flatnonzero(walled.mdp.terminal).tolist()


@pytest.mark.parametrize(
    "shaping",
    [
        cr.StateShaping(cr.StatePotential(MAZE, 1e9 * PHI)),
        cr.LookAheadAdvice(cr.StateActionPotential(MAZE, 1e9 * PAIRS)),
    ],
)
def test_a_huge_potential_is_safe_and_the_error_told(shaping):
    found = certify(MAZE, shaping)
    assert found.holds
    assert found.error_bound > 1e-7
    assert found.tolerance >= 4 * found.error_bound


def test_the_tolerance_asked_for_is_the_one_used():
    found = certify(MAZE, cr.StateShaping(ENDED), tolerance=0.5)
    assert found.holds
    assert found.tolerance == 0.5
    slight = np.zeros((MAZE.states.size, 4))
    slight[0, 0] = 3.0  # worse than generative on by 1.9, but for this
    assert not certify(MAZE, cr.DecayingAdvice(slight))
    assert certify(MAZE, cr.DecayingAdvice(slight), tolerance=5.0)
    with pytest.raises(SettingError, match=r"tolerance must be at least .*: got 1e-15"):
        certify(MAZE, cr.StateShaping(ENDED), tolerance=1e-15)


# -- ends, discounts -----------------------------------------------------------------------------


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
    np.testing.assert_allclose(taken_apart.potential[reached(MAZE.mdp).states],
                               hint[reached(MAZE.mdp).states], atol=1e-6)  # fmt: skip


# -- rewards of one's own ------------------------------------------------------------------------


def test_a_reward_made_of_a_potential_is_recognised():
    found = certify(MAZE, ShapingReward(difference(ENDED)))
    states = reached(MAZE.mdp).states
    np.testing.assert_allclose(found.potential[states], ENDED[states], atol=1e-12)
    assert found.residual < 1e-12
    assert found.findings[0].startswith("F = 0.9 Phi(s') - Phi(s) with Phi = 0 at the ends, to ")


def test_a_reward_made_of_a_potential_with_open_ends_is_recognised():
    found = certify(MAZE, ShapingReward(difference(PHI)))
    met = reached(MAZE.mdp)
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


def test_a_reward_that_looks_at_the_action_is_no_potential():
    found = certify(MAZE, ShapingReward(lambda s, a, after: 1.0 * (a == 0)))
    assert found.potential is None
    assert found.findings == (
        "not potential-based: from state 0 (row 0, column 0) to state 0 (row 0, column 0), F is 1 "
        "by north and 0 by west; a potential is blind to actions",
    )


def test_a_reward_that_pays_two_ways_differently_is_no_potential():
    # 1 for standing in the east: the way there and back earns, staying in the west does not.
    found = certify(MAZE, ShapingReward(lambda s, a, after: np.sin(7.0 * s)))
    assert found.potential is None
    assert "not potential-based: on from state" in found.findings[0]
    assert found.residual > 0.1


def test_a_harmless_bonus_is_safe_yet_called_what_it_is():
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
    # A policy of the shaped optimum walks on for ever: -1 a step, instead of the way to 20.
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
    states = reached(hacking.MAZE.mdp).states
    assert followed.values[states] == pytest.approx(-20.0)
    assert paid.total_loss == pytest.approx((best.values - followed.values)[states].max())
    assert paid.loss == pytest.approx(worst.lost)
    assert certify(hacking.MAZE, cr.StateShaping(hint.to_state()))
    assert certify(hacking.MAZE, cr.LookAheadAdvice(hint))


def test_a_reward_is_asked_in_blocks(monkeypatch):
    whole = certify(HUNT, ShapingReward(lambda s, a, after: 1.0 * (s == after)))
    asked = []

    def bonus(s, a, after):
        asked.append(len(s))
        return 1.0 * (s == after)

    monkeypatch.setattr("curricle.certificate.shaped.BLOCK", 5_000)
    parts = certify(HUNT, ShapingReward(bonus))
    assert len(asked) > 10
    assert max(asked) <= 5_000
    assert (parts.holds, parts.loss, parts.residual) == (whole.holds, whole.loss, whole.residual)
    assert parts.findings == whole.findings


# -- other ways ----------------------------------------------------------------------------------


def tree(discount=0.9):
    """7 states, 2 actions, 8 ends; each state is entered in one way."""
    reward = np.random.default_rng(1).normal(size=(7, 2))
    outcomes = [[[(1.0, 2 * s + 1 + a, reward[s, a])] for a in range(2)] for s in range(7)]
    return cr.FiniteMDP.from_outcomes(
        outcomes + [[[], []]] * 8, terminal=np.arange(15) >= 7, start=0, discount=discount
    )


def test_look_back_advice_is_safe_where_each_state_has_one_past():
    task = tree()
    found = certify(task, cr.LookBackAdvice(np.random.default_rng(2).normal(size=(15, 2)) * 9))
    assert found.holds
    assert found.residual < 1e-6


def test_look_back_advice_does_not_mind_an_end_with_two_pasts():
    fork = [[[(1.0, 1, 1.0)], [(1.0, 2, 0.0)]], [[(1.0, 3, 0.0)]] * 2, [[(1.0, 3, 2.0)]] * 2]
    task = cr.FiniteMDP.from_outcomes(
        [*fork, [[], []]], terminal=[False, False, False, True], start=0, discount=0.9
    )
    phi = np.array([[1.0, 5.0], [2.0, 7.0], [3.0, -4.0], [0.0, 0.0]])
    assert certify(task, cr.LookBackAdvice(phi))
    sample = certify(task, cr.LookBackAdvice(phi), method="sampled", steps=8_000)
    assert "no contradiction in" in sample.findings[0]


def test_look_back_advice_cannot_be_promised_where_ways_meet():
    choice, after = [[(1.0, 1, 1.0)], [(1.0, 2, 0.0)]], [[(1.0, 3, 0.0)]] * 2
    elsewhere = [[(0.5, 1, 0.0), (0.5, 2, 0.0)]] * 2
    task = cr.FiniteMDP.from_outcomes(
        [choice, after, after, [[], []], elsewhere],
        terminal=[False, False, False, True, False], start=[0.1, 0, 0, 0, 0.9], discount=0.9,
    )  # fmt: skip
    phi = np.zeros((5, 2))
    phi[0, 1] = 5.0
    found = certify(task, cr.LookBackAdvice(cr.StateActionPotential(task, phi)))
    assert found.holds is None
    assert not found
    assert np.isnan(found.loss)
    assert found.findings == (
        "look-back advice is sure to keep the optimum only where every state is entered in one "
        "way: state 2 is entered with phi = 5 from state 0 by action 1 and with phi = 0 from state "
        "4 by action 0",
    )
    assert str(found).startswith("Not proven: look-back advice is sure to")


def test_the_start_of_an_episode_is_a_past_of_its_own():
    loop = cr.GridWorld("ST")
    phi = np.full((2, 4), 2.0)
    found = certify(loop, cr.LookBackAdvice(phi))
    assert found.holds is None
    assert "with phi = 0 where an episode starts" in str(found)
    least, most = ways_in(reached(loop.mdp), phi)
    assert (least[0], most[0]) == (0.0, 2.0)


@pytest.mark.parametrize(
    ("weight", "holds", "said"),
    [
        (1.0, False, "Q + phi"),
        (0.5, False, "Q + 0.5 phi"),
        (cr.learning.linear(1.0, 0.0, steps=10), True, "Q alone"),
        (cr.learning.exponential(1.0, half_life=1e9), True, "Q alone"),
        (cr.learning.harmonic(1.0, 0.25), False, "Q + 0.25 phi"),
    ],
)
def test_advice_is_judged_by_what_its_weight_goes_to(weight, holds, said):
    q = cr.solve(MAZE).action_values
    found = certify(MAZE, cr.DecayingAdvice(-9.0 * q, weight=weight))
    assert found.holds is holds
    assert found.findings == (f"in the long run the policy acts on {said}",)


def test_advice_that_agrees_is_safe_with_any_weight():
    agreeing = cr.StateActionPotential(MAZE, cr.solve(MAZE).action_values)
    assert certify(MAZE, cr.DecayingAdvice(agreeing))


FRAMES = RNG.normal(size=(3, MAZE.states.size))


def changing(kind=cr.StatePotential, **settings):
    settings = {
        "weight": cr.learning.linear(1.0, 0.5, steps=40),
        "frame_steps": (0, 15, 300),
        **settings,
    }
    return kind(MAZE, FRAMES, **settings)


def test_a_changing_potential_is_compared_as_it_ends_and_checked_in_time():
    found = certify(MAZE, cr.StateShaping(changing()))
    assert found.holds
    assert found.findings == ("it changes while learning and was compared as it ends up",)
    ends_as = checked(MAZE, cr.StateShaping(changing())).final()
    np.testing.assert_array_equal(ends_as, 0.5 * np.where(MAZE.mdp.terminal, 0, FRAMES[2]))


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"weight": 1.0, "frame_steps": (0, 3_000, 500_000)},  # at two moments only
        {"weight": cr.learning.exponential(1.0, 0.5, half_life=10)},
    ],
)
def test_a_changing_potential_that_forgets_the_time_is_not_called_safe(change):
    class Forgetful(cr.StatePotential):
        def shaping_reward(self, state, next_state, *, step=0):
            now = self.at(step)
            return 0.9 * now[next_state] - now[state]  # Phi(s', t) in place of Phi(s', t + 1)

    assert certify(MAZE, cr.StateShaping(changing(**change)))
    found = certify(MAZE, cr.StateShaping(changing(Forgetful, **change)))
    assert found.holds is None
    assert "F does not telescope" in str(found)


def test_a_changing_potential_is_checked_all_the_time_that_it_changes():
    class Tiring(cr.StatePotential):
        def shaping_reward(self, state, next_state, *, step=0):
            when = step if step < 50_000 else 50_000
            return super().shaping_reward(state, next_state, step=when)

    weight = cr.learning.linear(1.0, 0.0, steps=100_000)
    assert certify(MAZE, cr.StateShaping(cr.StatePotential(MAZE, PHI, weight=weight)))
    assert certify(MAZE, cr.StateShaping(Tiring(MAZE, PHI, weight=weight))).holds is None


# -- discount 1 ----------------------------------------------------------------------------------


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


# -- large tasks ---------------------------------------------------------------------------------


def hidden(s):
    """A potential of the large pursuit, 0 where the prey is caught."""
    d = LARGE.states.decode(s)
    return np.sin(3.0 * d["prey"] + d["predator_2"]) * ~LARGE.terminal[s]


def large_mapped():
    alone = cr.Pursuit(size=10, predators=1)
    values = RNG.normal(size=(alone.states.size, 5))
    edges = [
        cr.Transfer("a", "b", cr.project(LARGE, alone, predator=f"predator_{i}")) for i in (1, 3)
    ]
    return mapped_potential(LARGE, edges, [values] * 2, cr.minimum)


def test_a_large_task_is_sampled():
    found = certify(
        LARGE, ShapingReward(lambda s, a, t: 0.99 * hidden(t) - hidden(s)), steps=30_000
    )
    assert found.holds is None
    assert (found.method, found.states) == ("sampled", 0)
    assert 25_000 < found.steps <= 30_000
    assert found.residual < 1e-9
    assert str(found) == (
        f"Not proven: no contradiction in {found.steps:,} sampled steps (states x actions x "
        "outcomes of the task exceed 20,000,000)."
    )


@pytest.mark.parametrize(
    "bonus",
    [
        lambda s, a, t: 0.9 * hidden(t) - hidden(s),  # a second discount
        lambda s, a, t: 1.0 * (s == t),
        lambda s, a, t: hidden(t),
        lambda s, a, t: 1.0 * (a % 7 == 0),
    ],
)
def test_a_large_task_is_sampled_and_contradicts(bonus):
    found = certify(LARGE, ShapingReward(bonus), steps=30_000)
    assert found.holds is None
    assert found.residual > 0.01
    assert "two ways of" in found.findings[0] or "blind to actions" in found.findings[0]
    assert found.findings[-1].startswith(f"this is by {found.steps:,} sampled steps")


@pytest.mark.parametrize("kind", [cr.QInitialisation, cr.LookAheadAdvice])
def test_a_mapped_potential_of_a_large_task_telescopes(kind):
    found = certify(LARGE, kind(large_mapped()), steps=20_000)
    assert found.holds is None
    assert "no contradiction" in str(found)
    assert found.residual < 1e-9


def test_a_mapped_potential_of_a_large_task_in_other_ways():
    phi = large_mapped()
    assert "look-back advice is sure" in str(certify(LARGE, cr.LookBackAdvice(phi), steps=20_000))
    assert "not potential-based" in str(certify(LARGE, cr.RewardBonus(phi), steps=20_000))
    advice = certify(LARGE, cr.DecayingAdvice(phi))
    assert advice.holds is None
    assert str(advice) == "Not proven: in the long run the policy acts on Q + phi."


def test_decaying_advice_needs_no_tables():
    task, _ = boat()
    fading = cr.learning.exponential(1.0, half_life=9)
    found = certify(task, cr.DecayingAdvice(np.ones((task.states.size, 5)), weight=fading))
    assert found.holds
    assert str(found) == "Safe: in the long run the policy acts on Q alone."


def test_phi_is_read_where_walks_lead():
    small, alone = cr.Pursuit(size=3, predators=2), cr.Pursuit(size=3, predators=1)
    edge = cr.Transfer("a", "b", cr.project(small, alone, predator="predator_2"))
    phi = mapped_potential(small, [edge], [RNG.normal(size=(81, 5))], cr.maximum)
    live = np.flatnonzero(~small.terminal)
    np.testing.assert_array_equal(phi.rows(live), phi.values[live])
    pairs = np.repeat(live, 25), np.tile(np.arange(25), len(live))
    assert len(pairs[0]) > READ  # more than one block
    np.testing.assert_array_equal(
        checked(small, cr.RewardBonus(phi)).at_pairs(*pairs), phi.values[pairs]
    )
    whole = certify(small, cr.QInitialisation(phi), method="sampled", steps=5_000)
    given = certify(
        small,
        cr.QInitialisation(cr.StateActionPotential(small, phi.values)),
        method="sampled",
        steps=5_000,
    )
    assert whole.residual == pytest.approx(given.residual, abs=1e-12)
    assert whole.findings == given.findings


def boat():
    sys.path.insert(0, str(EXAMPLES))
    try:
        import own_task
    finally:
        sys.path.remove(str(EXAMPLES))
    task = own_task.lake(5, 3)
    harbour = (task.states.decode()["x"] == 0) & (task.states.decode()["y"] == 0)
    return task, harbour


def test_a_computed_task_is_sampled():
    task, harbour = boat()
    phi = RNG.normal(size=task.states.size)
    ended = np.where(harbour, 0.0, phi)
    # Which states are ends is not known; learning takes them for 0 when it comes there.
    for own in (
        certify(task, cr.StateShaping(cr.StatePotential(task, phi)), steps=10_000),
        certify(task, cr.StateShaping(ended), steps=10_000),
        certify(task, ShapingReward(difference(ended, 0.99)), steps=10_000),
        certify(
            task,
            cr.QInitialisation(cr.StateActionPotential(task, np.outer(phi, [1, 2, 3, 4, 5]))),
            steps=10_000,
        ),
        certify(
            task,
            cr.StateShaping(
                cr.StatePotential(task, phi, weight=cr.learning.linear(1, 0, steps=30))
            ),
        ),
    ):
        assert own.holds is None
        assert own.method == "sampled"
        assert "Not proven: no contradiction in" in str(own)
        assert "(the task has no tables)" in str(own)
    for wrong in (
        certify(task, cr.StateShaping(phi), steps=10_000),
        certify(task, cr.StateShaping(ended), shaping_discount=0.9, steps=10_000),
        certify(task, cr.LookAheadAdvice(np.outer(phi, [1, 2, 3, 4, 5])), steps=10_000),
        certify(task, ShapingReward(difference(phi, 0.99)), steps=10_000),
        certify(task, ShapingReward(difference(ended, 0.9)), steps=10_000),
    ):
        assert wrong.holds is None
        assert "does not telescope" in str(wrong) or "not potential-based" in str(wrong)
    with pytest.raises(TaskError, match="has no tables"):
        certify(task, cr.StateShaping(phi), method="exact")


def test_a_cut_is_no_end():
    """Potentials that are large where walks are cut off telescope all the same."""
    short = cr.GridWorld(["S....", "....T"], time_limit=3, discount=0.9)
    phi = np.where(short.mdp.terminal, 0.0, 100.0 * np.arange(10))
    assert "no contradiction" in str(certify(short, cr.StateShaping(phi), method="sampled"))
    pairs = np.outer(phi, [1.0, 2.0, 3.0, 4.0])
    assert "no contradiction" in str(certify(short, cr.LookAheadAdvice(pairs), method="sampled"))


def test_loops_at_discount_1_must_earn_nothing():
    endless = cr.GridWorld(["S..", "..T"], discount=1)
    paid = certify(endless, ShapingReward(lambda s, a, after: 1.0 * (after > s)), steps=4_000)
    assert "not potential-based" in paid.findings[0]
    assert any("where a potential pays nothing" in said or "asks for Phi" in said
               for said in paid.findings)  # fmt: skip
    assert paid.residual >= 1
    potential = certify(endless, ShapingReward(difference(np.array([4.0, 2, 7, 1, 3, 0]), 1.0)))
    assert "no contradiction" in str(potential)
    # Round and round, one way only: nothing meets, nothing ends.
    ring = cr.FiniteMDP.from_outcomes(
        [[[(1.0, (s + 1) % 3, 0.0)]] for s in range(3)],
        terminal=[False] * 3, start=0, discount=1.0, time_limit=50,
    )  # fmt: skip
    paid = certify(ring, ShapingReward(lambda s, a, after: 0.5), steps=400)
    assert paid.findings[0].endswith("is paid 1.5, where a potential pays nothing")
    balanced = certify(
        ring, ShapingReward(lambda s, a, after: np.array([1.0, 2.0, -3.0])[s]), steps=400
    )
    assert "no contradiction" in str(balanced)


def test_equal_seeds_agree_and_others_differ():
    once, again, other = (random_rollouts(LARGE, episodes=4, length=9, seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(once.states, again.states)
    assert (once.states != other.states).any()


def test_walks_follow_the_task():
    walks = random_rollouts(MAZE, episodes=200, length=60, seed=3)
    mdp, taken = MAZE.mdp, walks.taken
    here, after = walks.states[:, :-1][taken], walks.states[:, 1:][taken]
    row = mdp.outcome_row[here, walks.actions[taken]]
    np.testing.assert_array_equal(mdp.next_state[row, 0], after)
    assert not mdp.terminal[here].any()
    np.testing.assert_array_equal(mdp.terminal[walks.states[:, -1]], walks.terminated)
    np.testing.assert_array_equal(walks.ending.sum(axis=1), walks.terminated)
    assert 0 < walks.terminated.sum() < 200 or walks.terminated.all()
    assert (walks.length[~walks.terminated] == 60).all()
    # Every action is as likely: 4 standard deviations, one false alarm in 4,000 streams.
    n = taken.sum()
    counts = np.bincount(walks.actions[taken], minlength=4)
    assert abs(counts / n - 0.25).max() < 4 * np.sqrt(0.25 * 0.75 / n)
    # What the task does does not depend on the draw of the action: within 5 standard deviations.
    chase = cr.Pursuit(size=9, predators=1)
    walks = random_rollouts(chase, episodes=400, length=50)
    first, then = (chase.states.decode(walks.states[:, i])["prey"] for i in (0, 1))
    joint = np.zeros((5, 5))
    moved = [0, -9, 1, 9, -1]
    inside = np.isin(first // 9, range(1, 8)) & np.isin(first % 9, range(1, 8))
    for prey, move in enumerate(moved):
        joint[:, prey] = np.bincount(
            walks.actions[inside & (then - first == move), 0], minlength=5
        )  # fmt: skip
    assert joint.sum() == inside.sum()
    assert abs(joint - joint.sum() / 25).max() < 5 * np.sqrt(joint.sum() / 25)
    given = random_rollouts(MAZE, episodes=3, length=1, starts=np.array([2, 0, 1]))
    assert given.states[:, 0].tolist() == [2, 0, 1]


# -- records and bad input -----------------------------------------------------------------------


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


OTHER = cr.GridWorld("S.T")
BAD = {
    "a shape": (
        PotentialError, r"shape \(8,\) or \(M, 8\): got \(3,\)",
        lambda: certify(MAZE, cr.StateShaping([1, 2, 3])),
    ),
    "states for pairs": (
        PotentialError, r"shape \(8, 4\): got \(8,\)",
        lambda: certify(MAZE, cr.QInitialisation(np.zeros(8))),
    ),
    "frames as an array": (
        PotentialError, r"got \(2, 8\)", lambda: certify(MAZE, cr.StateShaping(np.zeros((2, 8)))),
    ),
    "NaN": (
        PotentialError, r"entry \(4,\) is nan",
        lambda: certify(MAZE, cr.StateShaping(np.where(np.arange(8) == 4, np.nan, 0))),
    ),
    "text": (PotentialError, "array of numbers", lambda: certify(MAZE, cr.StateShaping("hint"))),
    "nothing": (SettingError, "have a potential", lambda: certify(MAZE, cr.StateShaping())),
    "no shaping": (
        SettingError, "must be a shaping, such as StateShaping", lambda: certify(MAZE, ENDED),
    ),
    "a shaping of networks": (
        SettingError, "must be for tables", lambda: certify(MAZE, WeightTransfer(ENDED)),
    ),
    "a function elsewhere": (
        PotentialError, "phi must be an array of numbers",
        lambda: certify(MAZE, cr.StateShaping(difference(ENDED))),
    ),
    "no function": (
        SettingError, "ShapingReward takes a function", lambda: certify(MAZE, ShapingReward(ENDED)),
    ),
    "the wrong kind": (
        SettingError, r"QInitialisation takes a potential phi\(s, a\): got a StatePotential",
        lambda: certify(MAZE, cr.QInitialisation(cr.StatePotential(MAZE, PHI))),
    ),
    "another task's": (
        SettingError, "made for the task it shapes",
        lambda: certify(MAZE, cr.StateShaping(cr.StatePotential(OTHER, [0, 0, 0]))),
    ),
    "a discount of 2": (
        SettingError, r"shaping_discount must lie in \[0, 1\]: got 2",
        lambda: certify(MAZE, cr.StateShaping(ENDED), shaping_discount=2),
    ),
    "a discount for nothing": (
        SettingError, "goes with StateShaping: got DecayingAdvice",
        lambda: certify(MAZE, cr.DecayingAdvice(PAIRS), shaping_discount=0.9),
    ),
    "look-back without discount": (
        SettingError, "must be positive: got 0",
        lambda: certify(cr.GridWorld("ST", discount=0), cr.LookBackAdvice(np.zeros((2, 4)))),
    ),
    "a tolerance of 0": (
        SettingError, "tolerance must be positive: got 0",
        lambda: certify(MAZE, cr.StateShaping(ENDED), tolerance=0),
    ),
    "a method": (
        SettingError, "method must be one of auto, exact, sampled: got 'guess'",
        lambda: certify(MAZE, cr.StateShaping(ENDED), method="guess"),
    ),
    "no steps": (
        SettingError, "steps to sample must be a whole number, at least 1: got 0",
        lambda: certify(MAZE, cr.StateShaping(ENDED), steps=0),
    ),
    "a seed": (
        SettingError, "seed must be a whole number",
        lambda: certify(MAZE, cr.StateShaping(ENDED), seed=-1),
    ),
    "no task": (TaskError, "a task must be", lambda: certify(3, cr.StateShaping(ENDED))),
    "a reward of NaN": (
        PotentialError, "must be finite: it is nan from state 0 .* by north to state 0",
        lambda: certify(MAZE, ShapingReward(lambda s, a, t: np.where(s == t, np.nan, 0))),
    ),
    "a reward of another shape": (
        PotentialError, r"a number for each of 28 transitions: got \(2,\)",
        lambda: certify(MAZE, ShapingReward(lambda s, a, t: np.zeros(2))),
    ),
    "a reward of text": (
        PotentialError, "a number for each of 28 transitions: got 'much'",
        lambda: certify(MAZE, ShapingReward(lambda s, a, t: "much")),
    ),
    "a reward of NaN, sampled": (
        PotentialError, "must be finite: it is nan from state",
        lambda: certify(LARGE, ShapingReward(lambda s, a, t: np.where(s == t, np.nan, 0)),
            steps=5_000),
    ),
    "starts for other walks": (
        SettingError, r"starts must have shape \(2,\)",
        lambda: random_rollouts(MAZE, episodes=2, length=1, starts=np.array([0])),
    ),
    "random rollouts of no steps": (
        SettingError, "length of a random rollout in steps must be",
        lambda: random_rollouts(MAZE, episodes=2, length=0)
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused_in_one_sentence(case):
    error, said, call = BAD[case]
    with pytest.raises(error, match=said) as raised:
        call()
    assert "\n" not in str(raised.value)


def test_a_scalar_reward_stands_for_all():
    nothing = np.zeros(3, np.int64)
    assert bonus_values(MAZE, lambda s, a, t: 2, nothing, nothing, nothing).tolist() == [2.0] * 3
