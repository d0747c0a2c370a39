"""Comparisons: measures, rows and tables worked out by hand; what is held equal at one total."""

from dataclasses import replace
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest

import curricle as cr
from curricle import Curriculum, Episodes, FiniteMDP, GreedyEvaluation
from curricle.comparison import Comparison, Reference
from curricle.comparison.measures import MEASURES
from curricle.comparison.sentences import (
    cluster_sentence,
    findings,
    headline,
    lines_below,
    meanings,
    nothing_learnt,
    page_table,
    steps_and_gain,
)
from curricle.errors import CurriculumError, SettingError
from curricle.planning import Target, target as target_module
from curricle.statistics.curves import midpoint
from curricle.statistics.intervals import interquartile_interval
from curricle.transfer.rollouts import target_of
from tests.support.comparisons import (
    ALL,
    MAZE,
    alone as compare,
    arm_of,
    assert_same,
    copied,
    corner,
    flat,
    pursuit,
)
from tests.support.tasks import ring

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
    assert helped.share_of_steps_saved.estimate == pytest.approx(1 / 3)  # 20 instead of 30
    assert helped.strong_gain.estimate == (0 + 10 + 30 + 40) / 40 - (0 + 5 + 15 + 25) / 40
    assert helped.asymptotic_gain.estimate == 1.0
    assert helped.probability_of_improvement.estimate == 1.0
    assert misled.jumpstart.estimate == -2.0
    assert misled.weak_steps_saved.estimate == 0.0  # 20 and 20 at most, and 20 and 20
    assert misled.share_of_steps_saved.estimate == pytest.approx(1 - 35 / 30)  # 40 and 30
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
    assert comparison.contrasts["later"].share_of_steps_saved.estimate == pytest.approx(0.5)
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


def test_clusters_that_are_close_by_the_range_of_returns_are_not_named():
    heights = np.array([139.2, 139.3, 141.5, 141.5, 141.6, 141.5])
    close = np.repeat(heights[:, None], 11, axis=1)
    comparison = comparison_of(scratch=close - 100, close=close)
    assert cluster_sentence(comparison, "close")
    wide = replace(comparison.reference, possible=(-2_600.0, 200.0))
    assert cluster_sentence(replace(comparison, reference=wide), "close") == ""


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


def test_where_no_arm_is_above_random_play_there_is_neither_a_threshold_nor_a_gain():
    rng = np.random.default_rng(0)
    low, lower = (rng.normal(height, 0.1, (8, 9)) for height in (1.0, 0.95))
    reference = Reference(0.5, random_return=1.0, random_noise=0.1)
    nobody = replace(comparison_of(scratch=lower, mine=low), reference=reference)
    assert str(nobody).splitlines()[0].endswith("threshold -")
    assert lines_below(nobody)[0].startswith("nobody learnt: no arm is above random play (1) by")
    assert not nobody.times("mine").reached.any()
    (row,) = [row for row in nobody.rows() if row["arm"] == "mine"]
    assert row["verdict"] == nobody.verdicts["mine"].answer == "nobody learnt"
    numbers = ("strong_gain", "weak_gain", "steps_to_threshold", "p", "share_of_steps_saved")
    assert np.isnan([row[name] for name in numbers]).all()
    assert headline(nobody).startswith("Nobody learnt: no arm is above random play")
    assert [finding.tone for finding in findings(nobody)] == ["open"]
    one_seed = np.where(np.arange(8)[:, None] == 5, 9.0, low)  # one of eight learnt
    stuck = np.where(np.arange(8)[:, None] < 2, -900.0, 9.0).repeat(9, 1)  # two are far below
    assert page_table(nobody)["mine"]["steps_to_threshold"].text == "−"
    assert "nan" not in str(dict(meanings(nobody)))
    for learnt in (low + 0.5, one_seed, stuck):
        some = replace(nobody, arms={**nobody.arms, "mine": arm_of(learnt)})
        assert some.nobody == ""
        assert np.isfinite(some.contrasts["mine"].strong_gain.estimate)


