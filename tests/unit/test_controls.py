"""Controls: what each one changes, and that it changes nothing else."""

import numpy as np
import pytest

import curricle as cr
from curricle import (
    UNMAPPED,
    Curriculum,
    GreedyEvaluation,
    GridWorld,
    Pursuit,
    Transfer,
    compare,
)
from curricle.transfer import StateActionMapping

MAZE = GridWorld(["....T", ".PPP.", "S...."], time_limit=50)
CORNER = MAZE.crop(rows=(0, 2), columns=(2, 5))
HERE = cr.same_position(MAZE, CORNER)
NOWHERE = StateActionMapping(MAZE, CORNER, np.full(HERE.index.shape, UNMAPPED))
ALL = ("random_start", "pretraining", "placebo", "scaled", "negated")
LABELS = ("placebo", "scaled x 0.5", "scaled x 2", "negated", "random start", "pretraining")


def corner(mapping=HERE, source=500, target=3000, eval_freq=100, **settings):
    """Return a curriculum from a corner of the maze to the maze."""
    return Curriculum(
        tasks={"corner": CORNER, "maze": MAZE},
        transfers=[Transfer("corner", "maze", mapping)],
        budget={"corner": source, "maze": target},
        eval_freq={"maze": eval_freq},
        **settings,
    )


def copied(task, target="far", **settings):
    """Return a curriculum from a task to itself."""
    return Curriculum(
        tasks={"near": task, target: task},
        transfers=[Transfer("near", target, cr.transfer.identity(task))],
        **({"budget": 100} | settings),
    )


@pytest.fixture
def calls(monkeypatch):
    """Return the list of all trainings from now on: their arguments, and what came of them."""
    noted, learn = [], cr.learn

    def noting(task, learner, budget, **settings):
        result = learn(task, learner, budget, **settings)
        charged = settings["charged"]
        left = budget if charged is None else budget - int(min(charged))
        shapings = settings["shaping"] if isinstance(settings["shaping"], list) else []
        settings["potentials"] = [one.for_task(task).potential for one in shapings]
        settings["shaping"] = [one.with_potential(None) for one in shapings]
        noted.append({"task": task, "budget": left, "result": result, **settings})
        return result

    monkeypatch.setattr("curricle.curriculum.node.learn", noting)
    return noted


def assert_same(one, other):
    """Two arms are equal, bit for bit."""
    np.testing.assert_array_equal(one.curve.steps, other.curve.steps)
    np.testing.assert_array_equal(one.curve.values, other.curve.values)
    np.testing.assert_array_equal(one.curve.source_steps, other.curve.source_steps)
    np.testing.assert_array_equal(one.training_return, other.training_return)
    np.testing.assert_array_equal(one.guard_share, other.guard_share)
    assert one.control == other.control


def pursuit(**settings):
    hunt, chase = Pursuit(3, 2, time_limit=50), Pursuit(3, 1, time_limit=50)
    changes = {"calibrate": settings.pop("calibrate", False)}
    return Curriculum(
        tasks={"chase": chase, "hunt": hunt},
        transfers=[
            Transfer("chase", "hunt", cr.project(hunt, chase, predator=name), **changes)
            for name in hunt.predator_names
        ],
        aggregate=cr.minimum,
        budget={"chase": 5000, "hunt": 8000},
        eval_freq={"hunt": 100},
        evaluation=GreedyEvaluation(method="rollouts", episodes=10),
        **settings,
    )


def test_controls_follow_their_arm_in_order():
    found = compare({"one": corner(), "two": corner()}, seeds=1, controls=ALL)
    expected = [
        f"{arm}{label}" for arm in ("one", "two") for label in ("", *map(", ".__add__, LABELS))
    ]
    assert list(found.arms) == ["scratch", *expected]
    assert [name for name, arm in found.arms.items() if arm.control] == [
        name for name in expected if ", " in name
    ]


