"""``curricle design`` and ``curricle apply``: what they write, exit codes, and refusals."""

import subprocess
import sys
from pathlib import Path

import pytest

from curricle.errors import ConfigError, CurricleError
from curricle.study import read_design, read_recipe, study_text
from curricle.study.config.templates import DESIGN, template
from curricle.study.recipes.designing import parameters_of, run_design

SMALL = """
family = "maze"
[defaults]
pits = 0.2
[miniatures]
size = [4, 5]
seed = 3
[training]
steps = 10_000
[others]
size = 4
seed = [1, 2]
"""
RECIPE = """
family = "maze"
[[stages]]
kind = "crop"
share = 0.5
steps = 40
"""
CORRIDOR = """
import curricle as cr
from curricle.tasks import Parameter, task_family
@task_family(Parameter("length", values=[3]))
def corridor(length=3):
    return cr.GridWorld("S.T")
@task_family(Parameter("length", low=2, high=3, harder="larger"))
def short(length: int, discount: float = 0.9):
    return cr.GridWorld("ST", discount=discount)
@task_family(Parameter("length", low=2, high=9, harder="larger"))
def walled(length: int):
    return cr.GridWorld("S" + "." * length + "#T")
@task_family(Parameter("length", low=2, high=9, harder="larger"))
def broken(length: int):
    if length < 6:
        raise RuntimeError("no such room")
    return cr.GridWorld("S" + "." * length + "T")
"""


def curricle(*arguments, cwd):
    return subprocess.run(
        [sys.executable, "-m", "curricle", *arguments], cwd=cwd, capture_output=True, text=True
    )


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "small.toml").write_text(SMALL)
    (tmp_path / "recipe.toml").write_text(RECIPE)
    (tmp_path / "own.py").write_text(CORRIDOR)
    return tmp_path


def sentence(done):
    """The one sentence of a refusal."""
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr
    (line,) = [one for one in done.stderr.splitlines() if "importing the study's" not in one]
    return line


def test_from_a_design_to_a_study_that_is_trained(folder):
    small = ("design", "small.toml", "--budget", "150_000", "--out", "small_recipe.toml")
    done = curricle(*small, cwd=folder)
    assert done.returncode == 0, done.stderr
    assert "The search cost:" in done.stdout
    stored = read_recipe(folder / "small_recipe.toml")
    assert stored.defaults == {"pits": 0.2}
    assert stored.ledger.cost <= 150_000
    assert stored.ledger.steps["miniatures"] == stored.ledger.total_steps
    assert stored.judgement["problems"] == ("size=4, seed=3", "size=5, seed=3")
    written = (folder / "small_recipe.toml").read_bytes()
    page = (folder / "small_recipe.html").read_bytes()
    assert "Open small_recipe.html" in done.stdout
    assert b"<h1>A recipe for maze</h1>" in page

    assert "small_recipe.trainings.jsonl is there already: go on with --resume" in sentence(
        curricle(*small, cwd=folder)
    )
    assert curricle(*small, "--resume", cwd=folder).returncode == 0
    assert (folder / "small_recipe.toml").read_bytes() == written
    assert (folder / "small_recipe.html").read_bytes() == page
    again = curricle(*small[:-1], "again.toml", cwd=folder)
    assert again.returncode == 0
    assert (folder / "again.toml").read_bytes() == written

    member = ("--to", "size=6, seed=9", "--budget", "4_000", "--seeds", "3")
    done = curricle("apply", "small_recipe.toml", *member, cwd=folder)
    assert done.returncode == 0, done.stderr
    done = curricle("check", "study.toml", cwd=folder)
    assert done.returncode == 0, done.stderr
    done = curricle("run", "study.toml", "--seeds", "1", cwd=folder)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ("miniatures.sise=3", "miniatures.sise is unknown, did you mean 'size'?"),
        ("miniatures.size=[4, 1]", "miniatures.size[1] must be a whole number, at least 2: got 1"),
        ("miniatures.size=[]", "miniatures.size must have a value: got an empty list"),
        ("others=3", "others must be a table of members: got 3"),
        ("traning.steps=3", "traning.steps is unknown, did you mean 'step'?"),
        ("defaults.pits=3", "defaults.pits must lie in [0, 1]: got 3"),
        ("training.fraction=3", "training.fraction must lie in [0, 1]: got 3"),
        ("training.steps=-1", "training.steps must be at least 1: got -1"),
        ("training.steps={ size = { 4 = 0 } }", "training.steps must be at least 1: got 0"),
        ("training.eval_freq=0", "training.eval_freq must be at least 1: got 0"),
        ("training.steps=x", "training.steps must be a whole number: got 'x'"),
        ("training.steps={ size = { 4 = 9 } }", "training.steps.size has no steps for maze(size=5"),
        ("training.steps={ 4 = 9 }", "training.steps must be a number, or a table by one param"),
        ("training.stepz=9", "training.stepz is unknown, did you mean 'steps'?"),
        ("learner={ type = 'deep' }", "learner must be tabular"),
        ("learner.epsilon=2", "learner is refused: epsilon must lie in [0, 1]"),
        ("family=mazes", "family must be one of maze, pursuit"),
        ("family=own:maze", "family is refused: own:maze names no function: own has no maze"),
        ("defaults.size=9", ""),
    ],
)
def test_a_mistake_in_a_design_is_named_by_its_key(folder, change, text):
    if not text:
        assert read_design(folder / "small.toml", set=[change]).problems
        return
    with pytest.raises(ConfigError) as error:
        read_design(folder / "small.toml", set=[change])
    assert f"small.toml, as set: {text}" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["none.toml"], "none.toml cannot be read: No such file or directory"),
        (["own.py"], "own.py is not valid TOML"),
        (["small.toml", "--on", "mini"], "mini is unknown: known are miniatures, others"),
        (["small.toml", "--out", "recipe.toml"], "recipe.toml is there already"),
        (["small.toml"], "a training of size=4, seed=3 for 2 seeds may cost 20,000"),
    ],
)
def test_a_design_that_is_refused_is_a_sentence(folder, arguments, text):
    before = sorted(folder.iterdir())
    done = curricle("design", "--budget", "1000", "--out", "new.toml", *arguments, cwd=folder)
    assert text in sentence(done)
    assert [one for one in sorted(folder.iterdir()) if one.name[0] not in "._"] == before


