"""Controls: what each one changes, and that it changes nothing else."""

import numpy as np
import pytest

import curricle as cr
from curricle import Pursuit
from tests.support.comparisons import ALL, HERE, MAZE, alone as compare, copied, corner, pursuit

LABELS = ("placebo", "negated", "random start", "pretraining")


def test_controls_follow_their_arm_in_order():
    comparison = compare({"one": corner(), "two": corner()}, seeds=1, controls=ALL)
    expected = [
        f"{arm}{label}" for arm in ("one", "two") for label in ("", *map(", ".__add__, LABELS))
    ]
    assert list(comparison.arms) == ["scratch", *expected]
    assert [name for name, arm in comparison.arms.items() if arm.control] == [
        name for name in expected if ", " in name
    ]


def test_pretraining_and_a_random_start_cost_what_the_sources_did(calls):
    comparison = compare(corner(), seeds=2, controls=["pretraining", "random_start"])
    anywhere, itself = (call for call in calls if call["stream"] == "control source")
    alive = ~MAZE.mdp.terminal
    np.testing.assert_allclose(anywhere["task"].mdp.start, alive / alive.sum())
    assert itself["task"] is MAZE
    for call, name in ((anywhere, "transfer, random start"), (itself, "transfer, pretraining")):
        assert call["budget"] == 500
        assert comparison[name].curve.source_steps.tolist() == [500, 500]
        # What the target starts with is what its source ended with.
        target = calls[calls.index(call) + 1]
        for k, phi in enumerate(target["potentials"]):
            np.testing.assert_array_equal(phi.values, call["result"].values[k])
    plain = cr.learn(MAZE, budget=500, seeds=2, stream="control source")
    np.testing.assert_array_equal(itself["result"].values, plain.values)
    np.testing.assert_array_equal(
        comparison["transfer, pretraining"].curve.values[:, 0], plain.greedy_return[:, -1]
    )


@pytest.mark.parametrize("task", [MAZE.mdp, Pursuit(3, 1)], ids=["tables", "pursuit"])
def test_any_task_with_tables_can_be_started_anywhere(task, calls):
    compare(copied(task), seeds=1, controls=["random_start"])
    (source,) = (call["task"] for call in calls if call["stream"] == "control source")
    alive = ~task.mdp.terminal
    np.testing.assert_allclose(source.mdp.start, alive / alive.sum())
    assert source.mdp.reward is task.mdp.reward


@pytest.mark.parametrize("plan", [corner, pursuit])
def test_controls_change_the_values_of_phi_alone(plan, calls):
    comparison = compare(plan(), seeds=[4, 9], controls=["placebo", "negated"])
    assert len(comparison.arms) == 4
    target = plan().target
    arm, placebo, negated = (call for call in calls[1:] if call["stream"] == target)
    alive = ~plan().tasks[target].mdp.terminal
    for k in range(2):
        phi = arm["potentials"][k].values
        assert len(np.unique(phi)) > 5
        np.testing.assert_array_equal(negated["potentials"][k].values, -phi)
        shuffled = placebo["potentials"][k].values
        np.testing.assert_array_equal(np.sort(shuffled[alive].ravel()), np.sort(phi[alive].ravel()))
        assert not shuffled[~alive].any()
        assert (shuffled[alive] != phi[alive]).mean() > 0.3
    kept = {"task", "seeds", "shaping", "eval_freq", "evaluation", "storage", "stream", "budget"}
    for call in (placebo, negated):
        assert all(call[name] == arm[name] for name in kept)


def test_each_seed_has_its_own_permutation(calls):
    """At rate 1 all seeds learn the same of a deterministic maze, after a while."""
    learner = cr.QLearning(learning_rate=1.0, epsilon=1.0)
    plan = copied(MAZE, learner={"near": learner}, budget={"near": 20_000, "far": 100})
    compare(plan, seeds=2, controls=["placebo"], window=1)
    (first, other), placebo = (call["potentials"] for call in calls[2:])
    np.testing.assert_array_equal(first.values, other.values)
    assert (placebo[0].values != placebo[1].values).mean() > 0.5


def test_a_potential_of_states_is_changed_before_it_is_one(calls):
    compare(corner(shaping=cr.StateShaping()), seeds=1, controls=["negated"])
    arm, negated = (call for call in calls[2:] if call["stream"] == "maze")
    (q,) = (call["result"].values[0] for call in calls if call["stream"] == "corner")
    phi = np.nan_to_num(HERE.read(q))  # what no source knows is 0 here
    np.testing.assert_array_equal(arm["potentials"][0].values[0], phi.max(axis=1))
    np.testing.assert_array_equal(negated["potentials"][0].values[0], (-phi).max(axis=1))


def test_controls_of_a_target_whose_values_are_not_kept(calls):
    plan = corner(storage={"maze": cr.Storage(save_values=False)})
    comparison = compare(plan, seeds=1, controls=ALL)
    assert len(comparison.arms) == 6
    assert all(call["result"].values is None for call in calls if call["stream"] == "maze")


def test_knowing_the_optimum_pays_and_its_negation_does_not():
    """What the controls are for. 8 seeds: the least p of them is 2^-7."""
    plan = copied(MAZE, budget={"near": 20_000, "far": 20_000}, eval_freq={"far": 200})
    comparison = compare(plan, seeds=8, controls=["placebo", "negated"], window=1)
    free = {name: arm.curve.values[:, :101].mean() for name, arm in comparison.arms.items()}
    assert free["transfer"] > free["scratch"] > free["transfer, negated"]
    assert free["transfer"] > free["transfer, placebo"]
    assert comparison.against("transfer, negated")["transfer"].answer == "yes"
    over = comparison.control_verdicts["transfer"]  # draws of its placebo are as far apart
    assert (over.rival, over.answer) == ("transfer, placebo", "not shown")
    assert over.gain.estimate > 0
    assert comparison.contrasts["transfer"].jumpstart.estimate > 0
