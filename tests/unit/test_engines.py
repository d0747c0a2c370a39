"""The words for engines, the window of units, and what is sent to a worker; no engine is needed."""

import pickle
import re
from concurrent.futures import Future, ThreadPoolExecutor
from types import SimpleNamespace

import pytest

from curricle.cli import progress_bars
from curricle.cli.progress_bars import run_with_bars
from curricle.errors import (
    ConfigError,
    EngineError,
    LostStoreError,
    SettingError,
    StoreError,
    StudyError,
)
from curricle.files import RemotePath
from curricle.interop.trackers import Tracker
from curricle.study import read_study, run_study, running, running as scheduling, store
from curricle.study.arms import Arms, UnitInput
from curricle.study.engines import engine
from curricle.study.engines.engine import (
    Engine,
    opened_engine,
    parsed,
    train_sent,
    versions_here,
)
from curricle.study.store import StoredUnit
from curricle.study.tuning import with_trials
from tests.sent_folders import RULES, STUDY

pytestmark = pytest.mark.usefixtures("quick_disk")


class FakeEngine(Engine):
    """Holds what is submitted; each time it is asked for its workers, it may call one function."""

    on = "fake"

    def __init__(self, numbers):
        self.numbers, self.held, self.most = list(numbers), [], []

    def close(self, whole):
        """Nothing was started."""

    def submit(self, function, argument):
        self.held.append((Future(), function, argument))
        return self.held[-1][0]

    def count(self):
        if len(self.numbers) > 1:
            return self.numbers.pop(0)
        return self.numbers[0]

    def wait(self, futures, timeout, return_when):
        """Return nothing while the number of workers changes, else the first that was held."""
        self.most.append(len(futures))
        if len(self.numbers) > 1:
            return set(), set(futures)
        future, function, argument = self.held.pop(0)
        future.set_result(function(argument))
        return {future}, set()


@pytest.fixture
def own_study(tmp_path):
    (tmp_path / "rules.py").write_text(RULES)
    (tmp_path / "own.toml").write_text(STUDY)
    return read_study(tmp_path / "own.toml")


def sent_units(engine, monkeypatch, study, out, **settings):
    monkeypatch.setattr(scheduling, "wait", engine.wait)
    engine.carry(with_trials(study, Arms.of(study)), study.folder)
    monkeypatch.setattr(running, "_workers", lambda *_: engine)
    return run_study(study, out, **settings)


@pytest.mark.parametrize("on", ["slurm", "", "dask://", "dask://host", "ray://a b:1", "DASK", 3])
def test_an_unknown_word_is_refused(on, study_file, tmp_path):
    with pytest.raises(SettingError, match="on must be dask or ray, or an address"):
        parsed(on)
    with pytest.raises(SettingError, match="on must be dask or ray"):
        run_study(read_study(study_file), tmp_path / "out", on=on)
    assert not (tmp_path / "out").exists()


def test_a_missing_package_names_its_extra(monkeypatch):
    monkeypatch.setattr(engine, "ENGINE_PACKAGES", {"dask": "no_such_package"})
    with (
        pytest.raises(SettingError, match=r'not installed: pip install "curricle\[dask\]"'),
        opened_engine("dask", None),
    ):
        pass


def test_a_cluster_with_an_executor_or_with_workers_is_refused(study_file, tmp_path):
    study = read_study(study_file)
    with pytest.raises(SettingError, match="exclude each other: got on='dask' and an executor"):
        run_study(study, tmp_path / "out", on="dask", executor=FakeEngine([1]))
    with pytest.raises(SettingError, match="has workers of its own: workers=2"):
        run_study(study, tmp_path / "out", on="dask://host:1", workers=2)


def test_other_versions_name_the_worker_and_what_differs():
    sent = UnitInput("", "", "", None, {}, versions={**versions_here(), "numba": "0.1"})
    error = train_sent(sent)
    assert isinstance(error, EngineError)
    assert re.search(r"^worker .* has numba .* and the run has 0\.1$", str(error))


