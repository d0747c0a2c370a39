"""The shaping wrappers, beside a slow oracle that writes F = gamma Phi(s') - Phi(s) out."""

import copy
import pickle
import re
from contextlib import contextmanager
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import Autoreset, RecordEpisodeStatistics, TimeLimit
from gymnasium.wrappers.vector import RecordEpisodeStatistics as RecordVectorStatistics

import curricle as cr
from curricle.errors import CurriculumError, PotentialError, SettingError
from curricle.interop.potential_shaping import PotentialShaping, VectorPotentialShaping
from curricle.learning.value_lookup import no_sources

N_STATES, N_ACTIONS, DISCOUNT, LIMIT = 6, 3, 0.9, 7
RNG = np.random.default_rng(0)
TRANSITION = RNG.dirichlet(np.full(N_STATES, 0.5), size=(N_STATES, N_ACTIONS))
REWARD = RNG.normal(size=(N_STATES, N_ACTIONS, N_STATES))
PHI = 3 * RNG.normal(size=N_STATES)
SOME = np.arange(N_STATES) == N_STATES - 1
NONE = np.zeros(N_STATES, bool)
MODES = list(AutoresetMode)


class Wander(gym.Env):
    """A random finite MDP; an episode begins anywhere it does not end."""

    def __init__(self, terminal=SOME, observe=int, space=None):
        self.terminal, self.observe = terminal, observe
        self.observation_space = space or gym.spaces.Discrete(N_STATES)
        self.action_space = gym.spaces.Discrete(N_ACTIONS)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = int(self.np_random.choice(np.flatnonzero(~self.terminal)))
        return self.observe(self.state), {"begun": 1}

    def step(self, action):
        before = self.state
        self.state = int(self.np_random.choice(N_STATES, p=TRANSITION[before, action]))
        reward = float(REWARD[before, action, self.state])
        return self.observe(self.state), reward, bool(self.terminal[self.state]), False, {"at": 1}


def wander(terminal=SOME, limit=LIMIT, **settings):
    return TimeLimit(Wander(terminal, **settings), limit)


def task(terminal=SOME, discount=DISCOUNT, **settings):
    return cr.FiniteMDP.from_dense(
        TRANSITION, REWARD, terminal=terminal, start=0, discount=discount, **settings
    )


def table(state):
    return PHI[state]


def actions_of(n_steps, *shape):
    return np.random.default_rng(1).integers(N_ACTIONS, size=(n_steps, *shape))


def episodes_of(env, actions):
    """The oracle: the plain environment's episodes, as lists of (s, r, s', terminated)."""
    episodes, state = [[]], env.reset(seed=3)[0]
    for action in actions.tolist():
        following, reward, terminated, truncated, _ = env.step(action)
        episodes[-1].append((state, reward, following, terminated))
        state = following
        if terminated or truncated:
            episodes.append([])
            state = env.reset()[0]
    return episodes


def shaped_steps(env, actions):
    """What the wrapper does with the same actions: (reward, info) of each step."""
    steps = []
    env.reset(seed=3)
    for action in actions.tolist():
        _, reward, terminated, truncated, info = env.step(action)
        steps.append((reward, info))
        if terminated or truncated:
            env.reset()
    return steps


# -- one environment -----------------------------------------------------------------------------


@pytest.mark.parametrize("discount", [0.0, DISCOUNT, 1.0])
@pytest.mark.parametrize(("terminal", "limit"), [(SOME, LIMIT), (SOME, 10**6), (NONE, LIMIT)])
def test_each_step_gets_what_the_oracle_writes_out(terminal, limit, discount):
    actions = actions_of(300)
    env = PotentialShaping(wander(terminal, limit), table, discount=discount)
    steps = iter(shaped_steps(env, actions))
    for episode in episodes_of(wander(terminal, limit), actions):
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


def test_the_oracle_met_both_ends_of_episodes():
    episodes = episodes_of(wander(), actions_of(300))[:-1]
    terminated = [episode[-1][3] for episode in episodes]
    assert any(terminated)
    assert not all(terminated)
    assert all(len(episode) == LIMIT for episode in episodes if not episode[-1][3])


