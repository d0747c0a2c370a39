"""Forecasts: rows and verdicts before the target is trained, and what they were computed from."""

import re
import sys
from dataclasses import replace

import numpy as np
import pytest

import curricle as cr
from curricle.cli import output
from curricle.cli.app import main
from curricle.learning.run import Run
from curricle.planning import policy_evaluation as target_module
from curricle.study import read_study
from curricle.study.cost import SLOWER
from curricle.transfer.rollouts import potential_quality
from tests.comparisons import MAZE, copied, corner
from tests.studies import CORNER
from tests.tasks import predator_edges

SUMMED = cr.GreedyEvaluation(discounted=False)


def pursuit(size, aggregate, **settings):
    """Return the curriculum of one predator for two, and its tasks' names."""
    rules = {"discount": 0.95, "time_limit": 100}
    hunt, chase = cr.Pursuit(size, 2, **rules), cr.Pursuit(size, 1, **rules)
    edges = predator_edges(hunt, chase)
    tasks = {"chase": chase, "hunt": hunt}
    return cr.Curriculum(tasks=tasks, transfers=edges, aggregate=aggregate, **settings)


def look(plan, *target, **settings):
    """Return a forecast without a trial: what it says of the potentials."""
    return cr.forecast(plan, *target, trial=False, **settings)


def trained(calls):
    """Return the names of the tasks that were trained, in order."""
    return [call["stream"] for call in calls]


# -- pursuit ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("seeds", [1, [7, 8]])
def test_pursuit_is_ranked_as_training_ranks_it(seeds, calls):
    """In training, minimum and mean start best, and mean falls from -10 to -17 an episode."""
    foreseen = look(pursuit(5, cr.minimum, budget=400_000), seeds=seeds)
    assert trained(calls) == ["chase"]
    assert [name for name in foreseen.ranking if name != "total"] == ["minimum", "mean", "maximum"]
    assert (foreseen.solved, foreseen.exact) == (True, True)
    least, middle, most, twice = (
        foreseen[name] for name in ("minimum", "mean", "maximum", "total")
    )
    assert least.mean("start") > middle.mean("start") > most.mean("start")
    assert foreseen.random_return < middle.mean("start") < least.mean("start") < foreseen.optimum
    assert re.search(
        r"% optimistic: expect no fall from there; calibrate with c = 1\.[45]$", least.verdict
    )
    assert re.search(
        r", 99% optimistic: expect a fall from there under epsilon-greedy; "
        r"calibrate with c = 1\.[6-9]$",
        middle.verdict,
    )
    assert "near or below the random policy" in most.verdict
    assert most.verdict.endswith(": the gain from there is unknown")
    assert "expect" not in most.verdict
    # Twice the mean: the same policy, hence the same start, and no longer optimistic.
    assert twice.mean("start") == middle.mean("start")
    assert twice.mean("optimistic") < 0.1
    assert twice.verdict.endswith("% optimistic: expect no fall from there")
    assert {row.name for row in foreseen.rows if not row.aggregate} == {
        "chase -> hunt [1]",
        "chase -> hunt [2]",
    }
    assert [row.used for row in foreseen.rows] == [row.name == "minimum" for row in foreseen.rows]


def test_a_target_too_large_to_solve_is_judged_by_rollouts(calls):
    """8x8 pursuit has 6.6 million pairs."""
    plan = pursuit(8, cr.mean, budget=400_000)
    foreseen = look(plan, seeds=1, episodes=200)
    assert trained(calls) == ["chase"]
    assert (foreseen.solved, foreseen.exact) == (False, False)
    assert np.isnan(foreseen.optimum)
    assert [name for name in foreseen.ranking if name != "total"] == ["minimum", "mean", "maximum"]
    assert ": random policy -" in " ".join(str(foreseen).split())
    how = "(returns by rollouts; Q* estimated by the values of phi's own policy)"
    assert how in " ".join(str(foreseen).split())
    assert "expect a fall from there under epsilon-greedy" in foreseen["mean"].verdict
    assert "calibrate with c = " in foreseen["minimum"].verdict


# -- verdicts, from values made up by hand ---------------------------------------------------------

