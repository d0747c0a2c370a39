"""The page of a study: what it says is what was found, it is sound HTML, and it is alone."""

import base64
import hashlib
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, strategies as st

import curricle as cr
from curricle.comparison.arms import Arm
from curricle.comparison.comparison import Comparison
from curricle.errors import SettingError
from curricle.planning.solution import greedy_policy
from curricle.plotting.learning_curves import draw_learning_curves
from curricle.report import forecast_section as promises_room, stories as stories_room
from curricle.report.episodes import before_and_after
from curricle.report.findings import findings, forest, headline, table, too_few
from curricle.report.forecast_section import promises
from curricle.report.graph import CARD, graphs
from curricle.report.inline import inline_svg
from curricle.report.replay import stories
from curricle.report.stage import stage
from curricle.report.storyboard import LEVELS, storyboard
from curricle.report.study_page import StudyRecord, study_page
from curricle.statistics.curves import Curve

VOID = {"meta", "link", "input", "br", "hr", "img", "col", "source", "wbr"}
ODD = "a <b>&\"' $x^2$ </script>"
"""A name that would do harm in HTML, in a script and in Matplotlib's mathematics."""


def snapshots(result, name, moments=5):
    """Five moments of seed 0, each learnt anew: a shorter budget is a prefix of a longer one."""
    node, curriculum = result[name], result.curriculum
    phi = (result.potentials.get(name) or [None])[0]
    end = int(node.steps_used[0])
    steps = np.linspace(0, end, moments).astype(np.int64)
    space = node.task.states.size, node.task.actions.size
    first = np.zeros(space) if phi is None else phi.values
    values = [first] + [
        cr.learn(
            node.task,
            curriculum.setting("learner", name),
            int(n),
            seeds=[0],
            potential=phi,
            eval_freq=int(n),
            stream=name,
        ).values[0]
        for n in steps[1:]
    ]
    return SimpleNamespace(seed=0, steps=steps, values=np.array(values, dtype=np.float32))


def record(name, plans, seeds, **settings):
    """A study as the store would hold it: compared, trained, filmed."""
    comparison = cr.compare(plans, seeds=seeds, **settings)
    first = next(iter(plans.values()))
    target = first.target
    scratch = cr.Curriculum({target: first.tasks[target]}, budget=comparison.total)
    results = {"scratch": scratch.train(seeds)}
    results |= {arm: plan.train(seeds) for arm, plan in plans.items()}
    snapshots = {
        (arm, node): snapshots(result, node)
        for arm, result in results.items()
        for node in result.nodes
    }
    environment = {"curricle": "0.1.0", "command": "curricle run study.toml <now>"}
    return StudyRecord(name, comparison, results, snapshots, {}, environment)


def hunt_plan(aggregate, **transfer):
    hunt, chase = (cr.Pursuit(3, n, discount=0.9, time_limit=30) for n in (2, 1))
    return cr.Curriculum(
        {"chase": chase, "hunt": hunt},
        [
            cr.Transfer("chase", "hunt", cr.project(hunt, chase, predator=name), **transfer)
            for name in hunt.predator_names
        ],
        aggregate=aggregate,
        budget={"chase": 4000, "hunt": 8000},
    )


def maze_plan(size):
    maze = cr.GridWorld(["...T", ".PP.", "F...", "S.#."], time_limit=40)
    corner = maze.crop(rows=(0, size), columns=(4 - size, 4))
    return cr.Curriculum(
        {"corner": corner, "maze": maze},
        [cr.Transfer("corner", "maze", cr.same_position(maze, corner))],
        budget={"corner": 500, "maze": 3000},
    )


def chain(n):
    outcomes = [[[(1.0, max(s - 1, 0), -1.0)], [(1.0, s + 1, -1.0)]] for s in range(n - 1)]
    ended = [False] * (n - 1) + [True]
    return cr.FiniteMDP.from_outcomes(
        [*outcomes, [[], []]], terminal=ended, start=0, discount=0.9, time_limit=30
    )