def test_the_window_follows_the_number_of_workers(own_study, tmp_path, monkeypatch):
    study = read_study(tmp_path / "own.toml", set=["seeds=9", "seeds_per_unit=1"])
    monkeypatch.setattr(scheduling, "ASKED_AGAIN", 0.0)
    engine = FakeEngine([0, 0, 1, 3, 1])  # the first number is for the progress
    sent_units(engine, monkeypatch, study, tmp_path / "out")
    assert scheduling.AHEAD == 2
    assert engine.most[:8] == [2, 2, 6, 5, 4, 3, 2, 2]  # 0, 1, 3 and then 1 worker
    assert max(engine.most[8:]) == 2


def test_units_that_an_engine_cancels_say_that_it_was_lost(study_file, tmp_path, monkeypatch):
    engine = FakeEngine([1])

    def cancelled(futures, timeout, return_when):
        for future, *_ in engine.held:
            future.cancel()
        return set(futures), set()

    engine.wait = cancelled
    with pytest.raises(EngineError, match="fake was lost or cancelled it: go on with --resume"):
        sent_units(engine, monkeypatch, read_study(study_file), tmp_path / "out")


def test_modules_travel_and_others_are_refused(own_study, tmp_path, monkeypatch):
    arms, whole, first = Arms.of(own_study), FakeEngine([2]), []
    whole.carry([arms], tmp_path)
    assert whole.files == {"rules.py": RULES.encode()}
    monkeypatch.setattr(scheduling, "wait", whole.wait)
    monkeypatch.setattr(running, "_workers", lambda *_: whole)
    submit = whole.submit
    whole.submit = lambda function, sent: first.append(sent) or submit(function, sent)
    (tmp_path / "rules.py").rename(tmp_path / "gone.py")  # what the driver has read before
    monkeypatch.setattr(running, "Arms", SimpleNamespace(of=lambda _: arms))
    assert run_study(own_study, tmp_path / "out").seeds == (0, 1)
    assert first[0].checkpoints is None
    other = first[0]._replace(files={"rules.py": RULES.encode() + b"# another version"})
    error = train_sent(other)
    assert isinstance(error, ConfigError)
    assert "rules.py must not change during a run" in str(error)


TUNED_LAKES = """
name = "lakes"
opponents = []
seeds = 1
tasks.lake = { type = "factory", factory = "lakes:tabled", budget = 400 }
tasks.other = { type = "factory", factory = "lakes:tabled", budget = 200 }
transfers = [{ source = "other", target = "lake", mapping = "identity" }]
[tune]
trials = 2
seeds = 1
[tune.space]
aggregate = ["mean", "pooling:largest"]
tasks.other.factory = ["lakes:tabled", "living:live"]
"""
LAKES = """
import curricle as cr

def {name}():
    return cr.from_gymnasium("FrozenLake-v1", discount=0.9, live={live})
"""


@pytest.fixture
def tuned_lakes(tmp_path):
    """A study whose trials alone use two of its modules, one of which has a live task."""
    (tmp_path / "lakes.py").write_text(LAKES.format(name="tabled", live=False))
    (tmp_path / "living.py").write_text(LAKES.format(name="live", live=True))
    (tmp_path / "pooling.py").write_text("def largest(values):\n    return values.max(axis=0)\n")
    (tmp_path / "lakes.toml").write_text(TUNED_LAKES)
    return read_study(tmp_path / "lakes.toml")


def test_modules_of_trials_alone_travel_too(tuned_lakes, tmp_path):
    both, lakes = with_trials(tuned_lakes, Arms.of(tuned_lakes)), FakeEngine([1])
    lakes.carry(both, tmp_path)
    assert {*lakes.files} == {"lakes.py", "living.py", "pooling.py"}
    assert [arms.serial for arms in both] == [False, True]
    assert lakes.serial


