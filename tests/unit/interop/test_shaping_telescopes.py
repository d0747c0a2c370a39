"""The sum of what shaping pays in an episode is checked at its end."""

import re
from functools import partial

import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv

from curricle.errors import PotentialError
from curricle.interop.potential_shaping import PotentialShaping, VectorPotentialShaping

from .shaping import (
    DISCOUNT,
    N_STATES,
    NONE,
    PHI,
    PICTURE,
    SomeEnvs,
    World,
    as_picture,
    run_episode,
    world,
)


class Clock:
    """A potential that depends on something else than the observation."""

    calls = 0

    def __call__(self, observation):
        self.calls += 1
        return float(self.calls)

    def batch(self, observations):
        return np.full(len(observations), self(observations))


def test_a_potential_of_something_else_is_refused_at_the_end():
    env = PotentialShaping(world(NONE), Clock(), discount=DISCOUNT)
    # Phi was 1 at the start and is 9 there at the end of 7 steps.
    said = "Phi depends on the observation alone: it is off by 8 after 7 steps"
    with pytest.raises(PotentialError, match=re.escape(said)):
        run_episode(env)
    envs = VectorPotentialShaping(
        SyncVectorEnv([partial(world, NONE)] * 2),
        Clock().batch,
        discount=DISCOUNT,
        batched=True,
    )
    with pytest.raises(PotentialError, match="is off by 7 at the end of an episode of sub-env"):
        run_episode(SomeEnvs(envs))


def test_without_a_tolerance_the_residual_is_only_reported():
    env = PotentialShaping(world(NONE), Clock(), discount=DISCOUNT, tolerance=None)
    assert run_episode(env)["telescoping_residual"] == pytest.approx(8.0, abs=1e-12)


def test_rounding_is_allowed_where_the_start_has_potential_0():
    first = World(NONE).reset(seed=0)[0]
    values = 1e9 * (PHI - PHI[first])
    settings = {"discount": 1.0, "tolerance": 1e-11}
    long = partial(world, NONE, limit=3000)
    env = PotentialShaping(long(), values.__getitem__, **settings)
    assert run_episode(env)["telescoping_residual"] != 0.0
    envs = VectorPotentialShaping(SyncVectorEnv([long]), values.__getitem__, **settings)
    assert run_episode(SomeEnvs(envs))["telescoping_residual"][0] != 0.0


@pytest.mark.parametrize("seed", range(5))
def test_observations_may_be_written_over(seed):
    buffer = np.zeros(N_STATES, np.float32)

    def observe(state):
        buffer[:] = as_picture(state)
        return buffer

    one = world(NONE, observe=observe, space=PICTURE)
    env = PotentialShaping(one, lambda picture: picture @ PHI, discount=DISCOUNT)
    assert abs(run_episode(env, seed)["telescoping_residual"]) < 1e-12
    many = SyncVectorEnv([partial(world, NONE, observe=as_picture, space=PICTURE)] * 2, copy=False)
    envs = VectorPotentialShaping(many, lambda o: o @ PHI, discount=DISCOUNT, batched=True)
    assert (abs(run_episode(SomeEnvs(envs), seed)["telescoping_residual"]) < 1e-12).all()
