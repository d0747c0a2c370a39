"""Which arm is better than which, why, and that no answer depends on what else was asked."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import stats

from curricle.comparison import Comparison, Reference, seeds_needed, verdicts_of
from curricle.comparison.controls import CHANGES
from curricle.comparison.sentences import findings, page_table, seeds_sentence, share_saved
from curricle.comparison.verdicts import ASKING, SIGNIFICANT, seeds_to_show, steps_saved_share
from curricle.errors import CurriculumError, SettingError
from curricle.statistics import Times, mean_interval, sign_flip_test
from curricle.statistics.hypothesis_tests import holm, sign_flip_tests
from curricle.study import StudyResults
from tests.support.comparisons import alone as compare, arm_of, corner, flat, of_arms


def compared(**returns):
    """A comparison of flat arms; those called "..._control" are controls of the arm before."""
    arms, last = {}, ""
    for name, heights in returns.items():
        is_control = name.endswith("_control")
        arms[name] = flat(heights, last if is_control else "")
        last = last if is_control else name
    return of_arms(arms)


def column(height, seeds=8):
    """Returns of the given mean, a little apart, in an order of their own for each height."""
    return height + 0.1 * np.random.default_rng(abs(int(height * 7))).permutation(seeds)


# -- a verdict and what else is asked ----------------------------------------------------------


def test_seeds_to_come_withhold_every_verdict():
    arms = {"scratch": column(0), "mine": column(2), "c_control": column(1)}
    whole = compared(**arms)
    comparison = replace(whole, interim="interim, 8 of 20 seeds: no verdict")
    assert whole.verdicts["mine"].direction == whole.control_verdicts["mine"].direction == 1
    every = (comparison.verdicts, comparison.control_verdicts, comparison.against("c_control"))
    for verdict in (verdict["mine"] for verdict in every):
        assert verdict.direction == 0
        assert verdict.answer == verdict.against_scratch == comparison.interim
        assert np.isnan([verdict.p, verdict.adjusted_p]).all()
    rows = comparison.rows()
    assert np.isnan([row[p] for row in rows for p in ("p", "adjusted_p", "beats_controls_p")]).all()
    assert rows[1]["verdict"] == rows[1]["beats_controls"] == comparison.interim
    assert comparison.reasons["mine"].why == ""
    assert "p =" in whole.text() + repr(whole)
    assert "p =" not in comparison.text() + repr(comparison)
    assert rows[1]["strong_gain"] == whole.rows()[1]["strong_gain"]


def test_seeds_that_are_added_after_a_look_cost_a_correction():
    arms = {"scratch": column(0, 20), "mine": column(2, 20)}
    once, again = compared(**arms), replace(compared(**arms), looks=(5, 8, 12, 20))
    p = once.verdicts["mine"].adjusted_p
    assert again.earlier == [8, 12]  # five seeds allowed no verdict
    assert (
        again.verdicts["mine"].adjusted_p
        == pytest.approx(3 * p, rel=0.5)
        == 3 * again.verdicts["mine"].p
    )
    assert "verdicts with 8 and 12 seeds could be seen: p values are multiplied by 3" in str(again)
    assert "looks" not in str(once)
    few = verdicts_of({"a": column(2), "b": column(0)}, {"a": ["b"]}, looks=[6, 7])["a"]
    assert few.needed == 7
    assert few.adjusted_p == 3 * few.p


@settings(max_examples=200)
@given(st.data())
def test_no_difference_is_shown_beside_an_interval_that_holds_0(data):
    """Sign flips and Student's t differ for skewed differences."""
    seeds, n = data.draw(st.integers(6, 12)), data.draw(st.integers(1, 3))
    skewed = st.floats(-1, 1).map(lambda x: np.sign(x) * abs(x) ** 9 + 0.01)
    rows = st.lists(skewed, min_size=seeds, max_size=seeds)
    returns = {"mine": np.zeros(seeds)} | {f"r{i}": data.draw(rows) for i in range(n)}
    verdict = verdicts_of(returns, {"mine": list(returns)[1:]})["mine"]
    if verdict.direction:
        assert not verdict.gain.low <= 0 <= verdict.gain.high
        assert verdict.adjusted_p < SIGNIFICANT


