"""The constant controls: phi's mean and maximum over what learning can visit, and nothing else."""

import numpy as np
import pytest

import curricle as cr
from curricle import QInitialisation, compare
from curricle.comparison.levels import Level, VisitedPairs
from curricle.transfer import FunctionValues, ObservationMapping
from curricle.transfer.potentials import ObservationPotential
from tests.comparisons import HERE, MAZE, copied, corner, pursuit
from tests.tasks import ring

LABELS = ("constant mean", "constant maximum")


@pytest.mark.parametrize("plan", [corner, pursuit])
def test_a_constant_is_phis_mean_and_its_maximum_and_0_at_ends(plan, calls):
    compare(plan(), seeds=[4, 9], controls=["constant"])
    arm, mean, maximum = (call for call in calls[1:] if call["stream"] == plan().target)
    alive = ~plan().tasks[plan().target].mdp.terminal  # every state can be reached in both tasks
    for k in range(2):
        phi = arm["potentials"][k].values[alive]
        for control, wanted in ((mean, phi.mean()), (maximum, phi.max())):
            values = control["potentials"][k].values
            np.testing.assert_allclose(values[alive], wanted, rtol=1e-12)
            assert not values[~alive].any()
    assert mean["budget"] == maximum["budget"] == arm["budget"]


def test_what_no_policy_can_reach_does_not_count():
    """East of the wall phi is 100."""
    walled = cr.GridWorld(["S.#.", "..#T"], time_limit=20)
    pairs = VisitedPairs(walled, dense=True)
    column = np.repeat(walled.mdp.states.decode()["column"][:, None], 4, axis=1)
    phi = cr.StateActionPotential(walled, np.where(column > 2, 100.0, 1.0 + column))
    assert sorted(pairs.values(phi).ravel().tolist()) == [1.0] * 8 + [2.0] * 8


def test_what_no_source_knows_counts_as_what_stands_there():
    plan = corner(unknown_value=-30.0)
    found = compare(plan, seeds=1, controls=["constant"])
    (q,) = plan.train(1, only="corner")["corner"].values
    phi = np.nan_to_num(HERE.read(q), nan=-30.0)[~MAZE.mdp.terminal]
    levels = [found[f"transfer, {one}"].level.values for one in LABELS]
    np.testing.assert_allclose(levels, [[phi.mean()], [phi.max()]])


@pytest.mark.parametrize(
    "shaping", [QInitialisation(), cr.LookAheadAdvice()], ids=["initialise", "advice"]
)
def test_a_constant_is_another_initial_value_bit_for_bit(shaping):
    """Which needs no source: the control's potential is no more than that."""
    plan = corner(shaping=shaping, learner={"maze": cr.QLearning(initial_value=2.0)})
    found = compare(plan, seeds=[7], controls=["constant"])
    for label in LABELS:
        arm = found[f"transfer, {label}"]
        learner = cr.QLearning(initial_value=arm.initial_value)
        alone = cr.learn(MAZE, learner, 3000, seeds=[7], eval_freq=100, stream="maze")
        np.testing.assert_allclose(arm.curve.values[:, :31], alone.greedy_return, rtol=1e-12)


@pytest.mark.parametrize(
    "shaping",
    [
        cr.DecayingAdvice(weight=cr.learning.linear(1.0, 0.0, steps=100)),
        cr.RewardBonus(),
    ],
    ids=["decaying advice", "bonus"],
)
def test_no_initial_value_is_named_where_a_constant_is_not_one(shaping):
    found = compare(corner(shaping=shaping), seeds=1, controls=["constant"])
    arm = found["transfer, constant mean"]
    assert (arm.initial_value, arm.level.constant) == (None, True)
    assert found.cheaper_way("transfer") == ""


def test_the_initial_value_under_a_guard_is_that_without():
    found = compare(
        corner(shaping=QInitialisation(guard=cr.Guard())), seeds=1, controls=["constant"]
    )
    arm = found["transfer, constant mean"]
    assert arm.initial_value == pytest.approx(arm.level.values.mean())
    assert np.isfinite(arm.guard_share).all()


def test_sparse_tables_are_sampled_and_a_constant_is_looked_up(calls):
    plan = pursuit(storage={"hunt": cr.Storage(kind="sparse")})
    found = compare(plan, seeds=1, controls=["constant"])
    used = [call["potentials"][0] for call in calls if call["potentials"]]
    assert {type(one).__name__ for one in used} == {"MappedPotential"}
    for label, phi in zip(LABELS, used[1:], strict=True):
        level = found[f"transfer, {label}"].level.mean
        np.testing.assert_allclose(phi.rows(np.arange(9)), level, rtol=1e-12)
    sampled, all_of_them = VisitedPairs.of(plan), VisitedPairs.of(pursuit())
    assert (sampled.dense, all_of_them.dense) == (False, True)
    assert set(sampled.states.tolist()) <= set(all_of_them.states.tolist())
    assert len(sampled.states) > 0.5 * len(all_of_them.states)


def test_a_task_without_tables_has_constants_too():
    found = compare(
        copied(ring(time_limit=30), eval_freq={"far": 20}), seeds=2, controls=["constant"]
    )
    for label in LABELS:
        assert np.isfinite(found[f"transfer, {label}"].level.values).all()


def test_a_potential_over_observations_has_a_level():
    car = cr.observation_task("MountainCar-v0")
    height = FunctionValues(state_values=lambda cars: cars[:, 0])
    edge = cr.Transfer("height", "car", ObservationMapping(car, car), scale=10.0)
    phi = ObservationPotential(car, [edge], [height])
    seen = VisitedPairs(car, dense=False).values(phi)
    assert seen.ndim == 1
    assert -12 < seen.mean() < 0
    flat = phi.rescaled(0.0, float(seen.max()))
    np.testing.assert_array_equal(VisitedPairs(car, dense=False).values(flat), seen.max())


def test_levels_of_batches_are_joined_in_order():
    plan = corner(target=1000)
    grown = compare(plan, seeds=2, precision=1e-9, most_seeds=5, controls=["constant"])
    once = compare(plan, seeds=5, controls=["constant"])
    for label in LABELS:
        name = f"transfer, {label}"
        np.testing.assert_array_equal(grown[name].level.values, once[name].level.values)
    level = Level(np.array([1.0, 2.0, 3.0]), 1.0, True)
    assert level.take(np.array([2, 0])).values.tolist() == [3.0, 1.0]
