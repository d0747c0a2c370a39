"""Potentials that are values of observations, in the Gymnasium wrappers, without a network."""

import numpy as np
import pytest
from gymnasium.spaces import Dict, Discrete, MultiBinary, MultiDiscrete, Text, Tuple
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.vector.utils import concatenate, create_empty_array
from hypothesis import given, strategies as st

import curricle as cr
from curricle.errors import PotentialError, SettingError
from curricle.interop.gymnasium import observation_task
from curricle.interop.potential_shaping import PotentialShaping, VectorPotentialShaping
from curricle.tasks.observation_task import stack
from curricle.transfer.aggregate import aggregate, aggregate_numbers
from curricle.transfer.observation_mapping import FunctionValues, TableValues
from curricle.transfer.potential import ObservationPotential

from .shaping import (
    DISCOUNT,
    N_STATES,
    PHI as TABLE,
    PICTURE,
    SOME,
    actions_of,
    as_picture,
    paid,
    vector_steps,
    world,
)

PHI = np.where(SOME, np.nan, TABLE)  # the value of the end is never read
PAIRS = np.stack([TABLE - 2, TABLE - 1, TABLE], axis=1)


def paid_in_vectors(envs, steps=100):
    return np.array([rewards for rewards, _ in vector_steps(envs, actions_of(steps, 3))])


def in_parts(state):
    return {"state": state, "more": (as_picture(state), state % 2)}


SEEN = {
    "vectors": (PICTURE, as_picture, lambda o: PHI[o.argmax(axis=1)]),
    "numbers": (Discrete(N_STATES), int, lambda o: PHI[o]),
    "dicts": (
        Dict({"state": Discrete(N_STATES), "more": Tuple([PICTURE, Discrete(2)])}),
        in_parts,
        lambda o: PHI[o["more"][0].argmax(axis=1)],
    ),
    "tuples": (
        Tuple([Discrete(2), PICTURE]),
        lambda state: (state % 2, as_picture(state)),
        lambda o: PHI[o[1].argmax(axis=1)],
    ),
}


@pytest.mark.parametrize("seen", SEEN)
def test_values_of_observations_pay_what_their_numbers_do(seen):
    space, observe, read = SEEN[seen]
    values = FunctionValues(state_values=read)
    shaped = PotentialShaping(world(observe=observe, space=space), values, discount=DISCOUNT)
    plain = PotentialShaping(world(), PHI.__getitem__, discount=DISCOUNT)
    assert paid(shaped) == paid(plain)


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("seen", SEEN)
def test_so_they_do_in_vectors(seen, mode):
    space, observe, read = SEEN[seen]
    envs = SyncVectorEnv([lambda: world(observe=observe, space=space)] * 3, autoreset_mode=mode)
    values = FunctionValues(state_values=read)
    shaped = VectorPotentialShaping(envs, values, discount=DISCOUNT)
    envs = SyncVectorEnv([world] * 3, autoreset_mode=mode)
    plain = VectorPotentialShaping(envs, PHI.__getitem__, discount=DISCOUNT)
    np.testing.assert_array_equal(paid_in_vectors(shaped), paid_in_vectors(plain))


class Calls(TableValues):
    """A table that keeps how many states it was asked for."""

    def v(self, observations):
        self.__dict__.setdefault("sizes", []).append(len(observations))
        return super().v(observations)


def test_vectors_are_read_in_one_go():
    values = Calls(PAIRS)
    envs = SyncVectorEnv([world] * 3, autoreset_mode=AutoresetMode.SAME_STEP)
    shaped = VectorPotentialShaping(envs, values, discount=DISCOUNT)
    paid_in_vectors(shaped, steps=50)
    assert len(values.sizes) == 51
    assert max(values.sizes) > 3


def test_a_potential_over_observations_states_the_discount_and_the_space():
    task = observation_task(world, discount=0.8)
    phi = ObservationPotential.of(task, TableValues(PAIRS))
    env = PotentialShaping(world(), phi)
    assert env.discount == 0.8
    expected = PotentialShaping(world(), TABLE.__getitem__, discount=0.8)
    assert paid(env) == paid(expected)
    with pytest.raises(SettingError, match=r"0.8 by the task of 'potential', 0.9 by the argument"):
        PotentialShaping(world(), phi, discount=0.9)
    with pytest.raises(SettingError, match="read from those of its task: 'potential' is one of"):
        PotentialShaping(world(observe=as_picture, space=PICTURE), phi)
    with pytest.raises(SettingError, match="a discount must be given"):
        PotentialShaping(world(), TableValues(np.zeros((N_STATES, 1))))


@pytest.mark.parametrize(
    ("read", "said"),
    [
        (lambda o: np.full(len(o), np.inf), "'potential' is inf at observation "),
        (lambda o: np.zeros(2), r"must return shape \(1,\): got \(2,\)"),
    ],
)
def test_values_that_cannot_be_used_are_named(read, said):
    env = PotentialShaping(world(), FunctionValues(state_values=read), discount=DISCOUNT)
    with pytest.raises(PotentialError, match=said):
        env.reset(seed=0)


@given(st.data())
def test_observations_are_stacked_as_gymnasium_stacks_them(data):
    spaces = [
        PICTURE,
        Discrete(7, start=3),
        MultiDiscrete([2, 3]),
        MultiBinary(4),
        SEEN["dicts"][0],
    ]
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
