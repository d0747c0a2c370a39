"""Potentials that are values of observations, in the Gymnasium wrappers, without a network."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, Discrete, MultiBinary, MultiDiscrete, Text, Tuple
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.vector.utils import concatenate, create_empty_array
from gymnasium.wrappers import TimeLimit
from hypothesis import given, strategies as st

import curricle as cr
from curricle.errors import SettingError
from curricle.interop.gymnasium import observation_task
from curricle.interop.potential_shaping import PotentialShaping, VectorPotentialShaping
from curricle.tasks.observation_task import stack
from curricle.transfer.aggregation import aggregate, aggregate_numbers
from curricle.transfer.observation_mapping import FunctionValues, TableValues
from curricle.transfer.potentials import ObservationPotential

SIZE, DISCOUNT, LIMIT = 5, 0.9, 4
PHI = np.array([3.0, -2.0, 5.0, 1.0, np.nan])  # the value of the end is never read
PAIRS = np.nan_to_num(np.stack([PHI - 1, PHI], axis=1), nan=0.0)
HOT = Box(0, 1, (SIZE,))


def one_hot(state):
    return np.eye(SIZE, dtype=np.float32)[state]


def in_parts(state):
    return {"state": state, "more": (one_hot(state), state % 2)}


SEEN = {
    "vectors": (HOT, one_hot, lambda o: PHI[o.argmax(axis=1)]),
    "numbers": (Discrete(SIZE), int, lambda o: PHI[o]),
    "dicts": (
        Dict({"state": Discrete(SIZE), "more": Tuple([HOT, Discrete(2)])}),
        in_parts,
        lambda o: PHI[o["more"][0].argmax(axis=1)],
    ),
    "tuples": (
        Tuple([Discrete(2), HOT]),
        lambda state: (state % 2, one_hot(state)),
        lambda o: PHI[o[1].argmax(axis=1)],
    ),
}


class Walk(gym.Env):
    """Cells in a row, walked at random; the last is the end."""

    action_space = Discrete(2)

    def __init__(self, space, observe):
        self.observation_space, self.observe = space, observe

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.cell = int(self.np_random.integers(SIZE - 1))
        return self.observe(self.cell), {}

    def step(self, action):
        self.cell = int(np.clip(self.cell + self.np_random.choice([-1, 1]), 0, SIZE - 1))
        return self.observe(self.cell), -1.0, self.cell == SIZE - 1, False, {}


def walk(space=SEEN["numbers"][0], observe=int):
    return TimeLimit(Walk(space, observe), LIMIT)


def paid(env, steps=100):
    rewards, _ = [], env.reset(seed=0)
    for _ in range(steps):
        _, reward, terminated, truncated, _ = env.step(0)
        rewards.append(reward)
        if terminated or truncated:
            env.reset()
    return rewards


def paid_in_vectors(envs, steps=100):
    rewards, _ = [], envs.reset(seed=0)
    for _ in range(steps):
        _, reward, terminated, truncated, _ = envs.step(np.zeros(envs.num_envs, int))
        rewards.append(reward)
        ended = terminated | truncated
        if envs.metadata["autoreset_mode"] is AutoresetMode.DISABLED and ended.any():
            envs.reset(options={"reset_mask": ended})
    return np.array(rewards)


@pytest.mark.parametrize("seen", SEEN)
def test_values_of_observations_pay_what_their_numbers_do(seen):
    space, observe, read = SEEN[seen]
    values = FunctionValues(state_values=read)
    shaped = PotentialShaping(walk(space, observe), values, discount=DISCOUNT)
    plain = PotentialShaping(walk(), PHI.__getitem__, discount=DISCOUNT)
    assert paid(shaped) == paid(plain)


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("seen", SEEN)
def test_so_they_do_in_vectors(seen, mode):
    space, observe, read = SEEN[seen]
    envs = SyncVectorEnv([lambda: walk(space, observe)] * 3, autoreset_mode=mode)
    values = FunctionValues(state_values=read)
    shaped = VectorPotentialShaping(envs, values, discount=DISCOUNT)
    envs = SyncVectorEnv([walk] * 3, autoreset_mode=mode)
    plain = VectorPotentialShaping(envs, PHI.__getitem__, discount=DISCOUNT)
    np.testing.assert_array_equal(paid_in_vectors(shaped), paid_in_vectors(plain))


class Calls(TableValues):
    """A table that keeps how many states it was asked for."""

    def v(self, observations):
        self.__dict__.setdefault("sizes", []).append(len(observations))
        return super().v(observations)


def test_vectors_are_read_in_one_go():
    values = Calls(PAIRS)
    envs = SyncVectorEnv([walk] * 3, autoreset_mode=AutoresetMode.SAME_STEP)
    shaped = VectorPotentialShaping(envs, values, discount=DISCOUNT)
    paid_in_vectors(shaped, steps=50)
    assert len(values.sizes) == 51
    assert max(values.sizes) > 3


def test_a_potential_over_observations_states_the_discount_and_the_space():
    task = observation_task(walk, discount=0.8)
    phi = ObservationPotential.of(task, TableValues(PAIRS))
    env = PotentialShaping(walk(), phi)
    assert env.discount == 0.8
    expected = PotentialShaping(walk(), np.nan_to_num(PHI).__getitem__, discount=0.8)
    assert paid(env) == paid(expected)
    with pytest.raises(SettingError, match=r"0.8 by the task of 'potential', 0.9 by the argument"):
        PotentialShaping(walk(), phi, discount=0.9)
    with pytest.raises(SettingError, match="read from those of its task: 'potential' is one of"):
        PotentialShaping(walk(HOT, one_hot), phi)
    with pytest.raises(SettingError, match="a discount must be given"):
        PotentialShaping(walk(), TableValues(np.zeros((SIZE, 1))))


@given(st.data())
def test_observations_are_stacked_as_gymnasium_stacks_them(data):
    spaces = [HOT, Discrete(7, start=3), MultiDiscrete([2, 3]), MultiBinary(4), SEEN["dicts"][0]]
    space = data.draw(st.sampled_from([*spaces, SEEN["tuples"][0], Text(5)]))
    space.seed(data.draw(st.integers(0, 99)))
    rows = [space.sample() for _ in range(data.draw(st.integers(1, 4)))]
    expected = concatenate(space, rows, create_empty_array(space, len(rows)))
    assert_same(stack(space, rows), expected)


def assert_same(one, other):
    assert type(one) is type(other)
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        one, other = tuple(one.values()), tuple(other.values())
    if isinstance(one, tuple):
        for each, its in zip(one, other, strict=True):
            assert_same(each, its)
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    else:
        assert one == other


def sideways(potentials):
    return potentials[0] - 1


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=12))
def test_numbers_are_aggregated_as_arrays_are(numbers):
    column = np.array(numbers).reshape(-1, 1, 1)
    for function in (cr.mean, cr.total, cr.maximum, cr.minimum, sideways):
        expected = aggregate(function, column)[0, 0]
        assert aggregate_numbers(function, numbers) == pytest.approx(expected, rel=1e-12, abs=1e-7)
