"""What a potential of observations may be, and what it may not."""

import re
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.spaces import Dict, Discrete, Tuple

import curricle as cr
from curricle.errors import PotentialError, SettingError
from curricle.interop.gymnasium import observation_task
from curricle.interop.potential_shaping import PotentialShaping
from curricle.learning.value_lookup import no_sources
from curricle.transfer.mapping import FunctionValues, TableValues
from curricle.transfer.potential import ObservationPotential
from tests.support.refusals import check_values
from tests.support.tasks import predator_edges

from .shaping import (
    DISCOUNT,
    N_STATES,
    NONE,
    PHI,
    PICTURE,
    RNG,
    SOME,
    actions_of,
    always,
    as_picture,
    by_function,
    paid,
    shaped_steps,
    table,
    task,
    world,
)

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
    plan = cr.Curriculum({"chase": CHASE, "hunt": HUNT}, predator_edges(HUNT, CHASE), budget=500)
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
    env.reset(seed=0)
    for _ in range(20):
        info = env.step(0)[4]
        assert info["potential"] == phi[info["state"]]


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
    for function, together in ((None, (PHI + other) / 2), (cr.minimum, np.minimum(PHI, other))):
        env = PotentialShaping(world(), both, aggregate=function)
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


@pytest.mark.parametrize("made", [cr.StatePotential, lambda of, values: ObservationPotential.of(
    observation_task(world, discount=of.discount), TableValues(PAIRS))])  # fmt: skip
def test_there_is_one_discount(made):
    near, far = (made(task(discount=discount), PHI) for discount in (DISCOUNT, 0.5))
    with pytest.raises(SettingError, match=r"0\.9 by the task of 'potential', 0\.95 by the arg"):
        PotentialShaping(world(), near, discount=0.95)
    with pytest.raises(SettingError, match=r"0\.9 by the task of 'a', 0\.5 by the task of 'b'"):
        PotentialShaping(world(), {"a": near, "b": far})


def test_what_cannot_be_a_potential_is_refused():
    shaped = partial(PotentialShaping, world(), discount=DISCOUNT)
    check_values(PotentialError, shaped, {"potential": [{}, {"a": None}]})
    check_values(SettingError, partial(shaped, table), {"tolerance": [-1], "encode": [int]})


OTHER_SPACES = [gym.spaces.MultiDiscrete([4, 4]), gym.spaces.Discrete(63), PICTURE]


@pytest.mark.parametrize("space", OTHER_SPACES)
def test_observations_that_number_other_states_are_refused(space):
    with pytest.raises(SettingError, match="must number the task's 64 states"):
        PotentialShaping(Positions(space, np.array), pair_potential_of_hunt())


@pytest.mark.parametrize(
    ("potential", "settings", "said"),
    [
        ({"a": table, "b": always(np.inf)}, {}, "'b' is inf at observation "),
        (always("high"), {}, "'potential' returned 'high' at observation "),
        (cr.StatePotential(task(), PHI), {"encode": always(-1)}, "got -1 for observation "),
        ({"a": table}, {"aggregate": always(np.zeros(2))}, "must return shape (1, 1)"),
        (FunctionValues(state_values=always(np.zeros(3))), {}, "(1,)"),
    ],
)
def test_values_that_cannot_be_used_are_named_with_their_observation(potential, settings, said):
    env = PotentialShaping(world(), potential, discount=DISCOUNT, **settings)
    with pytest.raises(cr.CurricleError, match=re.escape(said)):
        env.reset(seed=0)


def test_an_environment_is_shaped_once():
    env = PotentialShaping(world(), table, discount=DISCOUNT)
    twice = PotentialShaping(env, table, discount=DISCOUNT)
    twice.reset(seed=0)
    with pytest.raises(SettingError, match="must be shaped once"):
        twice.step(0)


KNOWN = np.where(SOME, np.nan, PHI)  # the value of the end is never read
PAIRS = np.stack([PHI - 2, PHI - 1, PHI], axis=1)


def in_parts(state):
    return {"state": state, "more": (as_picture(state), state % 2)}


SEEN = {
    "vectors": (PICTURE, as_picture, lambda o: KNOWN[o.argmax(axis=1)]),
    "numbers": (Discrete(N_STATES), int, lambda o: KNOWN[o]),
    "dicts": (
        Dict({"state": Discrete(N_STATES), "more": Tuple([PICTURE, Discrete(2)])}),
        in_parts,
        lambda o: KNOWN[o["more"][0].argmax(axis=1)],
    ),
    "tuples": (
        Tuple([Discrete(2), PICTURE]),
        lambda state: (state % 2, as_picture(state)),
        lambda o: KNOWN[o[1].argmax(axis=1)],
    ),
}


@pytest.mark.parametrize("seen", SEEN)
def test_values_of_observations_pay_what_their_numbers_do(seen):
    space, observe, read = SEEN[seen]
    seeing = world(observe=observe, space=space)
    shaped = PotentialShaping(seeing, FunctionValues(state_values=read), discount=DISCOUNT)
    assert paid(shaped) == by_function()


def test_a_potential_over_observations_states_the_discount_and_the_space():
    task = observation_task(world, discount=0.8)
    phi = ObservationPotential.of(task, TableValues(PAIRS))
    env = PotentialShaping(world(), phi)
    assert env.discount == 0.8
    expected = PotentialShaping(world(), PHI.__getitem__, discount=0.8)
    assert paid(env) == paid(expected)
    with pytest.raises(SettingError, match="read those of its own task: 'potential' is made for"):
        PotentialShaping(world(observe=as_picture, space=PICTURE), phi)
    with pytest.raises(SettingError, match="a discount must be given"):
        PotentialShaping(world(), TableValues(np.zeros((N_STATES, 1))))
