"""Certificates on random MDPs, against policies enumerated one by one and theory written out.

The oracle knows nothing of the library: a policy's values are one linear system, and the optimum
is the best of all deterministic policies.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
import pytest
from hypothesis import assume, given, strategies as st
from hypothesis.extra.numpy import arrays

import curricle as cr
from curricle.certificate import shaped
from curricle.certificate.bonus import fit, moves_of, second_discount
from curricle.certificate.certification import certify
from curricle.certificate.given import ShapingReward
from curricle.certificate.sampled import discounted_sums

CLOSE = 1e-5
"""Well above the tolerance of a certificate of values of the sizes drawn, 1e-6 of them."""


@dataclass(frozen=True)
class Dense:
    """A small MDP as dense arrays: P and r (S, A, S); every episode starts in state 0."""

    p: np.ndarray
    r: np.ndarray
    terminal: np.ndarray
    discount: float

    @property
    def shape(self):
        return self.p.shape[:2]

    @cached_property
    def task(self):
        return cr.FiniteMDP.from_dense(
            self.p, self.r, terminal=self.terminal, start=0, discount=self.discount
        )

    @property
    def met(self):
        """Live states that can be reached, by powers of the transition matrix."""
        step = (self.p.sum(axis=1) > 0) & ~self.terminal[:, None]
        reach = np.linalg.matrix_power(np.eye(len(step)) + step, len(step))[0] > 0
        return np.flatnonzero(reach & ~self.terminal)

    def paid(self, added=0.0):
        """Mean reward of every pair with F, (S, A, S) or broadcast to it, added."""
        return (self.p * (self.r + added)).sum(axis=2)

    def values(self, policy, reward):
        """V of a deterministic policy by one linear system."""
        live = np.flatnonzero(~self.terminal)
        step = self.p[live, policy[live]][:, live]
        v = np.zeros(len(self.terminal))
        paid = reward[live, policy[live]]
        v[live] = np.linalg.solve(np.eye(len(live)) - self.discount * step, paid)
        return v

    def policies(self):
        n, a = self.shape
        for choice in product(range(a), repeat=n):
            if not any(choice[s] for s in np.flatnonzero(self.terminal)):
                yield np.array(choice)

    def optimal(self, added=0.0):
        """V* and every deterministic policy that attains it wherever it is met."""
        reward = self.paid(added)
        each = [(policy, self.values(policy, reward)) for policy in self.policies()]
        best = np.max([v for _, v in each], axis=0)
        return best, [p for p, v in each if (v[self.met] >= best[self.met] - CLOSE).all()]

    def action_values(self, v, added=0.0):
        q = self.paid(added) + self.discount * self.p @ v
        return np.where(self.terminal[:, None], 0.0, q)


@st.composite
def mdps(draw, discounts=(0.3, 0.75, 0.95), max_states=4, max_actions=3, loose=False):
    """Draw an MDP; at discount 1 one whose every policy ends; `loose`: every move may happen."""
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
    return Dense(weights / weights.sum(axis=2, keepdims=True), reward, terminal, discount)


whole = st.integers(-8, 8)
all_discounts = (0.3, 0.75, 0.95, 1.0)


def states_of(data, mdp, elements=whole):
    return data.draw(arrays(np.int64, mdp.shape[0], elements=elements)).astype(float)


def pairs_of(data, mdp, elements=whole):
    return data.draw(arrays(np.int64, mdp.shape, elements=elements)).astype(float)


def zero_at_ends(mdp, values):
    return np.where(mdp.terminal.reshape(-1, *[1] * (values.ndim - 1)), 0.0, values)


def difference(phi, discount):
    return lambda s, a, after: discount * phi[after] - phi[s]


def agrees_with_enumeration(mdp, found, added):
    """Hold a certificate of the rewards r + `added` to all deterministic policies."""
    best, kept = mdp.optimal()
    _, taken = mdp.optimal(added)
    losses = [
        (best - mdp.values(policy, mdp.paid()))[mdp.met].max() for policy in taken
    ]  # fmt: skip
    assert found.holds in (True, False)
    assert max(losses) == pytest.approx(found.total_loss, abs=CLOSE)
    if found:
        assert {tuple(p[mdp.met]) for p in taken} == {tuple(p[mdp.met]) for p in kept}
        assert found.loss <= found.tolerance + 2 * found.error_bound
        return
    q = mdp.action_values(best)
    worst = found.counterexample
    s, a, b = worst.state, worst.action, worst.shaped_action
    assert s in mdp.met
    assert worst.values == pytest.approx((q[s, a], q[s, b]), abs=CLOSE)
    assert q[s, a] == pytest.approx(q[s].max(), abs=CLOSE)
    assert worst.lost == pytest.approx(q[s, a] - q[s, b], abs=CLOSE)
    # Some policy optimal in the shaped task does so, and so loses no less from there on.
    acting = [p for p in taken if p[s] == b]
    assert acting
    assert max((best - mdp.values(p, mdp.paid()))[s] for p in acting) >= worst.lost - CLOSE
    assert found.total_loss >= found.loss - CLOSE
    assert found.loss >= worst.lost - CLOSE
    if worst.lost == 0:  # an optimal action that no policy of the shaped task takes any more
        assert any(p[s] == a for p in kept)
        assert not any(p[s] == a for p in taken)


# -- what theory promises ------------------------------------------------------------------------


@given(mdps(all_discounts), st.data())
def test_every_state_potential_certifies(mdp, data):
    phi = cr.StatePotential(mdp.task, states_of(data, mdp))
    found = certify(mdp.task, cr.StateShaping(phi))
    assert found.holds is True
    assert found.states == len(mdp.met)
    assert found.residual <= 2 * found.error_bound + 1e-9
    assert found.findings == ()


@given(mdps(all_discounts), st.sampled_from([cr.QInitialisation, cr.LookAheadAdvice]), st.data())
def test_every_state_action_potential_certifies(mdp, kind, data):
    phi = cr.StateActionPotential(mdp.task, pairs_of(data, mdp))
    found = certify(mdp.task, kind(phi))
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
    assert certify(mdp.task, cr.DecayingAdvice(pairs_of(data, mdp), weight))


@given(mdps(), st.data())
def test_a_changing_potential_certifies(mdp, data):
    frames = np.stack([states_of(data, mdp) for _ in range(3)])
    weight = data.draw(
        st.sampled_from([1.0, cr.learning.linear(1, 0.25, steps=8), cr.learning.harmonic(2, -1)])
    )
    phi = cr.StatePotential(mdp.task, frames, frame_steps=(0, 2, 5), weight=weight)
    assert certify(mdp.task, cr.StateShaping(phi), seed=data.draw(st.integers(0, 9)))


@given(mdps((0.3, 0.75, 0.95)), st.data())
def test_look_back_advice_is_never_refuted_and_promised_only_where_ways_agree(mdp, data):
    # Few different numbers, so that ways that meet may agree.
    phi = pairs_of(data, mdp, st.sampled_from([0, 0, 0, 5]))
    found = certify(mdp.task, cr.LookBackAdvice(phi))
    entered = [{0.0} if s == 0 else set() for s in range(mdp.shape[0])]
    for s in mdp.met:
        for a in range(mdp.shape[1]):
            for after in np.flatnonzero(mdp.p[s, a]):
                entered[after].add(phi[s, a])
    one_past = all(len(entered[s]) == 1 for s in mdp.met)
    assert found.holds is (True if one_past else None)
    if one_past:
        assert found.residual <= 2 * found.error_bound + 1e-9


# -- what may be wrong ---------------------------------------------------------------------------


@given(mdps(), st.data())
def test_bonuses_are_judged_as_enumeration_judges_them(mdp, data):
    phi = pairs_of(data, mdp)
    found = certify(mdp.task, cr.RewardBonus(phi))
    agrees_with_enumeration(mdp, found, phi[:, :, None])


@given(mdps(), st.data())
def test_rewards_are_judged_as_enumeration_judges_them(mdp, data):
    f = data.draw(arrays(np.int64, mdp.p.shape, elements=whole)).astype(float)
    found = certify(mdp.task, ShapingReward(lambda s, a, after: f[s, a, after]))
    agrees_with_enumeration(mdp, found, f)


@given(mdps(), st.sampled_from([0.1, 0.5, 0.9, 1.0, None]), st.data())
def test_open_ends_and_second_discounts_are_judged_as_enumeration_judges_them(mdp, second, data):
    phi = states_of(data, mdp)
    found = certify(mdp.task, cr.StateShaping(phi), shaping_discount=second)
    discount = mdp.discount if second is None else second
    added = discount * phi[None, None, :] - phi[:, None, None]
    agrees_with_enumeration(mdp, found, added)
    ends = np.flatnonzero(mdp.terminal & ((mdp.p[mdp.met].sum(axis=(0, 1))) > 0) & (phi != 0))
    assert any("has Phi" in said for said in found.findings) is (ends.size > 0)
    assert any("second discount" in said for said in found.findings) is (discount != mdp.discount)
    # The same numbers as a reward of one's own are the same task.
    again = certify(mdp.task, ShapingReward(difference(phi, discount)))
    assert again.holds is found.holds
    assert again.total_loss == pytest.approx(found.total_loss, abs=CLOSE)


@given(mdps(), st.data())
def test_look_ahead_on_open_ends_is_judged_as_its_literal_operator(mdp, data):
    # 700 rounds from Q = 0 leave 0.95^700 = 3e-16 of the start.
    phi, q = pairs_of(data, mdp), np.zeros(mdp.shape)
    everywhere = np.arange(mdp.shape[0])
    for _ in range(700):
        best = (q + phi).argmax(axis=1)
        paid = mdp.discount * phi[everywhere, best][None, None, :] - phi[:, :, None]
        bootstrapped = mdp.discount * np.where(mdp.terminal, 0.0, q[everywhere, best])
        q = zero_at_ends(mdp, (mdp.p * (mdp.r + paid + bootstrapped)).sum(axis=2))
    task = mdp.task
    met = shaped.reached(task)
    own = shaped.solved(task, 1e-8)
    acted = shaped.with_look_ahead(own, met, phi)
    np.testing.assert_array_equal(met.states, mdp.met)
    np.testing.assert_allclose(acted.values, (q + phi)[mdp.met], atol=acted.bound + 1e-9)
    found = certify(task, cr.LookAheadAdvice(phi))
    best, kept = mdp.optimal()
    greedy = (q + phi) >= (q + phi).max(axis=1, keepdims=True) - CLOSE
    optimal = mdp.action_values(best) >= best[:, None] - CLOSE
    assert found.holds is bool((greedy == optimal)[mdp.met].all())
    assert kept


def test_a_table_that_starts_with_values_at_its_ends_is_refused():
    # Ending pays 1, going round pays 0; phi says that the end is worth -9.
    mdp = Dense(
        np.array([[[0.0, 1.0], [1.0, 0.0]], [[0.0, 1.0]] * 2]),
        np.array([[[0.0, 1.0], [0.0, 0.0]], [[0.0, 0.0]] * 2]),
        np.array([False, True]),
        0.9,
    )
    phi = np.array([[0.0, 0.0], [-9.0, -9.0]])
    found = certify(mdp.task, cr.LookAheadAdvice(phi))
    assert found.holds is False
    assert found.counterexample.lost == pytest.approx(0.1)  # once round, then in: 0.9
    assert found.total_loss == pytest.approx(1.0)  # round for ever
    assert found.counterexample.shaped_values == pytest.approx((1 - 8.1, 0.0))
    assert certify(mdp.task, cr.LookAheadAdvice(cr.StateActionPotential(mdp.task, phi)))


@given(mdps(), st.floats(0.1, 10.0), st.data())
def test_constant_advice_is_judged_as_greedy_policies_judge_it(mdp, weight, data):
    phi = pairs_of(data, mdp)
    best, _ = mdp.optimal()
    q = mdp.action_values(best)
    acted = q + weight * phi
    short = (acted.max(axis=1, keepdims=True) - acted)[mdp.met]
    assume(((short < 1e-9) | (short > CLOSE)).all())
    found = certify(mdp.task, cr.DecayingAdvice(phi, weight))
    optimal = (q >= best[:, None] - CLOSE)[mdp.met]
    assert found.holds is bool(((short < 1e-9) == optimal).all())
    lost = (best[:, None] - q)[mdp.met]
    assert found.loss == pytest.approx(lost[short < 1e-9].max(), abs=CLOSE)


# -- what F is made of ---------------------------------------------------------------------------


def taken_apart(mdp, f):
    met = shaped.reached(mdp.task)
    return moves_of(met, met.paid(f))


@given(mdps(all_discounts), st.data())
def test_f_made_of_a_potential_is_recognised_and_the_potential_found(mdp, data):
    phi = zero_at_ends(mdp, states_of(data, mdp))
    found = certify(mdp.task, ShapingReward(difference(phi, mdp.discount)))
    assert found.holds is True
    assert found.residual <= 1e-9
    np.testing.assert_allclose(found.potential[mdp.met], phi[mdp.met], atol=1e-8)
    # It is the value of any policy for rewards -F, of the uniform one say (Ng et al. 1999).
    paid = np.broadcast_to(difference_table(phi, mdp.discount), mdp.p.shape)
    against = Dense(mdp.p, -paid, mdp.terminal, mdp.discount)
    uniform = np.full(mdp.shape, 1 / mdp.shape[1])
    np.testing.assert_allclose(
        cr.evaluate(against.task, uniform).values[mdp.met], phi[mdp.met], atol=1e-6
    )


def difference_table(phi, discount):
    return np.broadcast_to(
        discount * phi[None, None, :] - phi[:, None, None], (len(phi), 1, len(phi))
    )


@given(mdps(all_discounts), st.data())
def test_f_that_looks_at_more_than_a_potential_is_not_taken_for_one(mdp, data):
    phi = zero_at_ends(mdp, states_of(data, mdp))
    table = np.broadcast_to(difference_table(phi, mdp.discount), mdp.p.shape).copy()
    possible = np.argwhere(mdp.p[mdp.met] > 0)
    s, a, after = data.draw(st.sampled_from(possible.tolist()))
    table[mdp.met[s], a, after] += 1.0
    moves = taken_apart(mdp, lambda s, a, after: table[s, a, after])
    # Whether a potential is behind F is a question of linear algebra.
    pairs = np.argwhere((mdp.p > 0) & np.isin(np.arange(mdp.shape[0]), mdp.met)[:, None, None])
    n = mdp.shape[0]
    system = mdp.discount * np.eye(n)[pairs[:, 2]] - np.eye(n)[pairs[:, 0]]
    system = system[:, ~mdp.terminal]
    f = table[tuple(pairs.T)]
    left = system @ np.linalg.lstsq(system, f, rcond=None)[0] - f
    assert (fit(moves, mdp.discount).worst <= 1e-6) is bool(abs(left).max() <= 1e-6)


@given(mdps(loose=True, max_states=5), st.floats(0.05, 1.0), st.integers(0, 99))
def test_a_second_discount_is_recovered(mdp, second, seed):
    assume(abs(second - mdp.discount) > 0.02)
    assume(np.count_nonzero(~mdp.terminal) > 1)
    phi = zero_at_ends(mdp, np.random.default_rng(seed).uniform(2.0, 9.0, mdp.shape[0]))
    found = second_discount(taken_apart(mdp, difference(phi, second)))
    assert found.discount == pytest.approx(second, abs=1e-3)
    np.testing.assert_allclose(found.potential[mdp.met], phi[mdp.met], rtol=1e-3)
    said = certify(mdp.task, ShapingReward(difference(phi, second))).findings
    assert said[0].startswith("shaped with a second discount: F = ")


@given(mdps(loose=True), st.integers(0, 99))
def test_open_ends_are_recovered(mdp, seed):
    # Every state can stay where it is, so that Phi is known without the ends.
    phi = np.random.default_rng(seed).uniform(2.0, 9.0, mdp.shape[0])
    found = fit(taken_apart(mdp, difference(phi, mdp.discount)), mdp.discount, ends_are_zero=False)
    assert found.worst <= 1e-9
    np.testing.assert_allclose(found.potential, phi, atol=1e-8)


@given(mdps(all_discounts), st.data())
def test_whatever_phi_and_its_ends_are_some_fit_leaves_nothing(mdp, data):
    phi = states_of(data, mdp)
    moves = taken_apart(mdp, difference(phi, mdp.discount))
    assert fit(moves, mdp.discount, ends_are_zero=False).worst <= 1e-7


# -- samples -------------------------------------------------------------------------------------


@given(mdps(), st.data())
def test_samples_never_contradict_a_potential(mdp, data):
    phi = states_of(data, mdp)
    pairs, seed = pairs_of(data, mdp), data.draw(st.integers(0, 99))
    task, ended = mdp.task, zero_at_ends(mdp, phi)
    for shaping in (
        cr.StateShaping(cr.StatePotential(task, phi)),
        cr.StateShaping(ended),
        cr.QInitialisation(cr.StateActionPotential(task, pairs)),
        cr.LookAheadAdvice(zero_at_ends(mdp, pairs)),
        ShapingReward(difference(ended, mdp.discount)),
    ):
        found = certify(task, shaping, method="sampled", steps=600, seed=seed)
        assert found.holds is None
        assert "no contradiction" in found.findings[0]
        assert found.residual <= 1e-7


@given(mdps(), st.data())
def test_what_samples_contradict_is_no_potential(mdp, data):
    f = data.draw(arrays(np.int64, mdp.p.shape, elements=st.integers(0, 1))).astype(float)

    def bonus(s, a, after):
        return f[s, a, after]

    sampled = certify(mdp.task, ShapingReward(bonus), method="sampled", steps=600)
    exact = certify(mdp.task, ShapingReward(bonus))
    if "not potential-based" in sampled.findings[0]:
        assert exact.residual > 1e-5
        assert not exact.findings[0].startswith(f"F = {mdp.discount:g} Phi")


@given(arrays(np.float64, (3, 5), elements=st.floats(-9, 9)), st.integers(0, 5), st.data())
def test_sums_are_those_added_up_one_by_one(paid, length, data):
    discount = data.draw(st.sampled_from([0.0, 0.5, 0.9, 1.0]))
    counts = np.tile(np.arange(5) < length, (3, 1))
    sums = discounted_sums(paid, counts, discount)
    for walk, t in np.ndindex(3, 5):
        expected = sum(discount ** (i - t) * paid[walk, i] for i in range(t, length))
        assert sums[walk, t] == pytest.approx(expected, abs=1e-9)
