"""Forecasts and trials: what is said before the target is trained, and what ``check`` prints."""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import curricle as cr
from curricle.cli import output
from curricle.comparison import trial as trials
from curricle.comparison.comparison import Comparison
from curricle.comparison.cost import SLOWER
from curricle.comparison.forecasting import Forecast, forecast
from curricle.comparison.measures import Reference
from curricle.comparison.plan import Memory
from curricle.comparison.sentences import (
    findings,
    headroom_sentence,
    instead,
    likely,
    steps_and_gain,
)
from curricle.comparison.trial import affordable, apart, hindrance, rows_of, run_trial
from curricle.errors import CurriculumError, SettingError
from curricle.study import read_study
from curricle.tasks.mdp import tables
from curricle.transfer.rollouts import potential_return, target_of
from tests.support.comparisons import MAZE, arm_of, assert_same, copied, corner, pursuit
from tests.support.studies import CORNER
from tests.support.tasks import dense_of

LINE = cr.GridWorld("S.T", discount=0.5, time_limit=50)


def look(plan, *target, **settings):
    """Return a forecast without a trial: what it says of the sources."""
    return cr.forecast(plan, *target, trial=False, **settings)


def words_of(text):
    return " ".join(str(text).split())


def live_plan(near=60):
    lake = cr.from_gymnasium("FrozenLake-v1", discount=0.9, live=True, time_limit=20)
    return copied(lake, budget={"near": near, "far": 60})


# -- rows ------------------------------------------------------------------------------------------


def test_custom_aggregates_have_rows_too():
    def mean(potentials):
        return np.sort(potentials, axis=0)[-1]

    lambdas = [lambda p: p.min(axis=0), lambda p: np.median(p, axis=0)]
    plan = replace(pursuit(), aggregate=lambdas[0], budget=2_000)
    predicted = cr.forecast(
        plan, seeds=1, aggregates=[lambdas[1], mean, cr.maximum], trial=True, opponents=()
    )
    assert sorted(row.name for row in predicted.rows if row.aggregate) == [
        "<lambda> [1]", "<lambda> [2]", "maximum", "mean [1]", "mean [2]", "minimum", "total",
    ]  # fmt: skip
    for name, same in (
        ("<lambda> [1]", "minimum"),
        ("<lambda> [2]", "mean [1]"),
        ("mean [2]", "maximum"),
    ):
        assert predicted[name].gain.estimate == predicted[same].gain.estimate
    least, middle, most = (predicted[name].gain for name in ("minimum", "mean [1]", "maximum"))
    assert least.estimate != middle.estimate != most.estimate
    assert [row.name for row in predicted.rows if row.used] == ["<lambda> [1]"]
    assert {row.name for row in predicted.rows if not row.aggregate} == {
        "chase -> hunt [1]",
        "chase -> hunt [2]",
    }
    lines = str(predicted).split("\n")[-len(predicted.rows) :]
    for row, line in zip(predicted.rows, lines, strict=True):
        name, number = re.split(r"\s{2,}", line.strip())
        assert name == row.name + " *" * row.used
        assert float(number) == pytest.approx(row.gain.estimate, rel=0.01)


def test_the_target_may_be_any_task_with_transfers_into_it(calls):
    maze = cr.GridWorld(["S..", "...", "..T"])
    tasks = {"near": maze.crop(rows=(1, 3), columns=(1, 3)), "left": maze, "far": maze}
    plan = cr.Curriculum(
        tasks=tasks,
        transfers=[
            cr.Transfer("near", "left", cr.same_position(maze, tasks["near"])),
            cr.Transfer("left", "far", cr.transfer.identity(maze)),
        ],
        budget=500,
    )
    predicted = look(plan, "left", seeds=1)
    assert [call["stream"] for call in calls] == ["near"]
    assert predicted.target == "left"
    look(plan, seeds=1, trained=predicted.trained)
    assert [call["stream"] for call in calls] == ["near", "left"]