LINE = cr.GridWorld("S.T", discount=0.5, time_limit=50)  # 98.5 and 199, towards the east
Q = cr.solve(LINE, tolerance=1e-6).action_values
SIZE = (98.5 + 199) / 2
COST = cr.GridWorld("S..T", discount=0.5, time_limit=50, rewards=cr.Rewards(treasure=0))


def copy_of(task, values, **settings):
    """Return a curriculum that takes a task's own values over, and the source with these."""
    plan = cr.Curriculum(
        tasks={"source": task, "target": task},
        transfers=[cr.Transfer("source", "target", cr.transfer.identity(task))],
        budget=10,
        **settings,
    )
    source = plan.train(only=["source"])["source"]
    return plan, {"source": replace(source, values=np.asarray(values, dtype=float)[None])}


def row_of(task, values):
    plan, sources = copy_of(task, values)
    return look(plan, seeds=1, trained=sources)["mean"]


STEADY = "0% optimistic: expect no fall from there"
ABOVE = np.array([[0.0, 600.0, 0.0, 0.0]] * 2 + [[0.0] * 4])
BELOW = np.array([[0.0], [1.0], [0.0]])


@pytest.mark.parametrize(
    ("values", "verdict"),
    [
        (Q, STEADY),
        (Q + 0.19 * SIZE, "100% optimistic: expect no fall from there"),
        (Q + 0.21 * SIZE, "100% optimistic: returns may fall from there under epsilon-greedy"),
        (Q + 0.26 * SIZE, "100% optimistic: expect a fall from there under epsilon-greedy"),
        # Of few pairs optimism is no danger: half of them far too high, an excess of 150 of 148.75.
        (Q + ABOVE, "25% optimistic: expect no fall from there"),
        # Half of a positive Q* would also be exact after a factor of 2, but does no harm.
        (Q / 2, STEADY),
        # The second cell has 199 - 230 = -31, below the 0 of no potential.
        (
            Q - 230 * BELOW,
            f"{STEADY}; underestimates state 1 (row 0, column 1), which the optimal policy visits, "
            "by 31: a portfolio limits what that costs",
        ),
        (Q - 218 * BELOW, STEADY),  # up to 20 typical rewards, of -1 here, are let pass
    ],
)
def test_what_learning_does_from_a_good_start(values, verdict):
    assert row_of(LINE, values).verdict == f"starts at 98.5, {verdict}"


@pytest.mark.parametrize(("share", "verdict"), [(0.4, "no fall"), (0.5, "a fall")])
def test_an_estimated_excess_has_to_be_larger(share, verdict, monkeypatch):
    """The excess is over the value of the policy itself, (98.5 + 199) / 2 a step here too."""
    monkeypatch.setattr(target_module, "LARGEST_SOLVED", 0)
    assert f": expect {verdict}" in row_of(LINE, Q + share * SIZE).verdict


def test_a_policy_that_never_arrives_is_no_gain(monkeypatch):
    """It moves west for ever, for -2."""
    verdict = row_of(LINE, -Q).verdict
    assert verdict.startswith("starts at -2, near or below the random policy, ")
    assert "expect" not in verdict
    monkeypatch.setattr(target_module, "LARGEST_SOLVED", 0)  # nor where the optimum is unknown
    assert row_of(LINE, -Q).verdict.startswith("starts at -2, near or below the random policy, ")


def test_too_small_a_scale_is_to_be_calibrated():
    """Half of Q*, which is negative: 50 % too high, and exact after a factor of 2."""
    half = cr.solve(COST, tolerance=1e-6).action_values / 2
    foreseen = row_of(COST, half)
    assert foreseen.scale == pytest.approx(2.0)
    fall = "expect a fall from there under epsilon-greedy; calibrate with c = 2.0"
    assert foreseen.verdict == f"starts at -1.75, 100% optimistic: {fall}"
    assert row_of(LINE, Q / 2).scale == pytest.approx(2.0)


def test_a_scale_that_most_seeds_cannot_be_given_is_none():
    plan, sources = copy_of(LINE, Q)
    silent = {
        "source": replace(
            plan.train(3, only=["source"])["source"], values=np.stack([Q, 0 * Q, 0 * Q])
        )
    }
    forecast = look(plan, seeds=3, trained=silent)
    foreseen = forecast["mean"]
    assert [bool(row.refusal) for row in foreseen.calibrations] == [False, True, True]
    assert np.isnan(foreseen.scale)
    assert re.search(r"^mean \*.* none$", str(forecast), re.MULTILINE)
    assert look(plan, seeds=1, trained=sources)["mean"].scale == pytest.approx(1.0)


