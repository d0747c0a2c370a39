"""A results folder is data: reading one from anywhere runs no code of it, and waits for nothing."""

import io
import json
import os
import re
import socket
import struct
import subprocess
import sys
import zipfile
from getpass import getuser

import numpy as np
import pytest

import curricle as cr
from curricle.errors import StoreError
from curricle.files import SEAL, sealed_archive
from curricle.show.report import write_report
from curricle.study import StudyStore, merge
from curricle.study.store import LARGEST_DECISIONS
from tests.support.sent_folders import a_unit, change, npy, put, refuses

pytestmark = pytest.mark.usefixtures("quick_disk")
EVIL = """
from pathlib import Path
Path("ran").touch()
def corner(*_, **__): ...
maze = same = corner
"""
LISTENING = """
import sys
import sysconfig
from pathlib import Path

own = {Path(p).resolve() for p in (sys.prefix, sys.base_prefix, sys.argv[1])}
own |= {Path(sysconfig.get_path(kind)).resolve() for kind in ("stdlib", "platstdlib", "purelib")}
heard = []

def foreign(file):
    return not file.startswith("<") and not own & set(Path(file).resolve().parents)

def hook(event, arguments):
    if event == "exec" and foreign(arguments[0].co_filename):
        heard.append((event, arguments[0].co_filename))
    elif event in ("pickle.find_class", "os.system", "os.exec", "os.posix_spawn", "os.fork"):
        heard.append((event, *map(str, arguments[:2])))
    elif event in ("subprocess.Popen", "socket.connect", "shutil.copyfile"):
        heard.append((event, str(arguments[0])))

sys.path.insert(0, "")
sys.addaudithook(hook)
from curricle.cli import main
from curricle.study import StudyResults

play = ["play", "--arm", "transfer"]
for command in (["show"], ["show", "--decisions"], ["compare"], ["report"], play):
    sys.argv = ["curricle", command[0], "out", *command[1:]]
    try:
        main()
    except SystemExit as end:
        assert not end.code, end
study = StudyResults("out")
for arm, task in study.record.keys:
    study.result(arm, task, values=True)
assert len(study.runs) == 1
print("HEARD", heard)
print("MODULES", [m for m in sys.modules if m in ("rules", "conftest") or "curricle_study_" in m])
"""


@pytest.fixture
def folder(sent_folder):
    return sent_folder


# -- what is read, and what is not -------------------------------------------------------------


