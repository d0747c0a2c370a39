"""Sources whose budget is not stated end when they have learnt; a stated number is a cap."""

from dataclasses import replace

import numpy as np
import pytest

import curricle as cr
from curricle.comparison.sentences import unlearnt
from curricle.errors import ConfigError
from curricle.learning import OptimisticQLearning
from curricle.learning.stopping import (
    AGREED,
    SETTLED,
    UNLEARNT,
    share_of_rise,
    stopping_kernel,
)
from curricle.planning.greedy import VisitedValues
from curricle.planning.policy_evaluation import greedy_policy_return
from curricle.planning.target import Target
from tests.support.studies import CORNER as STUDY
from tests.support.tasks import ring

MAZE = cr.GridWorld(["....T", ".PPP.", "S...."])
CORNER = MAZE.crop(rows=(0, 2), columns=(2, 5))
EDGE = cr.Transfer("corner", "maze", cr.same_position(MAZE, CORNER))
TASKS = {"corner": CORNER, "maze": MAZE}
LARGER = cr.GridWorld([".....", "....T", ".PPP.", "S...."])
TO_LARGER = cr.Transfer("maze", "larger", cr.same_position(LARGER, MAZE))
OF_THREE = {**TASKS, "larger": LARGER}, [EDGE, TO_LARGER]
EVALUATION = cr.GreedyEvaluation(method="rollouts", episodes=1_000)


BY_Q_LEARNING = cr.QLearning()


def plan(learner=BY_Q_LEARNING, **settings):
    return cr.Curriculum(TASKS, [EDGE], learner=learner, **settings)


def test_the_rise_by_hand_and_what_is_no_evidence_of_one():
    greedy = np.array([0.0] * 20 + [1.0] * 81)
    assert share_of_rise(greedy, 100) == 0.0
    # While it rises, the last three tenths lie above those before.
    assert share_of_rise(np.arange(101.0), 100) > 0.2
    greedy = np.zeros(101)
    greedy[71:] = 4.0  # the last 30 of 100
    greedy[49:71] = 1.0  # and those before them
    assert share_of_rise(greedy, 100) == (4.0 - 1.0) / 4.0
    for flat in (np.zeros(101), np.full(101, np.nan)):
        assert np.isnan(share_of_rise(flat, 100))
    greedy = np.array([0.0] * 5 + [1.0] * 95)
    known = [not np.isnan(share_of_rise(greedy, n)) for n in range(100)]
    assert not any(known[:35])
    assert all(known[45:])


def test_the_condition_that_holds_first_ends_learning():
    greedy, steps = np.array([0.0] * 20 + [1.0] * 81), np.arange(101) * 10
    settled = cr.StoppingRule(1_000, settled=0.05).decisions(steps, greedy)
    assert settled[-1].criterion == "settled return reached"
    assert settled[-1].step < 1_000
    higher = cr.StoppingRule(1_000, settled=0.05, threshold=2.0)
    assert higher.decisions(steps, greedy)[-1].criterion == "settled return reached"
    either = cr.StoppingRule(1_000, settled=0.05, threshold=1.0)
    assert either.decisions(steps, greedy)[-1].criterion == "threshold reached"


def test_a_return_that_fell_to_the_floor_has_not_settled():
    # It begins at 5, which is random, falls to 0 and stays there; or it rises to 8.
    fallen, risen = np.array([5.0] + [0.0] * 100), np.array([5.0] * 20 + [8.0] * 81)
    steps, rule = np.arange(101) * 10, cr.StoppingRule(1_000, settled=0.05)
    assert rule.decisions(steps, fallen)[-1].step < 1_000  # nobody knows where the floor is
    last = rule.decisions(steps, fallen, floor=6.0)[-1]
    assert (last.step, last.criterion) == (1_000, UNLEARNT)
    assert "greedy 0 <= 6, too low to have settled" in str(last)
    known, unknown = (rule.decisions(steps, risen, floor=f)[-1] for f in (6.0, -np.inf))
    assert known.step == unknown.step < 1_000


def test_without_a_model_it_has_to_exceed_random_play_by_more_than_its_noise():
    walk = ring(9)
    floor = Target.of(walk, episodes=1_000).floor
    randoms = [
        greedy_policy_return(walk, VisitedValues.none(2), EVALUATION, seed=k).value
        for k in range(20)
    ]
    assert Target.of(walk).solution is None
    # 20 means of 1,000 episodes: the floor lies within their range of 4 standard errors.
    assert np.mean(randoms) < floor < np.mean(randoms) + 4 * np.std(randoms)
    settled = cr.StoppingRule(100, settled=0.05)
    assert stopping_kernel(settled, walk, cr.GreedyEvaluation())[0] == settled.kernel(None, floor)
    off = cr.GreedyEvaluation(method="off")
    assert stopping_kernel(settled, walk, off) == (settled.kernel(), 0)


