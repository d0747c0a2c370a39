"""Names of files, arms and settings, and files that are the same however they were made."""

from pathlib import Path

import pyarrow as pa
import pytest

from curricle.comparison.plan import seed_ranges
from curricle.errors import StoreError
from curricle.study.results import parquet_of
from curricle.study.store import StoredUnit
from curricle.study_file.vary import short_names, varied_in


def test_seeds_are_read_as_they_are_written():
    assert seed_ranges([0, 1, 2, 7, 9, 10]) == "0-2+7+9-10"
    assert StoredUnit.at(Path("a-0f/seeds-0-2+7+9-10.npz")).seeds == (0, 1, 2, 7, 9, 10)
    for name in ("seeds-0-2_0f.npz", "seeds-5-2.npz"):
        with pytest.raises(StoreError, match="cannot be read"):
            StoredUnit.at(Path(name))


def test_settings_have_the_shortest_names_that_differ():
    both = varied_in({"tasks": {"a": {"budget": []}, "b": {"budget": []}}, "d.e": []}, ())
    assert [*short_names([*both]).values()] == ["a.budget", "b.budget", "e"]


def test_a_table_is_the_same_file_however_it_was_cut():
    table = pa.table({"seed": [0, 1, 2]})
    assert parquet_of([table]) == parquet_of([table[:1], table[1:]])
