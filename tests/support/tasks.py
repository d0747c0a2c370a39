"""Small tasks that several test files build: random MDPs, drawn ones, and a ring of functions."""

from dataclasses import dataclass, replace

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numba import njit

from curricle import Component, ComputedMDP, FiniteMDP, Pursuit, Space, Transfer, project
from curricle.tasks.kernel import integers, uniform

# -- random MDPs, from a seed --------------------------------------------------------------------


def random_mdp(seed, *, n_states=6, n_actions=3, width=3, discount=0.9, time_limit=None):
    """Return an MDP of `width` outcomes a pair, some impossible; a quarter of it is terminal."""
    rng = np.random.default_rng(seed)
    shape = (n_states, n_actions, width)
    probability = rng.dirichlet(np.ones(width), size=shape[:2])
    if width > 1:  # now and then the last outcome is the impossible one
        probability[rng.random(shape) < 0.2] = 0.0
        probability[..., 0] = 1 - probability[..., 1:].sum(axis=-1)
    successor, reward = rng.integers(n_states, size=shape), rng.normal(size=shape).round(2)
    terminal = np.arange(n_states) >= n_states - max(1, n_states // 4)
    start = np.where(terminal, 0, rng.integers(0, 3, size=n_states))
    start[0] = 1
    outcomes = [
        [list(zip(*(x[s, a].tolist() for x in (probability, successor, reward)), strict=True))
         for a in range(n_actions)]
        for s in range(n_states)
    ]  # fmt: skip
    return FiniteMDP.from_outcomes(
        outcomes,
        terminal=terminal,
        start=start / start.sum(),
        discount=discount,
        time_limit=time_limit,
    )


def with_masks(task, seed, share=0.6):
    """Return a task in which a random part of the actions is available, one in each state."""
    rng, (n_states, n_actions) = np.random.default_rng([seed, 7]), task.outcome_row.shape
    available = rng.random((n_states, n_actions)) < share
    available[np.arange(n_states), rng.integers(n_actions, size=n_states)] = True
    return replace(task, available=available)


def among_more_actions(task, seed, n_actions=5):
    """Return a task with its actions among more, in places that differ from state to state.

    The others are not available. Also return the places, (S, A).
    """
    shape = len(task.start), n_actions
    places = np.argsort(np.random.default_rng([seed, 8]).random(shape))[:, : task.actions.size]
    places.sort(axis=1)
    rows, available = np.zeros(shape, int), np.zeros(shape, bool)
    np.put_along_axis(rows, places, task.outcome_row, axis=1)
    np.put_along_axis(available, places, values=True, axis=1)
    actions = Space([Component("action", n_actions)])
    return replace(task, actions=actions, outcome_row=rows, available=available), places


def predator_edges(hunt, chase, **settings):
    """Return a transfer for each predator of a hunt from a chase by one."""
    return [
        Transfer("chase", "hunt", project(hunt, chase, predator=name), **settings)
        for name in hunt.predator_names
    ]


def dense_of(mdp):
    """Return P (S, A, S) and the mean reward (S, A) of a task's tables, 0 in terminal states."""
    n_states, n_actions = mdp.outcome_row.shape
    p, r = np.zeros((n_states, n_actions, n_states)), np.zeros((n_states, n_actions))
    for s in np.flatnonzero(~mdp.terminal):
        for a in range(n_actions):
            row = mdp.outcome_row[s, a]
            np.add.at(p[s, a], mdp.next_state[row], mdp.probability[row])
            r[s, a] = mdp.probability[row] @ mdp.reward[row]
    return p, r


# -- MDPs that Hypothesis draws ------------------------------------------------------------------


@dataclass(frozen=True)
class DenseMDP:
    """An MDP as arrays: P and r (S, A, S). Episodes start in the first live state."""

    p: np.ndarray
    r: np.ndarray
    terminal: np.ndarray
    discount: float

    @property
    def shape(self):
        """(S, A)."""
        return self.p.shape[:2]

    def task(self, added=0.0, **settings):
        """Return it as a task, F(s, a, s') added to its rewards."""
        start = int(np.flatnonzero(~self.terminal)[0])
        return FiniteMDP.from_dense(
            self.p,
            self.r + added,
            terminal=self.terminal,
            start=start,
            discount=self.discount,
            **settings,
        )

    def zero_at_ends(self, values):
        """Return a potential, (S,) or (S, A), with 0 in the terminal states."""
        return np.where(self.terminal.reshape(-1, *[1] * (values.ndim - 1)), 0.0, values)


@st.composite
def mdps(draw, discounts=(0.3, 0.75, 0.95), max_states=4, max_actions=3, loose=False):
    """Draw a DenseMDP with whole rewards; at discount 1, and in a loose one, every policy ends."""
    n, a = draw(st.integers(2, max_states)), draw(st.integers(1, max_actions))
    discount = draw(st.sampled_from(discounts))
    weights = draw(arrays(np.int64, (n, a, n), elements=st.integers(0, 3))) + loose
    sure = draw(arrays(np.int64, (n, a), elements=st.integers(0, n - 1)))
    terminal = draw(arrays(np.bool_, n))
    terminal[0] = False
    if discount == 1 or loose:
        terminal[-1] = True
        weights[:, :, -1] += 1
    weights[np.arange(n)[:, None], np.arange(a), sure] += 1
    reward = draw(arrays(np.int64, (n, a, n), elements=st.integers(-5, 5)))
    return DenseMDP(weights / weights.sum(axis=2, keepdims=True), reward, terminal, discount)


# -- a ring, by functions and by tables ----------------------------------------------------------

ASTRAY = 0.2
"""The chance that an action moves the other way."""
LEFT_OR_RIGHT = Component("move", 2, labels=("left", "right"))


@njit(nogil=True)
def ring_start(n, bits):
    """Return where an episode starts: anywhere but at place 0."""
    return 1 + integers(bits, n - 1)


@njit(nogil=True)
def ring_step(n, state, action, bits):
    """Return the next place, the reward and whether it is place 0."""
    right = (action == 1) != (uniform(bits) < ASTRAY)
    place = (state + (1 if right else n - 1)) % n
    return place, -1.0, place == 0


def ring(n=9, **settings):
    """Return n places in a ring: -1 a step to the end at 0. All rings share compiled functions."""
    settings = {"discount": 0.9, "time_limit": 30, **settings}
    spaces = Space([Component("place", n)]), Space([LEFT_OR_RIGHT])
    return ComputedMDP(*spaces, ring_start, ring_step, data=n, **settings)


def ring_by_tables(n=9):
    """Return the same ring, its outcomes in the order in which the function tries them."""
    places, ways = np.arange(n), np.array([-1, 1])
    straight = (places[:, None] + ways) % n
    astray = (places[:, None] - ways) % n
    terminal = places == 0
    return FiniteMDP(
        states=Space([Component("place", n)]),
        actions=Space([LEFT_OR_RIGHT]),
        outcome_row=np.arange(2 * n).reshape(n, 2),
        probability=np.tile([ASTRAY, 1 - ASTRAY], (2 * n, 1)),
        next_state=np.stack([astray.ravel(), straight.ravel()], axis=1),
        reward=np.full((2 * n, 2), -1.0),
        terminal=terminal,
        start=~terminal / (n - 1),
        discount=0.9,
        time_limit=30,
    )


# -- ways into a state -----------------------------------------------------------------------------


def tree(discount=0.9):
    """Return 7 states with 2 actions and 8 ends; each state has one way in."""
    reward = np.random.default_rng(1).normal(size=(7, 2)).round(1)
    outcomes = [[[(1.0, 2 * s + 1 + a, reward[s, a])] for a in range(2)] for s in range(7)]
    return FiniteMDP.from_outcomes(
        outcomes + [[[], []]] * 8, terminal=np.arange(15) >= 7, start=0, discount=discount
    )


@st.composite
def pursuits(draw, discounts=(0.99,)):
    """Draw a small pursuit."""
    size = draw(st.integers(2, 4))
    predators = draw(st.integers(1, {2: 3, 3: 2, 4: 1}[size]))
    return Pursuit(
        size=size,
        predators=predators,
        moves=draw(st.sampled_from([4, 5])),
        torus=draw(st.booleans()),
        capture=draw(st.sampled_from(["all", "any", "as_published", *range(1, predators + 1)])),
        step_reward=draw(st.sampled_from([-1.0, 0.25, 2.0])),
        capture_reward=draw(st.sampled_from([0.0, 10.0, -3.0])),
        discount=draw(st.sampled_from(discounts)),
    )
