"""The page of a study: sound HTML, its curves as data, its graph, its forecast."""

import base64
import hashlib
import json
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np

import curricle as cr
from curricle.comparison.measures import Arm
from curricle.show.graph import CARD, graphs
from curricle.show.plots import draw_learning_curves
from curricle.show.report import UPLOT, asset, curve_data
from curricle.show.style import arm_styles
from curricle.statistics.curves import Curve
from curricle.study import analysis as analysis_module

from .studies import ODD, Reader, hunt_plan, labelled, maze_plan, page_of, shown, study_page


def without_scripts(page):
    return re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)


def test_the_page_is_balanced_and_its_references_resolve(page):
    reader = Reader(page)
    assert reader.problems == reader.open == []
    ids = reader.values("id")
    assert len(set(ids)) == len(ids)
    wanted = [href[1:] for href in reader.values("href") if href.startswith("#")]
    wanted += reader.values("for")
    wanted += re.findall(r"url\(#([\w-]+)\)", without_scripts(page))
    assert set(wanted) <= set(ids)
    levels = [int(tag[1]) for tag, _ in reader.elements if re.fullmatch(r"h[1-6]", tag)]
    assert levels[0] == 1
    assert all(after - before <= 1 for before, after in pairwise(levels))


def test_the_page_requests_nothing_and_allows_its_own_scripts_only(page):
    reader = Reader(page)
    own = page.replace(asset(UPLOT), "")  # which says where it comes from
    assert not re.search(r"https?://(?!www.w3.org/2000/svg)", own)
    addresses = [*reader.values("src"), *reader.values("href"), *reader.values("srcset")]
    assert all(address.startswith(("#", "data:")) for address in addresses)
    assert not re.search(r"@import|url\((?!#)", page)
    assert {tag for tag, _ in reader.elements} & {"iframe", "object", "embed", "img"} == set()
    policy = reader.values("content", "meta")[0]
    assert policy.startswith("default-src 'none';")
    scripts = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    digests = [
        base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts
    ]
    assert len(scripts) == 3
    assert "script-src " + " ".join(f"'sha256-{digest}'" for digest in digests) + ";" in policy
    assert not [name for _, attrs in reader.elements for name in attrs if name.startswith("on")]


def test_names_are_text_wherever_they_stand(pages):
    page = pages["odd"]
    assert "<b>&" not in page
    reader = Reader(page)
    for name in ("", " arm", " short", " long", " reason", " key", " value"):
        assert ODD + name in reader.words
    assert f"{ODD} reason 1 of 6 {ODD} short" in reader.words
    assert f"all steps used 5 of 6 {ODD} long, {ODD} short" in reader.words
    assert page.count("</script>") == 5
    data = json.loads(re.search(r'id="replays">(.*?)</script>', page, re.DOTALL)[1])
    assert set(data["replays"]) == set(reader.values("data-key"))
    curves = json.loads(re.search(r'id="curves-data">(.*?)</script>', page, re.DOTALL)[1])
    assert {arm["name"] for arm in curves["arms"]} == set(reader.values("data-arm"))


def test_a_page_is_small_and_the_same_every_time_and_of_much_below_a_megabyte(pages, maze):
    assert max(len(page.encode()) for page in pages.values()) < 500_000
    assert page_of(maze) == pages["maze"]
    rng, seeds, checkpoints = np.random.default_rng(0), 100, 2001
    steps = np.arange(checkpoints) * 500

    def arm(control):
        values = -100 + np.cumsum(rng.normal(size=(seeds, checkpoints)), axis=1)
        spent = rng.integers(1000, 9000, seeds)
        return Arm(Curve(steps, values, spent), control)

    first = arm(False)
    first = replace(first, curve=replace(first.curve, source_steps=np.zeros(seeds, dtype=int)))
    arms = {"scratch": first, "2x2": arm(False), "3x3": arm(False)}
    arms |= {f"3x3, control {n}": arm(True) for n in range(5)}
    large = replace(maze.comparison, arms=arms, budget=900_000, total=1_000_000)
    page = study_page("large", large, maze.results)
    films = re.search(r'id="replays">(.*?)</script>', page, re.DOTALL)[1]
    assert len(page.encode()) - len(films) < 1_000_000


