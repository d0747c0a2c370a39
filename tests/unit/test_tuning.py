"""Tuning: as many trials for every arm, one outcome however it is run, and seeds kept apart."""

import re
import shutil

import numpy as np
import pytest

import curricle as cr
from curricle.errors import ConfigError, StoreError, StudyError
from curricle.study import StudyResults, merge, read_study, run_study
from curricle.study.results import DECISIONS, RESULTS
from curricle.study.store import ANALYSIS
from curricle.study.tuning import TRIALS, effects_of
from tests.support.executors import Inline
from tests.unit.test_config_sweeps import MAZES

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
    return StudyResults(tuned).record.tuned


def assert_same(folder, tuned):
    for name in (f"{TRIALS}/{RESULTS}", RESULTS):
        assert (folder / name).read_bytes() == (tuned / name).read_bytes(), name
    record, of_tuned = StudyResults(folder).record, StudyResults(tuned).record
    assert record.model_dump(mode="json") == of_tuned.model_dump(mode="json")


def test_workers_and_blocks_change_nothing(tuned_file, tuned, tmp_path):
    run_study(read_study(tuned_file, set=["seeds_per_unit=7"]), tmp_path / "out", workers=3)
    assert_same(tmp_path / "out", tuned)


@pytest.mark.parametrize("left", [None, 20])
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


@pytest.mark.parametrize("folder", ["", TRIALS])
@pytest.mark.parametrize("name", [RESULTS, DECISIONS, ANALYSIS])
def test_a_resumed_run_makes_what_a_finished_folder_lacks(
    tuned_file, tuned, tmp_path, folder, name
):
    """As of a run that was killed before that file was moved to its place."""
    out = shutil.copytree(tuned, tmp_path / "out")
    (out / folder / name).unlink(missing_ok=folder == TRIALS and name == ANALYSIS)
    run_study(read_study(tuned_file), out, resume=True, executor=Inline(0))
    files = [
        {path.relative_to(of) for path in of.rglob("*") if path.is_file()} for of in (out, tuned)
    ]
    assert files[0] == files[1]
    for path in (path for path in files[0] if path.suffix == ".parquet" or path.name == ANALYSIS):
        assert (out / path).read_bytes() == (tuned / path).read_bytes()


def test_another_seed_tries_other_settings(tuned_file):
    tried = []
    for seed in ("tune.seed=0", "tune.seed=0", "tune.seed=1"):
        trials = read_study(tuned_file, set=[seed]).tune.variants
        tried.append([trial.values for trial in trials.values()])
    assert tried[0] == tried[1] != tried[2]


def test_settings_that_changed_are_tuned_anew(tuned_file, tmp_path):
    before, after = ["learner.epsilon=0.1", "tune.seeds=3"], ["learner.epsilon=0.5", "tune.seeds=2"]
    for settings, folder in ((before, "out"), (after, "out"), (after, "new")):
        study = read_study(tuned_file, set=["tune.trials=2", *settings])
        run_study(study, tmp_path / folder, resume=True, workers=1)
    out, new = (StudyResults(tmp_path / folder) for folder in ("out", "new"))
    assert out.record.model_dump(mode="json") == new.record.model_dump(mode="json")
    assert (out.store.path / RESULTS).read_bytes() == (new.store.path / RESULTS).read_bytes()


def test_parts_are_tuned_alike_and_merged(tuned_file, tuned, tmp_path):
    for part in (1, 2):
        study = read_study(tuned_file, set=["seeds_per_unit=1"])
        run_study(study, tmp_path / f"{part}", shard=(part, 2), workers=1)
    merge(tmp_path / "all", [tmp_path / "1", tmp_path / "2"])
    assert_same(tmp_path / "all", tuned)


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
    pattern = r"every arm it is tuned first: (\d+) of 24 trials are stored; its seeds come after"
    assert shown.startswith("mazes: 0 of 2 seeds finished in every arm")
    done = int(re.search(pattern, " ".join(shown.split()))[1])
    assert 0 < done < 24
    assert "every arm spends" not in shown  # a search over budgets may end elsewhere
    run_study(study, out, resume=True, workers=1)
    shown = curricle("show", out)[1]
    assert "trials are stored" not in shown
    assert "every arm spends" in shown


def test_a_tuned_arm_is_played_in_its_task(tuned_file, tuned, tuning, curricle):
    arm = next(name for name in tuning.arms if name != "scratch")
    code, shown, _ = curricle("play", tuned, "--arm", arm, "--study", tuned_file)
    assert code == 0
    assert "return" in shown


def test_every_arm_has_as_many_trials_and_steps(tuning):
    assert {name: arm.trials for name, arm in tuning.arms.items()} == {
        "scratch": 12,
        "transfer": 12,
    }
    assert tuning.steps("scratch") == tuning.steps("transfer") == 12 * 2 * tuning.total


