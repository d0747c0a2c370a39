"""The optimistic learner finds what epsilon-greedy does not; seeds are fixed.

A run has found it when its greedy policy ends within a tenth of the optimum. Each bar of 18 of 20
seeds would be missed by chance in 1e-6 of all sets of seeds if a seed failed with probability .004.
"""

import numpy as np
import pytest

import curricle as cr
from benchmarks.pairs.families.lines import chain, river, sea
from curricle.learning import OptimisticQLearning
from curricle.planning.target import Target

pytestmark = pytest.mark.slow
SEEDS = 20
EXACT = cr.GreedyEvaluation(method="exact")
TASKS = {
    "RiverSwim, 20 states": (lambda: river(20, anywhere=False), 60_000),
    "chain, 30 states": (lambda: chain(30, anywhere=False), 60_000),
    "DeepSea, 10 deep": (lambda: sea(10, anywhere=False), 20_000),
    "DeepSea, 20 deep": (lambda: sea(20, anywhere=False), 100_000),
}


def found(task, learner, budget):
    """Return how many seeds end within a tenth of the optimum."""
    judge = Target.of(task, EXACT)
    result = cr.learn(task, learner, budget, seeds=SEEDS, evaluation=EXACT, eval_freq=budget)
    way = judge.optimum - judge.random_return
    return int(np.sum(result.greedy_return[:, -1] >= judge.optimum - 0.1 * way))


@pytest.mark.parametrize("name", TASKS)
def test_optimism_finds_what_epsilon_greedy_does_not(name):
    make, budget = TASKS[name]
    task = make()
    assert found(task, cr.QLearning(), budget) <= 2
    assert found(task, OptimisticQLearning(), budget) >= 18
