"""Gymnasium environments with transition tables as tasks, and their names."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.toy_text.cliffwalking import CliffWalkingEnv
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv, generate_random_map
from gymnasium.envs.toy_text.taxi import TaxiEnv
from gymnasium.wrappers import TimeLimit, TransformReward

import curricle as cr

from .environments import OFF, Ring

WORLDS = {
    "lake": ("FrozenLake-v1", {}),
    "large lake": ("FrozenLake-v1", {"map_name": "8x8"}),
    "lake without chance": ("FrozenLake-v1", {"is_slippery": False}),
    "cliff": ("CliffWalking-v1", {}),
    "slippery cliff": ("CliffWalking-v1", {"is_slippery": True}),
    "taxi": ("Taxi-v4", {}),
    "taxi in the rain": ("Taxi-v4", {"is_rainy": True}),
}


@pytest.mark.parametrize("name", WORLDS)
def test_a_table_has_the_outcomes_of_its_environment(name):
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
    evaluation = cr.GreedyEvaluation("exact", discounted=False)
    assert cr.planning.Target.of(lake, evaluation).optimum == pytest.approx(0.74, abs=0.005)
    cliff = cr.from_gymnasium("CliffWalking-v1", discount=0.999, time_limit=100)
    assert cr.planning.Target.of(cliff, evaluation).optimum == -13


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


def test_an_end_that_depends_on_the_transition_is_a_state_of_its_own():
    tabled = cr.from_gymnasium(Ring, discount=0.5)
    live = cr.from_gymnasium(Ring, discount=0.5, live=True)
    assert tabled.states.size == 4
    assert tabled.terminal.tolist() == [False, False, False, True]
    np.testing.assert_array_equal(cr.solve(tabled).action_values[:3, 0], [1.75, 1.5, 1.0])
    learner = cr.QLearning(learning_rate=1.0, epsilon=0.5)
    learnt = [cr.learn(task, learner, 500, evaluation=OFF).values[0] for task in (tabled, live)]
    np.testing.assert_array_equal(learnt[0][:3], learnt[1])
    np.testing.assert_array_equal(learnt[1][:, 0], [1.75, 1.5, 1.0])


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


def test_a_step_of_its_own_is_what_is_learnt_and_tabulated():
    """Random maps: the optimal policy of the tables earns its value where `step` is overridden."""
    for seed in range(5):
        desc = generate_random_map(4, seed=seed)

        def make(desc=desc):
            return Rotated(desc=desc, is_slippery=False)

        task = cr.tabulate(make, discount=0.9, time_limit=50)
        env, solution = make(), cr.solve(task)
        observation, _ = env.reset()
        earned, over, steps = 0.0, False, 0
        while not over and steps < 50:
            action = int(solution.action_values[task.state(observation)].argmax())
            observation, reward, over, *_ = env.step(action)
            earned += 0.9**steps * reward
            steps += 1
        assert solution.start_value > 0
        assert earned == pytest.approx(solution.start_value)
    live = cr.from_gymnasium(make, discount=0.9, time_limit=50)
    assert live.actions.components[0].labels is None  # west leads south
    learnt = cr.learn(live, cr.QLearning(learning_rate=0.5, epsilon=0.3), 20_000, seeds=1)
    assert learnt.greedy_return[0, -1] == pytest.approx(earned)


def test_a_table_that_was_changed_is_read_as_it_is():
    env = gym.make("FrozenLake-v1", is_slippery=False)
    env.unwrapped.P[0] = {a: [(1.0, 15, 7.0, True)] for a in range(4)}
    assert cr.solve(cr.from_gymnasium(env, discount=0.9)).start_value == 7
    with pytest.raises(
        cr.errors.TaskError, match="cannot be made again for each seed; give a function"
    ):
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