def test_an_aggregate_may_be_any_object_that_can_be_called():
    class Cautious(list):  # no hash
        def __call__(self, potentials):
            return potentials.min(axis=0) - 1

    predicted = look(replace(pursuit(), aggregate=Cautious()), seeds=1)
    assert any(row.used for row in predicted.rows)


def test_a_row_that_is_not_there_and_no_episodes_are_refused(calls):
    with pytest.raises(SettingError, match="episodes of an evaluation must be"):
        look(copied(LINE, budget=10), seeds=1, episodes=0)
    assert calls == []
    with pytest.raises(CurriculumError, match="must be one of mean: got 'minimum'"):
        look(copied(LINE, budget=10), seeds=1)["minimum"]


# -- what it says ----------------------------------------------------------------------------------


def test_without_a_trial_no_forecast_says_what_learning_gains():
    plan = copied(MAZE, budget={"near": 1, "far": 3000}, eval_freq={"far": 100})
    predicted = look(plan, seeds=1)
    assert "no better than" not in str(predicted)
    assert predicted.answer == "whether it pays is open"
    assert (predicted.best, predicted.start) == (predicted.used, None)


def test_of_a_live_target_it_says_what_the_potential_s_own_policy_returns():
    plan = live_plan(near=cr.StoppingRule(600))
    predicted = cr.forecast(plan, seeds=2, episodes=30)
    potentials = plan.potentials("far", predicted.trained)
    target = target_of(plan.tasks["far"], episodes=30)
    starts = [potential_return(phi, target, seed=k) for k, phi in enumerate(potentials)]
    assert predicted.start.potential == np.mean(starts)
    assert predicted.start.random != predicted.start.potential
    assert (
        words_of(predicted)
        .split(" -> ")[0]
        .endswith(
            f"the potential's own policy returns {predicted.start.potential:.4g} in 'far', from 2 "
            f"seeds of near (600 steps), and the random policy {predicted.start.random:.4g} near"
        )
    )


# -- what check prints -----------------------------------------------------------------------------

STUDY = CORNER.replace("[tasks.maze]", 'seeds = "0-3"\n[tasks.maze]\nbudget = 3_000')
STUDY = STUDY.replace("[tasks.corner]", "[tasks.corner]\nbudget = 2_000")


@pytest.fixture
def check(curricle, tmp_path):
    """A function: what is set -> what `curricle check` prints, and the study."""
    file = tmp_path / "maze.toml"
    file.write_text(STUDY)

    def run(*changes, flags=()):
        code, out, _ = curricle("check", file, *(f"--set={change}" for change in changes), *flags)
        assert code == 0
        return out, read_study(file, set=list(changes))

    return run


def test_check_prints_the_forecast_of_the_sources_as_they_will_be_trained(check):
    out, study = check("tasks.corner.budget.max_steps=10")
    plan = study.curriculum("transfer")
    for seeds in (3, [0, 1, 2]):
        assert str(cr.forecast(plan, seeds=seeds, opponents=study.played)) in out
    begun = r"^training corner for 3 seeds, for the forecast: about \d+ s$"
    assert re.search(begun, out, re.MULTILINE)


@pytest.mark.parametrize(("seeds", "few"), [(5, "(5; 6 or more)"), (6, "")])
def test_check_and_run_warn_of_too_few_seeds(check, curricle, tmp_path, seeds, few):
    out, _ = check(f"seeds={seeds}")
    assert ("too few seeds for a verdict" in out) is bool(few)
    assert few in out.splitlines()[1]
    quick = [f"--set={set}" for set in (f"seeds={seeds}", "budget=9", "tasks.corner.budget=9")]
    quick.append("--set=tasks.maze.budget=9")
    _, _, said = curricle("run", tmp_path / "maze.toml", "--out", tmp_path / "out", *quick)
    warning = [line for line in said.splitlines() if "too few" in line]
    assert warning == ["curricle: too few seeds for a verdict (5; 6 or more)"] * bool(few)


