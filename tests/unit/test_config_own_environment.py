"""Gymnasium classes and functions of the user's own, in a study file."""

import numpy as np
import pytest

import curricle as cr
from curricle.study import StudyConfig
from tests.studies import complaints_of, only, reader

OWN = """
import gymnasium as gym
import numpy as np
from gymnasium import spaces


class Room(gym.Env):
    def __init__(self, size=3, discount=None):
        self.size, self.discount = size, discount
        self.observation_space = spaces.MultiDiscrete([size, 4])
        self.action_space = spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place = 0
        return self._seen(), {}

    def step(self, action):
        self.place = min(self.place + action, 4 * self.size - 1)
        return self._seen(), float(action), self.place == 4 * self.size - 1, False, {}

    def _seen(self):
        return np.array(divmod(self.place, 4))


def numbered(size=3):
    return Numbered(Room(size))


class Numbered(gym.ObservationWrapper):
    def __init__(self, env):
        super().__init__(env)
        self.observation_space = spaces.Discrete(4 * env.size)

    def observation(self, observation):
        return int(observation @ [4, 1])


def seen(room):
    return gym.wrappers.FlattenObservation(room)
"""
STUDY = """
name = "rooms"
budget = 300

[tasks]
room = { type = "gymnasium", factory = "own:Room", names = ["row", "column"], time_limit = 20 }
"""
ROOM = STUDY.splitlines()[-1]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "own.py").write_text(OWN, "utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def built(folder):
    """The task of the study in which a line stands for the room."""

    def task(line=ROOM):
        study = reader(folder)(STUDY.replace(ROOM, line))
        again = StudyConfig.from_data(study.to_data(), folder)
        assert again.to_data() == study.to_data()
        return only(again, *again.arms).tasks["room"]

    return task


def test_a_class_of_ones_own_is_a_task_with_named_components(built):
    task = built()
    assert repr(task) == "LiveMDP(12 states, 2 actions, discount 0.99, time limit 20)"
    assert task.states.names == ("row", "column")
    walked = cr.planning.rollout(task, np.ones(12, int))
    assert walked.states.tolist() == [*range(12)]


def test_a_class_takes_arguments_of_any_name(built):
    task = built('room = { type = "gymnasium", factory = "own:Room", actions = ["stay", "east"], '
                 'arguments = { size = 5, discount = 3 } }')  # fmt: skip
    assert (task.states.size, task.discount, task.make().discount) == (20, 0.99, 3)
    assert task.actions.label(1) == "action=east"


def test_a_function_of_ones_own_and_one_number_split(built):
    task = built('room = { type = "gymnasium", factory = "own:numbered", '
                 'names = ["row", "column"], sizes = [3, 4], time_limit = "none" }')  # fmt: skip
    assert task.states.label(7) == "row=1 column=3"
    assert task.time_limit is None


def test_ids_have_names_and_limits_too(built):
    lake = built('room = { type = "gymnasium", id = "FrozenLake-v1", names = ["y", "x"], '
                 'arguments = { map_name = "8x8" }, time_limit = 9 }')  # fmt: skip
    assert (lake.states.names, lake.states.size, lake.time_limit) == (("y", "x"), 64, 9)


def test_tables_and_networks_take_a_class_too(built):
    line = ROOM.replace('"gymnasium"', '"tabulated"')
    task = built(
        line.replace('"row", "column"', '"where"').replace("}", ', actions = ["no", "go"]}')
    )
    assert task.actions.label(1) == "action=go"
    assert task.states.label(task.state(np.array([1, 3]))) == "where=7"
    observed = ('room = { type = "observation_task", factory = "own:Room", encode = "own:seen", '
                'learner = { type = "deep" } }')  # fmt: skip
    seen = built(observed)
    assert seen.observations.shape == (7,)
    assert str(seen.make) == "own:Room(encode=own:seen)"  # as the file names them


MISTAKES = [
    ('factory = "own:Room"', 'id = "own:Room"', "; a class or function of your own is named by"),
    ('factory = "own:Room"', 'id = "a", factory = "own:Room"', "id or factory: got both"),
    ("own:Room", "owm:Room", "owm is neither beside the study file nor on Python's"),
    ("own:Room", "own:Rom", "own has no Rom to call, did you mean 'Room'?"),
    ("time_limit", "arguments = { sise = 3 }, time_limit", "own:Room failed: TypeError:"),
    (', "column"', "", "in the order of state_1, state_2: got 1, row"),
    ('["row", "column"]', '"row"', "tasks.room.names must be a list: got 'row'"),
    ('"column"', '""', "tasks.room.names[1] must have 1 to 100 characters: got ''"),
    ("names", "nmaes", "tasks.room.nmaes is unknown, did you mean 'names'?"),
]


@pytest.mark.parametrize(("old", "new", "sentence"), MISTAKES)
def test_a_mistake_is_one_sentence(folder, old, new, sentence):
    (said,) = complaints_of(STUDY, (old, new))
    assert said.startswith("line 6: ")
    assert sentence in said


PAIR = STUDY + """
small = { type = "gymnasium", factory = "own:Room", arguments = { size = 2 }, names = ["row", "x"] }
[[transfers]]
source = "small"
target = "room"
project = { x = "column" }
"""  # fmt: skip


def test_components_are_mapped_by_their_names(folder):
    curriculum = only(reader(folder)(PAIR), "transfer")
    assert (
        repr(curriculum.transfers[0].mapping)
        == "ComponentMapping(row=row, x=column, action=action)"
    )


def test_identity_by_name(folder):
    text = PAIR.replace('project = { x = "column" }', 'mapping = "identity"')
    curriculum = only(reader(folder)(text.replace("size = 2", "size = 3")), "transfer")
    assert curriculum.transfers[0].mapping.index.tolist()[:2] == [[0, 1], [2, 3]]
