"""Tasks given by functions learn as their tables do; what cannot be done with them is refused."""

import numpy as np
import pytest
from numba import njit

import curricle as cr
from curricle import Component, ComputedMDP, QLearning, Space, Storage
from curricle.errors import TaskError
from tests.tasks import ring, ring_by_tables, ring_start, ring_step

ROLLED = cr.GreedyEvaluation("rollouts", episodes=5)


@njit(nogil=True)
def line_start(data, bits):
    return 0


@njit(nogil=True)
def line_step(data, state, action, bits):
    return state + 1, 1.0, state + 1 == 3


@pytest.mark.parametrize("initial_value", [0.0, 5.0, -5.0])
def test_functions_lead_to_the_values_of_their_tables(initial_value):
    """A harmonic rate at random actions averages: both come close to the same optimum."""
    rate = cr.learning.harmonic(half=50)
    learner = QLearning(learning_rate=rate, epsilon=1.0, initial_value=initial_value)
    best = cr.solve(ring_by_tables()).action_values
    for task in (ring(), ring_by_tables()):
        q = cr.learn(task, learner, 500_000, evaluation=ROLLED).values[0]
        np.testing.assert_allclose(q[1:], best[1:], atol=0.1)


@pytest.mark.parametrize(
    ("learner", "kind"),
    [
        (QLearning, "dense"),
        (QLearning, "sparse"),
        (cr.SARSA, "dense"),
        (cr.ExpectedSARSA, "dense"),
        (cr.DoubleQLearning, "dense"),
    ],
)
def test_an_end_is_worth_nothing_whatever_the_table_starts_with(learner, kind):
    spaces = Space([Component("place", 4)]), Space([Component("move", 1)])
    line = ComputedMDP(*spaces, line_start, line_step, discount=0.5)
    optimistic = learner(learning_rate=1.0, initial_value=100.0)
    values = cr.learn(line, optimistic, 200, storage=Storage(kind)).values[0]
    q = values.at([0, 1, 2]) if kind == "sparse" else values[:3]
    assert q.ravel().tolist() == [1.75, 1.5, 1.0]


@pytest.mark.parametrize(
    ("learner", "shaping"),
    [
        (QLearning, None),
        (QLearning, cr.QInitialisation()),
        (QLearning, cr.QInitialisation(guard=cr.Guard())),
        (QLearning, cr.StateShaping()),
        (cr.SARSA, cr.QInitialisation()),
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
    assert values[4] in (100.0, 107.0)


def test_compiled_functions_and_plain_ones_are_the_same():
    compiled = ring()
    functions = ring_start.py_func, ring_step.py_func
    plain = ComputedMDP(compiled.states, compiled.actions, *functions, 9, 0.9, 30)
    one, other = (cr.learn(task, budget=2000, seeds=2) for task in (plain, compiled))
    np.testing.assert_array_equal(one.values, other.values)
    np.testing.assert_array_equal(one.greedy_return, other.greedy_return)


def test_a_computed_task_hands_on_what_it_learnt():
    small, large = ring(5), ring(9)
    edge = cr.Transfer("small", "large", cr.project(large, small, unmapped_value=-3.0))
    curriculum = cr.Curriculum({"small": small, "large": large}, [edge], budget=2000)
    result = curriculum.train(2)
    phi = result.potentials["large"][0].values
    np.testing.assert_array_equal(phi[1:5], result["small"].values[0][1:])
    assert (phi[5:] == -3.0).all()


def test_step_limits_cut_episodes_of_computed_tasks():
    never = ComputedMDP(
        Space([Component("place", 3)]),
        Space([Component("move", 2)]),
        lambda data, bits: 0,
        lambda data, state, action, bits: (state, 0.0, False),
        time_limit=7,
    )
    assert cr.learn(never, budget=70).episodes_used[0] == 10


BAD = {
    "states": ({"states": 5}, "states must be"),
    "start": ({"start": 3}, "start must be a function: got 3"),
    "step": ({"step": None}, "step must be a function: got None"),
    "discount": ({"discount": 1.5}, "discount"),
    "time limit": ({"time_limit": 0}, "time_limit|time limit"),
    "endless": ({"discount": 1.0, "time_limit": None}, "needs a time limit"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_task_is_refused(name):
    changes, message = BAD[name]
    given = {
        "states": Space([Component("place", 9)]),
        "actions": Space([Component("move", 2)]),
        "start": ring_start,
        "step": ring_step,
    }
    with pytest.raises(TaskError, match=message):
        ComputedMDP(**{**given, **changes})


def test_exact_things_are_refused_in_words():
    with pytest.raises(cr.CurricleError, match="tables"):
        cr.solve(ring())
    with pytest.raises(cr.CurricleError, match="tables"):
        cr.learn(ring(), budget=10, evaluation=cr.GreedyEvaluation("exact"))
