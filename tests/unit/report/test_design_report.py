"""The page of a design: its numbers are those of the design."""

import re
from dataclasses import replace

import numpy as np
import pytest

from curricle.design import Problem, Recipe, SearchBudget
from curricle.design.ledger import Ledger
from curricle.design.racing import PLACEBO
from curricle.design.recipe import Stage
from curricle.design.recipe_design import design_recipe
from curricle.design.relations import Relation
from curricle.design.trends import Trend
from curricle.errors import StoreError
from curricle.report.design_figures import (
    BEYOND,
    CONTROLS,
    MOST_ROWS,
    SIZES,
    _percent,
    bracket,
    recipe_graph,
    scatter,
    trend_curve,
)
from curricle.report.design_report import design_page, write_design_report
from curricle.report.graph import CURVE
from curricle.report.templates import Script
from curricle.tasks import maze_family

from .studies import ODD, Reader


@pytest.fixture(scope="module")
def design():
    members = [maze_family(size=n, pits=0.2, seed=3) for n in (4, 5)]
    problems = [Problem(one, steps=20_000, miniature=True) for one in members]
    return design_recipe(problems, SearchBudget(700_000), standing={})


@pytest.fixture(scope="module")
def fruitless(design):
    """The same design where nothing was better than scratch."""
    steps = {name: np.full((2, 3), 100) for name in ("scratch", "recipe")}
    judged = replace(design.judgement, steps=steps)
    return replace(design, recipe=Recipe(), best=Recipe(), judgement=judged)


def words(page):
    return Reader(page).words


def test_the_words_on_top_are_those_of_the_design(design):
    text = words(design_page(design))
    for line in [design.why, *str(design.recipe).splitlines()]:
        assert re.sub(r"(?<![\w)\]])-(?=\d)", "−", line) in text
    scratch = design.judgement.steps["scratch"][-1].mean()
    largest = design.races[0].problems[-1].name
    assert f"{largest}, the largest miniature ({scratch:,.0f} steps)" in text
    assert str(design.break_even(scratch)).replace("-", "−") in text.replace("-", "−")


@pytest.mark.parametrize("size", SIZES)
def test_every_recipe_of_the_first_race_is_a_dot(design, size):
    first = design.races[0]
    plot = scatter(first, size)
    dots = {one.name: one for one in plot.dots}
    assert set(dots) == {*first.arms, "scratch", PLACEBO}
    scores = {name: score for one in first.rounds for name, score in one.scores.items()}
    for name, dot in dots.items():
        assert dot.saving == 1 - scores[name]
        assert dot.cost == first.source_share(name)
        assert 0 <= dot.x <= plot.width
        assert 0 <= dot.y <= plot.height
    for value, place, way in (("cost", "x", 1), ("saving", "y", -1)):
        ordered = sorted(dots.values(), key=lambda dot: getattr(dot, value))
        assert (np.diff([way * getattr(dot, place) for dot in ordered]) >= 0).all()
    assert (dots["scratch"].cost, dots["scratch"].y) == (0, plot.zero)
    assert [dot.name for dot in plot.dots if dot.winner] == [first.leader]
    assert {dot.name for dot in plot.dots if dot.kind != "arm"} == {"scratch", PLACEBO} | (
        {"half the size"} & set(first.arms)
    )
    heights = sorted(y for _, _, y, _ in plot.labels)
    assert (np.diff(heights) >= 12).all()


def test_dots_say_what_they_are_where_they_are_pointed_at(design):
    first, text = design.races[0], words(design_page(design))
    for name in first.arms:
        steps = np.concatenate(first.steps[name]).mean()
        sources = np.concatenate(first.source_steps[name]).mean()
        assert f"{steps:,.0f} steps a run, {sources:,.0f} of them in sources" in text


def test_rounds_and_rows_of_a_race(design):
    first = design.races[0]
    found = bracket(first)
    assert [one.runs for one in found.rounds] == [one.runs for one in first.rounds]
    assert found.cost == sum(one.cost for one in first.rounds)
    assert found.rounds[0].arms == len(first.arms)
    for row in found.rows:
        for (state, text), one in zip(row.cells, first.rounds, strict=True):
            if row.name not in one.scores:
                assert (state, text) == ("out", "")
            else:
                assert text.replace("−", "-") == f"{1 - one.scores[row.name]:.0%}"
        going = [state == "kept" for state, _ in row.cells]
        later = [row.name in one.scores for one in first.rounds[1:]] + [False]
        own = [row.name in one.scores for one in first.rounds]
        assert going == [a and b for a, b in zip(own, later, strict=True)]
    text = words(design_page(design))
    for one in first.rounds:
        assert f"{one.cost:,.0f} steps" in text