def test_a_difference_that_sign_flips_alone_would_show_is_not_shown():
    """Seven small gains and a large one: p = 2^-7 by flips, and Student's interval holds 0."""
    gains = [0.1, 0.2, 0.1, 0.3, 0.2, 0.1, 0.2, 9.0]
    assert sign_flip_test(gains) == 2**-7
    verdict = verdicts_of({"mine": gains, "scratch": np.zeros(8)}, {"mine": ["scratch"]})["mine"]
    assert verdict.gain.low < 0 < verdict.gain.high
    assert (verdict.answer, verdict.against_scratch) == ("not shown", "no difference shown")
    assert verdict.p == pytest.approx(stats.ttest_1samp(gains, 0).pvalue)


@settings(max_examples=40)
@given(st.data())
def test_no_verdict_changes_with_the_controls(data):
    seeds = data.draw(st.integers(1, 9))
    row = st.lists(st.integers(-9, 9), min_size=seeds, max_size=seeds)
    curricula = data.draw(st.lists(row, min_size=1, max_size=3))
    controls = [data.draw(st.lists(row, max_size=3)) for _ in curricula]
    alone, beside = {"scratch": data.draw(row)}, {}
    beside |= alone
    for n, (curriculum, rivals) in enumerate(zip(curricula, controls, strict=True)):
        alone[f"arm {n}"] = beside[f"arm {n}"] = curriculum
        beside |= {f"arm {n}, {k}_control": row for k, row in enumerate(rivals)}
    first, second = compared(**alone), compared(**beside)
    for name, contrast in first.contrasts.items():
        other = second.contrasts[name]
        assert (contrast.verdict, contrast.p, contrast.adjusted_p) == (
            other.verdict, other.p, other.adjusted_p,
        )  # fmt: skip
        assert str(first.verdicts[name]) == str(second.verdicts[name])
    assert set(second.control_verdicts) == {
        f"arm {n}" for n, rivals in enumerate(controls) if rivals
    }


# -- a curriculum and its controls -------------------------------------------------------------


def test_the_answer_is_about_the_strongest_control():
    rng = np.random.default_rng(3)
    gains = 10 + rng.normal(size=12)
    placebo, pretraining = 5 + rng.normal(size=12), 8 + rng.normal(size=12)
    comparison = compared(
        scratch=column(0, 12), mine=gains, a_control=placebo, b_control=pretraining
    )
    (verdict,) = comparison.control_verdicts.values()
    assert (verdict.rival, verdict.rivals, verdict.answer) == ("b_control", 2, "yes")
    assert verdict.gain.estimate == pytest.approx((gains - pretraining).mean())
    p = [sign_flip_test(gains - other) for other in (placebo, pretraining)]
    assert verdict.p == max(p)
    sentence = f"mine gains more than each of its 2 controls: {verdict}; the strongest is b_control"
    assert sentence in str(comparison).split("\n")


def test_a_stronger_control_has_to_be_found_among_all():
    """Behind one of n controls: n times its p, since it was picked out of n."""
    returns = {"mine": column(0), "a": column(-1), "b": column(1), "c": column(-2)}
    verdict = verdicts_of(returns, {"mine": "abc"})["mine"]
    assert (verdict.rival, verdict.p, verdict.answer) == ("b", 3 * 2**-7, "no, less")
    alone = verdicts_of(returns, {"mine": "b"})["mine"]
    assert alone.p == 2**-7


def test_the_gain_over_several_rivals_has_the_smallest_of_their_bounds():
    rng = np.random.default_rng(4)
    returns = {name: mean + rng.normal(size=9) for name, mean in (("mine", 9), ("a", 2), ("b", 7))}
    gain = verdicts_of(returns, {"mine": "ab"})["mine"].gain
    over = [returns["mine"] - returns[rival] for rival in "ab"]
    assert gain.low == min(mean_interval(row).low for row in over)
    assert gain.high == min(mean_interval(row, confidence=0.975).high for row in over)