def chain_plan():
    long, short = chain(8), chain(5)
    f = cr.from_function(long, short, lambda s, a: ({"state": s["state"] - 3}, a))
    return cr.Curriculum(
        {f"{ODD} short": short, f"{ODD} long": long},
        [cr.Transfer(f"{ODD} short", f"{ODD} long", f, scale=1.5)],
        budget={f"{ODD} short": 300, f"{ODD} long": 1500},
    )


@pytest.fixture(scope="module")
def pursuit():
    plans = {"min": hunt_plan(cr.minimum), "mean": hunt_plan(cr.mean)}
    return record("Two predators", plans, 8, controls=["placebo"])


@pytest.fixture(scope="module")
def maze():
    return record("A maze", {"2x2": maze_plan(2), "3x3": maze_plan(3)}, 3)


@pytest.fixture(scope="module")
def odd():
    study = record(ODD, {f"{ODD} arm": chain_plan()}, 2)
    reasons = {(f"{ODD} arm", f"{ODD} short"): (f"{ODD} reason", "budget spent")}
    return replace(study, decisions=reasons, environment={f"{ODD} key": f"{ODD} value"})


@pytest.fixture(scope="module")
def pages(pursuit, maze, odd):
    return {"pursuit": study_page(pursuit), "maze": study_page(maze), "odd": study_page(odd)}


@pytest.fixture(params=["pursuit", "maze", "odd"])
def page(request, pages):
    return pages[request.param]


class Reader(HTMLParser):
    """Reads a page strictly: every element that opens closes, in order."""

    def __init__(self, page):
        super().__init__()
        self.open, self.elements, self.text, self.problems = [], [], [], []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attrs):
        names = [name for name, _ in attrs]
        if len(set(names)) != len(names):
            self.problems.append(f"{tag} repeats an attribute")
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        if tag not in VOID and "svg" not in self.open:
            self.problems.append(f"{tag} closes itself outside SVG")
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.problems.append(f"{tag} closes what is not open")

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("script", "style"):
            self.text.append(data)

    def values(self, attribute, tag=None):
        return [a[attribute] for t, a in self.elements if attribute in a and tag in (None, t)]

    @property
    def words(self):
        return " ".join(" ".join(self.text).split())


# -- the page as HTML ----------------------------------------------------------------------------


def test_the_page_is_balanced_and_its_references_resolve(page):
    found = Reader(page)
    assert found.problems == []
    assert found.open == []
    ids = found.values("id")
    assert len(set(ids)) == len(ids)
    wanted = [href[1:] for href in found.values("href") if href.startswith("#")]
    wanted += found.values("for")
    wanted += re.findall(r"url\(#([\w-]+)\)", page)
    assert set(wanted) <= set(ids)
    levels = [int(tag[1]) for tag, _ in found.elements if re.fullmatch(r"h[1-6]", tag)]
    assert levels[0] == 1
    assert all(after - before <= 1 for before, after in pairwise(levels))


def test_the_page_asks_for_nothing(page):
    found = Reader(page)
    assert "http://" not in page.replace("http://www.w3.org/2000/svg", "")
    assert "https://" not in page
    addresses = [*found.values("src"), *found.values("href"), *found.values("srcset")]
    assert all(address.startswith(("#", "data:")) for address in addresses)
    assert not re.search(r"@import|url\((?!#)", page)
    assert {tag for tag, _ in found.elements} & {"iframe", "object", "embed", "img"} == set()


def test_the_policy_allows_the_page_s_own_script_only(page):
    found = Reader(page)
    policy = found.values("content", "meta")[0]
    assert policy.startswith("default-src 'none';")
    script = re.search(r"<script>(.*?)</script>", page, re.DOTALL)[1]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in policy
    assert not [name for _, attrs in found.elements for name in attrs if name.startswith("on")]


def test_names_are_text_wherever_they_stand(pages):
    page = pages["odd"]
    assert "<b>&" not in page
    found = Reader(page)
    for name in ("", " arm", " short", " long", " reason", " key", " value"):
        assert ODD + name in found.words
    assert page.count("</script>") == 2
    data = json.loads(re.search(r'id="stories">(.*?)</script>', page, re.DOTALL)[1])
    assert set(data["stories"]) == set(found.values("data-key"))