def test_a_budget_too_small_for_one_race(folder):
    with pytest.raises(ConfigError) as error:
        run_design(folder / "small.toml", "miniatures", folder / "new.toml", budget=45_000)
    assert "small.toml: miniatures: a design for these problems needs a budget" in str(error.value)
    assert not (folder / "new.trainings.jsonl").exists()


def test_a_family_with_one_member(folder):
    (folder / "one.toml").write_text('family = "own:corridor"\nminiatures = { length = 3 }')
    done = curricle("design", "one.toml", "--budget", "9_000_000", "--out", "new.toml", cwd=folder)
    assert "family must have several members: own:corridor has one" in sentence(done)


def test_a_family_without_sources(folder):
    file = folder / "short.toml"
    file.write_text('family = "own:short"\nminiatures = { length = 2 }')
    with pytest.raises(
        ConfigError, match=r"short\.toml: miniatures: a race needs a recipe that has sources"
    ):
        run_design(file, "miniatures", folder / "new.toml", budget=90_000_000)


def test_a_goal_that_is_never_reached_is_nothing_to_learn(folder):
    (folder / "walled.toml").write_text('family = "own:walled"\nminiatures = { length = [3, 4] }')
    new = folder / "new.toml"
    with pytest.raises(ConfigError, match=r"something to learn: in length=3 the random policy's"):
        run_design(folder / "walled.toml", "miniatures", new, budget=900_000)
    assert not new.with_suffix(".trainings.jsonl").exists()


def test_a_family_that_fails_is_named(folder):
    (folder / "broken.toml").write_text('family = "own:broken"\nminiatures = { length = [3, 8] }')
    with pytest.raises(ConfigError, match="own:broken failed: RuntimeError: no such room"):
        read_design(folder / "broken.toml")


def test_so_is_one_that_fails_in_a_source(folder):
    (folder / "broken.toml").write_text('family = "own:broken"\nminiatures = { length = 8 }')
    done = curricle("design", "broken.toml", "--budget", "9_000_000", "--out", "n.toml", cwd=folder)
    assert done.returncode == 3
    assert "own:broken failed in a design" in done.stderr.splitlines()[-1]
    assert not (folder / "n.toml").exists()


def test_or_in_a_source_of_a_study(folder):
    stage = '{ kind = "member", length = "0.5 n", steps = 9 }'
    (folder / "broken.toml").write_text(f'family = "own:broken"\nstages = [{stage}]')
    stored = read_recipe(folder / "broken.toml")
    with pytest.raises(ConfigError, match="own:broken failed: RuntimeError: no such room"):
        study_text(stored, {"length": 8}, budget=9, seeds=1)


