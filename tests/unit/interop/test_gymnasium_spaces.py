"""Gymnasium's spaces, and observations made discrete, as states and actions of a task."""

from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces

import curricle as cr
from curricle.tasks.mdp import same_task
from tests.refusals import check_values

from .environments import TWO, Echo, Ring

OBSERVATIONS = {
    "discrete": (spaces.Discrete(4), [0, np.int64(3)], [0, 3], ["state"]),
    "with a start": (spaces.Discrete(4, start=-1), [-1, 2], [0, 3], ["state"]),
    "several": (
        spaces.MultiDiscrete([2, 3], start=[0, 5]),
        [np.array([0, 5]), np.array([1, 6])],
        [0, 4],
        ["state_1", "state_2"],
    ),
    "binary": (
        spaces.MultiBinary([2, 1]),
        [np.array([[0], [1]], np.int8)] * 2,
        [1, 1],
        ["state_1", "state_2"],
    ),
    "tuple": (
        spaces.Tuple([spaces.Discrete(3), spaces.Tuple([spaces.Discrete(2), spaces.Discrete(2)])]),
        [(2, (0, 1)), (0, (1, 0))],
        [9, 2],
        ["state_1", "state_2_1", "state_2_2"],
    ),
    "dict": (
        spaces.Dict(dice=spaces.MultiDiscrete([6, 6]), card=spaces.Discrete(3)),
        [{"dice": np.array([1, 2]), "card": 1}, {"card": 2, "dice": np.array([5, 5])}],
        None,
        None,
    ),
}


@pytest.mark.parametrize("kind", OBSERVATIONS)
def test_observations_are_numbered(kind):
    space, observations, expected, names = OBSERVATIONS[kind]
    task = cr.from_gymnasium(Echo, discount=0.9, time_limit=9, observation_space=space,
                             action_space=TWO, observations=observations)  # fmt: skip
    seen = cr.planning.rollout(task, np.zeros(task.states.size, int)).states.tolist()
    if kind == "dict":  # in the order in which Gymnasium has the keys
        points = [{"dice_1": 1, "dice_2": 2, "card": 1}, {"dice_1": 5, "dice_2": 5, "card": 2}]
        expected = [int(task.states.encode(**point)) for point in points]
        names = sorted(points[0])
        assert sorted(task.states.names) == names
    else:
        assert list(task.states.names) == names
    assert seen == expected


def played_actions(space):
    notes = []
    task = cr.from_gymnasium(lambda: Echo(TWO, space, [0, 1], notes), discount=0.9, time_limit=9)
    for action in range(task.actions.size):
        cr.planning.rollout(task, [action, action])
    return task, notes


def test_joint_actions_are_what_the_environment_takes():
    task, notes = played_actions(spaces.MultiDiscrete([2, 3], start=[0, 5]))
    assert task.actions.names == ("action_1", "action_2")
    assert [note.tolist() for note in notes] == [[0, 5], [0, 6], [0, 7], [1, 5], [1, 6], [1, 7]]
    assert all(task.make().action_space.contains(note) for note in notes)
    assert not notes[0].flags.writeable
    _, notes = played_actions(spaces.Discrete(2, start=4))
    assert notes == [4, 5]
    _, notes = played_actions(spaces.Tuple([TWO, TWO]))
    assert notes == [(0, 0), (0, 1), (1, 0), (1, 1)]
    _, notes = played_actions(spaces.Dict(a=TWO))
    assert notes == [{"a": 0}, {"a": 1}]


def test_names_may_be_given():
    table = cr.Space([cr.Component("down", 4), cr.Component("right", 4)])
    lake = cr.from_gymnasium("FrozenLake-v1", discount=0.9, states=table)
    assert lake.states.label(6) == "down=1 right=2"
    live = cr.from_gymnasium("FrozenLake-v1", discount=0.9, states=table, live=True)
    assert live.states == lake.states
    assert live.actions == lake.actions
    jack = cr.from_gymnasium("Blackjack-v1", discount=0.9)
    assert jack.states.label(5) == "player=0 dealer=2 ace=usable"
    with pytest.raises(cr.errors.TaskError, match="actions must name the environment's 4: got 5"):
        cr.from_gymnasium("FrozenLake-v1", discount=0.9, actions=cr.Space([cr.Component("a", 5)]))


def test_an_encode_of_ones_own():
    place = cr.Space([cr.Component("side", 2), cr.Component("lean", 3, low=-1)])

    def encode(observation):
        return int(observation[0] > 0), int(np.clip(10 * observation[2], -1, 1))

    task = cr.from_gymnasium("CartPole-v1", discount=0.9, states=place, encode=encode)
    seen = cr.planning.rollout(task, np.zeros(6, int)).states
    assert seen[0] in (1, 4)  # upright, on one side
    by_number = cr.from_gymnasium(
        "CartPole-v1", discount=0.9, states=place,
        encode=lambda observation: int(place.encode(side=encode(observation)[0],
                                                    lean=encode(observation)[1])),
    )  # fmt: skip
    np.testing.assert_array_equal(cr.planning.rollout(by_number, np.zeros(6, int)).states, seen)
    listed = cr.Space(place.components, [[1, 0], [0, 0], [0, -1], [1, -1], [0, 1], [1, 1]])
    numbered = cr.from_gymnasium("CartPole-v1", discount=0.9, states=listed, encode=encode)
    again = cr.planning.rollout(numbered, np.zeros(6, int)).states
    for name, values in listed.decode(again).items():
        np.testing.assert_array_equal(values, place.decode(seen)[name])


