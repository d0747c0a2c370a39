"""Numbers that change while learning."""

import numpy as np
import pytest

from curricle import DoubleQLearning, FiniteMDP, GridWorld, QLearning, learn
from curricle.learning import exponential, harmonic, linear
from curricle.learning.schedules import constant


@pytest.mark.parametrize(
    ("schedule", "values"),
    [
        (constant(0.3), {0: 0.3, 10**9: 0.3}),
        (linear(1, 0, steps=4), {0: 1, 1: 0.75, 4: 0, 100: 0}),
        (linear(0, 2, steps=0.5), {0: 0, 1: 2}),
        (exponential(1, half_life=10), {0: 1, 10: 0.5, 30: 0.125}),
        (exponential(1, 3, half_life=1), {0: 1, 1: 2, 2: 2.5}),
        (harmonic(), {0: 1, 1: 1 / 2, 9: 1 / 10}),
        (harmonic(1, 0.5, half=4), {0: 1, 4: 0.75, 12: 0.625}),
    ],
)
def test_schedules_by_hand(schedule, values):
    assert {step: schedule(step) for step in values} == pytest.approx(values)


def test_a_harmonic_learning_rate_averages_the_rewards_of_a_pair():
    # The one step of each episode pays 199 or (at an edge) -1; the rate 1 / n makes Q the mean.
    task = GridWorld("ST", discount=0, time_limit=1)
    result = learn(task, QLearning(learning_rate=harmonic(), epsilon=1, initial_value=50), 100)
    assert result.values[0, 0].tolist() == [-1, 199, -1, -1]


@pytest.mark.parametrize("steps", [20, 1000])
def test_each_table_of_double_q_learning_averages_the_rewards_that_it_saw(steps):
    """With counts of their own, both tables forget where they started at their first update."""
    task = FiniteMDP.from_dense(
        np.array([[[0.0, 1.0]], [[0.0, 1.0]]]),
        [[1.0], [0.0]],
        terminal=[0, 1],
        start=0,
        discount=0.9,
    )
    learner = DoubleQLearning(learning_rate=harmonic(), initial_value=100.0)
    result = learn(task, learner, steps, seeds=20)
    np.testing.assert_array_equal(result.values[:, 0, 0], 1.0)


@pytest.mark.parametrize("schedule", [constant(1), linear(1, 0, steps=4), harmonic(1, half=2)])
def test_schedules_hold_floats_so_that_the_loops_compile_once(schedule):
    assert [type(number) for number in schedule[1:]] == [float] * 3
