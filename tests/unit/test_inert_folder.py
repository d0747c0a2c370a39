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
from tests.support.refusals import KINDS_OF_NO_FILE, no_file
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


# -- records that are refused ------------------------------------------------------------------

BAD = "clear\x1b[2J"
RECORDS = ["study.json", "analysis.json", "runs.json"]


@pytest.mark.parametrize("kind", KINDS_OF_NO_FILE)
def test_what_is_no_file_is_not_waited_for(folder, kind):
    for path in (*(folder / name for name in RECORDS), a_unit(folder)):
        path.rename(folder.parent / "aside")
        no_file(path, kind)
        refuses(folder, re.escape(path.name))
        path.rmdir() if path.is_dir() and not path.is_symlink() else path.unlink()
        (folder.parent / "aside").rename(path)


@pytest.mark.parametrize("name", RECORDS)
def test_other_json_is_refused(folder, name):
    for text in ("[" * 10**5, '{"a":' * 10**5, "[]", "{}", "null", "[1]", "\xff"):
        (folder / name).write_text(text, encoding="latin-1")
        refuses(folder, re.escape(name))


def values(part, **changed):
    """Return an edit of a study's record: other values in one of its parts."""
    return lambda study: study[part].update(changed)


def view(**changed):
    """Return an edit: other values in the view of every task."""

    def edit(study):
        for task in study["plan"]["tasks"]:
            task["view"].update(changed)

    return edit


def older(study):
    """Records without this field would be read as if nothing had been found."""
    for arm in study["plan"]["arms"].values():
        del arm["knows_target"]


def renamed(names):
    return {BAD if name in ("transfer", "maze") else name: x for name, x in names.items()}


def renamed_arm(study):
    study["plan"]["arms"] = renamed(study["plan"]["arms"])


def renamed_task(study):
    study["plan"]["target"] = BAD
    for arm in study["plan"]["arms"].values():
        arm["nodes"] = renamed(arm["nodes"])
        for edge in arm["transfers"]:
            edge["target"] = BAD


CHANGES = [
    (values("configuration", name=3), ""),
    (values("configuration", seeds=["a"]), ""),
    (values("plan", more=1), ""),
    (values("plan", target="mace"), ""),
    (values("plan", arms=None), ""),
    (values("plan", tasks=json.loads("[" * 400 + "]" * 400)), ""),
    (values("plan", tasks=[]), ""),
    (values("plan", eval_freq=0), ""),
    (older, ".*knows_target"),
    (values("configuration", name=BAD), ".*must be printable"),
    (renamed_arm, ".*must be printable"),
    (renamed_task, ".*must be printable"),
    (view(shape=[10**9, 10**9]), r"tasks\.0"),
    (view(cells=[10**6]), r"tasks\.0"),
    (view(states=[-1]), r"tasks\.0"),
    (view(ended=[99]), r"tasks\.0"),
    (view(directions=[7, 7, 7, 7]), r"tasks\.0"),
    (view(actions=["only"]), r"tasks\.0"),
    (view(markers=[["A", "red;}</style>"]]), r"tasks\.0"),
    (view(objects=[["treasure chest", 0, 0, True]]), r"tasks\.0"),
]


def test_a_record_of_another_form_is_refused(folder):
    record = folder / "study.json"
    whole = record.read_bytes()
    for edit, says in CHANGES:
        record.write_bytes(whole)
        change(record, edit)
        refuses(folder, rf"study\.json is not as Curricle writes it: {says}")


def test_an_analysis_that_does_not_fit_is_refused_or_left_out(folder):
    def other_arms(analysis):
        section = analysis["sections"][0]
        section["arms"] = section["certificates"][0]["arms"] = ["nobody"]
        analysis["episodes"]["transfer"]["maze"]["after"]["cells"][0] = [2000]

    change(folder / "analysis.json", other_arms)
    assert "predicted start" not in write_report(folder).read_text()
    change(folder / "analysis.json", lambda found: found["sections"][0].update(arms=[]))
    refuses(folder, r"analysis\.json is not as .*certificates must be of the section's arms")
    change(folder / "analysis.json", lambda found: found["sections"][0].update(certificates=3))
    refuses(folder, r"analysis\.json is not as Curricle writes it: sections\.0\.certificates")


