"""Curricula that the tests of comparisons share, and a record of what is trained."""

from functools import partial

import numpy as np
import pytest

import curricle as cr
from curricle import Curriculum, GreedyEvaluation, GridWorld, Pursuit, StoppingRule, Transfer
from curricle.comparison import Arm, Comparison, Reference
from curricle.learning.stopping import limits
from curricle.statistics import Curve
from tests.support.tasks import predator_edges

MAZE = GridWorld(["....T", ".PPP.", "S...."], time_limit=50)
CORNER = MAZE.crop(rows=(0, 2), columns=(2, 5))
HERE = cr.same_position(MAZE, CORNER)
alone = partial(cr.compare, opponents=())  # against the target's own learner and no other
ALL = ("random_start", "pretraining", "placebo", "negated")


def exactly(budget):
    """Return a budget that a source takes to its last step."""
    return StoppingRule(budget) if isinstance(budget, int) else budget


def corner(scale=1.0, source=500, target=3000, eval_freq=100, **settings):
    """Return a curriculum from a corner of the maze, learnt for so many steps, to the maze."""
    return Curriculum(
        tasks={"corner": CORNER, "maze": MAZE},
        transfers=[Transfer("corner", "maze", HERE, scale)],
        budget={"corner": exactly(source), "maze": target},
        eval_freq={"maze": eval_freq},
        **({"shaping": cr.QInitialisation()} | settings),
    )


def copied(task, target="far", **settings):
    """Return a curriculum from a task to itself."""
    given = {"budget": {"near": StoppingRule(100), target: 100}, "shaping": cr.QInitialisation()}
    return Curriculum(
        tasks={"near": task, target: task},
        transfers=[Transfer("near", target, cr.transfer.identity(task))],
        **(given | settings),
    )


def pursuit(**settings):
    hunt, chase = Pursuit(3, 2, time_limit=50), Pursuit(3, 1, time_limit=50)
    return Curriculum(
        tasks={"chase": chase, "hunt": hunt},
        transfers=predator_edges(hunt, chase),
        aggregate=cr.minimum,
        budget={"chase": StoppingRule(5000), "hunt": 8000},
        eval_freq={"hunt": 100},
        evaluation=GreedyEvaluation(method="rollouts", episodes=10),
        **({"shaping": cr.QInitialisation()} | settings),
    )


def arm_of(rows, spent=0, eval_freq=10, **kind):
    """Return an arm whose seeds have these curves, after so many source steps."""
    values = np.array(rows, dtype=float)
    steps, sources = np.arange(values.shape[1]) * eval_freq, np.full(len(values), spent)
    return Arm(Curve(steps, values, sources), **kind)


def flat(returns, curriculum="", **kind):
    """Return an arm whose seeds have constant curves of these heights."""
    values = np.repeat(np.asarray(returns, dtype=float)[:, None], 2, axis=1)
    curve = Curve(np.array([0, 10]), values)
    return Arm(curve, curriculum=curriculum, **kind)


def of_arms(arms):
    """Return the comparison of arms with two checkpoints, as those of `flat` have."""
    return Comparison("maze", arms, 10, 10, Reference(0.5), 1)


@pytest.fixture
def calls(monkeypatch):
    """Return the list of all trainings from now on: their arguments, and what came of them."""
    noted, learn = [], cr.learn

    def noting(task, learner, budget, **settings):
        result = learn(task, learner, budget, **settings)
        charged = settings["charged"]
        steps = limits(budget)[0]
        left = steps if charged is None else steps - int(min(charged))
        shapings = settings["shaping"] if isinstance(settings["shaping"], list) else []
        settings["potentials"] = [one.for_task(task).potential for one in shapings]
        settings["shaping"] = [one.with_potential(None) for one in shapings]
        noted.append({"task": task, "budget": left, "result": result, **settings})
        return result

    monkeypatch.setattr("curricle.curriculum.curriculum.learn", noting)
    return noted


def assert_same(one, other):
    """Two arms are equal, bit for bit."""
    np.testing.assert_array_equal(one.curve.steps, other.curve.steps)
    np.testing.assert_array_equal(one.curve.values, other.curve.values)
    np.testing.assert_array_equal(one.curve.source_steps, other.curve.source_steps)
    assert (one.scratch, one.curriculum) == (other.scratch, other.curriculum)
