"""Potentials and aggregates of several: by hand, and how far they are from the truth."""

import numpy as np
import pytest

import curricle as cr
from curricle import StateActionPotential, StatePotential, maximum, mean, minimum, total
from curricle.errors import CurriculumError, PotentialError
from curricle.planning import Target, target as target_module
from curricle.transfer.aggregate import aggregate
from curricle.transfer.rollouts import potential_return
from tests.support.tasks import predator_edges, random_mdp, ring, ring_by_tables

THREE = np.array([[[1.0, 5.0]], [[3.0, -2.0]], [[2.0, 0.0]]])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_an_aggregate_must_be_finite_and_have_the_targets_shape(value):
    def broken(phi):
        return np.where([[False, True]], value, phi[0])

    with pytest.raises(CurriculumError, match=r"finite.*broken returned .* at state 0, action 1"):
        aggregate(broken, THREE)
    with pytest.raises(CurriculumError, match=r"shape \(1, 2\): <lambda> returned \(3, 1, 2\)"):
        aggregate(lambda phi: phi, THREE)


UNKNOWN = np.array([[[np.nan, 5.0, np.nan]], [[3.0, -2.0, np.nan]], [[2.0, np.nan, np.nan]]])


@pytest.mark.parametrize(
    ("function", "expected"),
    [
        (maximum, [3, 5, -9]),
        (mean, [2.5, 1.5, -9]),
        (minimum, [2, -2, -9]),
        (total, [5, 3, -9]),
        (lambda phi: np.nanmedian(phi, axis=0), [2.5, 1.5, -9]),
    ],
)
def test_a_source_that_knows_nothing_is_skipped(function, expected):
    assert aggregate(function, UNKNOWN, -9.0).tolist() == [expected]
    assert aggregate(function, UNKNOWN).tolist() == [[*expected[:2], 0]]


def test_no_aggregate_is_asked_of_pairs_that_no_source_knows():
    """nanargmax raises there, and nanmean warns."""
    chosen = []

    def most_optimistic(phi):
        chosen.append(np.nanargmax(phi, axis=0))
        return np.nanmax(phi, axis=0)

    assert aggregate(most_optimistic, UNKNOWN).tolist() == [[3, 5, 0]]
    assert aggregate(lambda phi: np.nanmean(phi, axis=0), UNKNOWN).tolist() == [[2.5, 1.5, 0]]
    assert chosen[0][0, :2].tolist() == [1, 0]


LINE = cr.GridWorld("S.T", discount=0.5)  # Q* = 98.5 and 199 to the east
MAZE = cr.GridWorld(["F..T", ".P..", "S..#"], discount=0.9, time_limit=30)


@pytest.mark.parametrize("task", [ring_by_tables(), ring()], ids=["tables", "functions"])
def test_into_an_end_the_potential_is_zero_in_every_kind_of_task(task):
    """Home, where episodes end, is state 0; only the steps of a computed task tell so."""
    phi = StatePotential(task, np.full(9, 7.0))
    ended = [False, True]
    expected = [task.discount * 7.0 - 7.0, -7.0]
    assert phi.shaping_reward([2, 1], [1, 0], terminated=ended).tolist() == expected
    if task == ring():
        with pytest.raises(PotentialError, match="know its terminal states: give terminated="):
            phi.shaping_reward(1, 0)


def test_the_state_potential_of_a_pair_potential_is_its_maximum():
    phi = StateActionPotential(LINE, [[1, -5, 2, 0], [-3, -1, -2, -9], [7] * 4])
    assert phi.to_state().values.tolist() == [[2, -1, 0]]


def random_potential(task, seed):
    shape = task.mdp.outcome_row.shape
    return cr.StateActionPotential(task, np.random.default_rng([seed, 1]).normal(size=shape))


@pytest.mark.parametrize("discounted", [True, False])
@pytest.mark.parametrize("largest", [target_module.LARGEST_EVALUATED, 0], ids=["exact", "rollouts"])
@pytest.mark.parametrize("task", [MAZE, random_mdp(5, time_limit=20)])
def test_the_start_is_the_first_checkpoint_of_learning(task, largest, discounted, monkeypatch):
    for bound in ("LARGEST_EXACT", "LARGEST_EVALUATED"):
        monkeypatch.setattr(target_module, bound, min(largest, getattr(target_module, bound)))
    target = Target.of(task, cr.GreedyEvaluation(discounted=discounted), episodes=50)
    assert target.evaluation.method == ("exact" if largest else "rollouts")
    for seed in (0, 3):
        phi = random_potential(task, seed)
        how = {"shaping": cr.QInitialisation(phi), "evaluation": target.evaluation}
        learnt = cr.learn(task, budget=1, seeds=[seed], **how)
        assert potential_return(phi, target, seed=seed) == learnt.greedy_return[0, 0]


def test_of_too_many_pairs_a_potential_s_return_is_not_computed(monkeypatch):
    monkeypatch.setattr("curricle.transfer.rollouts.LARGEST_ROLLED_OUT", 10)
    assert np.isnan(potential_return(random_potential(MAZE, 0), Target.of(MAZE)))


def test_an_aggregate_without_code_is_named_where_a_target_is_too_large_for_arrays():
    huge, chase = cr.Pursuit(6, 5), cr.Pursuit(6, 1)
    edges, how = predator_edges(huge, chase), {"aggregate": np.nanmean, "budget": 100}
    plan = cr.Curriculum({"chase": chase, "hunt": huge}, edges, **how)
    with pytest.raises(CurriculumError, match=r"minimum, mean, maximum, total.*got nanmean and"):
        plan.train()


@pytest.mark.parametrize("unmapped_value", [None, 0.0])
def test_a_potential_too_large_for_exact_sums_is_refused(unmapped_value):
    maze, small = cr.GridWorld("S...T"), cr.GridWorld("S.T")
    mapping = cr.project(maze, small, unmapped_value=unmapped_value)
    plan = cr.Curriculum(
        {"small": small, "maze": maze}, [cr.Transfer("small", "maze", mapping, scale=1e15)],
        budget=500,
    )  # fmt: skip
    with pytest.raises(PotentialError, match="phi"):
        plan.train()
    with pytest.raises(PotentialError, match=r"weight times Phi must be at most 1e\+15"):
        StatePotential(maze, [1e14, 0.0, 0.0, 0.0, 0.0], weight=1e9)