def test_a_placebo_is_judged_by_the_spread_of_its_single_draws():
    """The interval is the prediction interval; that of paired differences is a third as wide."""
    rng = np.random.default_rng(5)
    returns = {"mine": rng.normal(size=9), "placebo": rng.normal(scale=3, size=9) - 4}
    question = {"mine": ["placebo"]}
    gain = verdicts_of(returns, question, placebos=["placebo"])["mine"].gain
    draws, apart = returns["placebo"], returns["mine"].mean() - returns["placebo"].mean()
    half = 2.306004135 * draws.std(ddof=1) * np.sqrt(1 + 1 / 9)
    assert (gain.low, gain.high) == pytest.approx((apart - half, apart + half))
    assert verdicts_of(returns, question)["mine"].answer == "yes"
    assert verdicts_of(returns, question, placebos=["placebo"])["mine"].answer == "not shown"


def test_equal_draws_are_no_difference_by_rounding():
    equal = {"mine": np.full(10, 1 / 3), "placebo": np.full(10, 1 / 3)}
    verdict = verdicts_of(equal, {"mine": ["placebo"]}, placebos=["placebo"])["mine"]
    assert (verdict.p, verdict.direction) == (1.0, 0)


def test_a_rival_at_a_constant_distance_does_not_hide_the_spread_over_another():
    gains = np.array([0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 10.0])
    returns = {"mine": gains, "scratch": np.zeros(7), "hopeless": gains - 100}
    verdict = verdicts_of(returns, {"mine": ["scratch", "hopeless"]})["mine"]
    assert verdict.gain.low < 0 < verdict.gain.high
    assert verdict.against_scratch == "no difference shown"
    alone = verdicts_of(returns, {"mine": ["hopeless"]})["mine"]
    assert np.isnan(alone.gain.low)


# -- arm against arm ---------------------------------------------------------------------------


def test_any_arm_can_be_asked_about(finished, curricle):
    comparison = compared(scratch=column(0), one=column(3), two=column(5), a_control=column(1))
    against = comparison.against("one")
    assert list(against) == ["two"]
    assert (against["two"].answer, against["two"].p) == ("yes", 2**-7)
    assert comparison.against("two")["one"].answer == "no, less"
    assert str(comparison.against("scratch")) == str(comparison.verdicts)
    with pytest.raises(CurriculumError, match="an arm must be one of scratch, one, two"):
        comparison.against("three")
    code, out, _ = curricle("compare", finished, "--against", "chain")
    stored = StudyResults(finished).comparison
    answers = stored.against("chain")
    assert (list(answers), code) == (["state", "scaled"], 0)
    lines = [f"{name} gains more than chain: {verdict}" for name, verdict in answers.items()]
    assert out == "\n".join([str(stored), *lines, ""])
    comparison = compare(corner(), seeds=6)
    gain, contrast = (
        comparison.verdicts["transfer"].gain,
        comparison.contrasts["transfer"].strong_gain,
    )
    assert (gain.estimate, gain.low, gain.high) == (contrast.estimate, contrast.low, contrast.high)


@pytest.mark.parametrize(
    ("returns", "rivals", "message"),
    [
        ([1.0, 2.0, 3.0], [], "an arm to be compared needs a rival: 'mine' has none"),
        ([1.0, 2.0, 3.0], ["z"], "an arm to be compared needs returns: 'z' has none"),
        ([1.0, 2.0], ["b"], "must be of the same seeds: 'mine' has 2, 'b' 3"),
        ([1.0, np.nan, 2.0], ["b"], "differences must be finite: seed 1"),
        ([1.0, np.inf, 2.0], ["b"], "differences must be finite: seed 1"),
    ],
)
def test_questions_that_make_no_sense(returns, rivals, message):
    with pytest.raises(SettingError, match=message):
        verdicts_of({"mine": returns, "b": [0.0, 0.5, 1.0]}, {"mine": rivals})


