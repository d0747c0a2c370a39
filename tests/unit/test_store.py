"""The results store: whole files or none, results of one description, nothing of others touched."""

import os

import pyarrow.parquet as pq
import pytest

from curricle.archives import sealed
from curricle.errors import StoreError
from curricle.study import StudyStore
from curricle.study.store import SCHEMA_VERSION

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
    found = "no schema version" if version is None else f"schema version {version}"
    for read in (opened, StudyStore):
        with pytest.raises(StoreError) as caught:
            read(tmp_path)
        assert str(caught.value) == (
            f"{tmp_path / 'study.json'} has {found} and this Curricle reads {SCHEMA_VERSION}: run "
            "the study again into a new folder, or read it with the version that wrote it"
        )
    assert (tmp_path / "study.json").read_bytes() == before


def test_a_damaged_file_is_named(tmp_path):
    store = opened(tmp_path)
    store.write("claims.json", b"{")
    with pytest.raises(StoreError, match=r"claims\.json is not as .* it must be JSON"):
        store.read_json("claims.json")


def test_a_write_that_fails_leaves_the_old_file_and_no_trace(tmp_path, monkeypatch):
    store = opened(tmp_path)
    store.write("data/x", b"old")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(StoreError, match=r"No space left.* what was stored before is whole"):
        store.write("data/x", b"new")
    assert (tmp_path / "data" / "x").read_bytes() == b"old"
    assert [path.name for path in (tmp_path / "data").iterdir()] == ["x"]


def test_tables_are_parquet(tmp_path):
    opened(tmp_path).write_table("t.parquet", {"seed": [0, 1], "steps": [5.0, 7.5]})
    assert pq.read_table(tmp_path / "t.parquet").to_pydict() == {
        "seed": [0, 1],
        "steps": [5.0, 7.5],
    }