@pytest.mark.parametrize("threshold", [None, 0.0])
def test_random_play_is_measured_where_the_target_is_not_solved(threshold):
    names = ("cart", "speed", "pole", "turn")
    bins = cr.interop.Bins({name: [-1.0, 0.0, 1.0] for name in names})
    live = cr.from_gymnasium("CartPole-v1", discount=1.0, encode=bins)
    node = cr.Curriculum({"cart": live}, budget=100, eval_freq=50).node("cart")
    reference = Reference.before(node, threshold)
    assert 15 < reference.random_return < 30
    assert 0 < reference.random_error < reference.random_noise < 15
    exact = Reference.before(corner().node("maze"), None)
    assert (exact.random_noise, exact.random_return < exact.optimum) == (0.0, True)
    sampled = cr.GreedyEvaluation("rollouts", episodes=200_000)  # as many as there may be
    assert 0 < Reference.before(corner(evaluation=sampled).node("maze"), threshold).random_noise < 1


def test_random_play_of_a_network_ends_as_its_evaluation_does():
    made, first = [], []

    class Endless(type(gym.make("CartPole-v1").unwrapped)):
        def reset(self, **options):
            first.append(super().reset(**options)[0].tobytes())
            return np.frombuffer(first[-1], np.float32), {}

    def endless():
        made.append(Endless())
        return made[-1]

    task = cr.observation_task(endless, discount=0.9)
    settings = {"learner": cr.deep.DeepLearner(), "budget": 100, "eval_freq": 50}
    evaluation = GreedyEvaluation(discounted=True, episodes=100)
    node = cr.Curriculum({"cart": task}, evaluation=evaluation, **settings).node("cart")
    made.clear()
    first.clear()
    reference = Reference.before(node, None)
    assert 5 < reference.random_return < 10
    # 200 episodes tell the mean as well as an evaluation of each of two seeds.
    assert reference.random_error == pytest.approx(reference.random_noise / 2**0.5)
    assert len(made) <= 52
    assert len({*first}) >= 200
    alone = target_of(task, evaluation, episodes=1)  # whose spread nothing tells
    assert np.isfinite(alone.random_return)
    assert np.isnan(alone.random.noise)


def test_where_the_random_policy_is_optimal_up_to_rounding_there_is_nothing_to_learn():
    target = SimpleNamespace(
        solution=True, optimum=2 + 1e-12, random_return=2.0, optimum_bounds=True
    )
    reference = Reference.of(target)
    assert (reference.threshold, reference.nothing_to_learn) == (None, True)
    assert reference.optimum_bounds
    comparison = comparison_of(scratch=[[2.0, 2.0]], other=[[2.0, 2.0]])
    assert nothing_learnt(comparison) == ""  # 2 is above the threshold
    comparison = replace(comparison, reference=replace(reference, threshold=2.0))
    assert not comparison.times("other").reached.any()
    assert nothing_learnt(comparison) == ""
    assert steps_and_gain(comparison, "other").startswith("nothing to learn, as the random")
    outcomes = [[[(0.5, 1, -1.0), (0.5, 0, -1.0)]], [[]]]
    one_action = cr.FiniteMDP.from_outcomes(
        outcomes, terminal=[False, True], start=0, discount=0.9, time_limit=9
    )
    assert Target.of(one_action).floor == -np.inf


@pytest.mark.parametrize(("more", "gain"), [(1e-9, 0.0), (1e-5, 1e-5), (-1e-5, -1e-5)])
def test_a_gain_within_rounding_is_none(more, gain):
    scratch, helped = flat([1.0]), flat([1.0 + more])
    arms = {"scratch": scratch, "helped": helped}
    contrast = Comparison("maze", arms, 10, 10, Reference(9.0), 1).contrasts["helped"]
    assert contrast.probability_of_improvement.estimate == (np.sign(gain) + 1) / 2


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


def assert_held(arm, last):
    """Nothing of an arm changes after these checkpoints, one a seed."""
    for k, place in enumerate(last):
        row = arm.curve.values[k]
        np.testing.assert_array_equal(row[place:], np.full_like(row[place:], row[place]))


