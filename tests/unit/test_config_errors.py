"""Mistakes in a study file are sentences: file, line, key path, rule, value, what was meant."""

import tomllib
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from curricle.errors import ConfigError
from curricle.study import read_study
from curricle.study.config.merging import Positions
from curricle.study.config.reading import configured
from tests.studies import NUMBERED_HUNT as HUNT

TYPES = (
    "maze, crop, pursuit, four_rooms, key_lock_pit, block_dude, river_swim, deep_sea, gymnasium, "
    "tabulated, factory, family, observation_task, distilled"
)
"""Of tasks, in the order in which they are listed."""


LEARNER = "[learner]\nepsilon = 0.1"
SIZE = "size = 3\npred"
PROJECT = 'project = { predator = "predator_1" }'


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (
            "predators",
            "predatrs",
            "line 10: tasks.chase.predatrs is unknown, did you mean 'predators'?",
        ),
        (
            'type = "pursuit"\nsize = 3\npred',
            'type = "persuit"\npred',
            f"line 8: tasks.chase.type must be one of {TYPES}: got 'persuit', did you mean "
            "'pursuit'?",
        ),
        (
            PROJECT,
            "mapping = 'same_positon'",
            "line 20: transfers[0].mapping must be 'identity', 'same_position', "
            "'relative_objects', 'family' or 'auto': got 'same_positon', did you mean "
            "'same_position'?",
        ),
        (
            SIZE,
            "size = 'three'\npred",
            "line 9: tasks.chase.size must be a whole number: got 'three'",
        ),
        (SIZE, "torus = 1\npred", "line 9: tasks.chase.torus must be true or false: got 1"),
        (SIZE, "moves = 6\npred", "line 9: tasks.chase.moves must be 4 or 5: got 6"),
        ('name = "hunt"', "name = ''", "line 1: name must have 1 to 100 characters: got ''"),
        (
            LEARNER,
            "shaping.guard = 3",
            "line 4: shaping.guard must be true, false or a table: got 3",
        ),
        (LEARNER, "seeds_per_unit = 0", "line 4: seeds_per_unit must be at least 1: got 0"),
        (LEARNER, "tasks.a = 3", "line 4: tasks.a must be a table: got 3"),
        ("epsilon = 0.1", "epsilon = nan", "line 5: learner.epsilon must be finite: got nan"),
    ],
)
def test_a_mistake_is_one_sentence_with_its_place(complaints, old, new, sentence):
    assert sentence in complaints(HUNT, (old, new))


@pytest.mark.parametrize(
    ("old", "new", "start", "end"),
    [
        (LEARNER, "[storage]\nqqq = 1", "line 5: storage.qqq is unknown: known are", "save_values"),
        (SIZE, "capture = 'al'\npred", "line 9: tasks.chase.capture must be", "mean 'all'?"),
        (SIZE, "prey = 'uni'\npred", "line 9: tasks.chase.prey must be", "mean 'uniform'?"),
        ('type = "pursuit"\nsize = 3\npred', "pred", "line 7: tasks.chase.type is missing", TYPES),
        (LEARNER, "aggregate = 'minmum'", "line 4: aggregate must be one of", "mean 'minimum'?"),
        ("budget = 2_000", f"budget = 1{400 * '0'}", "line 11: tasks.chase.budget must", "00..."),
        ('source = "chase"', 'source = "chse"', "line 18: transfers[0].source must", "'chase'?"),
        (PROJECT, f"mapping = 'identity'\n{PROJECT}", "line 17: transfers[0]", "project, mapping"),
        (PROJECT, "function = 'cart'", "line 20: transfers[0].function must name", "got 'cart'"),
    ],
)
def test_other_mistakes_name_their_place_and_what_is_there(complaints, old, new, start, end):
    lines = complaints(HUNT, (old, new))
    assert any(line.startswith(start) and line.endswith(end) for line in lines), lines