def test_names_are_text_in_a_page(folder):
    bad = "</script><script>alert(1)</script>"

    def edit(study):
        study["configuration"]["name"] = bad
        study["plan"]["tasks"][0]["text"] = bad
        study["plan"]["arms"]["transfer"]["transfers"][0]["words"] = bad

    change(folder / "study.json", edit)
    assert bad not in write_report(folder).read_text()


# -- units that are refused --------------------------------------------------------------------


class Pickled:
    def __reduce__(self):
        return (open, ("ran", "w"))


def packed(*parts):
    """A compressed member."""
    return b"".join(parts), zipfile.ZIP_DEFLATED


def header(shape):
    buffer = io.BytesIO()
    described = {"descr": "<f4", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(buffer, described)
    return buffer.getvalue()


MUCH = packed(header((64, 2**18)), bytes(2**26))
TOO_MUCH = r"\.npz is not as .*(at most [\d,]+ bytes|must not be compressed)"
ROW = ["maze", 0, 100, True, "threshold reached", 0.0, 0.0, 0.0, 0.0, "words"]
NOT_TRUE = json.dumps([[*ROW[:3], "yes", *ROW[4:]]]).encode()
MEMBERS = [
    ("steps.npy", None, "it has no steps"),
    ("steps.npy", npy(np.array([Pickled()], dtype=object)), "must hold numbers or text, and no Py"),
    *((f"{name}.npy", MUCH, TOO_MUCH) for name in ("snapshot_values", "steps", "values")),
    *(
        ("snapshot_values.npy", packed(header(shape), bytes(8)), says)
        for shape, says in (
            ((10**6, 10**6), "does not fill its file"),
            ((10**30,), "does not fill its file"),
            ((-1,), r"\.npz"),
        )
    ),
    ("decisions.json", b"not at all", r"\.npz is not as .*invalid JSON"),
    ("decisions.json", None, r"\.npz is not as .*must have decisions\.json"),
    ("decisions.json", b'[["maze", 0, 100]]', r"0\.3: field required"),
    ("decisions.json", NOT_TRUE, r"should be a valid boolean"),
    ("decisions.json", json.dumps([ROW]).encode() + b" " * LARGEST_DECISIONS, "of at most"),
]


@pytest.mark.filterwarnings("ignore:divide by zero")
def test_members_that_are_missing_too_large_or_without_sense_are_refused(
    folder, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    unit = a_unit(folder)
    whole = unit.read_bytes()
    with np.load(unit) as arrays:
        stored = dict(arrays)
    steps, returns = stored["steps"], stored["greedy_return"]
    of_arrays = [
        ("greedy_return", steps, "greedy_return must be an array of shape"),
        ("steps_used", steps[:1], "steps_used must be an array of shape"),
        ("steps", steps[::-1], "steps must ascend"),
        ("source_steps", np.array([0, 10**15]), "must spend at most"),
        ("greedy_return", returns / 0.0, "finite"),
        ("greedy_return", returns.astype(np.int8), "must be an array of float64"),
        ("source_steps", stored["source_steps"].astype(np.int8), "must be an array of int64"),
        ("seeds", stored["seeds"][::-1], "seeds must be the seeds of its unit"),
    ]
    rows = [(f"{name}.npy", npy(np.ascontiguousarray(of)), says) for name, of, says in of_arrays]
    for name, member, says in (*MEMBERS, *rows):
        unit.write_bytes(whole)
        put(unit, {name: member})
        assert unit.stat().st_size < 2**18 or name == "decisions.json"
        refuses(folder, says)
    assert not (tmp_path / "ran").exists()


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
        put(unit, {"snapshot_values.npy": packed(bytes(2**26))})
    refuses(folder, r"\.npz is not as .*at most 33,619,968 bytes")


def test_a_unit_that_says_to_be_another_is_not_used(folder):
    unit, into = a_unit(folder), folder.parent / "whole"
    whole = unit.read_bytes()
    unfit = {"key": ["0f"], "seeds": [[5, 6], []], "task": [3, "../maze"]}
    for key, value in ((key, value) for key, several in unfit.items() for value in several):
        unit.write_bytes(whole)
        put(unit, {}, lambda about: about.update({key: value}))  # noqa: B023
        assert StudyStore(folder).damaged_units() == [unit]
        with pytest.raises(StoreError, match=re.escape(str(unit))):
            merge(into, [folder])
        assert not into.exists()
