"""The results store: whole files of one description, one for each unit."""

import re
import shutil
import subprocess
import sys

import pytest

from curricle.errors import StoreError
from curricle.files import sealed
from curricle.study import StudyResults, StudyStore, read_study, run_study
from curricle.study.record import RunsRecord
from curricle.study.store import SCHEMA_VERSION

SETTINGS = {"seeds": 30, "version": "1"}
pytestmark = pytest.mark.usefixtures("quick_disk")


def opened(path, settings=SETTINGS):
    with StudyStore.opened(path, settings, resume=True) as store:
        return store


@pytest.mark.parametrize("other", [{"seeds": 5, "version": "1"}, {"seeds": 30}, {}])
def test_other_settings_are_refused(tmp_path, other):
    opened(tmp_path)
    with pytest.raises(StoreError, match="holds results of other settings"):
        opened(tmp_path, other)


@pytest.mark.parametrize("version", [None, 0, SCHEMA_VERSION + 1])
def test_another_schema_version_is_refused_with_what_to_do(tmp_path, version):
    study = SETTINGS if version is None else {"schema_version": version, **SETTINGS}
    (tmp_path / "study.json").write_bytes(sealed(study))
    before = (tmp_path / "study.json").read_bytes()
    form = "no schema version" if version is None else f"schema version {version}"
    form += ", of a later Curricle," * (version == SCHEMA_VERSION + 1)
    for read in (opened, StudyStore):
        with pytest.raises(StoreError) as caught:
            read(tmp_path)
        assert str(caught.value) == (
            f"{tmp_path / 'study.json'} has {form} and this Curricle reads {SCHEMA_VERSION}: run "
            "the study again into a new folder, or read it with the version that wrote it"
        )
    assert (tmp_path / "study.json").read_bytes() == before


def test_a_damaged_file_is_named(tmp_path):
    store = opened(tmp_path)
    store.write("claims.json", b"{")
    with pytest.raises(StoreError, match=r"claims\.json is damaged: its checksum does not fit"):
        store.record("claims.json", RunsRecord)


def test_a_file_of_another_unit_is_refused(study_file, copied, tmp_path, contents):
    """At its place: another key, other seeds, or another task that has the key of this one."""
    run_study(read_study(study_file, set=["learner.learning_rate=0.9"]), tmp_path / "other")
    first, second, *_, last = (unit.path for unit in StudyStore(copied).units())
    foreign = next(path for path in (tmp_path / "other").rglob("*.npz"))
    whole = contents(copied)
    for content in (second.read_bytes(), last.read_bytes(), foreign.read_bytes()):
        first.write_bytes(content)
        with pytest.raises(StoreError, match=re.escape(f"{first} is damaged: it holds")) as caught:
            _ = StudyResults(copied).comparison
        assert "run the study again with --resume" in str(caught.value)
        run_study(read_study(study_file), copied, resume=True)
        assert contents(copied) == whole


def test_two_files_of_one_seed_are_refused(study_file, copied, tmp_path):
    run_study(read_study(study_file, set=['seeds="1-2"', "seeds_per_unit=9"]), tmp_path / "part")
    shutil.copytree(tmp_path / "part" / "units", copied / "units", dirs_exist_ok=True)
    with pytest.raises(StoreError, match=r"must be in one file: .*-0-1\.npz and .*-1-2\.npz hold"):
        _ = StudyResults(copied).seeds


@pytest.mark.parametrize(
    "command", [("show",), ("compare",), ("report",), ("play", "--arm", "chain")]
)
def test_a_command_lists_a_folder_once_and_reads_each_file_once(copied, command):
    script = f"""
import sys
opened, listed = [], []
def note(event, arguments):
    if event == "open" and str(arguments[0]).startswith({str(copied)!r}) and arguments[1] is None:
        opened.append(arguments[0])
    if event == "os.scandir" and str(arguments[0]).startswith({str(copied)!r}):
        listed.append(str(arguments[0]))
sys.addaudithook(note)
sys.argv = ["curricle", {command[0]!r}, {str(copied)!r}, *{command[1:]!r}]
from curricle.cli import main
try:
    main()
finally:
    assert len({{*map(str, opened)}}) == len(opened) > 0, opened
    assert len({{*listed}}) == len(listed), listed
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_unit_of_another_task_than_is_asked_for_is_refused(finished):
    store = StudyStore(finished)
    unit = next(unit for unit in store.units() if unit.about.task == "corner")
    with pytest.raises(StoreError, match="it is of task 'corner', not 'maze'"):
        store.content(unit, "maze")
