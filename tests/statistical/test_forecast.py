"""A trial foretells the experiment: fixed seeds, with the rate at which this fails by chance."""

import numpy as np
import pytest

import curricle as cr
from benchmarks.pairs import pairs

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("family", ["mazes", "locks"])
def test_the_gain_of_a_trial_is_the_gain_of_the_experiment(family):
    """Two means of 20 seeds each; their difference is beyond 4 standard errors in 1 of 10,000."""
    for pair in pairs(family=family)[:4]:
        plan = pair.curriculum()
        told = cr.forecast(plan, seeds=1, trial=True).used.gain
        came = cr.compare(plan, seeds=20).contrasts["transfer"].strong_gain
        # An interval is NaN where all seeds have one gain.
        width = np.nansum([(told.high - told.low) ** 2, (came.high - came.low) ** 2])
        error = width**0.5 / 2 / 2.093  # Student's 97.5 % quantile of 19 degrees of freedom
        assert abs(told.estimate - came.estimate) <= 4 * error + 1e-9, pair.name
