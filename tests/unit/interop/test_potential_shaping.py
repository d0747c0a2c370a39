"""Shaping of environments, beside oracles that write gamma Phi(s') - Phi(s) out."""

import copy
import pickle
import re
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import Autoreset

import curricle as cr
from curricle.errors import PotentialError
from curricle.interop.potential_shaping import PotentialShaping

from .shaping import (
    DISCOUNT,
    LIMIT,
    MODES,
    N_STATES,
    NONE,
    PHI,
    PICTURE,
    RNG,
    SOME,
    World,
    actions_of,
    as_picture,
    by_function,
    episodes_of,
    paid,
    run_episode,
    shaped_steps,
    table,
    task,
    world,
)


@pytest.mark.parametrize("discount", [0.0, DISCOUNT, 1.0])
@pytest.mark.parametrize(("terminal", "limit"), [(SOME, LIMIT), (SOME, 10**6), (NONE, LIMIT)])
def test_each_step_gets_what_the_oracle_writes_out(terminal, limit, discount):
    actions = actions_of(300)
    env = PotentialShaping(world(terminal, limit), table, discount=discount)
    steps = iter(shaped_steps(env, actions))
    for episode in episodes_of(world(terminal, limit), actions):
        total = 0.0
        for place, (state, reward, following, terminated) in enumerate(episode):
            after = 0.0 if terminated else PHI[following]
            shaping = discount * after - PHI[state]
            got, info = next(steps)
            total += reward
            assert got == reward + shaping
            assert info["original_reward"] == reward
            assert info["shaping"] == shaping
            assert info["shaping_terms"] == {"potential": shaping}
            assert info["potential"] == after
            assert info["at"] == 1
            if place == len(episode) - 1 and "original_return" in info:
                assert info["original_return"] == pytest.approx(total, abs=1e-12)
                assert abs(info["telescoping_residual"]) < 1e-12
    assert next(steps, None) is None


def test_a_reset_is_no_step_of_a_weight_that_changes():
    weight = cr.learning.linear(1.0, 0.0, steps=50)
    env = PotentialShaping(Autoreset(world()), table, discount=DISCOUNT, weight=weight)
    state, _ = env.reset(seed=0)
    taken, over = 0, False
    for action in actions_of(40).tolist():
        following, _, terminated, truncated, info = env.step(action)
        if not over:
            taken += 1
            before, after = (1 - (taken - 1) / 50, 1 - taken / 50)
            ahead = 0.0 if terminated else after * PHI[following]
            assert info["shaping"] == pytest.approx(DISCOUNT * ahead - before * PHI[state])
        over, state = terminated or truncated, following
    assert 20 < taken < 40


def test_an_environment_that_resets_itself_keeps_the_reward_of_its_reset():
    env = PotentialShaping(Autoreset(world()), table, discount=DISCOUNT)
    state, _ = env.reset(seed=0)
    over, resets = False, 0
    for action in actions_of(100).tolist():
        following, reward, terminated, truncated, info = env.step(action)
        if over:
            resets += 1
            assert (reward, info["shaping"], info["potential"]) == (0.0, 0.0, PHI[following])
            assert info["begun"] == 1
        else:
            after = 0.0 if terminated else PHI[following]
            assert info["shaping"] == DISCOUNT * after - PHI[state]
            assert reward == info["original_reward"] + info["shaping"]
        over, state = terminated or truncated, following
    assert resets > 5


def test_gymnasiums_own_checker_passes(monkeypatch):
    lake, said = gym.make("FrozenLake-v1", disable_env_checker=True), []
    env = PotentialShaping(lake, lambda square: square / 15, discount=0.9)
    monkeypatch.setattr(gym.logger, "warn", lambda message, *rest, **settings: said.append(message))
    check_env(env, skip_render_check=True)  # pictures of the lake need pygame
    # It says of every wrapper that it is one.
    assert [text for text in said if "different from the unwrapped version" not in text] == []


def lake_potential():
    lake = gym.make("FrozenLake-v1")
    mdp = cr.FiniteMDP.from_outcomes(lake.unwrapped.P, start=0, discount=0.9, time_limit=100)
    return cr.StatePotential(mdp, np.linspace(0, 1, 16))


def followed(env, actions):
    return [env.step(action)[:4] for action in actions]


def test_the_spec_makes_the_same_environment_again():
    env = PotentialShaping(gym.make("FrozenLake-v1"), lake_potential(), weight=0.5)
    again = gym.make(env.spec)
    assert isinstance(again, PotentialShaping)
    assert str(again) == str(env)
    assert again.spec.additional_wrappers[-1].kwargs["weight"] == 0.5
    env.reset(seed=1)
    again.reset(seed=1)
    assert followed(again, [1, 1, 2]) == followed(env, [1, 1, 2])