def test_only_the_ends_of_episodes_are_told_as_such():
    env = PotentialShaping(wander(), table, discount=DISCOUNT)
    env.reset(seed=0)
    for _ in range(100):
        _, _, terminated, truncated, info = env.step(0)
        told = {"telescoping_residual", "original_return"} & set(info)
        assert len(told) == (2 if terminated or truncated else 0)
        if told:
            env.reset()


class Corridor(gym.Env):
    """Cells in a row; the last is the end, and every step costs 1."""

    def __init__(self, cells=3):
        self.observation_space, self.action_space = (
            gym.spaces.Discrete(cells),
            gym.spaces.Discrete(2),
        )

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.cell = 0
        return 0, {}

    def step(self, action):
        self.cell = max(0, self.cell + (1 if action else -1))
        return self.cell, -1.0, self.cell == self.observation_space.n - 1, False, {}


def test_a_hand_sized_episode():
    env = PotentialShaping(Corridor(), [10.0, 20.0, 40.0].__getitem__, discount=0.5)
    env.reset()
    assert env.step(1)[1] == -1 + 0.5 * 20 - 10
    assert env.step(1)[1] == -1 + 0 - 20  # the end is worth nothing, whatever the potential says
    env = PotentialShaping(TimeLimit(Corridor(), 1), [10.0, 20.0, 40.0].__getitem__, discount=0.5)
    env.reset()
    _, reward, terminated, truncated, info = env.step(1)
    assert (terminated, truncated, reward) == (False, True, -1 + 0.5 * 20 - 10)
    assert info["potential"] == 20.0


def test_ends_are_not_asked_for_their_potential():
    env = PotentialShaping(Corridor(), {0: 1.0, 1: 2.0}.__getitem__, discount=1)
    env.reset()
    env.step(1)
    assert env.step(1)[4]["potential"] == 0.0


def test_statistics_inside_stay_unshaped():
    env = PotentialShaping(RecordEpisodeStatistics(wander()), table, discount=DISCOUNT)
    ends = [info for _, info in shaped_steps(env, actions_of(100)) if "episode" in info]
    assert ends
    for info in ends:
        assert info["episode"]["r"] == pytest.approx(info["original_return"], abs=1e-12)


def test_an_environment_that_resets_itself_keeps_the_reward_of_its_reset():
    env = PotentialShaping(Autoreset(wander()), table, discount=DISCOUNT)
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


# -- where the potential comes from --------------------------------------------------------------


def paid(env):
    return [reward for reward, _ in shaped_steps(env, actions_of(60))]


def by_function(values=PHI):
    return paid(PotentialShaping(wander(), lambda s: values[s], discount=DISCOUNT))


def test_a_state_potential_brings_its_discount():
    env = PotentialShaping(wander(), cr.StatePotential(task(), PHI))
    assert env.discount == DISCOUNT
    assert env.get_wrapper_attr("discount") == DISCOUNT
    assert paid(env) == by_function()


def test_a_pair_potential_is_worth_its_best_action():
    pairs = RNG.normal(size=(N_STATES, N_ACTIONS))
    env = PotentialShaping(wander(), cr.StateActionPotential(task(), pairs))
    assert paid(env) == by_function(pairs.max(axis=1))


HUNT, CHASE = cr.Pursuit(size=2, predators=2), cr.Pursuit(size=2, predators=1)


class Positions(gym.Env):
    """Observations that list the components of a hunt's states, drawn at random."""

    def __init__(self, space, observe):
        self.observation_space, self.action_space = space, gym.spaces.Discrete(2)
        self.observe = observe

    def draw(self):
        self.state = int(self.np_random.integers(HUNT.states.size))
        return self.observe([int(values) for values in HUNT.states.decode(self.state).values()])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.draw(), {}

    def step(self, action):
        return self.draw(), 0.0, False, False, {"state": self.state}


