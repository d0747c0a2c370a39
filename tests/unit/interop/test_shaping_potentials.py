"""What a potential of observations may be, and what it may not."""

import re
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv

import curricle as cr
from curricle.errors import CurriculumError, PotentialError, SettingError
from curricle.interop.potential_shaping import PotentialShaping, VectorPotentialShaping
from curricle.learning.value_lookup import no_sources
from tests.refusals import check_values

from .shaping import (
    DISCOUNT,
    N_ACTIONS,
    N_STATES,
    NONE,
    PHI,
    PICTURE,
    RNG,
    actions_of,
    always,
    as_picture,
    by_function,
    episodes_of,
    paid,
    shaped_steps,
    table,
    task,
    world,
)


def test_a_state_potential_brings_its_discount():
    env = PotentialShaping(world(), cr.StatePotential(task(), PHI))
    assert env.discount == DISCOUNT
    assert env.get_wrapper_attr("discount") == DISCOUNT
    assert paid(env) == by_function()


def test_a_pair_potential_is_worth_its_best_action():
    pairs = RNG.normal(size=(N_STATES, N_ACTIONS))
    env = PotentialShaping(world(), cr.StateActionPotential(task(), pairs))
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
    assert isinstance(potential, cr.transfer.MappedPotential)
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
        "the same everywhere but at the end": lambda: cr.transfer.MappedPotential(
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


POINTS = [(x, y - 7) for x in (1, 2) for y in range(3)]


@pytest.mark.parametrize("points", [None, POINTS, POINTS[::-1]])
def test_components_are_counted_from_the_lowest(points):
    parts = [cr.Component("x", 2, low=1), cr.Component("y", 3, low=-7)]
    states = cr.Space(parts, points)
    space = gym.spaces.MultiDiscrete([2, 3])
    env = world(observe=lambda state: np.array(divmod(state, 3)), space=space)
    values = PHI[::-1] if points == POINTS[::-1] else PHI
    phi = cr.StatePotential(task(NONE, states=states), values)
    assert paid(PotentialShaping(env, phi)) == by_function()


def test_encode_gives_the_state_of_an_observation():
    env = world(observe=as_picture, space=PICTURE)
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
        env = PotentialShaping(world(), both, aggregate=aggregate)
        assert paid(env) == pytest.approx(by_function(together), abs=1e-12)


@pytest.mark.parametrize("aggregate", [cr.mean, cr.total, cr.maximum, cr.minimum])
def test_terms_are_what_each_source_would_pay_alone(aggregate):
    tables = RNG.normal(size=(3, N_STATES))
    sources = {name: values.__getitem__ for name, values in zip("abc", tables, strict=True)}
    env = PotentialShaping(world(), sources, discount=DISCOUNT, aggregate=aggregate)
    infos = [info for _, info in shaped_steps(env, actions_of(60))]
    terms = np.array([list(info["shaping_terms"].values()) for info in infos])
    shaping = np.array([info["shaping"] for info in infos])
    for column, values in zip(terms.T, tables, strict=True):
        alone = PotentialShaping(world(), values.__getitem__, discount=DISCOUNT)
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
    steps = [move for episode in episodes_of(world(NONE), actions) for move in episode]
    got = shaped_steps(PotentialShaping(world(NONE), phi), actions)
    for t, ((state, reward, following, _), (shaped, info)) in enumerate(
        zip(steps, got, strict=True)
    ):
        assert info["shaping"] == phi.shaping_reward(state, following, step=t)
        assert shaped == reward + info["shaping"]
        assert abs(info.get("telescoping_residual", 0.0)) < 1e-12


def test_a_weight_scales_any_potential_and_may_change_too():
    assert paid(PotentialShaping(world(), table, discount=DISCOUNT, weight=2)) == by_function(
        2 * PHI
    )
    weight = cr.learning.linear(1.0, 0.2, steps=80)
    weighed = cr.StatePotential(task(NONE), PHI, weight=weight)
    env = PotentialShaping(world(NONE), table, discount=DISCOUNT, weight=weight)
    assert paid(env) == pytest.approx(paid(PotentialShaping(world(NONE), weighed)), abs=1e-12)


@pytest.mark.parametrize(
    ("potential", "discount", "said"),
    [
        (cr.StatePotential(task(), PHI), 0.95, "0.9 by the task of 'potential', 0.95 by the arg"),
        (
            {"a": cr.StatePotential(task(), PHI), "b": cr.StatePotential(task(discount=0.5), PHI)},
            None,
            "0.9 by the task of 'a', 0.5 by the task of 'b'",
        ),
    ],
)
def test_there_is_one_discount(potential, discount, said):
    with pytest.raises(SettingError, match=re.escape(said)):
        PotentialShaping(world(), potential, discount=discount)


def test_what_cannot_be_a_potential_is_refused():
    shaped = partial(PotentialShaping, world(), discount=DISCOUNT)
    check_values(PotentialError, shaped, {"potential": [{}, {"a": None}]})
    check_values(SettingError, partial(shaped, table), {"tolerance": [-1], "encode": [int]})


OTHER_SPACES = [gym.spaces.MultiDiscrete([4, 4]), gym.spaces.Discrete(63), PICTURE]


@pytest.mark.parametrize("space", OTHER_SPACES)
def test_observations_that_number_other_states_are_refused(space):
    with pytest.raises(SettingError, match="must number the task's 64 states"):
        PotentialShaping(Positions(space, np.array), pair_potential_of_hunt())


@pytest.mark.parametrize("wrap", ["one", "many"])
@pytest.mark.parametrize(
    ("potential", "settings", "said"),
    [
        ({"a": table, "b": always(np.inf)}, {}, "'b' is inf at observation "),
        (always("high"), {}, "'potential' returned 'high' at observation "),
        (
            cr.StatePotential(task(), PHI),
            {"encode": always(-1)},
            "must lie in 0..5: 'potential' got -1 for observation ",
        ),
        ({"a": table}, {"aggregate": always(np.zeros(2))}, "must return shape (1, 1)"),
    ],
)
def test_values_that_cannot_be_used_are_named_with_their_observation(
    wrap, potential, settings, said
):
    if wrap == "one":
        env = PotentialShaping(world(), potential, discount=DISCOUNT, **settings)
    else:
        envs = SyncVectorEnv([world])
        env = VectorPotentialShaping(envs, potential, discount=DISCOUNT, **settings)
    with pytest.raises((PotentialError, SettingError, CurriculumError), match=re.escape(said)):
        env.reset(seed=0)


@pytest.mark.parametrize(
    ("potential", "settings", "said"),
    [
        (always(0.0), {}, "must have shape (2,): got ()"),
        (
            cr.StatePotential(task(), PHI),
            {"encode": always([0, 9])},
            "got 9 for observation 1 of 2",
        ),
    ],
)
def test_batches_that_cannot_be_used_are_named(potential, settings, said):
    envs = VectorPotentialShaping(
        SyncVectorEnv([world] * 2), potential, discount=DISCOUNT, batched=True, **settings
    )
    with pytest.raises(cr.CurricleError, match=re.escape(said)):
        envs.reset(seed=0)


def test_an_environment_is_shaped_once():
    env = PotentialShaping(world(), table, discount=DISCOUNT)
    twice = PotentialShaping(env, table, discount=DISCOUNT)
    twice.reset(seed=0)
    with pytest.raises(SettingError, match="must be shaped once"):
        twice.step(0)
    envs = VectorPotentialShaping(SyncVectorEnv([lambda: env]), table, discount=DISCOUNT)
    envs.reset(seed=0)
    with pytest.raises(SettingError, match="must be shaped once"):
        envs.step(np.array([0]))
