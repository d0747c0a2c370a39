"""Whether a source learnt its own task: its return against its optimum, or a fresh learner's."""

from dataclasses import replace

import numpy as np
import pytest

import curricle as cr
from curricle.comparison import source_learning
from curricle.comparison.forecasting import SourceLearning
from curricle.curriculum import SourceValues
from curricle.planning import target as target_module
from curricle.planning.target import Target
from tests.support.tasks import ring

MAZE = cr.GridWorld(["....T", ".PPP.", "S...."])
CORNER = MAZE.crop(rows=(0, 2), columns=(2, 5))


def plan(**settings):
    edge = cr.Transfer("corner", "maze", cr.same_position(MAZE, CORNER))
    return cr.Curriculum({"corner": CORNER, "maze": MAZE}, [edge], budget=1_000, **settings)


def values_of(*tables):
    steps = np.full(len(tables), 500)
    return {"corner": SourceValues(CORNER, tuple(range(len(tables))), np.stack(tables), steps)}


def solved():
    return Target.of(CORNER).solution.action_values


def judged(*tables):
    return source_learning(plan(), values_of(*tables))["corner"]


def test_the_optimal_and_the_worst_values_by_hand():
    learning = judged(solved(), solved())
    assert learning.returns == pytest.approx([Target.of(CORNER).optimum] * 2)
    assert (learning.shares, learning.noise, learning.learnt) == (
        pytest.approx([1.0, 1.0]),
        0.0,
        True,
    )
    assert str(learning) == "corner learnt 100 % of the way to its optimum"
    learning = judged(-solved())
    assert learning.share < 0
    assert "did NOT learn its own task" in str(learning)


def test_equal_values_are_the_random_policy_and_learnt_nothing():
    learning = judged(np.zeros_like(solved()))
    assert learning.returns == pytest.approx([learning.random_return])
    assert (learning.share, learning.learnt) == (pytest.approx(0.0), False)
    assert str(learning) == (
        f"corner did NOT learn its own task: {learning.random_return:.4g} where random is "
        f"{learning.random_return:.4g} and its optimum {Target.of(CORNER).optimum:.4g}; its values "
        "may mislead"
    )


def test_a_seed_that_failed_is_not_hidden_by_those_that_learnt():
    learning = judged(*[solved()] * 4, -solved() * 0)
    assert 0.5 < learning.share < 0.9
    assert str(learning) == (
        "corner learnt only 80 % of the way to its optimum, but 1 of 5 seeds did NOT learn it"
    )


def test_what_cannot_be_judged_is_left_open():
    learning = replace(judged(solved()), reference=5.0, random_return=5.0)
    assert np.isnan(learning.share)
    assert learning.learnt is None
    assert str(learning) == (
        "corner cannot be judged: its optimum returns 5, no more than random (5)"
    )
    kept = values_of(solved())
    assert source_learning(plan(), {"corner": replace(kept["corner"], values=None)}) == {}
    learning = replace(
        judged(solved()), returns=np.array([99.7]), random_return=0.0, reference=100.0
    )
    assert str(learning).startswith("corner learnt 99 % of the way")


def test_a_source_that_cannot_be_solved_is_measured_by_a_fresh_learner_of_twice_the_steps():
    task = ring(time_limit=30)  # it has functions, no tables
    edge = cr.Transfer("ring", "rings", cr.from_function(task, task, lambda s, a: (s, a)))
    both = cr.Curriculum({"ring": task, "rings": task}, [edge], budget=cr.StoppingRule(4_000))
    sources = both.train(seeds=[3, 4], only="ring").sources
    learning = source_learning(both, sources)["ring"]
    assert (learning.measured_by, learning.fresh_steps) == ("a fresh learner", 8_000)
    assert learning.reference > learning.random_return + 2 * learning.noise > learning.random_return
    assert abs(learning.share - 1) < 0.3  # both learn it
    assert str(learning).endswith("of the way to a fresh learner of 8,000 steps")
    # The same values, measured by nothing:
    unknown = source_learning(both, sources, fresh=False)["ring"]
    assert np.isnan(unknown.share)
    assert str(unknown).endswith("its optimum is not known")
    nothing = {"ring": replace(sources["ring"], values=np.zeros_like(sources["ring"].values))}
    assert "did NOT learn its own task" in str(source_learning(both, nothing, fresh=False)["ring"])


def test_noise_is_the_standard_error_of_rollouts(monkeypatch):
    """The same source, exactly and by rollouts: they agree within four standard errors."""
    for bound in ("LARGEST_EXACT", "LARGEST_EVALUATED"):
        monkeypatch.setattr(target_module, bound, 0)
    learning = judged(solved())
    assert learning.noise > 0
    assert abs(learning.random_return - Target.of(CORNER).random_return) < 4 * learning.noise


def test_a_source_that_is_not_evaluated_while_learning_is_judged_all_the_same():
    off = cr.GreedyEvaluation(method="off", discounted=False)
    learning = source_learning(plan(evaluation={"corner": off}), values_of(solved()))["corner"]
    assert learning.share == pytest.approx(1.0)


def test_a_forecast_has_a_line_for_every_source():
    learning = cr.forecast(plan(), seeds=2)
    assert isinstance(learning.sources["corner"], SourceLearning)
    assert str(learning.sources["corner"]) in str(learning)
    spoiled = values_of(-solved())
    assert "corner did NOT learn its own task" in " ".join(
        str(cr.forecast(plan(), seeds=1, trained=spoiled)).split()
    )
