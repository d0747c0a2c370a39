"""Potentials that a user writes: they are arms as those of sources are, and cost no step."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import curricle as cr
from curricle.curriculum.result import CurriculumResult
from curricle.errors import ConfigError, CurriculumError
from curricle.learning import OptimisticQLearning, linear
from curricle.study import run_study
from curricle.study.arms import Arms
from curricle.study.auditing import as_fair
from tests.support.studies import changed
from tests.unit.test_curriculum import MAZE, TASKS, edges, same

PHI = np.random.default_rng(0).normal(size=(12, 4))
LEVELS = PHI.max(axis=1)
BUDGET = 300
NEAR_AND_FAR = {name: TASKS[name] for name in ("near", "far")}, edges([("near", "far")])


def in_pairs(values):
    """Return the maximum of each state in all its pairs."""
    return np.tile(values.max(axis=1, keepdims=True), 4)


def by_hand(phi=PHI, shaping=None, **settings):
    shaping = shaping or cr.QInitialisation()
    plain = {"budget": BUDGET, "shaping": shaping, "potential": {"maze": phi}}
    return cr.Curriculum({"maze": MAZE}, **{**plain, **settings})


def learnt(shaping, seeds=(4, 2)):
    return cr.learn(MAZE, budget=BUDGET, seeds=seeds, shaping=shaping, stream="maze")


@pytest.mark.parametrize(
    "shaping",
    [
        cr.QInitialisation(),
        cr.QInitialisation(portfolio=cr.Portfolio()),
        cr.LookAheadAdvice(),
        cr.StateShaping(),
        cr.RewardBonus(),
    ],
    ids=str,
)
def test_it_enters_by_every_shaping_as_in_learn(shaping):
    result = by_hand(shaping=shaping).train(seeds=[4, 2])
    assert same(result["maze"], learnt(shaping.with_potential(PHI)))
    assert result.source_steps("maze").tolist() == [0, 0]


@pytest.mark.parametrize(
    ("potential", "array"),
    [
        (PHI.tolist(), PHI),
        (lambda task: PHI * task.states.size, 12 * PHI),
        (cr.StateActionPotential(MAZE, PHI), PHI),
        (LEVELS, in_pairs(PHI)),
        (cr.StatePotential(MAZE, LEVELS, weight=0.5), 0.5 * in_pairs(PHI)),
        (lambda task: cr.StatePotential(task, LEVELS), in_pairs(PHI)),
    ],
    ids=["lists", "function", "of pairs", "levels", "of states", "function of states"],
)
def test_it_is_an_array_a_potential_or_a_function_of_the_task(potential, array):
    plan = by_hand(potential)
    assert same(plan.train([4, 2])["maze"], learnt(cr.QInitialisation(array)))
    assert plan.has_potential("maze")
    assert not by_hand(None).has_potential("maze")
    assert plan.replace("maze", budget=9).potential == plan.potential
    one_for_all = replace(plan, potential=potential)
    np.testing.assert_array_equal(
        one_for_all.potential["maze"].values, plan.potential["maze"].values
    )


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_state_values_in_q_are_state_shaping(seed):
    levels = np.random.default_rng(seed).normal(size=12)  # Wiewiora 2003
    in_q = by_hand(levels).train()["maze"]
    rewarded = learnt(cr.StateShaping(levels), seeds=1)
    np.testing.assert_allclose(in_q.values, rewarded.values, atol=1e-9)


def test_a_source_may_have_one():
    plan = cr.Curriculum(
        *NEAR_AND_FAR,
        budget=BUDGET,
        learner={"near": cr.QLearning(learning_rate=0)},  # what arrives is phi
        shaping=cr.QInitialisation(),
        potential={"near": np.ones((4, 4))},
    )
    phi = plan.train().potentials["far"][0].values
    assert phi[MAZE.state(1, 2)].tolist() == [1.0] * 4
    assert phi[MAZE.state(0, 0)].tolist() == [0.0] * 4
    with pytest.raises(CurriculumError, match="in their task's own rewards"):
        replace(plan, shaping={"near": cr.RewardBonus()})


OTHER = cr.GridWorld(["S..", "..T"])
REFUSED = [
    (np.zeros((12, 3)), {}, "potential of 'maze' .* must have shape (12, 4): got (12, 3)"),
    (np.zeros(4), {}, "a state potential must have shape (12,) .* got (4,)"),
    (np.where(np.eye(12, 4), np.nan, PHI), {}, "must be finite: entry (0, 0) is nan"),
    (np.full(12, 1e16), {}, "must be at most 1e+15 in size"),
    ("high", {}, "a potential must be"),
    ([[1.0], [1.0, 2.0]], {}, "a potential must be"),
    (lambda task: None, {}, "a potential must be"),
    (cr.StateActionPotential(OTHER, np.ones((6, 4))), {}, "made for the task it shapes"),
    (cr.StatePotential(OTHER, np.ones(6)), {}, "made for the task it shapes"),
    (cr.StatePotential(MAZE, LEVELS, weight=linear(1.0, 0.0, steps=9)), {}, "change with time"),
    (PHI, {"shaping": cr.QInitialisation(PHI)}, "no potential of its own, because .*potential="),
    (PHI, {"learner": OptimisticQLearning(), "shaping": cr.StateShaping()}, "QInitialisation"),
    (PHI, {"potential": {"mase": PHI}}, "'mase'"),
]


@pytest.mark.parametrize(("potential", "settings", "words"), REFUSED)
def test_what_is_refused(potential, settings, words):
    literal = words.replace("(", r"\(").replace(")", r"\)").replace("+", r"\+")
    with pytest.raises(cr.CurricleError, match=literal):
        by_hand(potential, **settings)


def test_sources_and_one_by_hand_are_two_arms():
    words = "'far' has one by hand and the source 'near'; leave out one, or compare both"
    with pytest.raises(CurriculumError, match=words):
        cr.Curriculum(*NEAR_AND_FAR, potential={"far": PHI})


# -- compared, forecast, saved ---------------------------------------------------------------------

GOOD = 0.9 * cr.solve(MAZE).action_values


def test_it_has_opponents_and_controls_and_shares_nothing_with_another(calls):
    controls = ["placebo", "negated", "constant", "random_start", "pretraining", "unrelated"]
    arms = {"good": by_hand(GOOD), "phi": by_hand(), "none": by_hand(None)}  # which is scratch
    comparison = cr.compare(arms, seeds=[3, 7], opponents=[], controls=())
    greedy = {name: arm.curve.values for name, arm in comparison.arms.items()}
    assert not np.array_equal(greedy["good"], greedy["phi"])
    assert [*greedy] == ["scratch", "good", "phi"]
    with pytest.raises(CurriculumError, match="arm 'none' has neither"):
        cr.compare(arms, seeds=1, controls=["placebo"])

    calls.clear()
    portfolio = by_hand(GOOD, cr.QInitialisation(portfolio=cr.Portfolio()))
    comparison = cr.compare({"good": portfolio}, seeds=[3, 7], opponents=[], controls=controls)
    labels = ["placebo", "placebo, alone", "negated", *(f"constant {m}" for m in MEASURES)]
    assert [*comparison.arms] == ["scratch", "good", *(f"good, {label}" for label in labels)]
    assert {arm.curve.source_steps.max() for arm in comparison.arms.values()} == {0}
    alive = ~MAZE.mdp.terminal
    good, placebo, alone, negated, *constants = (
        [phi.values for phi in call["potentials"]] for call in calls[1:]
    )
    for k in range(2):
        np.testing.assert_array_equal(negated[k], -good[k])
        np.testing.assert_array_equal(alone[k], placebo[k])
        assert not np.array_equal(placebo[k], good[k])
        assert sorted(placebo[k][alive].ravel()) == sorted(good[k][alive].ravel())
        assert [np.unique(phi[k][alive]).size for phi in constants] == [1, 1, 1]


MEASURES = "mean", "minimum", "maximum"


def test_a_trial_plays_it():
    known = cr.forecast(by_hand(GOOD), seeds=1)
    assert [row.name for row in known.rows] == ["potential"]
    assert known.used.gain == known.trial.contrasts["potential"].strong_gain
    assert "with the potential, " in known.basis
    assert "sources" not in str(known)
    bad = cr.forecast(by_hand(-GOOD), seeds=1)
    assert bad.used.gain.estimate < known.used.gain.estimate
    with pytest.raises(CurriculumError, match="'maze' has neither transfers nor one by hand"):
        cr.forecast(by_hand(None))


def test_it_is_pickled_and_saved(tmp_path):
    plan = by_hand(lambda task: PHI)
    result = pickle.loads(pickle.dumps(plan)).train(2)
    again = CurriculumResult.load(result.save(tmp_path / "kept"), plan)
    assert same(again["maze"], result["maze"])
    for phi, before in zip(again.potentials["maze"], result.potentials["maze"], strict=True):
        np.testing.assert_array_equal(phi.values, before.values)


def test_a_choice_names_it():
    plan = by_hand(GOOD, budget=500)
    chosen = cr.choose(MAZE, [plan], kinds=(), budget=500, shaping=cr.QInitialisation())
    assert "potential" in str(chosen)


# -- in study files --------------------------------------------------------------------------------

OWN = """
import numpy as np
import curricle as cr