def test_of_many_recipes_the_best_are_shown_and_the_others_counted(design):
    first = design.races[0]
    (one, *_) = first.rounds
    more = {f"other {n}": 3.0 + n for n in range(30)}
    crowded = replace(
        first,
        arms=first.arms | dict.fromkeys(more, design.best),
        rounds=(replace(one, scores=one.scores | more), *first.rounds[1:]),
    )
    found = bracket(crowded)
    names = [row.name for row in found.rows]
    assert [name for name in names if name not in CONTROLS] == [
        name for name in crowded.ranking[:MOST_ROWS] if name not in CONTROLS
    ]
    assert {"scratch", PLACEBO} <= set(names)
    assert found.more + len(names) == len(crowded.arms) + 2


def test_the_ledger_has_the_classes_with_steps(design):
    text = words(design_page(replace(design, ledger=Ledger(prices={"sources": 0.5}).book(
        target=12_345, sources=6_000
    ))))  # fmt: skip
    assert "12,345" in text
    assert "18,345 environment steps" in text
    assert "3,000" in text
    page = design_page(design)
    assert f"{design.ledger.total_steps:,}" in words(page)
    assert "calibration" not in page


def test_the_judgement_is_shown_for_each_problem(design):
    page, judged = design_page(design), design.judgement
    table = page[page.index('<table class="judged">') :]
    table = table[: table.index("</table>")]
    rows = [re.findall(r">([\d.,]+)<", row) for row in table.split("<tr")[2:]]
    arms = [name for name in judged.steps if name not in ("scratch", PLACEBO)] + [PLACEBO]
    for p, row in enumerate(rows[:-1]):
        scratch = judged.steps["scratch"][p].mean()
        costs = [judged.steps[name][p].mean() / scratch for name in arms]
        assert row == [f"{scratch:,.0f}", *(f"{one:.2f}" for one in costs)]
    assert rows[-1][1:] == [f"{judged.cost(name):.2f}" for name in arms]
    assert len(rows) == 3


def test_a_design_may_say_no_curriculum(fruitless):
    page = design_page(fruitless)
    text = words(page)
    assert "No curriculum: nothing in the race was better" in text
    assert "learn the target alone" in text
    assert "it is not paid back" in text
    assert 'class="card' not in page
    assert "the search has paid" not in text
    assert "that was found saves" not in text


def test_what_was_not_shown_to_pay_is_called_so(design):
    text = words(design_page(replace(design, recipe=Recipe())))
    assert "Below is the best that was found." in text
    assert "The best that was found saves" in text
    assert "which may be none" in text


