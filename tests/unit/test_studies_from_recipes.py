"""A recipe applied: the study that is written trains the curriculum that the recipe means."""

import numpy as np
import pytest

from curricle.curriculum.curriculum import Curriculum
from curricle.design import Recipe, Relation, Stage, Trend
from curricle.errors import ConfigError, CurricleError
from curricle.study import StoredRecipe, read_study, study_text
from curricle.study.arms import Arms

MAZE = ("maze", {"pits": 0.2, "walls": 0.1}, {"size": 6, "seed": 1})
HUNT = ("pursuit", {"torus": True}, {"size": 4, "predators": 2})
LAKE = ("frozen_lake", {"map": "random"}, {"size": 5, "seed": 2})
ROOMS = ("four_rooms", {}, {})
CORNER = Stage(Relation("crop", 0.5), 40)
CHASE = Stage(Relation("member", changes={"predators": 1}), Trend(9.0, 0.5, 50.0, [(8.0, 0.5)] * 3))
APPLIED = {
    "crop": (MAZE, Recipe([CORNER])),
    "chain": (MAZE, Recipe([Stage(Relation("crop", share), 30) for share in (0.35, 0.7)])),
    "side by side": (
        MAZE,
        Recipe(
            [Stage(Relation("crop", 0.35), 30), CORNER], chain=False, aggregate="maximum", scale=3
        ),
    ),
    "annealed": (
        MAZE,
        Recipe([Stage(Relation("crop", one), 30) for one in (0.35, 0.7)], annealed=True),
    ),
    "starts": (MAZE, Recipe([Stage(Relation("starts", 0.5), 30)])),
    "chain of starts": (MAZE, Recipe([Stage(Relation("starts", one), 30) for one in (0.3, 0.7)])),
    "members": (HUNT, Recipe([CHASE], aggregate="minimum", scale=Trend(2.0, 0.1, 100.0))),
    "chain of members": (
        HUNT,
        Recipe([Stage(Relation("member", changes={"size": "0.5 n", "predators": 1}), 9), CHASE]),
    ),
    "settled": (MAZE, Recipe([Stage(Relation("crop", 0.5), 400, settled=True)])),
    "calibrated": (HUNT, Recipe([Stage(CHASE.relation, 50)], scale="calibrated")),
    "guarded": (MAZE, Recipe([CORNER], shaping="guarded")),
    "look-ahead": (MAZE, Recipe([CORNER], shaping="look-ahead")),
    "state": (MAZE, Recipe([CORNER], shaping="state")),
    "lake": (LAKE, Recipe([CORNER])),
    "rooms": (ROOMS, Recipe([CORNER])),
    "member of a maze": (MAZE, Recipe([Stage(Relation("member", changes={"size": "n - 2"}), 9)])),
}


def applied(family, recipe, place, *, budget=3000, **more):
    name, defaults, given = family
    stored = StoredRecipe(recipe, name, defaults, **more)
    path = place / "study.toml"
    path.write_text(study_text(stored, given, budget=budget, seeds=2, file=path))
    return read_study(path), stored.of_family()(**given)


def of_nodes(plan: Curriculum, name):
    """What a task is learnt with, but for mappings and an aggregate, which are compared apart."""
    node = plan.node(name)
    edges = plan.in_edges(name)
    shaping = node.shaping if edges else None
    each = [(one.source, one.scale, one.shift, one.calibration) for one in edges]
    return node.task, node.budget, node.learner, shaping, node.evaluation, node.eval_freq, each


@pytest.mark.parametrize("name", APPLIED)
def test_the_study_trains_the_curriculum_of_the_recipe(tmp_path, name):
    family, recipe = APPLIED[name]
    study, member = applied(family, recipe, tmp_path)
    ours, theirs = study.curriculum("recipe"), recipe.curriculum(member, budget=3000)
    assert ours.order == theirs.order
    for one in ours.order:
        assert of_nodes(ours, one) == of_nodes(theirs, one)
        for own, other in zip(ours.in_edges(one), theirs.in_edges(one), strict=True):
            assert np.array_equal(own.mapping.index, other.mapping.index)
    seeds = range(2)
    found, wanted = ours.train(seeds), theirs.train(seeds)
    for one in ours.order:
        assert np.array_equal(found[one].greedy_return, wanted[one].greedy_return)
        assert np.array_equal(found[one].steps_used, wanted[one].steps_used)


@pytest.mark.parametrize("name", ["crop", "members"])
def test_scratch_is_an_arm_too(tmp_path, name):
    study, _ = applied(*APPLIED[name], tmp_path)
    arms = Arms.of(study)
    assert list(arms.curricula) == ["scratch", "recipe"]
    assert arms.budget == 3000


