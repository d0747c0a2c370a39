"""Audits: as configured, then fair; equal trials for every arm, and one sentence."""

from types import SimpleNamespace

import pytest

import curricle as cr
from curricle.errors import ConfigError
from curricle.show.report import write_audit
from curricle.study import Audit, audit, read_study
from curricle.study.auditing import as_configured, as_fair, levels

STUDY = """
name = "line"
seeds = 8
budget = 1_500
eval_freq = 50
[tasks.line]
type = "maze"
map = "S......T"
[tasks.end]
type = "crop"
of = "line"
columns = [4, 8]
rows = [0, 1]
start = "uniform"
budget = 100
learner.learning_rate = 0.7
[[transfers]]
source = "end"
target = "line"
mapping = "same_position"
[arms.near]
[arms.quick]
tasks.line.learner.learning_rate = 0.9
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("audit") / "line.toml"
    path.write_text(STUDY)
    return path


@pytest.fixture(scope="module")
def audited(file, tmp_path_factory):
    return audit(file, tmp_path_factory.mktemp("out"), trials=3, progress=False)


def test_only_arms_that_gain_more_than_their_placebos_pay_by_what_they_know():
    verdicts = {name: SimpleNamespace(direction=1) for name in ("knowing", "chance")}
    reasons = {
        "knowing": SimpleNamespace(why="knowledge"),
        "chance": SimpleNamespace(why="placebo"),
    }
    comparison = SimpleNamespace(withheld="", nobody="", verdicts=verdicts, reasons=reasons)
    side = SimpleNamespace(comparison=comparison)
    said = Audit(side, side).sentence
    assert said.endswith("against fair opponents: knowing, chance; by what it knows: knowing.")
    nobody = SimpleNamespace(withheld="nobody learnt", nobody="nobody learnt", verdicts={})
    said = Audit(SimpleNamespace(comparison=nobody), side).sentence
    assert said.startswith("Shown to pay as configured: nobody learnt; against fair opponents: kn")


def test_every_arm_is_tuned_by_equal_trials_its_own_settings_first(file):
    study = as_fair(read_study(file), 3)
    of_arm = dict.fromkeys(study.variants, ())
    for trial, variant in study.tune.variants.items():
        of_arm[variant.arm] += (trial,)
    assert {arm: len(trials) for arm, trials in of_arm.items()} == dict.fromkeys(
        ("scratch", "near", "quick"), 4
    )
    own = read_study(file)
    assert all(study.tune.arms[arm] == own.arms[arm] for arm in own.arms)
    assert own.arms["near"].tasks["line"].learner is None  # which its trials state
    rates = {
        arm: [
            (study.tune.arms[trial].tasks["line"].learner or cr.QLearning()).learning_rate
            for trial in trials
        ]
        for arm, trials in of_arm.items()
        if arm in own.arms
    }
    # also where an arm or a source sets the rate itself; the points are the same for all
    assert rates["near"][0] == 0.1
    assert rates["quick"][0] == 0.9
    assert rates["near"][1:] == rates["quick"][1:]
    assert len({*rates["near"]}) == 4
    second = study.tune.arms[of_arm["near"][1]].tasks
    assert second["end"].learner.learning_rate == second["line"].learner.learning_rate
    assert second["end"].learner.initial_value == 0.0 != second["line"].learner.initial_value
    plans = {**study.tune.arms, **study.tune.scratches}
    points = [
        [plans[trial].tasks["line"].learner for trial in of_arm[arm][1:]]
        for arm in ("scratch", "near")
    ]
    assert points[0] == points[1]
    configured = as_configured(own)
    assert (configured.played, configured.controls) == ((), None)
    assert study.played == ("constant", "bounds", "optimistic")
    assert study.controls == ("placebo",)


def test_further_learners_and_the_arms_of_a_sweep_are_tuned_too(file):
    changes = ["scratch_learners.bold.initial_value=5.0", "sweep.tasks.end.budget=[50,100]"]
    study = as_fair(read_study(file, set=changes), 2)
    trials = [variant.arm for variant in study.tune.variants.values()]
    arms = {*study.arms, "scratch", "scratch, bold"}
    assert {arm: trials.count(arm) for arm in trials} == dict.fromkeys(arms, 3)
    assert len(study.arms) == 4
    bold = study.tune.scratches["scratch, bold"].tasks["line"].learner
    assert bold.initial_value == 5.0


def test_levels_run_from_the_random_policy_to_the_optimum():
    line = cr.GridWorld("S..T", rewards=cr.Rewards(step=-1.0, treasure=0.0), discount=0.5)
    assert levels(line) == {"low": pytest.approx(-1.96, abs=0.05), "high": 0.0}
    assert levels(line, [-9.0, 2.0]) == {"low": -9.0, "high": 2.0}
    endless = cr.GridWorld("S..T", rewards=cr.Rewards(step=-1.0), discount=1.0)
    assert levels(cr.tasks.LiveMDP) is None
    assert levels(endless) == {"low": 0.0, "high": 199.0}


def test_both_are_run_and_said(audited, tmp_path):
    assert isinstance(audited, Audit)
    assert audited.configured.comparison.scratches == ("scratch",)
    assert "scratch, OptimisticQLearning" in audited.fair.comparison.scratches
    assert audited.sentence.startswith("Shown to pay as configured: ")
    text = str(audited)
    for part in ("near", "quick", "as configured", "fair", "verdict"):
        assert part in text
    page = write_audit(audited, tmp_path / "audit.html").read_text()
    assert audited.sentence in page
    assert "What survives?" in page
    assert "near" in page


def test_where_nobody_learnt_there_is_a_verdict_alone(audited, monkeypatch):
    for side in (audited.configured, audited.fair):
        monkeypatch.setitem(vars(side.comparison), "nobody", "nobody learnt")
    *measures, verdict = audited.rows("near")
    assert {(before, after) for _, before, after in measures} == {("-", "-")}
    assert verdict[0] == "verdict"


def test_a_stopped_audit_goes_on(file, audited):
    trained = []
    again = audit(
        file,
        audited.fair.store.path.parent,
        trials=3,
        progress=lambda now: trained.extend(now.units),
    )
    assert str(again) == str(audited)
    assert not trained


@pytest.mark.parametrize(
    "change", ["scratch=false", "compared=false", "tune={space={learner.epsilon=[0.1,0.2]}}"]
)
def test_what_cannot_be_audited(file, change):
    with pytest.raises(ConfigError, match="an audit tunes every arm itself"):
        as_configured(read_study(file, set=[change]))


def test_too_few_seeds_say_nothing(file, tmp_path):
    study = read_study(file, set=["seeds=2"])
    made = cr.study.audit(study, tmp_path, trials=1, progress=False)
    assert made.sentence.startswith("Nothing is shown: too few seeds")
