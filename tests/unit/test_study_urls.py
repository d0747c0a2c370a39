"""Results at a URL: the same files as in a folder, by whatever file system pyarrow opens."""

import pickle
import shutil
from contextlib import nullcontext

import numpy as np
import pytest
from pyarrow.fs import LocalFileSystem, SubTreeFileSystem

from curricle import files as whole_files
from curricle.cli.app import main
from curricle.errors import LostStoreError, StoreError
from curricle.files import RemotePath, place_at, write_whole
from curricle.show.report import write_report
from curricle.study import StudyResults, StudyStore, merge, read_study, run_study
from curricle.study.store import StoredUnit

pytestmark = pytest.mark.usefixtures("quick_disk")


def url_of(folder):
    return f"file://{folder}"


def files(folder):
    """The bytes of all files but the lock and what says when a run began, by path."""
    read = (path for path in folder.rglob("*") if path.is_file())
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in read
        if path.name not in (".lock", "runs.json")
    }


def test_a_run_at_a_url_stores_the_same_files(study_file, finished, tmp_path):
    url = url_of(tmp_path / "out")
    study = run_study(read_study(study_file), url, workers=2)
    assert files(tmp_path / "out") == files(finished)
    assert str(study.comparison) == str(StudyResults(finished).comparison)
    assert len(study.runs) == 1
    assert str(study.store.path) == url


def test_going_on_at_a_url_trains_what_is_missing_or_damaged(study_file, finished, tmp_path):
    out = shutil.copytree(finished, tmp_path / "out")
    units = StudyStore(url_of(out)).units()
    first, last = (tmp_path / "out" / str(units[k].path).split("/out/")[1] for k in (0, -1))
    first.unlink()
    last.write_bytes(last.read_bytes()[:-1])
    sentences, stored = [], []
    noted = {"report": sentences.append, "progress": lambda now: stored.append(now.stored)}
    run_study(read_study(study_file), url_of(out), resume=True, **noted)
    assert sentences == [f"{units[-1].path} is damaged: its units are trained again"]
    assert len(stored) == 1 + 2 * 2  # a file holds two units
    assert files(out) == files(finished)
    with pytest.raises(StoreError, match=r"file://.* already holds results, 8 files"):
        run_study(read_study(study_file), url_of(out))


def test_a_unit_that_cannot_be_read_now_is_not_deleted(study_file, finished, tmp_path, monkeypatch):
    out = shutil.copytree(finished, tmp_path / "out")
    opened = RemotePath.opened

    def busy(path):
        if path.suffix == ".npz":
            raise OSError("AWS Error SLOW_DOWN: Please reduce your request rate.")
        return opened(path)

    monkeypatch.setattr(RemotePath, "opened", busy)
    with pytest.raises(StoreError, match=r"\.npz cannot be read: AWS Error SLOW_DOWN"):
        run_study(read_study(study_file), url_of(out), resume=True)
    assert files(out) == files(finished)


@pytest.mark.parametrize(
    "url",
    [
        "file:///tmp/my%20studies/100%25",
        "s3://bucket/a=1/b?endpoint_override=127.0.0.1%3A9000&scheme=http&region=here",
    ],
)
def test_a_place_at_a_url_is_sent_with_its_options(url):
    place = place_at(url) / "units" / "a b.npz"
    assert str(place) == f"{url.partition('?')[0]}/units/a%20b.npz"
    sent = pickle.loads(pickle.dumps(place))
    assert (str(sent), sent.key, sent.system) == (str(place), place.key, place.system)


@pytest.mark.parametrize("place", ["folder", "url"])
def test_checkpoints_end_when_their_unit_is_stored(finished, tmp_path, place):
    out = url_of(tmp_path / "out") if place == "url" else tmp_path / "out"
    units = StudyStore(finished).units()[:2]
    with StudyStore.opened(out, {}, resume=False) as store:
        for unit in units:
            file = store.checkpoints(unit.about) / "seed-0.checkpoint"
            if place == "folder":
                file.parent.mkdir(parents=True)
            write_whole(file, b"saved")
        store.write_unit(units[0].about, units[0].result(units[0].seeds))
        left = [*store.path.glob(".checkpoints/*/*/*")]
        assert [file.parent for file in left] == [store.checkpoints(units[1].about)]
        store.remove_checkpoints()
        assert not [*store.path.glob(".checkpoints/*/*/*")]
        store.remove_checkpoints()


def test_a_missing_bucket_is_named(tmp_path):
    objects = SubTreeFileSystem(str(tmp_path), LocalFileSystem())
    with pytest.raises(StoreError, match=r"holds a study.json: there is no s3://bucket$"):
        StudyStore(RemotePath(objects, "bucket/study", "s3://"))
    (tmp_path / "bucket").mkdir()
    with pytest.raises(StoreError, match=r"holds a study.json: s3://bucket/study has none$"):
        StudyStore(RemotePath(objects, "bucket/study", "s3://"))


