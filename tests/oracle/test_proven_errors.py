"""The proven error of exact planning: never exceeded, against exact rational arithmetic."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import curricle as cr
from curricle.errors import SettingError
from curricle.planning import solution as planning_module
from tests.support import tasks
from tests.support.enumeration import exact_action_values, exact_optimum, exact_values

SCALES = (1e-9, 1.0, 1e7)


def within_the_bound(solution, mdp, values):
    bound = Fraction(solution.error_bound)
    assert all(abs(Fraction(v) - e) <= bound for v, e in zip(solution.values, values, strict=True))
    q = exact_action_values(mdp, values)
    return all(abs(Fraction(solution.action_values[pair]) - e) <= bound for pair, e in q.items())


def scaled(mdp, factor, excess=0.0):
    """Return an MDP with larger rewards, and probabilities that sum to 1 + excess."""
    return replace(mdp, reward=mdp.reward * factor, probability=mdp.probability * (1 + excess))


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
        for solution in cr.solve(task), cr.evaluate(task, [0] * 30):
            assert solution.error_bound <= 1e-10 * abs(solution.values).max()
    solution = cr.solve(ring(scale, 1 - 1e-5))
    assert solution.error_bound <= 1e-9 * abs(solution.values).max()


def test_rewards_of_zero_have_values_of_zero():
    solution = cr.solve(ring(0.0, 0.999))
    assert not solution.values.any()
    assert solution.error_bound == 0.0


def test_a_target_is_solved_where_an_error_of_a_millionth_reward_is_out_of_reach():
    task = tasks.random_mdp(1, discount=1 - 1e-5, time_limit=10)
    solution = cr.planning.Target.of(task).solution
    assert 1e-6 < solution.error_bound <= 1e-9 * abs(solution.values).max()


def test_rewards_below_the_normal_numbers_have_an_error_too():
    for seed in range(20):
        mdp = scaled(tasks.random_mdp(seed, n_states=3, n_actions=2), 1e-323)
        assert within_the_bound(cr.solve(mdp), mdp, exact_optimum(mdp))
        assert within_the_bound(
            cr.evaluate(mdp, [0, 1, 0]), mdp, exact_values(mdp, np.array([0, 1, 0]))
        )


@pytest.mark.parametrize("below_1", [1e-7, 1e-8, 1e-11, 1e-14])
def test_a_discount_next_to_1_is_solved_directly(below_1):
    rng = np.random.default_rng(2)
    outcomes = [
        [[(0.5, 0, r), (0.25, 1, -r), (0.25, s, 1.0)] for r in rng.normal(size=2)] for s in range(2)
    ]
    mdp = cr.FiniteMDP.from_outcomes(outcomes, terminal=[False] * 2, start=0, discount=1 - below_1)
    solution = cr.solve(mdp)
    assert solution.error_bound <= 1e-14 / below_1 * abs(solution.values).max()
    assert within_the_bound(solution, mdp, exact_optimum(mdp))
    assert within_the_bound(cr.evaluate(mdp, [0, 1]), mdp, exact_values(mdp, [0, 1]))
    half = cr.evaluate(mdp, np.full((2, 2), 0.5))
    assert half.error_bound <= 1e-14 / below_1 * abs(half.values).max()


@pytest.mark.parametrize("halvings", [20, 30, 40])
def test_an_end_that_comes_once_in_a_billion_steps_is_solved_directly(halvings):
    ending = 0.5**halvings
    mdp = cr.FiniteMDP.from_outcomes(
        [[[(p, 1, r), (1 - p, 0, -1.0)] for p, r in ((ending, 1.0), (ending / 2, 5.0))], [[], []]],
        terminal=[False, True],
        start=0,
        discount=1.0,
    )
    solution = cr.solve(mdp)
    assert solution.error_bound <= 1e-14 / ending * abs(solution.values).max()
    assert within_the_bound(solution, mdp, exact_optimum(mdp))
    np.testing.assert_array_equal(cr.planning.visit_distribution(mdp), [1.0, 0.0])


def test_visits_of_episodes_that_hardly_end_are_those_of_the_chain():
    step = np.array([[0.5, 0.5], [0.1, 0.9]])
    rows = [[[(p, after, 0.0) for after, p in enumerate(row)]] for row in step]
    mdp = cr.FiniteMDP.from_outcomes(rows, terminal=[False] * 2, start=0, discount=1 - 1e-9)
    np.testing.assert_allclose(cr.planning.visit_distribution(mdp), [1 / 6, 5 / 6], rtol=1e-7)


def test_more_sweeps_than_end_are_refused(monkeypatch):
    monkeypatch.setattr(planning_module, "LARGEST_DIRECT", 1)
    monkeypatch.setattr(planning_module, "MOST_WORK", 1e8)
    mdp = tasks.random_mdp(1, n_states=5, discount=1 - 1e-9)
    with pytest.raises(SettingError, match=r"e\+1. more are expected"):
        cr.solve(replace(mdp, terminal=np.zeros(5, bool)))


def longest_ways(reward, after, end):
    """Return the largest sums of rewards to the end, or None where going round pays or is free."""
    best = [0 if s == end else -np.inf for s in range(len(reward))]
    for _ in range(2 * len(reward) + 2):
        before = best
        best = [
            0 if s == end else max(r + best[t] for r, t in zip(reward[s], after[s], strict=True))
            for s in range(len(reward))
        ]
    return best if best == before and np.isfinite(best).all() else None


def free_round(reward, after, end):
    """Return whether some way round costs nothing, by the best sums of n steps back to a state."""
    n = len(reward)
    best = np.where(np.eye(n, dtype=bool), 0.0, -np.inf)
    for _ in range(n):
        step = np.full((n, n), -np.inf)
        for s in set(range(n)) - {end}:
            for r, t in zip(reward[s], after[s], strict=True):
                step[s] = np.maximum(step[s], r + best[t])
        if (np.delete(step.diagonal(), end) >= 0).any():
            return True
        best = step
    return False


def test_ways_in_a_graph_are_solved_or_refused_as_they_should_be():
    solved = 0
    for seed in range(300):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(2, 7))
        reward, after = rng.integers(-4, 2, (n, 2)), rng.integers(0, n, (n, 2))
        after[:-1, 1] = np.arange(1, n) if seed % 2 else after[:-1, 1]
        truth = longest_ways(reward, after, n - 1)
        mdp = cr.FiniteMDP.from_outcomes(
            [
                [[(1.0, int(t), float(r))] for r, t in zip(*pair, strict=True)]
                for pair in zip(reward, after, strict=True)
            ],
            terminal=np.arange(n) == n - 1,
            start=0,
            discount=1.0,
            time_limit=10,
        )
        if truth is None or free_round(reward, after, n - 1):
            with pytest.raises(SettingError, match=r"from state .* can go on for ever"):
                planning_module.solve_without_limit(mdp)
            continue
        solved += 1
        solution = planning_module.solve_without_limit(mdp)
        assert abs(solution.values - truth).max() <= solution.error_bound <= 1e-9
        assert within_the_bound(solution, mdp, [Fraction(int(v)) for v in truth])
    assert 50 < solved < 250


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_stochastic_shortest_paths_are_within_their_bound(scale):
    for seed in range(40):
        mdp = tasks.random_mdp(seed, n_states=4, n_actions=2, discount=1.0, time_limit=9)
        cost = np.random.default_rng(seed).exponential(size=mdp.reward.shape) ** 4 + 1e-3
        mdp = replace(mdp, reward=-scale * cost)
        try:
            solution = cr.solve(mdp)
        except SettingError as refusal:
            assert "no way leads to an end" in str(refusal)  # noqa: PT017
            continue
        assert within_the_bound(solution, mdp, exact_optimum(mdp))
        assert solution.error_bound <= 1e-6 * abs(solution.values).max()


def test_values_without_a_finite_bound_are_refused():
    many = scaled(tasks.random_mdp(3, discount=1 - 1e-9), 1.0, 9e-9)
    with pytest.raises(SettingError, match=r"a finite error bound: .* in episodes of inf"):
        cr.solve(many)
