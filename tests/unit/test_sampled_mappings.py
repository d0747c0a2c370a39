"""Mappings of tasks without tables: estimated from random steps, which are charged."""

import numpy as np
import pytest

import curricle as cr
from curricle.errors import SettingError, TaskError
from curricle.transfer import TaskPair, find_mappings, score_mapping
from curricle.transfer.pair import sampled_tables
from tests.tasks import ring, ring_by_tables


def test_tables_come_near_the_true_ones():
    truth, found = ring_by_tables(), sampled_tables(ring(), 40_000)
    assert found.steps == 40_000
    assert found.tried.tolist() == (~truth.terminal).tolist()
    np.testing.assert_array_equal(found.mdp.terminal, truth.terminal)
    near = cr.solve(found.mdp).values - cr.solve(truth).values
    assert abs(near).max() < 0.1
    np.testing.assert_allclose(found.mdp.start, truth.start, atol=0.03)


def test_a_pair_that_was_not_tried_is_not_judged():
    found = sampled_tables(ring(), 3, seed=1)
    tried = np.flatnonzero(found.tried)
    assert len(tried) <= 1
    assert found.mdp.probability.sum(axis=1) == pytest.approx(1)


def test_equal_seeds_agree_and_others_differ():
    one, same, other = (sampled_tables(ring(), 500, seed=seed).mdp for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.probability, same.probability)
    assert not np.array_equal(one.next_state, other.next_state) or not np.array_equal(
        one.probability, other.probability
    )


def test_the_mapping_of_a_task_that_is_only_played_is_found():
    found = find_mappings(ring(), ring_by_tables(), samples=20_000)
    assert found.steps == 20_000  # the source has tables
    best = found[0]
    assert best.how == "components by name"
    assert best.scores.regained > 0.99
    assert best.scores.dynamics_error < 0.03
    assert np.isnan(best.bound)
    assert best.mapping.steps == 20_000


def test_scores_are_near_those_of_the_tables():
    by_tables = score_mapping(cr.transfer.identity(ring_by_tables()))
    mapping = cr.project(ring(), ring_by_tables())
    tasks = TaskPair(ring(), ring_by_tables(), samples=40_000)
    sampled = score_mapping(mapping, tasks=tasks)
    assert sampled.regained == pytest.approx(by_tables.regained, abs=0.02)
    assert sampled.bellman_inconsistency < 0.05
    assert by_tables.bellman_inconsistency < 1e-9


def test_the_steps_of_the_search_are_charged():
    task, source = ring(), ring_by_tables()
    mapping = find_mappings(task, source, samples=700)[0].mapping
    edge = cr.Transfer("source", "ring", mapping)
    budget = {"source": cr.StoppingRule(500), "ring": 2_000}
    plan = cr.Curriculum({"source": source, "ring": task}, [edge], budget=budget)
    result = plan.train(seeds=2, charge=True)
    assert result.source_steps("ring").tolist() == [1_200, 1_200]
    assert result["ring"].steps_used.tolist() == [800, 800]


def test_refusals():
    with pytest.raises(TaskError, match="no state was met in which every action was tried"):
        find_mappings(ring(), ring(), samples=1)
    with pytest.raises(TaskError, match="estimated for up to 2,000,000 pairs"):
        sampled_tables(cr.Pursuit(10, 3), 10)
    with pytest.raises(SettingError, match="steps to sample must be a whole number, at least 1"):
        sampled_tables(ring(), 0)
