"""Shaping of environments, one or many, beside oracles that write gamma Phi(s') - Phi(s) out."""

import copy
import pickle
import re
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import Autoreset

import curricle as cr
from curricle.errors import PotentialError, SettingError
from curricle.interop.potential_shaping import PotentialShaping, VectorPotentialShaping

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
    SomeEnvs,
    World,
    actions_of,
    as_picture,
    episodes_of,
    run_episode,
    shaped_steps,
    table,
    task,
    vector_steps,
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


@pytest.mark.parametrize("batched", [False, True])
@pytest.mark.parametrize("mode", MODES)
def test_ends_have_potential_0_under_any_aggregate(mode, batched):
    runs = []
    for potential, aggregate in ((lambda s: np.exp(PHI[s]), lambda p: 1 / p[0]), (None, None)):
        envs = VectorPotentialShaping(
            SyncVectorEnv([world] * 2, autoreset_mode=mode),
            potential or (lambda s: 1 / np.exp(PHI[s])),
            aggregate=aggregate,
            discount=DISCOUNT,
            batched=batched,
        )
        runs.append([rewards for rewards, _ in vector_steps(envs, actions_of(60, 2))])
    np.testing.assert_array_equal(*runs)


def vector_oracle(mode, actions, terminal, limit):
    """Step one by one, F written out: reward, F, Phi(s'), stepped, ended, original return."""
    n = actions.shape[1]
    envs = [world(terminal, limit) for _ in range(n)]
    states = [env.reset(seed=10 + i)[0] for i, env in enumerate(envs)]
    over, totals = [False] * n, [0.0] * n
    for row in actions.tolist():
        residuals = []
        for i, env in enumerate(envs):
            if mode is AutoresetMode.NEXT_STEP and over[i]:
                states[i], over[i], totals[i] = env.reset()[0], False, 0.0
                residuals.append((0.0, 0.0, 0.0, False, False, 0.0))
                continue
            following, reward, terminated, truncated, _ = env.step(row[i])
            after = 0.0 if terminated else PHI[following]
            shaping = DISCOUNT * after - PHI[states[i]]
            over[i], states[i] = terminated or truncated, following
            totals[i] += reward
            total = totals[i] if over[i] else 0.0
            residuals.append((reward + shaping, shaping, after, True, over[i], total))
            if over[i] and mode is not AutoresetMode.NEXT_STEP:
                states[i], totals[i] = env.reset()[0], 0.0
        yield tuple(np.array(column) for column in zip(*residuals, strict=True))


ENDS = [(SOME, LIMIT), (SOME, 10**6), (NONE, LIMIT)]


@pytest.mark.parametrize("batched", [False, True])
@pytest.mark.parametrize("n", [1, 4])
@pytest.mark.parametrize(("terminal", "limit"), ENDS)
@pytest.mark.parametrize("mode", MODES)
def test_each_sub_environment_gets_what_the_oracle_writes_out(mode, terminal, limit, n, batched):
    actions = actions_of(120, n)
    made = SyncVectorEnv([partial(world, terminal, limit)] * n, autoreset_mode=mode)
    envs = VectorPotentialShaping(made, table, discount=DISCOUNT, batched=batched)
    oracle, n_ended = vector_oracle(mode, actions, terminal, limit), 0
    for (rewards, infos), expected in zip(vector_steps(envs, actions), oracle, strict=True):
        reward, shaping, after, stepped, ended, total = expected
        n_ended += ended.sum()
        np.testing.assert_array_equal(rewards, reward)
        np.testing.assert_array_equal(infos["shaping"], shaping)
        np.testing.assert_array_equal(infos["potential"], after)
        np.testing.assert_allclose(infos["original_reward"], reward - shaping, atol=1e-12)
        np.testing.assert_array_equal(infos["shaping_terms"]["potential"], shaping)
        for name in ("shaping", "potential", "original_reward", "shaping_terms"):
            np.testing.assert_array_equal(infos[f"_{name}"], stepped)
        assert ("original_return" in infos) == ended.any()
        if ended.any():
            np.testing.assert_array_equal(infos["_original_return"], ended)
            np.testing.assert_array_equal(infos["_telescoping_residual"], ended)
            np.testing.assert_allclose(infos["original_return"], total, atol=1e-12)
            assert abs(infos["telescoping_residual"]).max() < 1e-12
    assert n_ended > 5


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(
    ("potential", "settings"),
    [
        (lambda s: np.where(SOME[s], np.nan, PHI[s]), {}),
        (cr.StatePotential(task(), PHI), {"encode": lambda s: np.where(SOME[s], 99, s)}),
    ],
)
def test_potentials_may_be_invalid_at_ends(mode, potential, settings):
    runs = []
    for arguments in ({"potential": potential, "batched": True, **settings}, {"potential": table}):
        made = SyncVectorEnv([world] * 2, autoreset_mode=mode)
        envs = VectorPotentialShaping(made, discount=DISCOUNT, **arguments)
        runs.append([rewards for rewards, _ in vector_steps(envs, actions_of(60, 2))])
    np.testing.assert_array_equal(*runs)


