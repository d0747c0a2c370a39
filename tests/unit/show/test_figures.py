"""Figures: lines, marks, limits, words, views and values on grids. No pixels are compared."""

import io
import os
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import FillBetweenPolyCollection, LineCollection
from matplotlib.figure import Figure

import curricle as cr
from curricle.comparison.comparison import Comparison
from curricle.comparison.measures import Arm, Reference
from curricle.errors import SettingError, TaskError
from curricle.learning.result import ends_of
from curricle.pictures.views import GridView
from curricle.show.plots import draw_comparison, draw_learning_curves, draw_potential, plot
from curricle.statistics.curves import Curve
from curricle.study.results import StudyResults

from .studies import labelled, texts_of

STEPS = np.arange(0, 101, 10)


def arm(values, source_steps=0, curriculum="", seeds=4, spread=1.0):
    """An arm whose seeds lie 0, 1, 2, ... times the spread above the given curve."""
    rows = np.broadcast_to(values, STEPS.shape) + spread * np.arange(seeds)[:, np.newaxis]
    return Arm(Curve(STEPS, rows, np.full(seeds, source_steps)), curriculum=curriculum)


def compared(**arms):
    return Comparison("hunt", {"scratch": arm(0.0), **arms}, 80, 100, Reference(7.5), 1)


def comparison(seeds=4, **more):
    arms = {
        "scratch": arm(0.0, seeds=seeds),
        "mean": arm(10.0, 20, seeds=seeds),
        "mean, placebo": arm(-5.0, 20, curriculum="mean", seeds=seeds),
    }
    return compared(**arms | more)


def test_a_curve_begins_where_its_sources_end():
    axes = draw_comparison(comparison()).axes[0]
    curves = labelled(axes)
    assert set(curves) == {"scratch", "mean", "mean, placebo"}
    assert curves["scratch"].get_xdata()[0] == 0
    mean = curves["mean"]
    assert (mean.get_xdata() == np.arange(20, 101, 10)).all()
    assert (mean.get_ydata() == 11.5).all()  # the mean of seeds 10 to 13
    lead_in = [line.get_xydata().tolist() for line in axes.lines if line.get_linestyle() == ":"]
    starts = [[[0, 1.5], [20, 1.5], [20, y]] for y in (-3.5, 11.5)]
    assert sorted(lead_in) == starts
    circles = [line.get_xydata().tolist() for line in axes.lines if line.get_marker() == "o"]
    assert sorted(circles) == [[[20, -3.5]], [[20, 11.5]]]


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
    placebo = arm(-5.0, 20, curriculum="mean", seeds=6, spread=3.0)
    helped = arm(10.0, 20, seeds=6, spread=2.0)
    result = comparison(seeds=6, **{"mean": helped, "mean, placebo": placebo})
    axes = draw_comparison(result).axes[2]
    ticks = [label.get_text() for label in axes.get_yticklabels()]
    assert ticks == ["scratch", "mean", "placebo"]
    assert [0, 0] in [list(line.get_xdata()) for line in axes.lines]
    dots = labelled(axes)
    for row, name in enumerate(["mean", "mean, placebo"], 1):
        gain = result.contrasts[name].strong_gain
        assert (*dots[name].get_xdata(), *dots[name].get_ydata()) == (gain.estimate, row)
        segment = axes.collections[row - 1].get_segments()[0]
        assert segment.tolist() == [[gain.low, row], [gain.high, row]]
        filled = name == "mean"  # a control is compared with its curriculum only
        assert (dots[name].get_markerfacecolor() == "w") is not filled
    assert f"{result.verdicts['mean'].adjusted_p:.2g}" in texts_of(axes)
    assert {"reference", "gain [95 %]", "p (Holm)"} <= set(texts_of(axes))


def test_returns_over_decades_are_drawn_on_a_bent_axis():
    far = replace(compared(scratch=arm(-400.0), mean=arm(-8.0, 20)), reference=Reference(-9.0))
    curves, profile, gains = draw_comparison(far).axes
    scales = curves.get_yscale(), profile.get_xscale(), gains.get_xscale()
    assert scales == ("symlog", "symlog", "linear")
    assert curves.get_ylim()[0] < -400


def test_a_figure_may_leave_profiles_out_and_has_no_gains_where_nothing_is_transferred():
    figure = draw_comparison(compared(mean=arm(8.0, 20)), profiles=False)
    assert [axes.get_title() for axes in figure.axes] == ["learning curves (strong transfer)", ""]
    assert figure.axes[1].get_title(loc="right") == "gain in mean return"
    assert figure.axes[1].get_xlabel() == "over that of the best opponent, scratch"
    assert not any("Middle" in text.get_text() for text in figure.texts)
    alone = draw_comparison(compared())
    assert [axes.get_title() for axes in alone.axes][1:] == ["final returns"]
    assert alone.axes[0].get_legend() is not None


