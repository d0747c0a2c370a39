"""Several learners from scratch: each an arm, and the verdict against the best of them."""

import numpy as np
import pytest

import curricle as cr
from curricle import QLearning, compare
from curricle.comparison import Comparison
from curricle.errors import CurriculumError, SettingError
from tests.comparisons import MAZE, assert_same, copied, corner, flat, pursuit

FAST = QLearning(learning_rate=0.5)


def column(height, seed=0):
    return height + 0.1 * np.random.default_rng(seed).permutation(9)


def by_hand(mine, *others):
    arms = {"scratch": flat(column(0.0))}
    for n, height in enumerate(others):
        arms[f"scratch, {n}"] = flat(column(height, n + 1), scratch=True)
    return Comparison("maze", arms | {"mine": flat(column(mine, 7))}, 10, 10, 0.5, 1)


def test_each_is_an_arm_with_the_same_total(calls):
    learners = {"fast": FAST, "sarsa": cr.SARSA()}
    comparison = compare(corner(), seeds=[3, 5], controls=["placebo"], scratch=learners)
    names = ["scratch", "scratch, fast", "scratch, sarsa", "transfer", "transfer, placebo"]
    assert list(comparison.arms) == names
    assert comparison.scratches == tuple(names[:3])
    for name, learner in zip(names[1:], learners.values(), strict=False):
        alone = cr.learn(MAZE, learner, 3500, seeds=[3, 5], eval_freq=100, stream="maze")
        np.testing.assert_array_equal(comparison[name].curve.values, alone.greedy_return)
        assert comparison[name].curve.source_steps.tolist() == [0, 0]
    assert [call["budget"] for call in calls[:3]] == [3500] * 3
    assert all(name.startswith("transfer") for name in comparison.contrasts)


def test_arms_that_were_there_before_are_the_same_bit_for_bit():
    one = compare(corner(), seeds=2, controls=["placebo"])
    other = compare(corner(), seeds=2, controls=["placebo"], scratch=[FAST])
    for name in one.arms:
        assert_same(one[name], other[name])
    assert one.threshold == other.threshold


def test_the_shaping_of_a_target_does_not_change_what_others_learn_from_scratch(calls):
    """Without sources there is nothing to shape; look-back advice is for SARSA alone."""
    plan = corner(learner={"maze": cr.SARSA()}, shaping={"maze": cr.LookBackAdvice()})
    compare(plan, seeds=1, scratch=[QLearning()])
    assert calls[1]["shaping"] == []


def test_the_verdict_is_against_the_best():
    comparison = by_hand(5.0, 3.0, 8.0, 1.0)
    assert comparison.best_scratch == "scratch, 1"
    verdict, contrast = comparison.verdicts["mine"], comparison.contrasts["mine"]
    assert (verdict.rival, verdict.rivals) == ("scratch, 1", 4)
    assert contrast.verdict == "costs more than it brings"
    assert contrast.strong_gain.estimate == pytest.approx((column(5, 7) - column(8, 2)).mean())
    assert contrast.weak_gain.estimate == pytest.approx(contrast.strong_gain.estimate)
    row = comparison.rows()[-1]
    assert (row["against"], row["verdict"]) == ("scratch, 1", "costs more than it brings")
    assert comparison.against("scratch")["mine"].answer == "yes"
    alone = by_hand(5.0).contrasts["mine"]
    assert alone.verdict == "pays"


def test_learners_are_named_after_their_settings():
    learners = [QLearning(epsilon=0.5, initial_value=3.0), cr.SARSA()]
    comparison = compare(corner(), seeds=1, scratch=learners)
    assert comparison.scratches[1:] == (
        "scratch, QLearning(epsilon=0.5, initial_value=3.0)",
        "scratch, SARSA",
    )


def test_one_that_fails_is_left_out():
    """Double Q-learning has no sparse tables."""
    plan = pursuit(storage={"hunt": cr.Storage(kind="sparse")})
    comparison = compare(plan, seeds=1, scratch={"two": cr.DoubleQLearning(), "fast": FAST})
    assert list(comparison.arms) == ["scratch", "scratch, fast", "transfer"]
    assert "sparse tables are for QLearning" in str(comparison.failed["scratch, two"])


@pytest.mark.parametrize(
    ("scratch", "message"),
    [
        (FAST, "scratch, unless it names learners in a dict, must be a Sequence: got QLearning"),
        ([FAST, FAST], r"learners from scratch must differ: QLearning\(learning_rate=0.5\) is"),
        ([QLearning()], "must differ from the target's own: QLearning is QLearning"),
        ({"x\n": FAST}, "a learner from scratch must"),
    ],
)
def test_what_makes_no_sense_is_refused_before_anything_is_trained(scratch, message, calls):
    with pytest.raises(SettingError, match=message):
        compare(corner(), seeds=1, scratch=scratch)
    assert calls == []


def test_an_arm_cannot_have_the_name_of_a_learner():
    with pytest.raises(CurriculumError, match="the name 'scratch, fast' is taken by a learner"):
        compare({"scratch, fast": copied(MAZE)}, seeds=1, scratch={"fast": FAST})
