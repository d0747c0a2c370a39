"""A folder of results from somewhere else, and ways to change it as an attacker would."""

import io
import json
import shutil
import zipfile

import numpy as np
import pytest

from curricle.errors import StoreError
from curricle.files import SEAL, as_json, sealed, sealed_archive, unsealed
from curricle.show.report import write_report
from curricle.study import StudyResults, read_study, run_study

RULES = """
import curricle as cr

def corner(rows):
    return maze().crop(rows=(0, rows), columns=(2, 5))

def maze():
    return cr.GridWorld(["....T", ".PPP.", "S...."], time_limit=30)

def same(target, source):
    return cr.same_position(target, source)
"""
STUDY = """
name = "own"
opponents = []
seeds = 2
seeds_per_unit = 2
budget = 400
tasks.corner = { type = "factory", factory = "rules:corner", arguments = { rows = 2 } }
tasks.maze = { type = "factory", factory = "rules:maze" }
transfers = [{ source = "corner", target = "maze", factory = "rules:same" }]
"""


@pytest.fixture(scope="module")
def sent(tmp_path_factory):
    """A folder of results whose study and whose own module are gone."""
    home = tmp_path_factory.mktemp("a_distinctive_home") / "of_somebody"
    home.mkdir()
    (home / "rules.py").write_text(RULES)
    (home / "own.toml").write_text(STUDY)
    run_study(read_study(home / "own.toml"), home / "out", workers=1)
    folder = tmp_path_factory.mktemp("sent") / "out"
    shutil.move(home / "out", folder)
    shutil.rmtree(home)
    return folder


@pytest.fixture
def sent_folder(sent, tmp_path):
    """A copy of that folder, to be changed."""
    return shutil.copytree(sent, tmp_path / "out")


def change(path, edit):
    """Change a file of JSON with a checksum, as somebody would who wants it to be read."""
    content = unsealed(path.read_bytes())
    edit(content)
    path.write_bytes(sealed(content))


def a_unit(folder):
    """The file of the unit that has snapshots and sources."""
    files = (folder / "units").glob("maze-*/*.npz")
    return next(file for file in files if "snapshot_steps" in np.load(file).files)


def put(unit, members, change=None):
    """Change members of a unit's sealed file: content, content and compression, or None."""
    with zipfile.ZipFile(unit) as archive:
        content = {m.filename: (archive.read(m), m.compress_type) for m in archive.infolist()}
    for name, member in members.items():
        stored = (member, zipfile.ZIP_STORED) if isinstance(member, bytes) else member
        content[name] = stored
    if change is not None:
        about = json.loads(content["unit.json"][0])
        change(about)
        content["unit.json"] = as_json(about), zipfile.ZIP_STORED
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, member in content.items():
            if member is not None:
                archive.writestr(name, *member)
        archive.comment = bytes(SEAL)
    unit.write_bytes(sealed_archive(buffer.getvalue()[:-SEAL], archive.start_dir))


def npy(array):
    """The content of an array's file."""
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, array)
    return buffer.getvalue()


def read_all(folder):
    """Read all that the commands read."""
    study = StudyResults(folder)
    assert study.runs
    for arm, task in study.record.keys:
        study.result(arm, task, values=True)
        study.decisions(arm, task)
        study.source_steps(arm, task)
    study.table("curves.parquet")
    str(study.comparison)
    write_report(folder)


def refuses(folder, fault):
    """Reading is refused in one sentence."""
    with pytest.raises(StoreError, match=fault) as caught:
        read_all(folder)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500
    assert str(folder) in str(caught.value)
