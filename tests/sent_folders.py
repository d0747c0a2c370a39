"""A folder of results from somewhere else, and ways to change it as an attacker would."""

import shutil
import time

import pytest

from curricle.errors import StoreError
from curricle.report.study_report import write_report
from curricle.study import StudyResults, read_study, run_study
from curricle.study.sealed_json import digest_of, sealed, unsealed

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
seeds = 2
seeds_per_unit = 2
budget = 400
[tasks.corner]
type = "factory"
factory = "rules:corner"
arguments = { rows = 2 }
[tasks.maze]
type = "factory"
factory = "rules:maze"
[[transfers]]
source = "corner"
target = "maze"
factory = "rules:same"
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
    found = unsealed(path.read_bytes())
    edit(found)
    path.write_bytes(sealed(found))


def a_unit(folder):
    """The unit that has snapshots and sources."""
    return next((folder / "units").glob("maze-*/*/snapshots.npz")).parent


def put(unit, name, content):
    """Put a file into a unit, and its size and checksum into the unit's description."""
    (unit / name).write_bytes(content)
    row = [len(content), digest_of(content)]
    change(unit / "unit.json", lambda found: found["files"].update({name: row}))


def read_all(folder):
    """Read all that the commands read."""
    study = StudyResults(folder)
    for arm, task in study.record.keys:
        study.result(arm, task, values=True)
        study.decisions(arm, task)
        study.source_steps(arm, task)
    study.table("curves.parquet")
    str(study.comparison)
    write_report(folder)


def refuses(folder, words):
    """Reading is refused at once, in one sentence."""
    began = time.perf_counter()
    with pytest.raises(StoreError, match=words) as caught:
        read_all(folder)
    assert time.perf_counter() - began < 5
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500
    assert str(folder) in str(caught.value)
