"""Figures of comparisons and forecasts: lines, marks, limits, words. No pixels are compared."""

import io
import os

import numpy as np
import pytest
from matplotlib.figure import Figure

import curricle as cr
from curricle.comparison.comparison import Arm, Comparison
from curricle.errors import SettingError
from curricle.plotting.forecast import draw_forecast
from curricle.plotting.learning_curves import draw_comparison, draw_learning_curves
from curricle.plotting.picture import plot
from curricle.statistics.curves import Curve

from .studies import labelled, texts_of

STEPS = np.arange(0, 101, 10)


def arm(values, source_steps=0, control=False, seeds=4, spread=1.0):
    """An arm whose seeds lie 0, 1, 2, ... times the spread above the given curve."""
    rows = np.broadcast_to(values, STEPS.shape) + spread * np.arange(seeds)[:, np.newaxis]
    flat = np.zeros(rows.shape)
    return Arm(Curve(STEPS, rows, np.full(seeds, source_steps)), flat, flat, control)


def comparison(seeds=4, **more):
    arms = {
        "scratch": arm(0.0, seeds=seeds),
        "mean": arm(10.0, 20, seeds=seeds),
        "mean, placebo": arm(-5.0, 20, control=True, seeds=seeds),
        **more,
    }
    return Comparison("hunt", arms, 80, 100, 7.5, 1)


def test_a_curve_begins_where_its_sources_end():
    axes = draw_comparison(comparison()).axes[0]
    curves = labelled(axes)
    assert set(curves) == {"scratch", "mean", "mean, placebo"}
    assert curves["scratch"].get_xdata()[0] == 0
    mean = curves["mean"]
    assert (mean.get_xdata() == np.arange(20, 101, 10)).all()
    assert (mean.get_ydata() == 11.5).all()  # the mean of seeds 10 to 13
    lead_in = [line for line in axes.lines if line.get_linestyle() == ":"]
    assert [list(line.get_xdata()) for line in lead_in] == [[0, 20, 20]] * 2
    assert sorted(list(line.get_ydata()) for line in lead_in) == [
        [1.5, 1.5, -3.5],
        [1.5, 1.5, 11.5],
    ]
    circles = [line for line in axes.lines if line.get_marker() == "o"]
    assert {(*line.get_xdata(), *line.get_ydata()) for line in circles} == {(20, 11.5), (20, -3.5)}


def test_a_profile_steps_down_where_a_run_ends():
    axes = draw_comparison(comparison()).axes[1]
    line = labelled(axes)["mean"]
    assert line.get_drawstyle() == "steps-post"
    share = dict(zip(line.get_xdata(), line.get_ydata(), strict=True))
    assert [share[tau] for tau in (3, 10, 11, 12, 13)] == [1, 0.75, 0.5, 0.25, 0]
    low, high = axes.get_xlim()
    assert min(share) == low < -5
    assert max(share) == high > 13


def test_gains_have_a_row_each_with_interval_and_p():
    placebo = arm(-5.0, 20, control=True, seeds=6, spread=3.0)
    own = arm(10.0, 20, seeds=6, spread=2.0)
    found = comparison(seeds=6, **{"mean": own, "mean, placebo": placebo})
    axes = draw_comparison(found).axes[2]
    assert [label.get_text() for label in axes.get_yticklabels()] == [
        "scratch",
        "mean",
        "placebo",
    ]
    assert [0, 0] in [list(line.get_xdata()) for line in axes.lines]
    dots = labelled(axes)
    for row, name in enumerate(["mean", "mean, placebo"], 1):
        gain = found.contrasts[name].strong_gain
        assert (*dots[name].get_xdata(), *dots[name].get_ydata()) == (gain.estimate, row)
        segment = axes.collections[row - 1].get_segments()[0]
        assert segment.tolist() == [[gain.low, row], [gain.high, row]]
        filled = name == "mean"  # a control is compared with its curriculum only
        assert (dots[name].get_markerfacecolor() == "w") is not filled
    assert f"{found.verdicts['mean'].adjusted_p:.2g}" in texts_of(axes)
    assert {"reference", "gain [95 %]", "p (Holm)"} <= set(texts_of(axes))


def test_seeds_whose_sources_end_at_other_steps_are_charged_one_by_one():
    late = Curve(STEPS, np.full((4, 11), 8.0), np.array([10, 10, 30, 30]))
    other = Arm(late, np.zeros((4, 11)), np.zeros((4, 11)), False)
    line = labelled(draw_comparison(comparison(other=other)).axes[0])["other"]
    # At 10 and 20 two seeds are at 8 and two at the first values of scratch, 2 and 3.
    assert line.get_xdata()[0] == 10
    assert line.get_ydata()[:3].tolist() == [(8 + 8 + 2 + 3) / 4] * 2 + [8]