def mapped_potential():
    edges = [
        cr.Transfer("chase", "hunt", cr.project(HUNT, CHASE, predator=f"predator_{i}"))
        for i in (1, 2)
    ]
    plan = cr.Curriculum({"chase": CHASE, "hunt": HUNT}, edges, budget=500)
    potential = plan.train().potentials["hunt"][0]
    assert isinstance(potential, cr.learning.MappedPotential)
    return potential


MULTI = gym.spaces.MultiDiscrete([4, 4, 4])
SHIFTED = gym.spaces.MultiDiscrete([4, 4, 4], start=[2, 0, -1])
TUPLE = gym.spaces.Tuple([gym.spaces.Discrete(4, start=start) for start in (0, 1, 0)])
LAYOUTS = {
    "MultiDiscrete": (MULTI, np.array),
    "counted from elsewhere": (SHIFTED, lambda parts: np.add(parts, [2, 0, -1])),
    "Tuple": (TUPLE, lambda parts: (parts[0], parts[1] + 1, parts[2])),
}


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("kind", ["by pairs", "mapped", "the same everywhere but at the end"])
def test_components_number_the_states(layout, kind):
    potential = {
        "by pairs": pair_potential_of_hunt,
        "mapped": mapped_potential,
        "the same everywhere but at the end": lambda: cr.learning.MappedPotential(
            HUNT, no_sources(25, 5.0)
        ),
    }[kind]()
    phi = potential.to_state().at()
    env = PotentialShaping(Positions(*LAYOUTS[layout]), potential)
    envs = VectorPotentialShaping(
        SyncVectorEnv([partial(Positions, *LAYOUTS[layout])] * 3), potential, batched=True
    )
    env.reset(seed=0)
    envs.reset(seed=0)
    for _ in range(20):
        info, infos = env.step(0)[4], envs.step(np.zeros(3, int))[4]
        assert info["potential"] == phi[info["state"]]
        np.testing.assert_array_equal(infos["potential"], phi[infos["state"]])


def pair_potential_of_hunt():
    return cr.StateActionPotential(HUNT, np.random.default_rng(2).normal(size=(64, 25)))


def test_a_discrete_space_may_start_anywhere():
    space = gym.spaces.Discrete(N_STATES, start=5)
    env = wander(observe=lambda state: np.int64(state + 5), space=space)
    assert paid(PotentialShaping(env, cr.StatePotential(task(), PHI))) == by_function()


POINTS = [(x, y - 7) for x in (1, 2) for y in range(3)]


@pytest.mark.parametrize("points", [None, POINTS, POINTS[::-1]])
def test_components_are_counted_from_the_lowest(points):
    parts = [cr.Component("x", 2, low=1), cr.Component("y", 3, low=-7)]
    states = cr.Space(parts, points)
    space = gym.spaces.MultiDiscrete([2, 3])
    env = wander(observe=lambda state: np.array(divmod(state, 3)), space=space)
    values = PHI[::-1] if points == POINTS[::-1] else PHI
    phi = cr.StatePotential(task(NONE, states=states), values)
    assert paid(PotentialShaping(env, phi)) == by_function()


def test_components_outside_their_space_are_named():
    env = wander(observe=lambda state: np.array([0, 3]), space=gym.spaces.MultiDiscrete([2, 3]))
    states = cr.Space([cr.Component("x", 2), cr.Component("y", 3)])
    shaped = PotentialShaping(env, cr.StatePotential(task(states=states), PHI))
    with pytest.raises(SettingError, match=re.escape("got -1 for observation array([0, 3])")):
        shaped.reset()


def as_picture(state):
    return np.eye(N_STATES, dtype=np.float32)[state]


PICTURE = gym.spaces.Box(0, 1, (N_STATES,))


def test_encode_says_which_state_an_observation_is():
    env = wander(observe=as_picture, space=PICTURE)
    phi = cr.StatePotential(task(), PHI)
    assert paid(PotentialShaping(env, phi, encode=np.argmax)) == by_function()


