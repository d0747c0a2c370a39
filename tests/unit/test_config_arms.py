"""Study files: seeds, settings for all tasks and for one, arms, and what is set from outside."""

import json
import re
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

import curricle as cr
from curricle import GridWorld
from curricle.study import StudyConfig, read_study
from curricle.study.config import configured, json_schema
from curricle.study.templates import KINDS, template
from curricle.study_file.file import Positions, merged
from curricle.transfer import aggregate as aggregation
from tests.support.studies import HUNT, MAZE, only

# Seeds.


@pytest.mark.parametrize(
    ("said", "made"),
    [
        ("3", (0, 1, 2)),
        ("[7, 0]", (7, 0)),
        ("'0-2'", (0, 1, 2)),
        ("'0-1, 8,20-21'", (0, 1, 8, 20, 21)),
    ],
)
def test_seeds_may_be_a_number_a_list_or_ranges(read, said, made):
    assert read(MAZE, set=[f"seeds={said}"]).seeds == made


def test_everything_else_has_a_default(read):
    study = read(MAZE)
    assert study.seeds == tuple(range(30))
    assert (study.seeds_per_unit, study.threshold, study.window) == (5, None, 5)
    assert study.scratch
    assert list(study.arms) == ["transfer"]


def test_a_file_may_begin_with_a_byte_order_mark(read, tmp_path):
    expected = read(MAZE)
    (tmp_path / "windows.toml").write_bytes(b"\xef\xbb\xbf" + MAZE.replace("\n", "\r\n").encode())
    assert read_study(tmp_path / "windows.toml") == expected


# Settings for all tasks, for one, and in an arm.


def test_a_task_s_table_goes_over_the_one_for_all_key_by_key(read):
    study = read(HUNT, set=["tasks.chase.learner.epsilon=0.5"])
    assert only(study).setting("learner", "chase") == cr.QLearning(0.2, 0.5)
    assert only(study).setting("learner", "hunt") == cr.QLearning(0.2, 0.1)


def test_an_arm_changes_what_it_says_and_nothing_else(read):
    study = read(
        HUNT
        + """
        [arms.minimum]
        [arms.mean]
        aggregate = "mean"
        [arms.long-chase]
        tasks.chase.budget = 9_000
        tasks.chase.learner.epsilon = 0.5
        [arms.one-source]
        transfers = [1]
        [arms.scaled]
        transfers.0.scale = 3
        """
    )
    arms = study.curricula
    assert list(arms) == ["minimum", "mean", "long-chase", "one-source", "scaled"]
    assert [a.setting("aggregate", "hunt") for a in arms.values()].count(cr.minimum) == 4
    assert arms["mean"].setting("aggregate", "hunt") is cr.mean
    caps = [a.setting("budget", "chase").max_steps for a in arms.values()]
    assert caps == [2_000, 2_000, 9_000, 2_000, 2_000]
    assert arms["long-chase"].setting("learner", "chase") == cr.QLearning(0.2, 0.5)
    assert [len(a.transfers) for a in arms.values()] == [2, 2, 2, 1, 2]
    assert arms["one-source"].transfers[0].mapping.renaming == {"predator": "predator_2"}
    assert [t.scale for t in arms["scaled"].transfers] == [3, 2]
    assert len({id(a.tasks["hunt"]) for a in arms.values()}) == 1


def test_what_says_how_potentials_enter_is_of_tasks_with_sources_only(read):
    study = read(HUNT + "[arms.a]\n[arms.b]\naggregate = 'mean'\nshaping = 'StateShaping'")
    first, second = study.arms.values()
    assert first.tasks["chase"] == second.tasks["chase"]
    assert first.tasks["hunt"] != second.tasks["hunt"]


def test_an_arm_without_a_source_is_without_its_task(read):
    three = (
        HUNT
        + """
        [tasks]
        small = { type = "pursuit", size = 2, predators = 1 }
        [[transfers]]
        source = "small"
        target = "chase"
        project = {}
        [arms.three]
        [arms.two]
        transfers = [0, 1]
        [arms.other]
        transfers = [{ source = "small", target = "hunt", project = { predator = "predator_1" } }]
        """
    )
    arms = read(three).curricula
    assert {name: set(arm.tasks) for name, arm in arms.items()} == {
        "three": {"small", "chase", "hunt"},
        "two": {"chase", "hunt"},
        "other": {"small", "hunt"},
    }