@pytest.mark.parametrize("clone", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_goes_on_where_the_original_is(clone):
    env = PotentialShaping(
        gym.make("FrozenLake-v1"), lake_potential(), weight=cr.learning.linear(1.0, 0.0, steps=9)
    )
    env.reset(seed=0)
    env.step(2)
    twin = clone(env)
    assert followed(twin, [2, 2, 1]) == followed(env, [2, 2, 1])


def test_ends_have_potential_0_under_any_aggregate():
    shaped = partial(PotentialShaping, world(), discount=DISCOUNT)
    inverted = shaped(lambda s: np.exp(PHI[s]), aggregate=lambda p: 1 / p[0])
    expected = paid(shaped(lambda s: 1 / np.exp(PHI[s])))
    np.testing.assert_allclose(paid(inverted), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("potential", "settings"),
    [
        (lambda s: np.where(SOME[s], np.nan, PHI[s]), {"discount": DISCOUNT}),
        (cr.StatePotential(task(), PHI), {"encode": lambda s: 99 if SOME[s] else s}),
    ],
)
def test_potentials_may_be_invalid_at_ends(potential, settings):
    assert paid(PotentialShaping(world(), potential, **settings)) == by_function()


@pytest.mark.parametrize("mode", MODES)
def test_sub_environments_of_a_vector_are_shaped_one_by_one(mode):
    def made(*wrappers):
        make = partial(gym.make_vec, "World-v0", 2, "sync", {"autoreset_mode": mode})
        return make(wrappers=wrappers, terminal=SOME)

    gym.register("World-v0", world)
    try:
        plain = made()
        shaped = made(partial(PotentialShaping, potential=table, discount=DISCOUNT))
    finally:
        del gym.registry["World-v0"]
    shaped.reset(seed=10)
    states, _ = plain.reset(seed=10)
    over, n_ended = np.zeros(2, bool), 0
    for row in actions_of(60, 2):
        stepped = ~over if mode is AutoresetMode.NEXT_STEP else ~np.zeros(2, bool)
        following, rewards, terminated, truncated, infos = plain.step(row)
        paid_more, over = shaped.step(row)[1] - rewards, terminated | truncated
        arrived = following.copy()
        if mode is AutoresetMode.SAME_STEP and over.any():
            arrived[over] = infos["final_obs"][over].astype(int)
        shaping = DISCOUNT * np.where(terminated, 0.0, PHI[arrived]) - PHI[states]
        np.testing.assert_allclose(paid_more, np.where(stepped, shaping, 0.0), atol=1e-12)
        n_ended, states = n_ended + over.sum(), following
        if mode is AutoresetMode.DISABLED and over.any():
            shaped.reset(options={"reset_mask": over.copy()})
            states, _ = plain.reset(options={"reset_mask": over.copy()})
    assert n_ended > 5


def test_time_is_counted_in_steps_of_the_environment():
    frames = RNG.normal(size=(2, N_STATES))
    weight = cr.learning.linear(1.0, 0.0, steps=200)
    phi = cr.StatePotential(task(), frames, frame_steps=[0, 20], weight=weight)
    env = PotentialShaping(world(), phi, weight=cr.learning.linear(1.0, 2.0, steps=90))
    state, _ = env.reset(seed=0)
    for taken, action in enumerate(actions_of(60)):
        following, _, terminated, truncated, info = env.step(action)
        after = (1 + min(1, (taken + 1) / 90)) * phi.at(taken + 1)[following]
        after = 0.0 if terminated else after
        expected = DISCOUNT * after - (1 + min(1, taken / 90)) * phi.at(taken)[state]
        assert info["shaping"] == pytest.approx(expected, abs=1e-12)
        state = env.reset()[0] if terminated or truncated else following


class Clock:
    """A potential that depends on something else than the observation."""

    calls = 0

    def __call__(self, observation):
        self.calls += 1
        return float(self.calls)


def test_a_potential_of_something_else_is_refused_at_the_end():
    env = PotentialShaping(world(NONE), Clock(), discount=DISCOUNT)
    # Phi was 1 at the start and is 9 there at the end of 7 steps.
    said = "Phi depends on the observation alone: it is off by 8 after 7 steps"
    with pytest.raises(PotentialError, match=re.escape(said)):
        run_episode(env)


def test_rounding_is_allowed_where_the_start_has_potential_0():
    first = World(NONE).reset(seed=0)[0]
    values = 1e9 * (PHI - PHI[first])
    settings = {"discount": 1.0, "tolerance": 1e-11}
    long = partial(world, NONE, limit=3000)
    env = PotentialShaping(long(), values.__getitem__, **settings)
    assert run_episode(env)["telescoping_residual"] != 0.0


@pytest.mark.parametrize("seed", range(5))
def test_observations_may_be_written_over(seed):
    buffer = np.zeros(N_STATES, np.float32)

    def observe(state):
        buffer[:] = as_picture(state)
        return buffer

    single = world(NONE, observe=observe, space=PICTURE)
    env = PotentialShaping(single, lambda picture: picture @ PHI, discount=DISCOUNT)
    assert abs(run_episode(env, seed)["telescoping_residual"]) < 1e-12
