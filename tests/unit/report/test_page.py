"""The page of a study: sound HTML, self-contained, with every arm and caption."""

import base64
import hashlib
import json
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import curricle as cr
from curricle.comparison.comparison import Arm
from curricle.errors import SettingError
from curricle.plotting.learning_curves import draw_learning_curves
from curricle.statistics.curves import Curve
from tests.study_pages import study_page

from .studies import ODD, Reader, maze_plan, page_of


def without_scripts(page):
    return re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)


def test_the_page_is_balanced_and_its_references_resolve(page):
    found = Reader(page)
    assert found.problems == []
    assert found.open == []
    ids = found.values("id")
    assert len(set(ids)) == len(ids)
    wanted = [href[1:] for href in found.values("href") if href.startswith("#")]
    wanted += found.values("for")
    wanted += re.findall(r"url\(#([\w-]+)\)", without_scripts(page))
    assert set(wanted) <= set(ids)
    levels = [int(tag[1]) for tag, _ in found.elements if re.fullmatch(r"h[1-6]", tag)]
    assert levels[0] == 1
    assert all(after - before <= 1 for before, after in pairwise(levels))


def test_the_page_requests_nothing(page):
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
    scripts = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    digests = [base64.b64encode(hashlib.sha256(one.encode()).digest()).decode() for one in scripts]
    assert len(scripts) == 3
    assert "script-src " + " ".join(f"'sha256-{one}'" for one in digests) + ";" in policy
    assert not [name for _, attrs in found.elements for name in attrs if name.startswith("on")]


def test_names_are_text_wherever_they_stand(pages):
    page = pages["odd"]
    assert "<b>&" not in page
    found = Reader(page)
    for name in ("", " arm", " short", " long", " reason", " key", " value"):
        assert ODD + name in found.words
    assert page.count("</script>") == 5
    data = json.loads(re.search(r'id="replays">(.*?)</script>', page, re.DOTALL)[1])
    assert set(data["replays"]) == set(found.values("data-key"))
    curves = json.loads(re.search(r'id="curves-data">(.*?)</script>', page, re.DOTALL)[1])
    assert {arm["name"] for arm in curves["arms"]} == set(found.values("data-arm"))


def test_the_page_is_small_and_the_same_every_time(pages, maze):
    assert max(len(page.encode()) for page in pages.values()) < 500_000
    assert page_of(maze) == pages["maze"]


def test_a_page_of_many_arms_seeds_and_checkpoints_is_below_a_megabyte(maze):
    rng, seeds, checkpoints = np.random.default_rng(0), 100, 2001
    steps = np.arange(checkpoints) * 500

    def arm(control):
        values = -100 + np.cumsum(rng.normal(size=(seeds, checkpoints)), axis=1)
        spent = rng.integers(1000, 9000, seeds)
        return Arm(Curve(steps, values, spent), values, values, control)

    first = arm(False)
    first = replace(first, curve=replace(first.curve, source_steps=np.zeros(seeds, dtype=int)))
    arms = {"scratch": first, "2x2": arm(False), "3x3": arm(False)}
    arms |= {f"3x3, control {n}": arm(True) for n in range(5)}
    large = replace(maze.comparison, arms=arms, budget=900_000, total=1_000_000)
    page = study_page("large", large, maze.results)
    films = re.search(r'id="replays">(.*?)</script>', page, re.DOTALL)[1]
    assert len(page.encode()) - len(films) < 1_000_000


def test_reasons_of_all_trainings_are_counted(pages):
    words = Reader(pages["odd"]).words
    assert f"{ODD} reason 1 of 6 {ODD} short" in words
    assert f"all steps used 5 of 6 {ODD} long, {ODD} short" in words


def test_every_control_has_a_label(page):
    found = Reader(page)
    controls = [a for tag, a in found.elements if tag in ("select", "input") and a["id"]]
    labelled = set(found.values("for", "label"))
    # The labels of these hold them.
    switches = {a["id"] for a in controls if a.get("type") in ("radio", "checkbox")}
    assert {a["id"] for a in controls} == (labelled | switches)


def test_both_axes_have_one_scale_and_all_arms(pursuit):
    comparison = pursuit.comparison
    weak, strong = (figure.axes[0] for figure in draw_learning_curves(comparison))
    assert weak.get_ylim() == strong.get_ylim()
    assert weak.get_xlim() == (0, comparison.budget)
    assert strong.get_xlim() == (0, comparison.total)
    for axes in (weak, strong):
        curves = {line.get_label(): line for line in axes.lines}
        assert set(comparison.arms) <= set(curves)
        assert len(axes.collections) == len(comparison.arms)  # a band each
    curves = {line.get_label(): line for line in strong.lines}
    assert curves["min"].get_xdata()[0] >= comparison["min"].curve.source_steps.min()
    assert curves["scratch"].get_xdata()[0] == 0
    weak_curves = {line.get_label(): line for line in weak.lines}
    mean = comparison["min"].curve.values.mean(axis=0)
    assert weak_curves["min"].get_ydata() == pytest.approx(
        mean[: len(weak_curves["min"].get_ydata())]
    )


def test_a_study_of_one_seed_without_snapshots_or_reasons_has_a_page():
    plan = maze_plan(2)
    found = Reader(
        study_page("alone", cr.compare({"mean": plan}, seeds=1), {"mean": plan.train(1)})
    )
    assert found.problems == []
    assert "One seed allows neither intervals nor tests." in found.words
    assert "This study kept no snapshots" in found.words
    assert "nan" not in found.words.lower().split()


def test_an_arm_without_transfers_has_no_forecast(maze):
    plan = cr.Curriculum({"maze": maze_plan(2).tasks["maze"]}, budget=500)
    found = Reader(study_page("same", cr.compare({"same": plan}, seeds=2), {"same": plan.train(2)}))
    assert found.problems == []
    assert "Too few seeds for a verdict (2; 6 or more)." in found.words
    assert "predicted start" not in found.words


def test_a_study_of_scratch_alone_is_refused(maze):
    comparison = replace(maze.comparison, arms={"scratch": maze.comparison.scratch})
    with pytest.raises(SettingError, match="needs an arm besides 'scratch'"):
        study_page("alone", comparison, {"scratch": maze.results["scratch"]})