def test_several_sources_are_averaged_unless_an_aggregate_is_given():
    other = RNG.normal(size=N_STATES)
    both = {"phi": cr.StatePotential(task(), PHI), "other": lambda s: other[s]}
    for aggregate, together in {
        None: (PHI + other) / 2,
        cr.mean: (PHI + other) / 2,
        cr.total: PHI + other,
        cr.maximum: np.maximum(PHI, other),
        cr.minimum: np.minimum(PHI, other),
    }.items():
        env = PotentialShaping(wander(), both, aggregate=aggregate)
        assert paid(env) == pytest.approx(by_function(together), abs=1e-12)


def test_an_aggregate_is_applied_to_a_single_source_too():
    settings = {"discount": DISCOUNT, "aggregate": lambda p: 1 - p[0]}
    assert paid(PotentialShaping(wander(), {"a": table}, **settings)) == by_function(1 - PHI)


@pytest.mark.parametrize("batched", [False, True])
@pytest.mark.parametrize("mode", MODES)
def test_ends_are_worth_nothing_and_aggregates_are_not_asked(mode, batched):
    runs = []
    for potential, aggregate in ((lambda s: np.exp(PHI[s]), lambda p: 1 / p[0]), (None, None)):
        envs = VectorPotentialShaping(
            SyncVectorEnv([wander] * 2, autoreset_mode=mode),
            potential or (lambda s: 1 / np.exp(PHI[s])),
            aggregate=aggregate,
            discount=DISCOUNT,
            batched=batched,
        )
        runs.append([rewards for rewards, _ in vector_steps(envs, actions_of(60, 2))])
    np.testing.assert_array_equal(*runs)


@pytest.mark.parametrize("aggregate", [cr.mean, cr.total, cr.maximum, cr.minimum])
def test_terms_are_what_each_source_would_pay_alone(aggregate):
    tables = RNG.normal(size=(3, N_STATES))
    sources = {name: values.__getitem__ for name, values in zip("abc", tables, strict=True)}
    env = PotentialShaping(wander(), sources, discount=DISCOUNT, aggregate=aggregate)
    infos = [info for _, info in shaped_steps(env, actions_of(60))]
    terms = np.array([list(info["shaping_terms"].values()) for info in infos])
    shaping = np.array([info["shaping"] for info in infos])
    for column, values in zip(terms.T, tables, strict=True):
        alone = PotentialShaping(wander(), values.__getitem__, discount=DISCOUNT)
        expected = [info["shaping"] for _, info in shaped_steps(alone, actions_of(60))]
        np.testing.assert_array_equal(column, expected)
    if aggregate in (cr.mean, cr.total):
        np.testing.assert_allclose(aggregate(terms.T), shaping, atol=1e-12)
    else:
        assert (terms.min(axis=1) - 1e-12 <= shaping).all()
        assert (shaping <= terms.max(axis=1) + 1e-12).all()
        assert abs(aggregate(terms.T) - shaping).max() > 0.1


def test_a_changing_potential_goes_by_the_steps_taken():
    frames = RNG.normal(size=(3, N_STATES))
    weight = cr.learning.linear(1.0, 0.2, steps=80)
    phi = cr.StatePotential(task(NONE), frames, frame_steps=[0, 10, 31], weight=weight)
    actions = actions_of(60)
    steps = [move for episode in episodes_of(wander(NONE), actions) for move in episode]
    got = shaped_steps(PotentialShaping(wander(NONE), phi), actions)
    for t, ((state, reward, following, _), (shaped, info)) in enumerate(
        zip(steps, got, strict=True)
    ):
        assert info["shaping"] == phi.shaping_reward(state, following, step=t)
        assert shaped == reward + info["shaping"]
        assert abs(info.get("telescoping_residual", 0.0)) < 1e-12


def test_a_weight_scales_any_potential_and_may_change_too():
    assert paid(PotentialShaping(wander(), table, discount=DISCOUNT, weight=2)) == by_function(
        2 * PHI
    )
    weight = cr.learning.linear(1.0, 0.2, steps=80)
    weighed = cr.StatePotential(task(NONE), PHI, weight=weight)
    env = PotentialShaping(wander(NONE), table, discount=DISCOUNT, weight=weight)
    assert paid(env) == pytest.approx(paid(PotentialShaping(wander(NONE), weighed)), abs=1e-12)