def test_many_arms_are_lines_with_bars_and_whole_names():
    long = [f"{letter}, a name of many words that says what the arm does" for letter in "abcdefg"]
    unbroken = "without_any_space_" * 5
    many = {name: arm(float(n), 20) for n, name in enumerate([*long, unbroken])}
    figure = draw_comparison(compared(**many))
    curves, profile, gains = figure.axes
    assert not [
        drawn for drawn in curves.collections if isinstance(drawn, FillBetweenPolyCollection)
    ]
    assert not profile.collections
    bars = [drawn for drawn in curves.collections if isinstance(drawn, LineCollection)]
    assert len(bars) == 9
    places = [segment[0, 0] for drawn in bars for segment in drawn.get_segments()]
    assert len({*places}) >= 9  # of 11 checkpoints: they stand beside each other
    FigureCanvasAgg(figure).draw()
    shown = [label.get_text().replace("\n", " ") for label in gains.get_yticklabels()]
    assert shown[:-1] == ["scratch", *long]
    assert shown[-1].replace(" ", "") == unbroken
    whole, renderer = figure.bbox, FigureCanvasAgg(figure).get_renderer()
    for axes in figure.axes:
        for text in (axes.yaxis.label, axes.xaxis.label, *gains.get_yticklabels()):
            box = text.get_window_extent(renderer)
            assert whole.x0 <= box.x0 <= box.x1 <= whole.x1
            assert whole.y0 <= box.y0 <= box.y1 <= whole.y1
    names = [label.get_window_extent(renderer) for label in gains.get_yticklabels()]
    assert all(above.y0 >= below.y1 for above, below in pairwise(names))
    assert min(name.x0 for name in names) >= profile.get_window_extent(renderer).x1


def test_bands_stay_within_possible_returns():
    seeds = np.repeat([[0.0], [0.0], [1.0]], 11, axis=1)
    arms = {"scratch": Arm(Curve(STEPS, seeds)), "a": Arm(Curve(STEPS, seeds))}
    for possible, ends in ((None, (0, 1)), ((-0.25, 1.125), (-0.25, 1.125))):
        compared = Comparison("hunt", arms, 80, 100, Reference(0.5, possible=possible), 1)
        assert compared.within == ends
        for band in draw_comparison(compared).axes[0].collections:
            heights = band.get_paths()[0].vertices[:, 1]
            assert (heights.min(), heights.max()) == ends
        mean = compared.mean_return("a")
        assert (mean.low, mean.high) == ends
        assert mean.estimate == pytest.approx(1 / 3)


def test_discounted_returns_of_a_tabulated_task_are_possible():
    task = cr.interop.tabulate("CliffWalking-v1", discount=0.9, time_limit=20)
    highest = ends_of(cr.learn(task, budget=20, eval_freq=20))[1]
    assert highest == pytest.approx(-(1 - 0.9**13) / 0.1)  # undiscounted it is -13


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf", ".PNG"])
def test_a_picture_is_written_the_same_each_time(tmp_path, trained, suffix):
    paths = [tmp_path / f"{name}{suffix}" for name in ("first", "second")]
    assert all(isinstance(plot(trained, path), Figure) for path in paths)
    first, second = (path.read_bytes() for path in paths)
    assert first == second
    assert len(first) > 5_000


def test_what_cannot_be_drawn_is_refused_and_nothing_written(tmp_path, hunt):
    for path in (tmp_path / "hunt.bmp", tmp_path / "nowhere" / "hunt.png", 7):
        with pytest.raises(SettingError, match=r"end in .png|a folder that exists|a path: got 7"):
            plot("no subject", path)
    with pytest.raises(SettingError, match=r"must be a Comparison, StudyResults, .*: got 7"):
        plot(7, tmp_path / "hunt.png")
    assert os.listdir(tmp_path) == []
    for values in (np.zeros(4), [0.0, np.nan, 0.0], "no numbers"):
        with pytest.raises(SettingError, match=r"got \(4,\)|entry \(1,\) is nan|array of numbers"):
            draw_potential(Figure().subplots(), cr.GridWorld("S.T"), values, label="")
    all_fixed = {"prey": 0, "predator_1": 0, "predator_2": 0}
    for at in (None, {"wolf": 0}, [("prey", 0)], all_fixed):
        with pytest.raises(SettingError, match=r"leaves|got 'wolf'|be a Mapping"):
            GridView.of(hunt, at)
    with pytest.raises(TaskError, match=r"prey runs from \(0,0\) to \(2,2\): got '\(1,3\)'"):
        GridView.of(hunt, {"prey": (1, 3), "predator_1": 0})


