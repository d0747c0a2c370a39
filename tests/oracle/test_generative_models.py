"""What loops read of a pursuit, computed successors and starts, against its tables."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numba import njit
from scipy.stats import chisquare

import curricle as cr
from curricle.tasks.kernel import inverse_of, quotient
from curricle.tasks.mdp import table_model
from curricle.tasks.models import first_state, transition
from tests.support.tasks import pursuits

FRACTION = 2**53


@njit
def moved(model, state, action, bits, next_state, reward, over):
    """Take each (state, action) with its random bits."""
    for i in range(state.shape[0]):
        next_state[i], reward[i], over[i] = transition(model, state[i], action[i], bits[i])


@njit
def started(model, bits, state):
    for i in range(state.shape[0]):
        state[i] = first_state(model, bits[i])


@njit
def quotients(numbers, inverse, out):
    for i in range(numbers.shape[0]):
        out[i] = quotient(numbers[i], inverse)


def step_all(model, state, action, bits):
    """Return next states, rewards and ends, as three lists."""
    pairs = (np.asarray(x, dtype=np.uint64) for x in (state, action, bits))
    result = np.zeros(len(state), np.uint64), np.zeros(len(state)), np.zeros(len(state), bool)
    moved(model, *pairs, *result)
    return [x.tolist() for x in result]


def random_bits(n, seed=0):
    return np.random.default_rng(seed).integers(2**64, size=n, dtype=np.uint64)


def alive_pairs(mdp, most=3000):
    """Return non-terminal states and actions, (n,) each; a sample of them where there are many."""
    pairs = np.argwhere(np.repeat(~mdp.terminal[:, None], mdp.actions.size, axis=1))
    if len(pairs) > most:
        pairs = pairs[np.random.default_rng(0).choice(len(pairs), most, replace=False)]
    return pairs.T


@settings(max_examples=40)
@given(pursuits())
def test_the_middle_of_a_prey_moves_interval_gives_that_moves_outcome(game):
    mdp = game.mdp
    state, action = alive_pairs(mdp)
    row = mdp.outcome_row[state, action]
    below = np.zeros(len(row))
    for move in range(game.moves):
        chance = mdp.probability[row, move]
        bits = ((below + chance / 2) * FRACTION).astype(np.uint64) << np.uint64(11)
        below += chance
        able = chance > 0
        result = step_all(game.model, state[able], action[able], bits[able])
        after = mdp.next_state[row[able], move]
        expected = after, mdp.reward[row[able], move], mdp.terminal[after]
        assert result == [x.tolist() for x in expected]


@settings(max_examples=40)
@given(pursuits(), st.integers(0, 999))
def test_any_random_bits_give_a_possible_outcome_and_the_one_that_tables_give(game, seed):
    mdp = game.mdp
    state, action = np.repeat(alive_pairs(mdp, most=500), 8, axis=1)
    bits = random_bits(len(state), seed)
    bits[:2] = 0, 2**64 - 1
    result = step_all(game.model, state, action, bits)
    assert result == step_all(table_model(mdp), state, action, bits)
    row = mdp.outcome_row[state, action]
    here = mdp.next_state[row] == np.array(result[0])[:, None]
    here &= mdp.reward[row] == np.array(result[1])[:, None]
    assert (here & (mdp.probability[row] > 0)).any(axis=1).all()
    assert result[2] == mdp.terminal[result[0]].tolist()


@pytest.mark.parametrize("capture", ["all", "any", 2])
@pytest.mark.parametrize("size", [2, 3])
def test_episodes_start_uniformly_where_the_prey_is_not_caught(size, capture):
    game = cr.Pursuit(size, 2, capture=capture)
    possible = np.flatnonzero(game.mdp.start)
    result = np.empty(200 * len(possible), np.uint64)
    started(game.model, random_bits(len(result), size), result)
    counts = np.bincount(result.astype(int), minlength=game.states.size)
    assert counts.sum() == counts[possible].sum()
    assert chisquare(counts[possible]).pvalue > 1e-4


def test_quotients_are_exact_around_the_multiples_of_a_divisor():
    rng, largest = np.random.default_rng(0), 2**43
    divisors = {*range(2, 200), *(2**k for k in range(1, 20)), 999_999, 10**6}
    divisors |= set(rng.integers(2, 10**6, size=800).tolist())
    for d in sorted(divisors):
        k = np.concatenate([np.arange(1, 50), rng.integers(1, largest // d, size=100)])
        k = np.append(k, [largest // d, largest // d - 1])
        numbers = (k[:, None] * d + np.array([-1, 0, 1])).ravel().astype(np.uint64)
        result = np.empty(len(numbers), np.uint64)
        quotients(numbers, inverse_of(d, 2), result)
        np.testing.assert_array_equal(result, numbers // np.uint64(d))


def test_quotients_of_the_largest_pursuits_are_exact():
    # Up to 2^50 states, and number * divisor just below 2^64.
    for d in (4, 9, 16, 49, 100, 961, 2**14, 65_535, 10**6 + 3):
        largest = min(2**50, (2**64 - 1) // d)
        multiples = np.array([largest // d, largest // d - 1, 1, 2], dtype=np.uint64) * np.uint64(d)
        numbers = np.append(multiples, [*(multiples - np.uint64(1)), np.uint64(largest)])
        result = np.empty(len(numbers), np.uint64)
        quotients(numbers, inverse_of(d, 2), result)
        assert result.tolist() == [int(n) // d for n in numbers]


def test_a_pursuit_too_large_to_number_is_refused():
    with pytest.raises(cr.errors.TaskError, match=r"at most 2\^50 states, .* has 531,441,000"):
        cr.learn(cr.Pursuit(30, 5), budget=10)


def test_learning_builds_no_tables():
    game = cr.Pursuit(4, 2)
    cr.learn(game, budget=100, eval_freq=100)
    assert "mdp" not in vars(game)
