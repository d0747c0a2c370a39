"""What a study's results depend on: the study and its seeds, and nothing about how it is run."""

import json
import multiprocessing
import pickle
from concurrent.futures import Executor, Future, ProcessPoolExecutor, wait
from functools import partial

import numpy as np
import pytest

import curricle as cr
from curricle.comparison import plan
from curricle.curriculum.result import SourceValues
from curricle.errors import SettingError, StoreError, StudyError
from curricle.study import StudyResults, read_study, run_study
from curricle.study.arms import Arms, UnitInput, train_unit, units_of
from curricle.study.results import DECISIONS, RESULTS
from tests.support.refusals import check_values
from tests.support.studies import HUNT, NUMBERED_HUNT, reader

pytestmark = pytest.mark.usefixtures("quick_disk")
CURVES = ("steps", "training_return", "greedy_return", "source_share", "episodes")
SPENT = ("steps_used", "episodes_used", "out_of_memory")


class Inline(Executor):
    """Trains a unit when it is submitted; after so many it takes none."""

    def __init__(self, most=10**9):
        self.left, self.trained = most, 0

    def submit(self, function, work):
        if not self.left:
            raise OSError("the cluster is gone")
        self.left -= 1
        future = Future()
        try:
            future.set_result(function(work))
            self.trained += 1
        except Exception as error:
            future.set_exception(error)
        return future


class LastFirst(Executor):
    """Holds what is submitted; the last of it is trained when results are waited for."""

    def __init__(self):
        self.held, self.submitted = [], []

    def submit(self, function, work):
        self.held.append((Future(), function, work))
        self.submitted.append(work.unit)
        return self.held[-1][0]

    def wait(self, futures, timeout, return_when):
        future, function, work = self.held.pop()
        future.set_result(function(work))
        return wait(futures, return_when=return_when)


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


# -- how it is run -----------------------------------------------------------------------------


@pytest.mark.parametrize(("seeds_per_unit", "workers"), [(1, 3), (3, 1)])
def test_block_and_workers_change_nothing(study_file, finished, tmp_path, seeds_per_unit, workers):
    study = read_study(study_file, set=[f"seeds_per_unit={seeds_per_unit}"])
    run_study(study, tmp_path / "out", workers=workers)
    assert_same_results(tmp_path / "out", finished)


def test_the_order_in_which_units_end_changes_nothing(study_file, finished, tmp_path, monkeypatch):
    pool, ended = LastFirst(), []
    monkeypatch.setattr(plan, "wait", pool.wait)
    how = {"workers": 4, "executor": pool, "progress": lambda now: ended.append(now.stored)}
    run_study(read_study(study_file), tmp_path / "out", **how)
    assert ended[1:] != pool.submitted
    assert_same_results(tmp_path / "out", finished)


def test_processes_change_nothing(study_file, finished, tmp_path):
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        run_study(read_study(study_file), tmp_path / "out", workers=2, executor=pool)
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


# -- what is trained ---------------------------------------------------------------------------


def test_what_arms_share_is_trained_once(study_file, tmp_path):
    begun, study = [], read_study(study_file)
    run_study(study, tmp_path / "out", progress=lambda now: begun.append(now.units))
    trained = sorted((unit.arm, unit.task) for unit in begun[0] if unit.seeds == (0, 1))
    assert trained == [
        ("chain", "corner"),  # the same in the arm "state", whose maze alone is learnt otherwise
        ("chain", "easy"),
        ("chain", "maze"),
        ("scaled", "easy"),  # without a source, unlike in the other arms
        ("scaled", "maze"),
        ("scratch", "maze"),
        ("state", "easy"),
        ("state", "maze"),
    ]


@pytest.mark.parametrize("arm", ["chain", "state", "scaled"])
def test_an_arm_is_its_curriculum_trained(study_file, finished, arm):
    study, trained = StudyResults(finished), by_hand(study_file, arm)
    for node, result in trained.nodes.items():
        assert_equal(study.result(arm, node, values=True), result)
        if trained.decisions(node)[0]:
            sentences = [[*map(str, of_seed)] for of_seed in trained.decisions(node)]
            assert study.decisions(arm, node) == dict(enumerate(sentences))


def test_the_comparison_is_that_of_compare(study_file, finished):
    results = StudyResults(finished).comparison
    wanted = cr.compare(read_study(study_file).curricula, seeds=4, opponents=())
    assert list(results.arms) == list(wanted.arms)
    for name, arm in wanted.arms.items():
        np.testing.assert_array_equal(results[name].curve.steps, arm.curve.steps)
        np.testing.assert_array_equal(results[name].curve.values, arm.curve.values)
        np.testing.assert_array_equal(results[name].curve.source_steps, arm.curve.source_steps)
    for name in ("total", "budget", "window", "threshold"):
        assert getattr(results, name) == getattr(wanted, name)
    assert results.threshold_from == wanted.threshold_from != ""
    assert str(results) == str(wanted)


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


# -- a unit ------------------------------------------------------------------------------------


def test_a_unit_is_a_pure_function_of_what_can_be_sent(study_file, finished):
    study, done = read_study(study_file), StudyResults(finished)
    changed = read_study(study_file, set=["seeds=[1, 3]", "seeds_per_unit=4"])
    units = units_of(changed, Arms.of(study), {})
    unit = next(unit for unit in units if (unit.arm, unit.task) == ("chain", "maze"))
    rows = [1, 3]
    sources = {
        name: SourceValues(None, (1, 3), known.values[rows], known.steps_used[rows])
        for name in unit.sources
        for known in [done.result("chain", name, values=True)]
    }
    sent = UnitInput(json.dumps(study.to_data()), str(study.folder), "{}", unit, sources)
    once, again = train_unit(sent), train_unit(pickle.loads(pickle.dumps(sent)))
    assert repr(once.decisions) == repr(again.decisions)  # NaN is not equal to itself
    assert once.arrays.keys() == again.arrays.keys()
    for name, array in once.arrays.items():
        np.testing.assert_array_equal(array, again.arrays[name])
    whole = done.result("chain", "maze", values=True)
    np.testing.assert_array_equal(once.arrays["values"], whole.values[rows])


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
