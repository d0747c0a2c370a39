"""Potentials and aggregates of several: by hand, and how far they are from the truth."""

import numpy as np
import pytest

import curricle as cr
from curricle import StateActionPotential, StatePotential, maximum, mean, minimum, total
from curricle.errors import CurriculumError, PotentialError
from curricle.planning import Target, policy_evaluation as target_module
from curricle.tasks.mdp import reachable_states
from curricle.transfer import rollouts as quality
from curricle.transfer.aggregate import aggregate
from curricle.transfer.rollouts import potential_quality
from tests.tasks import dense_of, random_mdp, ring, ring_by_tables

THREE = np.array([[[1.0, 5.0]], [[3.0, -2.0]], [[2.0, 0.0]]])


def test_any_function_of_the_right_shape_is_an_aggregate():
    assert aggregate(lambda phi: np.median(phi, axis=0), THREE).tolist() == [[2, 0]]
    assert aggregate(lambda phi: [[1, 2]], THREE).dtype == np.float64


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


def test_where_only_steps_tell_the_ends_they_must_be_given():
    phi = StatePotential(ring(), np.full(9, 7.0))
    with pytest.raises(PotentialError, match="does not know its terminal states: give terminated="):
        phi.shaping_reward(1, 0)


def test_the_state_potential_of_a_pair_potential_is_its_maximum():
    phi = StateActionPotential(LINE, [[1, -5, 2, 0], [-3, -1, -2, -9], [7] * 4])
    assert phi.to_state().values.tolist() == [[2, -1, 0]]


def random_potential(task, seed):
    shape = task.mdp.outcome_row.shape
    return cr.StateActionPotential(task, np.random.default_rng([seed, 1]).normal(size=shape))


def naive_optimum(mdp):
    """Return Q* by value iteration; 400 sweeps at discount 0.9 leave 5e-19 of the start."""
    p, r = dense_of(mdp)
    q = r
    for _ in range(400):
        q = r + mdp.discount * p @ q.max(axis=1)
    return q


def naive_quality(phi, mdp):
    """Return optimistic, excess, size, and the largest underestimate and its state."""
    q = naive_optimum(mdp)
    optimal = q > q.max(axis=1, keepdims=True) - 1e-6
    above, excess, size, alive = 0, 0.0, 0.0, 0
    for s in np.flatnonzero(~mdp.terminal):
        alive += 1
        size += abs(q[s].max())
        for a in range(q.shape[1]):
            above += phi[s, a] > q[s, a] + 1e-6
            excess += phi[s, a] - q[s, a]
    visited = reachable_states(mdp, optimal)
    worst = (0.0, -1)
    for s in np.flatnonzero(visited & ~mdp.terminal):
        below = min(q[s].max(), 0.0) - phi[s].max()
        if below > worst[0]:
            worst = (below, s)
    pairs = alive * q.shape[1]
    return above / pairs, excess / pairs, size / alive, *worst


@pytest.mark.parametrize("seed", range(8))
def test_every_measure_agrees_with_a_plain_loop(seed):
    task = random_mdp(seed, n_states=8, time_limit=20) if seed else MAZE
    phi = random_potential(task, seed)
    if seed % 2:
        phi = phi.rescaled(1.0, -2.0)
    judged = potential_quality(phi, Target.of(task))
    optimistic, excess, size, below, where = naive_quality(phi.values, task.mdp)
    assert judged.exact
    assert judged.optimistic == optimistic
    assert judged.most_underestimated_state == where
    # Both Q* are within the tolerance that a target is solved to, 1e-6, of the truth.
    near = judged.excess, judged.mean_absolute_value, judged.largest_underestimate
    assert near == pytest.approx((excess, size, below), abs=2e-6)


@pytest.mark.parametrize("task", [LINE, MAZE, cr.Pursuit(3, 2), *map(random_mdp, range(20))])
def test_the_optimum_has_no_error(task):
    target = Target.of(task)
    phi = cr.StateActionPotential(task, target.solution.action_values)
    judged = potential_quality(phi, target)
    assert (judged.optimistic, judged.excess) == (0.0, 0.0)
    assert judged.largest_underestimate == 0.0
    assert (judged.rank, judged.start) == pytest.approx((1.0, target.optimum))
    assert judged.most_underestimated_state == -1


def test_a_difference_within_the_proven_error_is_not_optimistic():
    target = Target.of(MAZE)
    error = target.solution.error_bound
    assert 0 < error <= 1e-6
    values = target.solution.action_values
    for shift, share in ((error / 2, 0.0), (error * 2 + 1e-9, 1.0)):
        phi = cr.StateActionPotential(MAZE, values + shift)
        assert potential_quality(phi, target).optimistic == share


def test_optimum_and_random_return_of_a_target():
    """Of the line: the first cell is worth 98.5 at best and x at random, the second y."""
    target = Target.of(LINE)
    assert target.optimum == 98.5
    # x = -1 + (3 x + y) / 8, y = (199 - 3) / 4 + (x + 2 y) / 8
    x, _ = np.linalg.solve([[5 / 8, -1 / 8], [-1 / 8, 6 / 8]], [-1.0, 49.0])
    assert target.random_return == pytest.approx(x)
    assert target.typical_reward == 1.0  # cells pay -1, -1 and 199


