"""A rule that waits for returns to settle ends by its cap, and not before its evidence."""

import numpy as np
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from curricle import StoppingRule
from curricle.learning.stopping import (
    MIN_EVALUATIONS,
    RECENT,
    _recent_return,
    _share_of_rise,
    recent_return,
    share_of_rise,
)

RETURNS = arrays(
    np.float64, st.integers(1, 120), elements=st.floats(-1e6, 1e6) | st.just(float("nan"))
)


@given(RETURNS, st.integers(1, 50), st.integers(0, 3_000))
def test_it_ends_by_its_cap_and_never_before_its_evidence(greedy, eval_freq, least):
    most = max(least, (len(greedy) - 1) * eval_freq, 1)
    rule = StoppingRule(most, min_steps=least, settled=0.05)
    steps = np.arange(len(greedy)) * eval_freq
    decisions = rule.decisions(steps, greedy)
    assert decisions[-1].step <= most
    ended = [decision for decision in decisions if decision.ends]
    for decision in ended:
        here = decision.step // eval_freq
        seen = greedy[: here + 1]
        assert decision.step >= least
        assert decision.share < 0.05
        assert np.nanmax(seen) > np.nanmin(seen)
        # Eight evaluations lie in each part, so it takes 36 in any case.
        assert here + 1 - (int(RECENT * here) + 1) >= MIN_EVALUATIONS
        assert here >= 36
    assert len(ended) <= 1


@given(
    arrays(np.float64, 80, elements=st.integers(-8, 8).map(float)),
    st.sampled_from([0.25, 2.0, 64.0]),
    st.integers(-50, 50),
)
def test_it_does_not_depend_on_the_scale_of_rewards(greedy, scale, shift):
    for checkpoint in range(40, 80):
        share, other = (share_of_rise(g, checkpoint) for g in (greedy, scale * greedy + shift))
        np.testing.assert_allclose(share, other, atol=1e-9)


@given(RETURNS | arrays(np.float64, 80, elements=st.floats(-1e-3, 1e-3)))
def test_python_decides_as_compiled_loops_do_bit_for_bit(greedy):
    for checkpoint in range(len(greedy)):
        for python, body in ((share_of_rise, _share_of_rise), (recent_return, _recent_return)):
            here, compiled = float(python(greedy, checkpoint)), float(body(greedy, checkpoint))
            assert here.hex() == compiled.hex() or here == compiled == 0
