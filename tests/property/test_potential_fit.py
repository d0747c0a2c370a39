"""The potential behind a shaping reward, found again on random MDPs."""

import numpy as np
from hypothesis import given, strategies as st

import curricle as cr
from curricle.certificate import ShapingReward, certify
from curricle.certificate.diagnosis import fit
from curricle.certificate.shaped_task import Reachable
from tests.certificates import difference
from tests.enumeration import all_discounts, met_states, states_of
from tests.tasks import DenseMDP, mdps


def reachable(mdp, function):
    """Return the reachable part of a task and F of its transitions."""
    met = Reachable.of(mdp.task())
    return met, met.reward(function)


@given(mdps(all_discounts), st.data())
def test_f_made_of_a_potential_is_recognised_and_the_potential_found(mdp, data):
    phi = mdp.zero_at_ends(states_of(data, mdp))
    found = certify(mdp.task(), ShapingReward(difference(phi, mdp.discount)))
    # Two actions may be equally good in a way that is not proven; F of 0 changes none.
    equal = (np.diff(np.sort(cr.solve(mdp.task()).action_values)) <= 2 * found.error_bound).any()
    assert found.holds or (found.holds is None and equal and phi.any())
    assert found.residual <= 1e-9
    np.testing.assert_allclose(found.potential[met_states(mdp)], phi[met_states(mdp)], atol=1e-8)
    # It is the value of any policy for rewards -F, of the uniform one say (Ng et al. 1999).
    paid = np.broadcast_to(difference_table(phi, mdp.discount), mdp.p.shape)
    against = DenseMDP(mdp.p, -paid, mdp.terminal, mdp.discount)
    uniform = np.full(mdp.shape, 1 / mdp.shape[1])
    np.testing.assert_allclose(
        cr.evaluate(against.task(), uniform).values[met_states(mdp)],
        phi[met_states(mdp)],
        atol=1e-6,
    )


def difference_table(phi, discount):
    return np.broadcast_to(
        discount * phi[None, None, :] - phi[:, None, None], (len(phi), 1, len(phi))
    )


@given(mdps(all_discounts), st.data())
def test_f_of_more_than_a_potential_does_not_fit(mdp, data):
    phi = mdp.zero_at_ends(states_of(data, mdp))
    table = np.broadcast_to(difference_table(phi, mdp.discount), mdp.p.shape).copy()
    possible = np.argwhere(mdp.p[met_states(mdp)] > 0)
    s, a, after = data.draw(st.sampled_from(possible.tolist()))
    table[met_states(mdp)[s], a, after] += 1.0
    met, paid = reachable(mdp, lambda s, a, after: table[s, a, after])
    # Whether a potential is behind F is a question of linear algebra.
    pairs = np.argwhere(
        (mdp.p > 0) & np.isin(np.arange(mdp.shape[0]), met_states(mdp))[:, None, None]
    )
    n = mdp.shape[0]
    system = mdp.discount * np.eye(n)[pairs[:, 2]] - np.eye(n)[pairs[:, 0]]
    system = system[:, ~mdp.terminal]
    f = table[tuple(pairs.T)]
    left = system @ np.linalg.lstsq(system, f, rcond=None)[0] - f
    assert (fit(met, paid, mdp.discount).worst <= 1e-6) is bool(abs(left).max() <= 1e-6)


@given(mdps(loose=True), st.integers(0, 99))
def test_open_ends_are_recovered(mdp, seed):
    # Every state can stay where it is, so that Phi is known without the ends.
    phi = np.random.default_rng(seed).uniform(2.0, 9.0, mdp.shape[0])
    found = fit(*reachable(mdp, difference(phi, mdp.discount)), mdp.discount, ends_are_zero=False)
    assert found.worst <= 1e-9
    np.testing.assert_allclose(found.potential, phi, atol=1e-8)


@given(mdps(all_discounts), st.data())
def test_whatever_phi_and_its_ends_are_some_fit_leaves_nothing(mdp, data):
    phi = states_of(data, mdp)
    met, f = reachable(mdp, difference(phi, mdp.discount))
    assert fit(met, f, mdp.discount, ends_are_zero=False).worst <= 1e-7
