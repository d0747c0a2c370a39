"""The oracle of certificates: small MDPs solved in exact fractions, or every policy in turn."""

from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from curricle.tasks.graph import steps_to

CLOSE = 1e-5
"""Well above the error of a certificate's values of the sizes drawn."""
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


def fractions(array):
    """Return an array of the fractions, of small denominators, that numbers were drawn as."""
    simple = np.vectorize(lambda x: Fraction(x).limit_denominator(1000), otypes=[object])
    return simple(np.asarray(array))


def policy_values(mdp, policy, reward):
    """Return V of a deterministic policy, by elimination in one linear system."""
    live = np.flatnonzero(~mdp.terminal)
    step = fractions(mdp.p)[live, policy[live]][:, live]
    rows = fractions(np.eye(len(live))) - fractions(mdp.discount)[()] * step
    paid = reward[live, policy[live]]
    v = fractions(np.zeros(len(mdp.terminal)))
    v[live] = eliminated(np.column_stack([rows, paid]))
    return v


def eliminated(rows):
    """Return the solution of a linear system of fractions, whose last column is its right side."""
    for i in range(len(rows)):
        pivot = next(k for k in range(i, len(rows)) if rows[k, i] != 0)
        rows[[i, pivot]] = rows[[pivot, i]]
        rows[i] = rows[i] / rows[i, i]
        for k in set(range(len(rows))) - {i}:
            if rows[k, i] != 0:
                rows[k] = rows[k] - rows[k, i] * rows[i]
    return rows[:, -1]


def mean_rewards(mdp, added=0.0):
    """Return the mean reward of every pair with F, (S, A, S) or broadcast to it, added."""
    return (fractions(mdp.p) * (fractions(mdp.r) + fractions(added))).sum(axis=2)


def action_values(mdp, added=0.0, allowed=None, sign=1):
    """Return the best Q of policies of allowed actions, (S, A); the worst where sign is -1."""
    reward = mean_rewards(mdp, added)
    allowed = np.ones(mdp.shape, bool) if allowed is None else allowed
    policy = allowed.argmax(axis=1)
    while True:
        v = policy_values(mdp, policy, reward)
        q = reward + fractions(mdp.discount)[()] * (fractions(mdp.p) @ v)
        ranked = np.where(allowed, sign * q, min(sign * q.ravel()) - 1)
        better = ranked.argmax(axis=1)
        places = np.arange(len(policy))
        gains = (ranked[places, better] > ranked[places, policy]) & ~mdp.terminal
        if not gains.any():
            return q
        policy = np.where(gains, better, policy)


# -- tables of doubles, which count as exact -------------------------------------------------------


def exact_values(mdp, policy):
    """Return V of a policy of one action a state, by elimination in exact rational numbers."""
    n, gamma = mdp.states.size, Fraction(mdp.discount)
    rows = np.array([[Fraction(int(i == j)) for j in range(n + 1)] for i in range(n)])
    rows[:, n] = Fraction(0)
    for s in np.flatnonzero(~mdp.terminal):
        row = mdp.outcome_row[s, policy[s]]
        for p, after, r in zip(
            mdp.probability[row], mdp.next_state[row], mdp.reward[row], strict=True
        ):
            rows[s, n] += Fraction(p) * Fraction(r)
            if not mdp.terminal[after]:
                rows[s, after] -= gamma * Fraction(p)
    return eliminated(rows).tolist()


def exact_optimum(mdp):
    """Return V*, of the best of all policies of one action a state that end, or are discounted."""
    n, n_actions = mdp.outcome_row.shape
    acting = np.flatnonzero(~mdp.terminal)
    best = [None] * n
    for chosen in product(range(n_actions), repeat=len(acting)):
        policy = np.zeros(n, np.int64)
        policy[acting] = chosen
        away = steps_to(mdp, mdp.terminal, taken=np.eye(n_actions, dtype=bool)[policy])
        if mdp.discount == 1 and np.isinf(away).any():
            continue
        values = exact_values(mdp, policy)
        best = [v if b is None else max(v, b) for v, b in zip(values, best, strict=True)]
    return best


def exact_action_values(mdp, values):
    """Return Q(s, a) = sum_s' P(s' | s, a) (r + gamma V(s')) of states that are not terminal."""
    gamma = Fraction(mdp.discount)
    q = {}
    for s, a in product(np.flatnonzero(~mdp.terminal), range(mdp.actions.size)):
        row = mdp.outcome_row[s, a]
        outcomes = zip(mdp.probability[row], mdp.next_state[row], mdp.reward[row], strict=True)
        q[s, a] = sum(Fraction(p) * (Fraction(r) + gamma * values[t]) for p, t, r in outcomes)
    return q


# -- certificates ----------------------------------------------------------------------------------


def best_actions(q):
    """Return which actions are exactly the best, (S, A)."""
    return q == q.max(axis=1, keepdims=True)


def total_loss(mdp, chosen):
    """Return the most that a policy of chosen actions, (S, A), loses from a state that is met."""
    best = action_values(mdp).max(axis=1)
    allowed = chosen | ~chosen.any(axis=1, keepdims=True)
    q = action_values(mdp, allowed=allowed, sign=-1)
    worst = np.where(allowed, q, q.max() + 1).min(axis=1)
    return max((best - worst)[met_states(mdp)])


def agrees_exactly(mdp, certificate, added):
    """Hold a certificate of the rewards r + `added` to the exact optimal actions of both."""
    states, q = met_states(mdp), action_values(mdp)
    acted = action_values(mdp, added)
    agrees_with_values(mdp, certificate, q, acted)
    optimal, chosen = best_actions(q), best_actions(acted)
    lost = total_loss(mdp, chosen)
    assert certificate.total_loss >= lost
    if certificate.holds is not None:
        close = 40 * certificate.error_bound + 1e-6 * float(abs(q).max())
        assert certificate.total_loss == pytest.approx(float(lost), abs=close)
    if certificate.holds is False:
        s, a, b = (
            getattr(certificate.counterexample, n) for n in ("state", "action", "shaped_action")
        )
        assert s in states
        values = float(q[s, a]), float(q[s, b])
        assert certificate.counterexample.values == pytest.approx(
            values, abs=2 * certificate.error_bound
        )
        assert optimal[s, a] or certificate.counterexample.lost == 0
        assert certificate.counterexample.lost == pytest.approx(
            float(q[s, a] - q[s, b]) if certificate.counterexample.lost else 0,
            abs=4 * certificate.error_bound,
        )


def agrees_with_values(mdp, certificate, q, acted):
    """Hold a certificate to the exact values, (S, A), of the task and those acted on."""
    states = met_states(mdp)
    optimal, chosen = best_actions(q)[states], best_actions(acted)[states]
    if certificate.holds is None:  # then two values are close, or equal
        differences = [
            np.sort(values[states].max(axis=1, keepdims=True) - values[states], axis=1)[:, 1:]
            for values in (q, acted)
        ]
        assert min(min(part.ravel()) for part in differences) <= 4 * certificate.error_bound
    else:
        assert certificate.holds is bool((optimal == chosen).all())
    short = (q.max(axis=1, keepdims=True) - q)[states]
    lost = max(short[chosen])
    assert certificate.loss >= lost
    if certificate.holds is not None:
        assert certificate.loss == pytest.approx(float(lost), abs=40 * certificate.error_bound)
