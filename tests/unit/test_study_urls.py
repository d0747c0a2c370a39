"""Results at a URL: the same files as in a folder, in whatever file system fsspec opens."""

import pickle
import sys
from pathlib import Path

import numpy as np
import pytest
from fsspec.implementations.memory import MemoryFileSystem

from curricle.errors import LostStoreError, StoreError
from curricle.files import place_at, write_whole
from curricle.show.report import write_report
from curricle.study import StudyResults, StudyStore, merge, read_study, run_study
from tests.support.executors import Elsewhere
from tests.support.studies import OF_RUNS

pytestmark = pytest.mark.usefixtures("quick_disk")
BUSY = type("ClientError", (Exception,), {"__module__": "botocore.exceptions"})
"""An error of a store's client, which is no OSError."""


def files(place):
    """The bytes of all files but those that tell of a run and not of its results, by path."""
    found = ((path, path.as_posix().partition(f"/{place.name}/")[2]) for path in place.rglob("*"))
    return {
        n: path.read_bytes() for path, n in found if path.is_file() and path.name not in OF_RUNS
    }


@pytest.fixture
def copy(url_of, finished):
    """The URL of a copy of the finished study."""
    place = place_at(url_of("out"))
    for name, content in files(finished).items():
        write_whole(place / name, content)
    return place


def test_units_of_other_machines_are_stored_at_a_url(study_file, finished, url_of):
    study = run_study(read_study(study_file), url_of("out"), executor=Elsewhere())
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


def let_fail(patch, method, ending, error):
    """Let a method of the file system raise an error for files whose names end so."""
    works = getattr(MemoryFileSystem, method)

    def failing(self, path, *arguments, **settings):
        if path.endswith(ending):
            raise error
        return works(self, path, *arguments, **settings)

    patch.setattr(MemoryFileSystem, method, failing)


@pytest.mark.parametrize("error", [OSError, BUSY])
def test_a_unit_that_cannot_be_read_now_is_not_deleted(
    study_file, finished, copy, monkeypatch, error
):
    with monkeypatch.context() as patch:
        let_fail(patch, "_open", ".npz", error("Please reduce your request rate."))
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


@pytest.mark.parametrize(
    ("name", "error"), [(".npz", BUSY), ("results.parquet", OSError), ("analysis.json", BUSY)]
)
def test_a_place_that_is_lost_during_a_run_has_an_error_of_its_own(
    study_file, url_of, monkeypatch, name, error
):
    study, url = read_study(study_file), url_of("out")
    with monkeypatch.context() as patch:
        let_fail(patch, "pipe_file", name, error("nothing answers"))
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
    unit, stored = StudyStore(copy).units()[0], StudyStore(finished).units()[0]
    wanted = stored.content(stored.about.task, ("run",)).arrays
    monkeypatch.setattr("curricle.files.READ_AT_ONCE", 0)
    read = unit.content(stored.about.task, ("run",)).arrays
    assert read.keys() == wanted.keys()
    for name in read:
        np.testing.assert_array_equal(read[name], wanted[name])


OTHER_URLS = {
    "s3://me:secret@bucket/study": "must have no password.* such as by the environment$",
    "s3://bucket/study?secret_key=secret@x&region=y": "must have no password, key or option",
    "s3://bucket/a?endpoint_override=http%3A%2F%2Fme%3Asecret%40host": "must have no password",
    "s3://bucket/a?endpoint_override=me:secret@host": "must have no password",
    "nowhere://bucket/study": "must be one that fsspec opens, not nowhere://bucket/study",
    "s3://": "must be one that fsspec opens, not s3://: ",
}


def test_other_urls_are_one_sentence_that_repeats_no_password(study_file, curricle):
    for url, fault in OTHER_URLS.items():
        with pytest.raises(StoreError, match=fault):
            place_at(url)
        for arguments in (["run", study_file, "--out", url], ["show", url]):
            code, _, complaint = curricle(*arguments)
            last = complaint.strip().splitlines()[-1]
            assert (code, last.startswith("curricle: a URL ")) == (1, True)
            assert "secret" not in last.replace("secret_key", "")


def test_a_url_needs_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "upath", None)
    with pytest.raises(StoreError, match=r'not installed: pip install "curricle\[url\]"'):
        place_at("s3://bucket/study")
