"""What a calibration may do to any potential of any task, and what it may never do."""

import numpy as np
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

import curricle as cr
from curricle.transfer import Calibrate
from curricle.transfer.calibration import fit_calibration


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
def test_a_calibration_keeps_to_its_steps_and_scales_or_leaves_phi_alone(
    task, data, episodes, max_steps, seed
):
    shape = (task.states.size, task.actions.size)
    phi = cr.StateActionPotential(
        task, data.draw(arrays(np.float64, shape, elements=st.integers(-9, 2)))
    )
    fitted = fit_calibration(phi, Calibrate(episodes, max_steps), seed=seed)
    assert fitted.episodes <= episodes
    assert 0 < fitted.steps <= (6 * episodes if max_steps is None else max_steps)
    assert fitted.steps == fitted.warm_up.lengths.sum()
    if fitted.refusal:
        assert fitted.potential is phi
        assert fitted.scale == 1
    else:
        assert fitted.scale > 0
        np.testing.assert_array_equal(fitted.potential.values, fitted.scale * phi.values)
