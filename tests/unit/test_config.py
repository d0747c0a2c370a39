"""Study files: what a file says is what is built, however it is written."""

import inspect
import json
import re
import subprocess
import sys
import textwrap
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from pydantic import ValidationError

from curricle import (
    SARSA,
    Curriculum,
    DecayingAdvice,
    DoubleQLearning,
    Episodes,
    GreedyEvaluation,
    GridWorld,
    Guard,
    LookAheadAdvice,
    Pursuit,
    QInitialisation,
    QLearning,
    Rewards,
    StateShaping,
    StoppingRule,
    Storage,
    Transfer,
    mean,
    minimum,
    project,
    same_position,
)
from curricle.checks import number
from curricle.curriculum import RetrainSources
from curricle.curriculum.curriculum import SETTINGS
from curricle.errors import ConfigError, SettingError
from curricle.learning import Learner, exponential, harmonic, linear
from curricle.learning.schedules import Schedule
from curricle.learning.shaping import Shaping
from curricle.study import StudyConfig, json_schema, read_study
from curricle.study.config import settings, tasks, transfers
from curricle.study.config.derived_tables import table_of
from curricle.study.config.merging import merged
from curricle.study.config.positions import Positions
from curricle.study.config.reading import configured
from curricle.study.config.references import load
from curricle.study.config.templates import KINDS, template
from curricle.transfer import Calibrate, aggregation

HUNT = """
name = "hunt"
seeds = "0-3"
seeds_per_unit = 2
threshold = -8.0
aggregate = "minimum"
[learner]
learning_rate = 0.2
epsilon = 0.1

[tasks.chase]
type = "pursuit"
size = 3
predators = 1
budget = 2_000

[tasks.hunt]
type = "pursuit"
size = 3
predators = 2
budget = 4_000

[[transfers]]
source = "chase"
target = "hunt"
project = { predator = "predator_1" }
scale = 2

[[transfers]]
source = "chase"
target = "hunt"
project = { predator = "predator_2" }
scale = 2
"""
MAZE = """
name = "maze"
[tasks.maze]
type = "maze"
map = '''
    ....T
    .PPP.
    S....
'''
"""


