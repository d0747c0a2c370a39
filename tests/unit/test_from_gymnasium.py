"""Gymnasium environments as tasks: tables that tell what the environment does, names, live play."""

import _thread
import signal

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv
from gymnasium.wrappers import TimeLimit, TransformReward

import curricle as cr
from curricle.interop.gymnasium import Recipe
from curricle.tasks.task import same_task

OFF = cr.GreedyEvaluation("off")
WORLDS = {
    "lake": ("FrozenLake-v1", {}),
    "large lake": ("FrozenLake-v1", {"map_name": "8x8"}),
    "lake without chance": ("FrozenLake-v1", {"is_slippery": False}),
    "cliff": ("CliffWalking-v1", {}),
    "slippery cliff": ("CliffWalking-v1", {"is_slippery": True}),
    "taxi": ("Taxi-v4", {}),
    "taxi in the rain": ("Taxi-v4", {"is_rainy": True}),
}


# -- tables --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", WORLDS)
def test_a_table_tells_what_its_environment_does(name):
    """Acted at random: every step is one of the table's outcomes, about as often as it says."""
    world, settings = WORLDS[name]
    task = cr.from_gymnasium(world, discount=0.9, **settings)
    assert isinstance(task, cr.FiniteMDP)
    n_states, n_actions = task.states.size, task.actions.size
    rng, env = np.random.default_rng(0), gym.make(world, **settings)
    state, _ = env.reset(seed=0)
    assert task.start[state] > 0
    seen = np.zeros((n_states, n_actions, task.probability.shape[1]))
    for _ in range(20_000):
        action = int(rng.integers(n_actions))
        after, reward, terminated, truncated, _ = env.step(action)
        row = task.outcome_row[state, action]
        match = (
            (task.next_state[row] == after)
            & (task.reward[row] == reward)
            & (task.probability[row] > 0)
        )
        assert match.any()
        assert terminated == task.terminal[after]
        # Outcomes that look alike share what was seen of them.
        seen[state, action, match] += (
            task.probability[row][match] / task.probability[row][match].sum()
        )
        state = after
        if terminated or truncated:
            state, _ = env.reset()
            assert task.start[state] > 0
    tried = seen.sum(axis=2)
    often = tried > 100
    shares = seen[often] / tried[often][:, None]
    said = task.probability[task.outcome_row[often]]
    # Five standard deviations of a share.
    assert (abs(shares - said) < 5 * np.sqrt(0.25 / tried[often][:, None])).all()


def test_horizons_are_those_of_the_environments():
    limits = {
        "FrozenLake-v1": 100,
        "FrozenLake8x8-v1": 200,
        "Taxi-v4": 200,
        "CliffWalking-v1": None,
    }
    for name, limit in limits.items():
        assert cr.from_gymnasium(name, discount=0.9).time_limit == limit
    assert cr.from_gymnasium("Taxi-v4", discount=0.9, time_limit=7).time_limit == 7
    assert cr.from_gymnasium("Taxi-v4", discount=0.9, max_episode_steps=9).time_limit == 9
    for live in (False, True):
        endless = cr.from_gymnasium("Taxi-v4", discount=0.9, time_limit=None, live=live)
        assert endless.time_limit is None
    walked = cr.planning.rollout(endless, np.zeros(500, int), steps=250)  # south, for ever
    assert len(walked) == 250
    assert cr.from_gymnasium(gym.make("FrozenLake-v1"), discount=0.9).time_limit == 100


def test_the_optimum_is_the_one_that_gymnasium_states():
    lake = cr.from_gymnasium("FrozenLake-v1", discount=0.999)
    judge = cr.GreedyEvaluation("exact", discounted=False)
    assert cr.planning.Target.of(lake, judge).optimum == pytest.approx(0.74, abs=0.005)
    cliff = cr.from_gymnasium("CliffWalking-v1", discount=0.999, time_limit=100)
    assert cr.planning.Target.of(cliff, judge).optimum == -13


