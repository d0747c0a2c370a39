"""Certificates of large tasks, from sampled steps and random rollouts; what certify refuses."""

import sys
from pathlib import Path

import numpy as np
import pytest

import curricle as cr
from curricle.certificate import SampledCertificate, ShapingReward, certify
from curricle.certificate.shaped_task import check_shaping, widest
from curricle.deep import WeightTransfer
from curricle.errors import PotentialError, SettingError, TaskError
from curricle.learning.potential import STATES_READ
from curricle.planning.rollouts import random_rollouts
from curricle.transfer.potential import mapped_potential
from tests.certificates import ENDED, MAZE, PAIRS, RNG, difference
from tests.refusals import check_refusal

EXAMPLES = Path(__file__).parents[2] / "examples"


LARGE = cr.Pursuit(size=10, predators=3)


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
    certificate = certify(
        LARGE, ShapingReward(lambda s, a, t: 0.99 * hidden(t) - hidden(s)), steps=30_000
    )
    assert certificate.holds is None
    assert isinstance(certificate, SampledCertificate)
    assert not certificate
    assert 25_000 < certificate.steps <= 30_000
    assert certificate.residual < 1e-9
    assert f"no contradiction in {certificate.steps:,} sampled steps" in str(certificate)


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
    certificate = certify(LARGE, ShapingReward(bonus), steps=30_000)
    assert certificate.holds is None
    assert certificate.residual > 0.01
    first = certificate.contradictions[0]
    assert "two paths of" in first or "the action does not matter" in first
    assert f"Found in {certificate.steps:,} sampled steps" in str(certificate)


@pytest.mark.parametrize("kind", [cr.QInitialisation, cr.LookAheadAdvice])
def test_a_mapped_potential_of_a_large_task_is_safe_by_theory(kind):
    certificate = certify(LARGE, kind(large_mapped()))
    assert certificate
    assert (certificate.states, certificate.loss) == (0, 0)
    assert certificate.theorem == "Wiewiora 2003"


def test_a_mapped_potential_of_a_large_task_in_other_ways():
    phi = large_mapped()
    assert "look-back advice keeps the optimum for certain only" in str(
        certify(LARGE, cr.LookBackAdvice(phi), steps=20_000)
    )
    assert "not potential-based" in str(certify(LARGE, cr.RewardBonus(phi), steps=20_000))
    advice = certify(LARGE, cr.DecayingAdvice(phi))
    assert advice.holds is None
    assert str(advice).endswith("In the long run the policy acts on Q + phi.")


def test_phi_is_read_where_rollouts_go():
    small, alone = cr.Pursuit(size=3, predators=2), cr.Pursuit(size=3, predators=1)
    edge = cr.Transfer("a", "b", cr.project(small, alone, predator="predator_2"))
    phi = mapped_potential(small, [edge], [RNG.normal(size=(81, 5))], cr.maximum)
    live = np.flatnonzero(~small.terminal)
    np.testing.assert_array_equal(phi.pairs(live), phi.values[live])
    pairs = np.repeat(live, 25), np.tile(np.arange(25), len(live))
    assert len(pairs[0]) > STATES_READ  # more than one chunk
    np.testing.assert_array_equal(
        check_shaping(small, cr.RewardBonus(phi)).phi_of(*pairs), phi.values[pairs]
    )
    whole, by_array = (
        certify(small, cr.RewardBonus(potential), method="sampled", steps=5_000)
        for potential in (phi, cr.StateActionPotential(small, phi.values))
    )
    assert whole.residual == pytest.approx(by_array.residual, abs=1e-12)
    assert whole.contradictions == by_array.contradictions


def boat():
    sys.path.insert(0, str(EXAMPLES))
    try:
        import own_task
    finally:
        sys.path.remove(str(EXAMPLES))
    task = own_task.lake(5, 3)
    harbour = (task.states.decode()["x"] == 0) & (task.states.decode()["y"] == 0)
    return task, harbour


