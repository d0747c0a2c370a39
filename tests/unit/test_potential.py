"""Potentials: zero at the end, frames in time, shaping rewards by hand."""

import numpy as np
import pytest

from curricle import GridWorld, StateActionPotential, StatePotential
from curricle.errors import PotentialError
from curricle.learning import linear
from tests.tasks import ring, ring_by_tables

MAZE = GridWorld("S.T", discount=0.5)


def test_the_shaping_reward_is_the_discounted_difference():
    phi = StatePotential(MAZE, [4, 6, 9])
    assert phi.shaping_reward(0, 1) == 0.5 * 6 - 4
    assert phi.shaping_reward([0, 1], [0, 2]).tolist() == [0.5 * 4 - 4, -6]


def test_frames_and_weights_change_with_time():
    phi = StatePotential(MAZE, [[1, 1, 0], [8, 8, 0]], frame_steps=(0, 10))
    assert [phi.at(t)[0] for t in (0, 9, 10, 99)] == [1, 1, 8, 8]
    assert phi.shaping_reward(0, 1, step=9) == 0.5 * 8 - 1
    phi = StatePotential(MAZE, [4, 4, 0], weight=linear(1, 0, steps=4))
    assert phi.at(1).tolist() == [3, 3, 0]
    assert phi.shaping_reward(0, 1, step=1) == 0.5 * 2 - 3


@pytest.mark.parametrize("task", [ring_by_tables(), ring()], ids=["tables", "functions"])
def test_into_an_end_the_potential_is_zero_in_every_kind_of_task(task):
    """Home, where episodes end, is state 0; only the steps of a computed task tell so."""
    phi = StatePotential(task, np.full(9, 7.0))
    ended = [False, True]
    expected = [task.discount * 7.0 - 7.0, -7.0]
    assert phi.shaping_reward([2, 1], [1, 0], terminated=ended).tolist() == expected


def test_where_only_steps_tell_the_ends_they_must_be_given():
    phi = StatePotential(ring(), np.full(9, 7.0))
    with pytest.raises(PotentialError, match="only the steps of this task tell: give terminated="):
        phi.shaping_reward(1, 0)


def test_the_state_potential_of_a_pair_potential_is_its_maximum():
    phi = StateActionPotential(MAZE, [[1, -5, 2, 0], [-3, -1, -2, -9], [7] * 4])
    state = phi.to_state()
    assert state.values.tolist() == [[2, -1, 0]]
