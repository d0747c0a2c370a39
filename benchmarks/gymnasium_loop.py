"""Q-learning as every tutorial writes it: a Gymnasium environment and a NumPy table."""

import gymnasium as gym
import numpy as np

LEARNING_RATE, EPSILON = 0.1, 0.1


class TableEnv(gym.Env):
    """A finite MDP without chance as a Gymnasium environment, as a user would write it."""

    def __init__(self, mdp):
        self.successor, self.pay = outcome_lists(mdp)
        self.ends, self.start = mdp.terminal.tolist(), int(mdp.start_states[0])
        self.observation_space = gym.spaces.Discrete(mdp.states.size)
        self.action_space = gym.spaces.Discrete(mdp.actions.size)
        self.state = 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = self.start
        return self.state, {}

    def step(self, action):
        reward, self.state = self.pay[self.state][action], self.successor[self.state][action]
        return self.state, reward, self.ends[self.state], False, {}


def outcome_lists(mdp):
    """Return the next state and the reward of each state and action of a task without chance.

    As lists: NumPy's scalars would cost a learner more than its own step.
    """
    return mdp.next_state[mdp.outcome_row, 0].tolist(), mdp.reward[mdp.outcome_row, 0].tolist()


def table_env(mdp, limit):
    return gym.wrappers.TimeLimit(TableEnv(mdp), limit)


def frozen_lake():
    return gym.make("FrozenLake-v1", map_name="8x8")  # slippery, cut at 200 steps


def q_learning(env, discount, steps, shape=None, encode=lambda observation: observation):
    """Return the Q-table after so many steps: one of the environment, one update, and so on.

    `encode` makes an observation an index into a table of this shape, (S,) by default.
    """
    q = np.zeros((*(shape or (env.observation_space.n,)), env.action_space.n))
    rng = np.random.default_rng(0)
    state = encode(env.reset(seed=0)[0])
    for _ in range(steps):
        if rng.random() < EPSILON:
            action = int(rng.integers(env.action_space.n))
        else:
            action = int(rng.choice(np.flatnonzero(q[state] == q[state].max())))
        observation, reward, terminated, truncated, _ = env.step(action)
        following = encode(observation)
        target = reward + (0.0 if terminated else discount * q[following].max())
        q[state][action] += LEARNING_RATE * (target - q[state][action])
        state = encode(env.reset()[0]) if terminated or truncated else following
    return q
