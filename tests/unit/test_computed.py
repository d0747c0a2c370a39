"""Tasks given by functions learn as their tables do, and every answer of a function is checked."""

import numpy as np
import pytest
from numba import njit

import curricle as cr
from curricle import Component, ComputedMDP, QLearning, Space
from curricle.errors import TaskError
from curricle.planning.rollouts import random_rollouts
from tests.support.tasks import ring, ring_by_tables, ring_start, ring_step

ROLLED = cr.GreedyEvaluation("rollouts", episodes=5)
PLACES, MOVES = Space([Component("place", 9)]), Space([Component("move", 2, labels=("on", "back"))])


@njit(nogil=True)
def line_start(data, bits):
    return 0


@njit(nogil=True)
def line_step(data, state, action, bits):
    return state + 1, 1.0, state + 1 == 3


def test_functions_lead_to_the_values_of_their_tables():
    """A harmonic rate at random actions averages: both come close to the same optimum."""
    rate = cr.learning.harmonic(half=50)
    learner = QLearning(learning_rate=rate, epsilon=1.0, initial_value=5.0)
    best = cr.solve(ring_by_tables()).action_values
    for task in (ring(), ring_by_tables()):
        q = cr.learn(task, learner, 500_000, evaluation=ROLLED).values[0]
        np.testing.assert_allclose(q[1:], best[1:], atol=0.1)


@pytest.mark.parametrize(
    ("learner", "shaping"),
    [
        (QLearning, None),
        (QLearning, cr.QInitialisation()),
        (QLearning, cr.QInitialisation(portfolio=cr.Portfolio(value_range=(-7.0, 7.0)))),
        (QLearning, cr.StateShaping()),
        (cr.SARSA, cr.QInitialisation()),
        (cr.ExpectedSARSA, None),
        (cr.DoubleQLearning, None),
    ],
)
def test_values_handed_on_are_zero_at_ends_that_only_steps_tell(learner, shaping):
    """A state that no episode entered keeps its first values, an end that one entered does not."""
    spaces = Space([Component("place", 5)]), Space([Component("move", 1)])
    line = ComputedMDP(*spaces, line_start, line_step, discount=0.5)
    if shaping is not None:
        shaping = shaping.with_potential(np.full((5, 1), 7.0))
    optimistic = learner(learning_rate=1.0, initial_value=100.0)
    values = cr.learn(line, optimistic, 200, shaping=shaping).values[0].ravel()
    assert values[:4].tolist() == [1.75, 1.5, 1.0, 0.0]
    assert values[4] in (100.0, 107.0, -7.0)  # the last in a portfolio


def test_compiled_functions_and_plain_ones_are_the_same():
    compiled = ring()
    functions = ring_start.py_func, ring_step.py_func
    plain = ComputedMDP(compiled.states, compiled.actions, *functions, 9, 0.9, 30)
    first, other = (cr.learn(task, budget=2000, seeds=2) for task in (plain, compiled))
    np.testing.assert_array_equal(first.values, other.values)
    np.testing.assert_array_equal(first.greedy_return, other.greedy_return)


def test_a_computed_task_hands_on_what_it_learnt():
    small, large = ring(5), ring(9)
    edge = cr.Transfer("small", "large", cr.project(large, small, unmapped_value=-3.0))
    plan, shaping = {"small": small, "large": large}, cr.QInitialisation()
    curriculum = cr.Curriculum(plan, [edge], budget=2000, shaping=shaping)
    result = curriculum.train(2)
    phi = result.potentials["large"][0].values
    np.testing.assert_array_equal(phi[1:5], result["small"].values[0][1:])
    assert (phi[5:] == -3.0).all()


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"states": 5}, "states must be"),
        ({"start": 3}, "start must be a function: got 3"),
        ({"step": None}, "step must be a function: got None"),
        ({"discount": 1.5}, "discount"),
        ({"time_limit": 0}, "time_limit|time limit"),
        ({"discount": 1.0, "time_limit": None}, "needs a time limit"),
    ],
)
def test_what_is_no_task_is_refused(changes, says):
    parts = {"states": PLACES, "actions": MOVES, "start": ring_start, "step": ring_step}
    with pytest.raises(TaskError, match=says):
        ComputedMDP(**(parts | changes))


def test_exact_things_are_refused_in_words():
    with pytest.raises(cr.CurricleError, match="tables"):
        cr.solve(ring())
    with pytest.raises(cr.CurricleError, match="tables"):
        cr.learn(ring(), budget=10, evaluation=cr.GreedyEvaluation("exact"))


NAN, INF = float("nan"), float("inf")
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
    "portfolio": lambda bad: cr.learn(
        bad, budget=300, shaping=cr.QInitialisation(phi(bad), portfolio=cr.Portfolio())
    ),
    "evaluation": lambda bad: cr.learn(bad, budget=300, eval_freq=1),
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


def test_step_limits_cut_episodes_of_computed_tasks():
    assert cr.learn(task((3.0, 3.0, 0.0)), budget=500, evaluation=OFF).episodes_used[0] == 10


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
