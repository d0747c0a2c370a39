"""The theorems of reward shaping, on random MDPs whose shaped tables are written out here.

Two exact solutions are compared within the sum of their proven error bounds."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

import curricle as cr
from tests.support.enumeration import all_discounts, states_of
from tests.support.tasks import DenseMDP, mdps


def bound(*solutions):
    return sum(s.error_bound for s in solutions) + 1e-12


def shaping(mdp, phi):
    """Return F(s, s') = gamma Phi(s') - Phi(s), (S, 1, S) (paper E2)."""
    return mdp.discount * phi[None, None, :] - phi[:, None, None]


@given(mdps(all_discounts), st.data())
def test_state_potential_shifts_the_optimum_and_keeps_its_policies(mdp, data):
    phi = mdp.zero_at_ends(states_of(data, mdp))
    plain, shaped = cr.solve(mdp.task()), cr.solve(mdp.task(shaping(mdp, phi)))
    assert abs(shaped.values - (plain.values - phi)).max() <= bound(plain, shaped)
    difference = shaped.action_values - (plain.action_values - phi[:, None])
    assert abs(difference[~mdp.terminal]).max() <= bound(plain, shaped)
    np.testing.assert_array_equal(shaped.optimal, plain.optimal)


@given(mdps(), st.data())
def test_dynamic_potential_keeps_the_optimal_policies_at_every_time(mdp, data):
    # A state of the shaped MDP is (s, t); the last frame holds for ever.
    frames = data.draw(st.integers(2, 4))
    phi = np.stack([mdp.zero_at_ends(states_of(data, mdp)) for _ in range(frames)])
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


def random_path(data, mdp):
    """Draw a path of states that passes no terminal state on its way."""
    live = st.sampled_from(np.flatnonzero(~mdp.terminal).tolist())
    states = data.draw(st.lists(live, min_size=1, max_size=12))
    return np.array([*states, data.draw(st.integers(0, mdp.shape[0] - 1))])


@given(mdps(all_discounts), st.sampled_from([1, 3]), st.data())
def test_state_potential_telescopes(mdp, frames, data):
    """One that stays as it is, and one that changes while learning."""
    states = random_path(data, mdp)
    values, weight = np.stack([states_of(data, mdp) for _ in range(frames)]) + 3.0, 1.0
    if frames > 1:
        weight = cr.learning.linear(1.0, 0.25, steps=8)
    phi = cr.StatePotential(mdp.task(), values, frame_steps=(0, 2, 5)[:frames], weight=weight)
    steps = range(len(states) - 1)
    paid = [phi.shaping_reward(states[t], states[t + 1], step=t) for t in steps]
    expected = mdp.discount ** len(steps) * phi.at(len(steps))[states[-1]] - phi.at(0)[states[0]]
    total = sum(mdp.discount**t * f for t, f in enumerate(paid))
    assert total == pytest.approx(expected, abs=1e-9)
    if mdp.terminal[states[-1]]:
        assert total == pytest.approx(-phi.at(0)[states[0]], abs=1e-9)


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