# -- how many seeds ----------------------------------------------------------------------------


@pytest.mark.parametrize("arms", [1, 2, 3, 4, 7])
def test_with_as_many_seeds_as_needed_and_no_fewer_there_is_a_verdict(arms):
    """The clearest results that there can be: every arm is ahead in every seed."""
    assert seeds_needed(100_000) <= 25
    with pytest.raises(SettingError, match="questions must be a whole number, at least 1: got 0"):
        seeds_needed(0)
    needed = seeds_needed(arms)
    for seeds in range(1, needed + 2):
        rows = {f"arm {n}": column(9 + n, seeds) for n in range(arms)}
        rivals = dict.fromkeys(rows, ("scratch",))
        verdicts = verdicts_of({"scratch": column(0, seeds), **rows}, rivals)
        answers = {verdict.against_scratch for verdict in verdicts.values()}
        p = [verdict.p for verdict in verdicts.values()]
        assert [verdict.adjusted_p for verdict in verdicts.values()] == holm(p).tolist()
        if seeds >= needed:
            assert answers == {"pays"}
        else:
            assert answers == {f"too few seeds for a verdict ({seeds}; {needed} or more)"}
            assert min(verdict.adjusted_p for verdict in verdicts.values()) >= SIGNIFICANT


# -- arms that fail ----------------------------------------------------------------------------


def failing(error, after=0):
    """Return an aggregate that raises an error, at the earliest after so many calls."""
    calls = []

    def aggregate(potentials):
        calls.append(0)
        if len(calls) > after:
            raise error
        return potentials.mean(axis=0)

    return aggregate


BROKEN = CurriculumError("a rule: a value, a place")


@pytest.mark.parametrize("error", [BROKEN, ZeroDivisionError("division by zero")])
def test_an_arm_that_fails_is_reported_and_the_others_stand(error):
    with pytest.raises(CurriculumError, match="a rule: a value, a place"):  # an error of all arms
        compare({name: corner(aggregate=failing(BROKEN)) for name in ("one", "two")}, seeds=2)
    arms = {"good": corner(), "bad": corner(aggregate=failing(error)), "too": corner()}
    named = []
    comparison = compare(arms, seeds=2, controls=["placebo"], progress=named.append)
    wanted = compare({"good": corner(), "too": corner()}, seeds=2, controls=["placebo"])
    assert list(comparison.arms) == list(wanted.arms) == named
    assert comparison.failed == {"bad": error}
    *same, last = str(comparison).split("\n")
    assert same == str(wanted).split("\n")
    words = f"{error}"
    if not isinstance(error, CurriculumError):
        words = rf"ZeroDivisionError: {error} \(raised in aggregate of test_verdicts.py, line \d+\)"
    assert re.fullmatch(f"bad failed: {words}", last)


def test_a_control_that_fails_is_left_out(monkeypatch):
    def broken(*_):
        raise BROKEN

    monkeypatch.setitem(CHANGES, "placebo", broken)
    comparison = compare(corner(), seeds=2, controls=["placebo", "pretraining"])
    assert list(comparison.arms) == ["scratch", "transfer", "transfer, pretraining"]
    assert comparison.failed == {"transfer, placebo": BROKEN}
    assert comparison.control_verdicts["transfer"].rivals == 1


NOISE = 0.1 * np.random.default_rng(5).permutation(12)


def controlled(pays, constant, *, placebo=None):
    """A comparison of an arm that gains `pays` with a constant and a placebo that gain so much."""
    arms = {"scratch": flat(NOISE[::-1]), "mean": flat(pays + NOISE)}
    if placebo is not None:
        arms["mean, placebo"] = flat(placebo + np.roll(NOISE, 3), "mean")
    if constant is not None:
        arms["mean, constant mean"] = flat(
            constant + np.roll(NOISE, 1), "mean", scratch=True, initial_values=np.full(12, 6.25)
        )
    return of_arms(arms)