def test_a_budget_that_takes_long_is_trained_only_with_the_flag(check, monkeypatch):
    monkeypatch.setattr("curricle.comparison.cost.random_pace", lambda _: 1.0)
    monkeypatch.setattr(output, "LONGEST_EXAMINING", 0.0)
    out, study = check()
    assert re.search("no forecast: to examine its sources and maze could take ", out)
    monkeypatch.setattr(output, "LONGEST_EXAMINING", np.inf)
    long = r"no forecast: training corner for one seed could take \S+ (min|h); curricle check --for"
    assert re.search(long, " ".join(check()[0].split()))
    out, study = check(flags=["--forecast"])
    plan, opponents = study.curriculum("transfer"), study.played
    assert str(cr.forecast(plan, trial=True, opponents=opponents)) in out


def test_one_seed_where_three_would_be_slow(check, monkeypatch):
    pace = 1.0  # seconds that a seed's 2,000 steps take
    monkeypatch.setattr(output, "LONGEST", 2 * pace)
    monkeypatch.setattr("curricle.comparison.cost.random_pace", lambda _: pace / SLOWER / 2000)
    out, study = check()
    assert "\ntraining corner for 1 seed, for the forecast: about 1 s\n" in out
    assert str(cr.forecast(study, seeds=1)) in out


ALONE = {"opponents": ()}  # against the target's own learner and no other


# -- the trial is the comparison, apart from its random numbers ------------------------------------


def test_a_trial_is_the_comparison_with_its_tasks_renamed():
    plan = corner()
    (used,) = rows_of(plan, "maze")
    comparison = run_trial([used], seeds=6)
    renamed = cr.compare(apart(plan), seeds=6)
    for name, other in (("scratch", "scratch"), ("mean", "transfer")):
        assert_same(comparison[name], renamed[other])
    assert (comparison.total, comparison.threshold) == (renamed.total, renamed.threshold)
    assert (comparison.budget, comparison.window) == (renamed.budget, renamed.window)


def test_a_trial_is_against_the_learners_that_a_comparison_is_against(tmp_path):
    """Of a curriculum as it is said, of a study as its file says."""
    high, plan = {"high": cr.QLearning(initial_value=50.0)}, corner()
    played = cr.forecast(plan, seeds=1, scratch=high, opponents=["optimistic"]).trial
    assert played.scratches == ("scratch", "scratch, high", "scratch, OptimisticQLearning")
    said = 'opponents = ["constant"]\nscratch_learners.high.initial_value = 50.0'
    text = CORNER.replace("opponents = []", said)
    (tmp_path / "study.toml").write_text(f"budget = 1_000\n{text}")
    trial = cr.forecast(tmp_path / "study.toml", trial=True).trial
    assert trial.scratches[:2] == ("scratch", "scratch, high")
    assert all(name.startswith("mean, constant") for name in trial.scratches[2:])
    assert len(trial.scratches) == 5


def test_no_seed_of_a_trial_draws_what_a_seed_of_the_experiment_draws(calls):
    plan = corner()
    cr.forecast(plan, seeds=3, **ALONE)
    streams = [call["stream"] for call in calls]
    assert streams == ["corner", "maze/trial", "corner/trial", "maze/trial"]
    experiment, trial = (
        cr.learn(MAZE, budget=1000, seeds=20, stream=stream).training_return[:, 1:]
        for stream in ("maze", "maze/trial")
    )
    assert not (experiment[:, None] == trial[None]).all(axis=2).any()


