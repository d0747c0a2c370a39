"""False-alarm rates of the statistics of a comparison, over simulated studies.

The arms of these studies are equal, so each finding is a false alarm. Seeds are fixed: a test
either always passes or always fails, and its bound, in standard errors of the simulated rate,
states how easily a correct program would fail if the random stream changed (one-sided 3: 1 in
700 where the rate is all of 5 %; two-sided 4: 1 in 16,000).
"""

import numpy as np
import pytest

from curricle.statistics.hypothesis_tests import holm, sign_flip_test

pytestmark = pytest.mark.slow


def standard_error(rate, studies):
    return np.sqrt(rate * (1 - rate) / studies)


@pytest.mark.parametrize("tails", ["normal", "standard_cauchy"])
@pytest.mark.parametrize("seeds", [6, 10, 20])
def test_sign_flips_raise_five_percent_false_alarms(seeds, tails):
    """4,000 studies (1,000 with drawn signs). Exact whatever the tails, so the rate is known.

    Values without ties make p a multiple of 2 / 2^K, each as likely: P(p <= 0.05) is the largest
    such multiple up to 0.05, hence 2, 50 of 64, 1,024; of 1,000 drawn signs it is 50 / 1,000.
    """
    studies = 1000 if seeds == 20 else 4000
    draw = getattr(np.random.default_rng(2024), tails)
    found = [
        sign_flip_test(draw(size=seeds), resamples=999, seed=study) <= 0.05
        for study in range(studies)
    ]
    expected = {6: 2 / 64, 10: 50 / 1024, 20: 0.05}[seeds]
    assert np.mean(found) == pytest.approx(expected, abs=4 * standard_error(expected, studies))


def test_holm_holds_five_arms_to_one_arms_false_alarms():
    """2,000 studies of 5 arms against one baseline, 10 seeds: at most 5 % find anything.

    Allowed are 3 standard errors more, since Holm's rule may use up all of the 5 %. Without the
    correction, well over 10 % of the studies would have a false alarm.
    """
    rng, studies = np.random.default_rng(2024), 2000
    one_by_one, together = [], []
    for _ in range(studies):
        baseline, arms = rng.exponential(size=10), rng.exponential(size=(5, 10))
        p_values = [sign_flip_test(arm - baseline) for arm in arms]
        one_by_one.append(min(p_values) <= 0.05)
        together.append(holm(p_values).min() <= 0.05)
    assert np.mean(together) <= 0.05 + 3 * standard_error(0.05, studies)
    assert np.mean(one_by_one) > 0.10