# -- rows ------------------------------------------------------------------------------------------


def test_custom_aggregates_have_rows_too():
    def mean(potentials):
        return np.sort(potentials, axis=0)[-1]

    lambdas = [lambda p: p.min(axis=0), lambda p: np.median(p, axis=0)]
    plan = pursuit(3, lambdas[0], budget=20_000)
    foreseen = look(plan, seeds=2, aggregates=[lambdas[1], mean, cr.maximum])
    assert sorted(foreseen.ranking) == [
        "<lambda> [1]", "<lambda> [2]", "maximum", "mean [1]", "mean [2]", "minimum", "total",
    ]  # fmt: skip
    starts = [foreseen[name].mean("start") for name in foreseen.ranking]
    assert starts == sorted(starts, reverse=True)
    for computed, theirs in (
        ("<lambda> [1]", "minimum"),
        ("<lambda> [2]", "mean [1]"),
        ("mean [2]", "maximum"),
    ):
        assert foreseen[computed].seeds == foreseen[theirs].seeds
    assert foreseen["minimum"].seeds != foreseen["mean [1]"].seeds != foreseen["maximum"].seeds
    assert [row.name for row in foreseen.rows if row.used] == ["<lambda> [1]"]


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
        evaluation=SUMMED,
    )
    foreseen = look(plan, "left", seeds=1)
    assert trained(calls) == ["near"]
    assert foreseen.target == "left"
    assert foreseen.optimum == 196.0  # 200 less four steps, not discounted
    look(plan, seeds=1, trained=foreseen.trained)
    assert trained(calls) == ["near", "left"]


# -- as text ---------------------------------------------------------------------------------------


def test_the_table_holds_the_numbers():
    foreseen = look(pursuit(3, cr.minimum, budget=cr.StoppingRule(20_000)), seeds=2)
    assert max(map(len, str(foreseen).split("\n"))) <= 80
    lines = re.sub(r"\n  (?! )", " ", str(foreseen)).split("\n")
    assert re.fullmatch(r"chase learnt 9\d % of the way to its optimum", lines[2])
    assert lines[3].startswith("The start with phi, from 2 seeds of chase (20,000 steps): optimum ")
    assert [line.split(":")[0] for line in lines[4:6]] == list(foreseen.coverage)
    for row, line in zip(foreseen.rows, lines[7:13], strict=True):
        name, *numbers = re.split(r"\s{2,}", line.strip())
        assert name == row.name + " *" * row.used
        share = float(numbers.pop(1).rstrip("%")) / 100
        expected = [row.mean(m) for m in ("start", "excess", "rank")] + [row.scale]
        assert [float(number) for number in numbers] == pytest.approx(expected, rel=0.05, abs=0.005)
        assert share == pytest.approx(row.mean("optimistic"), abs=0.0051)
    assert lines[13:] == [f"{name}: {foreseen[name].verdict}" for name in foreseen.ranking]


# -- refusals --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"target": "moon"}, "a task must be one of near, far, other: got 'moon'"),
        ({"target": "near"}, "a forecast needs a task with transfers into it: 'near' has none"),
        ({"target": "far", "episodes": 0}, "episodes of an evaluation must be"),
        ({"target": "far", "aggregates": [3]}, r"must be a function \(N, S, A\).*: got 3"),
    ],
)
def test_what_makes_no_sense_is_refused(settings, message, calls):
    plan = cr.Curriculum(
        tasks={"near": LINE, "far": LINE, "other": LINE},
        transfers=[cr.Transfer("near", "far", cr.transfer.identity(LINE))],
        budget=10,
    )
    with pytest.raises(cr.errors.CurricleError, match=message):
        cr.forecast(plan, trial=False, seeds=1, **settings)
    assert calls == []
    with pytest.raises(cr.errors.CurriculumError, match="must be one of mean: got 'minimum'"):
        look(copy_of(LINE, Q)[0], seeds=1)["minimum"]


