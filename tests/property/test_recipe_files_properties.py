"""A recipe of any kind comes back from its file exactly."""

from pathlib import Path
from tempfile import TemporaryDirectory

from hypothesis import given, settings, strategies as st

from curricle.design import KINDS, Recipe, Relation, Stage, Trend
from curricle.design.recipe import AGGREGATES, SHAPINGS
from curricle.study import StoredRecipe, read_recipe, recipe_text
from curricle.study.recipes.recipe_tables import recipe_data
from curricle.study.recipes.toml_text import toml_value

positive = st.floats(1e-300, 1e300)
finite = st.floats(allow_nan=False, allow_infinity=False)
draws = st.lists(st.tuples(positive, finite), max_size=5)
trends = st.builds(Trend, positive, finite, positive, draws) | positive.map(Trend.constant)
names = st.sampled_from(["size", "steps", "kind", "share", "changes", "a_b", "étage"])
text = st.text(st.characters(exclude_categories=["Cs"]), min_size=1)
values = st.one_of(
    st.booleans(),
    st.integers(-(2**63), 2**63),
    finite,
    st.none(),
    text.filter(lambda t: t != "none"),
)
members = st.builds(
    lambda changes: Relation("member", changes=changes),
    st.dictionaries(names, values, min_size=1, max_size=4),
)
others = st.builds(
    Relation,
    st.sampled_from([one for one in KINDS if one != "member"]),
    st.none() | st.floats(0, 1, exclude_min=True, exclude_max=True),
    st.just("") | text,
)
stages = st.builds(Stage, members | others, trends, st.booleans())
recipes = st.builds(
    Recipe,
    st.lists(stages, max_size=4),
    st.booleans(),
    st.sampled_from(list(AGGREGATES)),
    trends | st.just("calibrated"),
    st.sampled_from(list(SHAPINGS)),
    st.booleans(),
)


@settings(max_examples=150, deadline=None)
@given(recipes)
def test_it_comes_back_exactly(recipe):
    stored = StoredRecipe(recipe, "own:family")
    with TemporaryDirectory() as folder:
        path = Path(folder) / "recipe.toml"
        path.write_bytes(recipe_text(stored, ["Words", "", "more of them"]).encode())
        found = read_recipe(path)
        again = recipe_text(found)
    # As TOML, in which 1 is not 1.0, -0.0 is not 0.0, and tables have an order.
    assert toml_value(recipe_data(found.recipe)) == toml_value(recipe_data(recipe))
    assert str(found.recipe) == str(recipe)
    assert again == recipe_text(stored)