def test_the_verdict_names_sources_that_did_not_learn(read, tmp_path):
    short = "tasks.corner.budget={ max_steps = 4, settled = 0.05 }"
    by_q_learning = "tasks.corner.learner={ type = 'QLearning' }"
    study = read(
        STUDY,
        set=["seeds=2", "tasks.maze.budget=500", "tasks.maze.eval_freq=5", short, by_q_learning],
    )
    comparison = cr.run_study(study, tmp_path / "out", progress=False).comparison
    again = cr.compare({"transfer": study.curriculum("transfer")}, seeds=2)
    for compared in (comparison, again):
        assert (
            unlearnt(compared, "transfer")
            == "sources of transfer that did NOT learn: corner in 2 of 2 seeds"
        )
        assert unlearnt(compared, "transfer") in str(compared)
        (row,) = (row for row in compared.rows() if row["arm"] == "transfer")
        assert row["unlearnt"] == unlearnt(compared, "transfer")
    # A source that a threshold ended has learnt, after a step, with a return too low by itself.
    ended = "{ max_steps = 4_000, threshold = -1e5, patience = 1, settled = 0.05 }"
    early = [f"tasks.corner.budget={ended}", "tasks.corner.eval_freq=1", "tasks.maze.budget=5_000"]
    study = read(STUDY, set=["seeds=2", by_q_learning, *early])
    stored = cr.run_study(study, tmp_path / "early", progress=False).comparison
    again = cr.compare({"transfer": study.curriculum("transfer")}, seeds=2)
    learnt = cr.compare(plan(budget={"maze": 20_000}), seeds=2)
    assert unlearnt(stored, "transfer") == unlearnt(again, "transfer") == ""
    assert unlearnt(learnt, "transfer") == ""


def test_nothing_set_a_source_ends_when_it_has_learnt():
    curriculum = plan()
    assert curriculum.node("corner").budget == cr.StoppingRule(10_000, settled=SETTLED)
    assert curriculum.node("maze").budget == 100_000
    result = curriculum.train(seeds=3, only="corner")
    used = result["corner"].steps_used
    assert (used < 5_000).all()
    assert {rows[-1].criterion for rows in result.decisions("corner")} == {"settled return reached"}


OPTIMISTIC = cr.StoppingRule(500, settled=SETTLED, agreed=AGREED)


def test_nothing_set_a_source_is_learnt_by_an_optimistic_learner_in_few_steps():
    curriculum = plan(learner=None)
    assert curriculum.node("corner").learner == OptimisticQLearning()
    assert curriculum.node("corner").budget == OPTIMISTIC  # more than 10 for each of 20 pairs
    assert curriculum.node("maze").learner == cr.QLearning()
    result = curriculum.train(seeds=3, only="corner")
    assert (result["corner"].steps_used < 300).all()
    assert {rows[-1].criterion for rows in result.decisions("corner")} == {"agreement reached"}
    assert not result.unlearnt("maze")["corner"].any()
    of_900 = plan(learner=None, budget={"maze": 900}).node("corner").budget
    assert of_900.max_steps == 27  # .03 of the target's
    stated = plan(learner=None, budget={"corner": 20_000})
    assert stated.node("corner").budget == replace(OPTIMISTIC, max_steps=20_000)
    large = cr.GridWorld(["." * 9] * 8 + ["S" + "." * 7 + "T"])
    whole = cr.Transfer("large", "maze", cr.same_position(MAZE, large))
    ten = cr.Curriculum({"large": large, "maze": MAZE}, [whole], budget={"maze": 200_000})
    assert ten.node("large").budget == replace(OPTIMISTIC, max_steps=10 * 4 * 80)


def test_a_learner_that_is_stated_or_is_all_that_a_task_allows_is_kept():
    for learner in (cr.QLearning(), {"corner": cr.QLearning()}):
        assert plan(learner=learner).node("corner").learner == cr.QLearning()
        assert plan(learner=learner).node("corner").budget == rule(10_000)
    of_target = plan(learner={"maze": cr.SARSA()})
    assert of_target.node("corner").learner == OptimisticQLearning()
    chain = cr.Curriculum(*OF_THREE)  # the maze has a portfolio
    assert chain.node("maze").learner == cr.QLearning()
    assert chain.node("maze").budget == rule(5_000)
    walk = ring(9)  # has no tables; the other neither a discount below 1 nor a time limit
    for task in (walk, ENDS_BY_CHANCE):
        edge = cr.Transfer("one", "other", cr.transfer.identity(task))
        assert cr.Curriculum({"one": task, "other": task}, [edge]).node("one").learner == (
            cr.QLearning()
        )
    sparse = plan(learner=None, storage={"corner": cr.Storage(kind="sparse")})
    assert sparse.node("corner").learner == cr.QLearning()