# -- one discount --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("potential", "discount", "said"),
    [
        (table, None, "a discount must be given"),
        ({"a": table, "b": table}, None, "a discount must be given"),
        (cr.StatePotential(task(), PHI), 0.95, "0.9 by the task of 'potential', 0.95 by the arg"),
        (
            {"a": cr.StatePotential(task(), PHI), "b": cr.StatePotential(task(discount=0.5), PHI)},
            None,
            "0.9 by the task of 'a', 0.5 by the task of 'b'",
        ),
        (table, 1.5, "discount must lie in [0, 1]: got 1.5"),
    ],
)
def test_there_is_one_discount(potential, discount, said):
    with pytest.raises(SettingError, match=re.escape(said)):
        PotentialShaping(wander(), potential, discount=discount)


def test_the_same_discount_may_be_stated_twice():
    env = PotentialShaping(wander(), cr.StatePotential(task(), PHI), discount=DISCOUNT)
    assert paid(env) == by_function()


# -- refusals ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("potential", "settings", "error", "said"),
    [
        ({}, {}, PotentialError, "shaping needs a potential: got none"),
        ("phi", {}, PotentialError, "'potential' is 'phi'"),
        ({"a": None}, {}, PotentialError, "'a' is None"),
        ({1: table}, {}, SettingError, "name must be a str: got 1"),
        (table, {"tolerance": -1}, SettingError, "tolerance must be at least 0"),
        (table, {"weight": np.nan}, SettingError, "finite"),
        (table, {"encode": int}, SettingError, "encode must be left out"),
        (pair_potential_of_hunt(), {"discount": None}, SettingError, "the task's 64 states"),
    ],
)
def test_what_cannot_be_a_potential_is_refused(potential, settings, error, said):
    with pytest.raises(error, match=re.escape(said)):
        PotentialShaping(wander(), potential, **{"discount": DISCOUNT, **settings})


OTHER_SPACES = [gym.spaces.MultiDiscrete([4, 4]), gym.spaces.Discrete(63), PICTURE]


@pytest.mark.parametrize("space", OTHER_SPACES)
def test_observations_that_number_other_states_are_refused(space):
    with pytest.raises(SettingError, match="must number the task's 64 states"):
        PotentialShaping(Positions(space, np.array), pair_potential_of_hunt())


def always(value):
    return lambda observation: value


@pytest.mark.parametrize("wrap", ["one", "many"])
@pytest.mark.parametrize(
    ("potential", "settings", "said"),
    [
        (always(np.nan), {}, "'potential' is nan at observation "),
        ({"a": table, "b": always(np.inf)}, {}, "'b' is inf at observation "),
        (always("high"), {}, "'potential' returned 'high' at observation "),
        (always(None), {}, "'potential' returned None at observation "),
        (
            cr.StatePotential(task(), PHI),
            {"encode": always(-1)},
            "must lie in 0..5: 'potential' got -1 for observation ",
        ),
        (cr.StatePotential(task(), PHI), {"encode": always(6)}, "got 6 for observation "),
        (cr.StatePotential(task(), PHI), {"encode": always(1.5)}, "got 1.5 for observation "),
        ({"a": table}, {"aggregate": always(np.zeros(2))}, "must return shape (1, 1)"),
    ],
)
def test_values_that_cannot_be_used_are_named_with_their_observation(
    wrap, potential, settings, said
):
    if wrap == "one":
        env = PotentialShaping(wander(), potential, discount=DISCOUNT, **settings)
    else:
        envs = SyncVectorEnv([wander])
        env = VectorPotentialShaping(envs, potential, discount=DISCOUNT, **settings)
    with pytest.raises((PotentialError, SettingError, CurriculumError), match=re.escape(said)):
        env.reset(seed=0)


