"""Names for the components of an environment's states, and labels for its actions."""

from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers import TimeLimit

import curricle as cr
from curricle.interop.tabulation.states import words_of_state
from curricle.interop.tabulation.tables import named_states, words_of_blocks
from curricle.interop.tabulation.tabulated_task import parts_of
from curricle.tasks.observation_task import EnvironmentMaker
from tests.refusals import check_values

from .environments import TWO, Echo, Ring

SPACES = {
    "several": (spaces.MultiDiscrete([2, 3], start=[0, 5]), np.array([1, 6]), 4),
    "binary": (spaces.MultiBinary(2), np.array([1, 0], np.int8), 2),
    "tuple": (spaces.Tuple([spaces.Discrete(3), spaces.Discrete(2)]), (2, 1), 5),
    "dict": (spaces.Dict(a=spaces.Discrete(3), b=spaces.Discrete(2)), {"a": 1, "b": 1}, 3),
}


def echo(space, observation, **settings):
    return cr.from_gymnasium(
        Echo,
        discount=0.9,
        time_limit=3,
        **settings,
        observation_space=space,
        action_space=TWO,
        observations=[observation] * 2,
    )


@pytest.mark.parametrize("kind", SPACES)
def test_the_numbers_in_an_observation_are_named_in_their_order(kind):
    space, observation, state = SPACES[kind]
    plain, task = echo(space, observation), echo(space, observation, names=["row", "column"])
    assert task.states.names == ("row", "column")
    assert task.states.shape == plain.states.shape
    assert cr.planning.rollout(task, np.zeros(task.states.size, int)).states[0] == state


def test_numbers_and_actions_are_named():
    one = echo(spaces.Discrete(12, start=1), 8, names=["place"])
    assert one.states.label(7) == "place=8"
    split = echo(spaces.Discrete(12, start=1), 8, names=["row", "column"], sizes=[3, 4])
    assert split.states.label(cr.planning.rollout(split, np.zeros(12, int)).states[0]) == (
        "row=1 column=3"
    )
    ring = cr.from_gymnasium(Ring, discount=0.9, names=["place"])
    assert ring.mdp.states.names == ("place",)  # by its table
    bins = cr.interop.Bins({"x": [0, 1, 2], "v": [0, 1]})
    car = cr.from_gymnasium("MountainCar-v0", discount=0.9, encode=bins, names=["place", "speed"])
    assert car.states.names == ("place", "speed")
    assert car.states.components[0].labels == bins.states.components[0].labels
    jack = cr.from_gymnasium("Blackjack-v1", discount=0.9, names=["hand", "card", "ace"])
    assert jack.states.label(5) == "hand=0 card=2 ace=usable"
    task = echo(TWO, 0, actions=["left", "right"])
    assert [task.actions.label(a) for a in range(2)] == ["action=left", "action=right"]
    lake = cr.tabulate("FrozenLake-v1", discount=0.9, actions=list("wsen"))
    assert lake.actions.label(3) == "move=n"


GRID = spaces.MultiDiscrete([2, 3])
REFUSED = {
    "sizes alone": (TWO, {"sizes": [2]}, r"sizes need names of what has them: got sizes \[2\]"),
    "sizes of several": (
        GRID,
        {"names": ["a", "b"], "sizes": [2, 3]},
        "sizes are for observations that are one number: these have state_1, state_2",
    ),
    "other sizes": (
        TWO,
        {"names": ["a", "b"], "sizes": [2, 3]},
        "must make the environment's 2 states when multiplied: 2 x 3 is 6",
    ),
    "states too": (
        TWO,
        {"names": ["a"], "states": cr.Space([cr.Component("b", 2)])},
        r"names go without states, whose components have names: got both, names \['a'\]",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_names_nothing_is_refused_in_a_sentence(name):
    space, settings, sentence = REFUSED[name]
    with pytest.raises(cr.errors.TaskError, match=sentence):
        echo(space, space.sample(), **settings)
    wrong = {"names": [["row"], ["a", "a"]], "actions": [["a"]]}
    check_values(cr.errors.TaskError, partial(echo, GRID, GRID.sample()), wrong)


def test_the_time_limit_of_a_wrapper_is_the_task_s():
    def limited():
        return TimeLimit(Echo(TWO, TWO, [0, 1]), 7)

    assert cr.from_gymnasium(limited, discount=0.9).time_limit == 7
    assert cr.from_gymnasium(limited, discount=0.9, time_limit=5).time_limit == 5


class Room(gym.Env):
    """An environment whose arguments have names of our own."""

    def __init__(self, discount=1, names=()):
        self.observation_space, self.action_space = spaces.Discrete(discount), TWO
        self.names = names


def test_a_maker_brings_arguments_of_any_name():
    maker = EnvironmentMaker(Room, {"discount": 5, "names": ["x"]})
    task = cr.from_gymnasium(maker, discount=0.9, names=["place"])
    assert (task.states.size, task.states.names, task.make().names) == (5, ("place",), ["x"])
    lake = cr.from_gymnasium(
        EnvironmentMaker("FrozenLake-v1", {"map_name": "8x8"}), discount=0.9, time_limit=9
    )
    assert (lake.states.size, lake.time_limit) == (64, 9)


def test_the_words_of_states_and_of_their_blocks():
    assert words_of_state((3, "red")) == {"state_1": 3, "state_2": "red"}
    assert words_of_state(4) == {"state": 4}
    assert words_of_state({"at": (1, 2)}, "_") == {"_at_1": 1, "_at_2": 2}
    words = [{"row": 1, "lit": 0}, {"row": 1, "lit": 2}]
    assert words_of_blocks(words, np.array([0, 0])) == ([{"row": 1, "lit": "any"}], {"lit"})
    parts = {"sight/#0": 1, "sight/#1": 2, "goal": "key"}
    assert parts_of({"sight": (1, 2), "goal": "key"}) == parts


def test_states_of_equal_words_are_told_apart_by_whether_they_end_the_episode():
    words = [{"row": 1, "lamp": "on"}, {"row": 2, "lamp": "off"}, {"row": 2, "lamp": "off"}]
    space = named_states(words, np.array([False, False, True]), [])
    assert [*map(space.label, range(3))] == [
        "row=1 lamp=on ended=no",
        "row=2 lamp=off ended=no",
        "row=2 lamp=off ended=yes",
    ]