def test_a_task_without_tables_is_judged_by_theory_or_sampled():
    task, harbour = boat()
    phi = RNG.normal(size=task.states.size)
    ended = np.where(harbour, 0.0, phi)
    pairs = np.outer(phi, [1, 2, 3, 4, 5])
    fading = cr.StatePotential(task, phi, weight=cr.learning.linear(1, 0, steps=30))
    # Which states are ends is not known; learning takes them for 0 when it comes there.
    for shaping in (
        cr.StateShaping(cr.StatePotential(task, phi)),
        cr.StateShaping(ended),
        cr.QInitialisation(cr.StateActionPotential(task, pairs)),
        cr.StateShaping(fading),
    ):
        assert certify(task, shaping).theorem
    for shaping, settings, finding in (
        (cr.StateShaping(phi), {"ends": "given"}, "its ends are not known"),
        (cr.LookAheadAdvice(pairs), {"ends": "given"}, "its ends are not known"),
        (cr.StateShaping(ended), {"shaping_discount": 0.9}, "shaped with a second discount"),
    ):
        certificate = certify(task, shaping, **settings)
        assert certificate.holds is None
        assert any(sentence.startswith(finding) for sentence in certificate.findings)
    sample = certify(task, ShapingReward(difference(ended, 0.99)), steps=10_000)
    assert isinstance(sample, SampledCertificate)
    assert "Not proven: no contradiction in" in str(sample)
    assert "(the task has no tables)" in str(sample)
    for wrong in (difference(phi, 0.99), difference(ended, 0.9)):
        sample = certify(task, ShapingReward(wrong), steps=10_000)
        assert sample.holds is None
        assert "o potential that is 0 at the ends: one path from " in str(sample)
    with pytest.raises(TaskError, match="has no tables"):
        certify(task, cr.StateShaping(phi), method="exact")


def test_a_live_task_is_sampled_from_its_starts():
    class Line:
        def reset(self, seed=None):
            self.place = 3
            return 3, {}

        def step(self, action):
            self.place += 2 * action - 1
            return self.place, 0.0, self.place in (0, 7), False, {}

        def close(self):
            pass

    live = cr.tasks.LiveMDP(
        cr.Space([cr.Component("place", 8)]), cr.Space([cr.Component("move", 2)]), Line
    )
    phi = np.array([0.0, 5, 2, 8, 1, 9, 3, 0])
    good = certify(live, ShapingReward(difference(phi, 0.99)), steps=3_000)
    assert isinstance(good, SampledCertificate)
    assert good.contradictions == ()
    assert 100 < good.steps <= 3_000
    bonus = certify(live, ShapingReward(lambda s, a, after: 1.0 * (after > s)), steps=3_000)
    assert "not potential-based" in bonus.contradictions[0]


def test_rewards_over_loops_at_discount_1_must_add_up_to_0():
    endless = cr.GridWorld(["S..", "..T"], discount=1)
    paid = certify(endless, ShapingReward(lambda s, a, after: 1.0 * (after > s)), steps=4_000)
    assert "not potential-based" in paid.contradictions[0]
    assert any("over a loop through" in finding or "requires Phi" in finding
               for finding in paid.contradictions)  # fmt: skip
    assert paid.residual >= 1
    potential = certify(endless, ShapingReward(difference(np.array([4.0, 2, 7, 1, 3, 0]), 1.0)))
    assert "no contradiction" in str(potential)
    # Round and round, one way only: nothing meets, nothing ends.
    ring = cr.FiniteMDP.from_outcomes(
        [[[(1.0, (s + 1) % 3, 0.0)]] for s in range(3)],
        terminal=[False] * 3, start=0, discount=1.0, time_limit=50,
    )  # fmt: skip
    paid = certify(ring, ShapingReward(lambda s, a, after: 0.5), steps=400)
    assert paid.contradictions[0].startswith(
        "not potential-based: F adds up to 1.5 over a loop through state "
    )
    balanced = certify(
        ring, ShapingReward(lambda s, a, after: np.array([1.0, 2.0, -3.0])[s]), steps=400
    )
    assert "no contradiction" in str(balanced)


