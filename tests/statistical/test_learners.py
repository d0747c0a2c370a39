"""What is random, at the right frequencies; what converges, to the right values.

Seeds are fixed, so that a test either always passes or always fails: the false-alarm rates below
are for the day the random stream changes. Frequencies: chi-square at 1e-6 a test.
"""

import numpy as np
import pytest
import scipy.stats
from numba import njit

import curricle as cr
from curricle.tasks.kernel import STRIDE, splitmix64, uniform

FALSE_ALARM = 1e-6
DRAWS = 20_000


def assert_frequencies(actions, probabilities):
    """Chi-square against the probabilities; impossible actions must not occur at all."""
    probabilities = np.asarray(probabilities)
    counts = np.bincount(actions, minlength=len(probabilities))
    possible = probabilities > 0
    assert counts[~possible].sum() == 0
    if possible.sum() > 1:
        expected = probabilities[possible] * len(actions)
        assert expected.min() > 5  # chi-square's own condition
        assert scipy.stats.chisquare(counts[possible], expected).pvalue > FALSE_ALARM


@njit
def _units(counter, out):
    for i in range(out.size):
        counter += STRIDE
        out[i] = uniform(splitmix64(counter))


def test_uniform_numbers_are_uniform():
    drawn = np.zeros(DRAWS)
    _units(np.uint64(1), drawn)
    assert_frequencies((drawn * 64).astype(int), np.full(64, 1 / 64))
    assert_frequencies((drawn * 2**20).astype(int) % 64, np.full(64, 1 / 64))


def test_streams_of_different_seeds_are_unrelated():
    # 2,000 seeds' first outcome of a fair coin, and neighbours' agreement.
    task = cr.FiniteMDP.from_outcomes(
        [[[(0.5, 1, 0.0), (0.5, 1, 1.0)]], [[]]], terminal=[False, True], start=0, discount=0.9
    )
    first = cr.learn(task, budget=1, eval_freq=1, seeds=2000).training_return[:, 1]
    assert_frequencies(first.astype(int), [0.5, 0.5])
    assert_frequencies((first[1:] == first[:-1]).astype(int), [0.5, 0.5])


def noisy_task():
    """Return 5 states, one of them terminal, 2 actions, 2 outcomes, rewards in [-1, 1]."""
    rng = np.random.default_rng(5)
    outcomes = [
        [
            [(p, int(rng.integers(5)), float(rng.uniform(-1, 1))) for p in (0.3, 0.7)]
            for _ in range(2)
        ]
        for _ in range(5)
    ]
    return cr.FiniteMDP.from_outcomes(
        outcomes, terminal=np.arange(5) == 4, start=[0.25] * 4 + [0], discount=0.6,
    )  # fmt: skip


# Rate 5 / (5 + n) = h / n leaves noise of variance h^2 / (2 h (1 - gamma) - 1) / n = 8.3 / n times
# a target's (sd below 0.8 here). The rarest pair has n of about 8,000 in 400,000 steps: sd 0.026,
# and 0.009 in the mean over 8 seeds. Allowed: 0.04, above four of those for the rarest of 8 pairs.
RATE = cr.learning.harmonic(half=5)
ALLOWED = 0.04
STEPS = 400_000


def learnt(kind, **exploration):
    learner = kind(learning_rate=RATE, **exploration)
    result = cr.learn(noisy_task(), learner, STEPS, seeds=8, eval_freq=STEPS)
    return result.values.mean(axis=0)


def fixed_point(task, policy_of):
    """Return the Q that is the value of the policy it gives rise to."""
    q = np.zeros((task.states.size, task.actions.size))
    for _ in range(200):
        q = cr.evaluate(task, policy_of(q)).action_values
    return q


def epsilon_greedy(q):
    return 0.6 * cr.planning.greedy_policy(q) + 0.4 / 2


def softmax(q):
    weight = np.exp(2.0 * q)
    return weight / weight.sum(axis=1, keepdims=True)


@pytest.mark.parametrize(
    ("policy_of", "exploration"),
    [(epsilon_greedy, {"epsilon": 0.4}), (softmax, {"inverse_temperature": 2.0})],
)
@pytest.mark.parametrize("kind", [cr.SARSA, cr.ExpectedSARSA])
def test_on_policy_learners_find_the_values_of_their_own_policy(kind, policy_of, exploration):
    own_values = fixed_point(noisy_task(), policy_of)
    assert abs(own_values - cr.solve(noisy_task()).action_values).max() > 2 * ALLOWED  # another one
    assert abs(learnt(kind, **exploration) - own_values).max() < ALLOWED


@pytest.mark.slow
def test_double_q_learning_overestimates_less_than_q_learning():
    # Ten actions of mean 0 and sd 1: the largest of ten noisy estimates is well above 0, the other
    # table's view of it is not (van Hasselt 2010). Difference of means of 200 seeds, 6 errors.
    outcomes = [[[(0.5, 1, -1.0), (0.5, 1, 1.0)]] * 10, [[]] * 10]
    entry = [[(1.0, 0, 0.0)]] * 10
    task = cr.FiniteMDP.from_outcomes(
        [*outcomes, entry], terminal=[False, True, False], start=2, discount=1.0
    )

    def entry_values(kind):
        learner = kind(learning_rate=0.1, epsilon=1.0)
        return (
            cr.learn(task, learner, 20_000, seeds=200, eval_freq=20_000).values[:, 2].mean(axis=1)
        )

    single, double = entry_values(cr.QLearning), entry_values(cr.DoubleQLearning)
    error = np.hypot(single.std(), double.std()) / np.sqrt(200)
    assert single.mean() > 0.2
    assert single.mean() - double.mean() > 6 * error
    assert abs(double.mean()) < 0.1
