"""Forecasts: what they say before the target is trained, and what ``check`` prints of them."""

import re
import sys
from dataclasses import replace

import numpy as np
import pytest

import curricle as cr
from curricle.cli import output
from curricle.cli.app import main
from curricle.comparison.cost import SLOWER
from curricle.study import read_study
from curricle.transfer.rollouts import greedy_start
from tests.support.comparisons import MAZE, calls, copied, pursuit  # noqa: F401
from tests.support.studies import CORNER

LINE = cr.GridWorld("S.T", discount=0.5, time_limit=50)


def look(plan, *target, **settings):
    """Return a forecast without a trial: what it says of the sources."""
    return cr.forecast(plan, *target, trial=False, **settings)


def trained(calls):  # noqa: F811
    """Return the names of the tasks that were trained, in order."""
    return [call["stream"] for call in calls]


# -- rows ------------------------------------------------------------------------------------------


def test_custom_aggregates_have_rows_too():
    def mean(potentials):
        return np.sort(potentials, axis=0)[-1]

    lambdas = [lambda p: p.min(axis=0), lambda p: np.median(p, axis=0)]
    plan = replace(pursuit(), aggregate=lambdas[0], budget=2_000)
    predicted = cr.forecast(
        plan, seeds=1, aggregates=[lambdas[1], mean, cr.maximum], trial=True, opponents=()
    )
    assert sorted(predicted.ranking) == [
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


def test_the_target_may_be_any_task_with_transfers_into_it(calls):  # noqa: F811
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
    assert trained(calls) == ["near"]
    assert predicted.target == "left"
    look(plan, seeds=1, trained=predicted.trained)
    assert trained(calls) == ["near", "left"]


def test_an_aggregate_may_be_any_object_that_can_be_called():
    class Cautious(list):  # no hash
        def __call__(self, potentials):
            return potentials.min(axis=0) - 1

    predicted = look(replace(pursuit(), aggregate=Cautious()), seeds=1)
    assert any(row.used for row in predicted.rows)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"target": "moon"}, "a task must be one of near, far, other: got 'moon'"),
        ({"target": "near"}, "a forecast needs a task with transfers into it: 'near' has none"),
        ({"target": "far", "episodes": 0}, "episodes of an evaluation must be"),
        ({"target": "far", "aggregates": [3]}, r"must be a function \(N, S, A\).*: got 3"),
    ],
)
def test_what_makes_no_sense_is_refused(settings, message, calls):  # noqa: F811
    plan = cr.Curriculum(
        tasks={"near": LINE, "far": LINE, "other": LINE},
        transfers=[cr.Transfer("near", "far", cr.transfer.identity(LINE))],
        budget=10,
    )
    with pytest.raises(cr.errors.CurricleError, match=message):
        look(plan, seeds=1, **settings)
    assert calls == []
    with pytest.raises(cr.errors.CurriculumError, match="must be one of mean: got 'minimum'"):
        look(copied(LINE, budget=10), seeds=1)["minimum"]


# -- what it says ----------------------------------------------------------------------------------


def test_without_a_trial_no_forecast_says_what_learning_gains():
    plan = copied(MAZE, budget={"near": 1, "far": 3000}, eval_freq={"far": 100})
    predicted = look(plan, seeds=1)
    assert "no better than" not in str(predicted)
    assert predicted.answer == "whether it pays is open"
    assert (predicted.best, predicted.start) == (predicted.used, None)


def test_of_a_live_target_it_says_what_the_potential_s_own_policy_returns():
    lake = cr.from_gymnasium("FrozenLake-v1", discount=0.9, live=True, time_limit=20)
    plan = copied(lake, budget={"near": cr.StoppingRule(600), "far": 60})
    predicted = cr.forecast(plan, seeds=2, episodes=30)
    potentials = plan.potentials("far", predicted.trained)
    evaluation = cr.GreedyEvaluation(method="rollouts", episodes=30)
    starts = [greedy_start(phi, evaluation, seed=k) for k, phi in enumerate(potentials)]
    assert predicted.start.potential == np.mean(starts)
    assert predicted.start.random != predicted.start.potential
    assert (
        " ".join(str(predicted).split())
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


@pytest.mark.parametrize("budget", [10, 2000])
def test_check_prints_the_forecast_of_the_sources_as_they_will_be_trained(check, budget):
    out, study = check(f"tasks.corner.budget.max_steps={budget}")
    plan = study.curriculum("transfer")
    for seeds in (3, [0, 1, 2]):
        assert str(cr.forecast(plan, seeds=seeds, opponents=study.played)) in out
    begun = r"^training corner for 3 seeds, for the forecast: about \d+ s$"
    assert re.search(begun, out, re.MULTILINE)


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