EDGES = {"position": [-1.2, -0.5, 0.6], "velocity": np.linspace(-0.07, 0.07, 8)}


def test_bins_make_numbers_states():
    bins = cr.interop.Bins(EDGES)
    task = cr.from_gymnasium("MountainCar-v0", discount=0.9, encode=bins)
    assert task.states == bins.states
    assert task.states.shape == (2, 7)
    env = gym.make("MountainCar-v0")
    observation, _ = env.reset(seed=1)
    here = task.states.decode(bins(observation))
    assert here["position"] == np.digitize(observation[0], [-0.5])
    assert here["velocity"] == 3
    assert bins.states.components[0].labels == ("below -0.5", "-0.5 and above")
    assert cr.interop.Bins({"x": [0, 1]}).states.components[0].labels == ("any",)
    close = cr.interop.Bins({"x": [0, 1, 1 + 1e-12, 1 + 2e-12, 2]}).states.components[0].labels
    assert len(set(close)) == 4


BOX = spaces.Box(0, 1, (2,))
REFUSED = {
    "a box": ({"observation_space": BOX, "action_space": TWO}, "observations must be discrete"),
    "no states": (
        {"observation_space": BOX, "action_space": TWO, "encode": int},
        "needs the states it encodes to",
    ),
    "too few bins": (
        {"observation_space": BOX, "action_space": TWO, "encode": cr.interop.Bins({"x": [0, 1]})},
        r"edges for each entry of an observation, \(2,\): they have edges for 1",
    ),
    "no end in sight": (
        {"observation_space": TWO, "action_space": TWO, "discount": 1},
        "a live task with discount 1 needs a time limit",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_a_task_is_refused_in_a_sentence(name):
    settings, message = REFUSED[name]
    with pytest.raises(cr.errors.TaskError, match=message):
        cr.from_gymnasium(Echo, **{"discount": 0.9, **settings})


def test_wrong_bins_are_named():
    wrong = [[1, 2], {"x": [2, 1]}, {"x": [1, np.nan]}, {"x": [[1, 2]]}]
    for edges in wrong:
        with pytest.raises(cr.errors.TaskError, match=r"bins need a dict|'x' has"):
            cr.interop.Bins(edges)
    for observation in ([0.0, np.nan], [0.0]):
        with pytest.raises(cr.errors.TaskError, match=r"must be of numbers|must have 2 entries"):
            cr.interop.Bins(EDGES)(np.array(observation))


def test_what_cannot_be_made_is_refused_in_a_sentence():
    made = partial(cr.from_gymnasium, discount=0.9)
    check_values(cr.errors.TaskError, made, {"environment": [5, None, dict]})
    with pytest.raises(cr.errors.TaskError, match="takes no arguments: got map_name"):
        made(gym.make("FrozenLake-v1"), map_name="8x8")
    with pytest.raises(cr.errors.TaskError, match="cannot be made again for each seed"):
        made(Echo(TWO, TWO))
    check_values(cr.errors.TaskError, partial(made, "Taxi-v4"), {"time_limit": [0, 1.5, "5"]})
    for make in (cr.from_gymnasium, cr.observation_task):
        for name, arguments, failure in (
            ("NoSuchThing-v0", {}, "NameNotFound"),
            ("nomodule:NoSuchThing-v0", {}, "ModuleNotFoundError"),
            ("FrozenLake-v1", {"frozen": True}, "TypeError"),
            ("FrozenLake-v1", {"map_name": "9x9"}, "KeyError"),
        ):
            with pytest.raises(cr.errors.TaskError, match=f"{name}' failed with {failure}: "):
                make(name, discount=0.9, **arguments)
    spaces_of_task = cr.Space([cr.Component("s", 3)]), cr.Space([cr.Component("a", 2)])
    live = partial(cr.tasks.LiveMDP, *spaces_of_task)
    check_values(cr.errors.TaskError, live, {"make": [3]})
    check_values(cr.errors.TaskError, partial(live, Ring), {"encode": [3], "act": [3]})


def test_live_tasks_made_of_the_same_are_one():
    def jack(**settings):
        return cr.from_gymnasium("Blackjack-v1", **{"discount": 0.9, **settings})

    assert same_task(jack(), jack())
    assert hash(jack()) == hash(jack())
    assert not same_task(jack(), jack(sab=False))
    assert not same_task(jack(), jack(discount=0.8))
    car = [
        cr.from_gymnasium("MountainCar-v0", discount=0.9, encode=cr.interop.Bins(EDGES))
        for _ in range(2)
    ]
    assert same_task(*car)
    assert not same_task(car[0], jack())
    made = [cr.from_gymnasium(gym.make("Blackjack-v1"), discount=0.9) for _ in range(2)]
    assert same_task(*made)
    tuples = spaces.Tuple([spaces.Discrete(2), spaces.Discrete(3)])
    echoes = [
        cr.from_gymnasium(Echo, discount=0.9, observation_space=spaces.Tuple(list(tuples)),
                          action_space=spaces.MultiDiscrete([2, 2]), observations=[np.ones(3)])
        for _ in range(2)
    ]  # fmt: skip
    assert same_task(*echoes)
