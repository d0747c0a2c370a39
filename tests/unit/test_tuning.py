"""Tuning: as many trials for every arm, one outcome however it is run, and seeds kept apart."""

import json
import re
import shutil
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import curricle as cr
from curricle.errors import ConfigError, LostStoreError, SettingError, StoreError, StudyError
from curricle.files import RemotePath, sealed
from curricle.study import StudyResults, StudyStore, dependencies, merge, read_study, run_study
from curricle.study.record import plain
from curricle.study.results import RESULTS
from curricle.study.store import STUDY
from curricle.study.tuning import TRIALS, TUNING, read_tuning, sweep_effects, tuning_effects
from tests.unit.test_config_sweeps import MAZES
from tests.unit.test_study_runner import Inline

pytest.importorskip("optuna")
pytestmark = pytest.mark.usefixtures("quick_disk")
TUNED = f"""{MAZES}
[tune]
trials = 12
seeds = 2
[tune.space]
learner.learning_rate = {{ low = 0.05, high = 0.8, log = true }}
learner.initial_value = {{ low = -3, high = 3 }}
unknown_value = [0.0, 1.0]
"""


@pytest.fixture(scope="module")
def tuned_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("tuned") / "mazes.toml"
    path.write_text(TUNED)
    return path


@pytest.fixture(scope="module")
def pool():
    """Has trained the units of the tuned study, each once."""
    return Inline()


@pytest.fixture(scope="module")
def tuned(tuned_file, pool, tmp_path_factory):
    """The folder of the tuned study, run in one go; to be read only."""
    folder = tmp_path_factory.mktemp("tuned") / "out"
    run_study(read_study(tuned_file), folder, executor=pool)
    return folder


@pytest.fixture
def tuning(tuned):
    """What that tuning found."""
    return read_tuning(StudyStore(tuned))


def assert_same(folder, tuned):
    for name in (TUNING, RESULTS):
        assert (folder / name).read_bytes() == (tuned / name).read_bytes(), name
    assert plain(StudyResults(folder).record) == plain(StudyResults(tuned).record)


# -- one outcome -------------------------------------------------------------------------------


@pytest.mark.parametrize(("seeds_per_unit", "workers"), [(1, 1), (7, 3)])
def test_workers_and_blocks_change_nothing(tuned_file, tuned, tmp_path, seeds_per_unit, workers):
    study = read_study(tuned_file, set=[f"seeds_per_unit={seeds_per_unit}"])
    run_study(study, tmp_path / "out", workers=workers)
    assert_same(tmp_path / "out", tuned)


@pytest.mark.parametrize("left", [None, 20, 5, 1])
def test_a_killed_run_goes_on_to_the_same(tuned_file, tuned, pool, tmp_path, left):
    study = read_study(tuned_file)
    killed, again = Inline(0 if left is None else pool.trained - left), Inline()
    with pytest.raises(StudyError, match="the cluster is gone"):
        run_study(study, tmp_path / "out", executor=killed)
    if killed.trained:
        with pytest.raises(StoreError, match="go on with --resume"):
            run_study(study, tmp_path / "out", executor=Inline(0))
    run_study(study, tmp_path / "out", resume=True, executor=again)
    assert_same(tmp_path / "out", tuned)
    assert killed.trained + again.trained == pool.trained
    run_study(study, tmp_path / "out", resume=True, executor=Inline(0))  # all is there
    assert_same(tmp_path / "out", tuned)


def test_another_seed_tries_other_settings(tuned_file, tuned, tmp_path):
    run_study(read_study(tuned_file, set=["tune.seed=1"]), tmp_path / "out", workers=1)
    there, here = (read_tuning(StudyStore(folder)) for folder in (tmp_path / "out", tuned))
    assert there.arms["transfer"].trials != here.arms["transfer"].trials


