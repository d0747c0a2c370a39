"""A theorem about forecasts, on random tasks."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import curricle as cr
from curricle.planning import Target
from curricle.transfer.rollouts import potential_quality
from tests.tasks import random_mdp

seeds = st.integers(0, 2**32 - 1)


@settings(max_examples=20)
@given(seeds, st.floats(0.1, 10.0), st.floats(-10.0, 10.0))
def test_start_and_rank_depend_on_the_order_of_a_potential_alone(seed, scale, shift):
    """c phi + b with c > 0 has the greedy policy and the ranks of phi."""
    task = random_mdp(seed, time_limit=40)
    target, alive = Target.of(task), ~task.mdp.terminal[:, None]
    values = np.random.default_rng(seed).integers(-50, 50, (6, 3)) * alive
    phi, other = (
        potential_quality(cr.StateActionPotential(task, table), target)
        for table in (values, (scale * values + shift) * alive)
    )
    assert other.start == pytest.approx(phi.start, rel=1e-6, abs=1e-6)
    assert other.rank == pytest.approx(phi.rank, abs=1e-6, nan_ok=True)