def known(task):
    return 0.9 * cr.solve(task).action_values

def levels(task):
    return known(task).max(axis=1)

def short(task):
    return np.zeros((3, 4))

def infinite(task):
    return known(task) + np.inf

def failing(task):
    return task.nothing
"""
STUDY = """
name = "by hand"
seeds = 8
controls = ["placebo", "negated", "random_start"]
budget = 300
tasks.maze = { type = "maze", map = "S...\\n....\\n...T" }
tasks.near = { type = "crop", of = "maze", rows = [1, 3], columns = [2, 4], budget = 50 }
transfers = [{ source = "near", target = "maze", mapping = "same_position" }]
[arms.sources]
[arms.phi]
transfers = []
potential = "own:levels"
shaping = "QInitialisation"
"""
PLACE = "study.toml, line 12: arms.phi.potential is refused: "


@pytest.fixture
def study(read, tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    return lambda *changes: read(changed(STUDY, *changes))


@pytest.mark.usefixtures("quick_disk")
def test_a_study_is_run_judged_and_resumed(study, tmp_path):
    results = run_study(study(), tmp_path / "out")
    how = {"eval_freq": results.record.eval_freq, "seeds": range(8), "stream": "maze"}
    shaping = cr.QInitialisation(in_pairs(GOOD))
    alone = cr.learn(MAZE, budget=results.record.total, shaping=shaping, **how)
    stored = results.result("phi", "maze")
    np.testing.assert_array_equal(stored.greedy_return, alone.greedy_return)
    np.testing.assert_array_equal(stored.training_return, alone.training_return)
    comparison = results.comparison
    assert "phi, placebo" in comparison.arms
    assert "sources, random start" in comparison.arms
    assert "phi, random start" not in comparison.arms
    assert {"sources", "phi"} == {*comparison.verdicts}
    assert comparison["phi"].curve.source_steps.max() == 0
    groups = {section.arms: section for section in results.analysis.sections}
    (certificate,) = groups["phi",].certificates
    assert certificate.holds
    (tmp_path / "own.py").write_text(OWN.replace("0.9", "-0.9"))
    before = {arm: results.result(arm, "maze").training_return for arm in ("phi", "sources")}
    after = run_study(study(), tmp_path / "out", resume=True)
    changed_arms = {
        arm
        for arm, curves in before.items()
        if not np.array_equal(after.result(arm, "maze").training_return, curves, equal_nan=True)
    }
    assert changed_arms == {"phi"}


def test_the_modules_digest_is_in_the_keys(study, tmp_path):
    before = Arms.of(study())
    assert "own.py" in before.dependencies["phi", "maze"]["code"]
    (tmp_path / "own.py").write_text(f"{OWN}# changed\n")
    after = Arms.of(study())
    differ = {arm for arm, task in before.keys if before.keys[arm, task] != after.keys[arm, task]}
    assert {arm.partition(",")[0] for arm in differ} == {"phi"}
    assert before.keys["scratch", "maze"] == after.keys["scratch", "maze"]


def test_a_check_forecasts_it(study, curricle):
    study(("seeds = 8", 'seeds = "0-7"'))
    code, out, complaint = curricle("check", "study.toml", "--forecast")
    assert code == 0, complaint
    assert "a potential by hand for maze" in out
    assert "Forecast for 'maze'" in out.partition("arm phi\n")[2]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("own:levels", "own:short"), "must have shape (12, 4): got (3, 4)"),
        (("own:levels", "own:infinite"), "must be finite: entry (0, 0) is inf"),
        (("own:levels", "own:failing"), "own:failing failed: AttributeError"),
        (("own:levels", "own:knwn"), "knwn to call, did you mean 'known'?"),
        (("transfers = []\n", "\n"), "'maze' has one by hand and the source 'near'"),
    ],
)
def test_mistakes_are_named_with_their_place(study, change, words):
    with pytest.raises(ConfigError) as refusal:
        Arms.of(study(change))
    (line,) = str(refusal.value).splitlines()
    assert PLACE in line
    assert words in line


def test_it_must_be_named_as_a_function(study):
    with pytest.raises(ConfigError, match=r"line 12: .*potential must name a function as module:"):
        study(("own:levels", "known"))


def test_an_audit_and_a_sweep_take_it(study):
    without_controls = 'controls = ["placebo", "negated", "random_start"]', ""
    fair = as_fair(study(without_controls), 2)
    assert {"phi", "sources"} <= {of.arm for of in fair.tune.variants.values()}
    alone = study(
        without_controls,
        ('potential = "own:levels"', ""),
        ("[arms.sources]\n", ""),
        ("[arms.phi]", '[sweep]\npotential = ["own:known", "own:levels"]\n[arms.phi]'),
    )
    phis = [plan.potential["maze"].values for plan in alone.curricula.values()]
    np.testing.assert_array_equal(phis[1], in_pairs(phis[0]))
