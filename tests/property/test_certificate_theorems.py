"""Certificates on random MDPs: what theory proves is certified, and a potential is found again."""

import numpy as np
from hypothesis import given, strategies as st

import curricle as cr
from curricle.certificate import ShapingReward, certify
from curricle.certificate.shaped_task import Reachable, fit
from tests.support.certificates import difference
from tests.support.enumeration import all_discounts, met_states, pairs_of, states_of
from tests.support.tasks import mdps


@given(mdps(all_discounts), st.data())
def test_every_state_potential_certifies(mdp, data):
    task = mdp.task()
    phi = cr.StatePotential(task, states_of(data, mdp))
    certificate = certify(task, cr.StateShaping(phi))
    assert certificate.holds is True
    assert certificate.states == len(met_states(mdp))
    assert certificate.residual <= 2 * certificate.error_bound + 1e-9
    assert certificate.findings == ()


@given(mdps(all_discounts), st.sampled_from([cr.QInitialisation, cr.LookAheadAdvice]), st.data())
def test_every_state_action_potential_certifies(mdp, kind, data):
    pairs, task = pairs_of(data, mdp), mdp.task()
    certificate = certify(task, kind(cr.StateActionPotential(task, pairs)))
    assert certificate.holds is True
    assert certificate.residual <= 2 * certificate.error_bound + 1e-9


@given(mdps(), st.data())
def test_a_changing_potential_certifies(mdp, data):
    frames = np.stack([states_of(data, mdp) for _ in range(3)])
    changing = cr.learning.linear(1, 0.25, steps=8), cr.learning.harmonic(2, -1)
    weight = data.draw(st.sampled_from([1.0, *changing]))
    phi = cr.StatePotential(mdp.task(), frames, frame_steps=(0, 2, 5), weight=weight)
    assert certify(phi.task, cr.StateShaping(phi))


def reachable(mdp, function):
    """Return the reachable part of a task and F of its transitions."""
    met = Reachable.of(mdp.task())
    return met, met.reward(function)


@given(mdps(all_discounts), st.data())
def test_f_made_of_a_potential_is_recognised_and_the_potential_found(mdp, data):
    phi = mdp.zero_at_ends(states_of(data, mdp))
    certificate = certify(mdp.task(), ShapingReward(difference(phi, mdp.discount)))
    # Two actions may be equally good in a way that is not proven; F of 0 changes none.
    equal = (
        np.diff(np.sort(cr.solve(mdp.task()).action_values)) <= 2 * certificate.error_bound
    ).any()
    assert certificate.holds or (certificate.holds is None and equal and phi.any())
    assert certificate.residual <= 1e-9
    np.testing.assert_allclose(
        certificate.potential[met_states(mdp)], phi[met_states(mdp)], atol=1e-8
    )


@given(mdps(all_discounts), st.data())
def test_f_of_more_than_a_potential_does_not_fit(mdp, data):
    phi = mdp.zero_at_ends(states_of(data, mdp))
    table = mdp.discount * phi - phi[:, None, None] + np.zeros(mdp.p.shape)
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
