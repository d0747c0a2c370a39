"""What a study's results depend on: the study and its seeds, and nothing about how it is run."""

from functools import partial

import numpy as np
import pytest

import curricle as cr
from curricle.errors import ConfigError, CurriculumError, SettingError, StoreError, StudyError
from curricle.study import StudyResults, read_study, run_study
from curricle.study.arms import Arms
from curricle.study.results import DECISIONS, RESULTS
from tests.support.executors import Held, Inline, sent_units
from tests.support.refusals import check_values
from tests.support.studies import CORNER, HUNT, NUMBERED_HUNT, reader

pytestmark = pytest.mark.usefixtures("quick_disk")
CURVES = ("steps", "training_return", "greedy_return", "source_share", "agreement", "episodes")
SPENT = ("steps_used", "episodes_used", "out_of_memory")


def assert_equal(results, wanted, *, values=True):
    assert results.seeds == wanted.seeds
    for name in (*CURVES, *SPENT, *["values"] * values):
        np.testing.assert_array_equal(getattr(results, name), getattr(wanted, name), name)


def assert_same_results(folder, finished):
    """Two folders hold the same results, bit for bit."""
    for name in (RESULTS, DECISIONS):
        assert (folder / name).read_bytes() == (finished / name).read_bytes(), name
    results, wanted = StudyResults(folder), StudyResults(finished)
    for arm, node in wanted.record.keys:
        here, there = (study.result(arm, node, values=True) for study in (results, wanted))
        assert_equal(here, there)
        assert here.snapshots.seed == there.snapshots.seed == 0
        np.testing.assert_array_equal(here.snapshots.values, there.snapshots.values)


def by_hand(study_file, arm):
    """One arm's curriculum as an equal total makes it, trained at once."""
    study = read_study(study_file)
    arms = Arms.of(study)
    plan = study.curriculum(arm).replace("maze", budget=arms.total, eval_freq=arms.eval_freq)
    return plan.train(study.seeds, charge=True, workers=1)


def test_block_and_workers_change_nothing(study_file, finished, tmp_path):
    run_study(read_study(study_file, set=["seeds_per_unit=1"]), tmp_path / "out", workers=3)
    assert_same_results(tmp_path / "out", finished)


def test_the_order_in_which_units_end_changes_nothing(study_file, finished, tmp_path, monkeypatch):
    pool, ended, study = Held([4], last_first=True), [], read_study(study_file)
    done = {"progress": lambda now: ended.append(now.stored)}
    sent_units(pool, monkeypatch, study, tmp_path / "out", **done)
    assert ended[1:] != [work.unit for work in pool.submitted]
    assert_same_results(tmp_path / "out", finished)


@pytest.mark.parametrize("most", [0, 6])
def test_a_run_that_its_executor_failed_goes_on(study_file, finished, tmp_path, contents, most):
    study, pool = read_study(study_file), Inline(most)
    with pytest.raises(StudyError, match=r"failed, .* is whole: OSError: the cluster is gone"):
        run_study(study, tmp_path / "out", executor=pool)
    stored = StudyResults(tmp_path / "out").store.units()
    assert sum(len(unit.seeds) for unit in stored) == 2 * pool.trained == 2 * most
    run_study(study, tmp_path / "out", resume=True, executor=Inline())
    assert_same_results(tmp_path / "out", finished)
    assert contents(tmp_path / "out") == contents(finished)


def test_an_interrupted_run_goes_on_with_other_blocks(study_file, finished, tmp_path):
    def interrupt(progress):
        if progress.stored is not None and progress.stored.task == "easy":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_study(read_study(study_file), tmp_path / "out", workers=2, progress=interrupt)
    other = read_study(study_file, set=["seeds_per_unit=3"])
    run_study(other, tmp_path / "out", resume=True, workers=2)
    assert_same_results(tmp_path / "out", finished)


