"""Study files with task families and start states, for tasks of every type."""

import json

import numpy as np
import pytest

from curricle import GridWorld, Pursuit, project, run_study, solve
from curricle.errors import ConfigError
from curricle.planning import visit_distribution
from curricle.study import StudyConfig
from curricle.study_file.task_tables import BUILT_IN
from curricle.tasks import FourRooms, GoalDistance, maze_family, taxi_family, with_start
from tests.support.studies import OBSERVED_HUNT, reader

NAMES = ", ".join(BUILT_IN)
HUNT = """\
name = "hunt"
seeds = 2
budget = 300
aggregate = "minimum"

[tasks.chase]
family = "pursuit"
size = 3
predators = 1
torus = true
discount = 0.95

[tasks.hunt]
family = "pursuit"
size = 3
predators = 2
torus = true
discount = 0.95
time_limit = "none"
budget = 400

[[transfers]]
source = "chase"
target = "hunt"
mapping = "family"
scale = 0.5
"""
OWN_FAMILY = """
from curricle import GridWorld
from curricle.transfer import same_position
from typing import Annotated
from curricle.tasks import Rule, task_family

def by_cells(target, source):
    return [same_position(target.task, source.task)]

@task_family(mapping=by_cells)
def corridor(
    length: Annotated[int, Rule(2, 9, "larger")], treasure: float = 200.0, limit: int | None = 50
):
    if treasure == 13:
        raise RuntimeError("no luck")
    return GridWorld("S" + "." * (length - 2) + "T", time_limit=limit)

plain = len
"""
LANES = """\
name = "lanes"
seeds = 2
budget = 300

[tasks]
short = { family = "own:corridor", length = 4 }
long = { family = "own:corridor", length = 8, limit = "none" }

[[transfers]]
source = "short"
target = "long"
mapping = "family"
"""


@pytest.fixture
def read_family(tmp_path):
    (tmp_path / "own.py").write_text(OWN_FAMILY)
    return reader(tmp_path)


def test_members_are_tasks(read_family):
    curriculum = read_family(HUNT).curriculum("transfer")
    settings = {"torus": True, "discount": 0.95}
    assert curriculum.tasks["chase"] == Pursuit(3, 1, **settings)
    assert curriculum.tasks["hunt"] == Pursuit(3, 2, time_limit=None, **settings)
    assert curriculum.setting("budget", "hunt") == 400


def test_a_familys_mappings_are_transfers_of_their_own(read_family):
    curriculum = read_family(HUNT).curriculum("transfer")
    hunt, chase = curriculum.tasks["hunt"], curriculum.tasks["chase"]
    assert [edge.scale for edge in curriculum.transfers] == [0.5, 0.5]
    for edge, name in zip(curriculum.transfers, hunt.predator_names, strict=True):
        assert (edge.mapping.index == project(hunt, chase, predator=name).index).all()


def test_parameters_left_out_have_the_familys_defaults(read_family):
    text = 'name = "maze"\n[tasks]\nmaze = { family = "maze", size = 4.0, seed = 2 }'
    assert (
        read_family(text).curriculum("transfer").tasks["maze"] == maze_family(size=4, seed=2).task
    )


def test_a_family_of_ones_own(read_family):
    curriculum = read_family(LANES).curriculum("transfer")
    assert curriculum.tasks["long"] == GridWorld("S......T", time_limit=None)
    (edge,) = curriculum.transfers
    assert edge.mapping.coverage().mapped > 0.3
    assert curriculum.tasks["short"] == GridWorld("S..T", time_limit=50)


def test_a_crop_of_a_familys_maze(read_family):
    text = """
        name = "parts"
        budget = 100
        [tasks]
        maze = { family = "maze", size = 6, seed = 1 }
        part = { type = "crop", of = "maze", rows = [0, 3], columns = [-2, 1] }
        [[transfers]]
        source = "part"
        target = "maze"
        mapping = "same_position"
    """
    tasks = read_family(text).curriculum("transfer").tasks
    assert tasks["part"] == maze_family(size=3, seed=1, start="uniform").task


@pytest.mark.parametrize("text", [HUNT, LANES])
def test_plain_data_hold_every_parameter(read_family, text):
    study = read_family(text)
    plain = json.loads(json.dumps(study.to_data()))
    again = StudyConfig.from_data(plain, study.folder)
    assert again == study
    first, second = (config.curriculum("transfer").tasks for config in (again, study))
    assert list(first.values()) == list(second.values())
    task = plain["arms"]["transfer"]["tasks"].get("hunt")
    if task:
        assert (task["family"], task["moves"], task["time_limit"]) == ("pursuit", 5, "none")


def test_arms_change_parameters_and_families(read_family):
    text = (
        HUNT
        + """
[arms.same]
[arms.small]
tasks.chase.size = 2
[arms.walled]
tasks.chase.torus = false
[arms.other]
tasks.chase = { family = "maze", size = 3, seed = 1 }
[arms.maze]
tasks.chase = { type = "maze", map = "S.T" }
transfers = [{ source = "chase", target = "hunt", factory = "own:by_cells" }]
"""
    )
    study = read_family(text)
    tasks = {arm: study.arms[arm].tasks["chase"] for arm in study.arms}
    members = {
        arm: str(table.member(study.folder)) for arm, table in tasks.items() if arm != "maze"
    }
    assert members == {
        "same": "pursuit(size=3, predators=1, torus=True, discount=0.95)",
        "small": "pursuit(size=2, predators=1, torus=True, discount=0.95)",
        "walled": "pursuit(size=3, predators=1, discount=0.95)",
        "other": "maze(size=3, seed=1)",
    }
    assert tasks["maze"].type == "maze"
    assert len(study.curriculum("small").transfers) == 2


