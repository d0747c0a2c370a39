"""A study's folder: what is not its own is refused untouched; damage is named, and heals."""

import os
import re
import shutil
import subprocess
import sys
from contextlib import suppress

import numpy as np
import pytest

from curricle.errors import StoreError
from curricle.files import sealed
from curricle.study import StudyResults, StudyStore, read_study, run_study
from curricle.study.store import StoredUnit
from tests.support.studies import LINES

pytestmark = pytest.mark.usefixtures("quick_disk")


def read_everything(folder):
    """Read every file of a study's folder, or fail."""
    study = StudyResults(folder)
    for arm, node in study.record.keys:
        study.result(arm, node, values=True)
        study.decisions(arm, node)
    study.table("curves.parquet")
    return study.comparison


@pytest.fixture
def refused(contents):
    """A function: folder, words, study, settings -> a run is refused, and leaves all as it was."""

    def run(folder, fault, study, **settings):
        before = contents(folder) if folder.is_dir() else folder.read_bytes()
        with pytest.raises(StoreError, match=fault) as caught:
            run_study(study, folder, **settings)
        assert str(folder) in str(caught.value)
        assert "\n" not in str(caught.value)
        assert before == (contents(folder) if folder.is_dir() else folder.read_bytes())

    return run


# -- what is not its own -----------------------------------------------------------------------


@pytest.mark.parametrize(
    "change", ["name=other", "threshold=3", "window=1", "seeds_per_unit=4", "seeds=1"]
)
def test_what_only_concerns_its_reading_may_change(study_file, finished, copied, contents, change):
    run_study(read_study(study_file, set=[change]), copied, resume=True)
    there, here = contents(finished), contents(copied)
    assert there.pop("study.json") != "" != here.pop("study.json")
    assert there == here


def test_what_is_no_folder_of_its_own_is_refused(study_file, copied, tmp_path, refused):
    study = read_study(study_file)
    refused(copied, "already holds results, 16 files.*--resume", study)
    out, file, nowhere = (tmp_path / name for name in ("out", "file", "nowhere"))
    (out / "chapters").mkdir(parents=True)
    (out / "chapters" / "one.txt").write_text("years of work")
    for resume in (False, True):
        refused(out, "holds other files", study, resume=resume)
    file.write_text("not a folder")
    refused(file, "is a file", study)
    with pytest.raises(StoreError, match=r"cannot be written to .*Not a directory"):
        run_study(study, file / "out")
    assert file.read_text() == "not a folder"
    for place in (tmp_path, nowhere):
        with pytest.raises(StoreError, match=r"holds a study\.json: .* has none"):
            StudyResults(place)
    for arm, node in (("chian", "maze"), ("chain", "mace"), ("scaled", "corner")):
        for read in (StudyResults(copied).result, StudyResults(copied).decisions):
            with pytest.raises(StoreError, match=r"mace|chian|corner"):
                read(arm, node)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root writes anywhere")
def test_a_folder_that_cannot_be_written_is_refused(study_file, copied, refused):
    study = read_study(study_file, set=["seeds=5"])
    (copied / "units").chmod(0o555)
    copied.chmod(0o555)
    refused(copied, "cannot be written to .*Permission denied", study, resume=True)
    read_everything(copied)


def test_what_a_killed_run_left_unfinished_means_nothing(study_file, finished, copied, contents):
    (copied / ".study123.part").write_text("{")
    (copied / ".link.part").symlink_to(copied.parent)
    unit = StudyStore(copied).units()[0].path
    (unit.parent / ".tmp.part").write_bytes(unit.read_bytes()[:99])
    read_everything(copied)
    run_study(read_study(study_file), copied, resume=True)
    assert contents(copied) == contents(finished)


# -- damage ------------------------------------------------------------------------------------


def harmed(content, how):
    """A content that is cut, emptied or flipped in a bit."""
    middle = len(content) // 2
    if how == "flipped":
        return content[:middle] + bytes([content[middle] ^ 4]) + content[middle + 1 :]
    return content[:middle] if how == "cut" else b""


