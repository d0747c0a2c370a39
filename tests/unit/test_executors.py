"""Executors of other processes: the window of units, and what is sent; no cluster is needed."""

import re
import sys
from types import SimpleNamespace

import pytest

from curricle.errors import ConfigError, EngineError, SettingError
from curricle.study import read_study, run_study, running
from curricle.study.arms import Arms, UnitInput
from curricle.study.executors import Workers, _folder_with, train_sent, versions_here
from curricle.study.workers import dask_address, dask_cluster
from tests.support.executors import Held, sent_units
from tests.support.sent_folders import RULES, STUDY

pytestmark = pytest.mark.usefixtures("quick_disk")


@pytest.fixture
def own_study(tmp_path):
    (tmp_path / "rules.py").write_text(RULES)
    (tmp_path / "own.toml").write_text(STUDY)
    return read_study(tmp_path / "own.toml")


def test_what_is_no_cluster_or_executor_is_refused(study_file, tmp_path, monkeypatch):
    for on in ("slurm", "", "dask://", "dask://host", "ray", "dask://a b:1", "DASK"):
        with pytest.raises(
            SettingError, match="on must be dask, or an address as dask://host:8786"
        ):
            dask_address(on)
    with pytest.raises(SettingError, match="workers must be a number without an executor"):
        run_study(read_study(study_file), tmp_path / "out", workers=lambda: 2)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(SettingError, match=r'not installed: pip install "curricle\[dask\]"'),
        dask_cluster("dask"),
    ):
        pass
    with (
        pytest.raises(SettingError, match="has workers of its own: workers=2"),
        dask_cluster("dask://host:1", 2),
    ):
        pass


def test_other_versions_name_the_worker_and_what_differs():
    sent = UnitInput("", "", "", None, {}, versions={**versions_here(), "numba": "0.1"})
    error = train_sent(sent)
    assert isinstance(error, EngineError)
    assert re.search(r"^worker .* has numba .* and the run has 0\.1$", str(error))


def test_the_window_follows_the_number_of_workers(own_study, tmp_path, monkeypatch):
    study = read_study(tmp_path / "own.toml", set=["seeds=9", "seeds_per_unit=1"])
    monkeypatch.setattr(running, "ASKED_AGAIN", 0.0)
    pool = Held([0, 0, 1, 3, 1])  # the first number is for the progress
    sent_units(pool, monkeypatch, study, tmp_path / "out")
    assert running.AHEAD == 2
    assert pool.most[:8] == [2, 2, 6, 5, 4, 3, 2, 2]  # 0, 1, 3 and then 1 worker
    assert max(pool.most[8:]) == 2


def test_units_that_an_executor_cancels_say_that_it_was_lost(study_file, tmp_path, monkeypatch):
    pool = Held([1])

    def cancelled(futures, timeout, return_when):
        for future, *_ in pool.held:
            future.cancel()
        return set(futures), set()

    pool.wait = cancelled
    with pytest.raises(EngineError, match="executor was lost or cancelled it: go on with --resume"):
        sent_units(pool, monkeypatch, read_study(study_file), tmp_path / "out")


def test_modules_travel_and_others_are_refused(own_study, tmp_path, monkeypatch):
    arms, pool = Arms.of(own_study), Held([2])
    monkeypatch.setattr(running, "Arms", SimpleNamespace(of=lambda _: arms))
    made = Workers.of

    def elsewhere(*arguments):
        workers = made(*arguments)
        (tmp_path / "rules.py").rename(tmp_path / "gone.py")  # what the run has read before
        return workers

    monkeypatch.setattr(Workers, "of", elsewhere)
    assert sent_units(pool, monkeypatch, own_study, tmp_path / "out").seeds == (0, 1)
    assert pool.submitted[0].files == {"rules.py": RULES.encode()}
    other = pool.submitted[0]._replace(files={"rules.py": RULES.encode() + b"# another version"})
    error = train_sent(other)
    assert isinstance(error, ConfigError)
    assert "rules.py must not change during a run" in str(error)
    # A worker that sees the modules uses them where data may lie beside them.
    (tmp_path / "rules.py").write_text(RULES)
    assert _folder_with({"rules.py": RULES.encode()}, tmp_path) == tmp_path
    assert _folder_with({"rules.py": b"# another version"}, tmp_path) != tmp_path
    assert _folder_with({"rules.py": RULES.encode()}, tmp_path / "elsewhere").is_dir()


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
    both = Arms.of(tuned_lakes), Arms.of(tuned_lakes.trials)
    workers = Workers.of(Held([1]), lambda: 1, both, tmp_path)
    assert {*workers.files} == {"lakes.py", "living.py", "pooling.py"}
    assert [arms.serial for arms in both] == [False, True]
    assert workers.serial
