"""Study files: a configuration as plain data, the schema and the templates."""

import json
import re
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from curricle import (
    GridWorld,
)
from curricle.errors import ConfigError
from curricle.study import StudyConfig
from curricle.study.config.merging import Positions
from curricle.study.config.reading import configured
from curricle.study.config.study_config import json_schema
from curricle.study.config.templates import KINDS, template
from tests.studies import HUNT, MAZE, only

# As plain data.


def test_a_configuration_is_plain_data_and_comes_back_equal(read):
    study = read(
        HUNT
        + "[arms.a]\n[arms.b]\naggregate = 'mean'\n[arms.c]\nshaping.guard = { share_behind = 0.2 }"
    )
    words = json.dumps(study.to_data())
    again = StudyConfig.from_data(json.loads(words), study.folder)
    assert again == study
    assert json.dumps(again.to_data()) == words
    assert again.curricula["b"].tasks == study.curricula["b"].tasks


def test_two_ways_to_write_a_study_are_one_configuration(read):
    short = read(HUNT)
    long = read(
        """
        name = 'hunt'
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
    by_file = read("name = 'maze'\ntasks.maze = { type = 'maze', file = 'maze.txt' }")
    (tmp_path / "maze.txt").unlink()
    assert by_file == read(MAZE)
    again = StudyConfig.from_data(by_file.to_data(), Path("elsewhere"))
    assert only(again).tasks["maze"] == GridWorld(["....T", ".PPP.", "S...."])


def test_an_arm_s_file_takes_the_place_of_the_study_s_map(read, tmp_path):
    (tmp_path / "line.txt").write_text("S.T")
    study = read(
        MAZE
        + """
        [tasks]
        line = { type = "maze", map = "ST" }
        [[transfers]]
        source = "line"
        target = "maze"
        mapping = "relative_objects"
        [arms.line]
        tasks.line.file = "line.txt"
        """
    )
    assert only(study, "line").tasks["line"] == GridWorld("S.T")


SMALL = st.fixed_dictionaries(
    {"type": st.just("pursuit"), "size": st.integers(2, 4), "predators": st.integers(1, 3)},
    optional={
        "torus": st.booleans(),
        "time_limit": st.integers(1, 99) | st.just("none"),
        "budget": st.integers(1, 10**6) | st.fixed_dictionaries({"episodes": st.integers(1, 99)}),
        "shaping": st.sampled_from(
            ["StateShaping", {"guard": True}, {"guard": {"share_behind": 0.3}}]
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


@given(SMALL, SMALL, st.booleans() | st.just({"episodes": 3}))
def test_any_configuration_comes_back_equal(source, target, calibrate):
    edge = {"source": "a", "target": "b", "project": {}, "calibrate": calibrate}
    study = {"name": "x", "tasks": {"a": source, "b": target}, "transfers": [edge]}
    config = configured(study, Path(), Positions("x.toml", study))
    plain = json.loads(json.dumps(config.to_data()))
    assert StudyConfig.from_data(plain, Path()) == config


# The schema and the templates.


def test_the_schema_says_what_each_key_means():
    schema = json_schema()
    tables = [schema, *(one for one in schema["$defs"].values() if "properties" in one)]
    assert {"maze", "Transfer", "ArmPatch", "FamilyTask"} <= {table["title"] for table in tables}
    assert {"deep", "ObservationTaskTable", "MiniGridView", "TuneTable"} <= schema["$defs"].keys()
    assert {"families", "sweep"} <= schema["properties"].keys()
    for table in tables:
        # Their keys are the parameters of a family, or those of any setting.
        if table["title"] not in ("FamilyTable", "FamilyTask", "SweepTable"):
            assert table["additionalProperties"] is False
        assert table["description"]
        for name, value in table["properties"].items():
            assert name == "type" or value["description"], (table["title"], name)
    assert set(schema["required"]) == {"name", "tasks"}
    json.dumps(schema)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_what_a_template_shows_as_defaults_are_the_defaults(read, kind):
    shown = re.sub(r"(?m)^# (?!threshold|encode)([\w.]+ = )", r"\1", template(kind))
    assert shown != template(kind)
    assert read(shown) == read(template(kind))


def test_there_is_no_other_template():
    with pytest.raises(ConfigError, match=r"'pursiut' is unknown, did you mean 'pursuit'\?"):
        template("pursiut")


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
