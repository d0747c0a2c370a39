"""What is random, at the right frequencies; what converges, to the right values.

Seeds are fixed, so that a test either always passes or always fails: the false-alarm rates below
are for the day the random stream changes. Frequencies: chi-square at 1e-6 a test, 30 tests.
"""

import numpy as np
import pytest
import scipy.special
import scipy.stats
from numba import njit

import curricle as cr
from curricle.learning.exploration import choose
from curricle.planning.greedy import ACTION, best_of
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
def _choose_often(row, exploration, step, counter, out):
    for i in range(out.size):
        out[i], _, counter, _ = choose(exploration, row, splitmix64(counter), step, counter)


@njit
def _best_often(row, counter, out):
    for i in range(out.size):
        counter += STRIDE
        out[i] = best_of(row, 0, splitmix64(counter))[1] & ACTION


@njit
def _units(counter, out):
    for i in range(out.size):
        counter += STRIDE
        out[i] = uniform(splitmix64(counter))


def chosen(values, learner, *, seed=0, step=0):
    """Return the actions the compiled `choose` takes on these values."""
    row, out = np.array([values], dtype=np.float64), np.zeros(DRAWS, dtype=np.int64)
    _choose_often(row, learner.kernel().exploration, step, np.uint64(seed), out)
    return out


@pytest.mark.parametrize("values", [[0, 0, 0, 0], [1, 3, 3], [3, 1, 3, 2, 3], [-1, -1], [0, -0.0]])
def test_ties_are_broken_uniformly(values):
    expected = cr.planning.greedy_policy([values])[0]
    assert_frequencies(chosen(values, cr.QLearning(epsilon=0.0)), expected)
    for dtype in (np.float32, np.float64):
        out = np.zeros(DRAWS, dtype=np.int64)
        _best_often(np.array([values], dtype=dtype), np.uint64(5), out)
        assert_frequencies(out, expected)


@pytest.mark.parametrize("epsilon", [0.05, 0.5, 1.0])
@pytest.mark.parametrize("values", [[0.0, 1.0, 0.5], [2.0, 2.0, 0.0, 1.0], [7.0]])
def test_epsilon_greedy_frequencies(values, epsilon):
    greedy = cr.planning.greedy_policy([values])[0]
    expected = (1 - epsilon) * greedy + epsilon / len(values)
    assert_frequencies(chosen(values, cr.QLearning(epsilon=epsilon)), expected)


def test_epsilon_follows_its_schedule():
    learner = cr.QLearning(epsilon=cr.learning.linear(1.0, 0.0, steps=100))
    for step, epsilon in ((0, 1.0), (50, 0.5), (100, 0.0)):
        expected = [1 - epsilon / 2, epsilon / 2]
        assert_frequencies(chosen([1.0, 0.0], learner, step=step), expected)


# The last two reject so often that the full row must be drawn.
@pytest.mark.parametrize(
    ("values", "beta"),
    [
        ([0.0, 1.0, 2.0], 0.0),
        ([0.0, 1.0, 2.0], 1.0),
        ([-5.0, -8.0, -6.0, -5.5], 0.2),
        ([700.0, 701.0, 702.0], 1.0),
        ([0.0] + [-4.0] * 9, 1.0),
        ([3.0, 2.0] + [-100.0] * 14, 1.0),
    ],
)
def test_softmax_frequencies(values, beta):
    weight = np.exp(beta * (np.array(values) - max(values)))
    expected = weight / weight.sum()
    expected[expected < 1e-12] = 0.0  # never seen in 20,000 draws
    actions = chosen(values, cr.QLearning(inverse_temperature=beta))
    assert_frequencies(actions, expected / expected.sum())


def test_uniform_numbers_are_uniform():
    drawn = np.zeros(DRAWS)
    _units(np.uint64(1), drawn)
    assert_frequencies((drawn * 64).astype(int), np.full(64, 1 / 64))
    assert_frequencies((drawn * 2**20).astype(int) % 64, np.full(64, 1 / 64))


def test_starts_and_outcomes_follow_their_probabilities():
    # One-step episodes that pay 1 for one start and outcome: the mean return is their frequency.
    n = 100_000
    start, outcome = np.array([0.2, 0.3, 0.5]), np.array([0.1, 0.9])
    for s, o in np.ndindex(3, 2):
        rewards = [[float((i, k) == (s, o)) for k in range(2)] for i in range(3)]
        outcomes = [[[(outcome[k], 3, row[k]) for k in range(2)]] for row in rewards]
        task = cr.FiniteMDP.from_outcomes(
            [*outcomes, [[]]], terminal=[False] * 3 + [True], start=[*start, 0.0], discount=0.9
        )
        seen = cr.learn(task, budget=n, eval_freq=n).training_return[0, -1]
        p = start[s] * outcome[o]
        # 5 standard errors: false alarm 6e-7 each.
        assert abs(seen - p) < 5 * np.sqrt(p * (1 - p) / n)


