"""What is random, at the right frequencies.

Seeds are fixed, so that a test either always passes or always fails: the false-alarm rates below
are for the day the random stream changes. Frequencies: chi-square at 1e-6 a test.
"""

import numpy as np
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