def test_the_typical_reward_is_the_median_of_those_not_0():
    outcomes = [[[(0.5, 0, 0.0), (0.5, 0, -2.0)], [(0.5, 0, 4.0), (0.5, 0, 7.0)]]]
    task = cr.FiniteMDP.from_outcomes(outcomes, start=0, discount=0.5, terminal=[False])
    assert Target.of(task).typical_reward == 4.0
    idle = cr.FiniteMDP.from_outcomes([[[(1.0, 0, 0.0)]]], start=0, discount=0.5, terminal=[False])
    assert Target.of(idle).typical_reward == 1.0


def naive_rank(phi, target):
    """Return Pearson's correlation of the mean ranks."""
    alive = ~target.task.mdp.terminal
    both = [phi.values[alive].ravel(), target.solution.action_values[alive].ravel()]
    ranks = [np.searchsorted(np.sort(x), x) + np.searchsorted(np.sort(x), x, "right") for x in both]
    return np.corrcoef(ranks)[0, 1]


@pytest.mark.parametrize("levels", [2, 5, 1000])
@pytest.mark.parametrize("task", [MAZE, random_mdp(3, time_limit=20)])
def test_ranks_with_ties(task, levels):
    """With 2 levels nearly all of phi is tied; in the maze Q* has ties of its own."""
    target = Target.of(task)
    rng = np.random.default_rng(levels)
    noisy = target.solution.action_values + rng.normal(size=target.solution.action_values.shape)
    edges = np.quantile(noisy, np.linspace(0, 1, levels + 1)[1:-1])
    phi = cr.StateActionPotential(task, np.searchsorted(edges, noisy).astype(float))
    rank = potential_quality(phi, target).rank
    assert rank == pytest.approx(naive_rank(phi, target), abs=1e-12)
    assert 0.2 < abs(rank) < 0.9999


def test_a_constant_potential_has_no_rank():
    phi = cr.StateActionPotential(MAZE, np.full((11, 4), -3.0))
    judged = potential_quality(phi, Target.of(MAZE))
    assert np.isnan(judged.rank)


def test_many_pairs_are_ranked_by_a_sample(monkeypatch):
    hunt = cr.Pursuit(3, 2, discount=0.9)
    target, phi = Target.of(hunt), random_potential(hunt, 0)
    phi = cr.StateActionPotential(hunt, target.solution.action_values + phi.values)
    full = potential_quality(phi, target).rank
    assert full == pytest.approx(naive_rank(phi, target), abs=1e-12)
    monkeypatch.setattr(quality, "MAX_RANKED", 2000)
    sampled, same, other = (potential_quality(phi, target, seed=seed).rank for seed in (0, 0, 1))
    assert sampled == same != other
    # The standard error of a correlation of 2,000 pairs is below 1 / sqrt(2000) = 0.022.
    assert sampled == pytest.approx(full, abs=0.09)


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
        assert potential_quality(phi, target, seed=seed).start == learnt.greedy_return[0, 0]


@pytest.mark.parametrize("shift", [0.0, 2.0, -2.0])
def test_the_estimate_of_a_deterministic_optimum_is_exact(shift, monkeypatch):
    """The returns of its own policy are Q* then, and a shift of phi is the excess."""
    monkeypatch.setattr(target_module, "LARGEST_SOLVED", 0)
    target, best = Target.of(MAZE), cr.solve(MAZE, tolerance=1e-6)
    assert target.solution is None
    assert target.evaluation.method == "rollouts"
    phi = cr.StateActionPotential(MAZE, best.action_values + shift)
    judged = potential_quality(phi, target)
    assert not judged.exact
    assert (judged.excess, judged.start) == pytest.approx((shift, best.start_value), abs=1e-5)
    assert judged.rank == pytest.approx(1.0, abs=0.01)  # pairs equal but for rounding may swap
    if shift:
        assert judged.optimistic == (shift > 0)
    assert np.isnan([judged.largest_underestimate, target.optimum]).all()
    assert judged.most_underestimated_state == -1


def test_a_mapped_potential_is_followed_alike_by_lookup_and_from_an_array(monkeypatch):
    hunt, chase = cr.Pursuit(3, 2, time_limit=20), cr.Pursuit(3, 1, time_limit=20)
    transfer = cr.Transfer("chase", "hunt", cr.project(hunt, chase, predator="predator_1"))
    plan = cr.Curriculum({"chase": chase, "hunt": hunt}, [transfer], budget=1000)
    (phi,) = plan.potentials("hunt", plan.train(seeds=1, only="chase").sources)
    kinds = []
    for largest in (0, 10**6):
        monkeypatch.setattr(quality, "LARGEST_ARRAY", largest)
        rollouts = quality.greedy_rollouts(phi, episodes=20)
        start = quality.greedy_start(phi, cr.GreedyEvaluation(method="rollouts"))
        kinds.append((*vars(rollouts).values(), start))
    for by_lookup, by_array in zip(*kinds, strict=True):
        np.testing.assert_array_equal(by_lookup, by_array)


def test_an_aggregate_without_code_is_named_where_a_target_is_too_large_for_arrays():
    huge, chase = cr.Pursuit(6, 5), cr.Pursuit(6, 1)
    edges = [
        cr.Transfer("chase", "huge", cr.project(huge, chase, predator=name))
        for name in huge.predator_names
    ]
    plan = cr.Curriculum({"chase": chase, "huge": huge}, edges, aggregate=np.nanmean, budget=100)
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


def test_a_weight_may_not_make_a_potential_too_large():
    with pytest.raises(PotentialError, match=r"weight times Phi must be at most 1e\+15"):
        StatePotential(cr.GridWorld("S..T"), [1e14, 0.0, 0.0, 0.0], weight=1e9)
