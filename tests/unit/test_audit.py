"""Audits: as configured, then fair; equal trials for every arm, and one sentence."""

import json
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest

import curricle as cr
from curricle.errors import ConfigError
from curricle.show.report import write_audit
from curricle.study import Audit, audit, read_study
from curricle.study.auditing import HEADS, as_configured, as_fair
from curricle.study.tried import levels, potential_of

OPTIMIST = "scratch, OptimisticQLearning"
STUDY = """
name = "line"
seeds = 8
budget = 1_500
eval_freq = 50
shaping = "QInitialisation"
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


def test_the_command_prints_an_audit_as_data(audited, file, curricle, monkeypatch, tmp_path):
    monkeypatch.setattr("curricle.study.audit", lambda *_, **__: audited)
    (tmp_path / "out").mkdir()
    code, out, complaint = curricle("audit", file, "--out", "out", "--json")
    assert code == 0, complaint
    data = json.loads(out)
    assert data["sentence"] == audited.sentence
    for side in ("configured", "fair"):
        comparison = getattr(audited, side).comparison
        assert [row["arm"] for row in data[side]["arms"]] == [*comparison.arms]
    assert (tmp_path / "out" / "audit.html").exists()


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


def variants_of(study, arm):
    """Return the values of an arm's trials, and their plans."""
    tune = study.tune
    trials = [trial for trial, variant in tune.variants.items() if variant.arm == arm]
    plans = {**tune.scratches, **tune.arms}
    return [tune.variants[trial].values for trial in trials], [plans[trial] for trial in trials]


def test_every_arm_is_tuned_by_equal_trials_its_own_settings_first(file):
    own = read_study(file)
    study = as_fair(own, 3)
    number = Counter(variant.arm for variant in study.tune.variants.values())
    informed = "near, informed optimist"  # and quick's, which would be the same
    # five settings of an arm that starts at phi: of scratch three times as many trials, too
    assert number == dict.fromkeys(["scratch", OPTIMIST, "near", "quick", informed], 3 * 5 + 1)
    assert all(study.tune.arms[arm] == own.arms[arm] for arm in own.arms)
    assert own.arms["near"].tasks["line"].learner is None  # which its trials state
    near, plans = variants_of(study, "near")
    quick, quick_plans = variants_of(study, "quick")
    keys = ["learning_rate", "initial_value", "epsilon", "scale", "source_steps"]
    assert near[0] == quick[0] == {}
    # The first half keeps the arm's own sources, so that scratch's settings are tried with these.
    assert [[*values] for values in near[1:]] == [keys[:3]] * 7 + [keys] * 8
    # also where an arm or a source sets the rate itself; the points are the same for all
    assert quick_plans[0].tasks["line"].learner.learning_rate == 0.9
    assert [of["learning_rate"] for of in near[1:]] == [of["learning_rate"] for of in quick[1:]]
    scratch, _ = variants_of(study, "scratch")
    assert [of["learning_rate"] for of in near[1:]] == [of["learning_rate"] for of in scratch[1:]]
    for values, plan in zip(near[1:], plans[1:], strict=True):
        target, source = plan.tasks["line"], plan.tasks["end"]
        assert source.learner.learning_rate == target.learner.learning_rate
        assert target.learner.initial_value == values["initial_value"]
        assert target.learner.epsilon == values["epsilon"]
        assert source.learner.epsilon is None
        assert source.learner.initial_value == 0.0
        assert plan.transfers[0].scale == values.get("scale", 1.0)
        assert source.budget == values.get("source_steps", 100)
    steps = [values["source_steps"] for values in near[8:]]
    assert 5 <= min(steps) < 20 < 60 < max(steps) <= 100
    configured = as_configured(own)
    assert (configured.played, configured.controls) == ((), None)
    assert study.played == ("constant", "bounds")  # the optimistic learner is an arm
    assert study.controls == ("placebo",)


def test_the_optimistic_learner_is_tuned_too_and_keeps_its_own_in_a_quarter(file):
    values, plans = variants_of(as_fair(read_study(file), 8), OPTIMIST)
    assert len(values) == 41
    for key in ("learning_rate", "value_range", "epsilon"):
        assert len([of for of in values[1:] if key not in of]) == pytest.approx(10, abs=2)
    low = cr.learning.value_bounds(cr.GridWorld("S......T"))[0]
    for of, plan in zip(values, plans, strict=True):
        learner = plan.tasks["line"].learner
        assert learner.type == "OptimisticQLearning"
        top = of.get("value_range")
        assert learner.value_range == (None if top is None else (low, top))