def test_every_control_has_a_label(page):
    reader = Reader(page)
    controls = [a for tag, a in reader.elements if tag in ("select", "input") and a["id"]]
    labelled = set(reader.values("for", "label"))
    # The labels of these hold them.
    switches = {a["id"] for a in controls if a.get("type") in ("radio", "checkbox")}
    assert {a["id"] for a in controls} == (labelled | switches)


def test_both_axes_have_one_scale_and_all_drawn_arms(pursuit):
    comparison = pursuit.comparison
    weak, strong = (figure.axes[0] for figure in draw_learning_curves(comparison))
    assert weak.get_ylim() == strong.get_ylim()
    assert weak.get_xlim() == (0, comparison.budget)
    assert strong.get_xlim() == (0, comparison.total)
    for axes in (weak, strong):
        assert set(comparison.drawn) == set(labelled(axes))
        assert len(axes.collections) == len(comparison.drawn)  # a band each


def test_a_study_of_one_seed_without_snapshots_or_reasons_has_a_page():
    plan = maze_plan(2)
    comparison = cr.compare({"mean": plan}, seeds=1)
    reader = Reader(study_page("alone", comparison, {"mean": plan.train(1)}))
    assert reader.problems == []
    assert "Too few seeds for a verdict (1; 6 or more)." in reader.words
    assert "This study kept no snapshots" in reader.words
    assert "nan" not in reader.words.lower().split()


def test_a_page_without_sources_names_the_best_learner():
    plan = cr.Curriculum({"maze": maze_plan(2).tasks["maze"]}, budget=500)
    reader = Reader(
        study_page("same", cr.compare({"same": plan}, seeds=2), {"scratch": plan.train(2)})
    )
    assert reader.problems == []
    assert "No arm has a source; the best learner without one is the target's own" in reader.words
    assert "too few seeds for a verdict (2; 8 or more)" in reader.words
    assert "predicted start" not in reader.words


def data_of(comparison):
    weak, strong = (figure.axes[0] for figure in draw_learning_curves(comparison))
    data = curve_data(comparison, arm_styles(comparison), {"weak": weak, "strong": strong})
    return json.loads(json.dumps(data, allow_nan=False))


def test_seeds_are_their_returns_over_target_steps(pursuit):
    data = data_of(pursuit.comparison)
    unit = 10.0 ** -data["digits"]
    for arm in data["arms"]:
        curve = pursuit.comparison[arm["name"]].curve
        assert arm["source_steps"] == curve.source_steps.tolist()
        assert data["seed_steps"] == curve.steps.tolist()
        rows = np.array(arm["seeds"], dtype=float)
        np.testing.assert_allclose(rows, curve.filled(), atol=0.5001 * unit, rtol=0)


def test_where_nobody_learnt_the_page_has_no_threshold(pursuit):
    reference = replace(pursuit.comparison.reference, random_return=1e9, optimum=None)
    nobody = replace(pursuit.comparison, reference=reference)
    assert data_of(nobody)["threshold"] is None
    reader = Reader(study_page("none", nobody, pursuit.results))
    assert reader.problems == []
    assert "Grey: the threshold, none, as nobody learnt." in reader.words
    assert "nan" not in reader.words.lower().split()


def graphs_of(results):
    record, learnt, _ = shown(results)
    reasons = {(arm, task): ["all steps used"] for arm, nodes in learnt.items() for task in nodes}
    return graphs(record, learnt, reasons)