def test_places_and_moves_have_their_names():
    lake = cr.from_gymnasium("FrozenLake-v1", discount=0.9)
    cliff = cr.from_gymnasium("CliffWalking-v1", discount=0.9)
    taxi = cr.from_gymnasium("Taxi-v4", discount=0.9)
    assert lake.states.label(7) == "row=1 column=3"
    assert cliff.states.label(47) == "row=3 column=11"
    assert taxi.states.label(499) == "row=4 column=4 passenger=taxi destination=blue"
    assert [task.actions.label(3) for task in (lake, cliff, taxi)] == [
        "move=north",
        "move=west",
        "move=west",
    ]


def test_moves_go_where_their_names_say():
    moves = {"north": (-1, 0), "south": (1, 0), "east": (0, 1), "west": (0, -1)}
    lake = cr.from_gymnasium("FrozenLake8x8-v1", discount=0.9, is_slippery=False)
    cliff = cr.from_gymnasium("CliffWalking-v1", discount=0.9)
    taxi = cr.from_gymnasium("Taxi-v4", discount=0.9)
    for task, row, column in ((lake, 1, 1), (cliff, 1, 1), (taxi, 2, 1)):
        rest = {name: 0 for name in task.states.names if name not in ("row", "column")}
        here = int(task.states.encode(row=row, column=column, **rest))
        labels = task.actions.components[0].labels
        assert set(moves) <= set(labels)
        for label, (down, right) in moves.items():
            pair = task.outcome_row[here, labels.index(label)]
            there = task.states.decode(int(task.next_state[pair, 0]))
            assert (there["row"], there["column"]) == (row + down, column + right)