@pytest.mark.parametrize(
    ("potential", "settings", "said"),
    [
        (always(0.0), {}, "must have shape (2,): got ()"),
        (always("high"), {}, "must be an array of numbers"),
        (lambda s: np.where(s == s[1], np.nan, 0.0), {}, "'potential' is nan at observation "),
        (
            cr.StatePotential(task(), PHI),
            {"encode": always([0, 9])},
            "got 9 for observation 1 of 2",
        ),
        (cr.StatePotential(task(), PHI), {"encode": always([0])}, "states of shape (2,)"),
        (cr.StatePotential(task(), PHI), {"encode": always([0.5, 1])}, "must be whole numbers"),
    ],
)
def test_batches_that_cannot_be_used_are_named(potential, settings, said):
    envs = VectorPotentialShaping(
        SyncVectorEnv([wander] * 2), potential, discount=DISCOUNT, batched=True, **settings
    )
    with pytest.raises(cr.CurricleError, match=re.escape(said)):
        envs.reset(seed=0)


def test_an_environment_is_shaped_once():
    env = PotentialShaping(wander(), table, discount=DISCOUNT)
    twice = PotentialShaping(env, table, discount=DISCOUNT)
    twice.reset(seed=0)
    with pytest.raises(SettingError, match="must be shaped once"):
        twice.step(0)
    envs = VectorPotentialShaping(SyncVectorEnv([lambda: env]), table, discount=DISCOUNT)
    envs.reset(seed=0)
    with pytest.raises(SettingError, match="must be shaped once"):
        envs.step(np.array([0]))


# -- telescoping is checked ----------------------------------------------------------------------


def run_episode(env, seed=0, action=0):
    env.reset(seed=seed)
    over = False
    while not over:
        _, _, terminated, truncated, info = env.step(action)
        over = terminated or truncated
    return info


class Clock:
    """A potential that looks at something else than the observation."""

    calls = 0

    def __call__(self, observation):
        self.calls += 1
        return float(self.calls)

    def batch(self, observations):
        return np.full(len(observations), self(observations))


def test_a_potential_of_something_else_is_found_out_at_the_end():
    env = PotentialShaping(wander(NONE), Clock(), discount=DISCOUNT)
    # Phi was 1 at the start and is 9 there at the end of 7 steps.
    said = "Phi depends on the observation alone: it is off by 8 after 7 steps"
    with pytest.raises(PotentialError, match=re.escape(said)):
        run_episode(env)
    envs = VectorPotentialShaping(
        SyncVectorEnv([partial(wander, NONE)] * 2),
        Clock().batch,
        discount=DISCOUNT,
        batched=True,
    )
    with pytest.raises(PotentialError, match="is off by 7 at the end of an episode of sub-env"):
        run_episode(SomeEnvs(envs))


class SomeEnvs:
    """Sub-environments whose episodes end together, stepped like one."""

    def __init__(self, envs):
        self.envs = envs
        self.reset = envs.reset

    def step(self, action):
        *rest, terminated, truncated, info = self.envs.step(np.full(self.envs.num_envs, action))
        return *rest, terminated.all(), truncated.all(), info


def test_a_potential_meant_to_change_is_let_through_and_measured():
    env = PotentialShaping(wander(NONE), Clock(), discount=DISCOUNT, tolerance=None)
    assert run_episode(env)["telescoping_residual"] == pytest.approx(8.0, abs=1e-12)


def test_rounding_is_no_offence_even_where_the_start_is_worth_nothing():
    first = Wander(NONE).reset(seed=0)[0]
    values = 1e9 * (PHI - PHI[first])
    settings = {"discount": 1.0, "tolerance": 1e-11}
    long = partial(wander, NONE, limit=3000)
    env = PotentialShaping(long(), values.__getitem__, **settings)
    assert run_episode(env)["telescoping_residual"] != 0.0
    envs = VectorPotentialShaping(SyncVectorEnv([long]), values.__getitem__, **settings)
    assert run_episode(SomeEnvs(envs))["telescoping_residual"][0] != 0.0


