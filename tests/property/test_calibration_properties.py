"""What a cautious calibration may do to any potential of any task, and what it may never do."""

import numpy as np
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

import curricle as cr
from curricle.transfer import Calibrate
from curricle.transfer.calibration import fit_calibration
from curricle.transfer.scale_fit import LARGEST_CAUTIOUS


@st.composite
def tasks(draw):
    """Draw an MDP of up to 4 states, the last of which may be terminal."""
    n, actions = draw(st.integers(2, 4)), draw(st.integers(1, 3))
    weights = draw(arrays(np.int64, (n, actions, n), elements=st.integers(0, 2)))
    weights[:, :, 0] += weights.sum(axis=2) == 0
    rewards = draw(arrays(np.int64, (n, actions), elements=st.integers(-3, 1)))
    terminal = np.arange(n) == (n - 1 if draw(st.booleans()) else n)
    return cr.FiniteMDP.from_dense(
        weights / weights.sum(axis=2, keepdims=True),
        rewards,
        terminal=terminal,
        start=~terminal / np.sum(~terminal),
        discount=draw(st.sampled_from([0.5, 0.9])),
        time_limit=6,
    )


@given(tasks(), st.data(), st.integers(1, 30), st.sampled_from([None, 1, 7, 60]), st.integers(0, 9))
def test_a_cautious_calibration_only_ever_makes_costs_a_little_larger(
    task, data, episodes, max_steps, seed
):
    shape = (task.states.size, task.actions.size)
    phi = cr.StateActionPotential(
        task, data.draw(arrays(np.float64, shape, elements=st.integers(-9, 2)))
    )
    found = fit_calibration(phi, Calibrate(episodes, max_steps=max_steps), seed=seed)
    assert found.shift == 0
    assert found.episodes <= episodes
    assert found.steps <= (6 * episodes if max_steps is None else max_steps)
    assert found.steps == found.warm_up.lengths.sum()
    if found.refusal:
        assert found.potential is phi
        assert found.scale == 1
    else:
        assert 1 < found.scale <= LARGEST_CAUTIOUS
        assert phi.values.max() <= 0
        np.testing.assert_array_equal(found.potential.values, found.scale * phi.values)
    if phi.values.max() > 0:
        assert found.steps == 0


@given(tasks(), st.data(), st.integers(0, 9))
def test_more_steps_allowed_than_taken_change_nothing(task, data, seed):
    """Episodes are looked at in one order, the first ones first."""
    shape = (task.states.size, task.actions.size)
    values = data.draw(arrays(np.float64, shape, elements=st.integers(-9, 0)))
    phi = cr.StateActionPotential(task, values)
    free = fit_calibration(phi, Calibrate(20), seed=seed)
    again = fit_calibration(phi, Calibrate(20), seed=seed)
    assert (free.scale, free.steps, free.refusal) == (again.scale, again.steps, again.refusal)
    plain = fit_calibration(phi, Calibrate(20, cautious=False), seed=seed)
    n = min(len(free.warm_up.lengths), len(plain.warm_up.lengths))
    np.testing.assert_array_equal(free.warm_up.lengths[:n], plain.warm_up.lengths[:n])
