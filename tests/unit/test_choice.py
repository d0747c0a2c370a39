"""Choosing a curriculum: halving, opponents, studies that choose first, and carrying over."""

import json
from dataclasses import replace

import numpy as np
import pytest

import curricle as cr
from curricle.comparison import choice as module
from curricle.comparison.comparison import Comparison
from curricle.comparison.measures import Arm, Reference
from curricle.comparison.plan import Plan, PlannedArm
from curricle.comparison.sentences import without_source
from curricle.errors import CurriculumError, SettingError, StudyError, TaskError
from curricle.statistics.curves import Curve
from curricle.study import StudyStore, merge, run_study
from curricle.study.tuning import (
    CHOICE,
    chosen_file,
    settled_before,
    trial_study as choice_trials,
)
from curricle.tasks import pursuit_family
from tests.support.comparisons import flat
from tests.support.executors import Inline

HUNT = """
name = "hunt"
seeds = 6
choose = true
budget = 20_000
learner.learning_rate = 0.2
tasks.hunt = { family = "pursuit", size = 3, predators = 2 }
"""
SEEDLESS = HUNT.replace("seeds = 6\n", "")
SMALL = """
name = "maze"
seeds = 2
choose = true
budget = 1_000
tasks.maze = { type = "maze", map = "S..T" }
"""
SETTINGS = {"budget": 20_000, "learner": cr.QLearning(learning_rate=0.2)}
MAZE = cr.GridWorld(["S....", ".....", "....T"], rewards=cr.Rewards(step=-1, treasure=20))


