"""Results at a URL: the same files as in a folder, in whatever file system fsspec opens."""

import pickle
import sys
from pathlib import Path

import numpy as np
import pytest
from fsspec.implementations.memory import MemoryFileSystem

from curricle.cli.app import main
from curricle.errors import LostStoreError, StoreError
from curricle.files import place_at, write_whole
from curricle.show.report import write_report
from curricle.study import StudyResults, StudyStore, merge, read_study, run_study

pytestmark = pytest.mark.usefixtures("quick_disk")
BUSY = type("ClientError", (Exception,), {"__module__": "botocore.exceptions"})
"""An error of a store's client, which is no OSError."""


def files(place):
    """The bytes of all files but the lock and what says when a run began, by path."""
    found = ((path, path.as_posix().partition(f"/{place.name}/")[2]) for path in place.rglob("*"))
    return {
        name: path.read_bytes()
        for path, name in found
        if path.is_file() and path.name not in (".lock", "runs.json")
    }


@pytest.fixture
def copy(url_of, finished):
    """The URL of a copy of the finished study."""
    place = place_at(url_of("out"))
    for name, content in files(finished).items():
        write_whole(place / name, content)
    return place


def test_a_run_at_a_url_stores_the_same_files(study_file, finished, url_of):
    study = run_study(read_study(study_file), url_of("out"), workers=2)
    assert files(place_at(url_of("out"))) == files(finished)
    assert str(study.comparison) == str(StudyResults(finished).comparison)
    assert len(study.runs) == 1
    assert str(study.store.path) == url_of("out")


def test_going_on_at_a_url_trains_what_is_missing_or_damaged(study_file, finished, copy):
    units = StudyStore(copy).units()
    units[0].path.unlink()
    write_whole(units[-1].path, units[-1].path.read_bytes()[:-1])
    sentences, stored = [], []
    noted = {"report": sentences.append, "progress": lambda now: stored.append(now.stored)}
    run_study(read_study(study_file), str(copy), resume=True, **noted)
    assert sentences == [f"{units[-1].path} is damaged: its units are trained again"]
    assert len(stored) == 1 + 2
    assert files(copy) == files(finished)
    with pytest.raises(StoreError, match=r"memory://.* already holds results, \d+ files"):
        run_study(read_study(study_file), copy)


@pytest.mark.parametrize("error", [OSError, BUSY])
def test_a_unit_that_cannot_be_read_now_is_not_deleted(
    study_file, finished, copy, monkeypatch, error
):
    opened = MemoryFileSystem._open

    def busy(self, path, *arguments, **settings):
        if path.endswith(".npz"):
            raise error("Please reduce your request rate.")
        return opened(self, path, *arguments, **settings)

    with monkeypatch.context() as patch:
        patch.setattr(MemoryFileSystem, "_open", busy)
        with pytest.raises(StoreError, match=r"\.npz cannot be read: Please reduce your request"):
            run_study(read_study(study_file), copy, resume=True)
    assert files(copy) == files(finished)


def test_a_place_at_a_url_is_sent_to_other_machines():
    place = place_at("memory://bucket/a=1/my study") / "units" / "a b.npz"
    assert str(place) == "memory://bucket/a=1/my study/units/a b.npz"
    sent = pickle.loads(pickle.dumps(place))
    assert (sent, sent.storage_options) == (place, place.storage_options)


def test_a_url_of_this_machine_is_its_folder():
    assert place_at("file:///tmp/my%20studies/100%25") == Path("/tmp/my studies/100%")


@pytest.mark.parametrize("error", [OSError, BUSY])
@pytest.mark.parametrize("name", [".npz", "results.parquet", "analysis.json"])
def test_a_place_that_is_lost_during_a_run_has_an_error_of_its_own(
    study_file, url_of, monkeypatch, name, error
):
    works = MemoryFileSystem.pipe_file

    def failing(self, path, *arguments, **settings):
        if path.endswith(name):
            raise error("nothing answers")
        return works(self, path, *arguments, **settings)

    study, url = read_study(study_file), url_of("out")
    with monkeypatch.context() as patch:
        patch.setattr(MemoryFileSystem, "pipe_file", failing)
        with pytest.raises(LostStoreError, match=r"results cannot be written to .*nothing answers"):
            run_study(study, url)
    assert run_study(study, url, resume=True).seeds == study.seeds


def test_parts_at_urls_are_merged(study_file, finished, url_of):
    study, parts = read_study(study_file), [url_of("part-1"), url_of("part-2")]
    for i, part in enumerate(parts):
        run_study(study, part, shard=(i + 1, 2))
    merge(url_of("whole"), parts)
    whole = files(place_at(url_of("whole")))
    assert whole.keys() == files(finished).keys()
    for name in ("results.parquet", "decisions.parquet"):
        assert whole[name] == (finished / name).read_bytes()


def test_a_report_of_a_url_is_written_here(finished, copy, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = write_report(str(copy))
    assert str(page) == f"{copy.name}-report.html"
    assert "analysis.json" in files(copy)
    assert "<h1" in page.read_text()


def test_what_is_read_of_a_large_unit_is_what_is_read_of_all(finished, copy, monkeypatch):
    unit, wanted = StudyStore(copy).units()[0], StudyStore(finished).units()[0].arrays("run")
    monkeypatch.setattr("curricle.files.READ_AT_ONCE", 0)
    read = unit.arrays("run")
    assert read.keys() == wanted.keys()
    for name in read:
        np.testing.assert_array_equal(read[name], wanted[name])


@pytest.mark.parametrize(
    ("url", "fault"),
    [
        ("s3://me:secret@bucket/study", "must have no password.* such as by the environment$"),
        ("s3://bucket/study?secret_key=secret@x&region=y", "must have no password, key or option"),
        ("nowhere://bucket/study", "must be one that fsspec opens, not nowhere://bucket/study"),
        ("s3://", "must be one that fsspec opens, not s3://: "),
    ],
)
@pytest.mark.parametrize("command", ["run", "show"])
def test_other_urls_are_one_sentence(study_file, capsys, monkeypatch, command, url, fault):
    arguments = ["run", str(study_file), "--out", url] if command == "run" else ["show", url]
    monkeypatch.setattr("sys.argv", ["curricle", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 1
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert last.startswith("curricle: a URL ")
    with pytest.raises(StoreError, match=fault):
        place_at(url)
    assert "secret@" not in last


def test_a_url_needs_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "upath", None)
    with pytest.raises(StoreError, match=r'not installed: pip install "curricle\[url\]"'):
        place_at("s3://bucket/study")