def test_every_arm_has_the_same_total(calls):
    comparison = compare({"small": corner(), "large": corner(source=1500)}, seeds=2, controls=ALL)
    assert (comparison.budget, comparison.total) == (3000, 4500)
    trained = [(call["stream"], call["budget"]) for call in calls]
    again = [("control source", 500), ("maze", 4000)]
    assert trained[:7] == [("maze", 4500), ("corner", 500), *[("maze", 4000)] * 3, *again]
    assert trained[7:9] == again
    again = [("control source", 1500), ("maze", 3000)]
    assert trained[9:] == [("corner", 1500), *[("maze", 3000)] * 3, *again, *again]
    for name, arm in comparison.arms.items():
        spent = 0 if name == "scratch" else 500 if name.startswith("small") else 1500
        assert arm.curve.source_steps.tolist() == [spent, spent]
        assert arm.curve.steps.tolist() == list(range(0, 4501, 100))
        assert_held(arm, [(4500 - spent) // 100] * 2)


def test_arms_share_their_sources(calls):
    """Each arm has what it has alone, but sources with the same settings are trained once."""
    advised = {"corner": cr.QInitialisation(), "maze": cr.LookAheadAdvice()}
    arms = {"one": corner(), "advised": corner(shaping=advised), "longer": corner(source=600)}
    together = compare(arms, seeds=2)
    trained = [(call["stream"], call["budget"]) for call in calls]
    assert [entry for entry in trained if entry[0] == "corner"] == [
        ("corner", 500),
        ("corner", 600),
    ]
    for name in ("one", "advised"):
        alone = compare({name: arms[name], "longer": arms["longer"]}, seeds=2)
        assert_same(together.arms[name], alone.arms[name])


def test_each_seed_has_what_its_own_sources_leave(calls):
    """In a budget of 40 episodes no two seeds take the same steps; 40 x 50 are the most."""
    settings = {"eval_freq": {"far": 20}, "learner": {"near": cr.QLearning(epsilon=0.5)}}
    settings["budget"] = {"near": Episodes(40), "far": 3000}
    comparison = compare(copied(MAZE, **settings), seeds=3, controls=ALL)
    assert comparison.total == 5000
    spent = comparison["transfer"].curve.source_steps
    assert len(set((spent // 20).tolist())) == 3
    for name in list(comparison.arms)[1:]:
        assert comparison[name].curve.source_steps.tolist() == spent.tolist()
        assert_held(comparison[name], (5000 - spent) // 20)
    for k in range(3):
        settings["budget"] = {"near": Episodes(40), "far": int(5000 - spent[k])}
        alone = copied(MAZE, **settings).train([k])["far"]
        n, arm = len(alone.steps), comparison["transfer"]
        np.testing.assert_array_equal(arm.curve.values[k, :n], alone.greedy_return[0])
    controls = [call for call in calls if call["stream"] == "control source"]
    assert sorted(call["budget"] for call in controls) == sorted([*spent.tolist()] * 2)
    for call in controls:
        assert call["budget"] == spent[call["seeds"][0]]


def test_an_arm_with_an_empty_potential_is_scratch_after_its_source_steps():
    learner, evaluation = cr.QLearning(epsilon=0.3), GreedyEvaluation(discounted=False)
    settings = {"learner": {"maze": learner}, "evaluation": {"maze": evaluation}}
    comparison = compare(corner(scale=0.0, **settings), seeds=4)
    how = {"seeds": 4, "eval_freq": 100, "evaluation": evaluation, "stream": "maze"}
    alone = cr.learn(MAZE, learner, 3500, **how)
    np.testing.assert_array_equal(comparison.scratch.curve.values, alone.greedy_return)
    scratch, arm = comparison.scratch, comparison["transfer"]
    assert np.ptp(scratch.curve.values) > 0
    n = 3000 // 100 + 1
    np.testing.assert_array_equal(arm.curve.values[:, :n], scratch.curve.values[:, :n])
    charged = arm.charged(scratch).values
    np.testing.assert_array_equal(charged[:, 5:], scratch.curve.values[:, :-5])
    assert (charged[:, :5] == scratch.curve.values[:, :1]).all()


def test_an_arm_and_its_controls_have_a_guard(calls):
    plan = corner(shaping=cr.QInitialisation(portfolio=cr.Portfolio()))
    compared = compare(plan, seeds=2, controls=ALL, opponents=())
    shapings = [call["shaping"] for call in calls if call["stream"] == "maze" and call["shaping"]]
    bare = [shaping for shaping, *_ in shapings if shaping.portfolio is None]
    assert (len(shapings), len(bare)) == (len(compared.arms) - 1, 1)  # the placebo alone


CLIFF = cr.from_gymnasium("CliffWalking-v1", discount=1.0, time_limit=100)


@pytest.mark.parametrize(("task", "optimum"), [(MAZE, 184.346), (CLIFF, -13.0)])
def test_the_threshold_lies_nine_tenths_of_the_way_to_the_optimum(task, optimum):
    comparison, target = compare(copied(task), seeds=1), cr.planning.Target.of(task)
    assert target.optimum == pytest.approx(optimum, abs=1e-3)
    assert comparison.threshold == pytest.approx(0.9 * target.optimum + 0.1 * target.random_return)
    title = f"threshold {comparison.threshold:.4g} (nine tenths of the way to the optimum)\n"
    assert title in str(comparison)
    stated = compare(copied(task), seeds=1, threshold=50)
    assert stated.threshold == 50.0
    assert "threshold 50 (stated)\n" in str(stated)


@pytest.mark.parametrize(("scale", "said"), [(0.0, True), (1.0, False)])
def test_a_curriculum_that_reads_nothing_where_learning_goes_is_named(scale, said):
    comparison = cr.compare(corner(scale), seeds=2, opponents=["constant"])
    assert (
        "transfer has one value in all pairs that learning can visit" in str(comparison)
    ) == said


def test_the_threshold_of_a_target_too_large_to_solve_is_the_midpoint_of_scratch(monkeypatch):
    monkeypatch.setattr(target_module, "LARGEST_SOLVED", 0)
    comparison = compare(corner(), seeds=3)
    assert comparison.threshold == midpoint(comparison.scratch.curve)
    said = "(midpoint of scratch's curve: no optimum above random play is known)\n"
    assert said in str(comparison)


@pytest.mark.parametrize(
    "task",
    [
        FiniteMDP.from_outcomes(
            [[[(1.0, 1, 5.0)]], [[]]], terminal=[False, True], start=0, discount=0.9
        ),
        # 1 now or 5 later: at this discount 1 now is optimal, and half of the 6 is more.
        FiniteMDP.from_outcomes(
            [[[(1.0, 2, 1.0)], [(1.0, 1, 0.0)]], [[(1.0, 2, 5.0)]] * 2, [[], []]],
            terminal=[False, False, True],
            start=0,
            discount=0.1,
            time_limit=20,
        ),
    ],
    ids=["nothing to choose", "too impatient"],
)
def test_without_a_usable_optimum_the_threshold_is_the_midpoint_of_scratch(task):
    summed = GreedyEvaluation(discounted=False)
    comparison = compare(copied(replace(task, time_limit=20), evaluation=summed), seeds=2)
    assert comparison.threshold == midpoint(comparison.scratch.curve)


def test_a_curriculum_without_transfers_is_scratch_and_the_best_learner_is_named():
    plan = Curriculum({"maze": MAZE}, budget={"maze": 1000}, eval_freq=100)
    comparison = compare({"plain": plan}, seeds=9, opponents=["bounds", "optimistic"])
    assert comparison.total == 1000
    assert "plain" not in comparison.arms
    assert not comparison.verdicts
    best = comparison.best_opponents[0]
    others = [name for name in comparison.arms if name != best]
    gains = comparison.returns[best] - np.array([comparison.returns[name] for name in others])
    assert (gains.mean(axis=1) >= 0).all()
    (sentence,) = (line for line in comparison.sentences if line.startswith("no arm has a source"))
    assert f"better than each other learner: {comparison.best_learner}" in sentence
    assert "costs more" not in str(comparison)
    alone = compare({"plain": plan}, seeds=2, opponents=[])
    assert alone.best_learner is None
    assert "no arm has a source, and no other learner was compared" in str(alone)
    plain = Curriculum({"far": MAZE}, budget={"far": 1000}, eval_freq=100)
    other = copied(MAZE, budget={"near": 100, "far": 1000}, eval_freq=100)
    both = compare({"plain": plain, "other": other}, seeds=2)
    assert [*both.verdicts] == ["other"]
    comparison = compare(corner(source=300, target=1000, eval_freq=70), seeds=1, window=1)
    assert comparison.total == 1330  # a whole number of checkpoints
    assert comparison.arms["transfer"].curve.steps[-1] == 1330
    # Sources may be learnt otherwise, and the same problem as tables is compared.
    sarsa = copied(MAZE, learner={"near": cr.SARSA()})
    comparison = compare({"a": copied(MAZE), "b": copied(MAZE.mdp), "sarsa": sarsa}, seeds=2)
    assert_same(comparison["a"], comparison["b"])


# -- refusals ------------------------------------------------------------------------------------


THREE = {"near": cr.Episodes(3), "far": 100}
SPARSE = pursuit(storage={"hunt": cr.Storage(kind="sparse")})
PLAIN = cr.Curriculum({"maze": MAZE}, budget=9)


def pair(*rivals, **settings):
    """Return arms: a copied curriculum, others, and one with these settings of its target."""
    changed = copied(MAZE, **{which: {"far": setting} for which, setting in settings.items()})
    return dict(zip(["one", "two", "three"], [copied(MAZE), *(rivals or [changed])], strict=False))


@pytest.mark.parametrize(
    ("arms", "settings", "message"),
    [
        ({}, {}, "a comparison needs at least one curriculum: got none"),
        ([corner()], {}, r"arms, unless they are one curriculum, must be a Mapping: got \["),
        ({"mine": 3}, {}, "arm 'mine' must be a Curriculum: got 3"),
        ({"scratch": corner()}, {}, "'scratch' names two; rename the arm or learner"),
        (
            {"A": corner(), "A, placebo": corner(source=900)},
            {"controls": ["placebo"]},
            "arms must have other names than controls and opponents: 'A, placebo' names two",
        ),
        ({"scratch, OptimisticQLearning": corner()}, {}, "'scratch, OptimisticQLearning' names"),
        (
            corner(target=cr.Episodes(9)),
            {},
            "total .* 'maze' is 9 episodes; give it in steps",
        ),
        (cr.Curriculum({"a": MAZE, "b": MAZE}), {}, "one task that no other builds on: got a, b"),
        (copied(replace(MAZE, time_limit=None), budget=THREE), {}, "with a time limit: none set"),
        (
            pair(copied(MAZE), copied(replace(MAZE, discount=0.5, time_limit=7))),
            {},
            r"those of 'one' and 'three' differ in discount \(0.99 against 0.5\); "
            r"time_limit \(50 against 7\)$",
        ),
        (pair(copied(MAZE, target="away")), {}, "'one' and 'two' have 'far' and 'away'$"),
        (pair(evaluation=GreedyEvaluation(discounted=False)), {}, "evaluation: 'one' and 'two' ha"),
        (pair(learner=cr.QLearning(epsilon=0.2)), {}, r"learner: 'one' .* and QLearning\(.*0\.2"),
        (pair(learner=cr.SARSA()), {}, "learner: 'one' and 'two' have QLearning.* and SARSA"),
        (corner(), {"controls": ["negated", "magic"]}, "random_start, .*, unrelated: got 'magic'"),
        (corner(), {"controls": "placebo"}, "controls must be a list of names: got 'placebo'"),
        (
            {"mine": PLAIN},
            {"controls": ["negated"]},
            "arm 'mine' has neither a transfer into 'maze'",
        ),
        (copied(ring()), {"controls": ["placebo"]}, "given by functions or played live has no tab"),
        ({"mine": SPARSE}, {"controls": ["pretraining"]}, "of 'hunt' is sparse in arm 'mine'"),
        (corner(), {"window": 0}, "window must be a whole number, at least 1: got 0"),
        (corner(), {"threshold": float("nan")}, "threshold must be finite: got nan"),
        (corner(), {"seeds": 0}, "seeds must be a whole number, at least 1: got 0"),
    ],
)
def test_what_makes_no_sense_is_refused_before_anything_is_trained(arms, settings, message, calls):
    with pytest.raises((CurriculumError, SettingError, cr.errors.TaskError), match=message):
        cr.compare(arms, **({"seeds": 1} | settings))
    assert calls == []