def test_streams_of_different_seeds_are_unrelated():
    # 2,000 seeds' first outcome of a fair coin, and neighbours' agreement.
    task = cr.FiniteMDP.from_outcomes(
        [[[(0.5, 1, 0.0), (0.5, 1, 1.0)]], [[]]], terminal=[False, True], start=0, discount=0.9
    )
    first = cr.learn(task, budget=1, eval_freq=1, seeds=2000).training_return[:, 1]
    assert_frequencies(first.astype(int), [0.5, 0.5])
    assert_frequencies((first[1:] == first[:-1]).astype(int), [0.5, 0.5])


# -- convergence ---------------------------------------------------------------------------------


def noisy_task(time_limit=None):
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
        time_limit=time_limit,
    )  # fmt: skip


# Rate 5 / (5 + n) = h / n leaves noise of variance h^2 / (2 h (1 - gamma) - 1) / n = 8.3 / n times
# a target's (sd below 0.8 here). The rarest pair has n of about 8,000 in 400,000 steps: sd 0.026,
# and 0.009 in the mean over 8 seeds. Allowed: 0.04, above four of those for the rarest of 8 pairs.
RATE = cr.learning.harmonic(half=5)
ALLOWED = 0.04
STEPS = 400_000


def learnt(kind, time_limit=None, **exploration):
    learner = kind(learning_rate=RATE, **exploration)
    result = cr.learn(noisy_task(time_limit), learner, STEPS, seeds=8, eval_freq=STEPS)
    return result.values.mean(axis=0)


@pytest.mark.parametrize("time_limit", [None, 3])
@pytest.mark.parametrize("kind", [cr.QLearning, cr.DoubleQLearning])
def test_off_policy_learners_find_the_optimal_values(kind, time_limit):
    optimum = cr.solve(noisy_task()).action_values
    for exploration in ({"epsilon": 0.5}, {"inverse_temperature": 1.0}):
        assert abs(learnt(kind, time_limit, **exploration) - optimum).max() < ALLOWED


@pytest.mark.parametrize("kind", [cr.SARSA, cr.ExpectedSARSA])
def test_on_policy_learners_find_the_values_of_the_uniform_policy(kind):
    uniform = cr.evaluate(noisy_task(), np.full((5, 2), 0.5)).action_values
    assert abs(learnt(kind, epsilon=1.0) - uniform).max() < ALLOWED
    assert abs(learnt(kind, inverse_temperature=0.0) - uniform).max() < ALLOWED


def fixed_point(task, policy_of):
    """Return the Q that is the value of the policy it gives rise to."""
    q = np.zeros((task.states.size, task.actions.size))
    for _ in range(200):
        q = cr.evaluate(task, policy_of(q)).action_values
    return q


@pytest.mark.parametrize("kind", [cr.SARSA, cr.ExpectedSARSA])
def test_on_policy_learners_find_the_values_of_their_own_policy(kind):
    task = noisy_task()
    greedy = fixed_point(task, lambda q: 0.6 * cr.planning.greedy_policy(q) + 0.4 / 2)
    assert abs(greedy - cr.solve(task).action_values).max() > 3 * ALLOWED  # it is another one
    assert abs(learnt(kind, epsilon=0.4) - greedy).max() < ALLOWED
    softmax = fixed_point(task, lambda q: scipy.special.softmax(2.0 * q, axis=1))
    assert abs(learnt(kind, inverse_temperature=2.0) - softmax).max() < ALLOWED


@pytest.mark.slow
def test_harmonic_rate_is_the_sample_mean():
    # One step, reward +-1: harmonic() makes Q the mean of n rewards, sd 1 / sqrt(n). 400 seeds'
    # z-scores: Kolmogorov-Smirnov against the normal at 1e-6.
    n = 10_000
    task = cr.FiniteMDP.from_outcomes(
        [[[(0.5, 1, -1.0), (0.5, 1, 1.0)]], [[]]], terminal=[False, True], start=0, discount=0.9
    )
    learner = cr.QLearning(learning_rate=cr.learning.harmonic())
    result = cr.learn(task, learner, n, eval_freq=n, seeds=400)
    mean = result.values[:, 0, 0]
    assert mean == pytest.approx(result.training_return[:, 1], abs=1e-12)
    assert scipy.stats.kstest(mean * np.sqrt(n), "norm").pvalue > FALSE_ALARM


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
        learnt = cr.learn(task, learner, 20_000, seeds=200, eval_freq=20_000)
        return learnt.values[:, 2].mean(axis=1)

    single, double = entry_values(cr.QLearning), entry_values(cr.DoubleQLearning)
    error = np.hypot(single.std(), double.std()) / np.sqrt(200)
    assert single.mean() > 0.2
    assert single.mean() - double.mean() > 6 * error
    assert abs(double.mean()) < 0.1
