"""Study files: tables have the parameters of the library's classes, and build what they say."""

import inspect
from dataclasses import dataclass

import pytest
from pydantic import ValidationError

import curricle as cr
from curricle.checks import number
from curricle.curriculum.curriculum import SETTINGS
from curricle.errors import SettingError
from curricle.learning import (
    Learner,
    OptimisticQLearning,
    harmonic,
    linear,
)
from curricle.learning.schedules import Schedule
from curricle.learning.shaping import Shaping
from curricle.study_file import schema as settings, task_tables as tasks
from curricle.study_file.schema import table_of
from curricle.transfer import aggregate as aggregation
from tests.support.studies import HUNT, MAZE, only


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
    for which, value in SETTINGS.items():  # an unknown_value that is stated counts as given
        assert defaults.setting(which, tmp_path) == (None if which == "unknown_value" else value)
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
        MAZE
        + """
        [tasks.corner]
        type = "crop"
        of = "right"
        rows = [0, 2]
        columns = [3, 5]
        start = [[1, 4]]
        [tasks]
        right = { type = "crop", of = "maze", rows = [0, 3], columns = [2, 5] }
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
    assert only(read(f"name = 'x'\n[tasks.it]\n{table}")).tasks["it"] == made


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
    assert only(read(HUNT, set=[f"{key}={value}"])).setting(key.split(".")[-1], "hunt") == made


def test_an_arm_guards_the_shaping_of_the_study(read):
    arms = "[arms.plain]\n[arms.guarded]\nshaping.portfolio = true\n"
    study = read(HUNT.replace("[learner]", "shaping = 'LookAheadAdvice'\n[learner]") + arms)
    made = [study.curriculum(arm).setting("shaping", "hunt") for arm in ("plain", "guarded")]
    assert made == [cr.LookAheadAdvice(), cr.LookAheadAdvice(portfolio=cr.Portfolio())]
