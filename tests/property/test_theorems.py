"""The theorems of reward shaping, on random MDPs whose shaped tables are written out here.

Two exact solutions are compared within the sum of their proven error bounds."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

import curricle as cr
from tests.support.tasks import DenseMDP, mdps

whole = st.integers(-8, 8)
shaped_discounts = (0.3, 0.75, 0.95, 1.0)


def state_potentials(data, mdp, frames=()):
    phi = data.draw(arrays(np.int64, (*frames, mdp.shape[0]), elements=whole))
    return np.where(mdp.terminal, 0.0, phi)


def pair_potentials(data, mdp):
    return mdp.zero_at_ends(data.draw(arrays(np.int64, mdp.shape, elements=whole)))


def bound(*solutions):
    return sum(s.error_bound for s in solutions) + 1e-12


def shaping(mdp, phi):
    """Return F(s, s') = gamma Phi(s') - Phi(s), (S, 1, S) (paper E2)."""
    return mdp.discount * phi[None, None, :] - phi[:, None, None]


@given(mdps(shaped_discounts), st.data())
def test_state_potential_shifts_the_optimum_and_keeps_its_policies(mdp, data):
    phi = state_potentials(data, mdp)
    plain, shaped = cr.solve(mdp.task()), cr.solve(mdp.task(shaping(mdp, phi)))
    assert abs(shaped.values - (plain.values - phi)).max() <= bound(plain, shaped)
    difference = shaped.action_values - (plain.action_values - phi[:, None])
    assert abs(difference[~mdp.terminal]).max() <= bound(plain, shaped)
    np.testing.assert_array_equal(shaped.optimal, plain.optimal)


@given(mdps(shaped_discounts), st.data())
def test_the_optimal_values_as_potential_leave_nothing_to_learn(mdp, data):
    plain = cr.solve(mdp.task())
    shaped = cr.solve(mdp.task(shaping(mdp, plain.values)))
    assert abs(shaped.values).max() <= bound(plain, shaped)


@given(mdps((0.3, 0.75, 0.95)), st.data())
def test_look_ahead_advice_shifts_q_and_is_optimal_on_q_plus_phi(mdp, data):
    # Iterate the literal update: Q <- r + gamma phi(s', a*) - phi + gamma Q(s', a*),
    # a* = argmax Q + phi. 700 rounds leave 0.95^700 = 3e-16 of the start.
    phi, q = pair_potentials(data, mdp), np.zeros(mdp.shape)
    everywhere, live = np.arange(mdp.shape[0]), ~mdp.terminal
    reward = (mdp.p * mdp.r).sum(axis=2)
    for _ in range(700):
        best = (q + phi).argmax(axis=1)
        worth = np.where(live, (phi + q)[everywhere, best], 0.0)
        q = mdp.zero_at_ends(reward - phi + mdp.discount * mdp.p @ worth)
    plain = cr.solve(mdp.task())
    assert abs(q - (plain.action_values - phi)).max() <= bound(plain) + 1e-9
    followed = cr.evaluate(mdp.task(), cr.planning.greedy_policy(q + phi, tolerance=1e-8))
    assert abs(followed.values - plain.values).max() <= bound(plain, followed) + 1e-6


@given(mdps((0.3, 0.75, 0.95), max_states=3, max_actions=2), st.data())
def test_look_back_advice_shifts_the_optimum_by_what_went_before(mdp, data):
    # A state of the shaped MDP is (s, pair before); before the first step there is no pair.
    phi = pair_potentials(data, mdp)
    n, a = mdp.shape
    before = np.append(phi.ravel(), 0.0)
    transition = np.zeros((n, n * a + 1, a, n, n * a + 1))
    reward = np.zeros_like(transition)
    for s in range(n):
        for b in range(a):
            pair = s * a + b
            transition[s, :, b, :, pair] = mdp.p[s, b]
            # F = phi(s, a) - phi(before) / gamma; an end gives gamma (0 - phi(s, a) / gamma) too.
            given_away = np.where(mdp.terminal, 0.0, phi[s, b])
            paid = mdp.r[s, b] + given_away - before[:, None] / mdp.discount
            reward[s, :, b, :, pair] = paid
    size = n * (n * a + 1)
    remembering = DenseMDP(
        transition.reshape(size, a, size), reward.reshape(size, a, size),
        np.repeat(mdp.terminal, n * a + 1), mdp.discount,
    )  # fmt: skip
    plain, shaped = cr.solve(mdp.task()), cr.solve(remembering.task())
    expected = mdp.zero_at_ends(plain.values[:, None] - before / mdp.discount)
    assert abs(shaped.values.reshape(n, -1) - expected).max() <= bound(plain, shaped)
    np.testing.assert_array_equal(
        shaped.optimal.reshape(n, -1, a), np.repeat(plain.optimal[:, None], n * a + 1, axis=1)
    )


@given(mdps(), st.data())
def test_dynamic_potential_keeps_the_optimal_policies_at_every_time(mdp, data):
    # A state of the shaped MDP is (s, t); the last frame holds for ever.
    frames = data.draw(st.integers(2, 4))
    phi = state_potentials(data, mdp, (frames,))
    n, a = mdp.shape
    transition, reward = np.zeros((n, frames, a, n, frames)), np.zeros((n, frames, a, n, frames))
    for t in range(frames):
        after = min(t + 1, frames - 1)
        transition[:, t, :, :, after] = mdp.p
        added = mdp.discount * phi[after][None, None, :] - phi[t][:, None, None]
        reward[:, t, :, :, after] = mdp.r + added
    size = n * frames
    timed = DenseMDP(
        transition.reshape(size, a, size), reward.reshape(size, a, size),
        np.repeat(mdp.terminal, frames), mdp.discount,
    )  # fmt: skip
    plain, shaped = cr.solve(mdp.task()), cr.solve(timed.task())
    expected = mdp.zero_at_ends(plain.values[:, None] - phi.T)
    assert abs(shaped.values.reshape(n, frames) - expected).max() <= bound(plain, shaped)
    np.testing.assert_array_equal(
        shaped.optimal.reshape(n, frames, a), np.repeat(plain.optimal[:, None], frames, axis=1)
    )


def discounted(mdp, rewards):
    return sum(mdp.discount**t * f for t, f in enumerate(rewards))


def random_path(data, mdp):
    """Draw a path of states and actions that passes no terminal state on its way."""
    live, anywhere = st.sampled_from(np.flatnonzero(~mdp.terminal).tolist()), st.integers
    states = data.draw(st.lists(live, min_size=1, max_size=12))
    states.append(data.draw(anywhere(0, mdp.shape[0] - 1)))
    n = len(states)
    actions = data.draw(st.lists(anywhere(0, mdp.shape[1] - 1), min_size=n, max_size=n))
    return np.array(states), np.array(actions)


@given(mdps(shaped_discounts), st.data())
def test_state_potential_telescopes(mdp, data):
    states, _ = random_path(data, mdp)
    phi = cr.StatePotential(mdp.task(), state_potentials(data, mdp) + 3.0)
    total = discounted(mdp, phi.shaping_reward(states[:-1], states[1:]))
    here, there = phi.values[0, states[0]], phi.values[0, states[-1]]
    assert total == pytest.approx(mdp.discount ** (len(states) - 1) * there - here, abs=1e-9)
    if mdp.terminal[states[-1]]:
        assert total == pytest.approx(-here, abs=1e-9)


@given(mdps(shaped_discounts), st.data())
def test_dynamic_potential_telescopes(mdp, data):
    states, _ = random_path(data, mdp)
    phi = cr.StatePotential(
        mdp.task(), state_potentials(data, mdp, (3,)), frame_steps=(0, 2, 5),
        weight=cr.learning.linear(1.0, 0.25, steps=8),
    )  # fmt: skip
    steps = range(len(states) - 1)
    paid = [phi.shaping_reward(states[t], states[t + 1], step=t) for t in steps]
    expected = mdp.discount ** len(steps) * phi.at(len(steps))[states[-1]] - phi.at(0)[states[0]]
    assert discounted(mdp, paid) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("discount", [0.5, 0.9, 1.0])
@pytest.mark.parametrize("length", [1, 2, 6])
def test_learnt_shaping_rewards_sum_to_nothing_but_the_start(length, discount):
    # On a corridor with one way to go, learnt at rate 1, Q(s) is the exact discounted sum of what
    # is paid from s to the end: F must add -Phi(s).
    rng = np.random.default_rng(length)
    reward, phi = rng.normal(size=length), rng.normal(size=(length + 1, 1))
    outcomes = [[[(1.0, s + 1, reward[s])]] for s in range(length)]
    task = cr.FiniteMDP.from_outcomes(
        [*outcomes, [[]]], terminal=np.arange(length + 1) == length, start=0, discount=discount
    )
    exact = cr.solve(task).values[:-1]

    def learnt(shaping):
        return cr.learn(task, cr.SARSA(learning_rate=1.0), 200, shaping=shaping).values[0, :-1, 0]

    assert learnt(cr.LookAheadAdvice(phi)) == pytest.approx(exact)
    # `values` has Phi added again.
    assert learnt(cr.StateShaping(phi[:, 0])) == pytest.approx(exact)
