"""What certify and random rollouts refuse."""

import numpy as np
import pytest

import curricle as cr
from curricle.certificate import ShapingReward, certify
from curricle.deep import WeightTransfer
from curricle.errors import PotentialError, SettingError, TaskError
from curricle.planning.rollouts import random_rollouts
from tests.certificates import ENDED, MAZE, PAIRS, difference
from tests.refusals import check_refusal

LARGE = cr.Pursuit(size=10, predators=3)
OTHER = cr.GridWorld("S.T")
NOT_A_NUMBER = ShapingReward(lambda s, a, t: np.where(s == t, np.nan, 0))


def at_4(value):
    """Return a Phi of the maze that is 0 but in state 4."""
    return np.where(np.arange(8) == 4, value, 0)


POTENTIALS = [
    (
        lambda: cr.StateShaping(at_4(-1e285)),
        r"at most 1e\+15 in size, .*: entry \(4,\) is -1e\+285",
    ),
    (lambda: ShapingReward(lambda s, a, t: 2e285), r"at most 1e\+15 in size: it is 2e\+285 from"),
    (lambda: cr.StateShaping(difference(ENDED)), "phi must be an array of numbers"),
    (lambda: NOT_A_NUMBER, "must be finite: it is nan from state 0 .* by north to state 0"),
    (lambda: ShapingReward(lambda s, a, t: np.zeros(2)), r"28 transitions: got \(2,\)"),
]
SHAPINGS = [
    (lambda: cr.StateShaping(), "have a potential"),
    (lambda: ENDED, "must be a shaping, such as StateShaping"),
    (lambda: WeightTransfer(ENDED), "must be for tables"),
    (lambda: ShapingReward(ENDED), "ShapingReward takes a function"),
    (lambda: cr.StateShaping(cr.StatePotential(OTHER, [0, 0, 0])), "made for the task it shapes"),
]
SETTINGS = [
    ({"shaping_discount": 2}, r"shaping_discount must lie in \[0, 1\]: got 2"),
    ({"tolerance": -1}, "tolerance must be at least 0: got -1"),
    ({"ends": "open"}, "ends must be one of zero, given: got 'open'"),
    ({"method": "guess"}, "method must be one of auto, exact, sampled: got 'guess'"),
    ({"steps": 0}, "steps to sample must be a whole number, at least 1: got 0"),
    ({"seed": -1}, "seed must be a whole number"),
]


@pytest.mark.parametrize(("shaping", "says"), POTENTIALS)
def test_bad_potentials_are_refused_in_one_sentence(shaping, says):
    check_refusal(PotentialError, lambda: certify(MAZE, shaping()), says)


@pytest.mark.parametrize(("shaping", "says"), SHAPINGS)
def test_bad_shapings_are_refused_in_one_sentence(shaping, says):
    check_refusal(SettingError, lambda: certify(MAZE, shaping()), says)


@pytest.mark.parametrize(("settings", "says"), SETTINGS)
def test_bad_settings_are_refused_in_one_sentence(settings, says):
    check_refusal(SettingError, lambda: certify(MAZE, cr.StateShaping(ENDED), **settings), says)


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
    fades, says = cr.DecayingAdvice(PAIRS), "goes with StateShaping: got DecayingAdvice"
    check_refusal(SettingError, lambda: certify(MAZE, fades, shaping_discount=0.9), says)
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