@pytest.mark.parametrize(
    ("number", "how"), [(0, "cut"), (0, "flipped"), (-1, "emptied"), (-1, "gone")]
)
def test_a_damaged_file_is_named_and_heals(study_file, finished, copied, contents, number, how):
    file, gone = StudyStore(copied).units()[number].path, how == "gone"  # the first has snapshots
    file.write_bytes(harmed(file.read_bytes(), how))
    if gone:
        file.unlink()
    before = contents(copied)
    if not gone:  # then there is no unit
        with pytest.raises(StoreError, match=re.escape(f"{file} is damaged")) as caught:
            read_everything(copied)
        assert "run the study again with --resume" in str(caught.value)
    assert contents(copied) == before
    sentences, stored = [], []
    noted = {"report": sentences.append, "progress": lambda now: stored.append(now.stored)}
    run_study(read_study(study_file), copied, resume=True, **noted)
    assert sentences == ([] if gone else [f"{file} is damaged: its units are trained again"])
    assert len(stored) == 1 + 1
    assert contents(copied) == contents(finished)


def test_a_damaged_description_is_named_and_heals(study_file, finished, copied, contents):
    file, study = copied / "study.json", read_study(study_file)
    file.write_bytes(harmed(file.read_bytes(), "flipped"))
    before = contents(copied)
    for read in (lambda: StudyResults(copied), lambda: run_study(study, copied, resume=True)):
        with pytest.raises(StoreError, match=re.escape(str(file))):
            read()
        assert contents(copied) == before
    file.unlink()
    for name in ("results.parquet", "decisions.parquet"):  # tables of all units
        (copied / name).write_bytes(b"damaged")
    run_study(study, copied, resume=True, workers=2)
    assert contents(copied) == contents(finished)


@pytest.mark.parametrize("name", ["runs.json", "analysis.json"])
def test_what_blocks_a_run_says_how_to_go_on(study_file, copied, name):
    for content in (b"{", b"{}", b"[3]", b"null", b'[{"versions": 3}]', sealed({"of": 3})):
        (copied / name).write_bytes(content)
        with pytest.raises(StoreError, match=f"{name} .*; delete it and run .* again with --resu"):
            run_study(read_study(study_file), copied, resume=True)
    (copied / name).unlink()
    assert len(run_study(read_study(study_file), copied, resume=True).seeds) == 4


def with_flipped_bits(file):
    """Yield after each of 400 bits of a file was flipped alone."""
    whole, draws = file.read_bytes(), np.random.default_rng(0)
    for place in draws.integers(0, len(whole), 400):
        bit = 1 << int(draws.integers(0, 8))
        file.write_bytes(whole[:place] + bytes([whole[place] ^ bit]) + whole[place + 1 :])
        yield


def test_no_flipped_bit_of_a_unit_goes_unnoticed(copied):
    first = StudyStore(copied).units()[0]
    file, task = first.path, first.about.task
    assert StudyStore(copied).is_whole(StoredUnit.at(file))
    for _ in with_flipped_bits(file):
        unit, store = StoredUnit.at(file), StudyStore(copied)
        assert not store.is_whole(unit)
        with pytest.raises(StoreError, match=re.escape(f"{file} is damaged")):
            unit.content(task, ("run",))


def test_no_flipped_bit_of_what_is_read_of_a_large_unit_goes_unnoticed(copied, monkeypatch):
    monkeypatch.setattr("curricle.files.READ_AT_ONCE", 0)
    unit = StudyStore(copied).units()[0]
    task = unit.about.task

    def read():
        arrays = unit.content(task, ("run",)).arrays
        return {name: array.tobytes() for name, array in arrays.items()}

    whole = read()
    for _ in with_flipped_bits(unit.path):
        with suppress(StoreError):
            assert read() == whole


def test_other_snapshots_are_refused_where_units_have_theirs(study_file, copied, contents):
    before, message = contents(copied), r"holds units with snapshots = \d+, and it is 3 here; set"
    with pytest.raises(StoreError, match=message):
        run_study(read_study(study_file, set=["snapshots=3"]), copied, resume=True)
    assert contents(copied) == before
    for folder in copied.glob("units/*"):
        shutil.rmtree(folder)
    again = run_study(read_study(study_file, set=["snapshots=3"]), copied, resume=True)
    assert again.result("chain", "maze").snapshots.values.shape[0] <= 5