@pytest.mark.parametrize(
    "seeds", ["'0-'", "'a'", "'3-1'", "[1, 1]", "[]", "0", "-1", "1.5", "'0-99999999'"]
)
def test_malformed_seeds(complaints, seeds):
    (sentence,) = complaints(HUNT, ('"0-3"', seeds))
    assert sentence.startswith("line 2: seeds must be a number of seeds, a list of different ones")
    assert sentence.endswith(f"got {tomllib.loads(f'seeds = {seeds}')['seeds']!r}")


def test_all_mistakes_are_told_at_once_in_the_order_of_the_file(complaints):
    changes = [("seeds", "sedes"), ("size = 3\npred", "size = 'x'\npredd"), ("source", "sorce")]
    assert complaints(HUNT, *changes) == [
        "line 2: sedes is unknown, did you mean 'seeds'?",
        "line 9: tasks.chase.size must be a whole number: got 'x'",
        "line 10: tasks.chase.preddators is unknown, did you mean 'predators'?",
        "line 17: transfers[0].source is missing",
        "line 18: transfers[0].sorce is unknown, did you mean 'source'?",
    ]


# Files that are none.


def test_a_file_that_is_no_toml(complaints):
    assert complaints("name = \n") == [" is not valid TOML: Invalid value (at line 1, column 8)"]


def test_a_file_that_cannot_be_read(tmp_path):
    with pytest.raises(ConfigError, match=r"missing\.toml cannot be read: No such file"):
        read_study(tmp_path / "missing.toml")
    (tmp_path / "latin.toml").write_bytes(b"name = '\xe4'")
    with pytest.raises(ConfigError, match=r"latin\.toml cannot be read: it is not UTF-8"):
        read_study(tmp_path / "latin.toml")


def test_what_is_no_path_or_no_list_of_settings(tmp_path):
    with pytest.raises(ConfigError, match=r"^a study file must be a path: got 3$"):
        read_study(3)
    with pytest.raises(ConfigError, match=r"^set must be a list of settings, each .*: got 'a=1'$"):
        read_study(tmp_path / "none.toml", set="a=1")
    (tmp_path / "maze.toml").write_text("name = 'maze'")
    with pytest.raises(ConfigError, match=r"^a setting is given as key=value, .*: got 3$"):
        read_study(tmp_path / "maze.toml", set=[3])


def test_an_arm_that_is_not_there(tmp_path):
    (tmp_path / "study.toml").write_text(HUNT)
    with pytest.raises(ConfigError, match=r"arm 'trasfer' is unknown, did you mean 'transfer'\?$"):
        read_study(tmp_path / "study.toml").curriculum("trasfer")


# Nothing that TOML can say ends in anything but a configuration or a ConfigError.

# fmt: off
WORDS = st.sampled_from([
    "a", "b", "type", "maze", "crop", "pursuit", "map", "file", "of", "rows", "size", "tasks",
    "transfers", "arms", "learner", "epsilon", "budget", "episodes", "max_steps", "source",
    "target", "project", "mapping", "identity", "calibrate", "shaping", "guard", "seeds", "name",
    "0", "1",
])
# fmt: on
VALUES = st.recursive(
    WORDS | st.integers(-2, 9) | st.booleans() | st.floats() | st.just("S.T"),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(WORDS, inner, max_size=4),
    max_leaves=12,
)
TABLES = st.dictionaries(WORDS, VALUES, max_size=4)
STUDIES = st.fixed_dictionaries(
    {},
    optional={
        "name": VALUES,
        "seeds": VALUES,
        "learner": VALUES,
        "budget": VALUES,
        "shaping": VALUES,
        "tasks": VALUES | st.dictionaries(WORDS, TABLES, max_size=3),
        "transfers": VALUES | st.lists(TABLES, max_size=3),
        "arms": VALUES | st.dictionaries(WORDS, TABLES, max_size=2),
    },
)


@given(STUDIES)
def test_no_study_however_odd_is_worse_than_refused(study):
    sentences = []
    try:
        configured(study, Path("nowhere"), Positions("x.toml", study))
    except ConfigError as error:
        sentences = str(error).splitlines()
    assert all(line.startswith("x.toml: ") for line in sentences)