def test_rounding_is_no_offence_where_the_start_is_worth_most():
    phi = np.append(1e9, np.random.default_rng(0).random(49)).__getitem__
    settings = {"discount": DISCOUNT, "tolerance": 1e-11}
    env = PotentialShaping(Corridor(50), phi, **settings)
    envs = VectorPotentialShaping(SyncVectorEnv([partial(Corridor, 50)]), phi, **settings)
    assert run_episode(env, action=1)["telescoping_residual"] != 0.0
    assert run_episode(SomeEnvs(envs), action=1)["telescoping_residual"][0] != 0.0


@pytest.mark.parametrize("seed", range(5))
def test_observations_written_over_are_no_offence(seed):
    room = np.zeros(N_STATES, np.float32)

    def observe(state):
        room[:] = as_picture(state)
        return room

    one = wander(NONE, observe=observe, space=PICTURE)
    env = PotentialShaping(one, lambda picture: picture @ PHI, discount=DISCOUNT)
    assert abs(run_episode(env, seed)["telescoping_residual"]) < 1e-12
    many = SyncVectorEnv([partial(wander, NONE, observe=as_picture, space=PICTURE)] * 2, copy=False)
    envs = VectorPotentialShaping(many, lambda o: o @ PHI, discount=DISCOUNT, batched=True)
    assert (abs(run_episode(SomeEnvs(envs), seed)["telescoping_residual"]) < 1e-12).all()


# -- a good citizen of Gymnasium -----------------------------------------------------------------


@contextmanager
def logged_warnings(monkeypatch):
    said = []
    monkeypatch.setattr(gym.logger, "warn", lambda message, *rest, **settings: said.append(message))
    yield said


def test_gymnasiums_own_checker_has_nothing_to_say(monkeypatch):
    lake = gym.make("FrozenLake-v1", disable_env_checker=True)
    env = PotentialShaping(lake, lambda square: square / 15, discount=0.9)
    with logged_warnings(monkeypatch) as said:
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


def test_constructor_arguments_are_recorded_as_they_are():
    phi = cr.StatePotential(task(), PHI)
    envs = VectorPotentialShaping(SyncVectorEnv([wander]), phi, batched=True)
    assert envs._saved_kwargs["potential"] is phi
    assert envs._saved_kwargs["batched"] is True


# -- many environments ---------------------------------------------------------------------------


def vector_oracle(mode, actions, terminal, limit):
    """Sub-environments stepped one by one, reset as the mode says, F written out for each.

    Yields (reward, F, Phi(s'), stepped, ended, original return) of each sub-environment and step.
    """
    n = actions.shape[1]
    envs = [wander(terminal, limit) for _ in range(n)]
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


def vector_steps(envs, actions):
    """Step the sub-environments, resetting ended ones where they do not do so themselves."""
    envs.reset(seed=10)
    for row in actions:
        _, rewards, terminated, truncated, infos = envs.step(row)
        yield rewards, infos
        ended = terminated | truncated
        if envs.metadata["autoreset_mode"] is AutoresetMode.DISABLED and ended.any():
            envs.reset(options={"reset_mask": ended})


ENDS = [(SOME, LIMIT), (SOME, 10**6), (NONE, LIMIT)]


@pytest.mark.parametrize("batched", [False, True])
@pytest.mark.parametrize("n", [1, 4])
@pytest.mark.parametrize(("terminal", "limit"), ENDS)
@pytest.mark.parametrize("mode", MODES)
def test_each_sub_environment_gets_what_the_oracle_writes_out(mode, terminal, limit, n, batched):
    actions = actions_of(120, n)
    made = SyncVectorEnv([partial(wander, terminal, limit)] * n, autoreset_mode=mode)
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


def assert_same_infos(one, other):
    assert set(one) == set(other)
    for name, value in one.items():
        if isinstance(value, dict):
            assert_same_infos(value, other[name])
        else:
            np.testing.assert_allclose(value, other[name], atol=1e-12, err_msg=name)


