"""What holds of every teacher, whatever the tasks."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

import curricle as cr
from curricle.teaching import (
    Learnability,
    PrioritizedLevelReplay,
    ReverseCurriculum,
    Uniform,
    teach,
)
from tests.tasks import random_mdp

TEACHERS = [Uniform(), Learnability(), PrioritizedLevelReplay(), ReverseCurriculum()]
LEARNERS = [
    *(cr.QLearning(), cr.SARSA(), cr.ExpectedSARSA(), cr.DoubleQLearning()),
    cr.QLearning(learning_rate=0.5, initial_value=1.0),
    cr.SARSA(epsilon=cr.learning.linear(1.0, 0.1, steps=500)),
]
CURVES = ("values", "greedy_return", "training_return", "episodes", "steps_used")
CURVES += ("episodes_used", "evaluation_steps")
ENDS = random_mdp(0).terminal  # the goal of tasks whose best reward need not be at an end


def tasks_of(seed, n_tasks, time_limit):
    """Return tasks that differ in outcomes, rewards and starts, of one space."""
    return {
        f"{i}": random_mdp(seed + 100 * i, width=1 + (seed + i) % 3, time_limit=time_limit)
        for i in range(n_tasks)
    }


def assert_same(result, other):
    for name in CURVES:
        np.testing.assert_array_equal(getattr(result, name), getattr(other, name), err_msg=name)


ROLLOUTS = cr.GreedyEvaluation(method="rollouts", episodes=7)
SETTINGS = [
    *({"learner": learner, "seeds": [2, 7], "stream": "x"} for learner in LEARNERS),
    {"evaluation": ROLLOUTS},
    {"budget": cr.Episodes(40)},
    {"budget": cr.StoppingRule(3000, threshold=0.5, patience=3)},
]


@pytest.mark.parametrize("settings", SETTINGS)
def test_one_task_is_plain_learning_bit_for_bit(settings):
    settings = {"budget": 1500, "eval_freq": 30} | settings
    for seed in range(3):
        (task,) = tasks_of(seed, 1, 15).values()
        alone = cr.learn(task, **settings)
        assert_same(teach({"t": task}, target="t", **settings).learning, alone)


@pytest.mark.slow  # to compile
def test_one_task_is_plain_learning_with_the_loops_as_shipped(as_shipped):
    maze = cr.GridWorld(["S...PT", ".PP...", "......"])
    lake = cr.tasks.FrozenLake("8x8")
    for task in maze, lake, cr.GridWorld(["." * 40] * 30 + ["S" + "." * 38 + "T"]):
        for learner in cr.QLearning(), cr.QLearning(learning_rate=cr.learning.harmonic()):
            alone = cr.learn(task, learner, 5000, seeds=2)
            assert_same(
                teach({"t": task}, None, learner, 5000, target="t", seeds=2).learning, alone
            )


@given(
    teacher=st.sampled_from(TEACHERS),
    seed=st.integers(0, 20),
    n_tasks=st.integers(1, 5),
    budget=st.integers(1, 700),
    eval_freq=st.integers(1, 50),
)
def test_steps_add_up_and_draws_follow_the_probabilities(teacher, seed, n_tasks, budget, eval_freq):
    tasks, eval_freq = tasks_of(seed, n_tasks, 12), min(eval_freq, budget)
    settings = {"seeds": [seed], "eval_freq": eval_freq, "goal": ENDS}
    result = teach(tasks, teacher, None, budget, target="0", **settings)
    assert result.learning.steps_used[0] == budget == result.steps_per_task.sum()
    assert set(result.drawn[0]) <= set(range(n_tasks))
    lengths = np.diff(result.begun_at[0], append=budget)
    assert (lengths >= 1).all()
    assert (lengths <= 12).all()
    np.testing.assert_allclose(result.probabilities.sum(axis=2), 1.0)
    assert (result.probabilities >= 0).all()
    for checkpoint, step in enumerate(result.learning.steps[:-1]):
        episode = np.searchsorted(result.begun_at[0], step, side="right") - 1
        assert result.probabilities[0, checkpoint, result.drawn[0][episode]] > 0


@given(teacher=st.sampled_from(TEACHERS), seed=st.integers(0, 5))
def test_results_depend_on_the_seed_alone(teacher, seed):
    tasks = tasks_of(seed, 3, 12)

    def taught(seeds, workers, stream=""):
        settings = {"seeds": seeds, "workers": workers, "stream": stream, "goal": ENDS}
        return teach(tasks, teacher, None, 400, target="1", **settings)

    together, alone = taught(3, 3), taught([2], 1)
    for name in CURVES:
        joint, single = (getattr(result.learning, name) for result in (together, alone))
        np.testing.assert_array_equal(joint[2:], single)
    np.testing.assert_array_equal(together.drawn[2], alone.drawn[0])
    np.testing.assert_array_equal(together.probabilities[2:], alone.probabilities)
    other = taught([2], 1, "other")
    assert not np.array_equal(other.learning.values, alone.learning.values)


def test_the_draws_of_seeds_differ_and_are_those_of_the_probabilities():
    tasks = tasks_of(0, 4, 12)
    result = teach(tasks, Uniform(), None, 20_000, target="0", seeds=5)
    counts = np.array([np.bincount(drawn, minlength=4) for drawn in result.drawn])
    share = counts / counts.sum(axis=1, keepdims=True)
    error = np.sqrt(0.25 * 0.75 / counts.sum(axis=1)).max()
    assert abs(share - 0.25).max() < 5 * error
    assert len({tuple(drawn[:30]) for drawn in result.drawn}) == 5