@pytest.mark.parametrize(
    ("pays", "constant", "placebo", "answer"),
    [
        (10.0, 4.0, 4.0, "pays, by what it knows"),
        (10.0, 9.6, 4.0, "pays, by what it knows"),
        (10.0, 4.0, 11.0, "pays, not by what it knows: a placebo gains more"),
        (10.0, 4.0, 10.0, "pays, not shown to be by what it knows"),
        (10.0, 10.0, 4.0, "no difference shown"),
        (10.0, 11.0, 4.0, "costs more than it brings"),
        (-3.0, -5.0, 4.0, "costs more than it brings"),
    ],
)
def test_an_answer_goes_no_further_than_what_was_shown(pays, constant, placebo, answer):
    """NOISE moves a mean by nothing: equal heights are equal."""
    comparison = controlled(pays, constant, placebo=placebo)
    assert comparison.contrasts["mean"].answer == answer
    verdict, _, reason = answer.partition(", ")
    (row,) = (row for row in comparison.rows() if row["arm"] == "mean")
    assert (row["verdict"], row["reason"]) == (verdict, reason)


def test_gains_are_over_the_best_opponent_which_is_named_with_its_initial_value():
    comparison = controlled(10.0, 8.0, placebo=4.0)
    assert comparison.best_opponent("mean") == "mean, constant mean"
    assert comparison.contrasts["mean"].strong_gain.estimate == pytest.approx(2.0)
    (line,) = (line for line in str(comparison).split("\n") if "the best opponent" in line)
    assert line.startswith("mean, constant mean (initial_value=6.25)")
    assert line.endswith("the best opponent: gains are over it")
    weak = controlled(10.0, -8.0, placebo=4.0)
    assert weak.contrasts["mean"].strong_gain.estimate == pytest.approx(10.0)
    assert "other constants: mean, constant mean (initial_value=6.25) -7." in str(weak)
    assert "mean, constant mean" not in weak.drawn


@pytest.mark.parametrize(("constant", "placebo"), [(None, None), (None, 3.0), (3.0, None)])
def test_a_placebo_or_a_constant_alone_does_not_tell_knowledge_from_optimism(constant, placebo):
    comparison = controlled(10.0, constant, placebo=placebo)
    assert comparison.contrasts["mean"].answer == "pays"
    assert comparison.reasons["mean"].why == "not known"
    assert str(comparison).split("\n")[-1] == f"by what it knows? Not known without {ASKING}"
    assert "Not known" not in str(controlled(-10.0, constant, placebo=placebo))
    assert "Not known" not in str(controlled(10.0, 3.0, placebo=3.0))


def test_a_network_pays_by_what_it_knows_if_it_gains_more_than_its_placebo():
    table = controlled(10.0, None, placebo=3.0)
    network = replace(table["mean"], network=True)
    comparison = replace(table, arms={**table.arms, "mean": network})
    assert comparison.contrasts["mean"].answer == "pays, by what it knows"
    assert "Not known" not in str(comparison)
    assert str(comparison).count("mean gains more than its placebo") == 1
    alone = replace(comparison, arms={name: comparison[name] for name in ("scratch", "mean")})
    assert alone.reasons["mean"].why == "not known"


def test_other_controls_do_not_decide_but_a_placebo_outside_the_portfolio_does():
    """A source that is the target itself knows the task."""
    with_pretraining, with_placebo = (
        of_arms(controlled(10.0, 4.0, placebo=4.0).arms | beside)
        for beside in (
            {"mean, pretraining": flat(20.0 + NOISE, "mean")},
            {"mean, placebo, alone": flat(12.0 + NOISE, "mean")},
        )
    )
    assert with_pretraining.control_verdicts["mean"].rival == "mean, pretraining"
    assert with_pretraining.contrasts["mean"].reason == "by what it knows"
    assert with_placebo.knowledge_verdicts["mean"].rival == "mean, placebo, alone"
    assert with_placebo.reasons["mean"].why == "placebo"


