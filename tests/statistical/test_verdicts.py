"""False alarms of verdicts, over simulated studies of plain returns.

A verdict may be wrong in 5 % of studies; allowed are 3 standard errors of the simulated rate more.
"""

import numpy as np
import pytest

from curricle.comparison.verdicts import verdicts_of

pytestmark = pytest.mark.slow
STUDIES = 2000
ALLOWED = 0.05 + 3 * np.sqrt(0.05 * 0.95 / STUDIES)


def studies(arms, seeds, draw):
    """Yield studies of equal arms; seeds of all arms have a part in common."""
    rng = np.random.default_rng(2024)
    for _ in range(STUDIES):
        common = getattr(rng, draw)(size=seeds)
        yield {name: common + getattr(rng, draw)(size=seeds) for name in arms}


@pytest.mark.parametrize("draw", ["normal", "exponential", "standard_cauchy"])
@pytest.mark.parametrize(("curricula", "seeds"), [(1, 6), (3, 10), (3, 20)])
def test_curricula_that_equal_scratch_seldom_differ(curricula, seeds, draw):
    names = [f"arm {n}" for n in range(curricula)]
    rivals = dict.fromkeys(names, ("scratch",))
    wrong = [
        any(one.direction for one in verdicts_of(returns, rivals).values())
        for returns in studies(["scratch", *names], seeds, draw)
    ]
    assert np.mean(wrong) <= ALLOWED


@pytest.mark.parametrize("draw", ["normal", "exponential"])
@pytest.mark.parametrize(("controls", "seeds"), [(1, 10), (4, 10), (4, 20)])
def test_a_curriculum_that_equals_its_controls_is_seldom_told_apart(controls, seeds, draw):
    """Either answer is wrong: "yes" and "no, less"."""
    names = [f"control {n}" for n in range(controls)]
    found = [
        verdicts_of(returns, {"arm": names})["arm"]
        for returns in studies(["arm", *names], seeds, draw)
    ]
    assert np.mean([one.direction != 0 for one in found]) <= ALLOWED


@pytest.mark.parametrize(("controls", "seeds"), [(1, 10), (4, 10), (4, 30)])
def test_the_gain_over_the_strongest_control_is_covered(controls, seeds):
    """The true gain over the strongest is 0.3, and more over the others."""
    names = [f"control {n}" for n in range(controls)]
    missed = []
    for returns in studies(["arm", *names], seeds, "normal"):
        lower = {name: returns[name] - 0.3 - 0.2 * n for n, name in enumerate(names)}
        gain = verdicts_of({**returns, **lower}, {"arm": names})["arm"].gain
        missed.append(not gain.low <= 0.3 <= gain.high)
    assert np.mean(missed) <= ALLOWED


def test_a_control_that_equals_the_curriculum_hides_among_weak_ones():
    """The intersection-union test keeps 2.5 % however many weak controls there are beside it."""
    names = ["equal", "weak 1", "weak 2", "weak 3"]
    wrong = []
    for returns in studies(["arm", *names], 12, "normal"):
        weaker = {name: returns[name] - 9.0 for name in names[1:]}
        wrong.append(verdicts_of({**returns, **weaker}, {"arm": names})["arm"].direction > 0)
    assert np.mean(wrong) <= 0.025 + 3 * np.sqrt(0.025 * 0.975 / STUDIES)