@pytest.mark.parametrize(
    ("method", "name"),
    [("write", ".npz"), ("write", "results.parquet"), ("write", "analysis.json"), ("unlink", "")],
)
def test_a_place_that_is_lost_during_a_run_has_an_error_of_its_own(
    study_file, tmp_path, monkeypatch, method, name
):
    works = getattr(RemotePath, method)

    def failing(path, *arguments, **settings):
        if str(path).endswith(name):
            raise OSError("nothing answers")
        return works(path, *arguments, **settings)

    monkeypatch.setattr(RemotePath, method, failing)
    study, url = read_study(study_file), url_of(tmp_path / "out")
    with pytest.raises(LostStoreError, match=r"results cannot be written to .*nothing answers"):
        run_study(study, url)
    monkeypatch.undo()
    assert run_study(study, url, resume=True).seeds == study.seeds


def test_parts_at_urls_are_merged(study_file, finished, tmp_path):
    study = read_study(study_file)
    parts = [tmp_path / f"part-{i}" for i in (1, 2)]
    for i, part in enumerate(parts):
        run_study(study, url_of(part), shard=(i + 1, 2))
    merge(url_of(tmp_path / "whole"), list(map(url_of, parts)))
    assert files(tmp_path / "whole").keys() == files(finished).keys()
    for name in ("results.parquet", "decisions.parquet"):
        assert (tmp_path / "whole" / name).read_bytes() == (finished / name).read_bytes()


def test_a_report_of_a_url_is_written_here(finished, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = write_report(url_of(finished))
    assert str(page) == f"{finished.name}-report.html"
    assert page.read_text() == write_report(finished, tmp_path / "local.html").read_text()


def test_what_is_read_of_a_large_unit_is_what_is_read_of_all(finished, monkeypatch):
    unit = StudyStore(url_of(finished)).units()[0]
    store = StudyStore(finished)
    wanted = store.arrays(StoredUnit.at(finished / str(unit.path).split(f"{finished}/")[1]), "run")
    monkeypatch.setattr("curricle.files.READ_AT_ONCE", 0)
    read = StudyStore(url_of(finished)).arrays(unit, "run")
    assert read.keys() == wanted.keys()
    assert all(np.array_equal(read[name], wanted[name], equal_nan=True) for name in read)


@pytest.mark.parametrize(
    ("url", "fault"),
    [
        ("s3://me:secret@bucket/study", "must have no password.* by the environment.* before @$"),
        ("s3://bucket/study?secret_key=x&region=y", "must have no password.*got secret_key$"),
        ("gs://bucket/study?access_token=x", "must have no password.*got access_token$"),
        ("nowhere://bucket/study", "must be one that pyarrow opens, not nowhere://bucket/study"),
        ("s3://", "must be one that pyarrow opens, not s3://: it names no bucket or folder$"),
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
        RemotePath.of(url)
    assert "secret@" not in last


def test_a_place_that_cannot_be_written_is_one_sentence(study_file, tmp_path):
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(StoreError, match=r"cannot be written to file://") as caught:
        run_study(read_study(study_file), url_of(tmp_path / "file" / "out"))
    assert "\n" not in str(caught.value)
    with pytest.raises(StoreError, match="is a file"):
        run_study(read_study(study_file), url_of(tmp_path / "file"))


class BusyServer:
    """A file system whose first answers are errors."""

    type_name = "s3"

    def __init__(self, *errors):
        self.errors = list(errors)

    def delete_file(self, key):
        if self.errors:
            raise self.errors.pop(0)


BUSY = OSError("AWS Error INTERNAL_FAILURE: Failed to flush response stream")


@pytest.mark.parametrize(
    ("errors", "pauses"),
    [
        (3 * [BUSY], 3),
        (4 * [BUSY], 3),
        ([FileNotFoundError("a"), BUSY], 0),
        ([OSError("AWS Error ACCESS_DENIED"), BUSY], 0),
    ],
)
def test_a_server_that_is_busy_for_a_moment_is_asked_again(monkeypatch, errors, pauses):
    slept, server = [], BusyServer(*errors)
    monkeypatch.setattr(whole_files, "sleep", slept.append)
    fails = pytest.raises(type(errors[pauses])) if len(errors) > pauses else nullcontext()
    with fails:
        RemotePath(server, "bucket/a", "s3://").unlink(missing_ok=False)
    assert slept == list(whole_files.PAUSES[:pauses])
    assert server.errors == errors[pauses + 1 :]