@pytest.mark.parametrize(
    ("out", "text"),
    [
        ("small.toml", "a recipe needs a file of its own: small.toml is the file of the design"),
        (".", "a recipe needs a file of its own: . is a folder"),
        ("own.py", "own.py cannot be resumed: its trainings, own.trainings.jsonl, are not beside"),
    ],
)
def test_a_recipe_takes_no_other_file_s_place(folder, out, text):
    before = {one: one.read_bytes() for one in folder.iterdir()}
    asked = ("design", "small.toml", "--budget", "150_000", "--resume", "--out", out)
    assert text in sentence(curricle(*asked, cwd=folder))
    assert {one: one.read_bytes() for one in before} == before


@pytest.mark.parametrize(
    ("to", "text"),
    [
        ("sise=10", "a parameter of maze must be one of size, walls"),
        ("sise=10", "got 'sise', did you mean 'size'?"),
        ("size=1", "size of maze must be a whole number, at least 2: got 1"),
        ("size=ten", "size of maze must be a whole number, at least 2: got 'ten'"),
        ("size", "parameters are given as size=10, predators=3: got 'size'"),
        ("", "parameters are given as size=10, predators=3: got ''"),
        ("size=3,", "parameters are given as size=10, predators=3: got 'size=3,'"),
        ("size=3, size=4", "parameters are given as size=10, predators=3"),
        ("size=2", "has no source that is a crop 0.5"),
    ],
)
def test_a_target_that_is_refused_is_named(folder, to, text):
    with pytest.raises(CurricleError) as error:
        study_text(read_recipe(folder / "recipe.toml"), parameters_of(to), budget=9, seeds=1)
    assert text in str(error.value)
    assert "\n" not in str(error.value)


def test_at_the_shell_too(folder):
    done = curricle("apply", "recipe.toml", "--to", "sise=10", cwd=folder)
    assert "got 'sise', did you mean 'size'?" in sentence(done)
    assert not (folder / "study.toml").exists()


def test_a_study_that_is_there_is_not_overwritten(folder):
    (folder / "study.toml").write_text("mine")
    done = curricle("apply", "recipe.toml", "--to", "size=6", cwd=folder)
    assert "a new study needs a new file: study.toml is there already" in sentence(done)
    assert (folder / "study.toml").read_text() == "mine"


def test_a_recipe_without_sources_says_so(folder):
    (folder / "none.toml").write_text('family = "maze"')
    done = curricle("apply", "none.toml", "--to", "size=6", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert "The recipe has no sources: the study learns the target alone." in done.stdout


@pytest.mark.parametrize("arguments", [["small.toml"], ["small.toml", "--budget", "much"]])
def test_a_design_needs_a_budget(folder, arguments):
    assert curricle("design", *arguments, cwd=folder).returncode == 2


def test_the_template_is_a_design(tmp_path):
    done = curricle("new", DESIGN, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "design.toml").read_text("utf-8") == template(DESIGN)
    plan = read_design(tmp_path / "design.toml")
    assert len(plan.problems) == 6
    assert {one.steps for one in plan.problems} == {30_000}
    assert all(one.miniature for one in plan.problems)


def test_steps_may_be_by_a_parameter(folder):
    steps = "training.steps={ size = { 4 = 900, 5 = 1_000 } }"
    plan = read_design(Path(folder) / "small.toml", set=[steps, "training.eval_freq=9"])
    assert [(one.target["size"], one.steps, one.eval_freq) for one in plan.problems] == [
        (4, 900, 9),
        (5, 1000, 9),
    ]


def test_a_threshold_may_be_given(folder):
    plan = read_design(folder / "small.toml", set=["training.threshold=90"])
    assert [one.level for one in plan.problems] == [90.0, 90.0]


def test_values_in_lists_are_combined_once(folder):
    twice = "miniatures.seed=[2, 1, 2]"
    plan = read_design(Path(folder) / "small.toml", set=[twice])
    sizes = [one.task.states.size for one in plan.problems]
    assert sizes == sorted(sizes)
    assert {(one.target["size"], one.target["seed"]) for one in plan.problems} == {
        (4, 1),
        (4, 2),
        (5, 1),
        (5, 2),
    }