def test_what_was_learnt_is_plotted(tmp_path, finished):
    maze = cr.GridWorld(["..T", "S.."])
    near = cr.GridWorld([".T", "S."])
    edge = cr.Transfer("$near$", "maze", cr.project(maze, near))
    trained = cr.Curriculum({"$near$": near, "maze": maze}, [edge], budget=500).train(seeds=2)
    figure = plot(trained, tmp_path / "both.png")
    assert [axes.get_title() for axes in figure.axes] == ["$near$", "maze"]
    assert [axes.get_ylabel() for axes in figure.axes] == ["mean return of greedy episodes"] * 2
    learnt = trained["maze"]
    (axes,) = plot(learnt).axes
    assert axes.lines[0].get_ydata().tolist() == learnt.greedy_return.mean(axis=0).tolist()
    unevaluated = cr.learn(maze, budget=500, evaluation=cr.GreedyEvaluation(method="off"))
    assert plot(unevaluated).axes[0].get_ylabel() == "mean return of training episodes"
    study = StudyResults(finished)
    assert len(plot(study).axes) == len(plot(study.comparison).axes) == 3
    values = learnt.values[0]
    assert plot(values, task=maze).axes[0].get_title() == "max Q(s, a)"
    assert plot(cr.solve(maze).values, task=maze).axes[0].get_title() == "V(s)"
    for subject, task in ((values, None), (trained, maze), (values, near)):
        with pytest.raises(SettingError):
            plot(subject, tmp_path / "none.png", task=task)
    assert not (tmp_path / "none.png").exists()


def test_a_dollar_in_a_name_begins_no_formula():
    maze = cr.GridWorld(["..T", "S.."])
    name = r"$\frac{a$"
    edge = cr.Transfer(f"{name}b", f"{name}c", cr.transfer.identity(maze))
    plan = cr.Curriculum({f"{name}b": maze, f"{name}c": maze}, [edge], budget=100)
    for subject in (cr.compare({name: plan}, seeds=2), cr.forecast(plan, seeds=1).trial):
        figure = cr.plot(subject)
        figure.savefig(io.BytesIO(), format="png")  # by the user, without our settings
    for figure in draw_learning_curves(cr.compare({name: plan}, seeds=2)):
        figure.savefig(io.BytesIO(), format="svg")


def test_a_view_of_a_pursuit_is_one_predator_s_cell(hunt):
    shown = GridView.of(hunt, {"prey": (1, 2), "predator_1": 4})
    where = hunt.states.decode(shown.states)
    assert (set(where["prey"]), set(where["predator_1"])) == ({5}, {4})
    assert (where["predator_2"] == 3 * shown.cells[:, 0] + shown.cells[:, 1]).all()
    assert shown.letters == (("P", 1, 2), ("1", 1, 1))
    assert shown.ended.sum() == 0  # both predators would have to be with the prey
    both = GridView.of(hunt, {"prey": (1, 2), "predator_1": "(1,2)"})
    assert both.cells[both.ended].tolist() == [[1, 2]]


def test_a_maze_s_values_lie_in_their_cells():
    maze = cr.GridWorld(["S#T", "..."], origin=(2, 1))
    values = np.array([[1.0, 4.0, 0.0, 2.0], [9.0] * 4, [3.0] * 4, [5.0] * 4, [6.0] * 4])
    axes = Figure().subplots()
    image = draw_potential(axes, maze, values, label="φ (return)")
    drawn = image.get_array().filled(np.nan)
    # The wall is no state, and at the treasure it is over.
    assert np.array_equal(drawn, [[4, np.nan, np.nan], [3, 5, 6]], equal_nan=True)
    assert image.get_clim() == (3, 6)
    assert image.get_cmap().name == "cividis"
    assert {"4.0", "3.0", "5.0", "6.0", "T"} == set(texts_of(axes))
    assert any(patch.get_hatch() for patch in axes.patches)
    assert (axes.get_xlim(), axes.get_ylim()) == ((0.5, 3.5), (3.5, 1.5))


@pytest.mark.parametrize(
    ("values", "options", "limits", "colours"),
    [
        ([-1.0, 3.0, 0.0], {}, (-3, 3), "PuOr"),
        ([1.0, 3.0, 0.0], {"difference": True}, (-3, 3), "PuOr"),
        ([1.0, 3.0, 0.0], {"limits": (0.0, 8.0)}, (0, 8), "cividis"),
        ([2.0, 2.0, 0.0], {}, (1, 3), "cividis"),
    ],
)
def test_colours_diverge_around_zero_only_where_there_are_two_sides(
    values, options, limits, colours
):
    axes = Figure().subplots()
    image = draw_potential(axes, cr.GridWorld("S.T"), values, label="", bar=False, **options)
    assert (image.get_clim(), image.get_cmap().name) == (limits, colours)