def test_the_page_is_small_and_the_same_every_time(pages, maze):
    assert max(len(page.encode()) for page in pages.values()) < 500_000
    assert study_page(maze) == pages["maze"]


def test_the_sections_stand_in_their_order(page):
    titles = [id for id in Reader(page).values("id", "section") if id]
    wanted = ["findings", "curriculum", "curves", "measures", "promises", "watch", "run"]
    assert titles == wanted


def test_every_control_has_a_label(page):
    found = Reader(page)
    controls = [a for tag, a in found.elements if tag in ("select", "input") and a["id"]]
    labelled = set(found.values("for", "label"))
    radios = {a["id"] for a in controls if a.get("type") == "radio"}  # their labels hold them
    assert {a["id"] for a in controls} == (labelled | radios)


# -- findings and measures -----------------------------------------------------------------------


def line(height, source=0, seeds=8, control=False):
    """An arm of constant height, the same in all seeds but for a little."""
    steps = np.arange(0, 101, 10)
    values = np.full((seeds, 11), float(height)) + 0.01 * np.arange(seeds)[:, None]
    return Arm(Curve(steps, values, np.full(seeds, source)), values, values, control)


def compared(seeds=8, threshold=5.0, **arms):
    own = {"scratch": line(0, seeds=seeds), **arms}
    return Comparison("hunt", own, 80, 100, threshold, 1)


def test_the_headline_names_what_paid_and_by_how_much():
    found = compared(good=line(10, 20), better=line(20, 20), bad=line(-5, 10))
    gain = found.contrasts["better"].strong_gain
    said = headline(found).replace("\xa0", " ")
    assert said.startswith("2 of 3 pay for themselves, 1 of 3 costs more than it brings: better ")
    assert f"+{gain.estimate:.1f} [{gain.low:.1f}, {gain.high:.1f}]" in said
    assert said.endswith("over 8 seeds.")


def test_a_headline_claims_nothing_that_was_not_shown():
    assert headline(compared(same=line(0))).startswith("No curriculum is shown to differ")
    both = headline(compared(one=line(-5), two=line(-6)))
    assert both.startswith("Both curricula cost more than they bring: two most")


def test_controls_do_not_count_in_the_headline():
    found = compared(good=line(10), placebo=line(10, control=True))
    assert headline(found).startswith("The curriculum pays for itself: +")


@pytest.mark.parametrize(("seeds", "arms", "few"), [(1, 1, True), (5, 1, True), (6, 1, False)])
def test_too_few_seeds_are_said_to_be(seeds, arms, few):
    found = compared(seeds, **{f"arm {i}": line(10, seeds=seeds) for i in range(arms)})
    assert bool(too_few(found)) is few
    if few:
        assert all(one.tone == "open" for one in findings(found))


def test_findings_say_when_the_threshold_was_reached():
    sentences = {one.arm: one.sentences[2] for one in findings(compared(good=line(10, 20)))}
    assert sentences["good"] == (
        "Reaches 5.00 after 20 steps on average; the direct learner in no seed."
    )
    never = findings(compared(low=line(1)))[0].sentences[2]
    assert never == "Neither it nor the direct learner reaches 5.00 in any seed."


def test_the_table_holds_the_numbers_of_the_comparison(pursuit):
    cells, rows = table(pursuit.comparison), pursuit.comparison.rows()
    assert list(cells) == [row["arm"] for row in rows]
    for row in rows[1:]:
        for measure in (
            "strong_gain",
            "weak_gain",
            "jumpstart",
            "asymptotic_gain",
            "probability_of_improvement",
            "return",
        ):
            shown = cells[row["arm"]][measure]
            numbers = [shown.text, *shown.below.strip("[]").split(", ")]
            wanted = [row[measure], row[f"{measure}_low"], row[f"{measure}_high"]]
            size = max(map(abs, wanted))
            read = [float(number.replace("−", "-")) for number in numbers]
            assert read == pytest.approx(wanted, abs=0.006 * size)