def test_arms_may_fill_in_what_the_study_leaves_open(read):
    study = read(
        MAZE
        + """
        [tasks]
        corner = { type = "crop", of = "maze" }
        [[transfers]]
        source = "corner"
        target = "maze"
        mapping = "same_position"
        [arms.small]
        tasks.corner = { rows = [0, 1], columns = [3, 5] }
        [arms.large]
        tasks.corner = { rows = [0, 2], columns = [2, 5] }
        """
    )
    assert [arm.tasks["corner"].states.size for arm in study.curricula.values()] == [2, 6]


RULE, EPISODES = {"max_steps": 9, "threshold": 1}, {"episodes": 3}
HUNTING, DRAWN = {"type": "pursuit", "size": 4, "budget": 9}, {"type": "maze", "map": "S.T"}
WIDE = {"type": "OptimisticQLearning", "value_range": [0, 9], "epsilon": 0.3}
PLAIN = {"type": "QLearning", "learning_rate": 0.3}
MERGED = [
    ({"budget": 5}, {"budget": EPISODES}, {"budget": EPISODES}),
    ({"budget": RULE}, {"budget": EPISODES}, {"budget": EPISODES}),
    ({"map": "S.T"}, {"file": "x.txt"}, {"file": "x.txt"}),
    ({"epsilon": 0.1}, {"inverse_temperature": 1}, {"inverse_temperature": 1}),
    (HUNTING, DRAWN, {**DRAWN, "budget": 9}),
    ({"learner": PLAIN}, {"learner": {"type": "SARSA"}}, {"learner": {**PLAIN, "type": "SARSA"}}),
    (
        {"learner": WIDE},
        {"learner": {"type": "SARSA"}},
        {"learner": {"type": "SARSA", "epsilon": 0.3}},
    ),
    (  # the keys of a maker's arguments are its own
        {"arguments": {"type": "ice", "map": "m", "size": {"type": 1, "rows": 2}}},
        {"arguments": {"type": "snow", "file": "f", "size": {"type": 2}}},
        {"arguments": {"type": "snow", "map": "m", "file": "f", "size": {"type": 2, "rows": 2}}},
    ),
]


@pytest.mark.parametrize(("base", "patch", "expected"), MERGED)
def test_merging(base, patch, expected):
    assert merged(base, patch) == expected


TREES = st.recursive(
    st.integers(0, 3) | st.lists(st.integers(0, 3)),
    lambda inner: st.dictionaries(st.sampled_from("abcd"), inner, max_size=3),
    max_leaves=8,
)
TABLES = st.dictionaries(st.sampled_from("abcd"), TREES, max_size=4)


@given(TABLES, TABLES)
def test_merging_twice_is_merging_once_and_nothing_changes_nothing(first, second):
    assert merged(first, {}) == merged({}, first) == merged(first, first) == first
    assert merged(merged(first, second), second) == merged(first, second)


# Setting things from outside.


def test_what_is_set_is_read_as_toml_or_else_as_text(read):
    study = read(
        HUNT,
        set=[
            "name=short",
            "seeds='0-1'",
            "tasks.hunt.size=4",
            "aggregate=total",
            "seeds_per_unit = 1e1",
        ],
    )
    assert study.name == "short"
    assert study.seeds == (0, 1)
    assert study.seeds_per_unit == 10
    assert only(study).tasks["hunt"].size == 4
    assert only(study).setting("aggregate", "hunt") is aggregation.total


def test_arms_of_a_file_may_be_left_out(read, tmp_path):
    whole = read(MAZE + "[arms]\nfast = { budget = 10 }\nslow = { budget = 20 }\n")
    (file,) = tmp_path.glob("*.toml")
    part = read_study(file, arms=["slow"])
    assert list(part.arms) == ["slow"]
    assert part.arms["slow"] == whole.arms["slow"]
    with pytest.raises(cr.errors.ConfigError, match="arm 'slwo' is unknown, did you mean 'slow'"):
        read_study(file, arms=["slow", "slwo"])


# As plain data.