def test_an_agreement_ends_a_run_and_is_said():
    steps, greedy = np.arange(11) * 10, np.array([0.0] + [8.0] * 10)
    agreement = np.array([0.0, 0.2, 0.95, 0.5, *[0.92] * 7])
    agreeing = cr.StoppingRule(100, agreed=0.9, patience=3)
    assert str(agreeing) == (
        "100 steps, until an agreement of optimistic and learnt values of 0.9 over 3 evaluations"
    )
    last = agreeing.decisions(steps, greedy, agreement=agreement, floor=6.0)[-1]
    assert str(last) == (
        "ends; agreement 0.92 >= 0.9 over 3 evaluations; 60 of at most 100 steps used"
    )
    assert last.criterion == "agreement reached"
    low = agreeing.decisions(steps, greedy, agreement=agreement, floor=9.0)[-1]
    assert (low.step, low.criterion) == (100, UNLEARNT)
    unknown = agreeing.decisions(steps, greedy)[-1]  # of another learner
    assert (unknown.step, unknown.criterion) == (100, "all steps used")
    assert "too few evaluations for an agreement" in str(unknown)
    either = cr.StoppingRule(100, agreed=0.9, threshold=8.0, patience=3)
    assert either.decisions(steps, greedy, agreement=agreement)[-1].criterion == "threshold reached"


def rule(most):
    return cr.StoppingRule(most, settled=SETTLED)