# -- several processes, and a full disk --------------------------------------------------------

HOLDING = """
import sys
from contextlib import suppress
from curricle.study import read_study
from curricle.study import run_study

def hold(progress):
    if progress.stored is not None:
        print("stored", progress.stored.label, flush=True)
        sys.stdin.read()

run_study(read_study(sys.argv[1]), sys.argv[2], workers=1, progress=hold)
"""


def test_only_one_process_works_on_a_study(study_file, finished, tmp_path, contents, refused):
    out, study = tmp_path / "out", read_study(study_file)
    command = [sys.executable, "-c", HOLDING, str(study_file), str(out)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout.readline().startswith("stored ")
        for resume in (False, True):
            refused(out, "another is at work on", study, resume=resume)
        run.kill()
    assert len(StudyResults(out).store.units()) == 1
    run_study(study, out, resume=True, workers=2)  # the lock has gone with the process
    assert contents(out) == contents(finished)


FULL = """
import resource
import signal
import sys
from curricle.cli import main
from curricle.study import read_study
from curricle.study import run_study

file, whole, out, most = sys.argv[1:]
run_study(read_study(file), whole)  # what is compiled is stored before the disk is full
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(most), int(most)))
sys.argv = ["curricle", "run", file, "--out", out, "--workers", "2"]
main()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs a limit on the size of files")
def test_a_full_disk_leaves_whole_units(study_file, tmp_path, contents):
    file, whole, out = (tmp_path / name for name in ("wide.toml", "whole", "out"))
    row = 30 * "."
    wide = f"S...P{row}\n.#...{row}\n...PT{row}\n" + 10 * f".....{row}\n"
    text = study_file.read_text().replace("S...P\n.#...\n...PT\n", wide)
    file.write_text(f"scratch = false\n{text}")
    done = subprocess.run(
        [sys.executable, "-c", FULL, file, whole, out, "27000"], capture_output=True, text=True
    )
    assert done.returncode == 3, done.stderr
    assert "Traceback" not in done.stderr
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith(f"curricle: results cannot be written to {out} (File too large)")
    assert not list(out.rglob("*.part"))
    stored = StudyStore(out).units()
    assert stored
    assert not StudyStore(out).damaged_units()
    assert {unit.about.task for unit in stored} <= {"corner", "easy"}
    complete = StudyStore(whole).finished()
    for unit in stored:
        wanted = complete[unit.key][unit.seeds[0]].result(unit.seeds).arrays
        for name, array in unit.result(unit.seeds).arrays.items():
            there = wanted[name][..., : array.shape[-1]]  # longer where others of its file are
            np.testing.assert_array_equal(array, there, name)
    run_study(read_study(file), out, resume=True, workers=2)
    assert contents(out) == contents(whole)


def test_a_run_of_a_finished_study_reads_each_file_once(study_file, copied, contents):
    before = contents(copied)
    run = f"""
import sys
from curricle.study import read_study, run_study
opened = []
def note(event, arguments):
    if event == "open" and arguments[1] is None:  # by what the library opens files with
        opened.append(str(arguments[0]))
study = read_study({str(study_file)!r})
sys.addaudithook(note)
run_study(study, {str(copied)!r}, resume=True, workers=1, progress=False)
print(*(name for name in opened if name.startswith({str(copied)!r})), sep="\\n")
"""
    done = subprocess.run([sys.executable, "-c", run], capture_output=True, text=True, check=True)
    read = done.stdout.split()
    assert sorted({*read}) == sorted(read)
    assert {*map(str, copied.rglob("*.npz"))} <= {*read}
    assert contents(copied) == before


def test_a_run_has_no_seeds_and_no_analysis_of_runs_before_it(read, tmp_path):
    out = tmp_path / "out"
    assert run_study(read(LINES, set=["seeds=5"]), out).analysis is not None
    shutil.rmtree(out / "units")
    assert run_study(read(LINES), out).record.seeds == (0, 1, 2)
    changed = read(LINES, set=['tasks.far.map="S..T"', "scratch=false"])
    assert run_study(changed, out, resume=True).analysis is None