def test_a_lake_is_mapped_to_a_maze_by_name():
    lake = cr.from_gymnasium("FrozenLake-v1", discount=0.9)
    maze = cr.GridWorld(["S..", "...", "..T"])
    mapping = cr.project(lake, maze)
    south = 1
    pair = mapping.index[lake.states.encode(row=1, column=2), south]
    assert maze.states.label(pair // 4) == "row=1 column=2"
    assert maze.actions.label(pair % 4) == "move=south"


class Ring(gym.Env):
    """A table whose transitions, not states, end an episode: going round, or resting at 2."""

    def __init__(self, start=0):
        self.observation_space, self.action_space = spaces.Discrete(3), spaces.Discrete(2)
        self.initial_state_distrib = np.eye(3)[start]
        self.P = {
            s: {0: [(1.0, (s + 1) % 3, 1.0, s == 2)], 1: [(1.0, s, -1.0, s == 2)]} for s in range(3)
        }

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = int(self.initial_state_distrib.argmax())
        return self.state, {}

    def step(self, action):
        ((_, self.state, reward, over),) = self.P[self.state][action]
        return self.state, reward, over, False, {}


def test_an_end_that_depends_on_the_transition_is_set_apart():
    tabled = cr.from_gymnasium(Ring, discount=0.5)
    live = cr.from_gymnasium(Ring, discount=0.5, live=True)
    assert tabled.states.size == 4
    assert tabled.terminal.tolist() == [False, False, False, True]
    np.testing.assert_array_equal(cr.solve(tabled).action_values[:3, 0], [1.75, 1.5, 1.0])
    learner = cr.QLearning(learning_rate=1.0, epsilon=0.5)
    learnt = [cr.learn(task, learner, 500, evaluation=OFF).values[0] for task in (tabled, live)]
    np.testing.assert_array_equal(learnt[0][:3], learnt[1])
    np.testing.assert_array_equal(learnt[1][:, 0], [1.75, 1.5, 1.0])


def test_names_that_do_not_fit_an_end_set_apart_are_refused():
    with pytest.raises(cr.errors.TaskError, match="states must name the environment's 4: got 3"):
        cr.from_gymnasium(Ring, discount=0.5, states=cr.Space([cr.Component("place", 3)]))


class Doubled(gym.Wrapper):
    def step(self, action):
        observation, reward, *rest = self.env.step(action)
        return observation, 2 * reward, *rest


NOT_TOLD_BY_THE_TABLE = {
    "a wrapper that changes rewards": lambda: TransformReward(
        gym.make("FrozenLake-v1"), lambda r: -r
    ),
    "an unknown wrapper": lambda: Doubled(gym.make("FrozenLake-v1")),
    "a time limit nowhere told": lambda: TimeLimit(FrozenLakeEnv(), 5),
    "passengers who change their minds": lambda: gym.make("Taxi-v4", fickle_passenger=True),
    "no table": lambda: gym.make("Blackjack-v1"),
}


@pytest.mark.parametrize("why", NOT_TOLD_BY_THE_TABLE)
def test_what_a_table_does_not_tell_is_played_live(why):
    task = cr.from_gymnasium(NOT_TOLD_BY_THE_TABLE[why], discount=0.9)
    assert isinstance(task, cr.tasks.LiveMDP)


@pytest.mark.parametrize("table", [np.eye(16), [[1.0]], {3: 4}, None, [[[(1.0, 0)]] * 4] * 16])
def test_what_is_no_list_of_outcomes_is_no_table(table):
    class Odd(FrozenLakeEnv):
        def __init__(self):
            super().__init__()
            self.P = table

    assert isinstance(cr.from_gymnasium(Odd, discount=0.9), cr.tasks.LiveMDP)


# -- spaces --------------------------------------------------------------------------------------


class Echo(gym.Env):
    """Shows one observation after another, and notes what it is given."""

    def __init__(self, observation_space, action_space, observations=(), notes=None):
        self.observation_space, self.action_space = observation_space, action_space
        self.observations, self.notes = list(observations), notes

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.shown = 0
        return self.observations[0], {}

    def step(self, action):
        if self.notes is not None:
            self.notes.append(action)
        self.shown += 1
        over = self.shown == len(self.observations) - 1
        return self.observations[self.shown], 1.0, over, False, {}


TWO = spaces.Discrete(2)
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


def test_bins_are_values():
    assert cr.interop.Bins(EDGES) == cr.interop.Bins(dict(EDGES))
    assert hash(cr.interop.Bins(EDGES)) == hash(cr.interop.Bins(dict(EDGES)))
    assert cr.interop.Bins(EDGES) != cr.interop.Bins(dict(reversed(EDGES.items())))
    assert cr.interop.Bins(EDGES) != 3


BAD_BINS = {
    "no dict": ([1, 2], "bins need a dict"),
    "none": ({}, "bins need a dict"),
    "one edge": ({"x": [1.0]}, "'x' has"),
    "descending": ({"x": [2, 1]}, "'x' has"),
    "twice the same": ({"x": [1, 1, 2]}, "'x' has"),
    "not a number": ({"x": [1, np.nan]}, "'x' has"),
    "words": ({"x": "ab"}, "must be an array of numbers"),
    "a table": ({"x": [[1, 2]]}, "'x' has"),
}


@pytest.mark.parametrize("name", BAD_BINS)
def test_bad_bins_are_refused(name):
    edges, message = BAD_BINS[name]
    with pytest.raises(cr.errors.TaskError, match=message):
        cr.interop.Bins(edges)


@pytest.mark.parametrize(
    ("observation", "message"),
    [([0.0, np.nan], "must be of numbers"), ([0.0], "must have 2 entries")],
)
def test_what_is_no_observation_is_refused_by_bins(observation, message):
    with pytest.raises(cr.errors.TaskError, match=message):
        cr.interop.Bins(EDGES)(np.array(observation))


BOX = spaces.Box(0, 1, (2,))
REFUSED = {
    "a box": ({"observation_space": BOX, "action_space": TWO}, "observations must be discrete"),
    "a box of actions": (
        {"observation_space": TWO, "action_space": BOX},
        "actions must be discrete",
    ),
    "text in a dict": (
        {"observation_space": spaces.Dict(a=spaces.Text(3)), "action_space": TWO},
        "observations must be discrete",
    ),
    "no states": (
        {"observation_space": BOX, "action_space": TWO, "encode": int},
        "needs the states it encodes to",
    ),
    "too few bins": (
        {"observation_space": BOX, "action_space": TWO, "encode": cr.interop.Bins({"x": [0, 1]})},
        r"edges for each entry of an observation, \(2,\): they have edges for 1",
    ),
    "a discount": ({"observation_space": TWO, "action_space": TWO, "discount": 2}, "discount must"),
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


def test_what_cannot_be_made_is_refused_in_a_sentence():
    with pytest.raises(cr.errors.TaskError, match="an environment must be an id"):
        cr.from_gymnasium(5, discount=0.9)
    with pytest.raises(cr.errors.TaskError, match="takes no arguments: got map_name"):
        cr.from_gymnasium(gym.make("FrozenLake-v1"), discount=0.9, map_name="8x8")
    with pytest.raises(cr.errors.TaskError, match="cannot be made again for each seed"):
        cr.from_gymnasium(Echo(TWO, TWO), discount=0.9)
    for limit in (0, 1.5, "5"):
        with pytest.raises(cr.errors.TaskError, match="time_limit in steps must be a whole number"):
            cr.from_gymnasium("Taxi-v4", discount=0.9, time_limit=limit)
    with pytest.raises(gym.error.NameNotFound):
        cr.from_gymnasium("NoSuchThing-v0", discount=0.9)
    for name in ("make", "encode", "act"):
        parts = {"make": Ring, name: 3}
        with pytest.raises(cr.errors.TaskError, match=f"{name} must be a function: got 3"):
            cr.tasks.LiveMDP(
                cr.Space([cr.Component("s", 3)]), cr.Space([cr.Component("a", 2)]), **parts
            )


# -- live tasks are values -----------------------------------------------------------------------


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


def test_what_a_recipe_holds_cannot_be_changed_from_outside():
    table = np.array([1.0, 2.0])
    recipe = Recipe(dict, {"table": table.copy()})
    assert recipe == Recipe(dict, {"table": table})
    assert recipe != Recipe(dict, {"table": table + 1})
    assert recipe != 3
    recipe()["table"][0] = 7.0
    assert recipe == Recipe(dict, {"table": table})
    assert "table=" in repr(recipe)


# -- learning live -------------------------------------------------------------------------------


class Watched(gym.Env):
    """A coin tossed until heads; counts how often it was opened, stepped and closed."""

    def __init__(self, log, fail=None):
        self.observation_space, self.action_space = TWO, TWO
        self.log, self.fail = log, fail or (lambda log: None)
        log.append("open")

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.log.append(f"seed {seed}" if seed is not None else "reset")
        self.fail(self.log)
        return 0, {}

    def step(self, action):
        self.log.append("step")
        self.fail(self.log)
        heads = bool(self.np_random.random() < 0.3)
        return 1 - heads, float(action), heads, False, {}

    def close(self):
        self.log.append("close")


def watched(log, fail=None, **settings):
    make = (lambda: Watched(log, fail)) if fail else (lambda: Watched(log))
    return cr.from_gymnasium(make, **{"discount": 0.9, "time_limit": 20, **settings})


def test_each_seed_has_an_environment_of_its_own_and_another_to_be_judged_in():
    log = []
    task = watched(log)
    log.clear()
    cr.learn(task, budget=50, seeds=3, eval_freq=25, evaluation=cr.GreedyEvaluation(episodes=2))
    assert log.count("open") == log.count("close") == 6
    assert log.count("step") > 150
    assert sum(line.startswith("seed") for line in log) == 6
    assert len({line for line in log if line.startswith("seed")}) == 6
    log.clear()
    cr.learn(task, budget=50, seeds=3, evaluation=OFF)
    assert log.count("open") == log.count("close") == 3
    assert log.count("step") == 150


def test_a_seed_depends_on_itself_alone():
    task = watched([])
    learner = cr.QLearning(epsilon=0.5)
    many = cr.learn(task, learner, 300, seeds=[5, 2, 9], workers=4)
    for k, seed in enumerate(many.seeds):
        alone = cr.learn(task, learner, 300, seeds=[seed])
        for name in ("values", "training_return", "greedy_return", "episodes"):
            np.testing.assert_array_equal(getattr(many, name)[k], getattr(alone, name)[0])
    assert len({row.tobytes() for row in many.values}) == 3


def test_evaluation_does_not_disturb_learning():
    task = watched([])
    found = [
        cr.learn(task, budget=300, seeds=2, eval_freq=eval_freq, evaluation=judge)
        for eval_freq, judge in ((10, None), (10, OFF), (300, cr.GreedyEvaluation(episodes=50)))
    ]
    for other in found[1:]:
        np.testing.assert_array_equal(found[0].values, other.values)
    assert np.isnan(found[1].greedy_return).all()
    assert not np.isnan(found[0].greedy_return).any()


def test_few_episodes_judge_a_live_task_unless_asked_otherwise():
    class Short(Watched):
        def step(self, action):
            return 0, 1.0, True, False, {}

    for judge, expected in ((None, 5), (cr.GreedyEvaluation(episodes=8), 8)):
        log = []
        task = cr.from_gymnasium(lambda log=log: Short(log), discount=0.9)
        log.clear()
        cr.learn(task, budget=10, eval_freq=10, evaluation=judge)
        # Two checkpoints, and one start for each training step; the last step is none.
        resets = sum(line == "reset" or line.startswith("seed") for line in log)
        assert resets == 2 * expected + 11


class Stay(gym.Env):
    """One place that pays 1 for staying, and cuts every episode off at once."""

    observation_space, action_space = spaces.Discrete(1), spaces.Discrete(1)

    def __init__(self, terminated):
        self.terminated = terminated

    def reset(self, *, seed=None, options=None):
        return 0, {}

    def step(self, action):
        return 0, 1.0, self.terminated, not self.terminated, {}


@pytest.mark.parametrize("learner", [cr.QLearning, cr.SARSA, cr.ExpectedSARSA, cr.DoubleQLearning])
def test_being_cut_off_is_no_end(learner):
    values, episodes = [], []
    for terminated in (True, False):
        task = cr.from_gymnasium(Stay, discount=0.5, terminated=terminated)
        found = cr.learn(task, learner(learning_rate=1.0), 200, evaluation=OFF)
        values.append(found.values[0, 0, 0])
        episodes.append(found.episodes_used[0])
    assert values == pytest.approx([1.0, 2.0])
    assert episodes == [200, 200]


def test_a_guard_and_a_rollout_see_a_cut_too():
    task = cr.from_gymnasium(Stay, discount=0.5, terminated=False, time_limit=50)
    phi = cr.StateActionPotential(task, [[0.0]])
    rate = cr.QLearning(learning_rate=1.0)
    found = cr.learn(
        task, rate, 100, shaping=cr.QInitialisation(phi, guard=cr.Guard()), evaluation=OFF
    )
    assert found.episodes_used[0] == 100
    assert found.values[0, 0, 0] == pytest.approx(2.0)
    episode = cr.planning.rollout(task, [0])
    assert (len(episode), episode.truncated, episode.terminated) == (1, True, False)
    met = cr.learning.greedy_rollouts(phi, episodes=3)
    assert met.lengths.tolist() == [1, 1, 1]
    assert met.bootstrap_discount.tolist() == [0.5, 0.5, 0.5]


def test_a_time_limit_reaches_the_environment():
    task = cr.from_gymnasium("Taxi-v4", discount=0.9, time_limit=300, live=True)
    env = task.make()
    assert env.spec.max_episode_steps == 300
    result = cr.learn(task, budget=600, evaluation=OFF, learner=cr.QLearning(epsilon=1.0))
    assert result.episodes_used[0] == 2


def test_code_is_compiled_once_for_all_environments():
    from curricle.learning.q_learning import train_q_learning
    from curricle.tasks.overloads import compiled

    cr.learn(watched([]), budget=10, evaluation=OFF)
    before = len(compiled(train_q_learning, False).signatures)
    cr.learn(watched([]), budget=10, evaluation=OFF, seeds=3)
    assert len(compiled(train_q_learning, False).signatures) == before


# -- what goes wrong in an environment -----------------------------------------------------------


class Trouble(Exception):
    pass


ERRORS = [Trouble("x"), KeyboardInterrupt(), SystemExit(3), StopIteration()]
LOOPS = {
    "fast": {},
    "general": {"learner": cr.SARSA()},
    "double": {"learner": cr.DoubleQLearning()},
    "sparse": {"storage": cr.Storage("sparse")},
    "episodes": {"budget": cr.Episodes(10_000)},
}


@pytest.mark.parametrize("loop", LOOPS)
@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_what_an_environment_raises_surfaces_as_it_is(error, loop, capfd):
    log = []

    def fail(log):
        if log.count("step") == 40:
            raise error

    task = watched(log, fail)
    log.clear()
    with pytest.raises(type(error)) as caught:
        cr.learn(
            task,
            **{"budget": 10**9, "eval_freq": 10**6, "seeds": 3, "evaluation": OFF, **LOOPS[loop]},
        )
    assert caught.value is error
    assert log.count("step") == 40  # at once, and no other seed was begun
    assert log.count("open") == log.count("close") == 1
    assert capfd.readouterr() == ("", "")


def test_a_guarded_run_stops_too():
    def fail(log):
        if log.count("step") == 40:
            raise Trouble

    task = watched([], fail)
    phi = cr.StateActionPotential(task, np.ones((2, 2)))
    with pytest.raises(Trouble):
        cr.learn(
            task,
            budget=10**9,
            eval_freq=10**6,
            shaping=cr.QInitialisation(phi, guard=cr.Guard()),
            evaluation=OFF,
        )


def fails_at(line, number):
    def fail(log):
        if sum(entry.startswith(line) for entry in log) == number:
            raise Trouble(line)

    return fail


@pytest.mark.parametrize(("line", "number"), [("seed", 1), ("reset", 1), ("seed", 2), ("step", 3)])
def test_failures_anywhere_close_what_was_opened(line, number):
    log = []
    task = watched(log, fails_at(line, number))
    log.clear()
    with pytest.raises(Trouble, match=line):
        cr.learn(task, budget=10_000)
    assert log.count("open") == log.count("close") > 0


def test_failures_outside_of_learning_surface_too():
    task = watched([], fails_at("step", 4))
    phi = cr.StateActionPotential(task, np.zeros((2, 2)))
    for work in (
        lambda: [cr.planning.rollout(task, [0, 0], seed=seed) for seed in range(9)],
        lambda: cr.learning.greedy_rollouts(phi, episodes=100),
        lambda: cr.calibrate(phi),
    ):
        task.make().log.clear()
        with pytest.raises(Trouble):
            work()


def test_an_environment_that_cannot_be_made_or_closed_says_so():
    class Unclosable(Ring):
        def close(self):
            raise Trouble("close")

    spaces_of_ring = cr.Space([cr.Component("s", 3)]), cr.Space([cr.Component("a", 2)])
    with pytest.raises(Trouble, match="close"):
        cr.learn(cr.tasks.LiveMDP(*spaces_of_ring, Unclosable), budget=10)

    def nothing():
        raise Trouble("make")

    with pytest.raises(Trouble, match="make"):
        cr.learn(cr.tasks.LiveMDP(*spaces_of_ring, nothing), budget=10)


def test_an_interrupt_from_the_keyboard_stops_learning():
    log = []

    def fail(log):
        if log.count("step") == 30:
            _thread.interrupt_main(signal.SIGINT)

    task = watched(log, fail)
    with pytest.raises(KeyboardInterrupt):
        cr.learn(task, budget=10**9, eval_freq=10**6, seeds=2, workers=2)
    assert log.count("open") == log.count("close")


@pytest.mark.parametrize("shown", [2, -1, 1.5, "x", (0, 0), np.array([1, 1])])
def test_an_observation_that_is_no_state_is_refused(shown):
    task = cr.from_gymnasium(lambda: Echo(TWO, TWO, [0, shown, 0]), discount=0.9)
    with pytest.raises(
        cr.errors.TaskError, match=r"must encode to a state, a number in 0\.\.1 or .* state"
    ):
        cr.learn(task, budget=10, evaluation=OFF)


@pytest.mark.parametrize(
    "answer", [(0, None, False, False, {}), (0, "x", False, False, {}), (0, 1.0)]
)
def test_steps_that_are_none_surface(answer):
    class Odd(Ring):
        def step(self, action):
            return answer

    with pytest.raises((TypeError, ValueError)):
        cr.learn(cr.from_gymnasium(Odd, discount=0.9, live=True), budget=10, evaluation=OFF)


# -- live tasks in the rest of the library ---------------------------------------------------------


def lake(**settings):
    return cr.from_gymnasium("FrozenLake-v1", discount=0.95, is_slippery=False, **settings)


def test_a_live_target_is_taught_by_tables():
    tabled, live = lake(), lake(live=True)
    plan = cr.Curriculum(
        tasks={"tabled": tabled, "live": live},
        transfers=[cr.Transfer("tabled", "live", cr.project(live, tabled), calibrate=True)],
        budget={"tabled": 5000, "live": 2000},
        learner=cr.QLearning(learning_rate=0.5, epsilon=0.3),
        eval_freq={"live": 500},
    )
    result = plan.train(seeds=2)
    assert result["live"].greedy_return[:, 0] == pytest.approx([0.95**5] * 2)
    foreseen = cr.forecast(plan, seeds=1, episodes=5)
    assert not foreseen.solved
    assert foreseen["mean"].mean("start") == pytest.approx(0.95**5)
    found = cr.compare(plan, seeds=2, controls=["scaled"])
    assert found.arms["transfer"].curve.values[:, 0] == pytest.approx([0.95**5] * 2)
    checked = cr.certify(live, result.potentials["live"][0])
    assert checked.findings[0].startswith("no contradiction")


def test_what_needs_tables_is_refused_in_words():
    tabled, live = lake(), lake(live=True)
    edge = cr.Transfer("tabled", "live", cr.project(live, tabled))
    plan = cr.Curriculum(tasks={"tabled": tabled, "live": live}, transfers=[edge])
    for work in (
        lambda: cr.solve(live),
        lambda: cr.evaluate(live, np.zeros(16, int)),
        lambda: cr.learn(live, budget=10, evaluation=cr.GreedyEvaluation("exact")),
        lambda: cr.compare(plan, seeds=2, controls=["placebo"]),
    ):
        with pytest.raises(cr.errors.TaskError, match="played live has no tables to look at"):
            work()
    with pytest.raises(cr.errors.SettingError, match="starts where its episodes do: start was 3"):
        cr.planning.rollout(live, np.zeros(16, int), start=3)
    with pytest.raises(cr.errors.SettingError, match="a live task starts where its episodes do"):
        cr.certify(live, lambda s, a, after: 1.0 * (a == 1), "reward")
    with pytest.raises(
        cr.errors.SettingError, match="budget in episodes needs a task with a time limit"
    ):
        cr.learn(cr.from_gymnasium(Ring, discount=0.9, live=True), budget=cr.Episodes(3))


def test_a_comparison_without_evaluation_is_refused():
    plan = cr.Curriculum(tasks={"lake": lake()}, evaluation=OFF, budget=100)
    with pytest.raises(
        cr.errors.SettingError, match="rests on greedy evaluation: that of 'lake' is off"
    ):
        cr.compare(plan, seeds=2)


def test_rollouts_of_tasks_given_by_functions():
    def step(n, state, action, bits):
        return state + action, -1.0, state + action == n - 1

    line = cr.ComputedMDP(cr.Space([cr.Component("place", 4)]), cr.Space([cr.Component("go", 2)]),
                          lambda n, bits: 0, step, data=4)  # fmt: skip
    episode = cr.planning.rollout(line, np.ones(4, int))
    assert episode.states.tolist() == [0, 1, 2, 3]
    assert episode.terminated
    chance = np.full((4, 2), 0.5)
    some = [len(cr.planning.rollout(line, chance, seed=seed)) for seed in range(20)]
    assert len(set(some)) > 3
    assert cr.planning.rollout(line, np.zeros(4, int), steps=7).truncated
