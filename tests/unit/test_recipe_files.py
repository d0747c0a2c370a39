"""Recipes as files: they come back as they were, and mistakes in them are named by key."""

import numpy as np
import pytest

from curricle.design import Ledger, Recipe, Relation, Stage, Trend
from curricle.errors import ConfigError
from curricle.study import StoredRecipe, read_recipe, recipe_text
from curricle.study.recipes.recipe_tables import compact, recipe_data

DRAWS = [(40.0, 0.5), (60.0, 0.4), (55.0, 0.6)]
CHAIN = Recipe(
    [
        Stage(Relation("member", changes={"size": "0.5 n", "time_limit": None}), 30),
        Stage(Relation("crop", 0.7), Trend(50.0, 0.5, 40.0, DRAWS), settled=True),
    ],
    chain=False,
    aggregate="minimum",
    scale=Trend(2.0, -0.25, 30.0),
    shaping="guarded",
)
JUDGEMENT = {
    "problems": ("size=4", "size=5"),
    "seeds": 3,
    "problems_paid": 2,
    "saving": {"estimate": 0.4, "low": 0.3, "high": 0.5, "confidence": 0.95, "n": 3},
    "cost": {"recipe": 0.6, "half the size": 0.7},
}
LEDGER = Ledger(prices={"miniatures": 0.5}).book(miniatures=2000)


def text_of(recipe=CHAIN, **more):
    return recipe_text(StoredRecipe(recipe, "maze", **more), ["Some words: a = [1."])


@pytest.fixture
def read(tmp_path):
    def read_text(text):
        (tmp_path / "recipe.toml").write_text(text, "utf-8")
        return read_recipe(tmp_path / "recipe.toml")

    return read_text


def test_all_that_is_stored_comes_back(read):
    learner = {"type": "SARSA", "epsilon": {"type": "linear", "first": 0.5, "last": 0, "steps": 9}}
    given = {"defaults": {"pits": 0.1, "time_limit": "none"}, "learner": learner}
    found = read(text_of(**given, judgement=JUDGEMENT, ledger=LEDGER))
    assert recipe_data(found.recipe) == recipe_data(CHAIN)
    assert (found.family, found.defaults, found.learner) == ("maze", *given.values())
    assert found.judgement == JUDGEMENT
    assert found.ledger == LEDGER
    assert found.of_family()()["time_limit"] is None


def test_a_recipe_by_hand_needs_few_keys(read):
    found = read("family = 'maze'\n[[stages]]\nkind = 'crop'\nshare = 0.5\nsteps = 40")
    assert recipe_data(found.recipe) == recipe_data(Recipe([Stage(Relation("crop", 0.5), 40)]))
    assert found.ledger is None


def test_a_family_may_have_parameters_that_are_keys_of_a_stage(read):
    recipe = Recipe([Stage(Relation("member", changes={"steps": 3, "kind": "0.5 n"}), 40)])
    found = read(recipe_text(StoredRecipe(recipe, "own:family")))
    assert recipe_data(found.recipe) == recipe_data(recipe)


def test_the_interval_survives_in_few_draws():
    draws = np.random.default_rng(0).lognormal(size=200)
    constant = Trend(30.0, draws=[(one, 0.0) for one in draws])
    rising = Trend(30.0, 0.5, 20.0, [(one, 0.5 + one / 10) for one in draws])
    kept = compact(Recipe([Stage(Relation("crop", 0.5), one) for one in (constant, rising)]))
    few, all_of_them = (one.steps for one in kept.stages)
    assert len(few.draws) == 41
    assert len(all_of_them.draws) == 200
    for found, whole in ((few, constant), (all_of_them, rising)):
        assert found.interval(50) == pytest.approx(whole.interval(50), rel=1e-3)


@pytest.mark.parametrize(
    ("old", "new", "line", "text"),
    [
        ("chain = false", "chian = false", 5, "chian is unknown, did you mean 'chain'?"),
        ("chain = false", "chain = 1", 5, "chain must be true or false: got 1"),
        ('"minimum"', '"minimal"', 6, "aggregate must be one of mean, minimum, maximum, total"),
        ('"guarded"', '"guarde"', 7, "shaping must be one of initialise, guarded"),
        ("level = 2.0", "level = '2'", 11, "scale.level must be a number: got '2'"),
        ("level = 2.0", "level = -2", 10, "scale is refused: level of a trend must be above 0"),
        ('kind = "crop"', 'kind = "crap"', 21, "stages[1] is refused: the kind of a relation"),
        ("steps = 30.0", "steps = 0", 19, "stages[0].steps must be above 0: got 0"),
        ("steps = 30.0", "steps = 'n'", 19, "stages[0].steps must be a number, or a table"),
        ("steps = 30.0", "", 15, "stages[0].steps is missing"),
        ("share = 0.7", "share = 1.5", 21, "stages[1] is refused: the share of a relation"),
        ("size = ", "sise = ", 17, "stages[0].sise is unknown, did you mean 'size'?"),
        ('family = "maze"', 'family = "mace"', 4, "family must be one of maze, pursuit"),
        ("settled = true", "settled = 'yes'", 24, "stages[1].settled must be true or false"),
    ],
)
def test_a_mistake_is_named_by_its_key(read, old, new, line, text):
    written = text_of()
    assert old in written
    with pytest.raises(ConfigError) as error:
        read(written.replace(old, new, 1))
    assert f"recipe.toml, line {line}: {text}" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("table", "text"),
    [
        ("[ledger]\nsteps = { miniatures = 3 }", "ledger is refused: the price of miniatures"),
        ("[ledger]\nsteps = { sweets = 3 }", "ledger is refused: a class of steps must be one of"),
        ("[judgement]\nseeds = 3", "judgement.problems is missing"),
        ("[defaults]\nfamily = 'maze'", "defaults.family must stand above the tables"),
        ("[defaults]\npits = 2", "defaults.pits must lie in [0, 1]: got 2"),
        ("[learner]\ntype = 'Q'", "learner.type must be one of QLearning"),
    ],
)
def test_so_is_one_in_what_was_measured(read, table, text):
    with pytest.raises(ConfigError) as error:
        read(f"family = 'maze'\n{table}")
    assert text in str(error.value)


def test_a_file_that_was_cut_short_is_refused_wherever_it_was(read):
    whole = text_of(defaults={"pits": 0.1}, judgement=JUDGEMENT, ledger=LEDGER)
    assert read(whole).defaults == {"pits": 0.1}
    cut = 0
    for end in range(0, len(whole.rstrip()), 3):
        with pytest.raises(ConfigError) as error:
            read(whole[:end])
        cut += "end is missing, the last table: the file was cut short" in str(error.value)
    assert cut > 50  # of which TOML says nothing: most are between two keys


def test_a_file_by_hand_needs_no_end_and_may_have_one(read):
    short = "family = 'maze'\n[[stages]]\nkind = 'crop'\nshare = 0.5\nsteps = 40"
    assert len(read(short).recipe.stages) == len(read(f"{short}\n[end]").recipe.stages) == 1
    with pytest.raises(ConfigError, match=r"line 1: last_table must be 'end': got 'fin'"):
        read(f"last_table = 'fin'\n{short}")
    with pytest.raises(ConfigError, match=r"end\.this is unknown"):
        read(f"{short}\n[end]\nthis = 1")


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.toml cannot be read: No such file"):
        read_recipe(tmp_path / "none.toml")
