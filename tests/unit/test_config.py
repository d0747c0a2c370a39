"""Study files: what their tables may say and build, seeds, settings, arms, and what is set."""

import inspect
import json
import re
from pathlib import Path

import pytest

import curricle as cr
from curricle import GridWorld
from curricle.curriculum.curriculum import SETTINGS
from curricle.errors import ConfigError
from curricle.learning import Learner, OptimisticQLearning, RMax, harmonic, linear
from curricle.learning.shaping import Shaping
from curricle.study import StudyConfig, read_study
from curricle.study.config import json_schema
from curricle.study.templates import KINDS, template
from curricle.study_file import schema as settings, task_tables as tasks
from curricle.study_file.file import merged
from curricle.study_file.schema import table_of
from curricle.transfer import aggregate as aggregation
from tests.support.studies import CORNER, HUNT, MAZE, again, only


@pytest.mark.parametrize(
    ("table", "made"),
    [
        (settings.LEARNERS[0], cr.QLearning()),
        (settings.EvaluationTable, cr.GreedyEvaluation()),
        (settings.StorageTable, cr.Storage()),
        (settings.SHAPINGS[0], cr.QInitialisation()),
        (table_of(cr.Portfolio), cr.Portfolio()),
        (table_of(harmonic), harmonic()),
        (tasks.PursuitTask, cr.Pursuit()),
    ],
)
def test_defaults_are_those_of_what_is_built(table, made):
    assert table().build() == made


def test_settings_and_transfers_are_those_of_a_curriculum(tmp_path):
    assert set(settings.Settings.model_fields) == set(SETTINGS)
    defaults = settings.Settings()
    for which, value in SETTINGS.items():
        assert defaults.setting(which, tmp_path) == value
    parameters = set(inspect.signature(cr.Transfer).parameters) - {"mapping"}
    assert parameters == set(settings.TransferTable.parameters)
    assert set(inspect.signature(cr.GridWorld.crop).parameters) - {"self"} == (
        tasks.CropTask.model_fields.keys()
        - settings.Settings.model_fields.keys()
        - {"type", "of", "start_states"}
    )


def test_choices_are_those_of_the_library():
    def public(base):
        derived, kinds = [base], set()
        while derived:
            more = derived.pop().__subclasses__()
            derived += more
            kinds |= {kind for kind in more if kind.__module__.startswith("curricle.")}
        # ShapingReward is for certify: no learner takes it.
        used = {
            kind for kind in kinds if base is not Shaping or kind.for_tables or kind.for_networks
        }
        return {kind.__name__ for kind in used if used.isdisjoint(kind.__subclasses__())}

    assert {kind.makes.__name__ for kind in settings.LEARNERS} == public(Learner)
    assert {kind.makes.__name__ for kind in settings.SHAPINGS} == public(Shaping)
    assert set(settings.AGGREGATES) == {
        name
        for name, function in vars(aggregation).items()
        if inspect.isfunction(function)
        and list(inspect.signature(function).parameters) == ["potentials"]
    }


def test_a_crop_is_a_part_of_another_task_and_of_a_part(read):
    study = read(
        """
        name = "crops"
        [tasks]
        corner = { type = "crop", of = "right", rows = [0, 2], columns = [3, 5], start = [[1, 4]] }
        right = { type = "crop", of = "maze", rows = [0, 3], columns = [2, 5] }
        maze = { type = "maze", map = "....T\\n.PPP.\\nS...." }
        [arms.only]
        transfers = [
            { source = "corner", target = "right", mapping = "same_position" },
            { source = "right", target = "maze", mapping = "same_position" },
        ]
        """
    )
    made = only(study, "only").tasks
    maze = cr.GridWorld(["....T", ".PPP.", "S...."])
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


# -- what a file says is built ---------------------------------------------------------------------

SETTINGS_OF_HUNT = """
torus = true
size = 5
predators = 3
moves = 4
capture = "any"
step_reward = -2
capture_reward = 5
discount = 1
"""


@pytest.mark.parametrize(
    ("table", "made"),
    [
        (
            f"type = 'pursuit'{SETTINGS_OF_HUNT}",
            cr.Pursuit(5, 3, 4, True, "any", step_reward=-2, capture_reward=5, discount=1),
        ),
        (
            "type = 'pursuit'\ncapture = 2\ntime_limit = 'none'",
            cr.Pursuit(capture=2, time_limit=None),
        ),
        (
            "type = 'maze'\nmap = \"S.F\\n.PT\"\nrewards = { step = -5, pit = -100.0 }\n"
            "combine = 'worst'\nends = ['treasure']\nstart = [[4, 4], [3, 4]]\norigin = [3, 4]\n"
            "representation = 'relative'\ndiscount = 0.9\ntime_limit = 50",
            cr.GridWorld(
                ["S.F", ".PT"],
                rewards=cr.Rewards(step=-5, pit=-100),
                combine="worst",
                ends=("treasure",),
                start=[(4, 4), (3, 4)],
                representation="relative",
                origin=(3, 4),
                discount=0.9,
                time_limit=50,
            ),
        ),
        (
            "type = 'maze'\nmap = \"@ O\\nG..\"\n"
            "legend = { '@' = 'start', ' ' = 'free', O = 'pit', G = 'treasure' }",
            cr.GridWorld(["S.P", "T.."]),
        ),
        ("type = 'maze'\nmap = 'SFHG'\nlegend = 'frozen_lake'", cr.GridWorld("S.PT")),
    ],
)
def test_a_task_is_the_one_described(read, table, made):
    study = read(f"name = 'x'\n[tasks.it]\n{table}")
    assert only(study).tasks["it"] == made
    assert again(study) == study


