"""Verdicts are wrong in 5 % of simulated studies at most, and 3 standard errors of the rate."""

from dataclasses import replace

import numpy as np
import pytest

from curricle.comparison.verdicts import Reason, seeds_to_show, verdicts_of
from curricle.study import compare_studies, read_study, run_study

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


LINES = """
name = 'lines'
seeds = 30
eval_freq = 50
opponents = []
tasks.near = { type = 'maze', map = 'S.T', budget = { max_steps = 50 } }
tasks.far = { type = 'maze', map = 'S..T', budget = 50 }
transfers = [{ source = 'near', target = 'far', mapping = 'same_position' }]
"""


def test_a_study_that_is_looked_at_after_every_unit_raises_no_more_false_alarms(tmp_path):
    """Its curves are replaced by equal ones of both arms; 30 seeds are looked at every 5.

    A look at each as if it were the last finds a difference in more than 10 % of studies.
    """
    file = tmp_path / "lines.toml"
    file.write_text(LINES)
    study = run_study(read_study(file), tmp_path / "lines", workers=1, progress=False)
    rng, whole, wrong, looked = np.random.default_rng(2024), study.results, [], []
    for _ in range(STUDIES // 4):
        study.results = {
            arm: {name: replaced(result, rng) for name, result in nodes.items()}
            for arm, nodes in whole.items()
        }
        looks = []
        for seeds in range(5, 31, 5):
            study.seeds = tuple(range(seeds))
            looks.append(compare_studies([study]))
        wrong.append(any(one.verdicts["transfer"].direction for one in looks))
        looks = [replace(one, interim="") for one in looks]
        looked.append(any(one.verdicts["transfer"].direction for one in looks))
    assert np.mean(wrong) <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / len(wrong))
    assert np.mean(looked) > 0.1


def replaced(result, rng):
    """A learning result whose seeds have flat curves of normal heights, above random play."""
    heights = rng.normal(1e3, size=(len(result.seeds), 1)).repeat(result.steps.size, axis=1)
    return replace(result, greedy_return=heights)


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


def check_reason(why, controls, seeds, draw):
    """A reason is given of an arm that equals its controls, all 10 above scratch, in 2.5 %."""
    wrong = []
    for drawn in studies(["arm", "scratch", *controls], seeds, draw):
        returns = {name: values + 10 * (name != "scratch") for name, values in drawn.items()}
        rivals = ["scratch"], controls
        wrong.append(
            Reason(*(verdicts_of(returns, {"arm": of})["arm"] for of in rivals)).why == why
        )
    assert np.mean(wrong) <= 0.025 + 3 * np.sqrt(0.025 * 0.975 / STUDIES)


@pytest.mark.parametrize("seeds", [6, 20, 100])
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_random_values_of_a_curriculum_seldom_differ_from_those_of_its_placebo(seeds, share):
    """The curriculum has one draw in all seeds; `share` of a return's variance is its draw's."""
    rng, gains = np.random.default_rng([seeds, int(10 * share)]), []
    for _ in range(STUDIES):
        values = np.sqrt(share) * rng.normal(size=seeds + 1)
        noise = np.sqrt(1 - share) * rng.normal(size=(2, seeds))
        returns = {"arm": values[0] + noise[0], "placebo": values[1:] + noise[1]}
        verdict = verdicts_of(returns, {"arm": ["placebo"]}, placebos=["placebo"])["arm"]
        gains.append(verdict.direction)
    for direction in (-1, 1):
        wrong = np.mean(np.equal(gains, direction))
        assert wrong <= 0.025 + 3 * np.sqrt(0.025 * 0.975 / STUDIES)


@pytest.mark.parametrize(("controls", "seeds"), [(1, 10), (3, 20)])
def test_a_placebo_that_gains_as_much_is_seldom_said_to_gain_more(controls, seeds):
    check_reason("placebo", [f"placebo {n}" for n in range(controls)], seeds, "normal")


@pytest.mark.parametrize("seeds", [10, 20])
def test_a_curriculum_that_knows_nothing_is_seldom_said_to_pay_by_what_it_knows(seeds):
    """It equals the strongest control; both halves are right in 97.5 % of studies each."""
    check_reason(
        "knowledge", ["constant mean", "constant maximum", "placebo"], seeds, "exponential"
    )


@pytest.mark.parametrize("seeds", [6, 20])
def test_a_curriculum_that_equals_the_best_of_several_from_scratch_seldom_differs(seeds):
    """Against three learners from scratch: one as good, or all."""
    names = ["scratch", "scratch, one", "scratch, two"]
    for weaker in (0.0, 4.0):
        wrong = []
        for returns in studies(["arm", *names], seeds, "normal"):
            lower = {name: returns[name] - weaker * n for n, name in enumerate(names)}
            wrong.append(verdicts_of({**returns, **lower}, {"arm": names})["arm"].direction != 0)
        assert np.mean(wrong) <= ALLOWED


@pytest.mark.parametrize("beyond", [0.0, 0.5])
@pytest.mark.parametrize("gain", [0.5, 1.0])
def test_80_percent_of_studies_with_the_recommended_seeds_show_the_gain(gain, beyond):
    """Over four opponents, each `beyond` of a standard deviation below the one before."""
    rng, below = np.random.default_rng(2024), np.arange(4)[:, np.newaxis] * beyond

    def drawn(seeds):
        return gain + rng.normal(size=seeds), rng.normal(size=(4, seeds)) - below

    arm, opponents = drawn(20_000)
    apart = arm - opponents
    seeds = seeds_to_show(apart - apart.mean(axis=1, keepdims=True) + gain + below)
    shown = []
    for _ in range(STUDIES // 4):
        arm, opponents = drawn(seeds)
        returns = {"arm": arm, **{f"{n}": of for n, of in enumerate(opponents)}}
        shown.append(verdicts_of(returns, {"arm": list("0123")})["arm"].direction > 0)
    assert np.mean(shown) == pytest.approx(0.8, abs=0.05)