def test_settings_that_make_no_sense_are_refused(study_file, tmp_path):
    with pytest.raises(SettingError, match="needs greedy evaluation: that of 'maze' is off"):
        run_study(
            read_study(study_file, set=["tasks.maze.evaluation.method=off"]), tmp_path / "out"
        )
    shards = [(0, 1), (3, 2), (1, 0), (1.5, 2), ("1", 2), (1,), "1/2", None]
    wrong = {"executor": [3], "report": [3], "resume": ["no"], "workers": [0, -1, 1.5]}
    wrong |= {"shard": shards, "trackers": [["tensorboard"], [3]]}
    check_values(SettingError, partial(run_study, read_study(study_file), tmp_path / "out"), wrong)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("arm", ["chain", "state", "scaled"])
def test_an_arm_is_its_curriculum_trained(study_file, finished, arm):
    study, trained = StudyResults(finished), by_hand(study_file, arm)
    for node, result in trained.nodes.items():
        assert_equal(study.result(arm, node, values=True), result)
        if trained.decisions(node)[0]:
            sentences = [[*map(str, of_seed)] for of_seed in trained.decisions(node)]
            assert study.decisions(arm, node) == dict(enumerate(sentences))


def test_one_arm_may_end_at_a_gate_where_nothing_is_compared(study_file, tmp_path):
    path = tmp_path / "alone.toml"
    path.write_text(study_file.read_text().partition("[arms.chain]")[0])
    gate = "tasks.maze.budget={ max_steps = 400, threshold = 180.0, patience = 1 }"
    alone = read_study(path, set=["scratch=false", gate])
    study = run_study(alone, tmp_path / "out", workers=2)
    assert study.record.total is None
    trained = alone.curriculum("transfer").train(4)
    assert_equal(study.result("transfer", "maze", values=True), trained["maze"])
    assert (trained["maze"].steps_used < 400).all()
    with pytest.raises(StoreError, match="at one total of steps: "):
        _ = study.comparison


def test_a_source_whose_values_are_not_kept_is_said_so(study_file, tmp_path):
    changes = ["tasks.easy.storage.save_values=false"]
    with pytest.raises(StudyError, match=r"values must be kept.*'easy'") as caught:
        run_study(read_study(study_file, set=changes), tmp_path / "out", executor=Inline())
    assert caught.value.__cause__ is None  # it is a mistake in the file, not in the study's code


SPARSE = [
    "opponents=[]",
    *('seeds="3,7,8"', "seeds_per_unit=2", "tasks.hunt.storage.kind='sparse'"),
    *("tasks.chase.budget=400", "tasks.hunt.budget=400"),
]


def test_sparse_tables_are_stored_and_read(tmp_path):
    study = reader(tmp_path)(NUMBERED_HUNT, set=SPARSE)
    results = run_study(study, tmp_path / "out", workers=2)
    plan = study.curriculum("transfer").replace("hunt", budget=800, eval_freq=4)
    learnt = plan.train([3, 7, 8], charge=True)["hunt"]
    stored = results.result("transfer", "hunt", values=True)
    assert_equal(stored, learnt, values=False)
    for table, other in zip(stored.values, learnt.values, strict=True):
        np.testing.assert_array_equal(table.states, other.states)
        np.testing.assert_array_equal(table.values, other.values)
    assert stored.snapshots is None
    assert results.result("transfer", "hunt").values is None


