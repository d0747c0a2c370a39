"""Factored models and tables of random pursuits: solutions agree within their error bounds."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import curricle as cr
from tests.support.tasks import pursuits

HUNTS = pursuits(discounts=[0.0, 0.5, 0.9, 0.99])


@settings(max_examples=30)
@given(HUNTS, st.sampled_from([1e-3, 1e-9]))
def test_factored_models_and_tables_have_the_same_optimum(game, tolerance):
    factored, other = cr.solve(game, tolerance=tolerance), cr.solve(game.mdp, tolerance=tolerance)
    assert max(factored.error_bound, other.error_bound) <= tolerance
    bound = factored.error_bound + other.error_bound + 1e-12
    assert abs(factored.values - other.values).max() <= bound
    assert abs(factored.action_values - other.action_values).max() <= bound
    assert factored.start_value == pytest.approx(other.start_value, abs=bound)
    gap = factored.action_values.max(axis=1, keepdims=True) - factored.action_values
    differ = factored.optimal != other.optimal
    assert (gap[differ] <= 2 * bound).all()
    assert not factored.action_values[game.mdp.terminal].any()


def test_a_pursuit_that_is_too_large_has_no_factored_model():
    assert cr.Pursuit(size=10, predators=3).factored_model is None  # 10^8 states


PEAK = """
import tracemalloc
import curricle as cr
cr.solve(cr.Pursuit(size=2, discount=0.9))  # compiled
game = cr.Pursuit(size=5, predators=2, discount=0.9)
tracemalloc.start()
solution = cr.solve(game)
print(tracemalloc.get_traced_memory()[1], "mdp" in vars(game))
"""


def test_planning_builds_no_table_and_no_action_values():
    """In a process of its own: a thread that an earlier test left behind would be measured too."""
    game = cr.Pursuit(size=5, predators=2, discount=0.9)
    process = subprocess.run(
        [sys.executable, "-c", PEAK], capture_output=True, text=True, check=True
    )
    peak, tables = process.stdout.split()
    assert tables == "False"
    assert int(peak) < 3 * game.states.size * game.actions.size  # bytes; the table takes 4 a pair
    solution = cr.solve(game)
    assert solution.action_values is solution.action_values
    assert solution.optimal is solution.optimal


def test_discount_1_is_planned_on_the_tables():
    # Only there can one look for policies that never end, such as staying away from the prey: they
    # cost without bound, so that the values are those next to discount 1.
    values, near = (cr.solve(cr.Pursuit(2, 1, discount=d)).values for d in (1.0, 1 - 1e-7))
    np.testing.assert_allclose(values, near, rtol=0, atol=1e-6)
