"""Certificates of tasks that are not compared state by state, and what certify refuses."""

import sys
from pathlib import Path

import numpy as np
import pytest

import curricle as cr
from curricle.certificate import ShapingReward, certify
from curricle.deep import WeightTransfer
from curricle.errors import PotentialError, SettingError, TaskError
from curricle.transfer.potential import mapped_potential
from tests.support.certificates import ENDED, MAZE, PAIRS, RNG, difference
from tests.support.refusals import check_refusal

EXAMPLES = Path(__file__).parents[2] / "examples"


LARGE = cr.Pursuit(size=10, predators=3)


def large_mapped():
    alone = cr.Pursuit(size=10, predators=1)
    values = RNG.normal(size=(alone.states.size, 5))
    edges = [
        cr.Transfer("a", "b", cr.project(LARGE, alone, predator=f"predator_{i}")) for i in (1, 3)
    ]
    return mapped_potential(LARGE, edges, [values] * 2, cr.minimum)


@pytest.mark.parametrize("kind", [cr.QInitialisation, cr.LookAheadAdvice])
def test_a_mapped_potential_of_a_large_task_is_safe_by_theory(kind):
    certificate = certify(LARGE, kind(large_mapped()))
    assert certificate
    assert (certificate.states, certificate.loss) == (0, 0)
    assert certificate.theorem == "Wiewiora 2003"


def test_a_shaping_without_a_theorem_needs_tables():
    for task, phi in ((LARGE, large_mapped()), (boat()[0], boat()[1][:, None] * np.ones(5))):
        certificate = certify(task, cr.RewardBonus(phi))
        assert certificate.holds is None
        assert "RewardBonus is judged by comparing every state" in str(certificate)
    assert certificate.findings[0].endswith("that needs tables, which the task does not have")


def boat():
    sys.path.insert(0, str(EXAMPLES))
    try:
        import own_task
    finally:
        sys.path.remove(str(EXAMPLES))
    task = own_task.lake(5, 3)
    harbour = (task.states.decode()["x"] == 0) & (task.states.decode()["y"] == 0)
    return task, harbour


def test_a_task_without_tables_is_judged_by_theory():
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
    with pytest.raises(TaskError, match="has no tables"):
        certify(task, cr.StateShaping(phi), method="exact")


def test_a_reward_of_ones_own_is_not_compared_where_an_episode_can_go_on_for_ever():
    endless = cr.GridWorld(["S..", "..T"], discount=1)
    phi = ShapingReward(difference(np.array([4.0, 2, 7, 1, 3, 0]), 1.0))
    assert "an episode can go on for ever at discount 1" in str(certify(endless, phi))
    assert certify(endless, phi, method="exact").states == 5


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
    (SettingError, safe, {"method": "sampled"}, "one of auto, exact: got 'sampled'"),
    (SettingError, lambda: cr.RewardBonus(PAIRS), {"shaping_discount": 0.9}, "got RewardBonus"),
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
