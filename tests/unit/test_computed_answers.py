"""What a user's functions and environments return is checked at every step that any loop takes."""

import numpy as np
import pytest
from numba import njit

import curricle as cr
from curricle import Component, ComputedMDP, Space
from curricle.errors import TaskError
from curricle.planning.rollouts import random_rollouts
from curricle.transfer.rollouts import greedy_rollouts
from tests.tasks import ring_start, ring_step

NAN, INF = float("nan"), float("inf")
PLACES, MOVES = Space([Component("place", 9)]), Space([Component("move", 2, labels=("on", "back"))])
OFF = cr.GreedyEvaluation("off")


@njit
def start(data, bits):
    return data[0]


@njit
def step(data, state, action, bits):
    """From state to state round the ring, but from state 5 to what the data say."""
    if state == np.uint64(5):
        return data[1], data[2], False
    return (state + np.uint64(1)) % np.uint64(9), -1.0, False


def task(data):
    return ComputedMDP(PLACES, MOVES, start, step, data=data, time_limit=50)


def phi(bad):
    return cr.StateActionPotential(bad, np.arange(18.0).reshape(9, 2))


def in_environment(bad):
    environment = cr.to_gymnasium(bad)
    environment.reset(seed=0)
    for _ in range(9):
        environment.step(0)


FAST = {
    "learn": lambda bad: cr.learn(bad, budget=300, evaluation=OFF),
    "rollout": lambda bad: cr.planning.rollout(bad, np.zeros(9, int)),
    "environment": in_environment,
}
SLOW = {
    "sparse": lambda bad: cr.learn(bad, budget=300, storage=cr.Storage("sparse")),
    "general": lambda bad: cr.learn(bad, cr.SARSA(), 300),
    "double": lambda bad: cr.learn(bad, cr.DoubleQLearning(), 300),
    "guard": lambda bad: cr.learn(
        bad, budget=300, shaping=cr.QInitialisation(phi(bad), guard=cr.Guard())
    ),
    "evaluation": lambda bad: cr.learn(bad, budget=300, eval_freq=1),
    "greedy rollouts": lambda bad: greedy_rollouts(phi(bad), episodes=5),
    "calibration": lambda bad: cr.calibrate(phi(bad)),
    "random rollouts": lambda bad: random_rollouts(bad, episodes=5, length=20),
}
WAYS = [*FAST.items(), *[pytest.param(*way, marks=pytest.mark.slow) for way in SLOW.items()]]
STEPS = [  # the state and the reward that a step returns, and what the error says
    ((10.0, 0.0), r"whole number in 0\.\.8: step .* action on in state 5 returned 10$"),
    ((9.0, 0.0), "returned 9$"),
    ((-1.0, 0.0), "returned -1$"),
    ((2.0**63, 0.0), "returned 9223372036854775808$"),
    ((1e300, 0.0), r"returned 1.*e\+300$"),
    ((0.5, 0.0), "returned 0.5$"),
    ((NAN, 0.0), "returned nan$"),
    ((INF, 0.0), "returned inf$"),
    ((3.0, NAN), "rewards must be finite, .*: step .* action on in state 5 returned nan$"),
    ((3.0, -INF), "returned -inf$"),
    ((3.0, 1e101), r"returned 1e\+101$"),
]


@pytest.mark.parametrize(("name", "use"), WAYS)
def test_a_step_to_no_state_or_without_a_reward_is_refused_by_every_loop(name, use):
    for (state, reward), message in STEPS:
        with pytest.raises(TaskError, match=message.replace("action on", "action (on|back)")):
            use(task((3.0, state, reward)))


@pytest.mark.parametrize(("name", "use"), WAYS)
def test_a_start_in_no_state_is_refused_by_every_loop(name, use):
    for state in (9.0, -1.0, 0.5, NAN, 2.0**64):
        with pytest.raises(TaskError, match=r"in 0\.\.8: start of a computed task returned"):
            use(task((state, 3.0, 0.0)))


@pytest.mark.parametrize("state", [-1, 9, np.int64(-(2**63)), np.uint64(2**64 - 1)])
def test_whole_numbers_that_are_no_state_are_refused(state):
    """Compared without sign: a negative number is a large one."""
    with pytest.raises(TaskError, match="a state must be a whole number"):
        cr.planning.rollout(task((type(state)(3), state, 0.0)), np.zeros(9, int))


def test_the_mistake_of_one_task_does_not_outlive_its_run():
    environment = cr.to_gymnasium(task((3.0, NAN, 0.0)))
    for _ in range(2):
        environment.reset(seed=0)
        environment.step(0), environment.step(0)
        with pytest.raises(TaskError, match="returned nan"):
            environment.step(0)
        with pytest.raises(cr.errors.SettingError, match="reset"):
            environment.step(0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"start": lambda data, bits: None}, "start .* must return a state: it returns none"),
        ({"start": lambda data: 0}, "start .* numba compiles: .* positional argument"),
        ({"step": lambda data, s, a, bits: (s, 1.0)}, "a state, a reward and a flag: it returns"),
        ({"step": lambda data, s, a, bits: nowhere(s)}, "numba compiles: .*nowhere"),  # noqa: F821
        ({"data": object()}, "data of a computed task must be of types that numba knows"),
    ],
)
def test_functions_that_numba_cannot_use_are_refused_in_one_sentence(changes, message):
    bad = ComputedMDP(**{"states": PLACES, "actions": MOVES, "start": ring_start, "step": ring_step}
                      | changes)  # fmt: skip
    with pytest.raises(TaskError, match=message) as caught:
        cr.learn(bad, budget=10, evaluation=OFF)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("reward", [NAN, INF, -INF, 1e101, 10**400])
@pytest.mark.parametrize("learner", [cr.QLearning(), cr.SARSA()])
def test_a_live_reward_that_is_not_finite_is_refused(reward, learner):
    class Odd:
        place = 0

        def reset(self, seed=None):
            self.place = 0
            return 0, {}

        def step(self, action):
            self.place += 1
            return self.place, reward if self.place == 4 else 0.0, False, False, {}

        def close(self):
            pass

    live = cr.tasks.LiveMDP(PLACES, MOVES, Odd, time_limit=8)
    with pytest.raises(TaskError, match=r"finite, .*: the environment .* (on|back) in state 3"):
        cr.learn(live, learner, 30, evaluation=OFF)