@pytest.fixture
def read(tmp_path):
    def read_text(text, *, set=(), name="study.toml"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(textwrap.dedent(text), "utf-8")
        return read_study(path, set=set)

    return read_text


def only(study, arm="transfer"):
    return study.curriculum(arm)


# Tables are derived from the library's classes.


@dataclass(frozen=True)
class Invented:
    """What a later version may have.

    Parameters
    ----------
    height, width : float
        How large it is, in ``cells``.
    count : int
    """

    height: float
    width: float = 2.0
    count: int | None = None
    pace: float | Schedule = 0.5
    open: bool = False
    size: tuple[int, int] = (1, 1)

    def __post_init__(self):
        number("height", self.height, SettingError, 0.0)


def test_a_new_class_is_in_toml_without_a_second_declaration():
    table = table_of(Invented)
    made = table.model_validate({"height": 3, "pace": {"type": "harmonic"}, "size": [2, 4.0]})
    assert made.build() == Invented(3.0, pace=harmonic(), size=(2, 4))
    assert table.model_validate(made.model_dump(mode="json")) == made
    assert table.model_fields["width"].description == "How large it is, in cells."
    with pytest.raises(SettingError, match="height must be at least 0"):
        table(height=-1).build()
    for wrong in ({"height": "3"}, {"height": 1, "count": True}, {"height": 1, "open": 1}, {}):
        with pytest.raises(ValidationError):
            table.model_validate(wrong)


@pytest.mark.parametrize(
    ("table", "made"),
    [
        (settings.LEARNERS[0], QLearning()),
        (settings.EvaluationTable, GreedyEvaluation()),
        (settings.StorageTable, Storage()),
        (settings.SHAPINGS[0], QInitialisation()),
        (table_of(Guard), Guard()),
        (table_of(harmonic), harmonic()),
        (table_of(Calibrate), Calibrate()),
        (tasks.PursuitTask, Pursuit()),
    ],
)
def test_defaults_are_those_of_what_is_built(table, made):
    assert table().build() == made


def test_settings_and_transfers_are_those_of_a_curriculum(tmp_path):
    assert set(settings.Settings.model_fields) == set(SETTINGS)
    defaults = settings.Settings()
    for which, value in SETTINGS.items():
        assert defaults.setting(which, tmp_path) == value
    given = set(inspect.signature(Transfer).parameters) - {"mapping"}
    assert given == set(transfers.TransferTable.parameters)
    assert set(inspect.signature(GridWorld.crop).parameters) - {"self"} == (
        tasks.CropTask.model_fields.keys() - settings.Settings.model_fields.keys() - {"type", "of"}
    )


def test_choices_are_those_of_the_library():
    def public(base):
        found = {one for each in base.__subclasses__() for one in (each, *each.__subclasses__())}
        return {one.__name__ for one in found if not one.__name__.startswith("_")}

    assert {one.makes.__name__ for one in settings.LEARNERS} == public(Learner)
    assert {one.makes.__name__ for one in settings.SHAPINGS} == public(Shaping)
    assert set(settings.AGGREGATES) == {
        name
        for name, one in vars(aggregation).items()
        if inspect.isfunction(one) and list(inspect.signature(one).parameters) == ["potentials"]
    }


@pytest.mark.parametrize(
    ("table", "made"),
    [
        ("size = 5\npredators = 3", Pursuit(5, 3)),
        (
            "moves = 4\ntorus = true\ncapture = 'any'",
            Pursuit(moves=4, torus=True, capture="any"),
        ),
        ("capture = 2\nstep_reward = -2", Pursuit(capture=2, step_reward=-2)),
        ("capture_reward = 5\ndiscount = 1", Pursuit(capture_reward=5, discount=1)),
        ("time_limit = 'none'", Pursuit(time_limit=None)),
        (
            "size = 2\nmoves = 4\nprey = [[1, 0, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]",
            Pursuit(2, moves=4, prey=[[1, 0, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]),
        ),
    ],
)
def test_a_pursuit_is_the_one_described(read, table, made):
    study = read(f"name = 'x'\n[tasks.hunt]\ntype = 'pursuit'\n{table}")
    assert only(study).tasks["hunt"] == made


def test_a_maze_is_the_one_described(read):
    study = read(
        """
        name = "x"
        [tasks.maze]
        type = "maze"
        map = "S.F\\n.PT"
        rewards = { step = -5, pit = -100.0 }
        combine = "worst"
        ends = ["treasure"]
        start = [[4, 4], [3, 4]]
        representation = "relative"
        origin = [3, 4]
        discount = 0.9
        time_limit = 50
        """
    )
    assert only(study).tasks["maze"] == GridWorld(
        ["S.F", ".PT"],
        rewards=Rewards(step=-5, pit=-100),
        combine="worst",
        ends=("treasure",),
        start=[(4, 4), (3, 4)],
        representation="relative",
        origin=(3, 4),
        discount=0.9,
        time_limit=50,
    )


def test_a_crop_is_a_part_of_another_task_and_of_a_part(read):
    study = read(
        MAZE
        + """
        [tasks.corner]
        type = "crop"
        of = "right"
        rows = [0, 2]
        columns = [3, 5]
        start = [[1, 4]]
        [tasks.right]
        type = "crop"
        of = "maze"
        rows = [0, 3]
        columns = [2, 5]
        [[transfers]]
        source = "corner"
        target = "right"
        mapping = "same_position"
        [[transfers]]
        source = "right"
        target = "maze"
        mapping = "same_position"
        """
    )
    made = only(study).tasks
    maze = GridWorld(["....T", ".PPP.", "S...."])
    right = maze.crop(rows=(0, 3), columns=(2, 5))
    assert made == {
        "maze": maze,
        "right": right,
        "corner": right.crop(rows=(0, 2), columns=(3, 5), start=[(1, 4)]),
    }


def test_a_maze_that_only_lends_its_drawing_is_not_learnt(read):
    study = read(MAZE + "[tasks.corner]\ntype='crop'\nof='maze'\nrows=[0, 2]\ncolumns=[2, 5]\n")
    assert only(study).target == "corner"
    assert list(only(study).tasks) == ["corner"]


@pytest.mark.parametrize(
    ("table", "made"),
    [
        ("type = 'SARSA'\nepsilon = 0.3", SARSA(epsilon=0.3)),
        (
            "inverse_temperature = 2\ninitial_value = -5",
            QLearning(inverse_temperature=2.0, initial_value=-5.0),
        ),
        (
            "learning_rate = { type = 'harmonic' }\n"
            "epsilon = { type = 'linear', first = 1, last = 0.1, steps = 1e3 }",
            QLearning(learning_rate=harmonic(), epsilon=linear(1, 0.1, steps=1000)),
        ),
        (
            "type = 'DoubleQLearning'\n"
            "epsilon = { type = 'exponential', first = 1, half_life = 9.5 }",
            DoubleQLearning(epsilon=exponential(1, half_life=9.5)),
        ),
    ],
)
def test_a_learner_is_the_one_described(read, table, made):
    study = read(f"{MAZE}\n[tasks.maze.learner]\n{table}")
    assert only(study).setting("learner", "maze") == made


def test_settings_are_those_described(read):
    study = read(
        HUNT
        + """
        [tasks.hunt.shaping]
        type = "LookAheadAdvice"
        guard = { min_share = 0.2 }
        [tasks.hunt.evaluation]
        method = "rollouts"
        episodes = 7
        discounted = false
        [tasks.hunt.storage]
        kind = "dense"
        dtype = "float32"
        memory_limit = "1 GiB"
        """,
        set=["tasks.chase.budget={episodes = 8}", "tasks.hunt.eval_freq=50"],
    )
    curriculum = only(study)
    assert curriculum.setting("shaping", "hunt") == LookAheadAdvice(guard=Guard(min_share=0.2))
    assert curriculum.setting("evaluation", "hunt") == GreedyEvaluation("rollouts", 7, False)
    assert curriculum.setting("storage", "hunt") == Storage("dense", "float32", "1 GiB")
    assert curriculum.setting("budget", "chase") == Episodes(8)
    assert curriculum.setting("eval_freq", "hunt") == 50


@pytest.mark.parametrize(
    ("said", "made"),
    [
        ("'StateShaping'", StateShaping()),
        ("{ guard = true }", QInitialisation(guard=Guard())),
        ("{ guard = false }", QInitialisation()),
        (
            "{ type = 'DecayingAdvice', weight = { type = 'linear', first = 1, last = 0, steps = 9 } }",
            DecayingAdvice(weight=linear(1.0, 0.0, steps=9)),
        ),
    ],
)
def test_a_shaping_is_a_name_or_a_table(read, said, made):
    assert only(read(HUNT, set=[f"shaping={said}"])).setting("shaping", "hunt") == made


def test_an_arm_guards_the_shaping_of_the_study(read):
    arms = "[arms.plain]\n[arms.guarded]\nshaping.guard = true\n"
    study = read(HUNT.replace("[learner]", "shaping = 'LookAheadAdvice'\n[learner]") + arms)
    made = [study.curriculum(arm).setting("shaping", "hunt") for arm in ("plain", "guarded")]
    assert made == [LookAheadAdvice(), LookAheadAdvice(guard=Guard())]


def test_retraining_and_stopping_rules_are_those_described(read):
    study = read(
        HUNT,
        set=[
            "tasks.hunt.retrain={ drop = 3, steps = 500 }",
            "tasks.chase.budget={ max_steps = 5000, min_steps = 10, threshold = -3.5, when = 'all' }",
        ],
    )
    assert only(study).setting("retrain", "hunt") == RetrainSources(drop=3.0, steps=500)
    assert only(study).setting("budget", "chase") == StoppingRule(
        5000, min_steps=10, threshold=-3.5, when="all"
    )


@pytest.mark.parametrize(
    ("said", "made"),
    [("true", Calibrate()), ("false", None), ("{ shift = true }", Calibrate(shift=True))],
)
def test_calibration_may_be_a_flag(read, said, made):
    study = read(HUNT, set=[f"transfers.0.calibrate={said}", f"transfers.1.calibrate={said}"])
    assert only(study).calibration("hunt") == made


def test_what_is_built_learns_as_what_is_written_by_hand(read):
    study = read(HUNT)
    hunt, chase = Pursuit(3, 2), Pursuit(3, 1)
    by_hand = Curriculum(
        tasks={"chase": chase, "hunt": hunt},
        transfers=[
            Transfer("chase", "hunt", project(hunt, chase, predator=name), scale=2)
            for name in hunt.predator_names
        ],
        aggregate=minimum,
        learner=QLearning(learning_rate=0.2, epsilon=0.1),
        budget={"chase": 2_000, "hunt": 4_000},
    )
    assert study.seeds == (0, 1, 2, 3)
    (one, other) = (c.train(study.seeds)["hunt"] for c in (only(study), by_hand))
    np.testing.assert_array_equal(one.greedy_return, other.greedy_return)
    np.testing.assert_array_equal(one.values, other.values)


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
    assert only(study).setting("learner", "chase") == QLearning(0.2, 0.5)
    assert only(study).setting("learner", "hunt") == QLearning(0.2, 0.1)


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
    assert [a.setting("aggregate", "hunt") for a in arms.values()].count(minimum) == 4
    assert arms["mean"].setting("aggregate", "hunt") is mean
    assert [a.setting("budget", "chase") for a in arms.values()].count(2_000) == 4
    assert arms["long-chase"].setting("budget", "chase") == 9_000
    assert arms["long-chase"].setting("learner", "chase") == QLearning(0.2, 0.5)
    assert [len(a.transfers) for a in arms.values()] == [2, 2, 2, 1, 2]
    assert arms["one-source"].transfers[0].mapping.renaming == {"predator": "predator_2"}
    assert [t.scale for t in arms["scaled"].transfers] == [3, 2]
    assert len({id(a.tasks["hunt"]) for a in arms.values()}) == 1


def test_what_says_how_potentials_enter_is_of_tasks_with_sources_only(read):
    study = read(HUNT + "[arms.a]\n[arms.b]\naggregate = 'mean'\nshaping = 'StateShaping'")
    one, other = study.arms.values()
    assert one.tasks["chase"] == other.tasks["chase"]
    assert one.tasks["hunt"] != other.tasks["hunt"]


def test_an_arm_without_a_source_is_without_its_task(read):
    three = (
        HUNT
        + """
        [tasks.small]
        type = "pursuit"
        size = 2
        predators = 1
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
        [tasks.corner]
        type = "crop"
        of = "maze"
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


@pytest.mark.parametrize(
    ("base", "patch", "expected"),
    [
        ({"budget": 5}, {"budget": {"episodes": 3}}, {"budget": {"episodes": 3}}),
        ({"budget": {"episodes": 3}}, {"budget": {"max_steps": 9}}, {"budget": {"max_steps": 9}}),
        (
            {"budget": {"max_steps": 9, "threshold": 1}},
            {"budget": {"episodes": 3}},
            {"budget": {"episodes": 3}},
        ),
        (
            {"budget": {"max_steps": 9}},
            {"budget": {"threshold": 1}},
            {"budget": {"max_steps": 9, "threshold": 1}},
        ),
        ({"map": "S.T"}, {"file": "x.txt"}, {"file": "x.txt"}),
        ({"epsilon": 0.1}, {"inverse_temperature": 1}, {"inverse_temperature": 1}),
        (
            {"type": "pursuit", "size": 4, "budget": 9},
            {"type": "maze", "map": "S.T"},
            {"type": "maze", "map": "S.T", "budget": 9},
        ),
        (
            {"learner": {"type": "QLearning", "learning_rate": 0.3}},
            {"learner": {"type": "SARSA"}},
            {"learner": {"type": "SARSA", "learning_rate": 0.3}},
        ),
        ({"a": [1, 2]}, {"a": [3]}, {"a": [3]}),
    ],
)
def test_merging(base, patch, expected):
    assert merged(base, patch) == expected


TREES = st.recursive(
    st.integers(0, 3) | st.lists(st.integers(0, 3)),
    lambda inner: st.dictionaries(st.sampled_from("abcd"), inner, max_size=3),
    max_leaves=8,
)
TABLES = st.dictionaries(st.sampled_from("abcd"), TREES, max_size=4)


@given(TABLES, TABLES)
def test_merging_twice_is_merging_once_and_nothing_changes_nothing(one, other):
    assert merged(one, {}) == merged({}, one) == merged(one, one) == one
    assert merged(merged(one, other), other) == merged(one, other)


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


def test_an_arm_may_be_set(read):
    study = read(HUNT + '[arms."2 x"]\nbudget = 5', set=['arms."2 x".tasks.hunt.budget=70'])
    assert only(study, "2 x").setting("budget", "hunt") == 70


# The study.


def test_a_configuration_is_plain_data_and_comes_back_equal(read):
    study = read(
        HUNT
        + "[arms.a]\n[arms.b]\naggregate = 'mean'\n[arms.c]\nshaping.guard = { min_share = 0.2 }"
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
        shaping = "QInitialisation"
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
        [tasks.line]
        type = "maze"
        map = "ST"
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
            ["StateShaping", {"guard": True}, {"guard": {"min_share": 0.3}}]
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


# Functions of the user's own.

OWN = """
import numpy as np
import curricle as cr
from .rules import LONG

def line(length=LONG, treasure=200.0):
    return cr.GridWorld("S" + "." * (length - 2) + "T", rewards=cr.Rewards(treasure=treasure))

def flee(state):
    return np.tile([1.0, 0, 0, 0, 0], (len(state["prey"]), 1))

def second(potentials):
    return potentials[-1]

def halves(state, action):
    return {"row": state["row"], "column": state["column"] // 2}, action

def same(target, source):
    return cr.same_position(target, source, unmapped_value=-3)
"""
LINES = """
name = "lines"
aggregate = "own:second"
[tasks.short]
type = "factory"
factory = "own:line"
arguments = { length = 4, treasure = 3 }
[tasks.long]
type = "factory"
factory = "own:line"
[[transfers]]
source = "short"
target = "long"
function = "own:halves"
unmapped_value = -7
[[transfers]]
source = "short"
target = "long"
factory = "own:same"
"""


@pytest.fixture
def own(tmp_path):
    def write(folder, length):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / "own.py").write_text(OWN)
        (tmp_path / folder / "rules.py").write_text(f"LONG = {length}\n")
        return tmp_path / folder

    return write


def test_functions_are_found_beside_the_file(read, own):
    own(".", 8)
    before = list(sys.path)
    curriculum = only(read(LINES))
    assert sys.path == before
    assert curriculum.tasks["short"] == GridWorld("S..T", rewards=Rewards(treasure=3))
    assert curriculum.tasks["long"] == GridWorld("S......T")
    half, same = (transfer.mapping for transfer in curriculum.transfers)
    assert half.unmapped_value == -7
    assert half.index[:, 0].tolist() == [0, 0, 4, 4, 8, 8, -2, -2]
    assert same.unmapped_value == -3
    chosen = curriculum.setting("aggregate", "long")
    assert chosen(np.array([[[1.0]], [[2.0]]])) == 2


def test_modules_of_one_name_in_two_folders_stay_apart(read, own):
    own("a", 5), own("b", 6)
    one, other = read(LINES, name="a/study.toml"), read(LINES, name="b/study.toml")
    assert [only(study).tasks["long"].states.size for study in (one, other, one)] == [5, 6, 5]
    assert "own" not in sys.modules
    again = StudyConfig.from_data(one.to_data(), other.folder)
    assert only(again).tasks["long"].states.size == 6


def test_functions_are_found_on_the_path_too(tmp_path):
    assert load("curricle.transfer.aggregation:minimum", tmp_path) is minimum


def test_a_module_beside_the_file_comes_first(tmp_path):
    (tmp_path / "json.py").write_text("def dumps(): return 'mine'")
    assert load("json:dumps", tmp_path)() == "mine"
    assert json.dumps([]) == "[]"


def test_a_prey_may_be_a_function(read, own):
    own(".", 8)
    study = read("name='x'\ntasks.hunt={type='pursuit', size=2, prey='own:flee'}")
    probability = only(study).tasks["hunt"].mdp.probability
    assert (probability == [1, 0, 0, 0, 0]).all()


def test_other_mappings(read):
    words = MAZE + "[tasks.near]\ntype='crop'\nof='maze'\nrows=[0,3]\ncolumns=[0,5]\nstart='map'\n"
    edge = "[[transfers]]\nsource='near'\ntarget='maze'\n"
    maze = GridWorld(["....T", ".PPP.", "S...."])
    for name in ("identity", "same_position", "relative_objects"):
        curriculum = only(read(f"{words}{edge}mapping='{name}'"))
        expected = same_position(maze, maze).index
        np.testing.assert_array_equal(curriculum.transfers[0].mapping.index, expected)


# Gymnasium.

LAKE = """
name = "lake"
[tasks.lake]
type = "gymnasium"
id = "FrozenLake-v1"
arguments = { map_name = "4x4", is_slippery = false }
time_limit = 30
"""


def test_a_task_of_gymnasium_s(read):
    made = only(read(LAKE)).tasks["lake"]
    assert (made.states.size, made.actions.size) == (16, 4)


# The schema and the templates.


def test_the_schema_says_what_each_key_means():
    schema = json_schema()
    tables = [schema, *(one for one in schema["$defs"].values() if "properties" in one)]
    assert {"maze", "Transfer", "ArmPatch"} <= {table["title"] for table in tables}
    for table in tables:
        assert table["additionalProperties"] is False
        assert table["description"]
        for name, value in table["properties"].items():
            assert name == "type" or value["description"], (table["title"], name)
    assert set(schema["required"]) == {"name", "tasks"}
    json.dumps(schema)


@pytest.mark.parametrize("kind", KINDS)
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
