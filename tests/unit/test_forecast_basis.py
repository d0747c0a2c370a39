"""What a forecast was computed from: it says so, and check and forecast say the same."""

import re
import sys

import numpy as np
import pytest

import curricle as cr
from curricle.cli import study_preview
from curricle.cli.app import main
from curricle.errors import CurriculumError
from curricle.learning.run import Run
from curricle.study import read_study
from curricle.study.cost import SLOWER
from tests.comparisons import MAZE, copied, corner, pursuit
from tests.studies import CORNER

STUDY = CORNER.replace("[tasks.maze]", 'seeds = "0-3"\n[tasks.maze]\nbudget = 3_000')
STUDY = STUDY.replace("[tasks.corner]", "[tasks.corner]\nbudget = 2_000")


@pytest.fixture
def check(monkeypatch, capsys, tmp_path):
    """A function: what is set -> what `curricle check` prints, and the study."""
    (tmp_path / "maze.toml").write_text(STUDY)

    def run(*changes):
        arguments = [part for change in changes for part in ("--set", change)]
        file = str(tmp_path / "maze.toml")
        monkeypatch.setattr(sys, "argv", ["curricle", "check", file, *arguments])
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
        assert str(cr.forecast(plan, seeds=seeds)) in out
    assert f"from 3 seeds of corner ({budget:,} steps): optimum" in " ".join(out.split())
    begun = r"^training corner for 3 seeds and trials of 20 seeds, for the forecast: about \d+ s$"
    assert re.search(begun, out, re.MULTILINE)
    perfect = cr.forecast(plan, perfect=True)
    line = f"if corner were learnt perfectly: mean {perfect['mean'].verdict}"
    assert line in " ".join(out.split())


def test_a_budget_too_long_for_a_look_is_not_trained(check, monkeypatch):
    def trained(*_):
        raise AssertionError("nothing is trained")

    monkeypatch.setattr(Run, "train", trained)
    monkeypatch.setattr("curricle.study.cost.pace", lambda _: 1.0)
    out, study = check()
    words = " ".join(out.split())
    assert re.search(r"training corner for one seed would take about \S+ (min|h), so these ", words)
    assert str(cr.forecast(study.curriculum("transfer"), perfect=True)) in out
    assert "if corner were learnt perfectly: optimum" in words
    assert "seeds of" not in words


def test_one_seed_where_three_would_be_slow(check, monkeypatch):
    pace = 1.0  # seconds that a seed's 2,000 steps take
    monkeypatch.setattr(study_preview, "LONGEST", 2 * pace)
    monkeypatch.setattr("curricle.study.cost.pace", lambda _: pace / SLOWER / 2000)
    out, study = check()
    assert "\ntraining corner for 1 seed, for the forecast: about 1 s\n" in out
    # Trials would take 20 times as long as the look.
    assert str(cr.forecast(study.curriculum("transfer"), seeds=1, trial=False)) in out


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
    monkeypatch.setattr("curricle.planning.target.LARGEST_SOLVED", 0)
    with pytest.raises(CurriculumError, match="tasks that can be solved: 'chase' cannot"):
        cr.forecast(pursuit(), perfect=True)


def test_perfect_sources_are_not_given():
    plan = corner(source=10)
    given = cr.forecast(plan, seeds=1).trained
    with pytest.raises(CurriculumError, match="takes no trained ones: got corner"):
        cr.forecast(plan, perfect=True, trained=given)


def test_without_a_trial_no_forecast_says_what_learning_gains():
    """A start at the random policy's return is called open, and what came was a gain."""
    plan = copied(MAZE, budget={"near": 1, "far": 3000}, eval_freq={"far": 100})
    foreseen = cr.forecast(plan, seeds=1, trial=False)
    assert "no better than" not in str(foreseen)
    assert foreseen.answer == "whether it pays is open"
    assert foreseen["mean"].verdict.endswith("what learning gains from there is open")


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
    told = capsys.readouterr().err.splitlines()
    warning = [line for line in told if "too few" in line]
    assert warning == ["curricle: too few seeds for a verdict (5; 6 or more)"] * bool(few)
    assert told[0] == warning[0] if few else True