def test_saved_steps_are_bounds_where_seeds_never_got_there():
    cells = table(compared(good=line(10, 20), bad=line(1)))
    assert cells["good"]["strong_steps_saved"].text == "≥ 80.0"
    assert cells["bad"]["strong_steps_saved"].below == "never reached"
    reverse = Comparison("hunt", {"scratch": line(10), "bad": line(0)}, 80, 100, 5.0, 1)
    assert table(reverse)["bad"]["weak_steps_saved"].text.startswith("≤ ")


@given(st.lists(st.tuples(*[st.floats(-1e6, 1e6)] * 3), min_size=1, max_size=5))
def test_a_forest_keeps_order_and_stays_on_its_axis(gains):
    ordered = [sorted(gain) for gain in gains]
    found = [
        SimpleNamespace(arm=str(i), gain=SimpleNamespace(low=low, estimate=middle, high=high))
        for i, (low, middle, high) in enumerate(ordered)
    ]
    zero, places = forest(found)
    flat = [zero, *(place for three in places.values() for place in three)]
    assert min(flat) >= -1e-9
    assert max(flat) <= 100 + 1e-9
    assert all(low <= middle <= high for low, middle, high in places.values())


def test_every_arm_and_control_is_on_the_page(pages, pursuit):
    words = Reader(pages["pursuit"]).words
    for arm in pursuit.comparison.arms:
        assert arm in words
    for contrast in pursuit.comparison.contrasts.values():
        assert contrast.verdict in words
    assert "8 seeds; brackets are 95" in words


# -- curves --------------------------------------------------------------------------------------


def test_both_axes_have_one_scale_and_all_arms(pursuit):
    comparison = pursuit.comparison
    free, charged = (figure.axes[0] for figure in draw_learning_curves(comparison))
    assert free.get_ylim() == charged.get_ylim()
    assert free.get_xlim() == (0, comparison.budget)
    assert charged.get_xlim() == (0, comparison.total)
    for axes in (free, charged):
        curves = {line.get_label(): line for line in axes.lines}
        assert set(comparison.arms) <= set(curves)
        assert len(axes.collections) == len(comparison.arms)  # a band each
    curves = {line.get_label(): line for line in charged.lines}
    assert curves["min"].get_xdata()[0] >= comparison["min"].curve.source_steps.min()
    assert curves["scratch"].get_xdata()[0] == 0
    free_curves = {line.get_label(): line for line in free.lines}
    mean = comparison["min"].curve.values.mean(axis=0)
    assert free_curves["min"].get_ydata() == pytest.approx(
        mean[: len(free_curves["min"].get_ydata())]
    )


def test_captions_name_method_and_seeds(pages):
    words = Reader(pages["pursuit"]).words
    assert "mean over 8 seeds; bands: 95 % percentile bootstrap intervals".replace(
        "95 %", "95\xa0%"
    ) in words.replace("95 %", "95\xa0%")


def test_svg_of_two_figures_share_no_identifier(pursuit):
    figures = draw_learning_curves(pursuit.comparison)
    one, two = (
        Reader(inline_svg(figure, name, "")).values("id")
        for figure, name in zip(figures, "ab", strict=True)
    )
    assert one
    assert not set(one) & set(two)


# -- the graph -----------------------------------------------------------------------------------


def test_arms_with_the_same_tasks_and_transfers_share_a_graph(pursuit, maze):
    (graph,) = graphs(pursuit.results, {})
    assert graph.arms == ("min", "mean")
    assert [node.name for node in graph.nodes] == ["chase", "hunt"]
    assert [spark.arms for spark in graph.nodes[0].sparks] == [("min", "mean")]
    assert [spark.arms for spark in graph.nodes[1].sparks] == [("min",), ("mean",), ("scratch",)]
    (edge,) = graph.edges
    assert [words.split(";")[0] for words in edge.words] == [
        "predator is predator_1, prey by name",
        "predator is predator_2, prey by name",
    ]
    assert graph.notes == (
        "min: hunt starts from their minimum.",
        "mean: hunt starts from their mean.",
    )
    # Both corners are called "corner", and are not one task.
    assert [graph.arms for graph in graphs(maze.results, {})] == [("2x2",), ("3x3",)]