def test_each_candidate_pays_for_its_own_sources_only():
    tasks = {"left": MAZE, "right": MAZE, "far": MAZE, "first": MAZE}
    edges = [
        cr.Transfer(source, target, cr.transfer.identity(MAZE))
        for source, target in (("first", "left"), ("left", "far"), ("right", "far"))
    ]
    steps = {"first": 100, "left": 200, "right": 400}
    exact = {name: cr.StoppingRule(most) for name, most in steps.items()}
    plan = cr.Curriculum(
        tasks, edges, budget=exact | {"far": 2000},
        eval_freq={"far": 100},
    )  # fmt: skip
    comparison = cr.forecast(plan, seeds=1, **ALONE).trial
    spent = {name: arm.curve.source_steps[0] for name, arm in comparison.arms.items()}
    assert spent == {
        "scratch": 0, "minimum": 700, "mean": 700, "maximum": 700, "total": 700,
        "left -> far": 300, "right -> far": 400,
    }  # fmt: skip
    assert comparison.total == 2700


# -- what it says ----------------------------------------------------------------------------------


def rooms():
    """Return a curriculum from the room with the treasure to two rooms."""
    two = cr.GridWorld(
        ["....#....", "....#....", ".........", "....#....", "S...#...T"], time_limit=100
    )
    room = two.crop(rows=(0, 5), columns=(4, 9))
    return cr.Curriculum(
        {"room": room, "far": two},
        [cr.Transfer("room", "far", cr.same_position(two, room))],
        budget={"room": cr.StoppingRule(1000), "far": 20_000},
    )


def test_a_source_that_pays_is_said_to_pay_and_by_how_much():
    foreseen = cr.forecast(rooms(), seeds=2, **ALONE)
    assert (foreseen.answer, foreseen.used.gain.low > 0) == ("likely pays", True)
    gain = foreseen.trial.contrasts["mean"].strong_gain
    assert foreseen.used.gain is gain
    numbers = steps_and_gain(foreseen.trial, "mean")
    pattern = (
        r"expected steps to the threshold 146: .+ with sources \(their 1,000 steps included\), "
        r".+ from scratch; share of steps saved .+; gain in mean return .+"
    )
    assert re.fullmatch(pattern, numbers)
    assert "assumes" in foreseen.basis
    leaves = f"leaves {foreseen.headroom:.3f} of the way from random play to the optimum"
    assert re.match(
        "Forecast for 'far': the best learner without a source, the target's own learner, "
        rf"{leaves} in this budget \(.+ in mean return\): no source can gain more likely pays "
        f"{re.escape(numbers)}; a trial in",
        words_of(foreseen),
    )


def test_gains_order_rows_and_the_best_is_named_if_it_is_not_used():
    plan = replace(pursuit(), aggregate=cr.maximum)
    foreseen = cr.forecast(plan, seeds=1, trial=True)
    for kind in (True, False):
        gains = [row.gain.estimate for row in foreseen.rows if row.aggregate == kind]
        assert gains == sorted(gains, reverse=True)
    assert foreseen.best.gain.estimate == max(row.gain.estimate for row in foreseen.rows)
    assert foreseen.best.name != "maximum"
    assert [row.name for row in foreseen.rows if row.used] == ["maximum"]
    lines = [line for line in str(foreseen).split("\n") if line.startswith("maximum *")]
    assert float(lines[0].split()[2]) == pytest.approx(foreseen["maximum"].gain.estimate, rel=0.01)


def test_seeds_that_never_reach_the_threshold_are_counted():
    """Hand-made: from scratch at 200 steps, 400 and never in 500; with 100 source steps at 200."""
    fast, slow, nobody = [0, 9, 9, 9, 9, 9], [0, 0, 9, 9, 9, 9], arm_of([[0] * 6] * 3, 0, 100)
    scratch = arm_of([slow, [0, 0, 0, 0, 9, 9], [0] * 6], 0, 100)
    taught, late = arm_of([fast] * 3, 100, 100), arm_of([slow] * 3, 100, 100)

    def against(scratch, taught):
        arms = {"scratch": scratch, "a": taught}
        return Comparison("t", arms, 400, 500, Reference(9.0), 1)

    trial = against(scratch, taught)
    assert steps_and_gain(trial, "a") == (
        "expected steps to the threshold 9: 200 with sources (their 100 steps included), at least "
        "367 [0, inf] (1 of 3 seeds never) from scratch; share of steps saved at least 0.45 "
        "[-0.54, 1.00]; gain in mean return 3.3 [-4.6, 11.2]"
    )
    assert likely(trial.contrasts["a"].strong_gain) == "whether it pays is open"
    swapped = against(arm_of([fast] * 3, 0, 100), late)
    assert "; share of steps saved -2.00; " in steps_and_gain(swapped, "a")
    never = ", never within 500 steps from scratch; share of steps saved at least 0.400; "
    assert never in steps_and_gain(against(nobody, late), "a")