@pytest.mark.parametrize("batched", [False, True])
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED])
def test_infos_are_laid_out_as_those_of_environments_shaped_one_by_one(mode, batched):
    sources = {"a": table, "mask": cr.StatePotential(task(), PHI[::-1])}
    actions = actions_of(40, 3)
    shaped = SyncVectorEnv([lambda: PotentialShaping(wander(), sources)] * 3, autoreset_mode=mode)
    plain = SyncVectorEnv([wander] * 3, autoreset_mode=mode)
    envs = VectorPotentialShaping(plain, sources, batched=batched)
    for (rewards, infos), (other_rewards, other_infos) in zip(
        vector_steps(envs, actions), vector_steps(shaped, actions), strict=True
    ):
        np.testing.assert_allclose(rewards, other_rewards, atol=1e-12)
        if infos["_shaping"].any():
            assert_same_infos(infos, other_infos)
        else:  # all only reset: Gymnasium's has no entries then, the wrapper's are always there
            assert set(other_infos) == {"begun", "_begun"}


@pytest.mark.parametrize("mode", MODES)
def test_processes_of_their_own_change_nothing(mode):
    actions = actions_of(25, 2)
    phi = cr.StatePotential(task(), PHI)
    runs = []
    for make in (SyncVectorEnv, AsyncVectorEnv):
        envs = VectorPotentialShaping(make([wander] * 2, autoreset_mode=mode), phi, batched=True)
        runs.append([rewards for rewards, _ in vector_steps(envs, actions)])
        envs.close()
    np.testing.assert_array_equal(*runs)


@pytest.mark.parametrize("mode", MODES)
def test_statistics_inside_stay_unshaped_in_vectors(mode):
    def recorded():
        return RecordVectorStatistics(SyncVectorEnv([wander] * 2, autoreset_mode=mode))

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
    make = partial(wander, observe=as_dict, space=DICT)
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
def test_batches_may_hold_nonsense_at_ends(mode, potential, settings):
    runs = []
    for given in ({"potential": potential, "batched": True, **settings}, {"potential": table}):
        made = SyncVectorEnv([wander] * 2, autoreset_mode=mode)
        envs = VectorPotentialShaping(made, discount=DISCOUNT, **given)
        runs.append([rewards for rewards, _ in vector_steps(envs, actions_of(60, 2))])
    np.testing.assert_array_equal(*runs)


@pytest.mark.parametrize("batched", [False, True])
def test_time_is_counted_over_all_sub_environments(batched):
    frames = RNG.normal(size=(2, N_STATES))
    weight = cr.learning.linear(1.0, 0.0, steps=200)
    phi = cr.StatePotential(task(), frames, frame_steps=[0, 20], weight=weight)
    shaped = VectorPotentialShaping(
        SyncVectorEnv([wander] * 2),
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
    envs = SyncVectorEnv([partial(wander, NONE)] * 3, autoreset_mode=AutoresetMode.DISABLED)
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


def test_final_observations_are_asked_for():
    made = SyncVectorEnv([partial(wander, NONE)], autoreset_mode=AutoresetMode.SAME_STEP)
    envs = VectorPotentialShaping(Forgetful(made), table, discount=DISCOUNT)
    with pytest.raises(SettingError, match=re.escape("infos['final_obs']: sub-environment 0 did")):
        run_episode(SomeEnvs(envs))


def test_a_vector_environment_must_say_how_it_resets():
    envs = SyncVectorEnv([wander])
    del envs.metadata["autoreset_mode"]
    with pytest.raises(SettingError, match="must say how it resets"):
        VectorPotentialShaping(envs, table, discount=DISCOUNT)


def test_a_copied_vector_goes_on_where_the_original_is():
    envs = VectorPotentialShaping(SyncVectorEnv([wander] * 2), table, discount=DISCOUNT)
    envs.reset(seed=0)
    envs.step(np.array([0, 1]))
    twin = copy.deepcopy(envs)
    for row in actions_of(20, 2):
        np.testing.assert_array_equal(twin.step(row)[1], envs.step(row)[1])
