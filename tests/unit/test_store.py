"""The results folder: whole files or none, one set of settings, nothing of others touched."""

import os

import pyarrow.parquet as pq
import pytest

from curricle.errors import StoreError
from curricle.study.store import ResultsFolder

SETTINGS = {"seeds": 30, "version": "1"}


def test_reopening_with_the_same_settings_keeps_everything(tmp_path):
    ResultsFolder(tmp_path / "a", SETTINGS).write_json("x.json", [1, 2])
    again = ResultsFolder(tmp_path / "a", SETTINGS)
    assert again.has("x.json")
    assert again.read_json("x.json") == [1, 2]


@pytest.mark.parametrize("other", [{"seeds": 5, "version": "1"}, {"seeds": 30}, {}])
def test_other_settings_are_refused(tmp_path, other):
    ResultsFolder(tmp_path, SETTINGS)
    with pytest.raises(StoreError, match="holds results of other settings"):
        ResultsFolder(tmp_path, other)


def test_a_folder_of_other_files_is_refused_untouched(tmp_path):
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(StoreError, match="holds other files"):
        ResultsFolder(tmp_path, SETTINGS)
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.txt"]


def test_what_a_killed_run_left_unfinished_means_nothing(tmp_path):
    (tmp_path / ".settings123.part").write_text('{"see')
    assert ResultsFolder(tmp_path, SETTINGS).read_json("settings.json") == SETTINGS


def test_a_file_in_the_folders_place_is_refused(tmp_path):
    (tmp_path / "out").write_text("not a folder")
    with pytest.raises(StoreError, match="is a file"):
        ResultsFolder(tmp_path / "out", SETTINGS)


def test_a_place_below_a_file_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="folder that can be written"):
        ResultsFolder(tmp_path / "file" / "out", SETTINGS)


def test_damaged_settings_are_named(tmp_path):
    (tmp_path / "settings.json").write_text("{")
    with pytest.raises(StoreError, match=r"settings\.json must be JSON"):
        ResultsFolder(tmp_path, SETTINGS)


def test_a_write_that_fails_leaves_the_old_file_and_no_trace(tmp_path, monkeypatch):
    folder = ResultsFolder(tmp_path, SETTINGS)
    folder.write("data/x", b"old")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError, match="No space left"):
        folder.write("data/x", b"new")
    assert (tmp_path / "data" / "x").read_bytes() == b"old"
    assert [p.name for p in (tmp_path / "data").iterdir()] == ["x"]


def test_tables_are_parquet(tmp_path):
    folder = ResultsFolder(tmp_path, SETTINGS)
    folder.write_table("t.parquet", {"seed": [0, 1], "steps": [5.0, 7.5]})
    assert pq.read_table(tmp_path / "t.parquet").to_pydict() == {
        "seed": [0, 1],
        "steps": [5.0, 7.5],
    }