def test_reading_imports_and_runs_nothing_of_a_study(folder, tmp_path):
    def hostile(study):
        for arm in study["configuration"]["arms"].values():
            arm["tasks"]["corner"]["factory"] = "subprocess:getoutput"
            arm["tasks"]["corner"]["arguments"] = {"cmd": "touch ran"}
            arm["transfers"][0]["factory"] = "rules:same"

    change(folder / "study.json", hostile)
    for place in (tmp_path, folder, a_unit(folder).parent):
        (place / "rules.py").write_text(EVIL)
        (place / "conftest.py").write_text(EVIL)
    (folder / ".checkpoints").mkdir()
    (folder / ".checkpoints" / "one.checkpoint").write_bytes(b"cos\nsystem\n(S'touch ran'\ntR.")
    source = os.path.dirname(os.path.dirname(cr.__file__))
    done = subprocess.run(
        [sys.executable, "-c", LISTENING, source], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "HEARD []" in done.stdout
    assert "MODULES []" in done.stdout
    assert not list(tmp_path.rglob("ran"))
    assert "2 of 2 seeds finished" in done.stdout


def test_nothing_in_a_folder_names_the_machine_or_its_user(sent):
    names = ["a_distinctive_home", "of_somebody", str(sent.parent), sys.prefix, sys.executable]
    names += [rf"\b{name}\b" for name in (socket.gethostname(), getuser()) if len(name) > 1]
    files = [path for path in sent.rglob("*") if path.is_file()]
    assert len(files) > 7
    for path in files:
        assert not [word for word in names if re.search(word.encode(), path.read_bytes())], path


def test_a_report_has_all_that_the_tasks_themselves_could_say(folder):
    page = write_report(folder).read_text()
    for head in ("Is the shaping safe?", "One episode, before and after"):
        assert head in page
    assert "is left out" not in page
    assert str(folder.parent) not in page


# -- what is refused ---------------------------------------------------------------------------


class Pickled:
    def __reduce__(self):
        return (open, ("ran", "w"))


def test_pickles_in_an_archive_of_arrays_are_refused(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    put(a_unit(folder), steps__npy=npy(np.array([Pickled()], dtype=object)))
    refuses(folder, r"\.npz is not as .*must hold numbers or text, and no Python objects")
    assert not (tmp_path / "ran").exists()


def packed(*parts):
    """A compressed member."""
    return b"".join(parts), zipfile.ZIP_DEFLATED


def header(shape):
    buffer = io.BytesIO()
    described = {"descr": "<f4", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(buffer, described)
    return buffer.getvalue()


@pytest.mark.parametrize("name", ["snapshot_values", "steps", "values"])
def test_a_small_archive_of_much_is_refused(folder, name):
    unit = a_unit(folder)
    put(unit, **{f"{name}__npy": packed(header((64, 2**18)), bytes(2**26))})
    assert unit.stat().st_size < 2**18
    refuses(folder, r"\.npz is not as .*(at most [\d,]+ bytes|must not be compressed)")


def test_members_that_share_their_bytes_are_refused(folder):
    unit = a_unit(folder)
    content = unit.read_bytes()[:-SEAL]
    directory, end = content.index(b"PK\1\2"), content.index(b"PK\5\6")
    entries = content[directory:end]
    more = 50 * (entries.count(b"PK\1\2"),)  # the directory lists all of them again and again
    sizes = struct.pack("<HHI", *[sum(more)] * 2, len(more) * len(entries))
    tail = content[end : end + 8] + sizes + content[end + 16 :]
    content = content[:directory] + len(more) * entries + tail
    unit.write_bytes(sealed_archive(content, directory))
    refuses(folder, "its members must have different names and bytes")


def test_a_task_said_to_be_enormous_has_no_enormous_snapshots(folder, monkeypatch):
    monkeypatch.setattr("curricle.study.results.MAX_SNAPSHOT_BYTES", 2**25)

    def edit(study):
        for task in study["plan"]["tasks"]:
            task["states"] = 10**12

    change(folder / "study.json", edit)
    for unit in (folder / "units").glob("*/*.npz"):
        put(unit, snapshot_values__npy=packed(bytes(2**26)))
    refuses(folder, r"\.npz is not as .*at most 33,619,968 bytes")


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ((10**6, 10**6), "does not fill its file"),
        ((10**30,), "does not fill its file"),
        ((-1,), r"\.npz"),
    ],
)
def test_an_array_larger_than_its_file_is_refused(folder, shape, message):
    put(a_unit(folder), snapshot_values__npy=packed(header(shape), bytes(8)))
    refuses(folder, message)


@pytest.mark.filterwarnings("ignore:divide by zero")
def test_arrays_of_other_shapes_or_without_sense_are_refused(folder):
    unit = a_unit(folder)
    whole = unit.read_bytes()
    with np.load(unit) as arrays:
        changed = dict(arrays)
    for name, array, message in (
        ("greedy_return", changed["steps"], "greedy_return must be an array of shape"),
        ("steps_used", changed["steps"][:1], "steps_used must be an array of shape"),
        ("steps", changed["steps"][::-1], "steps must ascend"),
        ("source_steps", np.array([0, 10**15]), "must spend at most"),
        ("greedy_return", changed["greedy_return"] / 0.0, "finite"),
        ("greedy_return", changed["greedy_return"].astype(np.int8), "must be an array of float64"),
        ("source_steps", changed["source_steps"].astype(np.int8), "must be an array of int64"),
        ("seeds", changed["seeds"][::-1], "seeds must be the seeds of its unit"),
    ):
        unit.write_bytes(whole)
        put(unit, **{f"{name}__npy": npy(np.ascontiguousarray(array))})
        refuses(folder, message)


def test_units_without_what_belongs_to_them_are_refused(folder):
    unit = a_unit(folder)
    put(unit, steps__npy=None)
    refuses(folder, "it has no steps")


UNFIT = [{"key": "0f"}, {"seeds": [5, 6]}, {"seeds": []}, {"task": 3}, {"task": "../maze"}]


@pytest.mark.parametrize("about", UNFIT)
def test_a_unit_that_says_to_be_another_is_not_used(folder, about):
    unit = a_unit(folder)
    put(unit, lambda found: found.update(about))
    assert StudyStore(folder).damaged_units() == [unit]
    with pytest.raises(StoreError, match=re.escape(str(unit))):
        merge(folder.parent / "whole", [folder])
    assert not (folder.parent / "whole").exists()


def test_decisions_that_are_none_or_too_long_are_refused(folder):
    unit = a_unit(folder)
    put(unit, decisions__json=b"not at all")
    refuses(folder, r"\.npz is not as .*invalid JSON")
    put(unit, decisions__json=None)
    refuses(folder, r"\.npz is not as .*must have decisions\.json")
    put(unit, decisions__json=b'[["maze", 0, 100]]')
    refuses(folder, r"0\.3: field required")
    row = ["maze", 0, 100, True, "threshold reached", 0.0, 0.0, 0.0, 0.0, "words"]
    put(unit, decisions__json=json.dumps([[*row[:3], "yes", *row[4:]]]).encode())
    refuses(folder, r"should be a valid boolean")
    put(unit, decisions__json=json.dumps([row]).encode() + b" " * LARGEST_DECISIONS)
    refuses(folder, r"decisions\.json, uncompressed, of at most")