@pytest.mark.parametrize(
    ("before", "after"),
    [("learner.epsilon=0.1", "learner.epsilon=0.5"), ("tune.seeds=3", "tune.seeds=2")],
)
def test_settings_that_changed_are_tuned_anew(tuned_file, tmp_path, before, after):
    for setting, folder in ((before, "out"), (after, "out"), (after, "new")):
        study = read_study(tuned_file, set=["tune.trials=2", setting])
        run_study(study, tmp_path / folder, resume=True, workers=1)
    assert_same(tmp_path / "out", tmp_path / "new")


@pytest.fixture
def of_another_version(tuned, tmp_path, monkeypatch):
    """A copy of the tuned folder, which another version of Curricle made."""
    folder = shutil.copytree(tuned, tmp_path / "out")
    monkeypatch.setattr(dependencies, "metadata", SimpleNamespace(version=lambda _: "9.9"))
    return folder


def test_a_stale_tuning_is_kept_if_asked_for(tuned_file, tuned, of_another_version):
    sentences, folder = [], of_another_version
    kept = {"resume": True, "keep_stale": True, "report": sentences.append}
    run_study(read_study(tuned_file), folder, executor=Inline(0), **kept)
    assert (folder / TUNING).read_bytes() == (tuned / TUNING).read_bytes()
    assert (folder / RESULTS).read_bytes() == (tuned / RESULTS).read_bytes()
    first, *later = sentences
    assert first.startswith("the tuning is stale and kept: its trials are of other code, or of ")
    assert all("is stale and kept: Curricle was" in sentence for sentence in later)
    assert later


def test_stale_trials_are_kept_by_a_longer_tuning(tuned_file, of_another_version, pool):
    longer, sentences = read_study(tuned_file, set=["tune.trials=14"]), []
    trained = Inline()
    kept = {"resume": True, "keep_stale": True, "report": sentences.append}
    run_study(longer, of_another_version, executor=trained, **kept)
    assert sentences[0] == "the tuning is stale and made again: what it depends on has changed"
    tuning = read_tuning(StudyStore(of_another_version))
    assert {len(arm.trials) for arm in tuning.arms.values()} == {14}
    assert trained.trained < pool.trained / 2
    assert tuning.of == ""  # a run that keeps nothing stale makes it again


def test_a_stale_tuning_is_made_again_otherwise(tuned_file, tuned, of_another_version, pool):
    again, sentences = Inline(), []
    how = {"resume": True, "executor": again, "report": sentences.append}
    run_study(read_study(tuned_file), of_another_version, **how)
    assert again.trained == pool.trained
    assert sentences[0] == "the tuning is stale and made again: what it depends on has changed"
    assert (of_another_version / RESULTS).read_bytes() == (tuned / RESULTS).read_bytes()
    wanted = read_tuning(StudyStore(tuned))
    tuning = read_tuning(StudyStore(of_another_version))
    assert tuning.of != wanted.of
    assert plain(tuning) | {"of": wanted.of} == plain(wanted)


def test_parts_are_tuned_alike_and_merged(tuned_file, tuned, tmp_path):
    for part in (1, 2):
        study = read_study(tuned_file, set=["seeds_per_unit=1"])
        run_study(study, tmp_path / f"{part}", shard=(part, 2), workers=1)
    merge(tmp_path / "all", [tmp_path / "1", tmp_path / "2"])
    assert_same(tmp_path / "all", tuned)


def test_a_place_that_is_lost_after_a_tuning_is_a_lost_store(tuned_file, tmp_path, monkeypatch):
    study = read_study(tuned_file, set=["tune.trials=2", "tune.seeds=1"])
    exists, write = RemotePath.exists, StudyStore.write_record

    def failing(path):
        if path.name == STUDY:
            raise OSError("nothing answers")
        return exists(path)

    def last(store, name, record):
        write(store, name, record)
        if name == TUNING:
            monkeypatch.setattr(RemotePath, "exists", failing)

    monkeypatch.setattr(StudyStore, "write_record", last)
    with pytest.raises(LostStoreError, match="cannot be read: nothing answers"):
        run_study(study, (tmp_path / "out").as_uri(), workers=1)


