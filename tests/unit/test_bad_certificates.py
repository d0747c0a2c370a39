"""What certify and random rollouts refuse."""

import numpy as np
import pytest

import curricle as cr
from curricle.certificate import ShapingReward, certify
from curricle.deep import PolicyReuse, WeightTransfer
from curricle.errors import PotentialError, SettingError, TaskError
from curricle.planning.rollouts import random_rollouts
from tests.certificates import ENDED, MAZE, PAIRS, PHI, difference

LARGE = cr.Pursuit(size=10, predators=3)


OTHER = cr.GridWorld("S.T")
BAD = [
    (PotentialError, r"or \(M, 8\): got \(3,\)", lambda: certify(MAZE, cr.StateShaping([1, 2, 3]))),
    (
        PotentialError,
        r"Phi must be at most 1e\+15 in size, .*: entry \(4,\) is -1e\+285",
        lambda: certify(MAZE, cr.StateShaping(np.where(np.arange(8) == 4, -1e285, 0))),
    ),
    (
        PotentialError,
        r"phi must be at most 1e\+15 in size, .*: entry \(0, 0\) is 1e\+308",
        lambda: cr.learn(MAZE, budget=10, shaping=cr.QInitialisation(np.full((8, 4), 1e308))),
    ),
    (PotentialError, r"2e\+285 from", lambda: certify(MAZE, ShapingReward(lambda s, a, t: 2e285))),
    (PotentialError, r"4\): got \(8,\)", lambda: certify(MAZE, cr.QInitialisation(np.zeros(8)))),
    (PotentialError, r"got \(2, 8\)", lambda: certify(MAZE, cr.StateShaping(np.zeros((2, 8))))),
    (
        PotentialError,
        r"entry \(4,\) is nan",
        lambda: certify(MAZE, cr.StateShaping(np.where(np.arange(8) == 4, np.nan, 0))),
    ),
    (PotentialError, "array of numbers", lambda: certify(MAZE, cr.StateShaping("hint"))),
    (SettingError, "have a potential", lambda: certify(MAZE, cr.StateShaping())),
    (SettingError, "must be a shaping, such as StateShaping", lambda: certify(MAZE, ENDED)),
    (SettingError, "must be for tables", lambda: certify(MAZE, WeightTransfer(ENDED))),
    (SettingError, "must be for tables", lambda: certify(MAZE, PolicyReuse(ENDED))),
    (PotentialError, "array of numbers", lambda: certify(MAZE, cr.StateShaping(difference(ENDED)))),
    (SettingError, "ShapingReward takes a function", lambda: certify(MAZE, ShapingReward(ENDED))),
    (
        SettingError,
        r"QInitialisation takes a potential phi\(s, a\): got StatePotential",
        lambda: certify(MAZE, cr.QInitialisation(cr.StatePotential(MAZE, PHI))),
    ),
    (
        SettingError,
        "made for the task it shapes",
        lambda: certify(MAZE, cr.StateShaping(cr.StatePotential(OTHER, [0, 0, 0]))),
    ),
    (
        SettingError,
        r"shaping_discount must lie in \[0, 1\]: got 2",
        lambda: certify(MAZE, cr.StateShaping(ENDED), shaping_discount=2),
    ),
    (
        SettingError,
        "goes with StateShaping: got DecayingAdvice",
        lambda: certify(MAZE, cr.DecayingAdvice(PAIRS), shaping_discount=0.9),
    ),
    (
        SettingError,
        "must be positive: got 0",
        lambda: certify(cr.GridWorld("ST", discount=0), cr.LookBackAdvice(np.zeros((2, 4)))),
    ),
    (SettingError, "least 0: got -1", lambda: certify(MAZE, cr.StateShaping(ENDED), tolerance=-1)),
    (SettingError, "given: got 'open'", lambda: certify(MAZE, cr.StateShaping(ENDED), ends="open")),
    (
        TaskError,
        "a task must be a FiniteMDP .* got ObservationTask",
        lambda: certify(cr.observation_task("CartPole-v1"), cr.StateShaping(ENDED)),
    ),
    (
        SettingError,
        "method must be one of auto, exact, sampled: got 'guess'",
        lambda: certify(MAZE, cr.StateShaping(ENDED), method="guess"),
    ),
    (SettingError, "at least 1: got 0", lambda: certify(MAZE, cr.StateShaping(ENDED), steps=0)),
    (SettingError, "be a whole number", lambda: certify(MAZE, cr.StateShaping(ENDED), seed=-1)),
    (TaskError, "a task must be", lambda: certify(3, cr.StateShaping(ENDED))),
    (
        PotentialError,
        "must be finite: it is nan from state 0 .* by north to state 0",
        lambda: certify(MAZE, ShapingReward(lambda s, a, t: np.where(s == t, np.nan, 0))),
    ),
    (
        PotentialError,
        r"a number for each of 28 transitions: got \(2,\)",
        lambda: certify(MAZE, ShapingReward(lambda s, a, t: np.zeros(2))),
    ),
    (
        PotentialError,
        "a number for each of 28 transitions: got 'much'",
        lambda: certify(MAZE, ShapingReward(lambda s, a, t: "much")),
    ),
    (
        PotentialError,
        "must be finite: it is nan from state",
        lambda: certify(
            LARGE, ShapingReward(lambda s, a, t: np.where(s == t, np.nan, 0)), steps=5_000
        ),
    ),
    (
        SettingError,
        "starts must be as many as episodes, 2: got 1",
        lambda: random_rollouts(MAZE, episodes=2, length=1, starts=np.array([0])),
    ),
    (SettingError, "rollout in steps must be", lambda: random_rollouts(MAZE, episodes=2, length=0)),
]


@pytest.mark.parametrize(("error", "message", "call"), BAD)
def test_bad_input_is_refused_in_one_sentence(error, message, call):
    with pytest.raises(error, match=message) as raised:
        call()
    assert "\n" not in str(raised.value)
