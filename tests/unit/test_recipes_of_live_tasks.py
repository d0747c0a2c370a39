"""Recipes, problems and budgets where tasks are live, and every evaluation takes steps."""

from collections import Counter
from functools import partial

import numpy as np
import pytest

import curricle as cr
from curricle import Component, GreedyEvaluation, QLearning, Space
from curricle.design import (
    BudgetSpent,
    Problem,
    Recipe,
    Relation,
    SearchBudget,
    Stage,
    design_recipe,
)
from curricle.errors import CurriculumError
from curricle.tasks import ComponentsByName, LiveMDP, Parameter, task_family
from tests.refusals import cases, check_refusal

MOVE = Space([Component("move", 2)])
TAKEN = Counter()
"""Steps taken in environments, by their length."""
LIMIT, EPISODES = 12, 2
ROLLOUTS = GreedyEvaluation("rollouts", episodes=EPISODES, discounted=False)


class Corridor:
    """An environment that counts its steps: the place is the distance to the end."""

    def __init__(self, length):
        self.length = length

    def reset(self, seed=None):
        self.place = self.length - 1
        return self.place, {}

    def step(self, action):
        TAKEN[self.length] += 1
        self.place = min(self.place + (1 if action else -1), self.length - 1)
        return self.place, -1.0, self.place == 0, False, {}

    def close(self):
        pass


@task_family(Parameter("length", low=2, high=9, harder="larger"), mapping=ComponentsByName("clip"))
def corridor(length: int):
    places = Space([Component("place", length)])
    return LiveMDP(places, MOVE, partial(Corridor, length), time_limit=LIMIT)


def member(term):
    return Relation("member", changes={"length": term})


def problem(length=6, **settings):
    given = {"steps": 400, "threshold": -5.0, "evaluation": ROLLOUTS, "eval_freq": 50}
    return Problem(corridor(length=length), miniature=True, **given | settings)


def plan(given, recipe):
    return recipe.curriculum(given.target, **given.settings)


def test_a_smaller_member_is_a_source_without_tables():
    found = member("n - 2").source_of(corridor(length=6))
    assert found.member == corridor(length=4)
    assert found.task.states.size == 4
    assert found.mapping.target.states.size == 6


def test_members_that_are_the_target_or_one_another_are_left_out():
    stages = [Stage(member(term), 10) for term in ("0.1 n", "0.2 n", "n - 1")]
    assert [one.member["length"] for _, one in Recipe(stages).sources(corridor(length=9))] == [2, 8]
    assert Recipe(stages).sources(corridor(length=2)) == []
    built = Recipe(stages).curriculum(corridor(length=2), budget=100)
    assert built.order == ("target",)


@pytest.mark.parametrize(
    ("error", "call", "says"),
    cases({
        CurriculumError: {
            "live": (
                lambda: Problem(corridor(length=4)),
                r"needs a target with tables; give the threshold of corridor.*: got LiveMDP",
            ),
            "observed": (
                lambda: Problem(cr.observation_task("CartPole-v1")),
                r"give the threshold of target: got ObservationTask",
            ),
            "placebo": (
                lambda: problem().train(problem().scratch, [0], placebo=True),
                r"shuffles values over the pairs of a target with tables: got LiveMDP",
            ),
        }
    }),
)  # fmt: skip
def test_what_needs_tables_is_refused_without_them(error, call, says):
    check_refusal(error, call, says)


@pytest.mark.parametrize("target", [corridor(length=4), cr.observation_task("CartPole-v1")])
def test_without_tables_a_few_rollouts_are_the_default(target):
    found = Problem(target, threshold=-3.0).evaluation
    assert found.method == "rollouts"
    task = target.task if target is not None and hasattr(target, "task") else target
    assert found.rollouts(task) == 5


@pytest.mark.parametrize("settled", [False, True])
def test_every_step_in_an_environment_is_booked(settled):
    given, recipe = problem(), Recipe([Stage(member("n - 2"), 50, settled=settled)])
    budget = SearchBudget(1e6)
    TAKEN.clear()
    found = budget.train(given, plan(given, recipe), seeds=range(3))
    ledger = budget.ledger
    assert ledger.steps["miniatures"] + ledger.steps["evaluation"] == TAKEN.total()
    assert ledger.total_steps == TAKEN.total()
    assert TAKEN.total() > found.steps.sum()


def test_a_source_is_evaluated_only_where_its_budget_depends_on_it():
    for settled in (False, True):
        given, recipe = problem(), Recipe([Stage(member("n - 2"), 50, settled=settled)])
        TAKEN.clear()
        found, _ = given.train(plan(given, recipe), range(3))
        assert (TAKEN[4] > found.source_steps.sum()) == settled


@pytest.mark.parametrize("settled", [False, True])
def test_a_budget_pays_for_evaluations_too(settled):
    given, recipe = problem(), Recipe([Stage(member("n - 2"), 50, settled=settled)])
    built, episode = plan(given, recipe), LIMIT * EPISODES
    target, source = (400 // 50 + 1) * episode, (200 // 2 + 1) * episode
    assert given.evaluated_at_most(built) == target + (source if settled else 0)
    budget = SearchBudget(1e6)
    most = budget.most(given, 2, curriculum=built)
    assert most == 2 * (400 + given.evaluated_at_most(built))
    assert budget.most(given, 2) == 2 * (400 + target)
    budget.train(given, built, range(2))
    assert budget.ledger.cost <= most
    with pytest.raises(BudgetSpent, match=f"may cost {most:,.0f} steps"):
        SearchBudget(most - 1).train(given, built, range(2))
    assert SearchBudget(most).affords(given, 2, curriculum=built)


def test_evaluations_of_a_real_target_have_their_own_price():
    given = problem()
    real = Problem(given.target, 400, threshold=-5.0, evaluation=ROLLOUTS, eval_freq=50)
    free = SearchBudget(1e6, prices={"evaluation": 0})
    assert free.most(real, 1) == 400
    assert SearchBudget(1e6).most(real, 1) == 400 + 9 * LIMIT * EPISODES


def test_tables_are_evaluated_exactly_at_no_cost():
    maze = Problem(cr.GridWorld("S..T"), steps=2000)
    assert maze.evaluated_at_most(maze.scratch) == 0
    assert SearchBudget(1e6).most(maze, 3) == 6000


def test_a_live_source_makes_a_live_target_sooner_learnt():
    given = problem(length=9, threshold=-8.0, learner=QLearning(learning_rate=0.5), eval_freq=10)
    recipe = Recipe([Stage(member("n - 5"), 30)])
    target = given.train(plan(given, recipe), range(8))[0]
    alone = given.train(given.scratch, range(8))[0]
    assert target.learnt.all()
    assert np.mean(target.steps - target.source_steps) < np.mean(alone.steps)


def test_a_recipe_is_designed_on_live_members_without_a_placebo():
    stages = {f"{n}": Recipe([Stage(member("n - 2"), n)]) for n in (5, 40)}
    budget = SearchBudget(1e6, prices={"evaluation": 0})
    found = design_recipe([problem(steps=1500)], budget, arms=stages)
    assert set(found.judgement.steps) >= {"scratch", "recipe"}
    assert "placebo" not in found.judgement.steps
    assert all("placebo" not in one.scores for one in found.races[0].rounds)
    assert str(found)
