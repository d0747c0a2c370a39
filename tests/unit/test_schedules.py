"""Numbers that change while learning."""

import numpy as np
import pytest

from curricle import DoubleQLearning, FiniteMDP, learn
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