@pytest.mark.parametrize("finished_before", [False, True])
def test_show_says_how_far_a_tuning_is(tuned_file, tuned, tmp_path, curricle, finished_before):
    study, out = read_study(tuned_file), tmp_path / "out"
    if finished_before:
        shutil.copytree(tuned, out)
        assert "trials are stored" not in curricle("show", out)[1]
        study = read_study(tuned_file, set=["tune.seeds=3"])
    with pytest.raises(StudyError):
        run_study(study, out, resume=True, executor=Inline(7))
    code, shown, _ = curricle("show", out)
    assert code == 0
    how = "the tuning has changed" if finished_before else "it is tuned first"
    pattern = rf"every arm {how}: (\d+) of 24 trials are stored; its seeds come after them"
    assert shown.startswith("mazes: 0 of 2 seeds finished in every arm")
    done = int(re.search(pattern, " ".join(shown.split()))[1])
    assert 0 < done < 24
    assert "every arm spends" not in shown  # a search over budgets may end elsewhere
    run_study(study, out, resume=True, workers=1)
    shown = curricle("show", out)[1]
    assert "trials are stored" not in shown
    assert "every arm spends" in shown


# -- what it is --------------------------------------------------------------------------------


def test_every_arm_has_as_many_trials_and_steps(tuning):
    numbers = {name: len(arm.trials) for name, arm in tuning.arms.items()}
    assert numbers == {"scratch": 12, "transfer": 12}
    assert tuning.steps("scratch") == tuning.steps("transfer") == 12 * 2 * tuning.total


def test_an_arm_is_tuned_in_what_it_has(tuning):
    of_scratch = {"learner.learning_rate", "learner.initial_value"}
    assert {*tuning.arms["scratch"].best.values} == of_scratch
    assert {*tuning.arms["transfer"].best.values} == {*tuning.space}
    for trial in tuning.arms["transfer"].trials:
        assert 0.05 <= trial.values["learner.learning_rate"] <= 0.8
        assert type(trial.values["learner.initial_value"]) is int
        assert trial.values["unknown_value"] in (0.0, 1.0)


def test_a_trial_is_scored_as_arms_are_compared(tuned_file, tuning):
    trial = tuning.arms["transfer"].trials[3]
    sets = [f"{key}={value}" for key, value in trial.values.items()]
    plain = read_study(tuned_file, set=sets).curriculum("transfer")
    by_hand = cr.compare(plain, seeds=list(tuning.seeds))
    assert by_hand.total == tuning.total
    # The reference's first return is that of all actions being equally good, whatever the learner.
    np.testing.assert_allclose(by_hand.returns["transfer"].mean(), trial.score, rtol=1e-12)


def test_arms_are_run_with_their_best_settings_on_other_seeds(tuned, tuning):
    results = StudyResults(tuned)
    assert not {*results.seeds} & {*tuning.seeds}
    for name, arm in tuning.arms.items():
        assert results.record.arms[name].variant.values == arm.best.values
        settings = results.record.arms[name].nodes["maze"].settings["learner"]
        assert f"learning_rate={arm.best.values['learner.learning_rate']}" in settings
        assert arm.best.score == max(trial.score for trial in arm.trials)


def levels_of(effects, arm, key):
    return [level for level in effects.levels if (level.arm, level.key) == (arm, key)]


def test_effects_are_means_of_trials(tuning):
    effects = tuning_effects(tuning)
    trials = tuning.arms["transfer"].trials
    for level in levels_of(effects, "transfer", "unknown_value"):
        scores = [t.score for t in trials if f"{t.values['unknown_value']}" == level.text]
        assert level[3:] == (len(scores), pytest.approx(np.mean(scores)), min(scores), max(scores))
    parts = levels_of(effects, "transfer", "learner.learning_rate")
    assert sum(level.number for level in parts) == len(trials)
    rates = effects.settings["learner.learning_rate"]
    assert rates.levels == ("0.05 to 0.126", "0.126 to 0.317", "0.317 to 0.8")