def test_rollouts_follow_the_task():
    rollouts = random_rollouts(MAZE, episodes=200, length=60, seed=3)
    mdp, taken = MAZE.mdp, rollouts.taken
    here, after = rollouts.states[:, :-1][taken], rollouts.states[:, 1:][taken]
    row = mdp.outcome_row[here, rollouts.actions[taken]]
    np.testing.assert_array_equal(mdp.next_state[row, 0], after)
    assert not mdp.terminal[here].any()
    np.testing.assert_array_equal(mdp.terminal[rollouts.states[:, -1]], rollouts.terminated)
    np.testing.assert_array_equal(rollouts.ending.sum(axis=1), rollouts.terminated)
    assert 0 < rollouts.terminated.sum() < 200 or rollouts.terminated.all()
    assert (rollouts.length[~rollouts.terminated] == 60).all()
    # Every action is as likely: 4 standard deviations, one false alarm in 4,000 streams.
    n = taken.sum()
    counts = np.bincount(rollouts.actions[taken], minlength=4)
    assert abs(counts / n - 0.25).max() < 4 * np.sqrt(0.25 * 0.75 / n)
    # What the task does does not depend on the draw of the action: within 5 standard deviations.
    chase = cr.Pursuit(size=9, predators=1)
    rollouts = random_rollouts(chase, episodes=400, length=50)
    first, then = (chase.states.decode(rollouts.states[:, i])["prey"] for i in (0, 1))
    joint = np.zeros((5, 5))
    moved = [0, -9, 1, 9, -1]
    inside = np.isin(first // 9, range(1, 8)) & np.isin(first % 9, range(1, 8))
    for prey, move in enumerate(moved):
        joint[:, prey] = np.bincount(
            rollouts.actions[inside & (then - first == move), 0], minlength=5
        )  # fmt: skip
    assert joint.sum() == inside.sum()
    assert abs(joint - joint.sum() / 25).max() < 5 * np.sqrt(joint.sum() / 25)
    from_starts = random_rollouts(MAZE, episodes=3, length=1, starts=np.array([2, 0, 1]))
    assert from_starts.states[:, 0].tolist() == [2, 0, 1]


def test_the_widest_difference_is_of_equal_keys():
    keys, values = np.array([[1], [2], [1]]), np.array([5.0, 0.0, 3.0])
    assert widest(keys, values) == (2.0, 0, 2)


FOREIGN = cr.StatePotential(cr.GridWorld("S.T"), [0, 0, 0])


def safe():
    return cr.StateShaping(ENDED)


NOT_A_NUMBER = ShapingReward(lambda s, a, t: np.where(s == t, np.nan, 0))


def at_4(value):
    """Return a Phi of the maze that is 0 but in state 4."""
    return np.where(np.arange(8) == 4, value, 0)


REFUSED = [
    (PotentialError, lambda: cr.StateShaping(at_4(-1e285)), {}, r"entry \(4,\) is -1e\+285"),
    (PotentialError, lambda: ShapingReward(lambda s, a, t: 2e285), {}, r"size: it is 2e\+285 from"),
    (PotentialError, lambda: cr.StateShaping(difference(ENDED)), {}, "phi must be an array of num"),
    (PotentialError, lambda: NOT_A_NUMBER, {}, "it is nan from state 0 .* north to state 0"),
    (PotentialError, lambda: ShapingReward(lambda s, a, t: np.zeros(2)), {}, r"28 tr.*got \(2,\)"),
    (SettingError, lambda: cr.StateShaping(), {}, "have a potential"),
    (SettingError, lambda: ENDED, {}, "takes a shaping, such as StateShaping"),
    (SettingError, lambda: WeightTransfer(ENDED), {}, "must be for tables"),
    (SettingError, lambda: ShapingReward(ENDED), {}, "ShapingReward takes a function"),
    (SettingError, lambda: cr.StateShaping(FOREIGN), {}, "made for the task it shapes"),
    (SettingError, safe, {"shaping_discount": 2}, r"discount must lie in \[0, 1\]: got 2"),
    (SettingError, safe, {"tolerance": -1}, "tolerance must be at least 0: got -1"),
    (SettingError, safe, {"ends": "open"}, "ends must be one of zero, given: got 'open'"),
    (SettingError, safe, {"method": "guess"}, "one of auto, exact, sampled: got 'guess'"),
    (SettingError, safe, {"steps": 0}, "sample must be a whole number, at least 1: got 0"),
    (SettingError, safe, {"seed": -1}, "seed must be a whole number"),
    (SettingError, lambda: cr.DecayingAdvice(PAIRS), {"shaping_discount": 0.9}, "got DecayingAdv"),
]


@pytest.mark.parametrize(("error", "shaping", "settings", "says"), REFUSED)
def test_what_makes_no_sense_is_refused_in_one_sentence(error, shaping, settings, says):
    check_refusal(error, lambda: certify(MAZE, shaping(), **settings), says)


def test_bad_tasks_and_what_does_not_go_with_a_task_or_shaping_are_refused():
    phi = cr.StateShaping(ENDED)
    check_refusal(TaskError, lambda: certify(3, phi), "a task must be")
    seen = cr.observation_task("CartPole-v1")
    check_refusal(TaskError, lambda: certify(seen, phi), "a FiniteMDP .* got ObservationTask")
    huge = cr.QInitialisation(np.full((8, 4), 1e308))
    says = r"phi must be at most 1e\+15 in size, .*: entry \(0, 0\) is 1e\+308"
    check_refusal(PotentialError, lambda: cr.learn(MAZE, budget=10, shaping=huge), says)
    says = "must be finite: it is nan from state"
    check_refusal(PotentialError, lambda: certify(LARGE, NOT_A_NUMBER, steps=5_000), says)
    impatient, back = cr.GridWorld("ST", discount=0), cr.LookBackAdvice(np.zeros((2, 4)))
    check_refusal(SettingError, lambda: certify(impatient, back), "must be positive: got 0")


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"length": 1, "starts": np.array([0])}, "starts must be as many as episodes, 2: got 1"),
        ({"length": 0}, "length of a random rollout in steps must be"),
    ],
)
def test_bad_rollouts_are_refused_in_one_sentence(settings, says):
    check_refusal(SettingError, lambda: random_rollouts(MAZE, episodes=2, **settings), says)
