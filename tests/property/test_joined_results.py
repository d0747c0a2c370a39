"""Seeds learnt in any groups and joined are the seeds learnt together."""

from dataclasses import fields
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from curricle import Episodes, GreedyEvaluation, GridWorld, StoppingRule, Storage, learn
from curricle.learning.result import joined_results

MAZE = GridWorld(["S...", "..P.", "...T"], time_limit=30)
SEEDS = (0, 1, 3, 7, 8)
BUDGETS = {
    "steps": 230,
    "episodes": Episodes(12),
    "stopping rule": StoppingRule(400, threshold=185.0, patience=2),
}
STORAGES = {
    "dense": Storage(kind="dense"),
    "sparse": Storage(kind="sparse"),
    "float32": Storage(dtype="float32"),
    "none": Storage(save_values=False),
}


@cache
def learnt(seeds, budget, storage, snapshots):
    return learn(
        MAZE,
        budget=BUDGETS[budget],
        seeds=seeds,
        eval_freq=20,
        evaluation=GreedyEvaluation("rollouts", episodes=3),
        storage=STORAGES[storage],
        stream="joined",
        snapshots=snapshots,
        workers=1,
    )


def parts_of(labels):
    """Groups of seeds by their labels, in the labels' order; seeds rise within each."""
    return [
        tuple(seed for seed, label in zip(SEEDS, labels, strict=True) if label == one)
        for one in dict.fromkeys(labels[::-1])
    ]


def assert_equal(joined, wanted):
    for field in fields(wanted):
        array, other = getattr(joined, field.name), getattr(wanted, field.name)
        if isinstance(other, np.ndarray):
            assert array.dtype == other.dtype, field.name
            assert not array.flags.writeable, field.name
            np.testing.assert_array_equal(array, other, field.name)
    assert joined.seeds == wanted.seeds
    assert (joined.task, joined.learner) == (wanted.task, wanted.learner)
    assert type(joined.values) is type(wanted.values)
    if isinstance(wanted.values, tuple):
        for array, other in zip(joined.values, wanted.values, strict=True):
            np.testing.assert_array_equal(array.states, other.states)
            np.testing.assert_array_equal(array.values, other.values)
    assert (joined.snapshots is None) == (wanted.snapshots is None)
    if wanted.snapshots is not None:
        assert joined.snapshots.seed == wanted.snapshots.seed
        np.testing.assert_array_equal(joined.snapshots.steps, wanted.snapshots.steps)
        np.testing.assert_array_equal(joined.snapshots.values, wanted.snapshots.values)


def for_any_groups(test):
    """Run a test with each budget and storage, for drawn groups of the seeds."""
    labels = st.lists(st.integers(0, 4), min_size=5, max_size=5)
    drawn = given(labels=labels, snapshots=st.sampled_from([0, 5]))(test)
    each = pytest.mark.parametrize("budget", BUDGETS)(settings(max_examples=15)(drawn))
    return pytest.mark.parametrize("storage", STORAGES)(each)


@for_any_groups
def test_any_groups_joined_are_all_together(budget, storage, labels, snapshots):
    parts = [learnt(seeds, budget, storage, snapshots) for seeds in parts_of(labels)]
    assert_equal(joined_results(parts), learnt(SEEDS, budget, storage, snapshots))


def test_stopping_rules_end_the_seeds_apart():
    """Or the property above would not join results of different lengths."""
    assert len(set(learnt(SEEDS, "stopping rule", "dense", 0).steps_used.tolist())) > 1
    assert len(set(learnt(SEEDS, "episodes", "dense", 0).steps_used.tolist())) > 1