def test_an_arm_with_nothing_to_tune_has_one_trial(tmp_path):
    file = tmp_path / "mazes.toml"
    file.write_text(f"{MAZES}[tune]\ntrials = 3\nseeds = 1\nspace.unknown_value = [0.0, 1.0]\n")
    arms = read_tuning(run_study(read_study(file), tmp_path / "out", workers=1).store).arms
    assert {name: len(arm.trials) for name, arm in arms.items()} == {"scratch": 1, "transfer": 3}


def test_the_steps_of_trials_are_those_of_the_largest_source(tmp_path):
    file = tmp_path / "mazes.toml"
    space = "space.tasks.corner.budget = { low = 100, high = 400 }"
    file.write_text(f"{MAZES}[tune]\ntrials = 2\nseeds = 1\n{space}\n")
    results = run_study(read_study(file), tmp_path / "out", workers=1)
    tuning = read_tuning(results.store)
    assert tuning.total == 1_000 + 400
    spent = tuning.arms["transfer"].best.values["tasks.corner.budget"]
    assert results.record.total == 1_000 + -(-spent // 10) * 10


# -- sweeps ------------------------------------------------------------------------------------


def test_main_effects_of_a_sweep_are_means_over_arms(tmp_path):
    (tmp_path / "mazes.toml").write_text(
        f"{MAZES}\n[sweep]\nlearner.learning_rate = [0.1, 0.3]\nunknown_value = [0.0, 1.0]\n"
    )
    results = run_study(read_study(tmp_path / "mazes.toml"), tmp_path / "out", workers=1)
    returns = results.comparison.returns
    effects = sweep_effects(results.comparison, results.record, None)
    name = "transfer, learning_rate=0.3, unknown_value={}"
    both = [returns[name.format(value)] for value in (0.0, 1.0)]
    level = levels_of(effects, "transfer", "learner.learning_rate")[1]
    assert (level.text, level.number) == ("0.3", 2)
    assert level.mean == pytest.approx(np.mean(both))
    alone = levels_of(effects, "scratch", "learner.learning_rate")
    assert [level.text for level in alone] == ["0.1", "0.3"]
    assert not levels_of(effects, "scratch", "unknown_value")


# -- refusals ----------------------------------------------------------------------------------


def test_without_optuna_nothing_begins(tuned_file, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "optuna", None)
    with pytest.raises(SettingError, match=r"tuning needs Optuna.*pip install .curricle\[tune\]"):
        run_study(read_study(tuned_file), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_range_that_a_learner_refuses_is_refused_beforehand(tuned_file, tmp_path):
    study = read_study(tuned_file, set=["tune.space.learner.learning_rate.high=3.0"])
    with pytest.raises(ConfigError, match="learning_rate is refused: learning_rate must lie"):
        run_study(study, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("key", "value", "fault"),
    [
        ("seeds", [], "seeds"),
        ("total", "many", "total"),
        ("space", {"a": {"low": 1.0}}, "either low and high, or values"),
        ("space", {}, "trials must set what is in the space"),
        ("arms", {"transfer": {"arm": "x", "trials": []}}, "trials"),
    ],
)
def test_a_tuning_that_was_made_up_is_refused(tuned, tmp_path, key, value, fault):
    folder = shutil.copytree(tuned, tmp_path / "copied")
    tuning = json.loads((folder / TUNING).read_bytes())
    del tuning["digest"]
    (folder / TUNING).write_bytes(sealed(tuning | {key: value}))
    with pytest.raises(StoreError, match=fault):
        read_tuning(StudyResults(folder).store)
    (folder / TUNING).write_bytes(b"{}")
    with pytest.raises(StoreError, match="is damaged"):
        read_tuning(StudyResults(folder).store)


def test_damaged_trials_are_trained_again(tuned_file, tuned, tmp_path):
    study = read_study(tuned_file)
    run_study(study, tmp_path / "out", workers=1)
    (tmp_path / "out" / TUNING).unlink()
    file = StudyStore(tmp_path / "out" / TRIALS).units()[0].path
    file.write_bytes(file.read_bytes()[:-9])
    run_study(study, tmp_path / "out", resume=True, workers=1)
    assert_same(tmp_path / "out", tuned)