@pytest.mark.parametrize("batched", [False, True])
def test_time_is_counted_over_all_sub_environments(batched):
    frames = RNG.normal(size=(2, N_STATES))
    weight = cr.learning.linear(1.0, 0.0, steps=200)
    phi = cr.StatePotential(task(), frames, frame_steps=[0, 20], weight=weight)
    shaped = VectorPotentialShaping(
        SyncVectorEnv([world] * 2),
        phi,
        batched=batched,
        weight=cr.learning.linear(1.0, 2.0, steps=90),
    )
    states, _ = shaped.reset(seed=0)
    taken, n_ended = 0, 0
    for row in actions_of(60, 2):
        following, _, terminated, _, infos = shaped.step(row)
        stepped = infos["_shaping"]
        now, then = taken, taken + stepped.sum()
        after = np.where(terminated, 0.0, (1 + min(1, then / 90)) * phi.at(then)[following])
        expected = DISCOUNT * after - (1 + min(1, now / 90)) * phi.at(now)[states]
        np.testing.assert_allclose(infos["shaping"], np.where(stepped, expected, 0.0), atol=1e-12)
        states, taken = following, then
        n_ended += infos.get("_telescoping_residual", np.zeros(2)).sum()
    assert n_ended > 10
    assert taken == 120 - n_ended  # each reset takes a step


def test_masked_resets_leave_the_others_where_they_are():
    envs = SyncVectorEnv([partial(world, NONE)] * 3, autoreset_mode=AutoresetMode.DISABLED)
    shaped = VectorPotentialShaping(envs, table, discount=DISCOUNT)
    states, _ = shaped.reset(seed=0)
    shaped.step(np.zeros(3, int))
    options = {"reset_mask": np.array([False, True, False])}
    states, _ = shaped.reset(options=options)
    assert list(options) == ["reset_mask"]
    following, _, _, _, infos = shaped.step(np.zeros(3, int))
    np.testing.assert_array_equal(infos["shaping"], DISCOUNT * PHI[following] - PHI[states])
    for length in (3, 4, 5, 6, 7):
        *_, truncated, infos = shaped.step(np.zeros(3, int))
        np.testing.assert_array_equal(truncated, [length == 7, False, length == 7])
    assert abs(infos["telescoping_residual"]).max() < 1e-12


class Forgetful(gym.vector.VectorWrapper):
    """A vector environment that does not hand over final observations."""

    def step(self, actions):
        *rest, infos = super().step(actions)
        return *rest, {key: value for key, value in infos.items() if "final" not in key}


def test_missing_final_observations_are_refused():
    made = SyncVectorEnv([partial(world, NONE)], autoreset_mode=AutoresetMode.SAME_STEP)
    envs = VectorPotentialShaping(Forgetful(made), table, discount=DISCOUNT)
    with pytest.raises(SettingError, match=re.escape("infos['final_obs']: sub-environment 0 did")):
        run_episode(SomeEnvs(envs))


def test_a_vector_environment_must_say_how_it_resets():
    envs = SyncVectorEnv([world])
    del envs.metadata["autoreset_mode"]
    with pytest.raises(SettingError, match="must say how it resets"):
        VectorPotentialShaping(envs, table, discount=DISCOUNT)


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
        SyncVectorEnv([partial(world, NONE)] * 2), Clock().batch, discount=DISCOUNT, batched=True
    )
    with pytest.raises(PotentialError, match="is off by 7 at the end of an episode of sub-env"):
        run_episode(SomeEnvs(envs))


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

    single = world(NONE, observe=observe, space=PICTURE)
    env = PotentialShaping(single, lambda picture: picture @ PHI, discount=DISCOUNT)
    assert abs(run_episode(env, seed)["telescoping_residual"]) < 1e-12
    many = SyncVectorEnv([partial(world, NONE, observe=as_picture, space=PICTURE)] * 2, copy=False)
    envs = VectorPotentialShaping(many, lambda o: o @ PHI, discount=DISCOUNT, batched=True)
    assert (abs(run_episode(SomeEnvs(envs), seed)["telescoping_residual"]) < 1e-12).all()