def test_the_family_with_its_defaults_stands_once(tmp_path):
    study, member = applied(*APPLIED["members"], tmp_path)
    text = (tmp_path / "study.toml").read_text()
    assert text.count("torus = true") == 1
    assert member["torus"]
    assert study.curriculum("recipe").tasks["target"] == member.task


def test_numbers_say_where_they_come_from(tmp_path):
    draws = [(20.0, 0.0), (60.0, 0.0)]
    stage = Stage(Relation("crop", 0.5), Trend(40.0, draws=draws))
    judgement = {
        "problems": ["a", "b"],
        "seeds": 4,
        "problems_paid": 1,
        "saving": {"estimate": 0.25, "low": 0.125, "high": 0.5, "confidence": 0.95, "n": 4},
        "cost": {},
    }
    applied(MAZE, Recipe([stage]), tmp_path, judgement=judgement)
    text = (tmp_path / "study.toml").read_text()
    states = read_study(tmp_path / "study.toml").curriculum("recipe").tasks
    crop = next(task for name, task in states.items() if name != "target")
    low, high = (np.percentile([20, 60], tail) * crop.states.size for tail in (2.5, 97.5))
    comment = f"# 40 steps a state x {crop.states.size} states; 95 % interval"
    assert f"{comment} {low:.4g} to {high:.4g} steps" in text
    assert "saved 25% [12%, 50%] of the steps from scratch, in 1 of 2 problems" in text


def test_a_recipe_without_sources_is_a_study_of_the_target_alone(tmp_path):
    study, member = applied(MAZE, Recipe(), tmp_path)
    arms = Arms.of(study)
    (plan,) = arms.curricula.values()
    assert plan.order == ("target",)
    assert plan.tasks["target"] == member.task
    assert plan.node("target").budget == 3000
    assert "no curriculum: the target is learnt alone" in (tmp_path / "study.toml").read_text()


def test_the_learner_is_that_of_the_recipe(tmp_path):
    study, _ = applied(MAZE, Recipe([CORNER]), tmp_path, learner={"type": "SARSA", "epsilon": 0.3})
    plan = study.curriculum("recipe")
    assert {type(plan.node(one).learner).__name__ for one in plan.order} == {"SARSA"}
    assert {plan.node(one).learner.epsilon for one in plan.order} == {0.3}


def test_a_family_of_ones_own_is_looked_up_beside_the_file(tmp_path):
    (tmp_path / "own.py").write_text(
        "import curricle as cr\n"
        "from curricle.tasks import Parameter, task_family\n"
        "@task_family(Parameter('length', low=2, harder='larger'))\n"
        "def corridor(length: int, discount: float = 0.9):\n"
        "    return cr.GridWorld('S' + '.' * (length - 2) + 'T', discount=discount)\n"
    )
    family = ("own:corridor", {"discount": 0.8}, {"length": 9})
    recipe = Recipe([Stage(Relation("member", changes={"length": "0.5 n"}), 30)])
    study, member = applied(family, recipe, tmp_path, folder=tmp_path)
    plan = study.curriculum("recipe")
    assert plan.tasks["target"] == member.task
    assert [one.states.size for one in plan.tasks.values()] == [5, 9]


@pytest.mark.parametrize(
    ("family", "relation"),
    [
        (MAZE, Relation("removed", which="no pit")),
        (LAKE, Relation("deterministic")),
        (MAZE, Relation("bottleneck", 0.5)),
        (("taxi", {}, {}), Relation("coarser", which="row by 2")),
        (("river_swim", {}, {}), Relation("crop", 0.5)),
    ],
)
def test_what_a_study_cannot_say_names_the_call(tmp_path, family, relation):
    name, defaults, given = family
    stored = StoredRecipe(Recipe([Stage(relation, 30)]), name, defaults)
    try:
        stored.recipe.sources(stored.of_family()(**given))
    except CurricleError as error:
        pytest.fail(f"the example has no such source: {error}")
    with pytest.raises(ConfigError, match=r"a study file cannot say .*recipe\.curriculum\(member"):
        study_text(stored, given, budget=1000, seeds=1, file=tmp_path / "study.toml")


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"sise": 5}, "did you mean 'size'"),
        ({"size": 1}, "size of maze must be a whole number, at least 2: got 1"),
        ({"size": "big"}, "size of maze must be a whole number"),
    ],
)
def test_a_wrong_parameter_is_named(given, text):
    with pytest.raises(CurricleError, match=text):
        study_text(StoredRecipe(Recipe(), "maze"), given, budget=1000, seeds=1)


def test_a_target_without_such_a_source_says_so():
    recipe = Recipe([Stage(Relation("member", changes={"predators": 2}), 30)])
    with pytest.raises(CurricleError, match="a parameter of maze must be one of"):
        study_text(StoredRecipe(recipe, "maze"), {}, budget=1000, seeds=1)