def test_a_scaled_transfer_makes_another_graph(pursuit):
    scaled = hunt_plan(cr.minimum, scale=2.0).train(2)
    found = graphs({**pursuit.results, "scaled": scaled}, {})
    assert [graph.arms for graph in found] == [("min", "mean"), ("scaled",)]
    assert all("scaled by 2" in words for words in found[1].edges[0].words)


def test_cards_do_not_overlap_and_arrows_lead_down():
    maze = cr.GridWorld(["...T", "....", "S..."])
    tasks = dict.fromkeys("abcd", maze)
    pairs = [("a", "c"), ("b", "c"), ("c", "d"), ("a", "d")]
    edges = [cr.Transfer(*pair, cr.transfer.identity(maze)) for pair in pairs]
    result = cr.Curriculum(tasks, edges, budget=100).train()
    (graph,) = graphs({"taught": result}, {})
    top = {node.name: node.top for node in graph.nodes}
    for edge in graph.edges:
        assert top[edge.source] < top[edge.target]
        assert 0 <= edge.place[0] <= graph.width
    boxes = [(node.left, node.top, node.height) for node in graph.nodes]
    for i, (left, up, height) in enumerate(boxes):
        assert 0 <= left <= graph.width - CARD
        assert up + height <= graph.height
        for x, y, tall in boxes[:i]:
            apart = abs(left - x) >= CARD or up >= y + tall or y >= up + height
            assert apart
    (skipping,) = [edge for edge in graph.edges if (edge.source, edge.target) == ("a", "d")]
    (node,) = [node for node in graph.nodes if node.name == "c"]
    assert not node.left <= skipping.place[0] <= node.left + CARD


def test_reasons_are_counted(odd):
    node = graphs(odd.results, odd.decisions)[0].nodes[0]
    assert node.reason == f"{ODD} reason (1 of 2); budget spent (1 of 2)"


# -- stages and storyboards ----------------------------------------------------------------------


def test_arrows_are_of_the_agent_that_is_drawn():
    hunt = stage(cr.Pursuit(3, 2))
    values = np.zeros(25)
    values[hunt.board.task.actions.encode(predator_1=2, predator_2=0)] = 1  # east, stay
    assert hunt.known[hunt.choices(values)].tolist() == [2]
    assert hunt.fixed == (("P", 1, 1), ("2", 0, 0))


def test_ties_are_shown_as_ties():
    maze = stage(cr.GridWorld(["S.", ".T"]))
    east = maze.mark(maze.choices(np.array([0.0, 1.0, 0.0, 0.0])))
    both = maze.mark(maze.choices(np.array([0.0, 1.0, 1.0, 0.0])))
    assert maze.mark(maze.choices(np.ones(4))) == ""
    assert east.count("z") == 1
    assert both.count("z") == 2


@pytest.mark.parametrize("chosen", [(1, 0, 0, 0), (1, 1, 0, 0), (0, 1, 1, 1)])
def test_the_shapes_of_a_mark_all_begin_in_the_middle_of_the_cell(chosen):
    maze = stage(cr.GridWorld(["S.", ".T"]))
    mark = maze.mark(np.array(chosen, bool))
    shapes = re.findall(r"m(\S+) [^z]*zm(\S+?)(?=m|$)", mark)
    assert len(shapes) == sum(chosen)
    # z leads back to where a shape begins, and the move after it to the middle.
    for begins, home in shapes:
        there, back = (np.array(point.split(","), float) for point in (begins, home))
        assert (there + back == 0).all()


def test_a_task_without_geometry_is_a_strip_with_words():
    strip = stage(chain(80))
    assert not strip.is_map
    assert len(strip.board.states) == 60
    assert strip.board.words == "cells: states by number, the first 60 of 80"
    assert strip.mark(strip.choices(np.array([0.0, 1.0]))) == "1"
    assert strip.actors[0].cells[[0, 59, 60]].tolist() == [0, 59, -1]


def test_row_and_column_make_a_map_of_any_task():
    maze = cr.GridWorld(["S..", "..T"])
    tables = maze.mdp
    found = stage(tables)
    assert found.is_map
    assert found.arrows
    assert found.size == (3, 2)


