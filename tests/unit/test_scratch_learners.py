"""Further learners from scratch and controls in a study file: read, refused, trained, compared."""

import numpy as np
import pytest

from curricle import SARSA, QLearning, compare
from curricle.errors import ConfigError, SettingError
from curricle.study import StudyConfig, run_study
from curricle.study.analysis import study_record
from curricle.study.arms import Arms
from curricle.study.record import StudyRecord, plain, read_record
from tests.studies import CORNER, reader

FURTHER = """
[scratch_learners.optimistic]
initial_value = 50.0

[scratch_learners.sarsa]
type = "SARSA"
"""
NAMES = ("scratch", "scratch, optimistic", "scratch, sarsa")
SET = [
    *("seeds=2", "window=1", "learner.learning_rate=0.2", "tasks.maze.time_limit=50"),
    *("tasks.maze.budget=1_000", "tasks.corner.budget=200"),
]


def study(tmp_path, text=FURTHER, changes=()):
    return reader(tmp_path)(CORNER + text, set=[*SET, *changes])


def test_each_changes_the_targets_own_learner(tmp_path):
    arms = Arms.of(study(tmp_path))
    assert tuple(arms.curricula) == (*NAMES, "transfer")
    assert arms.scratches == NAMES
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
    one = study(tmp_path)
    again = StudyConfig.from_data(one.to_data(), one.folder)
    assert again == one
    assert Arms.of(again).keys == Arms.of(one).keys
    record = study_record(one, Arms.of(one))
    assert [name for name, arm in record.arms.items() if arm.scratch] == [*NAMES]
    assert read_record(StudyRecord, plain(record)).arms == record.arms
    assert record.groups() == [("transfer",)]


@pytest.mark.parametrize(
    ("text", "changes", "message"),
    [
        ("[scratch_learners.a]\nepsilon = 2.0", [], r"scratch_learners\.a cannot be compared: eps"),
        ("[scratch_learners.a]\nepsilom = 0.2", [], r"scratch_learners\.a\.epsilom is unknown"),
        (FURTHER, ["scratch=false"], "scratch_learners are compared with the target's own"),
        (f'{FURTHER}[arms."scratch, sarsa"]', [], "must have another name: a learner has it"),
    ],
)
def test_what_makes_no_sense_is_refused_in_a_sentence(tmp_path, text, changes, message):
    with pytest.raises(ConfigError, match=message):
        Arms.of(study(tmp_path, text, changes))


def test_a_run_trains_them_and_its_comparison_is_against_the_best(tmp_path):
    found = run_study(study(tmp_path), tmp_path / "results", workers=1)
    comparison = found.comparison
    assert comparison.scratches == NAMES
    assert list(comparison.contrasts) == ["transfer"]
    assert comparison.verdicts["transfer"].rivals == 3
    assert {len(found.results[name]["maze"].steps) for name in NAMES} == {121}


CONTROLS = 'controls=["placebo", "constant", "pretraining"]'


def test_controls_of_a_study_are_those_of_compare(tmp_path):
    checked = study(tmp_path, changes=["seeds=7", CONTROLS])
    results = run_study(checked, tmp_path / "out", progress=False)
    stored, compared = results.comparison, compare(checked)
    assert list(stored.arms) == list(compared.arms)
    assert str(stored) == str(compared)
    for name, arm in compared.arms.items():
        there = stored.arms[name]
        np.testing.assert_array_equal(there.curve.values, arm.curve.values)
        np.testing.assert_array_equal(there.curve.source_steps, arm.curve.source_steps)
        assert (there.control, there.level is None) == (arm.control, arm.level is None)
        if arm.level is not None:
            np.testing.assert_array_equal(there.level.values, arm.level.values)
            assert there.initial_value == arm.initial_value
    sources = {arms.keys["corner"] for arms in Arms.of(checked).arms.values() if arms.control}
    assert sources == {Arms.of(checked).keys["transfer", "corner"]}  # trained once
    assert results.record.groups() == [("transfer",)]


def test_a_record_names_the_arm_of_each_control(tmp_path):
    checked = study(tmp_path, changes=[CONTROLS])
    record = plain(study_record(checked, Arms.of(checked)))
    record["arms"]["transfer, placebo"]["control_of"] = "another"
    with pytest.raises(ValueError, match=r"control_of must be the arm before its controls"):
        read_record(StudyRecord, record)


def test_controls_that_make_no_sense_are_refused(tmp_path):
    with pytest.raises(SettingError, match="controls are compared with scratch"):
        Arms.of(study(tmp_path, "", changes=["scratch=false", CONTROLS]))
    with pytest.raises(ConfigError, match="controls"):
        study(tmp_path, changes=['controls=["placebos"]'])
