"""FiniteMDP: its constructors, its tables, and what has none."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from curricle import FiniteMDP, GridWorld
from curricle.errors import TaskError
from tests.support.tasks import dense_of

P = np.array(
    [[[0.5, 0.5, 0.0], [0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0], [0.0, 0.25, 0.75]], np.eye(3)[[2, 2]]]
)
END = [False, False, True]


def dense(reward, **changes):
    settings = {"terminal": END, "start": 0, "discount": 0.9}
    return FiniteMDP.from_dense(P, reward, **(settings | changes))


def test_from_dense_takes_rewards_of_states_pairs_or_transitions():
    _, r = dense_of(dense([1.0, 2.0, 9.0]))
    assert r.tolist() == [[1, 1], [2, 2], [0, 0]]
    _, r = dense_of(dense([[1.0, 2.0], [3.0, 4.0], [9.0, 9.0]]))
    assert r.tolist() == [[1, 2], [3, 4], [0, 0]]
    reward = np.zeros((3, 2, 3))
    reward[0, 0, 1], reward[1, 1, 2], reward[0, 0, 2] = 4.0, 8.0, 99.0  # the last is impossible
    _, r = dense_of(dense(reward))
    assert r.tolist() == [[2, 0], [0, 6], [0, 0]]


def test_from_outcomes_pads_lists_and_reads_ends():
    lists = [[[(0.5, 0, -1.0), (0.5, 1, 3.0)], [(1.0, 1, 7.0)]], [[], []]]
    mdp = FiniteMDP.from_outcomes(lists, terminal=[False, True], start=0, discount=0.5)
    p, r = dense_of(mdp)
    assert p[0].tolist() == [[0.5, 0.5], [0, 1]]
    assert r[0].tolist() == [1, 7]
    lists = {0: {0: [(1.0, 1, 0.0, False)]}, 1: {0: [(1.0, 2, 1.0, True)]}, 2: {0: []}}
    mdp = FiniteMDP.from_outcomes(lists, start=0, discount=1.0)
    assert mdp.terminal.tolist() == [False, False, True]


def test_a_start_may_be_a_state_or_a_distribution():
    assert dense(np.zeros(3), start=1).start.tolist() == [0, 1, 0]
    assert dense(np.zeros(3), start=np.int64(1)).start.tolist() == [0, 1, 0]
    mdp = dense(np.zeros(3), start=[0.25, 0.75, 0])
    assert mdp.start_states.tolist() == [0, 1]
    assert mdp.start_cumulative.tolist() == [0.25, 1]


def test_the_last_possible_outcome_has_cumulative_probability_1():
    third = 1 / 3
    p = [[[third, third, third], [1.0, 0.0, 0.0]]] * 3
    mdp = FiniteMDP.from_dense(p, np.zeros(3), terminal=END, start=0, discount=0.9)
    assert mdp.cumulative[0, 2] == 1.0
    assert mdp.cumulative[1].tolist() == [1, 1, 1]


def test_next_states_beyond_32_bits_are_refused_and_not_wrapped_round():
    m = GridWorld("S.T").mdp
    too_large = m.next_state.astype(np.int64) + 2**32
    with pytest.raises(TaskError, match="next states"):
        replace(m, next_state=too_large)


def test_no_wide_copy_of_the_next_states_stays():
    m = GridWorld([f"S{'.' * 298}T"] * 300).mdp
    wide = m.next_state.astype(np.int64)
    tracemalloc.start()
    replace(m, next_state=wide)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 26 * wide.size
