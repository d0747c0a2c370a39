"""Races of recipes, numbers by size, judgements, and the budget that pays for all of them."""

import json
from dataclasses import replace

import numpy as np
import pytest

import curricle as cr
from curricle.design import (
    Judgement,
    Problem,
    Recipe,
    Relation,
    SearchBudget,
    Stage,
    design_curriculum,
    design_recipe,
    first_arms,
    judge,
    race,
    timed,
    variations,
)
from curricle.design.judgement import RECIPE
from curricle.design.racing import FIRST_RUNS, PLACEBO
from curricle.design.search_budget import BudgetSpent
from curricle.design.step_trend import DOUBT, FACTORS, fitted, lowest, way_slope, with_step_trend
from curricle.errors import CurriculumError
from curricle.study.recipes.recipe_file import judgement_data
from curricle.study.recipes.recipe_tables import rounded
from curricle.tasks import CliffWalking, maze_family, pursuit_family
from tests.refusals import cases, check_refusal

LEARNER = cr.QLearning(learning_rate=0.1, epsilon=0.1)
BUDGET = 1_500_000
MAZE = maze_family(size=4, seed=107)


def maze(size, seed=107, **settings):
    """Return a random maze as a problem; a corner of it is a good source."""
    member = maze_family(
        size=size, walls=0.0, pits=0.22, fires=0.05, seed=seed, step=-5.0, time_limit=20 * size
    )
    given = {"steps": 12_000, "fraction": 0.975, "eval_freq": 100, "learner": LEARNER}
    return Problem(member, **given | settings)


def crop(share=0.5, steps=20, **settings):
    return Recipe([Stage(Relation("crop", share), steps)], **settings)


GOOD, BAD = crop(), crop(0.9, 400)
"""A corner, and one that takes most of a training."""
FEW = {"good": GOOD, "more": crop(0.7, 20), "bad": BAD}


# -- problems ------------------------------------------------------------------------------------


def test_the_cost_of_a_training_is_source_steps_and_target_steps():
    problem = maze(6)
    found, spent = problem.train(problem.curriculum(GOOD), range(4))
    states = problem.curriculum(GOOD).tasks["rows 0..2, columns -2..0"].states.size
    assert (found.source_steps == 20 * states).all()
    assert (found.steps > found.source_steps).all()
    assert spent.total_steps == found.steps.sum()
    assert spent.steps["sources"] == found.source_steps.sum()


def test_a_training_ends_where_the_target_is_learnt_and_not_later():
    problem = maze(6)
    found, _ = problem.train(problem.scratch, range(4))
    again = cr.learn(
        problem.task, LEARNER, problem.steps, seeds=range(4), eval_freq=100,
        evaluation=problem.evaluation, stream="target",
    )  # fmt: skip
    for steps, greedy in zip(found.steps, again.greedy_return, strict=True):
        reached = greedy >= problem.level
        lasting = reached[2:] & reached[1:-1] & reached[:-2]
        assert steps == again.steps[2:][lasting][0]
    assert found.learnt.all()


def test_sources_that_take_all_steps_are_not_trained():
    problem = maze(6, steps=500)
    found, spent = problem.train(problem.curriculum(BAD), range(2))
    assert spent.total_steps == 0
    assert (found.steps == 500).all()
    assert not found.learnt.any()


