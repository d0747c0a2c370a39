"""Shaping vector environments, beside an oracle that steps them one by one."""

import re
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics as RecordVectorStatistics

import curricle as cr
from curricle.errors import SettingError
from curricle.interop.potential_shaping import VectorPotentialShaping

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
    actions_of,
    as_picture,
    run_episode,
    table,
    task,
    vector_steps,
    world,
)


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
        found = []
        for i, env in enumerate(envs):
            if mode is AutoresetMode.NEXT_STEP and over[i]:
                states[i], over[i], totals[i] = env.reset()[0], False, 0.0
                found.append((0.0, 0.0, 0.0, False, False, 0.0))
                continue
            following, reward, terminated, truncated, _ = env.step(row[i])
            after = 0.0 if terminated else PHI[following]
            shaping = DISCOUNT * after - PHI[states[i]]
            over[i], states[i] = terminated or truncated, following
            totals[i] += reward
            told = totals[i] if over[i] else 0.0
            found.append((reward + shaping, shaping, after, True, over[i], told))
            if over[i] and mode is not AutoresetMode.NEXT_STEP:
                states[i], totals[i] = env.reset()[0], 0.0
        yield tuple(np.array(column) for column in zip(*found, strict=True))


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
def test_statistics_inside_stay_unshaped_in_vectors(mode):
    def recorded():
        return RecordVectorStatistics(SyncVectorEnv([world] * 2, autoreset_mode=mode))

    actions = actions_of(80, 2)
    shaped = VectorPotentialShaping(recorded(), table, discount=DISCOUNT)
    runs = zip(vector_steps(shaped, actions), vector_steps(recorded(), actions), strict=True)
    n_ended = 0
    for (_, infos), (_, plain) in runs:
        assert ("episode" in infos) == ("episode" in plain)
        if "episode" in infos:
            n_ended += infos["_episode"].sum()
            np.testing.assert_array_equal(infos["episode"]["r"], plain["episode"]["r"])
            np.testing.assert_array_equal(infos["_episode"], infos["_original_return"])
            if mode is AutoresetMode.NEXT_STEP:
                np.testing.assert_allclose(
                    infos["episode"]["r"], infos["original_return"], atol=1e-12
                )
    assert n_ended > 10


def as_dict(state):
    return {"row": state // 3, "picture": as_picture(state)}


DICT = gym.spaces.Dict({"row": gym.spaces.Discrete(2), "picture": PICTURE})


@pytest.mark.parametrize("mode", MODES)
def test_nested_observations_are_batched_as_gymnasium_batches_them(mode):
    actions = actions_of(60, 3)
    make = partial(world, observe=as_dict, space=DICT)
    runs = []
    for potential, batched in (
        (lambda o: o["picture"] @ PHI + o["row"], True),
        (lambda o: float(o["picture"] @ PHI + o["row"]), False),
    ):
        envs = VectorPotentialShaping(
            SyncVectorEnv([make] * 3, autoreset_mode=mode), potential, discount=DISCOUNT,
            batched=batched,
        )  # fmt: skip
        runs.append([rewards for rewards, _ in vector_steps(envs, actions)])
    np.testing.assert_allclose(*runs, atol=1e-12)


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
    for given in ({"potential": potential, "batched": True, **settings}, {"potential": table}):
        made = SyncVectorEnv([world] * 2, autoreset_mode=mode)
        envs = VectorPotentialShaping(made, discount=DISCOUNT, **given)
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
