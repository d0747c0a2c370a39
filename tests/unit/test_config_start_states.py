"""Start states in study files, for tasks of every type."""

import json

import numpy as np
import pytest

from curricle import GridWorld, Pursuit, run_study, solve
from curricle.errors import ConfigError
from curricle.planning import visit_distribution
from curricle.study import StudyConfig
from curricle.tasks import FourRooms, GoalDistance, taxi_family, with_start
from tests.studies import OBSERVED_HUNT

STUDY = """\
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
MAZE = GridWorld(["S..P", "..#T", "...."])


def task(read, text):
    (made,) = (
        read(f'name = "one"\n[tasks]\none = {{ {text} }}').curriculum("transfer").tasks.values()
    )
    return made


def test_a_maze_starts_in_a_ring(read):
    study = read(STUDY)
    tasks = study.curriculum("transfer").tasks
    assert tasks["near"] == with_start(MAZE, GoalDistance(1, 3))
    assert tasks["maze"] == MAZE
    again = StudyConfig.from_data(json.loads(json.dumps(study.to_data())), study.folder)
    assert again == study
    assert again.curriculum("transfer").tasks["near"] == tasks["near"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            'type = "pursuit", size = 3, predators = 1, start_states = { distance = 2 }',
            with_start(Pursuit(3, 1), GoalDistance(2)),
        ),
        (
            'family = "taxi", size = 3, start_states = "reachable"',
            with_start(taxi_family(size=3).task, "reachable"),
        ),
        (
            'type = "four_rooms", size = 9, start_states = { visits = "random" }',
            with_start(FourRooms(9), visit_distribution(FourRooms(9))),
        ),
        (
            'type = "four_rooms", size = 9, start_states = { visits = "optimal" }',
            with_start(FourRooms(9), visit_distribution(FourRooms(9), solve(FourRooms(9)).policy)),
        ),
        (
            'type = "four_rooms", size = 9, start_states = { distance = 1, goal = { row = 5, '
            "column = [1, 2] } }",
            with_start(FourRooms(9), GoalDistance(1, 1, {"row": 5, "column": [1, 2]})),
        ),
        ('type = "four_rooms", start_states = "uniform"', FourRooms(start="uniform")),
    ],
)
def test_tasks_of_every_type_start_where_they_are_told(read, text, expected):
    assert task(read, text) == expected


def test_tables_of_gymnasium_start_in_a_ring(read):
    text = 'type = "gymnasium", id = "FrozenLake-v1", start_states = { distance = [1, 2] }'
    assert np.flatnonzero(task(read, text).start).tolist() == [10, 13, 14]


def test_a_crop_of_a_task_that_starts_elsewhere(read):
    text = """
        name = "parts"
        budget = 100
        [tasks.rooms]
        type = "four_rooms"
        start_states = { distance = 1 }
        [tasks.room]
        type = "crop"
        of = "rooms"
        rows = [7, 12]
        columns = [7, 12]
        start_states = { distance = [1, 2] }
        [[transfers]]
        source = "room"
        target = "rooms"
        project = {}
    """
    tasks = read(text).curriculum("transfer").tasks
    room = FourRooms().crop(rows=(7, 12), columns=(7, 12))
    assert tasks["room"] == with_start(room, GoalDistance(1, 2))


def test_rings_are_a_curriculum(read, tmp_path):
    """An arm moves the ring, and the study runs."""
    text = STUDY + "\n[arms.near]\n[arms.far]\ntasks.near.start_states.distance = [2, 4]\n"
    study = read(text)
    starts = [study.curriculum(arm).tasks["near"].start for arm in ("near", "far")]
    assert starts[0] != starts[1]
    run_study(study, tmp_path / "results")


@pytest.mark.parametrize(
    ("new", "sentence"),
    [
        ('"reachble"', "line 12: tasks.near.start_states must be 'uniform', 'reachable', or a"),
        ("{ distance = [1, 2, 3] }", "line 12: tasks.near.start_states.distance must be a number"),
        ("{ distance = [3, 1] }", "line 12: tasks.near.start_states.distance must be steps from"),
        ("{}", "line 12: tasks.near.start_states must have distance or visits: got neither"),
        ('{ visits = "random", goal = { row = 1 } }', "line 12: tasks.near.start_states has a"),
    ],
)
def test_a_mistake_is_one_sentence_with_its_place(complaints, new, sentence):
    assert any(sentence in line for line in complaints(STUDY, ("{ distance = [1, 3] }", new)))


def test_tasks_without_tables_are_refused(read, complaints):
    text = OBSERVED_HUNT.replace(
        'type = "observation_task"', 'type = "observation_task"\nstart_states = "uniform"'
    )
    found = complaints(text)
    assert any("tasks.hunt.start_states must be left out for hunt" in one for one in found)
    live = 'type = "gymnasium", id = "Blackjack-v1", start_states = "uniform"'
    with pytest.raises(ConfigError, match="has no tables"):
        task(read, live)


def test_a_family_whose_parameter_is_a_key_of_tasks_is_refused(read, tmp_path):
    (tmp_path / "own.py").write_text(
        "from curricle import GridWorld\n"
        "from curricle.tasks import task_family\n"
        "@task_family()\n"
        "def lane(budget: int = 3):\n"
        "    return GridWorld('S.T')\n"
    )
    with pytest.raises(ConfigError, match="own:lane has the parameter budget, which is a key of"):
        task(read, 'family = "own:lane"')