def test_a_candidate_that_fails_is_said_to_fail_and_the_others_stand():
    def broken(potentials):
        raise RuntimeError("no idea")

    plan = copied(MAZE, budget={"near": 50, "far": 200})
    tried = rows_of(plan, "far", [broken])
    trial = run_trial(tried, seeds=8)
    assert trial.contrasts.keys() == {row.name for row in tried} - {"broken"}
    gains = {name: contrast.strong_gain for name, contrast in trial.contrasts.items()}
    rows = tuple(replace(row, gain=gains.get(row.name)) for row in tried)
    foreseen = Forecast("far", {}, rows, {}, trial=trial)
    assert 0 < foreseen.headroom < 1
    failed = replace(foreseen, rows=tuple(replace(r, used=r.name == "broken") for r in rows))
    assert np.isnan(failed.headroom)
    place = "raised in broken of test_forecast.py, line "
    assert failed.basis.startswith(f"RuntimeError: no idea ({place}")
    assert str(failed).startswith(
        "Forecast for 'far': it failed in the trial\nRuntimeError: no idea"
    )


# -- the headroom: the most that a source can gain -------------------------------------------------


def slow_return(task, over_actions):
    """Return what an optimal (np.max) or the random policy (np.mean) returns, by backups alone."""
    (p, r), values = dense_of(tables(task)), np.zeros(task.states.size)
    for _ in range(task.time_limit):
        values = over_actions(r + task.discount * p @ values, axis=1)
    return tables(task).start @ values


def test_a_forecast_begins_with_what_the_best_learner_without_a_source_leaves():
    foreseen = cr.forecast(corner(), seeds=1)
    arms, heights = foreseen.trial.arms, {}
    for name in set(arms) - {"mean"}:
        curves = arms[name].curve.values
        areas = [sum((a + b) / 2 for a, b in pairwise(c)) / (len(c) - 1) for c in curves.tolist()]
        heights[name] = sum(areas) / len(areas)
    best, random = slow_return(MAZE, np.max), slow_return(MAZE, np.mean)
    missing = best - max(heights.values())
    assert max(heights, key=heights.get) == "scratch, OptimisticQLearning"
    assert foreseen.headroom == pytest.approx(missing / (best - random), rel=1e-9)
    assert words_of(foreseen).startswith(
        "Forecast for 'maze': the best learner without a source, OptimisticQLearning, leaves "
        f"{missing / (best - random):.3f} of the way from random play to the optimum in this "
        f"budget ({missing:.1f} in mean return): no source can gain more likely costs more than it "
        "brings: use OptimisticQLearning without a source (in a study file: learner = { "
        'type = "OptimisticQLearning" }, no sources) expected steps to the threshold'
    )


