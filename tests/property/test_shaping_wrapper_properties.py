"""The theorems of shaping, through the Gymnasium wrappers, on random small worlds."""

import numpy as np
from gymnasium.wrappers import TimeLimit
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

import curricle as cr
from curricle.interop.potential_shaping import PotentialShaping
from tests.unit.interop import shaping


class World(shaping.World):
    """A finite MDP, P and r (S, A, S), that ends in its last state; a reset may name the state."""

    def __init__(self, p, r):
        super().__init__(np.arange(len(p)) == len(p) - 1, p=p, r=r)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = (options or {}).get("state", 0)
        return self.state, {}

    def task(self, rewards, discount):
        return cr.FiniteMDP.from_dense(
            self.p, rewards, terminal=self.terminal, start=0, discount=discount
        )


class Led(World):
    """A world in which actions name the next state too: action + A s'."""

    def step(self, action):
        following, action = divmod(action, self.p.shape[1])
        reward, self.state = float(self.r[self.state, action, following]), following
        return following, reward, bool(self.terminal[following]), False, {}


@st.composite
def tables(draw, max_states=4, max_actions=3):
    """Draw P and r; every step may end the episode, so that all of them do."""
    n, a = draw(st.integers(2, max_states)), draw(st.integers(1, max_actions))
    weights = draw(arrays(np.int64, (n, a, n), elements=st.integers(0, 3)))
    weights[:, :, -1] += 1
    reward = draw(arrays(np.int64, (n, a, n), elements=st.integers(-5, 5)))
    return weights / weights.sum(axis=2, keepdims=True), reward.astype(float)


finite = st.floats(-1e3, 1e3)
discounts = st.sampled_from([0.0, 0.3, 0.95, 1.0])


def potential_of(data, p, elements=finite):
    return data.draw(arrays(np.float64, p.shape[0], elements=elements))


@given(tables(), st.sampled_from([0.3, 0.75, 0.95, 1.0]), st.data())
def test_what_the_wrapper_pays_keeps_the_optimal_policies(world, discount, data):
    p, r = world
    n, a = p.shape[:2]
    whole = st.integers(-8, 8).map(float)
    sources = {name: potential_of(data, p, whole) for name in ("one", "other")}
    g = data.draw(st.sampled_from([cr.mean, cr.minimum, cr.maximum, cr.total]))
    env = PotentialShaping(
        Led(p, r), {k: v.__getitem__ for k, v in sources.items()}, discount=discount, aggregate=g
    )
    shaped = np.zeros((n, a, n))
    for state, action, following in np.ndindex(n - 1, a, n):
        env.reset(options={"state": state})
        shaped[state, action, following] = env.step(action + a * following)[1]
    plain, after = (cr.solve(env.unwrapped.task(rewards, discount)) for rewards in (r, shaped))
    phi = g(np.array(list(sources.values())))
    bound = plain.error_bound + after.error_bound + 1e-9
    assert abs(after.values - (plain.values - phi))[:-1].max() <= bound
    np.testing.assert_array_equal(after.optimal, plain.optimal)


def q_learning(env, q, discount, actions, rate=0.5, seed=0):
    """Return the table after the given actions, started at q."""
    q = q.copy()
    state, _ = env.reset(seed=seed)
    for action in actions:
        following, reward, terminated, truncated, _ = env.step(action)
        worth = 0.0 if terminated else q[following].max()
        q[state, action] += rate * (reward + discount * worth - q[state, action])
        state = env.reset()[0] if terminated or truncated else following
    return q


@given(tables(), discounts, st.integers(1, 6), st.data())
def test_shaping_is_initialisation_at_the_potential(world, discount, limit, data):
    """Wiewiora 2003: with the same experience Q + Phi is what Q learns that starts at Phi."""
    p, _ = world
    n, a = p.shape[:2]
    phi = potential_of(data, p)
    phi[-1] = 0.0
    actions = data.draw(st.lists(st.integers(0, a - 1), min_size=30, max_size=30))
    env = TimeLimit(World(*world), limit)
    started = q_learning(env, np.repeat(phi[:, None], a, axis=1), discount, actions)
    shaped = PotentialShaping(env, phi.__getitem__, discount=discount)
    learnt = q_learning(shaped, np.zeros((n, a)), discount, actions)
    np.testing.assert_allclose(learnt + phi[:, None], started, atol=1e-11 * max(1, abs(phi).max()))