# -- the seeds that a gain needs ------------------------------------------------------------------


def power_of_t(gain, seeds):
    """The power of Student's two-sided test of a gain in standard deviations of a difference."""
    limit, shift = stats.t.ppf(0.975, seeds - 1), gain * math.sqrt(seeds)
    return stats.nct.sf(limit, seeds - 1, shift)


@pytest.mark.parametrize("gain", [0.25, 0.4, 0.6, 0.8, 1.0])
def test_as_many_seeds_are_asked_for_as_students_test_of_one_rival_needs(gain):
    noise = np.random.default_rng(1).normal(size=2_000)
    seeds = seeds_to_show((gain + (noise - noise.mean()) / noise.std(ddof=1))[np.newaxis])
    assert power_of_t(gain, seeds - 2) - 0.02 < 0.8 < power_of_t(gain, seeds) + 0.02


def test_a_gain_over_several_rivals_needs_more_seeds_where_all_are_near():
    rng = np.random.default_rng(2)
    noise = rng.normal(size=(7, 500)) + rng.normal(size=500)  # that of the arm is shared
    noise -= noise.mean(axis=1, keepdims=True)
    near, far = (0.5 + noise + beyond * np.arange(7)[:, np.newaxis] for beyond in (0.0, 2.0))
    alone, with_far, with_near = map(seeds_to_show, (far[:1], far, near))
    assert with_far == pytest.approx(alone, abs=2)
    assert with_near > 1.4 * alone
    assert seeds_to_show(near + 0.5) < with_near == seeds_to_show(4 * near)
    assert seeds_to_show(near, 5) > with_near  # adjusted for five curricula
    assert seeds_to_show(far + 1e6) == seeds_needed() + 2
    assert seeds_to_show(np.full((1, 5), 2.0)) == seeds_needed() + 2  # without a spread
    with pytest.raises(SettingError, match=r"gains must be above 0: rival 1 has -1\.0"):
        seeds_to_show(near - np.arange(7)[:, np.newaxis] * 1.5)


@pytest.mark.parametrize("seeds", [12, 20])
def test_p_values_are_those_of_all_rivals(seeds):
    """Of 30 arms among 20 rivals, from 600 tests."""
    rng = np.random.default_rng(5)
    levels = {f"r{k}": k / 5 for k in range(20)} | {f"a{k}": k / 4 for k in range(30)}
    returns = {name: level + rng.normal(size=seeds) for name, level in levels.items()}
    arms, rivals = list(returns)[20:], list(returns)[:20]
    apart = np.array([[returns[arm] - returns[rival] for rival in rivals] for arm in arms])
    tests = sign_flip_tests(apart.reshape(-1, seeds), resamples=60_000).reshape(30, 20)
    found = verdicts_of(returns, dict.fromkeys(arms, rivals))
    for arm, p, means in zip(arms, tests, apart.mean(axis=2), strict=True):
        expected = p.max() if (means > 0).all() else min(1.0, 20 * p[means < 0].min(initial=1))
        assert found[arm].p in (expected, 0.05)  # where Student's interval holds 0


def test_the_sentence_on_seeds_is_of_the_gain_or_of_half_a_standard_deviation():
    better = compared(scratch=column(0), mine=column(2))
    gain = better.contrasts["mine"].strong_gain.estimate
    seeds = seeds_to_show((better.returns["mine"] - better.returns["scratch"])[np.newaxis])
    said = seeds_sentence(better, "mine", 1, 20)
    assert said == (
        f"about {seeds} seeds show a gain of {gain:.3g} in 80 % of studies of this spread; this "
        "study has 20"
    )
    worse = compared(scratch=column(2), mine=column(0))
    half = np.std(column(2), ddof=1) / 2
    pattern = rf"about (\d+) seeds show a gain of {half:.3g}, half a standard deviation of its"
    few, more = (
        int(re.match(pattern, seeds_sentence(worse, "mine", questions, 20))[1])
        for questions in (1, 4)
    )
    assert few < more
    even = compared(scratch=[1.0] * 8, mine=[1.0] * 8)
    rounded = compared(scratch=[9.0] * 7 + [9.0 + 1e-13], mine=[0.0] * 8)
    assert seeds_sentence(even, "mine", 1, 20) == seeds_sentence(better, "failed", 1, 20) == ""
    assert seeds_sentence(rounded, "mine", 1, 20) == ""


