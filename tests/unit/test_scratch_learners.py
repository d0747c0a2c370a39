"""Further learners from scratch: each an arm, also of study files; the verdict is on the best."""

import numpy as np
import pytest

import curricle as cr
from curricle import SARSA, QLearning
from curricle.errors import ConfigError, CurriculumError, SettingError
from curricle.study import StudyConfig, run_study
from curricle.study.analysis import study_record
from curricle.study.arms import Arms
from curricle.study.record import StudyRecord, read_record
from tests.support.comparisons import (
    MAZE,
    alone as compare,
    assert_same,
    copied,
    corner,
    flat,
    of_arms,
    pursuit,
)
from tests.support.studies import CORNER, reader

FURTHER = """
[scratch_learners.optimistic]
initial_value = 50.0

[scratch_learners.sarsa]
type = "SARSA"
"""
NAMES = ("scratch", "scratch, optimistic", "scratch, sarsa")
CONTROLS = 'controls=["placebo", "pretraining"]'
SET = [
    *("seeds=2", "window=1", "opponents=[]", "learner.learning_rate=0.2"),
    *("tasks.maze.time_limit=50", "tasks.maze.budget=1_000", "tasks.corner.budget=200"),
]


def study(tmp_path, text=FURTHER, changes=()):
    return reader(tmp_path)(CORNER + text, set=[*SET, *changes])


def test_each_changes_the_targets_own_learner(tmp_path):
    arms = Arms.of(study(tmp_path))
    assert tuple(arms.curricula) == (*NAMES, "transfer")
    assert tuple(name for name, arm in arms.arms.items() if arm.scratch) == NAMES
    learners = [arms.curricula[name].setting("learner", "maze") for name in NAMES]
    assert learners[:2] == [
        QLearning(learning_rate=0.2),
        QLearning(learning_rate=0.2, initial_value=50.0),
    ]
    assert learners[2] == SARSA(learning_rate=0.2)
    assert all(arms.curricula[name].order == ("maze",) for name in NAMES)
    assert {arms.curricula[name].setting("budget", "maze") for name in arms.curricula} == {1200}


def test_without_them_nothing_changes(tmp_path):
    """The keys of stored units are those of a study that has no such learners."""
    plain_keys, keys = Arms.of(study(tmp_path, "")).keys, Arms.of(study(tmp_path)).keys
    assert plain_keys == {place: key for place, key in keys.items() if place[0] not in NAMES[1:]}
    assert len(set(keys.values())) == len(keys)


def test_they_survive_as_plain_data(tmp_path):
    original = study(tmp_path)
    again = StudyConfig.from_data(original.to_data(), original.folder)
    assert again == original
    assert Arms.of(again).keys == Arms.of(original).keys
    record = study_record(original, Arms.of(original))
    assert [name for name, arm in record.arms.items() if arm.scratch] == [*NAMES]
    assert read_record(StudyRecord, record.model_dump(mode="json")).arms == record.arms
    assert record.groups() == [("transfer",)]


@pytest.mark.parametrize(
    ("text", "changes", "message"),
    [
        ("[scratch_learners.a]\nepsilon = 2.0", [], r"scratch_learners\.a cannot be compared: eps"),
        ("[scratch_learners.a]\nepsilom = 0.2", [], r"scratch_learners\.a\.epsilom is unknown"),
        ("", ["scratch=false", CONTROLS], "controls need the comparison with scratch"),
        ("", ['controls=["placebos"]'], "controls"),
        (FURTHER, ["scratch=false"], "scratch_learners are compared with the target's own"),
        (f'{FURTHER}[arms."scratch, sarsa"]', [], "must have another name: a learner has it"),
    ],
)
def test_what_makes_no_sense_is_refused_in_a_sentence(tmp_path, text, changes, message):
    with pytest.raises((ConfigError, SettingError), match=message):
        Arms.of(study(tmp_path, text, changes))