def test_a_schedule_and_a_temperature_are_kept_or_tried(file):
    rate = "learner={type='QLearning',epsilon={type='linear',first=1.0,last=0.1,steps=900}}"
    values, plans = variants_of(as_fair(read_study(file, set=[rate]), 8), "scratch")
    kept = [plan for of, plan in zip(values[1:], plans[1:], strict=True) if "epsilon" not in of]
    assert len(kept) == pytest.approx(10, abs=2)
    assert {plan.tasks["line"].learner.epsilon.type for plan in kept} == {"linear"}
    soft = "learner={type='QLearning',inverse_temperature=0.2}"
    values, plans = variants_of(as_fair(read_study(file, set=[soft]), 8), "near")
    tried = [of["inverse_temperature"] for of in values[1:]]
    assert (min(tried), max(tried)) == (pytest.approx(0.02, rel=0.2), pytest.approx(2, rel=0.2))
    assert all(plan.tasks["line"].learner.epsilon is None for plan in plans)


def test_an_informed_optimist_has_the_potential_and_the_sources_of_its_arm(file):
    own = read_study(file)
    study = as_fair(own, 2)
    assert [*study.arms] == ["near", "quick", "near, informed optimist"]
    curriculum = study.curricula["near, informed optimist"]
    assert curriculum.setting("shaping", "line") == cr.QInitialisation(
        portfolio=cr.learning.Portfolio()
    )
    assert study.arms["near, informed optimist"].transfers == own.arms["near"].transfers
    values, plans = variants_of(study, "near, informed optimist")
    portfolio = plans[-1].tasks["line"].shaping.portfolio
    assert portfolio.margin == values[-1]["margin"]
    assert portfolio.optimist == values[-1]["optimist"]
    # an arm that is one already has none beside it
    portfolio = as_fair(
        read_study(file, set=["shaping={type='QInitialisation',portfolio=true}"]), 2
    )
    assert [*portfolio.arms] == ["near", "quick"]


def test_further_learners_and_the_arms_of_a_sweep_are_tuned_too(file):
    changes = ["scratch_learners.bold.initial_value=5.0", "sweep.tasks.end.budget=[50,100]"]
    study = as_fair(read_study(file, set=changes), 2)
    number = Counter(variant.arm for variant in study.tune.variants.values())
    assert number == dict.fromkeys([*study.arms, "scratch", "scratch, bold", OPTIMIST], 11)
    assert len(study.arms) == 6  # a budget of the source each, of three arms
    bold = study.tune.scratches["scratch, bold"].tasks["line"].learner
    assert bold.initial_value == 5.0


def test_budgets_of_sources_are_shortened_by_their_kind(file):
    rule = "tasks.end.budget={max_steps=100,min_steps=40,fraction=0.9}"
    _, plans = variants_of(
        as_fair(read_study(file, set=[rule, "tasks.end.eval_freq=30"]), 4), "near"
    )
    budgets = [plan.tasks["end"].budget for plan in plans]
    assert all(of.fraction == 0.9 and of.min_steps == min(40, of.max_steps) for of in budgets)
    freqs = [plan.tasks["end"].eval_freq for plan in plans]
    assert freqs == [min(30, of.max_steps) for of in budgets]
    assert min(freqs) < 30
    episodes = ["tasks.end.budget={episodes=100}", "tasks.end.time_limit=20"]
    _, plans = variants_of(as_fair(read_study(file, set=episodes[:1]), 4), "near")
    assert {plan.tasks["end"].budget.episodes for plan in plans} > {100}


def test_levels_run_from_the_random_policy_to_the_optimum():
    line = cr.GridWorld("S..T", rewards=cr.Rewards(step=-1.0, treasure=0.0), discount=0.5)
    # the optimum of the states -1.75, -1.5 and -1
    assert levels(line) == pytest.approx((-1.96, -1.75, 0.0), abs=0.05)
    assert levels(line, 0.0, [-9.0, 2.0]) == pytest.approx((-9.0, -1.75, 2.0))
    endless = cr.GridWorld("S..T", rewards=cr.Rewards(step=-1.0), discount=1.0)
    assert levels(cr.tasks.LiveMDP) == ()
    assert (levels(endless)[0], levels(endless)[-1]) == (0.0, 199.0)


@pytest.mark.parametrize("shaping", ["StateShaping", "QInitialisation"])
def test_levels_of_an_arm_are_those_of_what_its_q_learns(file, shaping):
    study = as_fair(read_study(file, set=[f"shaping={shaping}"]), 20)
    curriculum = study.curricula["near"]
    line, end = curriculum.tasks["line"].mdp, curriculum.tasks["end"].mdp
    best, source = cr.solve(line), cr.solve(end).action_values
    phi = np.zeros((8, 4))
    phi[4:] = source[:4]
    if shaping == "StateShaping":
        phi = np.repeat(phi.max(axis=1, keepdims=True), 4, axis=1)
    np.testing.assert_allclose(np.broadcast_to(potential_of(curriculum), phi.shape), phi)
    learnt = (best.action_values - phi)[~line.terminal]
    tried = [of["initial_value"] for of in variants_of(study, "near")[0][1:]]
    low, high = min(0.0, learnt.min()), learnt.max()
    assert low - 100 <= min(tried) <= max(tried) <= high
    scratch = [of["initial_value"] for of in variants_of(study, "scratch")[0][1:]]
    assert np.median(tried) < np.median(scratch)