def test_two_ways_to_write_a_study_are_one_configuration(read):
    short = read(HUNT)
    long = read(
        """
        name = 'hunt'
        opponents = []
        seeds = [0, 1, 2, 3]
        seeds_per_unit = 2.0
        threshold = -8
        [tasks.hunt]
        type = "pursuit"
        size = 3
        moves = 5
        aggregate = "minimum"
        budget = 4e3
        learner = { type = "QLearning", learning_rate = 0.2, epsilon = 0.1 }
        [tasks.chase]
        type = "pursuit"
        size = 3
        predators = 1
        budget = 2000
        learner = { learning_rate = 0.2, epsilon = 0.1 }
        [arms.transfer]
        transfers = [
            { source = "chase", target = "hunt", project.predator = "predator_1", scale = 2.0 },
            { source = "chase", target = "hunt", project.predator = "predator_2", scale = 2.0 },
        ]
        """
    )
    assert long == short
    assert long.to_data() == short.to_data()


def test_a_configuration_holds_its_maps(read, tmp_path):
    (tmp_path / "maze.txt").write_text("....T\n.PPP.\nS....\n")
    by_file = read(
        "name = 'maze'\nopponents = []\ntasks.maze = { type = 'maze', file = 'maze.txt' }"
    )
    (tmp_path / "maze.txt").unlink()
    assert by_file == read(MAZE)
    again = StudyConfig.from_data(by_file.to_data(), Path("elsewhere"))
    assert only(again).tasks["maze"] == GridWorld(["....T", ".PPP.", "S...."])


SMALL = st.fixed_dictionaries(
    {"type": st.just("pursuit"), "size": st.integers(2, 4), "predators": st.integers(1, 3)},
    optional={
        "torus": st.booleans(),
        "time_limit": st.integers(1, 99) | st.just("none"),
        "budget": st.integers(1, 10**6) | st.fixed_dictionaries({"episodes": st.integers(1, 99)}),
        "shaping": st.sampled_from(
            ["StateShaping", {"portfolio": True}, {"portfolio": {"memory": 9}}]
        ),
        "learner": st.fixed_dictionaries(
            {},
            optional={
                "epsilon": st.floats(0, 1),
                "learning_rate": st.just({"type": "harmonic", "half": 3}),
            },
        ),
    },
)


@given(SMALL, SMALL, st.sampled_from([1, -0.5]))
def test_any_configuration_comes_back_equal(source, target, scale):
    edge = {"source": "a", "target": "b", "project": {}, "scale": scale}
    study = {"name": "x", "tasks": {"a": source, "b": target}, "transfers": [edge]}
    config = configured(study, Path(), Positions("x.toml"))
    plain = json.loads(json.dumps(config.to_data()))
    assert StudyConfig.from_data(plain, Path()) == config


# The schema and the templates.


def test_the_schema_says_what_each_key_means():
    schema = json_schema()
    tables = [
        schema,
        *(definition for definition in schema["$defs"].values() if "properties" in definition),
    ]
    assert {"maze", "Transfer", "ArmPatch", "FamilyTask"} <= {table["title"] for table in tables}
    assert {"deep", "observation_task", "MiniGridView", "TuneTable"} <= schema["$defs"].keys()
    assert {"arms", "sweep"} <= schema["properties"].keys()
    for table in tables:
        # Their keys are the parameters of a family, or those of any setting.
        if table["title"] not in ("FamilyTask", "SweepTable"):
            assert table["additionalProperties"] is False
        assert table["description"]
        for name, value in table["properties"].items():
            assert name == "type" or value["description"], (table["title"], name)
    assert set(schema["required"]) == {"name", "tasks"}
    json.dumps(schema)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_what_a_template_shows_as_defaults_are_the_defaults(read, kind):
    shown = re.sub(r"(?m)^# (?!threshold|encode|aggregate)([\w.]+ = )", r"\1", template(kind))
    assert shown != template(kind)
    assert read(shown) == read(template(kind))


def test_a_mistake_is_told_without_loading_anything_heavy(tmp_path):
    (tmp_path / "study.toml").write_text(HUNT.replace("predators", "predatrs"))
    code = """
        import sys
        from curricle.errors import ConfigError, SettingError
        from curricle.study import read_study
        try:
            read_study(sys.argv[1])
        except ConfigError as error:
            assert "predatrs" in str(error)
            sys.exit(bool({"pyarrow", "matplotlib", "torch"} & set(sys.modules)))
    """
    command = [sys.executable, "-c", textwrap.dedent(code), str(tmp_path / "study.toml")]
    assert subprocess.run(command, check=False).returncode == 0