# -- the steps that an arm saves ------------------------------------------------------------------


def taken(*steps, never=()):
    """The steps of each seed to the threshold; of some seeds the steps until they were given up."""
    return Times(np.array(steps, float), ~np.isin(np.arange(len(steps)), never))


def numbers_of(interval):
    return [interval.estimate, interval.low, interval.high]


def test_a_share_of_steps_saved_by_hand():
    """The errors of ln(400 / 150) are 300 / 400 - 100 / 150 = 1 / 12 and as much less."""
    half = 12.7062047 * math.sqrt(2) / 12 / math.sqrt(2)
    wanted = [1 - 150 / 400 * math.exp(way * half) for way in (0, 1, -1)]
    share = steps_saved_share(taken(100, 200), [taken(300, 500)])
    assert numbers_of(share) == pytest.approx(wanted, abs=1e-7)
    assert (share.confidence, share.n) == (0.95, 2)
    slower = steps_saved_share(taken(300, 500), [taken(100, 200)])
    assert slower.estimate == pytest.approx(1 - 400 / 150)


def test_a_share_of_steps_saved_is_of_the_quickest_opponent():
    arm, quick, slow = taken(10, 12, 11), taken(20, 22, 25), taken(90, 99, 80)
    alone, both = (steps_saved_share(arm, of) for of in ([quick], [slow, quick]))
    assert both.estimate == alone.estimate == pytest.approx(1 - 33 / 67)
    assert both.low == pytest.approx(alone.low)
    assert alone.high < both.high < steps_saved_share(arm, [slow]).high  # corrected for two


NAN, INF = math.nan, math.inf


@pytest.mark.parametrize(
    ("arm", "opponents", "estimate", "low", "high"),
    [
        # no seed of the opponent: all are lower bounds, and so is the share
        (taken(10, 20), [taken(90, 90, never=[0, 1])], 1 - 30 / 180, "any", 1.0),
        # a slower opponent has all seeds, and bounds the share from above
        (taken(10, 20), [taken(80, 90, never=[1]), taken(99, 95)], 1 - 30 / 170, "any", "any"),
        (taken(10, 90, never=[1]), [taken(30, 20)], -1.0, -INF, "any"),
        (taken(10, 90, never=[1]), [taken(30, 90, never=[1])], NAN, NAN, NAN),
        (taken(10, 90, never=[1]), [taken(30, 90, never=[1]), taken(80, 85)], NAN, NAN, NAN),
        (taken(0, 0), [taken(30, 90, never=[1])], 1.0, NAN, NAN),
        (taken(10, 20), [taken(0, 0), taken(10, 20)], NAN, NAN, NAN),
        (taken(0, 0), [taken(0, 0)], NAN, NAN, NAN),
        # no spread, no interval: also where other opponents have a spread
        (taken(10, 10), [taken(40, 40)], 0.75, NAN, NAN),
        (taken(10, 10), [taken(30, 50), taken(80, 80)], 0.75, "any", "any"),
        (taken(10, 10), [taken(30, 50, never=[1]), taken(80, 80)], 0.75, "any", 1 - 10 / 80),
        (taken(10), [taken(40)], 0.75, NAN, NAN),
    ],
)
def test_a_share_of_steps_that_were_not_all_taken_is_a_bound(arm, opponents, estimate, low, high):
    share = steps_saved_share(arm, opponents)
    for number, wanted in zip(numbers_of(share), (estimate, low, high), strict=True):
        assert (
            np.isfinite(number) if wanted == "any" else number == pytest.approx(wanted, nan_ok=True)
        )
    assert not share.low > share.estimate
    assert not share.high < share.estimate


