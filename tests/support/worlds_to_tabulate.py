"""Small environments, most of which have something that a table must not get wrong."""

import random
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv


class Corridor(gym.Env):
    """A corridor of cells with a lamp; the goal at its end counts only in the light."""

    def __init__(self, cells=4):
        self.observation_space = spaces.MultiDiscrete([cells, 2])
        self.action_space = spaces.Discrete(3)
        self.cells = cells

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place, self.lit = int(self.np_random.integers(self.cells - 1)), False
        return self.seen(), {}

    def seen(self):
        return np.array([self.place, self.lit])

    def step(self, action):
        if action == 2:
            self.lit = not self.lit
        else:
            self.place = min(max(self.place + (1 if action else -1), 0), self.cells - 1)
        over = self.place == self.cells - 1
        return self.seen(), float(over and self.lit), over, False, {}


class Counting(Corridor):
    """Counts its steps, for ever."""

    def reset(self, *, seed=None, options=None):
        self.taken = 0
        return super().reset(seed=seed)

    def step(self, action):
        self.taken += 1
        return super().step(action)


class Toggles(Corridor):
    """Counts how often the lamp was switched, for ever."""

    def reset(self, *, seed=None, options=None):
        self.switched = 0
        return super().reset(seed=seed)

    def step(self, action):
        self.switched += action == 2
        return super().step(action)


class Unseeded(Corridor):
    """A reset draws from a generator of its own, which no seed reaches."""

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place = random.Random().randrange(self.cells - 1)
        return self.seen(), {}


class OldReset(Corridor):
    """A reset takes no seed, as it did before Gymnasium."""

    def reset(self):
        return super().reset()


class OldStep(Corridor):
    """Steps return what they did before Gymnasium: four parts."""

    def step(self, action):
        seen, reward, terminated, _, info = super().step(action)
        return seen, reward, terminated, info


class OwnClock(Counting):
    """Truncates by a clock of its own."""

    def step(self, action):
        *result, over, _, info = super().step(action)
        return *result, over, self.taken >= 3, info


class Slippery(Corridor):
    """Steps fail at random; `where` says where the random numbers come from."""

    def __init__(self, where, chance=0.5):
        super().__init__()
        self.where, self.chance = where, chance
        self.own, self.old = np.random.default_rng(0), random.Random(0)
        self.dice = SimpleNamespace(rng=np.random.Generator(np.random.Philox(0)))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=0)
        self.place = 0
        return self.seen(), {}

    def step(self, action):
        draw = {
            "environment": lambda: self.np_random.random(),
            "attribute": lambda: self.own.random(),
            "standard library": lambda: self.old.random(),
            "attribute of an attribute": lambda: self.dice.rng.random(),
            "nobody's": lambda: random.random(),
        }[self.where]()
        return super().step(action if draw >= self.chance else 0)


class Flickering(Corridor):
    """What is seen is random, and nothing else."""

    def seen(self):
        return np.array([self.place, int(self.np_random.integers(2))])


class Dark(Corridor):
    """The lamp is not seen."""

    def __init__(self, cells=4):
        super().__init__(cells)
        self.observation_space = spaces.Discrete(cells)

    def seen(self):
        return self.place


class Uncopyable(Corridor):
    def __init__(self):
        super().__init__()
        self.file = open(__file__)  # noqa: SIM115

    def close(self):
        self.file.close()


class Unreadable(Corridor):
    """Can be copied, but holds what has no parts to be compared."""

    def __init__(self):
        super().__init__()
        self.part = Opaque()


class OfNoModule(type):
    """A type without a module, as SWIG makes them for Box2D."""

    @property
    def __module__(cls):
        raise AttributeError("__module__")


class Opaque(metaclass=OfNoModule):
    __slots__ = ()

    def __deepcopy__(self, memo):
        return self

    def __reduce_ex__(self, protocol):
        raise TypeError("no parts")


class Written(gym.Env):
    """An MDP written down: successors and rewards (S, A), terminal (S,); starts in state 0."""

    def __init__(self, after, reward, terminal):
        self.after, self.reward, self.terminal = after, reward, terminal
        self.observation_space = spaces.Discrete(len(after))
        self.action_space = spaces.Discrete(after.shape[1])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.now = 0
        return self.now, {}

    def step(self, action):
        reward, self.now = float(self.reward[self.now, action]), int(self.after[self.now, action])
        return self.now, reward, bool(self.terminal[self.now]), False, {}


class Listed(FrozenLakeEnv):
    """An environment of Gymnasium's that is nothing but its table: outcomes of each pair."""

    def __init__(self, table, start):
        super().__init__()
        self.observation_space = spaces.Discrete(len(table))
        self.action_space = spaces.Discrete(len(table[0]))
        self.P = dict(enumerate(map(dict, map(enumerate, table))))
        self.initial_state_distrib = np.asarray(start)


def assert_same_tables(first, second):
    """Two tasks lead alike from state to state, bit for bit."""
    for name in ("next_state", "reward", "terminal", "start"):
        np.testing.assert_array_equal(getattr(first.mdp, name), getattr(second.mdp, name))
