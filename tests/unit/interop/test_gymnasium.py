"""Gymnasium environments as tasks: tables, spaces, names, and what is refused."""

from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.envs.toy_text.cliffwalking import CliffWalkingEnv
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv
from gymnasium.envs.toy_text.taxi import TaxiEnv
from gymnasium.wrappers import TimeLimit, TransformReward

import curricle as cr
from curricle.interop.states import words_of_state
from curricle.interop.tabulated_task import assembled, parts_of
from curricle.interop.tabulation import named_states, words_of_blocks
from curricle.study.templates import new_study
from curricle.tasks.mdp import same_task
from curricle.tasks.observation_task import EnvironmentMaker
from tests.support.refusals import check_values

from .environments import TWO, Echo, Ring


def test_horizons_are_those_of_the_environments():
    for name, limit in {"FrozenLake8x8-v1": 200, "Taxi-v4": 200, "CliffWalking-v1": None}.items():
        assert cr.from_gymnasium(name, discount=0.9).time_limit == limit
    assert cr.from_gymnasium("Taxi-v4", discount=0.9, time_limit=7).time_limit == 7
    assert cr.from_gymnasium("Taxi-v4", discount=0.9, max_episode_steps=9).time_limit == 9
    for live in (False, True):
        endless = cr.from_gymnasium("Taxi-v4", discount=0.9, time_limit=None, live=live)
        assert endless.time_limit is None
    walked = cr.planning.rollout(endless, np.zeros(500, int), steps=250)  # south, for ever
    assert len(walked) == 250
    for outer, limit in ((200, 100), (100, 100), (50, 50)):
        lake = TimeLimit(gym.make("FrozenLake-v1"), outer)
        assert cr.from_gymnasium(lake, discount=0.9).time_limit == limit


def test_the_optimum_is_the_one_that_gymnasium_states():
    lake = cr.from_gymnasium("FrozenLake-v1", discount=0.999)
    evaluation = cr.GreedyEvaluation("exact", discounted=False)
    assert cr.planning.Target.of(lake, evaluation).optimum == pytest.approx(0.74, abs=0.005)
    cliff = cr.from_gymnasium("CliffWalking-v1", discount=0.999, time_limit=100)
    assert cr.planning.Target.of(cliff, evaluation).optimum == -13


class Doubled(gym.Wrapper):
    def step(self, action):
        observation, reward, *rest = self.env.step(action)
        return observation, 2 * reward, *rest


class Rotated(FrozenLakeEnv):
    def step(self, action):
        return super().step((action + 1) % 4)


class FromAnywhere(TaxiEnv):
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.s = int(self.np_random.integers(500))
        return self.s, {}


class ImpatientLimit(TimeLimit):
    def step(self, action):
        observation, reward, *rest = super().step(action)
        return observation, reward - 1, *rest


class OwnTable(gym.Env):
    """Has a table that its `step` need not follow."""

    observation_space, action_space = gym.spaces.Discrete(1), gym.spaces.Discrete(1)
    initial_state_distrib, P = np.ones(1), {0: {0: [(1.0, 0, 0.0, False)]}}


def replaced(method):
    env = CliffWalkingEnv()
    setattr(env, method, getattr(env, method))
    return env


NOT_IN_THE_TABLE = {
    "a subclass's step": lambda: Rotated(),
    "a subclass's reset": lambda: FromAnywhere(),
    "a step that was replaced": lambda: replaced("step"),
    "a reset that was replaced": lambda: replaced("reset"),
    "a time limit's own step": lambda: ImpatientLimit(gym.make("FrozenLake-v1"), 100),
    "a table beside a step": lambda: OwnTable(),
    "a wrapper that changes rewards": lambda: TransformReward(
        gym.make("FrozenLake-v1"), lambda r: -r
    ),
    "an unknown wrapper": lambda: Doubled(gym.make("FrozenLake-v1")),
    "a time limit nowhere told": lambda: TimeLimit(FrozenLakeEnv(), 5),
    "passengers who change their minds": lambda: gym.make("Taxi-v4", fickle_passenger=True),
    "no table": lambda: gym.make("Blackjack-v1"),
}


@pytest.mark.parametrize("why", NOT_IN_THE_TABLE)
def test_what_a_table_does_not_describe_is_live(why):
    task = cr.from_gymnasium(NOT_IN_THE_TABLE[why], discount=0.9)
    assert isinstance(task, cr.tasks.LiveMDP)
    if why == "a subclass's step":  # west leads south
        assert task.actions.components[0].labels is None