def test_a_standing_recipe_may_be_recommended(design):
    judged, own = design.judgement, Recipe([Stage(Relation("crop", 0.9), 77)])
    steps = dict(judged.steps) | {"elsewhere": judged.steps["scratch"] // 2}
    judged = replace(judged, steps=steps)
    stood = replace(design, recipe=own, standing="elsewhere", judgement=judged)
    page = design_page(stood)
    text = words(page)
    assert "crop 0.9 77 steps a state" in text
    assert "The recipe saves 50%" in text
    assert "Recommended is elsewhere, a standing recipe" in text
    assert ">best in the race</th>" in page
    scratch = judged.steps["scratch"][-1].mean()
    assert str(stood.break_even(scratch)) in text


def test_a_race_of_one_round(design):
    first = design.races[0]
    short = replace(first, rounds=first.rounds[:1], ended="what is left was too little")
    text = words(design_page(replace(design, races=(short,))))
    assert "It ended early: what is left was too little." in text
    assert "round 1" in text
    assert "round 2" not in text
    assert [state for row in bracket(short).rows for state, _ in row.cells].count("kept") == 0


def test_the_stages_are_cards_in_order():
    stages = [Stage(Relation("crop", share), 10 * n) for n, share in enumerate((0.3, 0.6), 1)]
    chain = recipe_graph(Recipe(stages, scale=2.0, shaping="look-ahead"), [9])
    assert [card.name for card in chain.cards] == ["crop 0.3", "crop 0.6", "target"]
    assert [card.words for card in chain.cards[:2]] == [
        ("10 steps a state",),
        ("20 steps a state",),
    ]
    assert [(source, target) for source, target, _ in chain.words] == [
        ("crop 0.3", "crop 0.6"),
        ("crop 0.6", "target"),
    ]
    assert "start of Q" in chain.words[0][2]
    assert chain.words[1][2] == "its values advise actions (look-ahead advice), times 2"
    beside = recipe_graph(Recipe(stages, chain=False, aggregate="minimum"), [9])
    assert [target for _, target, _ in beside.words] == ["target", "target"]
    assert all(how.endswith("the minimum of several") for _, _, how in beside.words)


def test_a_trend_is_a_curve_with_its_interval(design):
    draws = [(30.0, 0.4), (50.0, 0.6)]
    steps = Trend(40.0, slope=0.5, around=16.0, draws=draws)
    curve = trend_curve(steps, [9, 36])
    low, high = steps.interval(36)
    assert curve.words.endswith(f"60 [{low:.3g}, {high:.3g}] at 36")
    line, beyond, band = (
        np.array([point.split(",") for point in drawn.split()], float)
        for drawn in (curve.line, curve.beyond, curve.band)
    )
    assert (line[0, 0], beyond[-1, 0]) == (0, CURVE)
    end = CURVE * np.log(4) / np.log(4 * BEYOND)  # of the miniatures, in logarithms
    assert abs(line[-1, 0] - end) < CURVE / 30
    assert (line[-1] == beyond[0]).all()
    slopes = np.diff([*line[:, 1], *beyond[1:, 1]])  # a power is a straight line
    assert slopes.std() < 0.1
    assert (slopes < 0).all()
    half = len(band) // 2
    both = np.concatenate([line, beyond[1:]])
    assert (band[:half, 1] >= both[:, 1]).all()  # y grows downwards
    assert (band[half:, 1][::-1] <= both[:, 1]).all()
    recipe = Recipe([Stage(Relation("crop", 0.5), steps)])
    page = design_page(replace(design, recipe=recipe, best=recipe))
    sizes = [one.task.states.size for one in design.races[0].problems]
    assert trend_curve(steps, sizes).words in words(page)
    assert "to the power 0.5" in words(page)
    assert trend_curve(Trend(40.0, slope=0.5, around=16.0), [9, 36]).band == ""


def test_a_constant_has_no_curve(design):
    recipe = Recipe([Stage(Relation("crop", 0.5), Trend(40.0, draws=[(30.0, 0.0), (50.0, 0.0)]))])
    (card, _) = recipe_graph(recipe, [9, 36]).cards
    assert card.curve is None
    assert card.words == ("40 [30.5, 49.5] steps a state",)
    page = design_page(replace(design, recipe=recipe, best=recipe))
    assert "<polyline" not in page
    assert "no trend was shown" in words(page)


def test_the_page_is_whole_offline_and_always_the_same(design, fruitless, tmp_path):
    for one in (design, fruitless):
        path = write_design_report(one, tmp_path / "recipe.html")
        page = path.read_text("utf-8")
        assert page == design_page(one)
        assert "default-src 'none'" in page
        assert "http:" not in page
        assert "https:" not in page
        assert page.count("<script") == 1  # whose digest the policy names
        assert f"script-src '{Script.of('scroll.js').digest}';" in page
        read = Reader(page)
        assert read.problems == []
        assert read.open == []
        ids = read.values("id")
        assert len(set(ids)) == len(ids)
        assert set(read.values("href", "a")) <= {f"#{one}" for one in ids}


def test_names_are_escaped(design):
    first = design.races[0]
    named = {ODD if name == first.leader else name: one for name, one in first.arms.items()}
    renamed = replace(
        first,
        arms=named,
        steps={ODD if k == first.leader else k: v for k, v in first.steps.items()},
        source_steps={ODD if k == first.leader else k: v for k, v in first.source_steps.items()},
        rounds=tuple(
            replace(
                one,
                scores={ODD if k == first.leader else k: v for k, v in one.scores.items()},
                kept=tuple(ODD if k == first.leader else k for k in one.kept),
            )
            for one in first.rounds
        ),
    )
    page = design_page(replace(design, races=(renamed, *design.races[1:])))
    assert ODD in words(page)
    assert "<b>" not in page


def test_a_page_that_cannot_be_written_is_a_sentence(design, tmp_path):
    with pytest.raises(StoreError, match="a report cannot be written to"):
        write_design_report(design, tmp_path / "none" / "recipe.html")


def test_a_share_that_rounds_to_zero_has_no_minus():
    assert [_percent(one) for one in (-0.004, 0.0, -0.006)] == ["0%", "0%", "−1%"]
