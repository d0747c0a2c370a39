"""The curves that a page's script draws: they hold what was measured, and no more than is seen."""

import json

import numpy as np
import pytest

import curricle as cr
from curricle.show.page import SEEN, curve_data
from curricle.show.plots import draw_learning_curves, shown_curve
from curricle.show.style import arm_styles
from curricle.statistics.intervals import mean_interval

from .studies import maze_plan


def data_of(comparison):
    weak, strong = (figure.axes[0] for figure in draw_learning_curves(comparison))
    found = curve_data(comparison, arm_styles(comparison), {"weak": weak, "strong": strong})
    return json.loads(json.dumps(found, allow_nan=False))


def numbers(row, digits):
    """The numbers that a row of differences holds; NaN for None."""
    known = [one for one in row if one is not None]
    sums = iter(np.cumsum(known) / 10**digits)
    return np.array([np.nan if one is None else next(sums) for one in row])


@pytest.mark.parametrize("panel", ["weak", "strong"])
@pytest.mark.parametrize("study", ["pursuit", "maze"])
def test_means_and_bounds_are_those_of_the_comparison(study, panel, request):
    comparison = request.getfixturevalue(study).comparison
    found = data_of(comparison)
    steps, unit = np.cumsum(found["steps"]), 10.0 ** -found["digits"]
    assert {arm["name"] for arm in found["arms"]} == set(comparison.arms)
    for arm in found["arms"]:
        curve, begin = shown_curve(comparison, arm["name"], strong=panel == "strong")
        own = arm[panel]
        mean = numbers(own["mean"], found["digits"])
        assert steps[own["first"]] == comparison.scratch.curve.steps[begin]
        assert steps[own["first"] :][: len(mean)].tolist() == curve.steps.tolist()
        band = mean_interval(curve.filled())
        for name, wanted in (("mean", band.estimate), ("low", band.low), ("high", band.high)):
            row = numbers(own[name], found["digits"])
            np.testing.assert_allclose(row, wanted, atol=0.5001 * unit, rtol=0)


def test_seeds_are_their_returns_over_target_steps(pursuit):
    found = data_of(pursuit.comparison)
    steps = np.cumsum(found["seed_steps"])
    for arm in found["arms"]:
        curve = pursuit.comparison[arm["name"]].curve
        assert arm["source_steps"] == curve.source_steps.tolist()
        assert steps.tolist() == curve.steps.tolist()
        rows = [numbers(row, found["digits"]) for row in arm["seeds"]]
        unit = 10.0 ** -found["digits"]
        np.testing.assert_allclose(rows, curve.filled(), atol=0.5001 * unit, rtol=0)


def test_returns_are_rounded_to_what_can_be_seen(maze):
    found = data_of(maze.comparison)
    low, high = found["panels"]["strong"]["y"]
    assert 10.0 ** -found["digits"] <= (high - low) / SEEN < 10.0 ** (1 - found["digits"])


def test_one_seed_has_no_bounds():
    found = data_of(cr.compare({"mean": maze_plan(2)}, seeds=1))
    for arm in found["arms"]:
        assert set(arm["weak"]["low"]) == set(arm["strong"]["high"]) == {None}