def test_controls_of_a_study_are_those_of_compare(tmp_path):
    checked = study(tmp_path, changes=["seeds=7", CONTROLS])
    results = run_study(checked, tmp_path / "out", progress=False)
    stored, compared = results.comparison, cr.compare(checked)
    assert list(stored.arms) == list(compared.arms)
    assert (stored.scratches, stored.verdicts["transfer"].rivals) == (NAMES, 3)
    assert str(stored) == str(compared)
    for name, arm in compared.arms.items():
        there = stored.arms[name]
        np.testing.assert_array_equal(there.curve.values, arm.curve.values)
        np.testing.assert_array_equal(there.curve.source_steps, arm.curve.source_steps)
        assert (there.scratch, there.curriculum) == (arm.scratch, arm.curriculum)
        assert (there.initial_values is None) == (arm.initial_values is None)
        if arm.initial_values is not None:
            np.testing.assert_array_equal(there.initial_values, arm.initial_values)
    sources = {arms.keys["corner"] for arms in Arms.of(checked).arms.values() if arms.of}
    assert sources == {Arms.of(checked).keys["transfer", "corner"]}  # trained once
    assert results.record.groups() == [("transfer",)]
    record = results.record.model_dump(mode="json")
    record["arms"]["transfer, placebo"]["control_of"] = "another"
    with pytest.raises(ValueError, match=r"control_of must be the arm before its controls"):
        read_record(StudyRecord, record)


FAST = QLearning(learning_rate=0.5)


def column(height, seed=0):
    return height + 0.1 * np.random.default_rng(seed).permutation(9)


def by_hand(height_of_arm, *further):
    arms = {"scratch": flat(column(0.0))}
    for n, height in enumerate(further):
        arms[f"scratch, {n}"] = flat(column(height, n + 1), scratch=True)
    arms["mine"] = flat(column(height_of_arm, 7))
    return of_arms(arms)


def test_each_is_an_arm_with_the_same_total(calls):
    learners = {"fast": FAST, "sarsa": SARSA()}
    comparison = compare(corner(), seeds=[3, 5], controls=["placebo"], scratch=learners)
    without = compare(corner(), seeds=[3, 5], controls=["placebo"])
    for name in without.arms:  # those that would be there without are the same bit for bit
        assert_same(comparison[name], without[name])
    names = ["scratch", "scratch, fast", "scratch, sarsa", "transfer", "transfer, placebo"]
    assert list(comparison.arms) == names
    assert comparison.scratches == tuple(names[:3])
    for name, learner in zip(names[1:], learners.values(), strict=False):
        alone = cr.learn(MAZE, learner, 3500, seeds=[3, 5], eval_freq=100, stream="maze")
        np.testing.assert_array_equal(comparison[name].curve.values, alone.greedy_return)
        assert comparison[name].curve.source_steps.tolist() == [0, 0]
    assert [call["budget"] for call in calls[:3]] == [3500] * 3
    assert all(name.startswith("transfer") for name in comparison.contrasts)


def test_the_shaping_of_a_target_does_not_change_what_others_learn_from_scratch(calls):
    """Without sources there is nothing to shape; state shaping is not for the optimist."""
    sparse = pursuit(storage={"hunt": cr.Storage(kind="sparse")})  # not for Double Q-learning
    learners = [cr.DoubleQLearning(), QLearning(epsilon=0.5, initial_value=3.0)]
    comparison = compare(sparse, seeds=1, scratch=learners)
    named = "scratch, QLearning(epsilon=0.5, initial_value=3.0)"
    assert list(comparison.arms) == ["scratch", named, "transfer"]
    assert "sparse tables are for QLearning" in str(comparison.failed["scratch, DoubleQLearning"])
    calls.clear()
    plan = corner(shaping={"maze": cr.StateShaping()})
    compare(plan, seeds=1, scratch=[cr.learning.OptimisticQLearning()])
    assert calls[1]["shaping"] == []


def test_the_verdict_is_against_the_best():
    comparison = by_hand(5.0, 3.0, 8.0, 1.0)
    assert comparison.best_opponent("mine") == "scratch, 1"
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
    with pytest.raises(CurriculumError, match="'scratch, fast' names two; rename"):
        compare({"scratch, fast": copied(MAZE)}, seeds=1, scratch={"fast": FAST})
    assert calls == []