def test_arms_that_are_not_compared_keep_budgets_of_their_own(tmp_path):
    file = tmp_path / "hunt.toml"
    changes = [
        "compared=false",
        "tasks.hunt.budget={ episodes = 30 }",
        "arms.short.tasks.hunt.budget=500",
        "arms.mean.aggregate=mean",
    ]
    file.write_text(HUNT + "[arms.mean]\n[arms.short]\n")
    study = read_study(file, set=changes)
    results = run_study(study, tmp_path / "out", progress=False)
    for arm, curriculum in study.curricula.items():
        alone = curriculum.train(study.seeds)
        there = results.result(arm, "hunt", values=True)
        np.testing.assert_array_equal(there.values, alone["hunt"].values)
        np.testing.assert_array_equal(there.steps_used, alone["hunt"].steps_used)
    assert (results.results["short"]["hunt"].steps_used == 500).all()
    assert (results.results["scratch"]["hunt"].episodes_used == 30).all()
    with pytest.raises(StoreError, match="a comparison needs the target learnt from scratch"):
        _ = results.comparison
    with pytest.raises(SettingError, match="leave out compared = false"):
        run_study(read_study(file, set=[*changes, 'controls=["placebo"]']), tmp_path / "controls")
    with pytest.raises(SettingError, match="own budget with compared = false"):
        run_study(read_study(file, set=changes[1:2]), tmp_path / "compared")
    assert not (tmp_path / "compared").exists()


STUDY = CORNER.replace("\n", "\nseeds = [3, 5]\nbudget = 600\nthreshold = 5\nwindow = 2\n", 1)
PLAN = "[arms.plain]\n[arms.halved]\ntransfers.0.scale = 0.5\n"


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "corners.toml").write_text(STUDY, "utf-8")
    return tmp_path / "corners.toml"


def test_a_study_runs_from_its_path_into_the_folder_of_the_command_line(file):
    results = cr.run_study("corners.toml")
    assert (file.parent / "corners-results" / "study.json").exists()
    again = cr.run_study(file, resume=True)
    np.testing.assert_array_equal(
        results.results["transfer"]["maze"].values, again.results["transfer"]["maze"].values
    )
    cr.run_study(cr.read_study(file), "elsewhere")
    assert StudyResults("elsewhere").seeds == (3, 5)


def test_a_study_is_compared_from_its_path_with_its_own_settings(file):
    study = cr.read_study(file)
    expected = cr.compare(study.curricula, seeds=[3, 5], threshold=5, window=2, opponents=())
    for argument in ("corners.toml", file, study):
        comparison = cr.compare(argument)
        assert (comparison.seeds, comparison.threshold, comparison.window) == (2, 5, 2)
        assert str(comparison) == str(expected)
    assert cr.compare(arms=file, seeds=[7], window=1).seeds == 1


def test_a_study_of_one_arm_is_forecast_from_its_path(file):
    foreseen = cr.forecast("corners.toml", trial=False)
    assert foreseen.trained["corner"].seeds == (3, 5)
    assert cr.forecast(file, trial=False, seeds=[1]).trained["corner"].seeds == (1,)
    file.write_text(STUDY + PLAN, "utf-8")
    with pytest.raises(ConfigError, match=r"a forecast is of one arm: .* ARM one of plain, halved"):
        cr.forecast("corners.toml")


def test_what_is_no_study_is_refused_in_a_sentence(file, tmp_path_factory):
    stored = tmp_path_factory.mktemp("other") / "results"
    cr.run_study(file, stored)
    for function in (cr.run_study, cr.compare, cr.forecast):
        with pytest.raises(ConfigError, match=r"nowhere.toml cannot be read: No such file"):
            function("nowhere.toml")
        with pytest.raises(ConfigError, match=r"is a folder of results, which StudyResults\(FOLD"):
            function(stored)
    with pytest.raises(
        SettingError, match="study must be a StudyConfig or the path of a file: got"
    ):
        cr.run_study(cr.GridWorld("S.T"))
    with pytest.raises(CurriculumError, match="must be a Mapping: got 5"):
        cr.compare(5)
    with pytest.raises(CurriculumError, match="must be a Curriculum: got 5"):
        cr.forecast(5)
    with pytest.raises(StoreError, match="a folder must be a path or a URL: got 5"):
        cr.run_study(file, 5)
    assert [path.name for path in file.parent.iterdir()] == ["corners.toml"]