def test_the_area_weighs_steps_by_what_is_missing():
    problem = maze(6, measure="area", steps=4000)
    found, _ = problem.train(problem.scratch, range(3))
    again = cr.learn(
        problem.task, LEARNER,
        cr.StoppingRule(4000, threshold=problem.level, patience=3),
        seeds=range(3), eval_freq=100, evaluation=problem.evaluation, stream="target",
    )  # fmt: skip
    worst = problem.random_return
    for k in range(3):
        used = again.steps_used[k]
        greedy = again.greedy_return[k][: used // 100]
        share = (problem.level - greedy) / (problem.level - worst)
        assert found.steps[k] == round(100 * share.clip(0, 1).sum())


# -- the budget ----------------------------------------------------------------------------------


@pytest.mark.parametrize("cost", [0, 10_000, 60_000, 300_000])
def test_no_training_is_begun_that_the_budget_may_not_pay_for(cost):
    problem, budget = maze(6), SearchBudget(cost)
    while budget.affords(problem, 2):
        budget.train(problem, problem.scratch, range(2))
    with pytest.raises(BudgetSpent, match="may cost 24,000 steps"):
        budget.train(problem, problem.scratch, range(2))
    assert budget.ledger.cost <= cost
    assert budget.left < 24_000


def test_a_share_of_the_budget_binds_inside_and_not_after():
    budget = SearchBudget(100_000)
    with budget.share(0.1, aside=50_000):
        assert budget.left == 5_000
        assert not budget.affords(maze(6), 1)
    assert budget.left == 100_000


def test_prices_decide_what_a_budget_pays_for():
    problem = maze(6, miniature=True)
    assert SearchBudget(12_000, prices={"miniatures": 0.5}).affords(problem, 2)
    assert not SearchBudget(12_000).affords(problem, 2)


# -- races ---------------------------------------------------------------------------------------


def test_a_race_keeps_the_better_half_and_the_controls():
    problems, budget = [maze(6), maze(6, seed=231)], SearchBudget(BUDGET)
    arms = {"good": GOOD, "bad": BAD, "fixed": crop(0.7, 100), "far": crop(0.9, 100)}
    found = race(timed(problems, budget), arms, budget, always=["fixed"])
    first, second = found.rounds
    assert (first.runs, second.runs) == (FIRST_RUNS, 2 * FIRST_RUNS)
    assert set(first.scores) == {"scratch", *arms}
    assert "bad" not in second.scores
    assert {"scratch", "fixed", PLACEBO} <= set(second.scores)
    assert found.leader == "good"
    assert found.ranking[0] == "good"
    assert PLACEBO not in found.ranking


def test_scores_are_mean_steps_over_those_of_scratch_in_the_same_problems():
    problems, budget = [maze(6), maze(6, seed=231)], SearchBudget(BUDGET)
    found = race(timed(problems, budget), {"good": GOOD, "bad": BAD}, budget)
    shares = [
        own.mean() / scratch.mean()
        for own, scratch in zip(found.steps["good"], found.steps["scratch"], strict=True)
    ]
    assert found.rounds[-1].scores["good"] == pytest.approx(np.mean(shares))


def test_the_share_of_sources_is_their_steps_over_those_of_scratch_in_the_same_runs():
    problems, budget = [maze(6), maze(6, seed=231)], SearchBudget(BUDGET)
    found = race(timed(problems, budget), {"good": GOOD, "bad": BAD}, budget)
    for name, left in {"good": False, "bad": True}.items():
        shares = []
        for problem, own, sources, scratch in zip(
            found.problems,
            found.steps[name],
            found.source_steps[name],
            found.steps["scratch"],
            strict=True,
        ):
            trained, _ = problem.train(problem.curriculum(found.arms[name]), range(2))
            assert (sources == trained.source_steps[0]).all()  # no stage settles before its end
            assert (len(own) < len(scratch)) == left
            shares.append(sources.mean() / scratch[: len(own)].mean())
        assert found.source_share(name) == pytest.approx(np.mean(shares))
    assert found.source_share("scratch") == 0
    assert found.source_share(PLACEBO) > 0


def test_no_curriculum_wins_where_every_recipe_is_worse():
    budget = SearchBudget(BUDGET)
    found = race(timed([maze(6)], budget), {"bad": BAD, "worse": crop(0.9, 800)}, budget)
    assert found.leader == "scratch"


def test_an_arm_without_sources_in_some_problem_is_dropped_with_the_reason():
    problems, budget = [maze(6)], SearchBudget(BUDGET)
    no_fire = Recipe([Stage(Relation("removed", which="no such thing"), 10)])
    found = race(timed(problems, budget), {"good": GOOD, "none": no_fire}, budget)
    assert "has no source that is" in found.dropped["none"]
    assert list(found.arms) == ["good"]


@pytest.mark.parametrize(("rate", "annealed"), [(0.1, True), (0.9, False)])
def test_sources_of_slow_learners_are_annealed_first(rate, annealed):
    arms = first_arms([maze(6, learner=cr.QLearning(learning_rate=rate))])
    assert next(iter(arms.values())).annealed == annealed
    assert arms == first_arms([maze(6)])  # in another order


def test_the_first_arms_race_where_the_budget_pays_for_few():
    budget = SearchBudget(250_000)
    problems = timed([maze(6)], budget)
    arms = first_arms(problems)
    found = race(problems, arms, budget)
    assert 1 <= len(found.arms) < len(arms)
    assert list(found.arms) == list(arms)[: len(found.arms)]
    assert budget.ledger.cost <= 250_000


def test_a_round_that_the_budget_cuts_short_leaves_arms_paired(monkeypatch):
    # Races are planned by what they are expected to cost: here that is too little.
    monkeypatch.setattr("curricle.design.racing.race_cost", lambda *_: 0.0)
    problem, ended = maze(6, steps=6_000), 0
    for cost in range(60_000, 120_000, 6_000):
        try:
            found = race([problem], FEW, SearchBudget(cost), always=list(FEW))
        except BudgetSpent:
            continue
        lengths = {len(found.steps[name][0]) for name in ("scratch", *FEW)}
        assert len(lengths) == 1
        ended += bool(found.ended)
    assert ended


def test_variations_differ_from_the_leader_in_one_setting_each():
    leader = crop(0.35, 30)
    for name, other in variations(leader, several=True).items():
        assert name
        assert other != leader
        same = [
            str(other.stages[0].steps) == str(leader.stages[0].steps),
            other.stages[0].settled == leader.stages[0].settled,
            str(other.scale) == str(leader.scale),
            other.shaping == leader.shaping,
            other.aggregate == leader.aggregate,
            other.annealed == leader.annealed,
        ]
        assert same.count(False) == 1


# -- numbers by size -----------------------------------------------------------------------------


@pytest.mark.parametrize("slope", [-0.25, 0.0, 0.5, 1.0])
@pytest.mark.parametrize("level", [-0.7, 0.0, 0.9])
def test_the_lowest_point_of_shifted_curves_is_found(level, slope):
    x, sizes = np.log(FACTORS), np.log([16.0, 16.0, 36.0, 64.0])
    u = x - level - slope * (sizes - sizes.mean())[:, None]
    costs = 0.5 * np.exp(0.15 * u**2 + 0.03 * u**3)  # steeper to the right, as real ones are
    found = lowest(sizes, costs)
    assert found == pytest.approx((level, slope), abs=0.1)


def test_costs_that_do_not_pay_have_no_say():
    x, sizes = np.log(FACTORS), np.log([16.0, 64.0])
    costs = 0.5 * np.exp(0.15 * (x - 0.4 * (sizes - sizes.mean())[:, None]) ** 2)
    capped = np.where(costs < 1, costs, 1.5)
    assert lowest(sizes, capped) == pytest.approx((0.0, 0.4), abs=0.06)
    nothing = np.full((2, len(FACTORS)), 1.2)
    assert lowest(sizes, nothing)[1] == 0.0


def test_at_one_size_the_number_is_a_constant():
    x = np.log(FACTORS)
    costs = np.tile(0.5 * np.exp(0.1 * (x - 0.7) ** 2), (3, 1))
    assert lowest(np.log([36.0] * 3), costs) == pytest.approx((0.7, 0.0), abs=0.02)


def valleys(lows):
    """Return costs of which the lowest is at these log factors, for one seed, (P, F, 1)."""
    return 0.4 * np.exp(0.1 * (np.log(FACTORS) - np.asarray(lows)[:, None]) ** 2)[:, :, None]


def test_ways_grow_more_slowly_than_states():
    mazes, hunts = [maze(4), maze(8)], [hunt(2), hunt(4)]
    assert way_slope(mazes) == pytest.approx(0.5, abs=0.2)
    assert way_slope(hunts) == pytest.approx(np.log(3 / 1) / np.log(4096 / 64))
    assert way_slope([maze(6), maze(6, seed=231)]) is None


def hunt(size):
    return Problem(pursuit_family(size=size, predators=2, discount=0.95), steps=1000)


def test_a_slope_on_which_problems_agree_is_kept_and_others_become_that_of_the_way():
    sizes = np.repeat([3.5, 4.5], 6)
    agreed = 0.9 * (sizes - 4.0)
    apart = agreed + np.tile([1.0, -1.0, 0.6, -0.6, 0.3, -0.3], 2)
    found = {
        name: fitted(sizes, valleys(lows), 0.4, np.random.default_rng(1))
        for name, lows in {"agreed": agreed, "apart": apart}.items()
    }
    assert found["agreed"][1] == pytest.approx(0.9, abs=0.05)
    assert 0.4 < found["apart"][1] < 0.7
    spread = {name: draws[:, 1].std() for name, (_, _, draws) in found.items()}
    assert spread["agreed"] < 0.05 < spread["apart"] < 1.1 * DOUBT * 0.4


def test_the_part_of_a_slope_that_a_recipe_has_is_not_added_again():
    sizes = np.repeat([3.5, 4.5], 4)
    costs = valleys([1.0, -1.0, 0.6, -0.6] * 2)
    whole, rest = (
        fitted(sizes, costs, 0.4, np.random.default_rng(1), known=known)[1] for known in (0.0, 0.4)
    )
    assert rest < 0.1 < whole
    flat = with_step_trend([maze(6)], GOOD, SearchBudget(BUDGET), first_seed=3)
    assert flat.stages[0].steps.slope == 0.0


# -- judgements ----------------------------------------------------------------------------------


def test_a_judgement_compares_on_the_same_seeds():
    problems = [maze(6), maze(6, seed=231)]
    found = judge(problems, GOOD, SearchBudget(BUDGET), others={"bad": BAD}, seeds=5)
    assert {name: rows.shape for name, rows in found.steps.items()} == dict.fromkeys(
        ["scratch", RECIPE, "bad", PLACEBO], (2, 5)
    )
    assert found.cost() < 1 < found.cost("bad")
    assert found.saving().estimate == pytest.approx(1 - found.cost())


def test_the_interval_is_over_problems_where_they_are_many():
    random = np.random.default_rng(0)
    steps = {"scratch": random.integers(90, 110, (6, 40)), RECIPE: random.integers(40, 60, (6, 40))}
    assert Judgement(steps).saving().n == 6
    few = Judgement({name: rows[:2] for name, rows in steps.items()})
    assert few.saving().n == 40


# -- designs -------------------------------------------------------------------------------------


def small():
    return [maze(n, seed=107) for n in (5, 6)]


def test_the_same_seed_is_the_same_design_whatever_the_workers():
    first, again = (
        design_recipe(small(), SearchBudget(BUDGET, workers=n), arms=FEW) for n in (1, 2)
    )
    assert first.best == again.best
    assert first.recipe == again.recipe
    assert first.ledger.steps == again.ledger.steps
    for one, other in zip(first.races, again.races, strict=True):
        assert one.rounds == other.rounds
    for name in first.judgement.steps:
        np.testing.assert_array_equal(first.judgement.steps[name], again.judgement.steps[name])
    other = design_recipe(small(), SearchBudget(BUDGET), arms=FEW, seed=1)
    assert other.ledger.steps != first.ledger.steps


def test_a_design_never_costs_more_than_its_budget_and_pays():
    for cost in (300_000, 600_000):
        found = design_recipe(small(), SearchBudget(cost), standing={})
        assert found.ledger.cost <= cost
    assert found.recipe.stages
    assert found.judgement.saving().low > 0
    assert "pays by what it knows" in str(found)
    assert found.break_even(1e6).trainings >= 1


def test_where_nothing_pays_the_design_says_no_curriculum():
    arms = {"bad": BAD, "worse": crop(0.9, 800)}
    found = design_recipe([maze(6)], SearchBudget(BUDGET), arms=arms, fixed=crop(0.9, 300))
    assert found.recipe == Recipe()
    assert str(found).startswith("no curriculum")
    assert "No curriculum" in found.why


def test_a_killed_design_goes_on_to_the_same_bits(tmp_path):
    whole = tmp_path / "whole.jsonl"
    found = design_recipe(small(), SearchBudget(400_000, journal=whole), arms=FEW)
    lines = whole.read_bytes().splitlines(keepends=True)
    for kept, torn in ((0, b""), (7, b'{"key"'), (len(lines) - 1, b""), (len(lines), b"")):
        part = tmp_path / f"{kept}.jsonl"
        part.write_bytes(b"".join(lines[:kept]) + torn)
        again = design_recipe(small(), SearchBudget(400_000, journal=part), arms=FEW)
        assert part.read_bytes() == whole.read_bytes()
        assert str(again) == str(found)


def test_a_journal_of_another_design_is_refused(tmp_path):
    path = tmp_path / "trainings.jsonl"
    design_recipe(small(), SearchBudget(400_000, journal=path), arms=FEW)
    with pytest.raises(CurriculumError, match="holds another design: its training 1 is not"):
        design_recipe(small(), SearchBudget(400_000, journal=path), arms=FEW, seed=1)
    path.write_text(json.dumps({"some": "thing"}) + "\n")
    with pytest.raises(CurriculumError, match=r"line 1 of .* is no training of a design"):
        SearchBudget(1, journal=path)


# -- one target ----------------------------------------------------------------------------------


def test_one_training_is_not_worth_a_search():
    found = design_curriculum(maze(6))
    assert found.search is None
    assert found.ledger.cost == 0
    assert found.recipe.stages
    assert "costs nothing to find" in found.why


def test_many_trainings_are():
    told = []
    found = design_curriculum(maze(8, steps=20_000), trainings=3_000, progress=told.append)
    assert found.search is not None
    assert told == [*found.search.races, found.search.judgement]
    assert 0 < found.ledger.cost <= 3_000 * 0.1 * 20_000 / 3
    assert found.curriculum.target == "target"


def test_a_wrong_progress_is_refused_whether_or_not_there_is_a_search():
    with pytest.raises(cr.errors.SettingError, match="progress must be True, False, None"):
        design_curriculum(Problem(CliffWalking(), steps=5_000), progress=3)


def test_without_parts_or_members_there_is_no_curriculum():
    found = design_curriculum(Problem(CliffWalking(), steps=5_000))
    assert found.recipe == Recipe()
    assert "No curriculum" in found.why


def test_where_no_search_is_possible_it_does_not_say_that_one_costs_too_much():
    found = design_curriculum(Problem(CliffWalking(), steps=500), trainings=1_000_000)
    assert found.why.startswith("No search: the target has no parts around its goal")


def test_a_fast_learner_gets_no_standing_recipe():
    found = design_curriculum(maze(6, learner=cr.QLearning(learning_rate=0.9)))
    assert found.recipe == Recipe()
    assert "no standing recipe for such a target and learner" in found.why


def test_a_standing_recipe_stays_unless_it_is_beaten():
    standing = {"corner": crop(0.5, 30)}
    budget = SearchBudget(BUDGET)
    found = design_recipe(small(), budget, arms={"alike": crop(0.5, 29)}, standing=standing)
    assert found.standing == "corner"
    assert found.recipe == standing["corner"]
    assert "not shown to be more" in found.why
    stored, own = judgement_data(found), found.judgement.saving("corner")
    assert stored["saving"]["estimate"] == rounded(own.estimate)  # of what is recommended
    assert stored["problems_paid"] == found.judgement.problems_paid("corner")[0]
    assert stored["cost"]["recipe"] == rounded(found.judgement.cost("corner"))
    assert stored["cost"]["best in the race"] == rounded(found.judgement.cost())
    assert "corner" not in stored["cost"]
    lost = replace(found, best=Recipe())  # as if scratch had won the race
    assert lost.why.endswith("on new seeds. Scratch won the race.")
    worse = {"bad": crop(0.5, 900)}
    again = design_recipe(small(), SearchBudget(BUDGET), arms={"good": GOOD}, standing=worse)
    assert not again.standing
    assert again.recipe == again.best


@pytest.mark.parametrize(
    ("error", "call", "says"),
    cases({
        CurriculumError: {
            "no problem": (lambda: design_recipe([], SearchBudget(1)), "needs a problem"),
            "small budget": (
                lambda: design_recipe(small(), SearchBudget(150_000)),
                r"a design for these problems needs a budget of [\d,]+ steps at least: got 150,000",
            ),
            "no arm": (
                lambda: race([maze(6)], {}, SearchBudget(1)), "a race needs a recipe that has"
            ),
            "no source": (
                lambda: race(
                    [maze(6)],
                    {"a": Recipe([Stage(Relation("removed", which="ice"), 1)])},
                    SearchBudget(BUDGET),
                ),
                "a recipe that has sources in every problem",
            ),
            "no miniatures": (
                lambda: design_curriculum(
                    Problem(CliffWalking(), steps=500), budget=SearchBudget(BUDGET)
                ),
                "a search needs miniatures",
            ),
            "one problem": (
                lambda: design_recipe(maze(4), SearchBudget(1)),
                "the problems of a design must be a list: got Problem",
            ),
            "a number of steps": (
                lambda: design_recipe(small(), 1e6), "the budget of a design must be a SearchBudget"
            ),
            "arms": (
                lambda: design_recipe(small(), SearchBudget(1), arms={"a": 3}),
                "the arm 'a' of a race must be a Recipe: got 3",
            ),
            "arms in a list": (
                lambda: design_recipe(small(), SearchBudget(1), arms=[GOOD]),
                "the arms of a race must be a dict by name",
            ),
            "nothing to learn": (
                lambda: design_recipe([maze(4, fraction=0)], SearchBudget(BUDGET)),
                "something to learn: in .* the random policy's return is",
            ),
            "no problem of a target": (
                lambda: design_curriculum(MAZE), "the problem of a design must be a Problem"
            ),
            "freq": (lambda: maze(6, eval_freq=0), "eval_freq of a problem must be a whole number"),
            "learner": (lambda: Problem(MAZE, learner="Q"), "learner of a problem must be a Learn"),
            "measure": (lambda: maze(6, measure="length"), "the measure of a problem must be"),
        },
    }),
)  # fmt: skip
def test_what_cannot_be_designed_is_refused(error, call, says):
    check_refusal(error, call, says)


def test_a_hunt_is_designed_by_its_predators():
    arms = {
        f"{p} {scale}": Recipe(
            [Stage(Relation("member", changes={"predators": p}), 100)],
            aggregate="minimum", scale=scale, annealed=True,
        )
        for p in (1,) for scale in (1.0, 2.0)
    }  # fmt: skip
    problem = Problem(
        pursuit_family(size=2, predators=2, discount=0.95), steps=8_000, learner=LEARNER,
        measure="area", fraction=0.95, eval_freq=200,
    )  # fmt: skip
    found = design_recipe([problem], SearchBudget(2_000_000), arms=arms)
    assert dict(found.best.stages[0].relation.changes) == {"predators": 1}
    assert found.judgement.saving().low > 0.3
