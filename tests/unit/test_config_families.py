"""Study files with task families and start states, for tasks of every type."""

import json

import numpy as np
import pytest

from curricle import GridWorld, Pursuit, project, solve
from curricle.errors import ConfigError
from curricle.planning import visit_distribution
from curricle.study import StudyConfig
from curricle.tasks import FourRooms, GoalDistance, maze_family, taxi_family, with_start
from tests.support.studies import reader

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

@task_family()
def lane(budget: int = 3):
    return GridWorld("S.T")

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


def test_members_are_tasks_and_a_familys_mappings_transfers_of_their_own(read_family):
    curriculum = read_family(HUNT).curriculum("transfer")
    settings = {"torus": True, "discount": 0.95}
    hunt, chase = Pursuit(3, 2, time_limit=None, **settings), Pursuit(3, 1, **settings)
    assert curriculum.tasks == {"chase": chase, "hunt": hunt}
    assert curriculum.setting("budget", "hunt") == 400
    assert [edge.scale for edge in curriculum.transfers] == [0.5, 0.5]
    for edge, name in zip(curriculum.transfers, hunt.predator_names, strict=True):
        assert (edge.mapping.index == project(hunt, chase, predator=name).index).all()


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
    assert tasks["maze"] == maze_family(size=6, seed=1).task  # all else has the family's defaults
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
[arms]
same = {}
small.tasks.chase.size = 2
walled.tasks.chase.torus = false
other.tasks.chase = { family = "maze", size = 3, seed = 1 }
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


def test_a_crop_of_what_is_no_maze_is_refused(read):
    hunt, crop = (
        '{ family = "pursuit" }',
        '{ type = "crop", of = "hunt", rows = [0, 2], columns = [0, 2] }',
    )
    text = f'name = "parts"\n[tasks]\nhunt = {hunt}\npart = {crop}'
    with pytest.raises(ConfigError, match="what a crop is a part of must be one of GridWorld, "):
        _ = read(text).curricula


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


def test_a_maze_starts_in_a_ring_that_an_arm_moves(read):
    study = read(f"{STARTS}\n[arms.near]\n[arms.far]\ntasks.near.start_states.distance = [2, 4]\n")
    again = StudyConfig.from_data(json.loads(json.dumps(study.to_data())), study.folder)
    assert again == study
    for arm, ring in (("near", (1, 3)), ("far", (2, 4))):
        tasks = again.curriculum(arm).tasks
        assert tasks == {"near": with_start(ROUGH, GoalDistance(*ring)), "maze": ROUGH}


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
    with pytest.raises(ConfigError, match="has no tables"):
        task_of(read, 'type = "gymnasium", id = "Blackjack-v1", start_states = "uniform"')