def test_sources_without_a_budget_share_a_tenth_of_the_targets():
    by_q = {"learner": cr.QLearning()}
    for budget in (4_000, cr.StoppingRule(4_000, threshold=1.0), cr.Episodes(20)):
        steps = 20 * LARGER.time_limit if isinstance(budget, cr.Episodes) else 4_000
        both = cr.Curriculum(*OF_THREE, budget={"larger": budget}, **by_q)
        assert both.setting("budget", "corner") == rule(steps // 20)
    chain = cr.Curriculum(*OF_THREE, budget={"corner": None}, **by_q)
    budgets = [chain.setting("budget", name) for name in ("corner", "maze", "larger")]
    assert budgets == [rule(5_000), rule(5_000), 100_000]  # a target has none unless it is a source
    for budget in (cr.Episodes(20), cr.StoppingRule(900, threshold=150.0)):
        assert plan(budget=budget).node("corner").budget == budget
    off = {"corner": cr.GreedyEvaluation(method="off")}  # what is not evaluated takes its cap
    result = plan(budget=rule(3_000), evaluation=off).train(seeds=1, only="corner")
    assert result["corner"].steps_used.tolist() == [3_000]
    stated = {"larger": 4_000, "maze": 900}
    wide = cr.Curriculum(*OF_THREE, budget=stated, **by_q)
    assert wide.setting("budget", "corner") == rule(400)
    # Of two targets the larger counts, and longer training of the target changes no source.
    two = cr.Curriculum(
        {**TASKS, "other": MAZE},
        [EDGE, cr.Transfer("corner", "other", EDGE.mapping)],
        budget={"maze": 5_000, "other": 9_000},
        **by_q,
    )
    assert two.setting("budget", "corner") == rule(900)
    longer = plan(budget={"maze": 4_000}).replace("maze", budget=9_000)
    assert longer.setting("budget", "corner") == rule(400)


def test_the_steps_that_it_took_are_charged():
    result = plan(budget={"maze": 30_000}).train(seeds=2, charge=True)
    spent = result["corner"].steps_used
    assert (spent < 20_000).all()
    assert (result.source_steps("maze") == spent).all()
    assert (result["maze"].steps_used == 30_000 - spent).all()


def test_a_number_that_is_stated_is_a_cap():
    stated = plan(budget={"corner": 20_000, "maze": 500})
    assert stated.node("corner").budget == rule(20_000)
    assert stated.node("maze").budget == 500
    ended = stated.train(seeds=2)["corner"]
    assert (ended.steps_used < 20_000).all()
    exactly = plan(budget={"corner": cr.StoppingRule(20_000), "maze": 500}).train(seeds=2)
    assert exactly["corner"].steps_used.tolist() == [20_000, 20_000]
    # What a source learns is the beginning of what it would have, bit for bit.
    short = cr.StoppingRule(int(ended.steps_used[0]))
    again = plan(budget={"corner": short, "maze": 500}).train(seeds=1)["corner"]
    assert np.array_equal(ended.values[0], again.values[0])


def test_a_study_file_has_the_rule_and_the_defaults_of_a_curriculum(read):
    stated = "[tasks.corner]\nbudget = { max_steps = 4_000, settled = 0.05 }"
    text, changes = STUDY.replace("[tasks.corner]", stated), ["tasks.corner.budget.max_steps=70"]
    for steps, study in ((4_000, read(text)), (70, read(text, set=changes))):
        assert study.curriculum("transfer").node("corner").budget == rule(steps)
    arm, by_hand = read(STUDY).curriculum("transfer"), plan(learner=None)
    for name in ("corner", "maze"):
        assert arm.setting("budget", name) == by_hand.setting("budget", name)
        assert arm.setting("learner", name) == by_hand.setting("learner", name)
    stated = read(STUDY, set=["learner.learning_rate=0.1"]).curriculum("transfer")
    assert [stated.setting("budget", name) for name in TASKS] == [rule(10_000), 100_000]
    assert arm.node("corner").eval_freq == by_hand.node("corner").eval_freq
    with pytest.raises(ConfigError, match=r"maze\.eval_freq.*must not exceed the budget of 100000"):
        read(STUDY, set=["tasks.maze.eval_freq=100_001"]).curriculum("transfer")


def late_reward(limit):
    """Return a task that pays 1 at once, or 100 after ten steps."""
    steps = [[[(1.0, s + 1, 100.0 * (s == 9))], [(1.0, 11, 1.0 * (s == 0))]] for s in range(10)]
    ends = [False] * 10 + [True] * 2
    return cr.FiniteMDP.from_outcomes(
        [*steps, [[], []], [[], []]], terminal=ends, start=0, discount=0.99, time_limit=limit
    )


OF_FIRE = cr.Rewards(step=-1, treasure=0, fire=-50, near_fire=0)
FIRE = cr.GridWorld("SFT", rewards=OF_FIRE, discount=0.99, time_limit=20)
CHANCES = [[(p, 0, -1.0), (1 - p, 1, -1.0)] for p in (0.5, 0.6)]
ENDS_BY_CHANCE = cr.FiniteMDP.from_outcomes(
    [CHANCES, [[], []]], terminal=[False, True], start=0, discount=1.0
)


@pytest.mark.parametrize(
    ("task", "optimum"),
    [
        (late_reward(5), 1.0),
        (late_reward(20), 100 * 0.99**9),
        (cr.tasks.FourRooms(size=9, discount=1.0, time_limit=100), 1.0),  # all actions tie
        (FIRE, -(1 - 0.99**20) / 0.01),  # waits until the time is over
        (ENDS_BY_CHANCE, -2.0),  # no limit, no discount: few outcomes are evaluated exactly
    ],
)
def test_the_optimum_is_that_of_the_steps_there_are(task, optimum):
    assert Target.of(task).optimum == pytest.approx(optimum, rel=1e-6)


def test_a_tie_within_the_error_bound_is_not_played_at_random():
    # A line with a trap whose values are so large that their error bound hides the line's.
    n, cost = 100, 1e6
    back = [[(0.9, max(s - 1, 0), 0.0), (0.1, s, 0.0)] for s in range(n)]
    back[0] = [(0.9, 0, 0.0), (0.1, n + 1, 0.0)]
    on = [[(0.9, s + 1, float(s == n - 1)), (0.1, s, 0.0)] for s in range(n)]
    outcomes = [*map(list, zip(back, on, strict=True)), [[], []], [[(1.0, n + 1, -cost)]] * 2]
    ends = np.arange(n + 2) == n
    task = cr.FiniteMDP.from_outcomes(
        outcomes, terminal=ends, start=0, discount=0.99, time_limit=2000
    )
    target = Target.of(task)
    assert target.solution.optimal[:n].all(axis=1).any()
    assert target.optimum == pytest.approx(target.solution.start_value, abs=0.01)
    assert target.optimum > 0.3


def test_a_source_whose_last_steps_reach_no_checkpoint_has_not_learnt_either():
    hall = cr.GridWorld(["S" + "." * 60 + "T"], time_limit=100)
    edge = cr.Transfer("far", "target", cr.transfer.identity(hall))
    budget = {"target": 50_070}  # a tenth is no multiple of its hundredth
    tasks = {"far": hall, "target": hall}
    result = cr.Curriculum(tasks, [edge], budget=budget, learner=cr.QLearning()).train()
    last = result.decisions("far")[0][-1]
    assert last.step < result["far"].steps_used[0] == last.rule.max_steps
    assert last.criterion == UNLEARNT
    assert result.unlearnt("target")["far"].all()
