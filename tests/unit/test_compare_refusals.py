"""Comparisons that are refused before anything is trained."""

from dataclasses import replace

import pytest

import curricle as cr
from curricle.errors import CurriculumError, SettingError
from tests.comparisons import MAZE, copied, corner, pursuit


def test_targets_that_differ_are_refused_with_all_their_differences(calls):
    other = replace(MAZE, discount=0.5, time_limit=7)
    with pytest.raises(CurriculumError) as caught:
        cr.compare({"one": copied(MAZE), "two": copied(MAZE), "three": copied(other)}, seeds=1)
    assert str(caught.value) == (
        "arms must share their target: those of 'one' and 'three' differ in discount "
        f"({MAZE.discount} against 0.5); time_limit ({MAZE.time_limit} against 7)"
    )
    assert calls == []


@pytest.mark.parametrize(
    ("which", "mine", "yours"),
    [
        ("evaluation", cr.GreedyEvaluation(), cr.GreedyEvaluation(discounted=False)),
        ("budget", 100, 200),
        ("learner", cr.QLearning(), cr.QLearning(epsilon=0.2)),
        ("learner", cr.QLearning(), cr.SARSA()),
        ("eval_freq", 10, 20),
    ],
)
def test_targets_with_different_settings_are_refused(which, mine, yours, calls):
    one, two = (copied(MAZE, **{which: {"far": setting}}) for setting in (mine, yours))
    with pytest.raises(CurriculumError) as caught:
        cr.compare({"one": one, "two": two}, seeds=1)
    assert str(caught.value) == (
        f"arms must share their target's {which}: 'one' and 'two' have {mine} and {yours}"
    )
    assert calls == []


def test_targets_of_other_names_are_refused():
    with pytest.raises(CurriculumError) as caught:
        cr.compare({"one": copied(MAZE), "two": copied(MAZE, target="away")}, seeds=1)
    assert str(caught.value) == (
        "arms must share their target: 'one' and 'two' have 'far' and 'away'"
    )


RING = cr.ComputedMDP(
    cr.Space([cr.Component("place", 9)]),
    cr.Space([cr.Component("move", 2)]),
    lambda data, bits: 1,
    lambda data, state, action, bits: (state - 1 + 2 * action, -1.0, state < 1),
)


SPARSE = cr.Storage(kind="sparse")
THREE = {"near": cr.Episodes(3), "far": 100}


@pytest.mark.parametrize(
    ("arms", "message"),
    [
        ({}, "a comparison needs at least one curriculum: got none"),
        ([corner()], r"arms, unless they are one curriculum, must be a Mapping: got \["),
        ({"mine": 3}, "arm 'mine' must be a Curriculum: got 3"),
        ({"scratch": corner()}, "the name 'scratch' is taken by the baseline: rename this arm"),
        (corner(target=cr.Episodes(9)), "needs the target's in steps: 'maze' has 9 episodes"),
        (cr.Curriculum({"a": MAZE, "b": MAZE}), "one task that no other builds on: got a, b"),
        (copied(replace(MAZE, time_limit=None), budget=THREE), "with a time limit: none set"),
    ],
)
def test_bad_arms_are_refused_before_anything_is_trained(arms, message, calls):
    with pytest.raises((CurriculumError, SettingError, cr.errors.TaskError), match=message):
        cr.compare(arms, seeds=1)
    assert calls == []


@pytest.mark.parametrize(
    ("arm", "controls", "message"),
    [
        (corner(), ["negated", "magic"], "must be one of random_start, .*, negated: got 'magic'"),
        (corner(), "placebo", "controls must be a list of names: got 'placebo'"),
        (cr.Curriculum({"maze": MAZE}, budget=9), ["scaled"], "arm 'mine' has none into 'maze'"),
        (copied(RING), ["placebo"], "a task given by functions or played live has no tables"),
        (pursuit(storage={"hunt": SPARSE}), ["pretraining"], "of 'hunt' is sparse in arm 'mine'"),
    ],
)
def test_bad_controls_are_refused_before_anything_is_trained(arm, controls, message, calls):
    with pytest.raises((CurriculumError, SettingError, cr.errors.TaskError), match=message):
        cr.compare({"mine": arm}, seeds=1, controls=controls)
    assert calls == []


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"window": 0}, "window must be a whole number, at least 1: got 0"),
        ({"window": 32}, "at most 31, the checkpoints within the target's budget: got 32"),
        ({"threshold": float("nan")}, "threshold must be finite: got nan"),
        ({"seeds": 0}, "seeds must be a whole number, at least 1: got 0"),
        ({"precision": 1.0}, "to begin adding with must be a whole number, at least 2"),
        ({"seeds": 5, "precision": 0.0}, "precision must be above 0: got 0"),
        ({"seeds": 5, "precision": 1.0, "difference": True}, "or at a difference, one of them"),
        ({"seeds": 30, "difference": True, "most_seeds": 20}, "at least 30: got 20"),
    ],
)
def test_bad_settings_are_refused_before_anything_is_trained(settings, message, calls):
    with pytest.raises(SettingError, match=message):
        cr.compare(corner(), **({"seeds": 1} | settings))
    assert calls == []