def test_a_map_of_too_many_cells_is_not_drawn():
    wide = cr.GridWorld(["S" + "." * 59 + "T"] + ["." * 61] * 50)
    assert stage(wide) is None
    result = cr.Curriculum({"wide": wide}, budget=10).train()
    shape = (2, wide.states.size, 4)
    short = SimpleNamespace(seed=0, steps=np.array([0, 9]), values=np.zeros(shape, np.float32))
    assert stories({"scratch": result}, {("scratch", "wide"): short}) == ((), ("wide",))


def test_walls_and_ends_cover_what_is_no_state(maze):
    found = stage(maze.results["2x2"].curriculum.tasks["maze"])
    assert found.walls == "M2 3h1v1h-1z"
    assert found.over.count("M") == 3  # two pits and the treasure
    assert [(letter, ends) for letter, *_, ends in found.things] == [
        ("T", True),
        ("P", True),
        ("P", True),
        ("F", False),
    ]


@given(st.integers(0, 2**32 - 1), st.floats(1e-3, 1e4))
def test_a_storyboard_keeps_values_to_a_sixty_five_thousandth(seed, size):
    maze = cr.GridWorld(["S..", "..T"])
    values = np.random.default_rng(seed).normal(0, size, (4, 6, 4)).astype(np.float32)
    shot = SimpleNamespace(seed=0, steps=np.arange(4) * 10, values=values)
    found = storyboard(shot, stage(maze))
    read = found.low + (found.high - found.low) * found.levels / (LEVELS - 1)
    best = values[:, :5].max(axis=-1)
    assert np.abs(read - best).max() <= 0.6 * (found.high - found.low) / (LEVELS - 1)
    policy = greedy_policy(values[2, :5]) > 0
    for number, row in zip(found.choices[2], policy, strict=True):
        assert found.marks[number] == found.stage.mark(row)


def test_frames_are_thinned_but_the_ends_are_kept():
    maze = cr.GridWorld("S.T")
    shot = SimpleNamespace(seed=0, steps=np.arange(200), values=np.zeros((200, 3, 4), np.float32))
    found = storyboard(shot, stage(maze), 7)
    assert len(found.steps) == 7
    assert found.steps[[0, -1]].tolist() == [0, 199]


def test_many_cells_get_fewer_frames(maze, monkeypatch):
    monkeypatch.setattr(stories_room, "MOST_CELL_FRAMES", 1)
    found, _ = stories(maze.results, maze.snapshots)
    assert {len(story.board.steps) for story in found} == {3}


def test_a_page_has_room_for_so_many_cells_and_targets_come_first(maze, monkeypatch):
    monkeypatch.setattr(stories_room, "MOST_CELLS", 3 * 15)  # three arms in the target
    found, left_out = stories(maze.results, maze.snapshots)
    assert {story.task for story in found} == {"maze"}
    assert left_out == ("corner",)


def test_arms_that_learnt_alike_share_a_story(pursuit, maze):
    told, left_out = stories(pursuit.results, pursuit.snapshots)
    assert [(story.task, story.arms) for story in told] == [
        ("hunt", ("scratch",)),
        ("hunt", ("min",)),
        ("hunt", ("mean",)),
        ("chase", ("min", "mean")),
    ]
    assert left_out == ()
    told, _ = stories(maze.results, maze.snapshots)
    assert [story.arms for story in told if story.task == "corner"] == [("3x3",), ("2x2",)]


# -- episodes ------------------------------------------------------------------------------------


def test_both_episodes_start_alike_and_earn_what_the_task_pays(pursuit):
    hunt = pursuit.results["min"].curriculum.tasks["hunt"]
    shot = pursuit.snapshots["min", "hunt"]
    before, after = before_and_after(shot, stage(hunt), discounted=True)
    assert (before.cells[0] == after.cells[0]).all()
    followed = cr.planning.rollout(hunt, greedy_policy(shot.values[-1]), seed=0)
    assert after.earned[-1] == pytest.approx(followed.discounted_return(0.9))
    decoded = hunt.states.decode(followed.states)
    assert (after.cells[:, 1] == decoded["predator_1"]).all()
    assert after.over == followed.terminated


