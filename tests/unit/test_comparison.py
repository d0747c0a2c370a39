"""The measures, rows and table of a comparison, worked out by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import curricle as cr
from curricle.comparison import Comparison, Reference
from curricle.comparison.measures import MEASURES
from curricle.comparison.sentences import cluster_sentence, findings, nothing_learnt
from curricle.comparison.trial import Trial
from curricle.planning import Target
from curricle.statistics.intervals import interquartile_interval
from tests.support.comparisons import arm_of, flat

BY_HAND = Comparison(
    target="maze",
    arms={
        "scratch": arm_of([[0, 0, 1, 2, 3], [0, 0, 1, 2, 3]]),
        "helped": arm_of([[2, 4, 4, 4, 4], [2, 4, 4, 4, 4]], 20),
        "misled": arm_of([[-2, -2, 0, 0, 1], [-2, 0, 2, 2, 2]], 10, curriculum="helped"),
    },
    budget=20,
    total=40,
    reference=Reference(2.0),
    window=1,
)


def test_measures_by_hand():
    """Charged, the arms are 0, 0, 2, 4, 4 and 0, -2, -2, 0, 0 or 0, -2, 0, 2, 2."""
    helped, misled = (BY_HAND.contrasts[name] for name in ("helped", "misled"))
    assert BY_HAND.seeds == 2
    assert helped.jumpstart.estimate == 2.0
    assert helped.weak_steps_saved.estimate == 20.0  # scratch never within its own 20 steps
    assert helped.strong_steps_saved.estimate == 10.0  # 30 against 20
    assert helped.strong_gain.estimate == (0 + 10 + 30 + 40) / 40 - (0 + 5 + 15 + 25) / 40
    assert helped.asymptotic_gain.estimate == 1.0
    assert helped.probability_of_improvement.estimate == 1.0
    assert misled.jumpstart.estimate == -2.0
    assert misled.weak_steps_saved.estimate == 0.0  # 20 and 20 at most, and 20 and 20
    assert misled.strong_steps_saved.estimate == (30 - 40 + 30 - 30) / 2
    returned = ((-10 - 20 - 10 - 0) / 40 + (-10 - 10 + 10 + 20) / 40) / 2
    assert misled.strong_gain.estimate == returned - 1.125
    assert misled.asymptotic_gain.estimate == -2.0
    assert misled.probability_of_improvement.estimate == 0.0
    assert BY_HAND.times("misled").reached.tolist() == [False, True]
    assert BY_HAND.times("misled").steps.tolist() == [40.0, 30.0]
    assert BY_HAND.times("misled", strong=False).steps.tolist() == [20.0, 20.0]
    assert BY_HAND.times("helped", strong=False).steps.tolist() == [0.0, 0.0]
    assert BY_HAND.mean_return("helped").estimate == 2.0


def test_a_gain_is_the_difference_of_two_entries_of_its_column():
    """Also where few seeds of an arm learn, whose middle half does not."""
    learnt = np.where(np.arange(20)[:, None] < 3, np.linspace(0, 1, 11), 0.0)
    returns = {"scratch": np.flip(learnt, axis=0) * 2, "few": learnt}
    rows = comparison_of(**returns).rows()
    assert rows[0]["mean_return"] > 0
    gain = rows[1]["mean_return"] - rows[0]["mean_return"]
    assert rows[1]["strong_gain"] == pytest.approx(gain)


@pytest.mark.parametrize("start", [0.0, -0.3, 1e6])
def test_a_threshold_at_which_nothing_was_learnt_is_not_reached_by_it(start):
    """That of a curve that stays as it is lies on it; who learns more passes it."""
    flat = np.full((6, 11), start)
    later = flat + np.where(np.arange(11) < 5, 0.0, 0.5)
    comparison = comparison_of(scratch=flat, same=flat.copy(), later=later, threshold=start)
    assert [row["reached"] for row in comparison.rows()] == [0, 0, 6]
    assert comparison.times("scratch").steps.tolist() == [100.0] * 6
    assert comparison.times("later").steps.tolist() == [50.0] * 6
    assert comparison.contrasts["later"].strong_steps_saved.estimate == 50
    assert comparison.contrasts["same"].strong_steps_saved.estimate == 0
    assert "> 100 (6 never)" in str(comparison)
    above = comparison_of(scratch=flat + 1.0, same=flat + 1.0, threshold=start)
    assert [row["steps_to_threshold"] for row in above.rows()] == [0, 0]  # it was reached before


def test_seeds_that_are_apart_from_the_others_are_said_to_be():
    rng = np.random.default_rng(5)
    heights = np.where(np.arange(12) < 2, 1.0, 150.0) + rng.normal(scale=0.5, size=12)
    few = np.repeat(heights[:, None], 11, axis=1)
    half = np.repeat(heights[(np.arange(12) % 4), None], 11, axis=1) + rng.normal(size=(12, 1))
    comparison = comparison_of(
        scratch=few + 300, few=few, half=half, none=few[2:].repeat(2, 0)[:12]
    )
    assert [name for name in comparison.arms if cluster_sentence(comparison, name)] == [
        "scratch",
        "few",
        "half",
    ]
    few_apart = cluster_sentence(comparison, "few")
    middle = interquartile_interval(comparison.returns["few"])
    assert few_apart.startswith("the seeds of few are in two clusters, mean return of 10 near 150.")
    assert f"and of 2 near {heights[:2].mean():.4g}; interquartile mean" in few_apart
    assert few_apart.endswith(f"without the few: {str(middle).rpartition(',')[0]}")
    assert "of 6 near" in cluster_sentence(comparison, "half")
    assert "interquartile" not in cluster_sentence(comparison, "half")
    assert few_apart in str(comparison)
    (sentences,) = [arm.sentences for arm in findings(comparison) if arm.arm == "few"]
    assert any("The seeds of few are in two" in sentence for sentence in sentences)
    assert any("The seeds of scratch are in two" in sentence for sentence in sentences)


def comparison_of(threshold=0.5, **returns):
    """A comparison of curves over 100 steps, of arms without sources."""
    arms = {name: arm_of(curve) for name, curve in returns.items()}
    return Comparison("maze", arms, 100, 100, Reference(threshold), 1)


def test_an_arm_that_is_not_shown_reaches_the_threshold_too():
    arms = {"scratch": flat([5.0, 5.1]), "A": flat([6.0, 6.1])}
    hidden = arm_of([[0, 9]] * 2, scratch=True, curriculum="A", initial_values=np.zeros(2))
    comparison = Comparison("maze", arms, 10, 10, Reference(8.0), 1)
    assert nothing_learnt(comparison)
    comparison = replace(comparison, arms=arms | {"A, constant mean": hidden})
    assert "A, constant mean" not in comparison.shown
    assert not nothing_learnt(comparison)


def test_where_the_random_policy_is_optimal_up_to_rounding_there_is_nothing_to_learn():
    target = SimpleNamespace(solution=True, optimum=2 + 1e-12, random_return=2.0)
    reference = Reference.of(target)
    assert (reference.threshold, reference.nothing_to_learn) == (None, True)
    comparison = comparison_of(scratch=[[2.0, 2.0]], other=[[2.0, 2.0]])
    assert nothing_learnt(comparison) == ""  # 2 is above the threshold
    comparison = replace(comparison, reference=replace(reference, threshold=2.0))
    assert not comparison.times("other").reached.any()
    assert nothing_learnt(comparison) == ""
    assert Trial(comparison, "").numbers("other").startswith("nothing to learn, as the random")
    outcomes = [[[(0.5, 1, -1.0), (0.5, 0, -1.0)]], [[]]]
    one_action = cr.FiniteMDP.from_outcomes(
        outcomes, terminal=[False, True], start=0, discount=0.9, time_limit=9
    )
    assert Target.of(one_action).floor == -np.inf


@pytest.mark.parametrize(("more", "gain"), [(1e-9, 0.0), (1e-5, 1e-5), (-1e-5, -1e-5)])
def test_a_gain_within_rounding_is_none(more, gain):
    scratch, helped = flat([1.0]), flat([1.0 + more])
    np.testing.assert_allclose(helped.strong_gain(scratch), [gain], rtol=1e-3)
    arms = {"scratch": scratch, "helped": helped}
    contrast = Comparison("maze", arms, 10, 10, Reference(9.0), 1).contrasts["helped"]
    assert contrast.probability_of_improvement.estimate == (np.sign(gain) + 1) / 2


@pytest.mark.parametrize(
    ("height", "verdict"),
    [(1, "pays"), (-1, "costs more than it brings"), (0, "no difference shown")],
)
def test_verdicts(height, verdict):
    """Seven seeds of equal sign have p = 2^-6 = 0.016; among four equal arms 0.0625 at best."""
    scratch, other = arm_of(np.zeros((7, 5))), arm_of(np.full((7, 5), height))
    few = "too few seeds for a verdict (7; 8 or more)"
    for arms, expected in ((1, verdict), (4, few)):
        names = [f"arm {i}" for i in range(arms)]
        comparison = replace(BY_HAND, arms={"scratch": scratch, **dict.fromkeys(names, other)})
        assert comparison.contrasts["arm 0"].verdict == expected
        assert comparison.contrasts["arm 0"].p == (2**-6 if height else 1.0)


def test_rows_are_a_table():
    rows = BY_HAND.rows()
    assert [row["arm"] for row in rows] == ["scratch", "helped", "misled"]
    assert len({tuple(row) for row in rows}) == 1
    scratch, helped, misled = rows
    assert (scratch["control"], misled["control"]) == (False, True)
    assert (helped["source_steps"], helped["steps_to_threshold"], helped["reached"]) == (20, 20, 2)
    assert (misled["source_steps"], misled["steps_to_threshold"], misled["reached"]) == (10, 35, 1)
    assert {row["seeds"] for row in rows} == {2}
    for row in (helped, misled):
        contrast = BY_HAND.contrasts[row["arm"]]
        for measure in MEASURES:
            interval = getattr(contrast, measure)
            numbers = row[measure], row[f"{measure}_low"], row[f"{measure}_high"]
            np.testing.assert_equal(numbers, (interval.estimate, interval.low, interval.high))
            assert np.isnan([scratch[measure], scratch[f"{measure}_low"]]).all()
        assert (row["p"], row["adjusted_p"]) == (contrast.p, contrast.adjusted_p)
        assert row["verdict"] == contrast.verdict
    verdicts = BY_HAND.control_verdicts["helped"]
    assert (helped["strongest_control"], helped["beats_controls"]) == ("misled", verdicts.answer)
    assert helped["gain_over_controls"] == verdicts.gain.estimate == 2.0 - misled["mean_return"]
    assert (misled["strongest_control"], scratch["beats_controls"]) == ("", "")
    assert scratch["mean_return"] == 1.125
    assert scratch["verdict"] == ""
