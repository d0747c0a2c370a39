"""The oracle of certificates: small MDPs whose policies are enumerated one by one.

It does not use the library: the values of a policy are one linear system, and the optimum is the
best of all deterministic policies.
"""

from itertools import product

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

CLOSE = 1e-5
"""Well above the tolerance of a certificate of values of the sizes drawn, 1e-6 of them."""
whole = st.integers(-8, 8)
all_discounts = (0.3, 0.75, 0.95, 1.0)


def states_of(data, mdp, elements=whole):
    """Draw Phi, (S,)."""
    return data.draw(arrays(np.int64, mdp.shape[0], elements=elements)).astype(float)


def pairs_of(data, mdp, elements=whole):
    """Draw phi, (S, A)."""
    return data.draw(arrays(np.int64, mdp.shape, elements=elements)).astype(float)


def met_states(mdp):
    """Return the live states that can be reached, by powers of the transition matrix."""
    step = (mdp.p.sum(axis=1) > 0) & ~mdp.terminal[:, None]
    reach = np.linalg.matrix_power(np.eye(len(step)) + step, len(step))[0] > 0
    return np.flatnonzero(reach & ~mdp.terminal)


def mean_rewards(mdp, added=0.0):
    """Return the mean reward of every pair with F, (S, A, S) or broadcast to it, added."""
    return (mdp.p * (mdp.r + added)).sum(axis=2)


def policy_values(mdp, policy, reward):
    """Return V of a deterministic policy by one linear system."""
    live = np.flatnonzero(~mdp.terminal)
    step = mdp.p[live, policy[live]][:, live]
    v = np.zeros(len(mdp.terminal))
    paid = reward[live, policy[live]]
    v[live] = np.linalg.solve(np.eye(len(live)) - mdp.discount * step, paid)
    return v


def optimal_policies(mdp, added=0.0):
    """Return V* and every deterministic policy that attains it in all states that are met."""
    n, a = mdp.shape
    reward, ends = mean_rewards(mdp, added), np.flatnonzero(mdp.terminal)
    policies = [np.array(p) for p in product(range(a), repeat=n) if not any(p[s] for s in ends)]
    each = [(policy, policy_values(mdp, policy, reward)) for policy in policies]
    best, states = np.max([v for _, v in each], axis=0), met_states(mdp)
    return best, [p for p, v in each if (v[states] >= best[states] - CLOSE).all()]


def action_values(mdp, v):
    """Return Q of V, 0 at ends."""
    return mdp.zero_at_ends(mean_rewards(mdp) + mdp.discount * mdp.p @ v)


def agrees_with_enumeration(mdp, found, added):
    """Hold a certificate of the rewards r + `added` to all deterministic policies."""
    best, kept = optimal_policies(mdp)
    _, taken = optimal_policies(mdp, added)
    states, reward = met_states(mdp), mean_rewards(mdp)
    losses = [(best - policy_values(mdp, policy, reward))[states].max() for policy in taken]
    assert found.holds in (True, False)
    assert max(losses) == pytest.approx(found.total_loss, abs=CLOSE)
    if found:
        assert {tuple(p[met_states(mdp)]) for p in taken} == {
            tuple(p[met_states(mdp)]) for p in kept
        }
        assert found.loss <= found.tolerance + 2 * found.error_bound
        return
    q = action_values(mdp, best)
    worst = found.counterexample
    s, a, b = worst.state, worst.action, worst.shaped_action
    assert s in states
    assert worst.values == pytest.approx((q[s, a], q[s, b]), abs=CLOSE)
    assert q[s, a] == pytest.approx(q[s].max(), abs=CLOSE)
    assert worst.lost == pytest.approx(q[s, a] - q[s, b], abs=CLOSE)
    # Some policy optimal in the shaped task does so, and so loses no less from there on.
    acting = [p for p in taken if p[s] == b]
    assert acting
    assert (
        max((best - policy_values(mdp, p, mean_rewards(mdp)))[s] for p in acting)
        >= worst.lost - CLOSE
    )
    assert found.total_loss >= found.loss - CLOSE
    assert found.loss >= worst.lost - CLOSE
    if worst.lost == 0:  # an optimal action that no policy of the shaped task takes any more
        assert any(p[s] == a for p in kept)
        assert not any(p[s] == a for p in taken)