def test_only_steps_that_were_all_taken_bound_a_share_from_above():
    arm, slow = taken(10, 11, 10), taken(80, 81, 82)
    share = steps_saved_share(arm, [taken(40, 41, 42, never=[2]), slow])
    assert share.estimate == pytest.approx(1 - 31 / 123)
    assert share.high == steps_saved_share(arm, [slow]).high > 1 - 31 / 243


def test_the_interval_of_a_share_is_that_of_the_bootstrap():
    rng = np.random.default_rng(3)
    arm, opponent = rng.lognormal(5, 0.5, 200), rng.lognormal(6, 0.4, 200)
    share = steps_saved_share(taken(*arm), [taken(*opponent)])
    drawn = rng.integers(200, size=(20_000, 200))  # seeds, so that pairs stay pairs
    shares = 1 - arm[drawn].mean(axis=1) / opponent[drawn].mean(axis=1)
    assert [share.low, share.high] == pytest.approx(np.quantile(shares, [0.025, 0.975]), abs=0.005)


def test_a_comparison_says_which_share_of_whose_steps_each_curriculum_saves():
    def arm(*learnt_at, **kind):
        return arm_of([[0.0] * at + [1.0] * (9 - at) for at in learnt_at], **kind)

    arms = {
        "scratch": arm(6, 7, 8, 8),
        "scratch, quick": arm(4, 4, 5, 5, scratch=True),
        "scratch, high": arm_of([[0, 0, 0, 0, 0, 0, 9, 9, 9]] * 4, scratch=True),
        "good": arm(1, 2, 1, 2),
        "good, placebo": arm(8, 8, 8, 9, curriculum="good"),
        "late": arm(5, 6, 7, 9),
    }
    comparison = Comparison("maze", arms, 80, 80, Reference(1.0), 1)
    assert comparison.best_opponent("good") == "scratch, high"
    assert comparison.quickest_opponent("good") == "scratch, quick"
    rows = {row["arm"]: row for row in comparison.rows()}
    assert rows["good"]["share_of_steps_saved"] == pytest.approx(1 - 60 / 180)
    assert rows["late"]["share_of_steps_saved_low"] == -np.inf
    assert np.isnan(rows["scratch"]["share_of_steps_saved"])
    of = "as a share of the quickest opponent's (scratch, quick):"
    lines = str(comparison).splitlines()
    good = f"steps to the threshold saved by good, {of} 0.667 [0."
    assert [line for line in lines if line.startswith(good)]
    assert [line for line in lines if f"saved by late, {of} at most -0.44" in line]
    assert not [line for line in lines if "saved by good, placebo" in line]
    cells = {name: row["share_of_steps_saved"] for name, row in page_table(comparison).items()}
    assert cells["scratch, quick"] == ("", "")
    assert (cells["good"].text, cells["late"].text[:8]) == ("0.667", "at most ")
    assert cells["good, placebo"].text.startswith("at most −")
    (good,) = [finding for finding in findings(comparison) if finding.arm == "good"]
    assert any(f"Steps to the threshold saved by good, {of}" in said for said in good.sentences)
    assert share_saved(comparison, "good", "scratch").startswith("0.793 [")  # of 15 / 72.5
    assert share_saved(comparison, "late", "scratch, quick").startswith("at most -0.444 [-inf, ")
    both = replace(comparison, arms={name: arms[name] for name in ("scratch", "late")})
    assert "as a share of those of scratch: at most" in str(both)
    never = replace(both, arms={**both.arms, "scratch": arm(6, 7, 9, 9)})
    assert "as a share of those of scratch: unknown (seeds of both never get there)" in str(never)
    nowhere = replace(both, arms={"scratch": arm(9, 9, 9, 9), "late": arm(9, 9, 9, 9)})
    assert "saved by" not in str(nowhere)
    best = replace(comparison, arms={**arms, "scratch, high": arms["scratch, quick"]})
    assert best.quickest_opponent("good") == best.best_opponent("good")