@pytest.fixture(scope="module", autouse=True)
def few_options():
    """Play each candidate at one source budget and scale, and finalists on half of the seeds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "SHARES", (0.05,))
        patch.setattr(module, "WAYS", ((2.0, False),))
        patch.setattr(module, "FINAL_SEEDS", 10)
        yield


@pytest.fixture(scope="module")
def hunt():
    """Return a target of which a curriculum pays."""
    return pursuit_family(size=3, predators=2)


@pytest.fixture(scope="module")
def choice(hunt):
    """Return its choice."""
    return cr.choose(hunt, **SETTINGS)


@pytest.fixture
def small(tmp_path):
    """Return the path of a study that chooses, and none pays."""
    path = tmp_path / "maze.toml"
    path.write_text(SMALL)
    return path


@pytest.fixture
def file(tmp_path):
    """Return the path of the study of that target."""
    path = tmp_path / "hunt.toml"
    path.write_text(HUNT)
    return path


# -- Halving, with made-up returns -----------------------------------------------------------------


def played(heights, opponents, noise=0.0, *, failing=()):
    """Return the rounds that are played where arms have these mean returns, as (names, seeds).

    Those of `failing` fail in the first round that they play.
    """
    rounds = []

    def play(plan, seeds, _):
        shown = [name for name in plan.arms if name in failing or name not in opponents]
        rounds.append((shown, seeds))
        arms = {}
        for place, name in enumerate(plan.arms):
            rng = np.random.default_rng([place, *seeds[:1]])
            flat = heights[name] + noise * rng.normal(size=(len(seeds), 1)) + np.zeros(3)
            source = np.zeros(len(seeds), np.int64)
            curve = Curve(np.array([0, 10, 20]), flat, source)
            arms[name] = Arm(curve, scratch=name in opponents)
        failed = {name: arms.pop(name) and ValueError("no") for name in failing if len(rounds) == 1}
        return Comparison(plan.target, arms, 20, 20, Reference(0.0), 1, failed)

    alone = cr.Curriculum({"maze": MAZE}, budget=20)
    arms = {name: PlannedArm(alone, {}, scratch=name in opponents) for name in heights}
    choice = module.chosen(Plan(arms, "maze", 20, 20, 10), play)
    assert all(f"{name} failed: ValueError: no" in choice.remarks for name in failing)
    return rounds


def test_each_round_keeps_the_better_half_on_further_seeds():
    heights = {"scratch": 0.0} | {f"c{n}": 1.0 + n / 1000 for n in range(20)}
    rounds = played(heights, ["scratch"], noise=0.2)
    assert [len(names) for names, _ in rounds[:3]] == [20, 10, 5]
    seeds = [seed for _, seeds in rounds for seed in seeds]
    assert len(set(seeds)) == len(seeds)
    assert min(seeds) == module.FIRST_SEED
    assert len(rounds[-1][0]) <= module.FINALISTS
    assert len(rounds[-1][1]) == module.FINAL_SEEDS


def test_halving_stops_when_the_best_is_clear_or_none_can_pay():
    heights = {"scratch": 0.0} | {f"c{n}": 10.0 * n for n in range(20)}
    assert [names for names, _ in played(heights, ["scratch"], noise=0.1)[1:]] == [["c19"]]
    heights = {"scratch": 0.0, "scratch, better": 9.0} | {f"c{n}": 1.0 for n in range(20)}
    assert len(played(heights, ["scratch", "scratch, better"], noise=0.1)) == 2


@pytest.mark.parametrize("arm", ["scratch, better", "c3"])
def test_an_arm_that_fails_in_a_round_plays_in_no_other(arm):
    """Its returns on the seeds of some rounds could not be paired with those of the others."""
    heights = {"scratch": 0.0, "scratch, better": 9.0} | {f"c{n}": 5.0 + n / 10 for n in range(8)}
    rounds = played(heights, ["scratch", "scratch, better"], noise=0.1, failing=[arm])
    assert arm in rounds[0][0]
    assert all(arm not in names for names, _ in rounds[1:])


# -- A choice in memory ----------------------------------------------------------------------------


def test_a_source_that_pays_is_chosen(hunt, choice):
    assert choice.curriculum.order == ("pursuit(size=2, predators=1)", "target")
    assert isinstance(choice.curriculum.setting("shaping", "target"), cr.QInitialisation)
    assert choice.curriculum.setting("shaping", "target").portfolio is None
    best = choice.rows[0]
    assert best["name"] == choice.name
    assert best["gain_low"] > 0
    assert choice.comparison.verdicts[choice.name].direction == 1
    # It pays on the seeds of an experiment too, against all opponents.
    fresh = cr.compare({"chosen": choice.curriculum}, seeds=10)
    assert fresh.verdicts["chosen"].direction == 1
    assert len(choice.rows) == 4
    assert {len(row) for row in choice.rows} == {8}
    assert any("constant" in name for name in choice.comparison.opponents(choice.name))
    first, heads, line, *_ = str(choice).splitlines()
    assert first.startswith(f"{choice.name}: gains ")
    assert choice.alone in first
    assert heads.split()[:2] == ["source", "steps"]
    assert line.startswith(choice.name)
    assert "<pre>" in choice._repr_html_()
    assert repr(choice).startswith("Choice(")


@pytest.mark.parametrize(("name", "level", "says"), [
    ("A", 6, "A: gains 6.00 [5.00, 7.00] in mean return on 7 fresh seeds more than the target's"),
    ("", 1, "no curriculum: none is shown to gain more than the target's own learner alone ("),
    ("", -6, "no curriculum: the target's own learner alone does better (the best, A, gains -6"),
])  # fmt: skip
def test_the_sentence_names_the_opponent_of_the_gain_and_what_is_shown(name, level, says):
    spread, constant = np.arange(-3.0, 4.0), {"scratch": True, "initial_values": np.zeros(7)}
    arms = {"scratch": flat(np.zeros(7)), "A": flat(level + spread / (2 if name else 1)),
            "B": flat(spread), "B, constant": flat(spread + 9, "B", **constant)}  # fmt: skip
    result = Comparison("maze", arms, 10, 10, Reference(0.5), 1)
    rows = ({"name": "A"},)
    choice = module.Choice(name, None, without_source(result, "A")[0], result, rows)
    assert choice.sentence.startswith(says)
    arms["A, constant"] = flat(level + spread + 9, "A", **constant)
    assert without_source(replace(result, arms=arms), "A")[0].endswith(
        "learner with initial_value=0"
    )


def test_equal_seeds_give_equal_choices_whatever_the_workers():
    how = {"kinds": ["crop"], "budget": 500}
    alone, together = (cr.choose(MAZE, workers=workers, **how) for workers in (1, 2))
    assert alone.rows == together.rows
    assert cr.choose(MAZE, seed=1, **how).rows != alone.rows


def test_curricula_of_the_user_are_candidates_and_progress_is_told(hunt, choice):
    told = []
    alone = cr.choose(hunt, {"mine": choice.curriculum}, kinds=(), progress=told.append)
    assert (alone.name, alone.curriculum) == ("mine", choice.curriculum)
    assert (told.count("mine"), "scratch" in told) == (2, True)
    both = cr.choose(hunt, [choice.curriculum], kinds=["removed"])
    assert both.name == "pursuit(size=2, predators=1)"
    assert len(both.rows) == 2


@pytest.mark.parametrize("learner", ["QLearning", "SARSA"])
def test_a_way_in_is_the_default_portfolio_where_the_learner_may_have_one(
    hunt, file, monkeypatch, learner
):
    monkeypatch.setattr(module, "WAYS", ((1.0, False), (1.0, True)))
    settings = {"budget": 20_000, "learner": getattr(cr, learner)()}
    in_memory, _ = module.trial_curricula(hunt, (), module.KINDS, module.MOST, settings)
    in_study = choice_trials(cr.read_study(file, set=[f"learner.type={learner}"])).curricula
    assert in_memory.keys() == in_study.keys()
    portfolio = cr.Portfolio()
    ways = [(False, None), (True, portfolio)] if learner == "QLearning" else [(False, None)]
    for curricula in (in_memory, in_study):
        shapings = {name: plan.setting("shaping", plan.target) for name, plan in curricula.items()}
        assert {type(shaping) for shaping in shapings.values()} == {cr.QInitialisation}
        found = {(name.endswith(", portfolio"), x.portfolio) for name, x in shapings.items()}
        assert found == {*ways}


def test_a_portfolio_is_carried_over(hunt, monkeypatch):
    monkeypatch.setattr(module, "WAYS", ((1.0, True),))
    target = pursuit_family(size=4, predators=2)
    _, options = module.trial_curricula(hunt, (), ["member"], 1, SETTINGS)
    carried, sentence = module._carried_over(target, *options.values(), hunt)
    plan = carried.curriculum("target", target.task, SETTINGS)
    assert plan.setting("shaping", "target").portfolio == cr.Portfolio()
    assert ", scale 1, in a portfolio: " in sentence


LIVE = cr.from_gymnasium("FrozenLake-v1", discount=0.99, live=True)
PLAN, ELSEWHERE = (cr.Curriculum({"t": of}, budget=300) for of in (MAZE, cr.GridWorld("S.T")))


@pytest.mark.parametrize(
    ("how", "error", "says"),
    [
        ({"kinds": ()}, CurriculumError, "candidates to choose from"),
        ({"candidates": "crop"}, CurriculumError, "curricula or SourceCandidates"),
        ({"candidates": [MAZE]}, CurriculumError, "curricula or SourceCandidates"),
        ({"kinds": ["near"]}, CurriculumError, "kind"),
        ({"seed": -1, "kinds": ["crop"]}, SettingError, "seed"),
        ({"budget": cr.Episodes(3)}, SettingError, "budget"),
        ({"candidates": [PLAN], "kinds": (), "budget": 77}, CurriculumError, "differs in budget"),
        ({"candidates": [ELSEWHERE], "kinds": ()}, CurriculumError, "differs in states"),
        ({"target": LIVE}, TaskError, "on="),
        ({"target": PLAN}, SettingError, r"call choose\(plan.tasks\['t'\], \[plan\]\)"),
    ],
)
def test_what_cannot_be_chosen_from_is_refused(how, error, says):
    with pytest.raises(error, match=says):
        cr.choose(**({"target": MAZE} | how))


# -- Carried over from a smaller relative ----------------------------------------------------------


def test_a_choice_is_carried_over_in_relative_terms(hunt, choice):
    target = pursuit_family(size=4, predators=2)
    states = target.task.states.size / hunt.task.states.size
    budget = round(20_000 * states)
    settings = {**SETTINGS, "budget": budget}
    carried = cr.choose(target, on=hunt, **settings)
    assert carried.name == choice.name
    source = carried.curriculum.order[0]
    there, here = choice.curriculum, carried.curriculum
    relation = [
        plan.tasks[plan.order[0]].states.size / plan.tasks["target"].states.size
        for plan in (there, here)
    ]
    assert 1 / 4 < relation[0] / relation[1] < 4
    assert "predators=1" in source
    steps = [plan.node(plan.order[0]).most_steps for plan in (there, here)]
    sizes = [plan.tasks[plan.order[0]].states.size for plan in (there, here)]
    assert steps[1] / sizes[1] == pytest.approx(steps[0] / sizes[0], abs=1)
    assert here.node("target").budget == budget
    assert {edge.scale for edge in here.transfers} == {edge.scale for edge in there.transfers}
    assert "carried over: a source of kind 'member'" in str(carried)


# -- In studies ------------------------------------------------------------------------------------


def test_a_study_and_memory_choose_alike(file, tmp_path):
    pool = Inline()
    run, choice = run_study(file, tmp_path / "out", executor=pool), cr.choose(file)
    assert run.record.chosen == str(choice)
    arms = list(run.comparison.controls)
    assert arms == [choice.name]
    assert run.comparison.verdicts[choice.name].seeds == 6
    settled = settled_before(cr.read_study(file), run.store.path)  # which `curricle play` plays
    assert settled.data == run.store.description["configuration"]


def test_sources_keep_the_values_that_their_target_does_not(hunt, choice, file):
    sparing = cr.Storage(save_values=False)
    assert str(cr.choose(hunt, **SETTINGS, storage=sparing)) == str(choice)
    study = cr.read_study(file, set=["storage.save_values=false"])
    trials = choice_trials(study).curricula.values()
    assert {plan.setting("storage", plan.target) for plan in trials} == {sparing}
    sources = [(plan, name) for plan in trials for name in plan.order if name != plan.target]
    assert {plan.setting("storage", name) for plan, name in sources} == {cr.Storage()}


def test_an_arm_with_a_potential_by_hand_is_chosen_from(file):
    file.with_name("own.py").write_text("def phi(task):\n    return [0.0] * len(task.states)\n")
    file.write_text(f'{HUNT}\n[arms.hand]\npotential = "own:phi"\n')
    assert "hand" in choice_trials(cr.read_study(file)).arms


@pytest.mark.parametrize("left", [0, 10])
def test_a_choice_resumes(small, tmp_path, left):
    folder, pool = tmp_path / "out", Inline()
    run = run_study(small, folder, executor=pool)
    before = run.record.chosen
    assert before.startswith("no curriculum: ")
    assert not run.comparison.controls
    settled = settled_before(cr.read_study(small), folder)
    assert settled.data == run.store.description["configuration"]
    trials = StudyStore(folder / CHOICE)
    units = sorted(trials.units(), key=lambda unit: unit.path)
    trials.remove([unit.path for unit in units[left:]])
    assert run_study(small, folder, resume=True, executor=pool).record.chosen == before
    said = []
    nothing = Inline(0)  # fails where anything is sent to it
    run_study(small, folder, resume=True, executor=nothing, report=said.append)
    assert said == []


def test_parts_choose_alike_and_are_merged(small, tmp_path):
    study = cr.read_study(small, set=["seeds=12"])
    parts = [tmp_path / "one", tmp_path / "two"]
    for k, part in enumerate(parts):
        run_study(study, part, shard=(k + 1, 2), executor=Inline())
    merged = merge(tmp_path / "merged", parts)
    assert len(merged.seeds) == 12
    assert merged.record.chosen
    assert StudyStore(tmp_path / "merged" / CHOICE).units()


def test_the_chosen_study_is_written_and_read_again(file, tmp_path):
    study, choice = cr.read_study(file), cr.choose(file)
    path = tmp_path / "chosen.toml"
    path.write_text(chosen_file(study, choice, tmp_path))
    written, chosen = cr.read_study(path), choice.curriculum
    (curriculum,) = written.curricula.values()
    assert not written.choose
    assert written.seeds == study.seeds
    assert curriculum.order == chosen.order
    for which in ("learner", "budget", "shaping", "aggregate"):
        assert curriculum.setting(which, "hunt") == chosen.setting(which, "hunt")
    source = chosen.order[0]
    assert curriculum.setting("budget", source) == chosen.setting("budget", source)
    pairs = zip(curriculum.transfers, chosen.transfers, strict=True)
    for edge, other in pairs:
        np.testing.assert_array_equal(edge.mapping.index, other.mapping.index)
        assert edge.scale == other.scale


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("sweep.learner.learning_rate = [0.1, 0.2]", "no sweep"),
        ("scratch = false", "comparison with scratch"),
        ("seeds = [2_000_000]", "below 2,000,000"),
        ('tasks.near = { type = "candidate", of = "hunt", kind = "odd", candidate = "x" }', "kind"),
        ('tasks.near = { type = "candidate", of = "h", kind = "crop", candidate = "x" }', "name"),
        (
            'tasks.near = { type = "candidate", of = "hunt", kind = "removed", candidate = "x" }\n'
            'transfers = [{ source = "near", target = "hunt", mapping = "candidate" }]',
            "no 'x'",
        ),
    ],
)
def test_a_study_that_cannot_choose_says_why(file, line, says):
    file.write_text(SEEDLESS + line)
    with pytest.raises(cr.CurricleError, match=says):
        _ = cr.read_study(file).curricula


def test_the_command_prints_and_writes(small, tmp_path, curricle):
    out = tmp_path / "chosen.toml"
    code, printed, _ = curricle("choose", small, "--out", out)
    assert code == 0
    assert "gains" in printed
    assert "curricle run" in printed
    assert not cr.read_study(out).choose
    code, data, complaint = curricle("choose", small, "--json", "--quiet")
    assert (code, complaint) == (0, "")
    assert printed.startswith(f"{json.loads(data)['sentence']}\n")
    assert json.loads(data)["rows"][0]["name"] in printed
    nowhere = tmp_path / "nowhere" / "chosen.toml"
    for place, says in ((out, "needs a new file"), (nowhere, "needs a folder that exists")):
        code, printed, complaint = curricle("choose", small, "--out", place)
        assert (code, printed) == (1, "")
        assert says in complaint


def test_show_says_how_far_a_choice_is_and_what_it_was(small, tmp_path, curricle):
    folder = tmp_path / "out"
    with pytest.raises(StudyError):
        run_study(small, folder, executor=Inline(20))
    shown = " ".join(curricle("show", folder)[1].split())
    assert "its arm is chosen first" in shown
    run = run_study(small, folder, resume=True, executor=Inline())
    assert run.record.chosen.splitlines()[0][:30] in curricle("show", folder)[1]
