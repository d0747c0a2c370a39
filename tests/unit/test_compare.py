"""Comparisons at one total budget: what is held equal, and which threshold is used."""

from dataclasses import replace

import numpy as np
import pytest

import curricle as cr
from curricle import Curriculum, Episodes, FiniteMDP, GreedyEvaluation, GridWorld
from curricle.errors import CurriculumError, SettingError
from curricle.planning import target as target_module
from curricle.statistics.curves import midpoint
from curricle.transfer import UNMAPPED, StateActionMapping
from tests.support.comparisons import (
    ALL,
    CORNER,
    HERE,
    MAZE,
    alone as compare,
    assert_same,
    copied,
    corner,
    pursuit,
)
from tests.support.tasks import ring

NOWHERE = StateActionMapping(MAZE, CORNER, np.full(HERE.index.shape, UNMAPPED))


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


def test_the_total_is_a_whole_number_of_checkpoints():
    comparison = compare(corner(source=300, target=1000, eval_freq=70), seeds=1, window=1)
    assert comparison.total == 1330
    assert comparison.arms["transfer"].curve.steps[-1] == 1330


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


def test_an_arm_with_an_empty_mapping_is_scratch_after_its_source_steps():
    comparison = compare(corner(NOWHERE), seeds=4)
    scratch, arm = comparison.scratch, comparison["transfer"]
    assert np.ptp(scratch.curve.values) > 0
    n = 3000 // 100 + 1
    np.testing.assert_array_equal(arm.curve.values[:, :n], scratch.curve.values[:, :n])
    charged = arm.charged(scratch).values
    np.testing.assert_array_equal(charged[:, 5:], scratch.curve.values[:, :-5])
    assert (charged[:, :5] == scratch.curve.values[:, :1]).all()


def test_scratch_has_the_settings_of_the_target():
    learner, evaluation = cr.QLearning(epsilon=0.3), GreedyEvaluation(discounted=False)
    comparison = compare(
        corner(learner={"maze": learner}, evaluation={"maze": evaluation}), seeds=2
    )
    alone = cr.learn(
        MAZE, learner, 3500, seeds=2, eval_freq=100, evaluation=evaluation, stream="maze"
    )
    np.testing.assert_array_equal(comparison.scratch.curve.values, alone.greedy_return)


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


@pytest.mark.parametrize(("mapping", "said"), [(NOWHERE, True), (HERE, False)])
def test_a_curriculum_that_reads_nothing_where_learning_goes_is_named(mapping, said):
    comparison = cr.compare(corner(mapping), seeds=2, opponents=["constant"])
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
        GridWorld("S..T", rewards=cr.Rewards(step=0.0), discount=1.0, time_limit=20),
        # 1 now or 5 later: at this discount 1 now is optimal, and half of the 6 is more.
        FiniteMDP.from_outcomes(
            [[[(1.0, 2, 1.0)], [(1.0, 1, 0.0)]], [[(1.0, 2, 5.0)]] * 2, [[], []]],
            terminal=[False, False, True],
            start=0,
            discount=0.1,
            time_limit=20,
        ),
    ],
    ids=["nothing to choose", "free rounds at discount 1", "too impatient"],
)
def test_without_a_usable_optimum_the_threshold_is_the_midpoint_of_scratch(task):
    summed = GreedyEvaluation(discounted=False)
    comparison = compare(copied(replace(task, time_limit=20), evaluation=summed), seeds=2)
    assert comparison.threshold == midpoint(comparison.scratch.curve)


def test_a_curriculum_without_transfers_equals_scratch():
    plan = Curriculum({"maze": MAZE}, budget={"maze": 1000}, eval_freq=100)
    comparison = compare({"plain": plan}, seeds=3)
    assert comparison.total == 1000
    np.testing.assert_array_equal(comparison["plain"].curve.values, comparison.scratch.curve.values)
    assert comparison.contrasts["plain"].p == 1.0


def test_sources_may_be_learnt_otherwise():
    first, two = (copied(MAZE, learner={"near": kind()}) for kind in (cr.QLearning, cr.SARSA))
    assert compare({"one": first, "two": two}, seeds=1).seeds == 1


def test_the_same_problem_as_tables_is_compared():
    comparison = compare({"maze": copied(MAZE), "tables": copied(MAZE.mdp)}, seeds=2)
    assert_same(comparison["maze"], comparison["tables"])


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
        (corner(target=cr.Episodes(9)), {}, "needs the target's in steps: 'maze' has 9 episodes"),
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
        ({"mine": PLAIN}, {"controls": ["negated"]}, "arm 'mine' has none into 'maze'"),
        (copied(ring()), {"controls": ["placebo"]}, "given by functions or played live has no tab"),
        ({"mine": SPARSE}, {"controls": ["pretraining"]}, "of 'hunt' is sparse in arm 'mine'"),
        (corner(), {"window": 0}, "window must be a whole number, at least 1: got 0"),
        (corner(), {"window": 32}, "at most 31, the checkpoints within .* budget: got 32"),
        (corner(), {"threshold": float("nan")}, "threshold must be finite: got nan"),
        (corner(), {"seeds": 0}, "seeds must be a whole number, at least 1: got 0"),
    ],
)
def test_what_makes_no_sense_is_refused_before_anything_is_trained(arms, settings, message, calls):
    with pytest.raises((CurriculumError, SettingError, cr.errors.TaskError), match=message):
        cr.compare(arms, **({"seeds": 1} | settings))
    assert calls == []