def test_a_table_that_was_changed_is_read_as_it_is():
    env = gym.make("FrozenLake-v1", is_slippery=False)
    env.unwrapped.P[0] = {a: [(1.0, 15, 7.0, True)] for a in range(4)}
    assert cr.solve(cr.from_gymnasium(env, discount=0.9)).start_value == 7
    with pytest.raises(cr.errors.TaskError, match="made again for each seed; give a function"):
        cr.from_gymnasium(env, discount=0.9, live=True)


def test_an_environment_whose_step_was_replaced_cannot_be_made_again():
    env = gym.make("FrozenLake-v1")
    env.unwrapped.step = lambda action: (15, 1.0, True, False, {})
    with pytest.raises(cr.errors.TaskError, match="give a function that makes it so"):
        cr.from_gymnasium(env, discount=0.9)


@pytest.mark.parametrize("table", [np.eye(16), [[1.0]], {3: 4}, None, [[[(1.0, 0)]] * 4] * 16])
def test_what_is_no_list_of_outcomes_is_no_table(table):
    class Odd(FrozenLakeEnv):
        def __init__(self):
            super().__init__()
            self.P = table

    assert isinstance(cr.from_gymnasium(Odd, discount=0.9), cr.tasks.LiveMDP)


NUMBER, PAIR = spaces.Discrete, spaces.Tuple([TWO, TWO])
DICE = spaces.Dict(card=NUMBER(3), dice=spaces.MultiDiscrete([6, 6]))
ROLLED = [{"dice": np.array([1, 2]), "card": 1}, {"card": 2, "dice": np.array([5, 5])}]
BOX_OF_NUMBERS = spaces.Box(np.array([[0, -1]]), np.array([[2, 1]]), dtype=np.int64)
OBSERVATIONS = [  # two observations of a space, their states, and the names of their components
    (NUMBER(4), [0, np.int64(3)], [0, 3], ["state"]),
    (NUMBER(4, start=-1), [-1, 2], [0, 3], ["state"]),
    (spaces.MultiDiscrete([2, 3], start=[0, 5]), [np.array([0, 5]), np.array([1, 6])], [0, 4],
     ["state_1", "state_2"]),
    (spaces.MultiBinary([2, 1]), [np.array([[0], [1]], np.int8)] * 2, [1, 1],
     ["state_0_0", "state_1_0"]),
    (BOX_OF_NUMBERS, [np.array([[0, -1]]), np.array([[2, 0]])], [0, 7],
     ["state_0_0", "state_0_1"]),
    (spaces.MultiDiscrete([[2], [3]]), [np.array([[1], [2]])] * 2, [5, 5],
     ["state_0_0", "state_1_0"]),
    (spaces.Tuple([NUMBER(3), PAIR]), [(2, (0, 1)), (0, (1, 0))], [9, 2],
     ["state_1", "state_2_1", "state_2_2"]),
    (DICE, ROLLED, [44, 107], ["card", "dice_1", "dice_2"]),
]  # fmt: skip


@pytest.mark.parametrize(("space", "observations", "expected", "names"), OBSERVATIONS)
def test_observations_are_numbered(space, observations, expected, names):
    world = {"observation_space": space, "action_space": TWO, "observations": observations}
    task = cr.from_gymnasium(Echo, discount=0.9, time_limit=9, **world)
    seen = cr.planning.rollout(task, np.zeros(task.states.size, int)).states.tolist()
    assert list(task.states.names) == names
    assert seen == expected
    renamed = [f"part {i}" for i in range(len(names))]
    named = cr.from_gymnasium(Echo, discount=0.9, time_limit=9, names=renamed, **world)
    assert list(named.states.names) == renamed
    assert named.states.shape == task.states.shape


def played_actions(space):
    notes = []
    task = cr.from_gymnasium(lambda: Echo(TWO, space, [0, 1], notes), discount=0.9, time_limit=9)
    for action in range(task.actions.size):
        cr.planning.rollout(task, [action, action])
    return task, notes


@pytest.mark.parametrize(
    ("space", "taken"),
    [
        (spaces.MultiDiscrete([2, 2], start=[0, 5]), [[0, 5], [0, 6], [1, 5], [1, 6]]),
        (spaces.Discrete(2, start=4), [4, 5]),
        (spaces.Tuple([TWO, TWO]), [(0, 0), (0, 1), (1, 0), (1, 1)]),
        (spaces.Dict(a=TWO), [{"a": 0}, {"a": 1}]),
    ],
)
def test_joint_actions_are_what_the_environment_takes(space, taken):
    task, notes = played_actions(space)
    assert [note.tolist() if isinstance(note, np.ndarray) else note for note in notes] == taken
    assert all(task.make().action_space.contains(note) for note in notes)
    if isinstance(space, spaces.MultiDiscrete):
        assert task.actions.names == ("action_1", "action_2")
        assert not notes[0].flags.writeable


