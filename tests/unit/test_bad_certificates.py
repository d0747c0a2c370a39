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
BAD = {
    "a shape": (
        PotentialError, r"shape \(8,\) or \(M, 8\): got \(3,\)",
        lambda: certify(MAZE, cr.StateShaping([1, 2, 3])),
    ),
    "an enormous potential": (
        PotentialError, r"Phi must be at most 1e\+15 in size, .*: entry \(4,\) is -1e\+285",
        lambda: certify(MAZE, cr.StateShaping(np.where(np.arange(8) == 4, -1e285, 0))),
    ),
    "an enormous start": (
        PotentialError, r"phi must be at most 1e\+15 in size, .*: entry \(0, 0\) is 1e\+308",
        lambda: cr.learn(MAZE, budget=10, shaping=cr.QInitialisation(np.full((8, 4), 1e308))),
    ),
    "an enormous reward": (
        PotentialError, r"a shaping reward must be at most 1e\+15 in size: it is 2e\+285 from",
        lambda: certify(MAZE, ShapingReward(lambda s, a, t: 2e285)),
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
    "a policy of networks": (
        SettingError, "must be for tables", lambda: certify(MAZE, PolicyReuse(ENDED)),
    ),
    "a function elsewhere": (
        PotentialError, "phi must be an array of numbers",
        lambda: certify(MAZE, cr.StateShaping(difference(ENDED))),
    ),
    "no function": (
        SettingError, "ShapingReward takes a function", lambda: certify(MAZE, ShapingReward(ENDED)),
    ),
    "the wrong kind": (
        SettingError, r"QInitialisation takes a potential phi\(s, a\): got StatePotential",
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
    "a negative tolerance": (
        SettingError, "tolerance must be at least 0: got -1",
        lambda: certify(MAZE, cr.StateShaping(ENDED), tolerance=-1),
    ),
    "ends": (
        SettingError, "ends must be one of zero, given: got 'open'",
        lambda: certify(MAZE, cr.StateShaping(ENDED), ends="open"),
    ),
    "an observed task": (
        TaskError, "a task must be a FiniteMDP .* got ObservationTask",
        lambda: certify(cr.observation_task("CartPole-v1"), cr.StateShaping(ENDED)),
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
    "starts for other rollouts": (
        SettingError, "starts must be as many as episodes, 2: got 1",
        lambda: random_rollouts(MAZE, episodes=2, length=1, starts=np.array([0])),
    ),
    "random rollouts of no steps": (
        SettingError, "length of a random rollout in steps must be",
        lambda: random_rollouts(MAZE, episodes=2, length=0)
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused_in_one_sentence(case):
    error, message, call = BAD[case]
    with pytest.raises(error, match=message) as raised:
        call()
    assert "\n" not in str(raised.value)