def test_a_calibrated_curriculum_has_a_calibrated_row():
    raw, plain = pursuit(3, cr.mean, budget=25_000), cr.transfer.Calibrate()
    transfers = [
        cr.Transfer(edge.source, edge.target, edge.mapping, calibrate=plain)
        for edge in raw.transfers
    ]
    plan = replace(raw, transfers=transfers)
    foreseen = look(plan, seeds=[4, 5])
    (fitted,) = (row for row in foreseen.rows if row.used)
    assert fitted.name == "mean, calibrated"
    result = plan.train([4, 5], trained=foreseen.trained)
    place = cr.planning.Target.of(plan.tasks["hunt"])
    for row, phi in zip(fitted.seeds, result.potentials["hunt"], strict=True):
        assert row.excess == potential_quality(phi, place).excess
    assert fitted.mean("excess") < foreseen["mean"].mean("excess")
    assert fitted.scale == pytest.approx(1.0, abs=0.1)


def test_an_aggregate_may_be_any_object_that_can_be_called():
    class Cautious(list):  # no hash
        def __call__(self, potentials):
            return potentials.min(axis=0) - 1

    foreseen = look(pursuit(3, Cautious(), budget=2000), seeds=1)
    assert any(row.used for row in foreseen.rows)


def test_a_weak_start_is_said_to_be_one_and_no_more():
    """A tenth to half of the way from the random policy to the optimum: little to lose."""
    foreseen = look(pursuit(4, cr.maximum, budget=50_000, evaluation=SUMMED), seeds=1)
    whole = foreseen.optimum - foreseen.random_return
    assert 0.1 < (foreseen["maximum"].mean("start") - foreseen.random_return) / whole < 0.5
    pattern = r"starts at -\d\S*, a weak start, \d+% optimistic: the gain from there is unknown"
    assert re.fullmatch(pattern, foreseen["maximum"].verdict)


# -- what it was computed from, which check and forecast say alike ---------------------------------

STUDY = CORNER.replace("[tasks.maze]", 'seeds = "0-3"\n[tasks.maze]\nbudget = 3_000')
STUDY = STUDY.replace("[tasks.corner]", "[tasks.corner]\nbudget = 2_000")


@pytest.fixture
def check(monkeypatch, capsys, tmp_path):
    """A function: what is set -> what `curricle check` prints, and the study."""
    (tmp_path / "maze.toml").write_text(STUDY)

    def run(*changes, flags=()):
        arguments = [part for change in changes for part in ("--set", change)]
        file = str(tmp_path / "maze.toml")
        monkeypatch.setattr(sys, "argv", ["curricle", "check", file, *arguments, *flags])
        with pytest.raises(SystemExit) as ended:
            main()
        assert not ended.value.code
        return capsys.readouterr().out, read_study(file, set=list(changes))

    return run


def test_a_forecast_is_the_return_at_the_first_step():
    """Exact in every seed: what was foreseen is what came."""
    plan = corner()
    foreseen = cr.forecast(plan, seeds=[2, 5])
    came = plan.train([2, 5])["maze"].greedy_return[:, 0]
    starts = [quality.start for quality in foreseen["mean"].seeds]
    np.testing.assert_allclose(starts, came, rtol=1e-9)


@pytest.mark.parametrize("budget", [10, 2000])
def test_check_prints_the_forecast_of_the_sources_as_they_will_be_trained(check, budget):
    out, study = check(f"tasks.corner.budget.max_steps={budget}")
    plan = study.curriculum("transfer")
    for seeds in (3, [0, 1, 2]):
        assert str(cr.forecast(plan, seeds=seeds, opponents=study.played)) in out
    assert f"from 3 seeds of corner ({budget:,} steps): optimum" in " ".join(out.split())
    begun = r"^training corner for 3 seeds, for the forecast: about \d+ s$"
    assert re.search(begun, out, re.MULTILINE)


def test_a_budget_too_long_for_a_look_is_not_trained(check, monkeypatch):
    def trained(*_):
        raise AssertionError("nothing is trained")

    monkeypatch.setattr(Run, "train", trained)
    monkeypatch.setattr("curricle.study.cost.pace", lambda _: 1.0)
    out, study = check()
    text = " ".join(out.split())
    assert re.search(r"training corner for one seed could take \S+ (min|h), so this ", text)
    assert str(cr.forecast(study.curriculum("transfer"), perfect=True)) in out
    assert "if corner were learnt perfectly: optimum" in text
    assert "seeds of" not in text


