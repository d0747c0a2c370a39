"""Study files: tables have the parameters of the library's classes, and build what they say."""

import inspect
from dataclasses import dataclass

import numpy as np
import pytest
from pydantic import ValidationError

import curricle as cr
from curricle.checks import number
from curricle.curriculum.node import SETTINGS
from curricle.errors import SettingError
from curricle.learning import (
    Learner,
    OptimisticQLearning,
    exponential,
    harmonic,
    linear,
)
from curricle.learning.schedules import Schedule
from curricle.learning.shaping import Shaping
from curricle.study.config import settings, tasks
from curricle.study.config.tables import table_of
from curricle.transfer import Calibrate, aggregation
from tests.studies import HUNT, MAZE, only
from tests.tasks import predator_edges


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
        (table_of(cr.Guard), cr.Guard()),
        (table_of(harmonic), harmonic()),
        (table_of(Calibrate), Calibrate()),
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
    given = set(inspect.signature(cr.Transfer).parameters) - {"mapping"}
    assert given == set(settings.TransferTable.parameters)
    assert set(inspect.signature(cr.GridWorld.crop).parameters) - {"self"} == (
        tasks.CropTask.model_fields.keys()
        - settings.Settings.model_fields.keys()
        - {"type", "of", "start_states"}
    )


def test_choices_are_those_of_the_library():
    def public(base):
        found = {one for each in base.__subclasses__() for one in (each, *each.__subclasses__())}
        ours = {one for one in found if one.__module__.startswith("curricle.")}
        return {one.__name__ for one in ours if ours.isdisjoint(one.__subclasses__())}

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
        (
            "size = 5\npredators = 3\nmoves = 4\ntorus = true\ncapture = 'any'\n"
            "step_reward = -2\ncapture_reward = 5\ndiscount = 1",
            cr.Pursuit(
                5,
                3,
                moves=4,
                torus=True,
                capture="any",
                step_reward=-2,
                capture_reward=5,
                discount=1,
            ),
        ),
        ("capture = 2\ntime_limit = 'none'", cr.Pursuit(capture=2, time_limit=None)),
        (
            "size = 2\nmoves = 4\nprey = [[1, 0, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]",
            cr.Pursuit(2, moves=4, prey=[[1, 0, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]),
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
    assert only(study).tasks["maze"] == cr.GridWorld(
        ["S.F", ".PT"],
        rewards=cr.Rewards(step=-5, pit=-100),
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


@pytest.mark.parametrize(
    ("table", "made"),
    [
        ("type = 'SARSA'\nepsilon = 0.3", cr.SARSA(epsilon=0.3)),
        (
            "learning_rate = { type = 'harmonic' }\n"
            "epsilon = { type = 'linear', first = 1, last = 0.1, steps = 1e3 }",
            cr.QLearning(learning_rate=harmonic(), epsilon=linear(1, 0.1, steps=1000)),
        ),
        (
            "type = 'DoubleQLearning'\n"
            "epsilon = { type = 'exponential', first = 1, half_life = 9.5 }",
            cr.DoubleQLearning(epsilon=exponential(1, half_life=9.5)),
        ),
        (
            "type = 'OptimisticQLearning'\nvalue_range = [-3, 2.5]\nlearning_rate = 0.5",
            OptimisticQLearning(value_range=(-3.0, 2.5), learning_rate=0.5),
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
        guard = { share_behind = 0.2 }
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
    assert curriculum.setting("shaping", "hunt") == cr.LookAheadAdvice(
        guard=cr.Guard(share_behind=0.2)
    )
    assert curriculum.setting("evaluation", "hunt") == cr.GreedyEvaluation("rollouts", 7, False)
    assert curriculum.setting("storage", "hunt") == cr.Storage("dense", "float32", "1 GiB")
    assert curriculum.setting("budget", "chase") == cr.Episodes(8)
    assert curriculum.setting("eval_freq", "hunt") == 50


@pytest.mark.parametrize(
    ("said", "made"),
    [
        ("'StateShaping'", cr.StateShaping()),
        ("{ guard = true }", cr.QInitialisation(guard=cr.Guard())),
        (
            "{ type = 'DecayingAdvice', weight = { type = 'harmonic', half = 9 } }",
            cr.DecayingAdvice(weight=harmonic(half=9)),
        ),
    ],
)
def test_a_shaping_is_a_name_or_a_table(read, said, made):
    assert only(read(HUNT, set=[f"shaping={said}"])).setting("shaping", "hunt") == made


def test_an_arm_guards_the_shaping_of_the_study(read):
    arms = "[arms.plain]\n[arms.guarded]\nshaping.guard = true\n"
    study = read(HUNT.replace("[learner]", "shaping = 'LookAheadAdvice'\n[learner]") + arms)
    made = [study.curriculum(arm).setting("shaping", "hunt") for arm in ("plain", "guarded")]
    assert made == [cr.LookAheadAdvice(), cr.LookAheadAdvice(guard=cr.Guard())]


def test_stopping_rules_are_those_described(read):
    study = read(
        HUNT,
        set=[
            "tasks.chase.budget={ max_steps = 5000, min_steps = 10, threshold = -3.5 }",
            "tasks.chase.budget.when=all",
        ],
    )
    assert only(study).setting("budget", "chase") == cr.StoppingRule(
        5000, min_steps=10, threshold=-3.5, when="all"
    )


@pytest.mark.parametrize(
    ("said", "made"),
    [("true", Calibrate()), ("false", None), ("{ max_steps = 5 }", Calibrate(max_steps=5))],
)
def test_calibration_may_be_a_flag(read, said, made):
    study = read(HUNT, set=[f"transfers.0.calibrate={said}", f"transfers.1.calibrate={said}"])
    assert only(study).calibration("hunt") == made


def test_what_is_built_learns_as_what_is_written_by_hand(read):
    study = read(HUNT)
    hunt, chase = cr.Pursuit(3, 2), cr.Pursuit(3, 1)
    by_hand = cr.Curriculum(
        tasks={"chase": chase, "hunt": hunt},
        transfers=predator_edges(hunt, chase, scale=2),
        aggregate=cr.minimum,
        learner=cr.QLearning(learning_rate=0.2, epsilon=0.1),
        budget={"chase": 2_000, "hunt": 4_000},
    )
    assert study.seeds == (0, 1, 2, 3)
    (one, other) = (c.train(study.seeds)["hunt"] for c in (only(study), by_hand))
    np.testing.assert_array_equal(one.greedy_return, other.greedy_return)
    np.testing.assert_array_equal(one.values, other.values)