class Swapped(gym.ActionWrapper):
    def action(self, action):
        return 3 - action


class Mirrored(gym.ObservationWrapper):
    def observation(self, observation):
        return 15 - observation


@pytest.mark.parametrize("kind", [Swapped, Mirrored, lambda env: TransformReward(env, abs)])
def test_wrappers_that_change_what_is_seen_or_done_leave_no_names(kind):
    def make():
        return kind(gym.make("FrozenLake-v1", is_slippery=False))

    task, tables = cr.from_gymnasium(make, discount=0.9), cr.tabulate(make, discount=0.9)
    named = kind not in (Swapped, Mirrored)
    assert task.states.names == (("row", "column") if named else ("state",))
    for actions in (task.actions, tables.actions):
        assert actions.label(2) == ("move=east" if named else "action=2")


def test_an_encode_of_ones_own():
    place = cr.Space([cr.Component("side", 2), cr.Component("lean", 3, low=-1)])

    def encode(observation):
        return int(observation[0] > 0), int(np.clip(10 * observation[2], -1, 1))

    def number(observation):
        return int(place.encode(**dict(zip(place.names, encode(observation), strict=True))))

    listed = cr.Space(place.components, [[1, 0], [0, 0], [0, -1], [1, -1], [0, 1], [1, 1]])
    seen = []
    for states, function in ((place, encode), (place, number), (listed, encode)):
        task = cr.from_gymnasium("CartPole-v1", discount=0.9, states=states, encode=function)
        met = cr.planning.rollout(task, np.zeros(6, int)).states
        seen.append([values.tolist() for values in states.decode(met).values()])
    assert seen[0] == seen[1] == seen[2]
    assert seen[0][1][0] == 0  # upright


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


def test_wrong_whole_numbers_are_named():
    no_dict, no_range = "need a dict from names to ran", "be two ascending whole numbers: 'a' has"
    for ranges, said in (
        *((wrong, f"whole numbers {no_dict}") for wrong in ([("a", (0, 3))], {})),
        *(({"a": ends}, no_range) for ends in (5, (3,), (0, 1.5), (3, 0))),
        ({"a": "word"}, "the range of 'a' must be an array of numbers"),
    ):
        with pytest.raises(cr.errors.TaskError, match=said):
            cr.interop.WholeNumbers(ranges)
    of_numpy = cr.interop.WholeNumbers({"a": np.array([0, 3])})
    assert of_numpy == cr.interop.WholeNumbers({"a": (0, 3)})


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
    for make in (
        lambda: cr.from_gymnasium("MountainCar-v0", discount=0.9, encode=cr.interop.Bins(EDGES)),
        lambda: cr.from_gymnasium(gym.make("Blackjack-v1"), discount=0.9),
        lambda: echo(spaces.Tuple([TWO, spaces.Discrete(3)]), np.ones(3)),
    ):
        assert same_task(make(), make())
        assert not same_task(make(), jack(sab=True))


def echo(space, observation, **settings):
    world = {"observation_space": space, "action_space": TWO, "observations": [observation] * 2}
    return cr.from_gymnasium(Echo, **{"discount": 0.9, "time_limit": 3, **settings}, **world)


def test_states_and_actions_are_named():
    made = partial(cr.from_gymnasium, discount=0.9)
    table = cr.Space([cr.Component("down", 4), cr.Component("right", 4)])
    lake, live = (made("FrozenLake-v1", states=table, live=live) for live in (False, True))
    assert lake.states.label(6) == "down=1 right=2"
    assert (live.states, live.actions) == (lake.states, lake.actions)
    assert made("Blackjack-v1").states.label(5) == "player=0 dealer=2 ace=usable"
    jack = made("Blackjack-v1", names=["hand", "card", "ace"])
    assert jack.states.label(5) == "hand=0 card=2 ace=usable"
    with pytest.raises(cr.errors.TaskError, match="name all 4 of the environment's: got 5"):
        made("FrozenLake-v1", actions=cr.Space([cr.Component("a", 5)]))
    echoed = echo(spaces.Discrete(12, start=1), 8, names=["place"])
    assert echoed.states.label(7) == "place=8"
    split = echo(spaces.Discrete(12, start=1), 8, names=["row", "column"], sizes=[3, 4])
    assert split.states.label(cr.planning.rollout(split, np.zeros(12, int)).states[0]) == (
        "row=1 column=3"
    )
    assert made(Ring, names=["place"]).mdp.states.names == ("place",)  # by its table
    bins = cr.interop.Bins({"x": [0, 1, 2], "v": [0, 1]})
    car = made("MountainCar-v0", encode=bins, names=["place", "speed"])
    assert car.states.names == ("place", "speed")
    assert car.states.components[0].labels == bins.states.components[0].labels
    task = echo(TWO, 0, actions=["left", "right"])
    assert [task.actions.label(a) for a in range(2)] == ["action=left", "action=right"]
    lake = cr.tabulate("FrozenLake-v1", discount=0.9, actions=list("wsen"))
    assert lake.actions.label(3) == "move=n"