def test_arms_with_the_same_tasks_and_transfers_share_a_graph(pursuit, maze):
    (graph,) = graphs_of(pursuit.results)
    assert graph["arms"] == ("min", "mean")
    owners = {c["name"]: [curve["arms"] for curve in c["curves"]] for c in graph["cards"]}
    assert owners == {"chase": [("min", "mean")], "hunt": [("min",), ("mean",), ("scratch",)]}
    (edge,) = graph["edges"]
    mapped = [f"predator is predator_{n}, prey by name" for n in (1, 2)]
    assert [text.split(";")[0] for text in edge["words"]] == mapped
    names = {"min": "minimum", "mean": "mean"}.items()
    assert graph["notes"] == [f"{a}: hunt uses the {name} of its transfers." for a, name in names]
    # Both corners are called "corner", and are not one task.
    assert [graph["arms"] for graph in graphs_of(maze.results)] == [("2x2",), ("3x3",)]


def test_a_source_that_is_not_evaluated_has_no_curve(recwarn):
    plan = replace(maze_plan(2), evaluation={"corner": cr.GreedyEvaluation("off")})
    (graph,) = graphs_of({"transfer": plan.train(2)})
    source, target = graph["cards"]
    assert source["curves"] == []
    assert len(target["curves"]) == 1
    assert source["height"] < target["height"]
    assert not recwarn.list


def test_a_scaled_transfer_makes_another_graph(pursuit):
    scaled = hunt_plan(cr.minimum, scale=2.0).train(2)
    drawn = graphs_of({**pursuit.results, "scaled": scaled})
    assert [graph["arms"] for graph in drawn] == [("min", "mean"), ("scaled",)]
    assert all("scaled by 2" in text for text in drawn[1]["edges"][0]["words"])


def test_cards_do_not_overlap_and_arrows_lead_down():
    maze = cr.GridWorld(["...T", "....", "S..."])
    tasks = dict.fromkeys("abcd", maze)
    pairs = [("a", "c"), ("b", "c"), ("c", "d"), ("a", "d")]
    edges = [cr.Transfer(*pair, cr.transfer.identity(maze)) for pair in pairs]
    result = cr.Curriculum(tasks, edges, budget=100).train()
    (graph,) = graphs_of({"both": result})
    top = {card["name"]: card["top"] for card in graph["cards"]}
    for edge in graph["edges"]:
        assert top[edge["source"]] < top[edge["target"]]
        assert 0 <= edge["place"][0] <= graph["width"]
    for i, card in enumerate(graph["cards"]):
        assert 0 <= card["left"] <= graph["width"] - CARD
        bottom = card["top"] + card["height"]
        assert bottom <= graph["height"]
        for other in graph["cards"][:i]:
            below = card["top"] >= other["top"] + other["height"] or other["top"] >= bottom
            assert below or abs(card["left"] - other["left"]) >= CARD
    place = {(e["source"], e["target"]): e["place"][0] for e in graph["edges"]}["a", "d"]
    (left,) = [card["left"] for card in graph["cards"] if card["name"] == "c"]
    assert not left <= place <= left + CARD


def test_arms_with_the_same_potential_share_a_certificate(pursuit):
    (section,) = shown(pursuit.results)[2].sections
    (certificate,) = section.certificates
    assert certificate.arms == ("min", "mean")
    assert certificate.holds
    assert section.left_out == ()


def test_a_sentence_names_what_is_left_out_and_how_to_get_it(pursuit, monkeypatch):
    monkeypatch.setattr(analysis_module, "LARGEST_CERTIFIED", 10)
    text = Reader(page_of(pursuit)).words
    why = f"because hunt has {729 * 25:,} state-action pairs"
    assert f"min, mean: Certificates are left out, {why}: curricle.certify" in text


def test_a_potential_that_was_not_kept_is_made_again(pursuit):
    stored = {arm: replace(result, potentials={}) for arm, result in pursuit.results.items()}
    kept, again = (shown(results)[2].sections[0] for results in (pursuit.results, stored))
    assert kept.certificates == again.certificates
    stored = {arm: replace(result, nodes=without_values(result)) for arm, result in stored.items()}
    (section,) = shown(stored)[2].sections
    assert section.certificates == ()
    assert all("values were not kept" in sentence for sentence in section.left_out)


def without_values(result):
    return {name: replace(node, values=None) for name, node in result.nodes.items()}
