"""MiniGrid levels with some actions or smaller rooms, control on a grid or by force, a bonus."""

import inspect

import gymnasium as gym
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnvWrapper

from curricle.interop import MiniGridView


def walk(env):
    """Return an environment of MiniGrid in which an agent turns and walks."""
    return some_actions(env, 0, 1, 2)


def opens(env):
    """Return an environment in which the agent also opens doors."""
    return some_actions(env, 0, 1, 2, 5)


def fetch(env):
    """Return an environment in which the agent also picks things up."""
    return some_actions(env, 0, 1, 2, 3, 5)


def carry(env):
    """Return an environment in which the agent also lays down what it carries."""
    return some_actions(env, 0, 1, 2, 3, 4, 5)


def go_to(env):
    """Return an environment in which the agent walks and says that it has arrived."""
    return some_actions(env, 0, 1, 2, 6)


def pick_up(env):
    """Return an environment in which the agent walks and picks things up."""
    return some_actions(env, 0, 1, 2, 3)


def some_actions(env, *actions):
    """Return an environment of MiniGrid as zeros and ones, with some of its actions."""
    few = gym.spaces.Discrete(len(actions))
    return gym.wrappers.TransformAction(MiniGridView()(env), actions.__getitem__, few)


def rooms(id, side):
    """Return a level of MiniGrid all of whose rooms have another side, walls included."""
    env = gym.make(id)
    level = env.unwrapped
    level.room_size = side
    level.width, level.height = ((side - 1) * n + 1 for n in (level.num_cols, level.num_rows))
    return env


def car(force):
    """Return the mountain car with another engine than its own, which has force 0.001."""
    env = gym.make("MountainCar-v0")
    env.unwrapped.force = force
    return env


ENDS = {
    "MountainCar-v0": ((-1.2, 0.6), (-0.07, 0.07)),  # position and velocity
    "Pendulum-v1": ((-np.pi, np.pi), (-8.0, 8.0)),  # angle and velocity
    "Acrobot-v1": ((-np.pi, np.pi),) * 2 + ((-2 * np.pi, 2 * np.pi), (-4.5 * np.pi, 4.5 * np.pi)),
}


class Grid(gym.Wrapper):
    """An environment of classic control on a grid of states; each action is held for some steps.

    Its values are those of the environment if its task's discount is discount^held.
    """

    def __init__(self, id, points, held, discount=0.99):
        super().__init__(numbered(gym.make(id).unwrapped))
        self.axes = [np.linspace(*ends, points) for ends in ENDS[id]]
        self.held, self.discount = held, discount

    def reset(self, **options):
        _, info = self.env.reset(**options)
        return self.rounded(), info

    def step(self, action):
        total = 0.0
        for k in range(self.held):
            _, reward, terminated, truncated, info = self.env.step(action)
            total += self.discount**k * float(reward)
            if terminated:
                break
        return self.rounded(), total, terminated, truncated, info

    def rounded(self):
        env = self.unwrapped
        state = np.array(env.state)
        if env.spec.id == "Pendulum-v1":  # its angle is not kept within a turn
            state[0] = (state[0] + np.pi) % (2 * np.pi) - np.pi
            env.last_u = None  # which is drawn alone
        pairs = zip(self.axes, state, strict=True)
        env.state = np.array([axis[np.abs(axis - x).argmin()] for axis, x in pairs])
        seen = getattr(env, "_get_ob", getattr(env, "_get_obs", None))
        return env.state.astype(np.float32) if seen is None else seen()


def numbered(env):
    """Return an environment with five numbered torques in the place of the pendulum's."""
    if isinstance(env.action_space, gym.spaces.Discrete):
        return env
    torques = np.linspace(env.action_space.low, env.action_space.high, 5, dtype=np.float32)
    return gym.wrappers.TransformAction(env, torques.__getitem__, gym.spaces.Discrete(5))


class Counted(VecEnvWrapper):
    """Adds bonus / sqrt(n) to rewards, n the visits of an observation in its unfinished episode."""

    def __init__(self, venv, bonus):
        super().__init__(venv)
        self.bonus, self.visits = bonus, [{} for _ in range(venv.num_envs)]

    def reset(self):
        observations = self.venv.reset()
        self.visits = [{row.tobytes(): 1} for row in observations]
        return observations

    def step_wait(self):
        observations, rewards, dones, infos = self.venv.step_wait()
        rewards = rewards.copy()
        for k, (row, done) in enumerate(zip(observations, dones, strict=True)):
            if done:  # the observation is the first of the next episode
                self.visits[k] = {}
            visits, seen = self.visits[k], row.tobytes()
            visits[seen] = visits.get(seen, 0) + 1
            rewards[k] += 0.0 if done else self.bonus / np.sqrt(visits[seen])
        return observations, rewards, dones, infos


class CountingPPO(PPO):
    """PPO whose rewards have a bonus for observations that are new in an episode."""

    __signature__ = inspect.signature(PPO).replace(
        parameters=[
            *inspect.signature(PPO).parameters.values(),
            inspect.Parameter("bonus", inspect.Parameter.KEYWORD_ONLY, default=0.0),
        ]
    )

    def __init__(self, policy, env, *, bonus=0.0, **settings):
        super().__init__(policy, Counted(env, bonus) if env and bonus else env, **settings)