GRID, BOX = spaces.MultiDiscrete([2, 3]), spaces.Box(0, 1, (2,))
PICTURE, NO_BOUNDS = (
    spaces.Box(0, 255, (9, 9), np.uint8),
    spaces.Box(-(2**63), 2**63 - 1, (1,), int),
)
MANY = spaces.MultiBinary(70), spaces.Tuple([spaces.MultiBinary(40)] * 2)
AB, OF_B = {"names": ["a", "b"]}, cr.Space([cr.Component("b", 2)])
REFUSED = [
    *(
        (space, {}, r"observations must be discrete.*; tabulate")
        for space in (PICTURE, NO_BOUNDS, BOX, spaces.Dict(cell=TWO, picture=PICTURE), *MANY)
    ),
    (BOX, {"encode": int}, "needs the states it encodes to"),
    (BOX, {"encode": cr.interop.Bins({"x": [0, 1]})}, "have edges for 1"),
    (TWO, {"discount": 1, "time_limit": None}, "a live task with discount 1 needs a time limit"),
    (TWO, {"sizes": [2]}, r"need the names of their components: got sizes \[2\]"),
    (GRID, AB | {"sizes": [2, 3]}, "one number: these have state_1, state_2"),
    (TWO, AB | {"sizes": [2, 3]}, "environment's 2 states: 2 x 3 is 6"),
    (TWO, {"names": ["a"], "states": OF_B}, r"the components: got names \['a'\]"),
]


@pytest.mark.parametrize(("space", "settings", "sentence"), REFUSED)
def test_what_cannot_be_a_task_is_refused_in_a_sentence(space, settings, sentence):
    with pytest.raises(cr.errors.TaskError, match=sentence):
        echo(space, None, **settings)


def test_what_names_nothing_is_refused():
    wrong = {"names": [["row"], ["a", "a"]], "actions": [["a"]]}
    check_values(cr.errors.TaskError, partial(echo, GRID, GRID.sample()), wrong)
    for name, meant in (
        ("FrozenLaek-v1", "exist, did you mean FrozenLake-v1 or"),
        ("Empty-5x5-v0", "exist, did you mean minigrid:MiniGrid-Empty-5x5-v0"),
    ):
        with pytest.raises(cr.errors.TaskError, match=meant):
            cr.from_gymnasium(name, discount=0.9)


def test_without_minigrid_its_environments_name_the_extra_to_install(monkeypatch):
    monkeypatch.setattr("curricle.interop.gymnasium.find_spec", lambda _: None)
    monkeypatch.setattr("curricle.study.templates.find_spec", lambda _: None)
    with pytest.raises(cr.errors.ConfigError, match=r'pip install "curricle\[minigrid\]"'):
        new_study("MiniGrid-Absent-v0")


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
    alike = {"a": np.arange(4).reshape(2, 2), "a_1": [7, 8], "b": [3], "b_1": 4}
    assert [*words_of_state(alike).values()] == [0, 1, 2, 3, 7, 8, 3, 4]
    assert words_of_state(alike)["b_1"] == 4
    components = [{"row": 1, "lit": 0}, {"row": 1, "lit": 2}]
    assert words_of_blocks(components, np.array([0, 0])) == ([{"row": 1, "lit": "any"}], {"lit"})
    parts = {"sight/#0": 1, "sight/#1": 2, "goal": "key"}
    assert parts_of({"sight": (1, 2), "goal": "key"}) == parts
    nested = {"a/b": {"#~1": np.ones(2)}, "~": (1, 2)}
    assert np.array_equal(assembled(parts_of(nested))["a/b"]["#~1"], np.ones(2))
    assert assembled(parts_of(nested))["~"] == (1, 2)


def test_states_of_equal_words_are_told_apart_by_whether_they_end_the_episode():
    components = [{"row": 1, "lamp": "on"}, {"row": 2, "lamp": "off"}, {"row": 2, "lamp": "off"}]
    space = named_states(components, np.array([False, False, True]), [])
    assert [*map(space.label, range(3))] == [
        "row=1 lamp=on ended=no",
        "row=2 lamp=off ended=no",
        "row=2 lamp=off ended=yes",
    ]
