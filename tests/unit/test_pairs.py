"""The benchmark of pairs: what its families and pairs have in common."""

import numpy as np
import pytest

from benchmarks.pairs import family_names, pairs
from benchmarks.pairs.families import DEVELOPMENT, FRESH, VERIFICATION
from benchmarks.pairs.pair import SENSIBLE
from curricle import StoppingRule
from curricle.transfer import ENDED

EVERYWHERE = {
    *("near", "far", "wrong goal", "mirrored"),
    *("useless", "negated", "unlearnt", "too large"),
}
NAMED = ("river-swim", "chain", "deep-sea", "taxi", "frozen-lake", "four-rooms")


def test_families_are_disjoint_and_many():
    assert not set(DEVELOPMENT) & set(VERIFICATION) | set(FRESH) & {*DEVELOPMENT, *VERIFICATION}
    assert {pair.family for pair in pairs("fresh")} == set(FRESH)
    assert min(len(DEVELOPMENT), len(VERIFICATION)) >= 6
    assert set(NAMED) <= set(VERIFICATION)
    assert len(pairs()) >= 120
    for split, families in ("development", DEVELOPMENT), ("verification", VERIFICATION):
        assert {pair.family for pair in pairs(split)} == set(families)
    assert len(pairs("development")) + len(pairs("verification")) == len(pairs())


@pytest.mark.parametrize("family", family_names())
def test_each_family_goes_from_helpful_to_harmful(family):
    found = pairs(family=family)
    assert {pair.kind for pair in found} == EVERYWHERE
    assert [pair.sensible for pair in found] == [pair.kind in SENSIBLE for pair in found]
    assert len({pair.split for pair in found}) == 1
    for pair in found:
        curriculum = pair.curriculum()  # nothing is set but budgets
        assert curriculum.target == "target"
        assert curriculum.setting("budget", "target") == pair.target_budget
        assert curriculum.setting("budget", "source") == StoppingRule(pair.source_budget)
        assert {edge.scale for edge in curriculum.transfers} == {pair.scale}
        assert pair.target_budget % pair.eval_freq == 0
        for mapping in pair.mappings:
            coverage = mapping.coverage()
            assert coverage.mapped > 0.05, pair.name
            assert coverage.never_used < 0.7 * coverage.source_pairs, pair.name


def test_targets_with_one_name_are_one_task_and_small():
    tasks = {}
    for pair in pairs():
        assert tasks.setdefault((pair.family, pair.target_name), pair.target) is pair.target
        mdp = pair.target.mdp
        assert mdp.states.size * mdp.actions.size < 20_000
        assert mdp.discount < 1
        assert mdp.time_limit is not None
    ends = [bool(task.mdp.terminal.any()) for task in tasks.values()]
    rewards = [task.mdp.reward[task.mdp.probability > 0] for task in tasks.values()]
    assert 3 <= sum(ends) <= len(ends) - 3  # episodic and continuing
    assert sum(bool((r <= 0).all()) for r in rewards) >= 3
    assert sum(bool((r >= 0).all()) for r in rewards) >= 3


@pytest.mark.parametrize("family", family_names())
def test_the_negated_potential_is_the_negation(family):
    by_name = {pair.name: pair for pair in pairs(family=family)}
    negated = [pair for pair in by_name.values() if pair.kind == "negated"]
    assert negated
    for pair in negated:
        whole = by_name[pair.name.removesuffix(", negated")]
        values = np.random.default_rng(0).normal(
            size=(pair.source.states.size, pair.source.actions.size)
        )
        for one, other in zip(pair.transfers(), whole.transfers(), strict=True):
            assert np.array_equal(one.mapping.index, other.mapping.index)
            mapped = one.mapping.index != ENDED
            np.testing.assert_array_equal(
                one.potential(values)[mapped], -other.potential(values)[mapped]
            )
