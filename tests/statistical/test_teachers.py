"""Starts from the goal outwards reach a sparse reward that the start alone does not; fixed seeds.

Every step in every task is counted. If a seed failed with probability .01, three of 20 would fail
in 0.1 % of all sets of seeds.
"""

import numpy as np
import pytest

import curricle as cr
from curricle.planning.policy_evaluation import Target
from curricle.statistics import Curve, time_to_threshold
from curricle.tasks import DeepSea, GoalDistance, with_start
from curricle.teaching import ReverseCurriculum, Uniform, teach

pytestmark = pytest.mark.slow
SEEDS, BUDGET = 20, 100_000
FREE = cr.Rewards(step=0.0, bump=0.0, treasure=1.0)
HALL = cr.GridWorld("S" + "." * 28 + "T", rewards=FREE, time_limit=100)
TARGETS = {
    "deep sea": (DeepSea(12, time_limit=12), [(d, d) for d in range(1, 12)]),
    "hall": (HALL, [(d, d + 2) for d in range(1, 29, 3)]),
}


@pytest.mark.parametrize("name", TARGETS)
def test_starts_from_the_goal_outwards_beat_the_start_alone(name):
    target, rings = TARGETS[name]
    tasks = {f"{low}..{high}": with_start(target, GoalDistance(low, high)) for low, high in rings}
    judge = Target.of(target, cr.GreedyEvaluation(method="exact"))
    level = judge.random_return + 0.9 * (judge.optimum - judge.random_return)
    learner, seeds = cr.QLearning(learning_rate=0.5), range(SEEDS)

    def times(teacher):
        arms = {**tasks, "target": target}
        found = teach(arms, teacher, learner, BUDGET, target="target", seeds=seeds)
        np.testing.assert_array_equal(found.steps_per_task.sum(axis=1), BUDGET)
        return time_to_threshold(found.curve, level)

    alone = time_to_threshold(Curve.of(cr.learn(target, learner, BUDGET, seeds=seeds)), level)
    uniform, outwards = times(Uniform()), times(ReverseCurriculum())
    assert alone.reached.sum() <= 2
    assert uniform.reached.sum() >= 18
    assert outwards.reached.sum() >= 18
    assert np.median(outwards.steps) < np.median(uniform.steps) < BUDGET / 2