LEARNER = "tasks.hunt.learner"
STORAGE = cr.Storage(dtype="float32", memory_limit="1 GiB")
FALLING = "{ type = 'linear', first = 1, last = 0, steps = 1e3 }"
SAID = [
    (LEARNER, "{ type = 'SARSA', epsilon = 0.3 }", cr.SARSA(0.2, 0.3)),
    (LEARNER, f"{{ epsilon = {FALLING} }}", cr.QLearning(0.2, linear(1, 0, steps=1000))),
    (LEARNER, "{ learning_rate = { type = 'harmonic' } }", cr.QLearning(harmonic(), 0.1)),
    (
        LEARNER,
        "{ type = 'OptimisticQLearning', value_range = [-3, 2.5], learning_rate = 0.5 }",
        OptimisticQLearning(value_range=(-3.0, 2.5), learning_rate=0.5, epsilon=0.1),
    ),
    (LEARNER, "{ type = 'RMax', min_visits = 5 }", RMax(min_visits=5, epsilon=0.1)),
    ("shaping", "{ portfolio = true }", cr.QInitialisation(portfolio=cr.Portfolio())),
    ("storage", "{ dtype = 'float32', memory_limit = '1 GiB' }", STORAGE),
    ("tasks.hunt.budget", "{ episodes = 8 }", cr.Episodes(8)),
    (
        "tasks.hunt.budget",
        "{ max_steps = 5000, min_steps = 10, threshold = -3.5 }",
        cr.StoppingRule(5000, min_steps=10, threshold=-3.5),
    ),
]


@pytest.mark.parametrize(("key", "value", "made"), SAID)
def test_a_setting_is_the_one_described(read, key, value, made):
    study = read(HUNT, set=[f"{key}={value}"])
    assert only(study).setting(key.split(".")[-1], "hunt") == made
    assert again(study) == study


def test_an_arm_guards_the_shaping_of_the_study(read):
    arms = "[arms.plain]\n[arms.guarded]\nshaping.portfolio = true\n"
    study = read(HUNT.replace("[learner]", "shaping = 'LookAheadAdvice'\n[learner]") + arms)
    made = [study.curriculum(arm).setting("shaping", "hunt") for arm in ("plain", "guarded")]
    assert made == [cr.LookAheadAdvice(), cr.LookAheadAdvice(portfolio=cr.Portfolio())]


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


def test_an_arm_changes_what_it_says_and_nothing_else(read):
    study = read(
        HUNT
        + """
        [arms]
        minimum = {}
        mean.aggregate = "mean"
        long-chase.tasks.chase = { budget = 9_000, learner.epsilon = 0.5 }
        one-source.transfers = [1]
        scaled.transfers.0.scale = 3
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


def test_an_arm_without_a_source_is_without_its_task(read):
    more = """
        [tasks]
        small = { type = "pursuit", size = 2, predators = 1 }
        [[transfers]]
        source = "small"
        target = "chase"
        project = {}
        [arms]
        three = {}
        two.transfers = [0, 1]
        other.transfers = [{ source = "small", target = "hunt", project.predator = "predator_1" }]
    """
    arms = read(HUNT + more).curricula
    assert {name: set(arm.tasks) for name, arm in arms.items()} == {
        "three": {"small", "chase", "hunt"},
        "two": {"chase", "hunt"},
        "other": {"small", "hunt"},
    }


def test_arms_may_fill_in_what_the_study_leaves_open(read):
    text = CORNER.replace("rows = [0, 2]\ncolumns = [2, 5]\n", "")
    small = "small.tasks.corner = { rows = [0, 1], columns = [3, 5] }"
    large = "large.tasks.corner = { rows = [0, 2], columns = [2, 5] }"
    study = read(f"{text}\n[arms]\n{small}\n{large}\n")
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
    ({"learner": PLAIN}, {"learner": {"type": "RMax"}}, {"learner": {"type": "RMax"}}),
    (  # the keys of a maker's arguments are its own
        {"arguments": {"type": "ice", "map": "m", "size": {"type": 1, "rows": 2}}},
        {"arguments": {"type": "snow", "file": "f", "size": {"type": 2}}},
        {"arguments": {"type": "snow", "map": "m", "file": "f", "size": {"type": 2, "rows": 2}}},
    ),
]


@pytest.mark.parametrize(("base", "patch", "expected"), MERGED)
def test_merging(base, patch, expected):
    assert merged(base, patch) == expected


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
        learner = { type = "QLearning", learning_rate = 0.2, epsilon = 0.1 }
        tasks.hunt = { type = "pursuit", size = 3, moves = 5, aggregate = "minimum", budget = 4e3 }
        tasks.chase = { type = "pursuit", size = 3, predators = 1, budget = 2000 }
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
    elsewhere = StudyConfig.from_data(by_file.to_data(), Path("elsewhere"))
    assert only(elsewhere).tasks["maze"] == GridWorld(["....T", ".PPP.", "S...."])


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


@pytest.mark.parametrize(
    "line",
    [
        "scratch = false",
        "compared = false",
        "choose = true",
        "tune.space = { 'learner.learning_rate' = [0.1, 0.5] }",
    ],
)
def test_compare_refuses_a_study_of_which_it_would_leave_something_out(read, line):
    with pytest.raises(ConfigError, match=r"compare would leave out .*run_study\(study, FOLDER\)"):
        cr.compare(read(f"{line}\n{MAZE}"))


def test_a_task_that_leads_nowhere_is_told_of_its_transfer(read):
    stages = "".join(f'[tasks.{name}]\ntype = "maze"\nmap = "S.T"\n' for name in ("small", "large"))
    with pytest.raises(ConfigError, match=r"got small, large; a transfer .* may be missing"):
        _ = read(f'name = "stages"\nbudget = 9\n{stages}').curricula
