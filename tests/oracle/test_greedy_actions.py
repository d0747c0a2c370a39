"""What is written in the processor's words, against NumPy; each type of loop against another."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numba import njit

import curricle as cr
from curricle.planning.greedy import ACTION, TIED, best_of, highest
from curricle.tasks.kernel import _without_lowest, nth_one, of_width, ones

WIDTHS = [1, 2, 7, 8, 9, 16, 25, 63, 64, 65, 125, 200]
ROLLED = cr.GreedyEvaluation("rollouts", episodes=5)
without_lowest = njit(_without_lowest)


@njit
def best_rows(table, bits, best, action):
    for row in range(table.shape[0]):
        best[row], action[row] = best_of(table, np.uint64(row), bits[row])


@njit
def unrolled_rows(table, width, bits, best, action):
    fixed = of_width(table, width)
    for row in range(fixed.shape[0]):
        best[row], action[row] = best_of(fixed, np.uint64(row), bits[row])


@njit
def changed_rows(table, entries, values, bits, best, action, highest_values):
    for row in range(table.shape[0]):
        changed = entries[row], values[row]
        best[row], action[row] = best_of(table, np.uint64(row), bits[row], changed)
        highest_values[row] = highest(table, np.uint64(row), changed)


@njit
def highest_rows(table, best):
    for row in range(table.shape[0]):
        best[row] = highest(table, np.uint64(row))


@njit
def numbered(bits, n):
    return nth_one(bits, n)


@njit
def counted(bits):
    return ones(bits)


def random_bits(n, seed=0):
    return np.random.default_rng(seed).integers(0, 2**64, size=n, dtype=np.uint64)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("width", WIDTHS)
def test_a_rows_best_is_found_and_ties_are_flagged(width, dtype):
    rng = np.random.default_rng(width)
    # Few values, hence many ties; minus infinity and the sign of zero among them.
    table = rng.choice(
        [-np.inf, -2.0, -0.0, 0.0, 1.5], size=(400, width), p=[0.1, 0.6, 0.1, 0.1, 0.1]
    )
    table[::7] = rng.normal(size=table[::7].shape)
    table = table.astype(dtype)
    best, action = np.zeros(400, dtype), np.zeros(400, np.uint64)
    bits = random_bits(400)
    best_rows(table, bits, best, action)
    np.testing.assert_array_equal(best, table.max(axis=1))
    highest_rows(table, best)
    np.testing.assert_array_equal(best, table.max(axis=1))
    tied = table == best[:, None]
    assert tied[np.arange(400), (action & ACTION).astype(int)].all()
    np.testing.assert_array_equal(action >= TIED, tied.sum(axis=1) > 1)
    if width <= 64:
        again, same = np.zeros(400, dtype), np.zeros(400, np.uint64)
        unrolled_rows(table, (None,) * width, bits, again, same)
        np.testing.assert_array_equal(same, action)
        np.testing.assert_array_equal(again, best)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("width", WIDTHS)
def test_a_row_is_read_as_if_one_of_its_values_were_changed(width, dtype):
    rng, n = np.random.default_rng(width), 400
    table = rng.choice([-np.inf, -2.0, 0.0, 1.5], size=(n, width)).astype(dtype)
    entries = rng.integers(0, width, size=n, dtype=np.uint64)
    values, bits = rng.choice([-2.0, 1.5, 3.0], size=n).astype(dtype), random_bits(n)
    best, action, highest_values = np.zeros(n, dtype), np.zeros(n, np.uint64), np.zeros(n, dtype)
    untouched = table.copy()
    changed_rows(table, entries, values, bits, best, action, highest_values)
    np.testing.assert_array_equal(table, untouched)
    table[np.arange(n), entries.astype(int)] = values
    written, drawn = np.zeros(n, dtype), np.zeros(n, np.uint64)
    best_rows(table, bits, written, drawn)
    np.testing.assert_array_equal(best, written)
    np.testing.assert_array_equal(highest_values, written)
    np.testing.assert_array_equal(action, drawn)


@pytest.mark.parametrize("width", [3, 8, 25, 64, 65, 125])
def test_every_tie_is_drawn_equally_often(width):
    n, row = 40_000, np.zeros(width)
    row[1::3] = 1.0
    best, action = np.zeros(n), np.zeros(n, np.uint64)
    best_rows(np.tile(row, (n, 1)), random_bits(n, width), best, action)
    count = np.bincount((action & ACTION).astype(int), minlength=width)
    assert (count[row == 0] == 0).all()
    expected = n / (row == 1).sum()
    assert abs(count[row == 1] - expected).max() < 5 * np.sqrt(expected)


@given(st.integers(1, 2**64 - 1), st.data())
def test_the_nth_bit_is_the_nth(bits, data):
    places = [i for i in range(64) if bits >> i & 1]
    n = data.draw(st.integers(0, len(places) - 1))
    assert numbered(np.uint64(bits), np.uint64(n)) == places[n]
    assert counted(np.uint64(bits)) == len(places)
    rest = int(without_lowest(np.uint64(bits), np.uint64(n)))  # where no instruction does it
    assert rest == sum(1 << i for i in places[n:])


def maze():
    """A task without chance, with a table of a few hundred bytes."""
    return cr.GridWorld(["S.P.", "..P.", "...T"])


def hunt():
    """A task with a table that is not in the processor's nearest cache."""
    return cr.Pursuit(3, 2, time_limit=30)


def learnt(task, learner):
    result = cr.learn(task, learner, 5000, seeds=2, eval_freq=7, evaluation=ROLLED)
    return result.values, result.training_return, result.greedy_return


@pytest.mark.parametrize(
    ("task", "learner"),
    [
        (maze, cr.QLearning(epsilon=0.3)),
        (hunt, cr.QLearning(inverse_temperature=1.0)),
        pytest.param(maze, cr.QLearning(inverse_temperature=1.0), marks=pytest.mark.slow),
        pytest.param(hunt, cr.QLearning(epsilon=0.3), marks=pytest.mark.slow),
        pytest.param(maze, cr.SARSA(epsilon=0.3), marks=pytest.mark.slow),
    ],
)
def test_loops_as_shipped_learn_what_loops_of_tests_learn(task, learner, request):
    """Unrolled, for tables without chance, rates that never change, and tables near or far."""
    arrays = learnt(task(), learner)
    request.getfixturevalue("as_shipped")
    for array, other in zip(arrays, learnt(task(), learner), strict=True):
        np.testing.assert_array_equal(array, other)


@pytest.mark.parametrize("kind", ["dense", "sparse"])
def test_a_fresh_tie_is_drawn_at_every_visit(kind):
    """Actions that stay and earn nothing tie for ever."""
    taken, n = [], 20_000

    class Stay:
        def reset(self, seed=None):
            return 0, {}

        def step(self, action):
            taken.append(action)
            return 0, 0.0, False, False, {}

        def close(self):
            pass

    spaces = cr.Space([cr.Component("place", 1)]), cr.Space([cr.Component("move", 4)])
    stay = cr.tasks.LiveMDP(*spaces, Stay, discount=0.9, time_limit=1)
    off = cr.GreedyEvaluation(method="off")
    cr.learn(stay, cr.QLearning(epsilon=0.0), n, evaluation=off, storage=cr.Storage(kind))
    pairs = np.bincount(np.array(taken[:-1]) * 4 + taken[1:], minlength=16)
    expected = (n - 1) / 16
    assert abs(pairs - expected).max() < 5 * np.sqrt(expected)