def test_of_an_optimum_that_may_be_exceeded_no_bound_is_claimed():
    arms = {"scratch": arm_of([[0, 1]] * 2), "a": arm_of([[0, 2]] * 2)}
    reference = Reference(1.0, random_return=0.0, optimum=2.0)
    comparison = Comparison("t", arms, 10, 10, reference, 1)
    sentence = headroom_sentence(comparison, "a")
    assert sentence.endswith("optimum in this budget (1.5 in mean return)")
    assert comparison.headroom("a") == 0.75
    bounded = replace(comparison, reference=replace(reference, optimum_bounds=True))
    assert headroom_sentence(bounded, "a") == f"{sentence}: no source can gain more"
    for evaluation, bounds in (({}, True), ({"discounted": False}, False)):
        target = target_of(LINE, cr.GreedyEvaluation(**evaluation))
        assert Reference.of(target).optimum_bounds is bounds
        assert Reference.of(target, stated=0.0).optimum_bounds is bounds
    for unknown in (
        {"optimum": None},
        {"optimum": -1.0},
        {"random_return": None},
        {"optimum": 0.0},
    ):
        nothing = replace(comparison, reference=replace(reference, **unknown))
        assert np.isnan(nothing.headroom("a"))
        assert headroom_sentence(nothing, "a") == ""
    above = replace(comparison, reference=replace(reference, optimum=0.25))
    assert above.headroom("a") == 0.0  # by the noise of rollouts


@pytest.mark.parametrize(
    ("name", "settings", "learner", "written"),
    [
        ("scratch", {}, "the target's own learner", ""),
        (
            "scratch, initial_value=-100", {}, "the target's own learner with initial_value=-100",
            "learner.initial_value = -100, ",
        ),
        (
            "a, constant mean", {"curriculum": "a", "initial_values": np.array([2.0, 4.0] * 4)},
            "the target's own learner with initial_value=3", "learner.initial_value = 3, ",
        ),
        (
            "scratch, OptimisticQLearning", {}, "OptimisticQLearning",
            'learner = { type = "OptimisticQLearning" }, ',
        ),
        ("scratch, mine", {}, "mine", ""),
    ],
)  # fmt: skip
def test_what_to_use_instead_is_named_where_a_curriculum_costs_more(
    name, settings, learner, written
):
    low, high = ([[height + 0.01 * k, height] for k in range(8)] for height in (0, 2))
    arms = {"scratch": arm_of(low), name: arm_of(high, scratch=True, **settings), "a": arm_of(low)}
    reference = Reference(1.0, random_return=-1.0, optimum=3.0)
    comparison = Comparison("t", arms, 10, 10, reference, 1)
    advice = f"use {learner} without a source (in a study file: {written}no sources)"
    assert instead(comparison, "a") == advice
    headroom = headroom_sentence(comparison, "a")
    assert headroom.startswith(f"the best learner without a source, {learner}, leaves 0.246 of")
    assert {headroom, f"instead of a, {advice}"} <= {*str(comparison).splitlines()}
    (finding,) = findings(comparison)
    assert {f"{line[0].upper()}{line[1:]}." for line in (headroom, advice)} <= {*finding.sentences}
    better = replace(comparison, arms=arms | {"a": arm_of([[5, 5.0 + k] for k in range(8)])})
    assert "without a source (in a study file" not in f"{better} {findings(better)}"


# -- where there is none ---------------------------------------------------------------------------


def test_a_live_task_has_no_trial_and_its_words_are_weak():
    plan = live_plan()
    assert hindrance(plan).startswith("'near' is live and has no model")
    foreseen = cr.forecast(plan, seeds=1)
    assert foreseen.trial is None
    assert foreseen.answer == "whether it pays is open"
    assert "pays," not in str(foreseen)
    assert foreseen.basis == (
        "no trial: 'near' is live and has no model (tabulate makes it if states are few); "
        "cr.choose(..., on=) plays on a smaller relative"
    )
    assert foreseen.used.gain is None
    assert np.isnan(foreseen.headroom)
    assert "learner without a source" not in words_of(foreseen)


OFF = cr.GreedyEvaluation(method="off")
EPISODES = copied(LINE, budget={"near": 50, "far": cr.Episodes(9)})
EDGE = cr.Transfer("near", "far", cr.transfer.identity(LINE))
THREE = cr.Curriculum({"near": LINE, "far": LINE, "other": LINE}, [EDGE], budget=10)