def test_a_study_of_families_runs(read_family, tmp_path):
    results = run_study(read_family(HUNT), tmp_path / "results")
    assert len(results.record.arms["transfer"].transfers) == 2


def test_a_crop_of_what_is_no_maze_is_refused(read_family):
    text = HUNT.replace('mapping = "family"', "project = {}").replace(
        'family = "pursuit"\nsize = 3\npredators = 1\ntorus = true\ndiscount = 0.95',
        'type = "crop"\nof = "hunt"\nrows = [0, 2]\ncolumns = [0, 2]',
    )
    with pytest.raises(ConfigError, match="what a crop is a part of must be one of GridWorld, "):
        _ = read_family(text).curricula


# -- start states ----------------------------------------------------------------------

STARTS = """\
name = "starts"
seeds = 2
budget = 300

[tasks.near]
type = "maze"
map = '''
S..P
..#T
....
'''
start_states = { distance = [1, 3] }

[tasks.maze]
type = "maze"
map = '''
S..P
..#T
....
'''

[[transfers]]
source = "near"
target = "maze"
mapping = "same_position"
"""
ROUGH = GridWorld(["S..P", "..#T", "...."])


def task_of(read, text):
    (made,) = (
        read(f'name = "one"\n[tasks]\none = {{ {text} }}').curriculum("transfer").tasks.values()
    )
    return made


def test_a_maze_starts_in_a_ring(read):
    study = read(STARTS)
    tasks = study.curriculum("transfer").tasks
    assert tasks["near"] == with_start(ROUGH, GoalDistance(1, 3))
    assert tasks["maze"] == ROUGH
    again = StudyConfig.from_data(json.loads(json.dumps(study.to_data())), study.folder)
    assert again == study
    assert again.curriculum("transfer").tasks["near"] == tasks["near"]


ROOMS = FourRooms(9)
STARTED = [
    ('"pursuit", size = 3, predators = 1', "{ distance = 2 }", (Pursuit(3, 1), GoalDistance(2))),
    ('"family", family = "taxi", size = 3', '"reachable"', (taxi_family(size=3).task, "reachable")),
    ('"four_rooms", size = 9', '{ visits = "random" }', (ROOMS, visit_distribution(ROOMS))),
    (
        '"four_rooms", size = 9',
        '{ visits = "optimal" }',
        (ROOMS, visit_distribution(ROOMS, solve(ROOMS).policy)),
    ),
    (
        '"four_rooms", size = 9',
        "{ distance = 1, goal = { row = 5, column = [1, 2] } }",
        (ROOMS, GoalDistance(1, 1, {"row": 5, "column": [1, 2]})),
    ),
    ('"four_rooms"', '"uniform"', (FourRooms(), "uniform")),
]


@pytest.mark.parametrize(("kind", "said", "expected"), STARTED)
def test_tasks_of_every_type_start_where_they_are_told(read, kind, said, expected):
    assert task_of(read, f"type = {kind}, start_states = {said}") == with_start(*expected)


def test_tables_of_gymnasium_start_in_a_ring(read):
    text = 'type = "gymnasium", id = "FrozenLake-v1", start_states = { distance = [1, 2] }'
    assert np.flatnonzero(task_of(read, text).start).tolist() == [10, 13, 14]


def test_rings_are_a_curriculum(read, tmp_path):
    """An arm moves the ring, and the study runs."""
    text = STARTS + "\n[arms.near]\n[arms.far]\ntasks.near.start_states.distance = [2, 4]\n"
    study = read(text)
    starts = [study.curriculum(arm).tasks["near"].start for arm in ("near", "far")]
    assert starts[0] != starts[1]
    run_study(study, tmp_path / "results")


def test_tasks_without_tables_are_refused(read, complaints):
    text = OBSERVED_HUNT.replace(
        'type = "observation_task"', 'type = "observation_task"\nstart_states = "uniform"'
    )
    lines = complaints(text)
    assert any("tasks.hunt.start_states must be left out for hunt" in line for line in lines)
    live = 'type = "gymnasium", id = "Blackjack-v1", start_states = "uniform"'
    with pytest.raises(ConfigError, match="has no tables"):
        task_of(read, live)


def test_a_family_whose_parameter_is_a_key_of_tasks_is_refused(read, tmp_path):
    (tmp_path / "own.py").write_text(
        "from curricle import GridWorld\n"
        "from curricle.tasks import task_family\n"
        "@task_family()\n"
        "def lane(budget: int = 3):\n"
        "    return GridWorld('S.T')\n"
    )
    with pytest.raises(ConfigError, match="own:lane has the parameter budget, which is a key of"):
        task_of(read, 'family = "own:lane"')