def test_a_potential_that_is_the_optimum_is_learnt_from_zero():
    line = cr.GridWorld("S..T", discount=0.5)
    q = cr.solve(line).action_values
    known = cr.Curriculum({"line": line}, potential={"line": q})
    np.testing.assert_allclose(potential_of(known), q)
    lowest, high = levels(line, potential_of(known))
    assert high == 0.0
    assert lowest < 0  # what a random policy earns, less phi


def test_the_fair_half_is_checked_before_anything_runs(file, tmp_path):
    # the name of an arm that only the fair half has
    text = STUDY.replace("[arms.quick]", '[arms."near, constant mean"]')
    clash = file.with_name("clash.toml")
    clash.write_text(text)
    with pytest.raises(cr.errors.CurriculumError, match="names two"):
        audit(clash, tmp_path / "out", trials=1, progress=False)
    assert not (tmp_path / "out").exists()


def test_both_are_run_and_said(audited, tmp_path):
    assert isinstance(audited, Audit)
    assert audited.configured.comparison.scratches == ("scratch",)
    assert OPTIMIST in audited.fair.comparison.scratches
    assert audited.sentence.startswith("Shown to pay as configured: ")
    text = str(audited)
    for part in ("near", "quick", *HEADS, "verdict", "near, informed optimist", "16 trials of "):
        assert part in text
    rows = {measure: texts for measure, *texts in audited.rows("near")}
    for opponent, steps, share in zip(
        rows["opponent"],
        rows["steps until learnt: the arm; it"],
        rows["share of its steps saved"],
        strict=True,
    ):
        own, others = (float(number.replace(",", "")) for number in steps.split("; "))
        assert float(share.split(" ")[0]) == pytest.approx(1 - own / others, abs=0.01), opponent
    tuned = audited.fair.record.tuned.arms
    assert {of.trials for of in tuned.values()} == {16}
    assert tuned[OPTIMIST].settings == ("learning_rate", "value_range", "epsilon")
    assert tuned["near"].words.startswith(
        "16 trials of learning_rate, initial_value, epsilon, scale"
    )
    assert {of.finalists for of in tuned.values()} <= {5, 6}
    runs = 16 * 3 + tuned["near"].finalists * 30
    assert audited.fair.record.tuned.steps("near") == runs * 1_600
    page = write_audit(audited, tmp_path / "audit.html").read_text()
    assert audited.sentence in page
    assert "What survives?" in page
    assert "have one number of trials, in proportion to the settings" in page
    assert all(head in page for head in HEADS)
    assert "near" in page


def test_the_best_are_played_again_and_judged_by_all_seeds(audited, file):
    folder, tuned = audited.fair.store.path, audited.fair.record.tuned
    trials = cr.study.StudyResults(folder / "tuning")
    assert len(trials.seeds) == len(tuned.seeds) + len(tuned.final_seeds) == 3 + 30
    scores = {name: returns.mean() for name, returns in trials.comparison.returns.items()}
    assert {"scratch", OPTIMIST, "near", "quick"} <= scores.keys()  # their own settings, too
    for arm, best in tuned.arms.items():
        of_arm = {n: x for n, x in scores.items() if n == arm or n.startswith(f"{arm}, trial ")}
        assert len(of_arm) == best.finalists in (5, 6)
        assert best.score == max(of_arm.values())
        first = max(of_arm, key=of_arm.get)
        assert best.values == trials.record.variants[first].values
    # as many as are judged, so that a setting which seldom fails is seen to
    assert len(as_fair(read_study(file, set=["seeds=60"]), 1).tune.final_seeds) == 60


def test_each_column_has_its_own_opponent(audited):
    comparison = audited.fair.comparison
    rows = {measure: cells for measure, *cells in audited.rows("near")}
    best = comparison.best_opponent("near")
    assert rows["opponent"] == ["scratch", "scratch", best]
    assert rows["verdict"][2] == comparison.contrasts["near"].answer
    assert rows["verdict"][1] == comparison.against("scratch")["near"].against_scratch
    assert rows["trials of the arm"][0] == "-"  # as configured nothing is tuned
    informed = {measure: cells for measure, *cells in audited.rows("near, informed optimist")}
    assert {cells[0] for cells in informed.values()} == {"-"}


def test_the_same_learner_is_of_the_class_of_the_arm(audited, monkeypatch):
    assert audited.same_learner("near") == "scratch"
    settings = audited.fair.record.arms["near"].nodes["line"].settings
    assert settings["learner"].startswith("QLearning(")
    monkeypatch.setitem(settings, "learner", "OptimisticQLearning()")
    assert audited.same_learner("near") == OPTIMIST
    monkeypatch.setitem(settings, "learner", "SARSA(epsilon=0.1)")
    assert audited.same_learner("near") == "scratch"


def test_where_nobody_learnt_there_is_a_verdict_and_what_was_tuned(audited, monkeypatch):
    for side in (audited.configured, audited.fair):
        monkeypatch.setitem(vars(side.comparison), "nobody", "nobody learnt")
    measures = [measure for measure, *_ in audited.rows("near")]
    assert measures == ["verdict", "trials of the arm", "trials of it"]


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