def test_the_trials_are_a_study_in_which_each_arm_varies_what_it_has(tuned, tuning):
    trials = StudyResults(tuned / TRIALS)
    assert trials.seeds == tuning.seeds
    rate, first, unknown = "learner.learning_rate", "learner.initial_value", "unknown_value"
    points = {arm: [] for arm in tuning.arms}
    for variant in trials.record.variants.values():
        points[variant.arm].append(values := variant.values)
        assert values.keys() == {rate, first, unknown} - {
            unknown if variant.arm == "scratch" else ""
        }
        assert 0.05 <= values[rate] <= 0.8
        assert type(values[first]) is int
        assert values.get(unknown) in (0.0, 1.0, None)
    alike = [[(values[rate], values[first]) for values in of_arm] for of_arm in points.values()]
    assert alike[0] == alike[1]  # the same points for every arm
    assert {values[first] for values in points["scratch"]} == {*range(-3, 4)}
    assert {values[unknown] for values in points["transfer"]} == {0.0, 1.0}
    thirds = np.digitize([values[rate] for values in points["scratch"]], [0.126, 0.317])
    assert min(np.bincount(thirds)) >= 3  # and spread evenly, here by their logarithm


def test_a_trial_is_scored_as_arms_are_compared(tuned_file, tuned, tuning):
    trials = StudyResults(tuned / TRIALS)
    values = trials.record.variants["transfer, trial 4"].values
    sets = [f"{key}={value}" for key, value in values.items()]
    by_hand = cr.compare(
        read_study(tuned_file, set=sets).curriculum("transfer"), seeds=tuning.seeds
    )
    assert by_hand.total == tuning.total
    # The reference's first return is that of all actions being equally good, whatever the learner.
    score = trials.comparison.returns["transfer, trial 4"].mean()
    np.testing.assert_allclose(by_hand.returns["transfer"].mean(), score, rtol=1e-12)


def test_arms_are_run_with_their_best_settings_on_other_seeds(tuned, tuning):
    results = StudyResults(tuned)
    assert not {*results.seeds} & {*tuning.seeds}
    trials = StudyResults(tuned / TRIALS)
    for name, best in tuning.arms.items():
        scores = {
            trial: trials.comparison.returns[trial].mean()
            for trial, variant in trials.record.variants.items()
            if variant.arm == name
        }
        chosen = max(scores, key=scores.get)
        assert (best.score, best.trials) == (scores[chosen], 12)
        assert results.record.variants[name].values == best.values
        assert trials.record.variants[chosen].values == best.values
        settings = results.record.arms[name].nodes["maze"].settings["learner"]
        assert f"learning_rate={best.values['learner.learning_rate']}" in settings


def levels_of(effects, arm, key):
    return [level for level in effects if (level.arm, level.key) == (arm, key)]


def test_an_arm_with_nothing_to_tune_has_one_trial(read, tmp_path):
    study = read(f"{MAZES}[tune]\ntrials = 3\nseeds = 1\nspace.unknown_value = [0.0, 1.0]\n")
    arms = run_study(study, tmp_path / "out", workers=1).record.tuned.arms
    assert {name: arm.trials for name, arm in arms.items()} == {"scratch": 1, "transfer": 3}


def test_the_steps_of_trials_are_those_of_the_largest_source(read, tmp_path):
    space = "space.tasks.corner.budget = { low = 100, high = 400 }"
    study = read(f"{MAZES}[tune]\ntrials = 2\nseeds = 1\n{space}\n")
    results = run_study(study, tmp_path / "out", workers=1)
    tuning, trials = results.record.tuned, StudyResults(tmp_path / "out" / TRIALS)
    variants = trials.record.variants.values()
    tried = [variant.values.get("tasks.corner.budget", 0) for variant in variants]
    assert tuning.total == 1_000 + -(-max(tried) // 10) * 10
    spent = tuning.arms["transfer"].values["tasks.corner.budget"]
    assert results.record.total == 1_000 + -(-spent // 10) * 10


def test_main_effects_of_a_sweep_are_means_over_arms(read, tmp_path):
    swept = "learner.learning_rate = [0.1, 0.3]\nunknown_value = [0.0, 1.0]"
    results = run_study(read(f"{MAZES}\n[sweep]\n{swept}\n"), tmp_path / "out", workers=1)
    returns = results.comparison.returns
    effects = effects_of(results)
    name = "transfer, learning_rate=0.3, unknown_value={}"
    both = [returns[name.format(value)] for value in (0.0, 1.0)]
    level = levels_of(effects, "transfer", "learner.learning_rate")[1]
    assert (level.text, level.number) == ("0.3", 2)
    assert level.mean.estimate == pytest.approx(np.mean(both))
    alone = levels_of(effects, "scratch", "learner.learning_rate")
    assert [level.text for level in alone] == ["0.1", "0.3"]
    assert not levels_of(effects, "scratch", "unknown_value")


def test_a_range_that_a_learner_refuses_is_refused_beforehand(tuned_file, tmp_path):
    study = read_study(tuned_file, set=["tune.space.learner.learning_rate.high=3.0"])
    with pytest.raises(ConfigError, match="learning_rate is refused: learning_rate must lie"):
        run_study(study, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_resumed_study_is_not_tested_on_seeds_that_it_is_tuned_on(tuned, tuned_file, tmp_path):
    shutil.copytree(tuned, tmp_path / "out")
    seeds = StudyResults(tuned).record.seeds
    other = [f"tune.seeds=[{seeds[0]}]", f"seeds=[{max(seeds) + 100}]", "tune.trials=2"]
    with pytest.raises(StoreError, match="seeds of tuning must be none of the study's"):
        run_study(read_study(tuned_file, set=other), tmp_path / "out", resume=True)
