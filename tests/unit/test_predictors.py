"""Predictors by hand, and the bars that the benchmark of pairs judges them by."""

from dataclasses import replace

import numpy as np
import pytest

import curricle as cr
from benchmarks.pairs import predictions
from curricle.comparison.candidates import candidates_of
from curricle.comparison.predictors import (
    BASE,
    COST,
    PREDICTORS,
    RANK,
    Case,
    knowledge_for_cost,
    optimism,
    rank_agreement,
    start_value,
    sweeps_left,
    sweeps_until,
    trial,
)
from curricle.planning import Target
from curricle.transfer.quality import potential_quality

LINE = cr.GridWorld("S.T", discount=0.5, time_limit=50)  # 98.5 and 199, towards the east
Q = cr.solve(LINE, tolerance=1e-6).action_values
RANDOM = Target.of(LINE).random_return


def case_of(*tables, source=100, target=300):
    """Return the case of a copy of the line whose seeds learnt these tables."""
    plan = cr.Curriculum(
        {"near": LINE, "far": LINE},
        [cr.Transfer("near", "far", cr.transfer.identity(LINE))],
        budget={"near": cr.StoppingRule(source), "far": target},
    )
    seeds = range(len(tables))
    (candidate,) = candidates_of(plan, "far")
    sources = plan.train(seeds, only="near").sources
    sources = {"near": replace(sources["near"], values=np.stack(tables))}
    potentials = candidate.potentials(sources, seeds)
    place = Target.of(LINE)
    quality = [potential_quality(phi, place) for phi in potentials]
    return Case(candidate, place, sources, potentials, quality)


def test_predictions_of_the_optimum_and_of_its_opposite():
    best, worst, both = case_of(Q), case_of(-Q), case_of(Q, -Q)
    assert start_value(best).score == pytest.approx(1.0)
    assert start_value(worst).score == pytest.approx((-2 - RANDOM) / (98.5 - RANDOM))
    assert rank_agreement(best).score == pytest.approx(1.0)
    assert rank_agreement(worst).score == pytest.approx(-1.0)
    for predictor in (start_value, rank_agreement):
        mean = (predictor(best).score + predictor(worst).score) / 2
        assert predictor(both).score == pytest.approx(mean)


def test_optimism_is_the_excess_over_the_values():
    size = (98.5 + 199) / 2
    assert optimism(case_of(Q + 0.5 * size)).score == pytest.approx(0.5, abs=1e-6)
    assert optimism(case_of(Q - size)).score == pytest.approx(-1.0, abs=1e-6)


def test_the_cost_of_sources_is_their_share_of_all_steps():
    assert case_of(Q, source=100, target=300).source_share == 0.25
    cheap, dear = (case_of(Q, source=n, target=300) for n in (100, 900))
    assert knowledge_for_cost(cheap).score == pytest.approx(RANK - COST * 0.25 + BASE)
    assert sweeps_left(cheap).score - sweeps_left(dear).score == pytest.approx(0.75 - 0.25)


def test_sweeps_are_counted_until_the_policy_is_good():
    """From 0 both cells tie; after one sweep the last is right, after two the first."""
    place = Target.of(LINE)
    assert sweeps_until(place, np.zeros_like(Q), place.optimum) == 2
    assert sweeps_until(place, Q, place.optimum) == 0
    assert sweeps_left(case_of(Q)).score == pytest.approx(1 - 0 / 2 - 0.25)


def test_sweeps_are_unknown_without_a_solution_and_where_random_is_best(monkeypatch):
    monkeypatch.setattr("curricle.planning.target.LARGEST_SOLVED", 0)
    assert np.isnan(sweeps_left(case_of(Q)).score)


def test_the_trial_has_an_interval_and_its_mean_is_the_score():
    found = trial(case_of(Q), seeds=8)
    assert found.score == found.gain.estimate
    assert found.gain.low <= found.score <= found.gain.high
    assert found.gain.n == 8
    assert "8 seeds" in found.assumes


def test_all_predictors_have_one_signature():
    case = case_of(Q)
    for name, predictor in PREDICTORS.items():
        found = predictor(case)
        assert isinstance(found.score, float), name
        assert found.assumes, name
        assert (found.gain is None) == (name != "trial")


# -- the bars --------------------------------------------------------------------------------------


def test_ranks_are_compared_within_targets_only():
    """Two targets whose returns differ by thousands: what counts is the order in each."""
    target = np.array(["a"] * 3 + ["b"] * 3)
    gain = np.array([1.0, 2.0, 3.0, 1001.0, 1002.0, 1003.0])
    assert predictions.pooled_rank(gain, gain, target) == pytest.approx(1.0)
    assert predictions.pooled_rank(-gain, gain, target) == pytest.approx(-1.0)
    swapped = np.array([1.0, 2.0, 3.0, 3.0, 2.0, 1.0])
    assert predictions.pooled_rank(swapped, gain, target) == pytest.approx(0.0)
    unknown = np.array([1.0, np.nan, 3.0, 1.0, 2.0, 3.0])
    assert 0.9 < predictions.pooled_rank(unknown, gain, target) <= 1.0


def test_signs_are_counted_where_the_gain_differs_from_0():
    gain, low, high = np.array([[2, 1, 3], [-2, -3, -1], [1, -1, 3], [2, 1, 3]], float).T
    score = np.array([1.0, 1.0, -1.0, np.nan])  # right, wrong, does not count, not known
    assert predictions.right_signs(score, gain, low, high) == (pytest.approx(1 / 3), 3)


def test_the_first_choice_is_the_highest_score_or_scratch():
    target = np.array(["a", "a", "b", "b", "c", "d"])
    gain = np.array([4.0, 1.0, 4.0, 3.0, -1.0, -1.0])
    score = np.array([2.0, 1.0, 1.0, 2.0, -1.0, 1.0])
    assert predictions.regrets(score, gain, target).tolist() == [0.0, 0.25, 0.0, np.inf]
    assert predictions.regrets(-abs(score), gain, target).tolist() == [1.0, 1.0, 0.0, 0.0]
