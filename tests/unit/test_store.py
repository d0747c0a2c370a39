"""The results store: whole files of one description, in blocks of seeds whenever units ended."""

import shutil

import numpy as np
import pytest

from curricle.errors import StoreError
from curricle.files import sealed
from curricle.study import StudyResults, StudyStore, read_study, run_study, store
from curricle.study.analysis import study_record
from curricle.study.arms import Arms
from curricle.study.store import SCHEMA_VERSION, files_of, merged_files, pack
from tests.studies import OBSERVED_HUNT

SETTINGS = {"seeds": 30, "version": "1"}


def opened(path, settings=SETTINGS):
    with StudyStore.opened(path, settings, resume=True) as store:
        return store


def test_reopening_with_the_same_settings_keeps_everything(tmp_path):
    opened(tmp_path / "a").write_json("x.json", [1, 2])
    again = opened(tmp_path / "a")
    assert again.has("x.json")
    assert again.read_json("x.json") == [1, 2]
    assert again.description == SETTINGS


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
    with pytest.raises(StoreError, match=r"claims\.json is not as .* it must be JSON"):
        store.read_json("claims.json")


pytestmark = pytest.mark.usefixtures("quick_disk")


@pytest.mark.parametrize("between", [0.0, 1e9], ids=["each alone", "as many as wait"])
@pytest.mark.parametrize("workers", [1, 3])
def test_when_units_are_written_changes_nothing(
    study_file, finished, tmp_path, contents, monkeypatch, between, workers
):
    monkeypatch.setattr(store, "BETWEEN", between)
    monkeypatch.setattr(store, "MOST_FILES", 1)  # merged during the run, too
    study = read_study(study_file, set=["seeds_per_unit=1"])
    run_study(study, tmp_path / "out", workers=workers)
    assert contents(tmp_path / "out" / "units") == contents(finished / "units")


def test_each_task_has_one_file_for_its_seeds(finished):
    files = StudyStore(finished).units()
    assert [unit.seeds for unit in files] == [(0, 1, 2, 3)] * len(files)
    assert len({unit.key for unit in files}) == len(files)


def test_files_hold_blocks_of_seeds(study_file, tmp_path, monkeypatch):
    monkeypatch.setattr(store, "FULL", 1)  # one seed a file
    study = read_study(study_file, set=["seeds_per_unit=1"])
    run_study(study, tmp_path / "out")
    files = StudyStore(tmp_path / "out").units()
    assert {len(unit.seeds) for unit in files} == {1}
    pack(StudyStore(tmp_path / "out"), {unit.key: 3 for unit in files})
    blocks = {unit.seeds for unit in StudyStore(tmp_path / "out").units()}
    assert blocks == {(0, 1, 2), (3,)}


def test_units_of_large_tables_are_not_held(study_file, tmp_path, monkeypatch):
    monkeypatch.setattr(store, "FULL", 1)
    monkeypatch.setattr(store, "BETWEEN", 1e9)
    study, files = read_study(study_file), []

    def count(progress):
        files.append(len(list((tmp_path / "out").glob("units/*/*.npz"))))

    run_study(study, tmp_path / "out", workers=1, progress=count)
    assert files[-1] == 16
    assert max(np.diff(files)) <= 2  # as many as one worker is ahead


def test_a_run_that_was_killed_while_it_merged_goes_on(study_file, finished, tmp_path, contents):
    """The merged file was there, and some of those that it is made of."""
    out = shutil.copytree(finished, tmp_path / "out")
    part = tmp_path / "part"
    run_study(read_study(study_file, set=['seeds="1-2"']), part)
    shutil.copytree(part / "units", out / "units", dirs_exist_ok=True)
    assert contents(out) != contents(finished)
    run_study(read_study(study_file), out, resume=True)
    assert contents(out) == contents(finished)


def test_no_seed_is_merged_twice(study_file, finished, tmp_path):
    out = shutil.copytree(finished, tmp_path / "out")
    part = tmp_path / "part"
    run_study(read_study(study_file, set=['seeds="1-2"']), part)
    shutil.copytree(part / "units", out / "units", dirs_exist_ok=True)
    store, key = StudyStore(out), StudyResults(out).record.keys["scratch", "maze"]
    merged = merged_files(store, [unit for unit in store.units() if unit.key == key])
    assert merged.seeds == (0, 1, 2, 3)
    assert [unit for unit in store.units() if unit.key == key] == [merged]


def test_a_network_has_a_file_for_each_unit(tmp_path):
    (tmp_path / "hunt.toml").write_text(OBSERVED_HUNT)
    study = read_study(tmp_path / "hunt.toml")
    arms = Arms.of(study)
    per_file = files_of(study_record(study, arms))
    per_task = {task: per_file[key] for (arm, task), key in arms.keys.items() if arm != "scratch"}
    assert per_task["hunt"] == 1
    assert per_task["chase"] > 5
