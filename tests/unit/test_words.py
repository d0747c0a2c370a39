"""Values in the words of tables, names of arms and files, and messages."""

from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from curricle import GridWorld, Pursuit
from curricle.cli.output import total_words
from curricle.comparison.plan import numbered_seeds, seed_ranges
from curricle.comparison.sentences import in_brief, likely, short as with_dash, signed
from curricle.errors import StoreError
from curricle.statistics import Interval
from curricle.study.results import parquet_of
from curricle.study.store import StoredUnit, place_of
from curricle.study.tuning import short
from curricle.study_file.file import path_text
from curricle.study_file.schema import unknown
from curricle.study_file.vary import short_names, value_text, varied_in
from curricle.tasks.observation_task import made_by, plain_text
from curricle.tasks.spaces import action_name, state_name
from curricle.text import duration, rounded

NONE = float("nan")
LOSS = Interval(-1.5, -2.0, 1.0, 0.95, 30)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (in_brief(Interval(12345.6, 11000.2, 13700.0, 0.95, 20)), "12,300 [11,000, 13,700]"),
        (in_brief(Interval(5.0, NONE, NONE, 0.95, 20)), "5"),
        (with_dash(Interval(11.04, 10.0, 12.0, 0.95, 5)), "11.0 [10.0, 12.0]"),
        (with_dash(Interval(NONE, NONE, NONE, 0.95, 5)), "-"),
        (signed(LOSS), "−1.50\xa0[−2.00,\xa01.00]"),
        (likely(LOSS), "whether it pays is open"),
        ([*map(rounded, (-19.0, 0.5, -3215.4))], ["−19.0", "0.500", "−3,215"]),
        ([*map(short, (0.12345, 1234.5))], ["0.123", "1,234"]),
        ([*map(duration, (0.2, 75, 5000))], ["1 s", "75 s", "83 min"]),
        (
            total_words("maze", 1003, 1010, 10, sources=False),
            "every arm spends 1,010 steps: 1,003 of maze, rounded up to whole checkpoints of 10",
        ),
        ([*map(numbered_seeds, ([3], [0, 1, 2]))], ["seed 3", "seeds 0-2"]),
        (place_of("0f", "my maze", "0-4"), "my_maze-0f/seeds-0-4.npz"),
        (value_text({"type": "SARSA", "epsilon": 0.1}), "{type=SARSA, epsilon=0.1}"),
        (path_text(("tasks", "5 by 5", 0, "size")), 'tasks."5 by 5"[0].size'),
        (unknown("predatrs", ["predators"]), "is unknown, did you mean 'predators'?"),
        (unknown("x", ["size", "predators"]), "is unknown: known are size, predators"),
        (plain_text(np.arange(3)), "array([0, 1, 2])"),
        (made_by(partial(int, "7", base=8)), "int('7', base=8)"),
        (state_name(GridWorld(["S.", ".T"]).states, 2), "state 2 (row 1, column 0)"),
        (action_name(Pursuit(2, 2).actions, 1), "predator_1 stay, predator_2 north"),
    ],
)
def test_a_value_in_words(text, expected):
    assert text == expected


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
