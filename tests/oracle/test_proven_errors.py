"""The proven error of exact planning: never exceeded, against exact rational arithmetic."""

from fractions import Fraction
from itertools import product

import numpy as np
import pytest

import curricle as cr
from curricle.errors import SettingError
from tests import tasks

SCALES = (1e-9, 1.0, 1e7)


def exact_values(mdp, policy):
    """Return V of a policy of one action a state, by elimination in exact rational numbers."""
    n, gamma = mdp.states.size, Fraction(mdp.discount)
    rows = [[Fraction(int(i == j)) for j in range(n)] + [Fraction(0)] for i in range(n)]
    for s in np.flatnonzero(~mdp.terminal):
        row = mdp.outcome_row[s, policy[s]]
        for p, after, r in zip(
            mdp.probability[row], mdp.next_state[row], mdp.reward[row], strict=True
        ):
            rows[s][-1] += Fraction(p) * Fraction(r)
            if not mdp.terminal[after]:
                rows[s][after] -= gamma * Fraction(p)
    for i in range(n):
        pivot = next(j for j in range(i, n) if rows[j][i] != 0)
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [x / rows[i][i] for x in rows[i]]
        for j in range(n):
            if j != i and rows[j][i] != 0:
                rows[j] = [x - rows[j][i] * y for x, y in zip(rows[j], rows[i], strict=True)]
    return [row[-1] for row in rows]


def exact_optimum(mdp):
    """Return V*, of the best of all policies of one action a state."""
    n, n_actions = mdp.outcome_row.shape
    acting = np.flatnonzero(~mdp.terminal)
    best = [None] * n
    for chosen in product(range(n_actions), repeat=len(acting)):
        policy = np.zeros(n, np.int64)
        policy[acting] = chosen
        values = exact_values(mdp, policy)
        best = [v if b is None else max(v, b) for v, b in zip(values, best, strict=True)]
    return best


def exact_action_values(mdp, values):
    """Return Q(s, a) = sum_s' P(s' | s, a) (r + gamma V(s')) of states that are not terminal."""
    gamma = Fraction(mdp.discount)
    found = {}
    for s, a in product(np.flatnonzero(~mdp.terminal), range(mdp.actions.size)):
        row = mdp.outcome_row[s, a]
        outcomes = zip(mdp.probability[row], mdp.next_state[row], mdp.reward[row], strict=True)
        found[s, a] = sum(Fraction(p) * (Fraction(r) + gamma * values[t]) for p, t, r in outcomes)
    return found


def within_the_bound(found, mdp, values):
    bound = Fraction(found.error_bound)
    assert all(abs(Fraction(v) - e) <= bound for v, e in zip(found.values, values, strict=True))
    q = exact_action_values(mdp, values)
    return all(abs(Fraction(found.action_values[pair]) - e) <= bound for pair, e in q.items())


def scaled(mdp, factor, excess=0.0):
    """Return an MDP with larger rewards, and probabilities that sum to 1 + excess."""
    fields = {name: getattr(mdp, name) for name in mdp.__dataclass_fields__}
    fields |= {"reward": mdp.reward * factor, "probability": mdp.probability * (1 + excess)}
    return cr.FiniteMDP(**fields)


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("discount", [0.0, 0.9, 0.9999, 1 - 1e-6])
@pytest.mark.parametrize("excess", [0.0, 9e-9, -9e-9])
def test_no_value_is_further_from_the_truth_than_the_bound(scale, discount, excess):
    mdp = scaled(tasks.random_mdp(3, n_states=5, n_actions=2, discount=discount), scale, excess)
    solution = cr.solve(mdp)
    assert solution.error_bound <= 1e-7 * abs(solution.values).max()
    assert within_the_bound(solution, mdp, exact_optimum(mdp))
    policy = np.arange(5) % 2
    assert within_the_bound(cr.evaluate(mdp, policy), mdp, exact_values(mdp, policy))


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("ending", [0.5, 1e-3, 1e-5])
def test_nor_at_discount_1(scale, ending):
    rng = np.random.default_rng(5)
    outcomes = [
        [
            [(ending, 3, r), ((1 - ending) / 2, 1, r), ((1 - ending) / 2, s, -r / 3)]
            for r in rng.normal(size=2) * scale
        ]
        for s in range(3)
    ]
    mdp = cr.FiniteMDP.from_outcomes(
        [*outcomes, [[], []]], terminal=[False] * 3 + [True], start=0, discount=1.0
    )
    solution = cr.solve(mdp)
    assert within_the_bound(solution, mdp, exact_optimum(mdp))
    policy = np.array([0, 1, 0, 0])
    assert within_the_bound(cr.evaluate(mdp, policy), mdp, exact_values(mdp, policy))


def ring(reward, discount):
    """Return five states in a ring, which pay for ever."""
    outcomes = [[[(1.0, (s + 1) % 5, reward)]] for s in range(5)]
    return cr.FiniteMDP.from_outcomes(outcomes, terminal=[False] * 5, start=0, discount=discount)


@pytest.mark.parametrize("scale", [1e-12, 1.0, 100.0, 1e12])
def test_a_default_tolerance_is_never_the_users_mistake(scale):
    for seed in range(5):
        task = scaled(tasks.random_mdp(seed, n_states=30, discount=0.999), scale)
        for found in cr.solve(task), cr.evaluate(task, [0] * 30):
            assert found.error_bound <= 1e-10 * abs(found.values).max()
    found = cr.solve(ring(scale, 1 - 1e-5))
    assert found.error_bound <= 1e-9 * abs(found.values).max()


def test_taxi_is_solved_at_a_discount_near_1():
    found = cr.solve(cr.from_gymnasium("Taxi-v4", discount=1 - 1e-6))
    assert found.error_bound <= 1e-8 * abs(found.values).max()


def test_rewards_of_zero_have_values_of_zero():
    found = cr.solve(ring(0.0, 0.999))
    assert not found.values.any()
    assert found.error_bound == 0.0


def test_a_target_is_solved_where_an_error_of_a_millionth_reward_is_out_of_reach():
    task = tasks.random_mdp(1, discount=1 - 1e-5, time_limit=10)
    solution = cr.planning.Target.of(task).solution
    assert 1e-6 < solution.error_bound <= 1e-9 * abs(solution.values).max()


def test_values_without_a_finite_bound_are_refused():
    many = scaled(tasks.random_mdp(3, discount=1 - 1e-9), 1.0, 9e-9)
    with pytest.raises(
        SettingError, match=r"need a finite error bound: .* in episodes of inf expected"
    ):
        cr.solve(many)