def test_tasks_without_tables_have_no_episodes(pursuit, monkeypatch):
    hunt = pursuit.results["min"].curriculum.tasks["hunt"]
    monkeypatch.setattr("curricle.report.episodes.LARGEST_TABLE", 10)
    assert before_and_after(pursuit.snapshots["min", "hunt"], stage(hunt), discounted=True) is None


def test_a_state_off_the_strip_has_no_episode():
    long = chain(80)
    values = np.zeros((2, 80, 2), np.float32)
    values[:, :, 1] = 1
    far = replace(long, start=np.eye(80)[70])
    shot = SimpleNamespace(seed=0, steps=np.array([0, 9]), values=values)
    assert before_and_after(shot, stage(far), discounted=True) is None


# -- forecast and certificates -------------------------------------------------------------------


def test_the_forecast_is_set_against_what_came(pursuit):
    (found,) = promises(pursuit.results, [["min", "mean"]])
    assert found.used == {"minimum": ("min",), "mean": ("mean",)}
    for arm, name in (("min", "minimum"), ("mean", "mean")):
        came = pursuit.results[arm]["hunt"].greedy_return[:, 0]
        assert found.came[arm] == came.mean()
        assert found.forecast[name].mean("start") == pytest.approx(came[:3].mean(), abs=0.5)
    ((arms, certificate),) = found.certificates
    assert arms == ("min", "mean")
    assert certificate.holds
    assert found.left_out == ()


def test_what_is_left_out_is_said_and_how_to_get_it(pursuit, monkeypatch):
    monkeypatch.setattr(promises_room, "EFFORT", 10)
    monkeypatch.setattr(promises_room, "LARGEST_CERTIFIED", 10)
    words = Reader(study_page(pursuit)).words
    why = f"because hunt has {729 * 25:,} state-action pairs"
    assert f"min, mean: The forecast is left out, {why}: curricle.forecast" in words
    assert "Certificates are left out" in words


def test_values_that_were_not_kept_leave_both_out():
    plan = hunt_plan(cr.minimum)
    result = plan.train(2)
    bare = {name: replace(node, values=None) for name, node in result.nodes.items()}
    (found,) = promises({"min": replace(result, nodes=bare)}, [["min"]])
    assert found.forecast is None
    assert found.certificates == ()
    assert all("values were not kept" in sentence for sentence in found.left_out)


def test_a_potential_that_was_not_kept_is_made_again(pursuit):
    stored = {arm: replace(one, potentials={}) for arm, one in pursuit.results.items()}
    kept, again = (promises(results, [["min"]])[0] for results in (pursuit.results, stored))
    assert str(kept.certificates[0][1]) == str(again.certificates[0][1])


# -- small and odd studies -----------------------------------------------------------------------


def test_a_study_of_one_seed_without_films_or_reasons_is_told():
    plan = maze_plan(2)
    study = StudyRecord("alone", cr.compare({"taught": plan}, seeds=1), {"taught": plan.train(1)})
    found = Reader(study_page(study))
    assert found.problems == []
    assert "One seed allows neither intervals nor tests." in found.words
    assert "No snapshots were kept" in found.words
    assert "nan" not in found.words.lower().split()


def test_an_arm_without_transfers_is_told_without_a_forecast(maze):
    plan = cr.Curriculum({"maze": maze_plan(2).tasks["maze"]}, budget=500)
    study = StudyRecord("same", cr.compare({"same": plan}, seeds=2), {"same": plan.train(2)})
    found = Reader(study_page(study))
    assert found.problems == []
    assert "No curriculum is shown to differ" in found.words
    assert "foreseen" not in found.words


def test_a_study_of_the_direct_learner_alone_is_refused(maze):
    comparison = replace(maze.comparison, arms={"scratch": maze.comparison.scratch})
    study = StudyRecord("alone", comparison, {"scratch": maze.results["scratch"]})
    with pytest.raises(SettingError, match="needs an arm besides 'scratch'"):
        study_page(study)