def test_returns_over_decades_are_drawn_on_a_bent_axis():
    far = {"scratch": arm(-400.0), "mean": arm(-8.0, 20)}
    curves, profile, gains = draw_comparison(Comparison("hunt", far, 80, 100, -9.0, 1)).axes
    assert curves.get_yscale() == profile.get_xscale() == "symlog"
    assert gains.get_xscale() == "linear"
    assert curves.get_ylim()[0] < -400


def test_a_forecast_has_a_bar_for_each_potential(predicted):
    figure = draw_forecast(predicted)
    (axes,) = figure.axes
    names = [label.get_text() for label in axes.get_yticklabels()]
    assert [name.removesuffix(" (used)") for name in names] == [o.name for o in predicted.rows]
    assert [name for name in names if name.endswith(" (used)")] == ["mean (used)"]
    for bar, one in zip(axes.patches, predicted.rows, strict=True):
        assert bar.get_x() == pytest.approx(predicted.random_return)
        assert bar.get_x() + bar.get_width() == pytest.approx(one.mean("start"))
        assert f"{one.mean('optimistic'):.0%}" in texts_of(axes)
        assert f"× {one.scale:.2g}" in texts_of(axes)
    low, high = axes.get_xlim()
    assert low < predicted.random_return
    assert predicted.optimum < high


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf", ".PNG"])
def test_a_picture_is_written_the_same_each_time(tmp_path, predicted, suffix):
    written = []
    for name in ("one", "other"):
        figure = plot(predicted, tmp_path / f"{name}{suffix}")
        assert isinstance(figure, Figure)
        written.append((tmp_path / f"{name}{suffix}").read_bytes())
    assert written[0] == written[1]
    assert len(written[0]) > 5_000


def test_what_cannot_be_drawn_is_refused_and_nothing_written(tmp_path):
    for path in (tmp_path / "hunt.bmp", tmp_path / "nowhere" / "hunt.png", 7):
        with pytest.raises(SettingError, match=r"end in .png|a folder that exists|a path: got 7"):
            plot("no subject", path)
    with pytest.raises(SettingError, match=r"must be a Comparison, Forecast, .*: got 7"):
        plot(7, tmp_path / "hunt.png")
    assert os.listdir(tmp_path) == []


def test_what_was_learnt_is_plotted(tmp_path):
    maze = cr.GridWorld(["..T", "S.."])
    near = cr.GridWorld([".T", "S."])
    edge = cr.Transfer("$near$", "maze", cr.project(maze, near))
    trained = cr.Curriculum({"$near$": near, "maze": maze}, [edge], budget=500).train(seeds=2)
    figure = plot(trained, tmp_path / "both.png")
    assert [axes.get_title() for axes in figure.axes] == ["$near$", "maze"]
    assert [axes.get_ylabel() for axes in figure.axes] == ["greedy return"] * 2
    learnt = trained["maze"]
    (axes,) = plot(learnt).axes
    assert axes.lines[0].get_ydata().tolist() == learnt.greedy_return.mean(axis=0).tolist()
    off = cr.GreedyEvaluation(method="off")
    assert (
        plot(cr.learn(maze, budget=500, evaluation=off)).axes[0].get_ylabel() == "training return"
    )
    data = {"name": "line", "seeds": [0, 1], "arms": {"near": {
        "tasks": {"maze": {"type": "maze", "map": "S.T", "budget": 500}}}}}  # fmt: skip
    study = cr.study.StudyConfig.from_data(data, tmp_path)
    found = cr.run_study(study, tmp_path / "out", progress=False)
    assert len(plot(found).axes) == len(plot(found.comparison).axes) == 3
    values = learnt.values[0]
    drawn = plot(values, task=maze).axes[0]
    assert drawn.get_title() == "max Q(s, a)"
    assert plot(cr.solve(maze).values, task=maze).axes[0].get_title() == "V(s)"
    for subject, given in ((values, None), (trained, maze), (values, near)):
        with pytest.raises(SettingError):
            plot(subject, tmp_path / "none.png", task=given)
    assert not (tmp_path / "none.png").exists()


def test_a_dollar_in_a_name_begins_no_formula():
    maze = cr.GridWorld(["..T", "S.."])
    name = r"$\frac{a$"
    edge = cr.Transfer(f"{name}b", f"{name}c", cr.transfer.identity(maze))
    plan = cr.Curriculum({f"{name}b": maze, f"{name}c": maze}, [edge], budget=100)
    for subject in (cr.compare({name: plan}, seeds=2), cr.forecast(plan, seeds=1)):
        figure = cr.plot(subject)
        figure.savefig(io.BytesIO(), format="png")  # by the user, without our settings
    for figure in draw_learning_curves(cr.compare({name: plan}, seeds=2)):
        figure.savefig(io.BytesIO(), format="svg")