def test_pretraining_and_a_random_start_cost_what_the_sources_did(calls):
    found = compare(corner(), seeds=2, controls=["pretraining", "random_start"])
    anywhere, itself = (call for call in calls if call["stream"] == "control source")
    alive = ~MAZE.mdp.terminal
    np.testing.assert_allclose(anywhere["task"].mdp.start, alive / alive.sum())
    assert itself["task"] is MAZE
    for call, name in ((anywhere, "transfer, random start"), (itself, "transfer, pretraining")):
        assert call["budget"] == 500
        assert found[name].curve.source_steps.tolist() == [500, 500]
        # What the target starts with is what its source ended with.
        target = calls[calls.index(call) + 1]
        for k, phi in enumerate(target["potentials"]):
            np.testing.assert_array_equal(phi.values, call["result"].values[k])
    plain = cr.learn(MAZE, budget=500, seeds=2, stream="control source")
    np.testing.assert_array_equal(itself["result"].values, plain.values)
    np.testing.assert_array_equal(
        found["transfer, pretraining"].curve.values[:, 0], plain.greedy_return[:, -1]
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
    found = compare(plan(), seeds=[4, 9], controls=["placebo", "scaled", "negated"])
    assert len(found.arms) == 6
    target = plan().target
    arm, placebo, half, twice, negated = (call for call in calls[1:] if call["stream"] == target)
    alive = ~plan().tasks[target].mdp.terminal
    for k in range(2):
        phi = arm["potentials"][k].values
        assert len(np.unique(phi)) > 5
        np.testing.assert_allclose(half["potentials"][k].values, phi / 2, rtol=1e-15)
        np.testing.assert_array_equal(twice["potentials"][k].values, 2 * phi)
        np.testing.assert_array_equal(negated["potentials"][k].values, -phi)
        shuffled = placebo["potentials"][k].values
        np.testing.assert_array_equal(np.sort(shuffled[alive].ravel()), np.sort(phi[alive].ravel()))
        assert not shuffled[~alive].any()
        assert (shuffled[alive] != phi[alive]).mean() > 0.3
    keep = (
        "task",
        "seeds",
        "shaping",
        "eval_freq",
        "evaluation",
        "storage",
        "stream",
        "budget",
    )
    for call in (placebo, half, twice, negated):
        assert {name: call[name] for name in keep} == {name: arm[name] for name in keep}


def test_each_seed_has_its_own_permutation(calls):
    """At rate 1 all seeds learn the same of a deterministic maze, after a while."""
    learner = cr.QLearning(learning_rate=1.0, epsilon=1.0)
    plan = copied(MAZE, learner={"near": learner}, budget={"near": 20_000, "far": 100})
    compare(plan, seeds=2, controls=["placebo"], window=1)
    (one, other), placebo = (call["potentials"] for call in calls[2:])
    np.testing.assert_array_equal(one.values, other.values)
    assert (placebo[0].values != placebo[1].values).mean() > 0.5


def test_a_potential_of_states_is_changed_before_it_is_one(calls):
    compare(corner(shaping=cr.StateShaping()), seeds=1, controls=["negated"])
    arm, negated = (call for call in calls[2:] if call["stream"] == "maze")
    (q,) = (call["result"].values[0] for call in calls if call["stream"] == "corner")
    phi = HERE.read(q)
    np.testing.assert_array_equal(arm["potentials"][0].values[0], phi.max(axis=1))
    np.testing.assert_array_equal(negated["potentials"][0].values[0], (-phi).max(axis=1))


def test_controls_of_a_target_whose_values_are_not_kept(calls):
    plan = corner(storage={"maze": cr.Storage(save_values=False)})
    found = compare(plan, seeds=1, controls=ALL)
    assert len(found.arms) == 8
    assert all(call["result"].values is None for call in calls if call["stream"] == "maze")


def test_knowing_the_optimum_pays_and_its_negation_does_not():
    """What the controls are for. 8 seeds: the least p of them is 2^-7, times 3 arms 0.02."""
    plan = copied(MAZE, budget={"near": 20_000, "far": 20_000}, eval_freq={"far": 200})
    found = compare(plan, seeds=8, controls=["placebo", "negated"], window=1)
    free = {name: arm.curve.values[:, :101].mean() for name, arm in found.arms.items()}
    assert free["transfer"] > free["scratch"] > free["transfer, negated"]
    assert free["transfer"] > free["transfer, placebo"]
    assert found.contrasts["transfer, negated"].verdict == "costs more than it brings"
    assert found.contrasts["transfer"].jumpstart.low > 0


def test_scaled_potentials_serve_sparse_tables_too():
    plan = pursuit(storage={"hunt": cr.Storage(kind="sparse")})
    found = compare(plan, seeds=1, controls=["scaled"])
    dense = compare(pursuit(), seeds=1, controls=["scaled"])
    for name in dense.arms:
        assert_same(found[name], dense[name])