@pytest.mark.parametrize(
    ("plan", "settings", "message"),
    [
        (THREE, {"target": "moon"}, "a task must be one of near, far, other: got 'moon'"),
        (THREE, {"target": "near"}, "a forecast needs a task with a potential: 'near' has neither"),
        (THREE, {"target": "far", "aggregates": [3]}, r"must be a function \(N, S, A\).*: got 3"),
        (EPISODES, {"trial": True}, "models and a budget in steps: the budget of 'far' is 9 epis"),
        (copied(LINE, evaluation=OFF), {"trial": True}, "greedy evaluation of 'far' is off"),
        (live_plan(), {"trial": True}, "a trial needs models and a budget in steps: 'near' is l"),
        (corner(), {"trial": 3}, "trial must be True, False or None"),
    ],
)
def test_what_makes_no_sense_is_refused(plan, settings, message, calls):
    with pytest.raises(CurriculumError, match=message):
        cr.forecast(plan, **({"trial": False} | settings))
    assert calls == []


def test_a_long_trial_is_made_of_the_used_candidate_alone_or_only_if_it_is_asked_for(monkeypatch):
    plan = pursuit()
    tried = rows_of(plan, "hunt")
    assert affordable(rows_of(corner(), "maze"))[1] == trials.SEEDS
    alone = trials.trial_seconds([candidate for candidate in tried if candidate.used])
    monkeypatch.setattr(trials, "QUICK", 1.5 * trials.FEWEST * alone)
    some, seeds = affordable(tried)
    assert [candidate.name for candidate in some] == ["minimum"]
    assert cr.forecast(plan, seeds=1).rows[0].name == "minimum"  # the others have no gain
    assert seeds == int(1.5 * trials.FEWEST)
    plan = corner(target=1000)
    monkeypatch.setattr(trials, "QUICK", 0.0)
    assert affordable(tried) == ([], 0)
    said = "no trial: it would take long; trial=True or curricle check --forecast makes it"
    assert cr.forecast(plan, seeds=1).basis == said
    assert cr.forecast(plan, seeds=1, trial=True).trial.seeds == trials.SEEDS


def test_the_best_is_among_the_rows_that_were_tried_and_failures_are_named():
    foreseen = cr.forecast(pursuit(), seeds=1, trial=True)
    untried = replace(foreseen.best, name="untried", gain=None, used=False)
    assert replace(foreseen, rows=(untried, *foreseen.rows)).best is foreseen.best
    failed = {"scratch, fast": SettingError("a rule: a value")}
    played = replace(foreseen.trial, failed=failed)
    said = replace(foreseen, trial=played)
    assert "scratch, fast failed: a rule: a value" in str(said).splitlines()


def test_trials_share_what_is_learnt_without_sources(calls):
    memory, arms = Memory(), [corner(target=300), corner(target=300, aggregate=cr.maximum)]
    how = {"seeds": 1, **ALONE}
    first, second = (forecast(arm, memory=memory, **how).trial for arm in arms)
    streams = [call["stream"] for call in calls]
    assert [streams.count(name) for name in ("maze/trial", "corner/trial")] == [3, 1]
    assert_same(first.arms["scratch"], second.arms["scratch"])
    assert_same(second.arms["maximum"], cr.forecast(arms[1], **how).trial["maximum"])


def test_an_unasked_trial_that_fails_leaves_the_rest(monkeypatch):
    def fails(*_, **__):
        raise SettingError("a rule: a value")

    monkeypatch.setattr("curricle.comparison.trial.comparison_plan", fails)
    foreseen = cr.forecast(corner(target=300), seeds=1)
    assert foreseen.basis == "no trial: it failed: a rule: a value"
    with pytest.raises(SettingError, match="a rule: a value"):
        cr.forecast(corner(target=300), seeds=1, trial=True)