def test_the_flag_makes_a_forecast_that_takes_long(check, monkeypatch):
    monkeypatch.setattr("curricle.study.cost.pace", lambda _: 1.0)
    monkeypatch.setattr(output, "LONGEST_COMPARING", 0.0)
    out, study = check(flags=["--forecast"])
    plan, opponents = study.curriculum("transfer"), study.played
    assert str(cr.forecast(plan, trial=True, opponents=opponents)) in out


def test_one_seed_where_three_would_be_slow(check, monkeypatch):
    pace = 1.0  # seconds that a seed's 2,000 steps take
    monkeypatch.setattr(output, "LONGEST", 2 * pace)
    monkeypatch.setattr("curricle.study.cost.pace", lambda _: pace / SLOWER / 2000)
    out, study = check()
    assert "\ntraining corner for 1 seed, for the forecast: about 1 s\n" in out
    assert str(cr.forecast(study, seeds=1)) in out


def test_a_perfect_source_is_its_solution():
    plan = corner(source=1)
    foreseen = cr.forecast(plan, seeds=[4, 5], perfect=True)
    solved = cr.solve(plan.tasks["corner"]).action_values
    np.testing.assert_allclose(foreseen.trained["corner"].values[0], solved, atol=1e-3)
    assert (foreseen.perfect, foreseen.computed_from) == (True, "if corner were learnt perfectly")
    assert len(foreseen["mean"].seeds) == 1
    assert "seed" not in str(foreseen).split(":")[0]


def test_steps_are_those_that_the_sources_were_trained_for():
    rule = cr.StoppingRule(max_steps=900, threshold=194.0, patience=3)
    plan = corner(source=rule, eval_freq=100).replace("corner", eval_freq=10)
    foreseen = cr.forecast(plan, seeds=5)
    used = foreseen.trained["corner"].steps_used
    assert used.min() < used.max()
    assert foreseen.computed_from == (
        f"from 5 seeds of corner ({used.mean():,.0f} steps on average)"
    )
    longer = plan.replace("corner", budget=90_000)
    assert (
        cr.forecast(longer, seeds=5, trained=foreseen.trained).computed_from
        == foreseen.computed_from
    )


def test_a_source_that_cannot_be_solved_has_no_perfect_forecast(monkeypatch):
    monkeypatch.setattr("curricle.planning.policy_evaluation.LARGEST_SOLVED", 0)
    with pytest.raises(
        cr.errors.CurriculumError, match="sources that can be solved: 'chase' cannot"
    ):
        cr.forecast(pursuit(3, cr.minimum, budget=100), perfect=True)


def test_perfect_sources_are_not_given():
    plan = corner(source=10)
    trained = cr.forecast(plan, seeds=1).trained
    with pytest.raises(cr.errors.CurriculumError, match="must have no trained sources: got corner"):
        cr.forecast(plan, perfect=True, trained=trained)


def test_without_a_trial_no_forecast_says_what_learning_gains():
    """A start at the random policy's return is called open, and what came was a gain."""
    plan = copied(MAZE, budget={"near": 1, "far": 3000}, eval_freq={"far": 100})
    foreseen = cr.forecast(plan, seeds=1, trial=False)
    assert "no better than" not in str(foreseen)
    assert foreseen.answer == "whether it pays is open"
    assert foreseen["mean"].verdict.endswith("the gain from there is unknown")


@pytest.mark.parametrize(("seeds", "few"), [(5, "(5; 6 or more)"), (6, "")])
def test_check_and_run_warn_of_too_few_seeds(check, monkeypatch, capsys, tmp_path, seeds, few):
    out, _ = check(f"seeds={seeds}")
    assert ("too few seeds for a verdict" in out) is bool(few)
    assert few in out.splitlines()[1]
    run = ["run", str(tmp_path / "maze.toml"), "--out", str(tmp_path / "out")]
    quick = ["--set", f"seeds={seeds}", "--set", "tasks.corner.budget=9", "--set"]
    monkeypatch.setattr(sys, "argv", ["curricle", *run, *quick, "tasks.maze.budget=9"])
    with pytest.raises(SystemExit):
        main()
    lines = capsys.readouterr().err.splitlines()
    warning = [line for line in lines if "too few" in line]
    assert warning == ["curricle: too few seeds for a verdict (5; 6 or more)"] * bool(few)
    assert lines[0] == warning[0] if few else True
