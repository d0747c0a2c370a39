"""Certificates of potentials on random MDPs: what theory proves is certified."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

import curricle as cr
from curricle.certificate import ShapingReward, certify
from curricle.certificate.sampled import discounted_sums
from tests.certificates import difference
from tests.enumeration import all_discounts, met_states, pairs_of, states_of
from tests.tasks import mdps


@given(mdps(all_discounts), st.data())
def test_every_state_potential_certifies(mdp, data):
    task = mdp.task()
    phi = cr.StatePotential(task, states_of(data, mdp))
    found = certify(task, cr.StateShaping(phi))
    assert found.holds is True
    assert found.states == len(met_states(mdp))
    assert found.residual <= 2 * found.error_bound + 1e-9
    assert found.findings == ()


@given(mdps(all_discounts), st.sampled_from([cr.QInitialisation, cr.LookAheadAdvice]), st.data())
def test_every_state_action_potential_certifies(mdp, kind, data):
    task = mdp.task()
    phi = cr.StateActionPotential(task, pairs_of(data, mdp))
    found = certify(task, kind(phi))
    assert found.holds is True
    assert found.residual <= 2 * found.error_bound + 1e-9


@given(mdps(all_discounts), st.data())
def test_decaying_advice_certifies(mdp, data):
    weight = data.draw(
        st.sampled_from(
            [
                cr.learning.linear(1, 0, steps=9),
                cr.learning.harmonic(),
                cr.learning.exponential(1, half_life=5),
            ]
        )
    )
    assert certify(mdp.task(), cr.DecayingAdvice(pairs_of(data, mdp), weight))


@given(mdps(), st.data())
def test_a_changing_potential_certifies(mdp, data):
    task = mdp.task()
    frames = np.stack([states_of(data, mdp) for _ in range(3)])
    weight = data.draw(
        st.sampled_from([1.0, cr.learning.linear(1, 0.25, steps=8), cr.learning.harmonic(2, -1)])
    )
    phi = cr.StatePotential(task, frames, frame_steps=(0, 2, 5), weight=weight)
    assert certify(task, cr.StateShaping(phi))


@given(mdps((0.3, 0.75, 0.95)), st.data())
def test_look_back_advice_is_safe_only_where_ways_agree_and_never_refuted(mdp, data):
    # Few different numbers, so that ways that meet may agree.
    phi = pairs_of(data, mdp, st.sampled_from([0, 0, 0, 5]))
    found = certify(mdp.task(), cr.LookBackAdvice(phi))
    entered = [{0.0} if s == 0 else set() for s in range(mdp.shape[0])]
    for s in met_states(mdp):
        for a in range(mdp.shape[1]):
            for after in np.flatnonzero(mdp.p[s, a]):
                entered[after].add(phi[s, a])
    one_past = all(len(entered[s]) == 1 for s in met_states(mdp))
    assert found.holds is (True if one_past else None)
    if one_past:
        assert found.residual <= 2 * found.error_bound + 1e-9


@given(mdps(), st.integers(0, 99), st.data())
def test_samples_never_contradict_a_potential(mdp, seed, data):
    reward = ShapingReward(difference(mdp.zero_at_ends(states_of(data, mdp)), mdp.discount))
    sample = certify(mdp.task(), reward, method="sampled", steps=600, seed=seed)
    assert sample.holds is None
    assert sample.contradictions == ()
    assert sample.residual <= 1e-7


@given(mdps(), st.data())
def test_samples_contradict_only_what_has_no_potential(mdp, data):
    task = mdp.task()
    f = data.draw(arrays(np.int64, mdp.p.shape, elements=st.integers(0, 1))).astype(float)

    def bonus(s, a, after):
        return f[s, a, after]

    sampled = certify(task, ShapingReward(bonus), method="sampled", steps=600)
    exact = certify(task, ShapingReward(bonus))
    if sampled.contradictions:
        assert exact.residual > 1e-5
        assert not any(one.startswith(f"F = {mdp.discount:g} Phi") for one in exact.findings)


@given(arrays(np.float64, (3, 5), elements=st.floats(-9, 9)), st.integers(0, 5), st.data())
def test_sums_equal_those_added_up_one_by_one(paid, length, data):
    discount = data.draw(st.sampled_from([0.0, 0.5, 0.9, 1.0]))
    counts = np.tile(np.arange(5) < length, (3, 1))
    sums = discounted_sums(paid, counts, discount)
    for walk, t in np.ndindex(3, 5):
        expected = sum(discount ** (i - t) * paid[walk, i] for i in range(t, length))
        assert sums[walk, t] == pytest.approx(expected, abs=1e-9)