def test_live_tasks_of_trials_alone_are_trained_one_at_a_time(tuned_lakes, tmp_path, monkeypatch):
    threads, pools = [], []

    def interruptible(workers):
        threads.append(workers)
        return ThreadPoolExecutor(workers)

    class Processes(ThreadPoolExecutor):
        def __init__(self, workers):
            pools.append(workers)
            super().__init__(1)

    monkeypatch.setattr(running, "interruptible", interruptible)
    monkeypatch.setattr(progress_bars, "WorkerProcesses", Processes)
    monkeypatch.setattr(running, "described", stop)
    for run in (run_study, run_with_bars):
        how = {"processes": False, "on": None, "resume": True} if run is run_with_bars else {}
        with pytest.raises(StudyError, match="stopped"):
            run(tuned_lakes, tmp_path / "out", workers=3, **how)
    assert (threads, pools) == ([1], [3])


def stop(*_, **__):
    raise StudyError("stopped")


class Recorder(Tracker):
    """Notes how many seeds each unit has."""

    def __init__(self):
        self.seeds = []

    def record(self, arm, task, result):
        self.seeds.append(len(result.seeds))


class FakeCluster(FakeEngine):
    """Workers that get copies, as those on other machines do, and send copies back."""

    def submit(self, function, argument):
        return super().submit(lambda sent: through(function(through(sent))), argument)

    def wait(self, futures, timeout, return_when):
        if not futures:
            return set(), set()
        return super().wait(futures, timeout, return_when)


def through(value):
    return pickle.loads(pickle.dumps(value))


def test_workers_read_and_write_large_units_at_a_url(
    study_file, finished, tmp_path, monkeypatch, contents
):
    monkeypatch.setattr(store, "FULL", 1)
    returned, received = [], []

    def noted(sent):
        file = train_sent(sent)
        received.append(sent)
        returned.append(file)
        return file

    monkeypatch.setattr(engine, "train_sent", noted)
    study, recorder, url = read_study(study_file), Recorder(), (tmp_path / "out").as_uri()
    sent_units(FakeCluster([2]), monkeypatch, study, url, trackers=[recorder])
    assert all(isinstance(file, StoredUnit) for file in returned)
    assert all(len(pickle.dumps(file)) < 500 for file in returned)
    assert all(not sent.sources for sent in received)
    assert any(sent.stored for sent in received)
    assert recorder.seeds == 16 * [2]
    run_study(study, tmp_path / "local")
    assert contents(tmp_path / "out" / "units") == contents(tmp_path / "local" / "units")


def test_small_units_come_back_and_share_files(study_file, finished, tmp_path, monkeypatch):
    study, out = read_study(study_file), tmp_path / "out"
    sent_units(FakeCluster([2]), monkeypatch, study, out.as_uri())
    here, there = (
        sorted(file.relative_to(folder) for file in folder.rglob("*.npz"))
        for folder in (out, finished)
    )
    assert here == there


def test_what_a_worker_cannot_write_ends_the_run(study_file, tmp_path, monkeypatch):
    monkeypatch.setattr(store, "FULL", 1)
    study, url = read_study(study_file), (tmp_path / "out").as_uri()
    write = RemotePath.write

    def elsewhere(sent):
        file = train_sent(sent)
        file.path.unlink()
        return file

    with monkeypatch.context() as patch:
        patch.setattr(engine, "train_sent", elsewhere)
        with pytest.raises(StoreError, match="workers must write to the place of the run: file://"):
            sent_units(FakeCluster([2]), patch, study, url)

    def failing(path, content):
        if path.suffix == ".npz":
            raise OSError("nothing answers")
        write(path, content)

    monkeypatch.setattr(RemotePath, "write", failing)
    with pytest.raises(LostStoreError, match="nothing answers"):
        sent_units(FakeCluster([2]), monkeypatch, study, url, resume=True)
