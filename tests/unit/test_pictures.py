"""What is drawn: lines, marks, limits, words. No pixels are compared."""

import os

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

import curricle as cr
from curricle.comparison.arms import Arm
from curricle.comparison.comparison import Comparison
from curricle.errors import CurriculumError, SettingError
from curricle.plotting.choice_flips import collapse_figure, draw_flips
from curricle.plotting.comparison import draw_comparison
from curricle.plotting.figures import COLOURS
from curricle.plotting.forecast import draw_forecast
from curricle.plotting.grid_view import board
from curricle.plotting.picture import plot, save
from curricle.plotting.potentials import draw_potential, draw_sources, shared_limits
from curricle.plotting.scales import return_scale, steps_scale
from curricle.statistics.curves import Curve

STEPS = np.arange(0, 101, 10)


def arm(values, source_steps=0, control=False, seeds=4):
    """An arm whose seeds lie 0, 1, 2, ... above the given curve."""
    rows = np.broadcast_to(values, STEPS.shape) + np.arange(seeds)[:, np.newaxis]
    flat = np.zeros(rows.shape)
    return Arm(Curve(STEPS, rows, np.full(seeds, source_steps)), flat, flat, control)


def comparison(seeds=4, **more):
    arms = {
        "scratch": arm(0.0, seeds=seeds),
        "taught": arm(10.0, 20, seeds=seeds),
        "taught, placebo": arm(-5.0, 20, control=True, seeds=seeds),
        **more,
    }
    return Comparison("hunt", arms, 80, 100, 7.5, 1)


def labelled(axes):
    """The lines with a name of their own."""
    return {line.get_label(): line for line in axes.lines if line.get_label()[0] != "_"}


def words(figure):
    return figure.get_supxlabel().replace("\n", " ")


def texts(axes):
    return [text.get_text() for text in axes.texts]


def greyness(colour):
    return 1 - np.ptp(to_rgb(colour))


# -- comparisons ---------------------------------------------------------------------------------


def test_a_curve_begins_where_its_sources_end():
    axes = draw_comparison(comparison()).axes[0]
    curves = labelled(axes)
    assert set(curves) == {"scratch", "taught", "taught, placebo"}
    assert curves["scratch"].get_xdata()[0] == 0
    taught = curves["taught"]
    assert (taught.get_xdata() == np.arange(20, 101, 10)).all()
    assert (taught.get_ydata() == 11.5).all()  # the mean of seeds 10 to 13
    lead_in = [line for line in axes.lines if line.get_linestyle() == ":"]
    assert [list(line.get_xdata()) for line in lead_in] == [[0, 20, 20]] * 2
    assert sorted(list(line.get_ydata()) for line in lead_in) == [
        [1.5, 1.5, -3.5],
        [1.5, 1.5, 11.5],
    ]
    circles = [line for line in axes.lines if line.get_marker() == "o"]
    assert {(*line.get_xdata(), *line.get_ydata()) for line in circles} == {(20, 11.5), (20, -3.5)}


def test_the_curves_show_the_threshold_and_all_steps():
    axes = draw_comparison(comparison()).axes[0]
    assert axes.get_xlim() == (0, 100)
    assert axes.get_xlabel() == "total steps"
    assert "threshold 7.5" in texts(axes)
    assert [7.5, 7.5] in [list(line.get_ydata()) for line in axes.lines]
    assert len(axes.collections) == 3  # a band each
    low, high = axes.get_ylim()
    assert low < -5
    assert high > 13


def test_controls_are_dashed_and_greyer():
    axes = draw_comparison(comparison()).axes[0]
    curves = labelled(axes)
    assert curves["taught"].get_linestyle() == curves["scratch"].get_linestyle() == "-"
    assert curves["taught, placebo"].get_linestyle() == "--"  # what Matplotlib calls any dashes
    assert curves["scratch"].get_color() == COLOURS["black"]
    colours = [curves[name].get_color() for name in ("taught", "taught, placebo")]
    assert greyness(colours[0]) < greyness(colours[1])


def test_a_profile_steps_down_where_a_run_ends():
    axes = draw_comparison(comparison()).axes[1]
    line = labelled(axes)["taught"]
    assert line.get_drawstyle() == "steps-post"
    share = dict(zip(line.get_xdata(), line.get_ydata(), strict=True))
    assert [share[tau] for tau in (3, 10, 11, 12, 13)] == [1, 0.75, 0.5, 0.25, 0]
    low, high = axes.get_xlim()
    assert min(share) == low < -5
    assert max(share) == high > 13


def test_gains_have_a_row_each_with_interval_and_p():
    found = comparison()
    axes = draw_comparison(found).axes[2]
    assert [label.get_text() for label in axes.get_yticklabels()] == [
        "scratch",
        "taught",
        "placebo",
    ]
    assert [0, 0] in [list(line.get_xdata()) for line in axes.lines]
    dots = labelled(axes)
    for row, name in enumerate(["taught", "taught, placebo"], 1):
        gain = found.contrasts[name].strong_gain
        assert (*dots[name].get_xdata(), *dots[name].get_ydata()) == (gain.estimate, row)
        segment = axes.collections[row - 1].get_segments()[0]
        assert segment.tolist() == [[gain.low, row], [gain.high, row]]
        assert f"{found.contrasts[name].adjusted_p:.2g}" in texts(axes)
        assert dots[name].get_markerfacecolor() == "w"  # p is 1/8 at best with 4 seeds
    assert {"reference", "gain [95 %]", "p (Holm)"} <= set(texts(axes))


def test_significant_gains_are_filled():
    dots = labelled(draw_comparison(comparison(seeds=8)).axes[2])
    assert dots["taught"].get_markerfacecolor() == COLOURS["blue"]


def test_the_caption_says_seeds_intervals_and_correction():
    said = words(draw_comparison(comparison()))
    for part in ("4 seeds", "95 % percentile bootstrap", "2 arms by Holm", "controls"):
        assert part in said
    alone = Comparison("hunt", {n: comparison()[n] for n in ("scratch", "taught")}, 80, 100, 7.5, 1)
    said = words(draw_comparison(alone))
    assert "controls" not in said
    assert "of one arm" in said


def test_one_seed_has_no_intervals_and_no_p():
    figure = draw_comparison(comparison(seeds=1))
    assert words(figure).startswith("One seed, which allows neither intervals nor tests")
    assert not figure.axes[0].collections
    assert not figure.axes[1].collections
    assert "p (Holm)" not in texts(figure.axes[2])


def test_twelve_curricula_differ_in_colour_or_dashes(tmp_path):
    arms = {f"number {i}": arm(float(i), 10) for i in range(12)}
    figure = draw_comparison(comparison(**arms))
    curves = labelled(figure.axes[0])
    looks = {(line.get_color(), repr(line._dash_pattern)) for line in curves.values()}
    assert len(looks) == len(curves) == 15
    save(figure, tmp_path / "twelve.png")


def test_an_arm_without_sources_has_no_lead_in():
    axes = draw_comparison(comparison(random_return=arm(2.0))).axes[0]
    assert len([line for line in axes.lines if line.get_linestyle() == ":"]) == 2


def test_seeds_whose_sources_end_at_other_steps_are_charged_one_by_one():
    late = Curve(STEPS, np.full((4, 11), 8.0), np.array([10, 10, 30, 30]))
    other = Arm(late, np.zeros((4, 11)), np.zeros((4, 11)), False)
    line = labelled(draw_comparison(comparison(other=other)).axes[0])["other"]
    # At 10 and 20 two seeds are at 8 and two at the direct learner's first values, 2 and 3.
    assert line.get_xdata()[0] == 10
    assert line.get_ydata()[:3].tolist() == [(8 + 8 + 2 + 3) / 4] * 2 + [8]


def test_a_comparison_without_arms_is_refused():
    alone = Comparison("hunt", {"scratch": arm(0.0)}, 80, 100, 7.5, 1)
    with pytest.raises(SettingError, match="an arm besides 'scratch'"):
        draw_comparison(alone)


def test_returns_over_decades_are_drawn_on_a_bent_axis():
    far = {"scratch": arm(-400.0), "taught": arm(-8.0, 20)}
    curves, profile, gains = draw_comparison(Comparison("hunt", far, 80, 100, -9.0, 1)).axes
    assert curves.get_yscale() == profile.get_xscale() == "symlog"
    assert "symlog" in curves.get_ylabel()
    assert "symlog" in profile.get_xlabel()
    assert gains.get_xscale() == "linear"
    assert curves.get_ylim()[0] < -400


@pytest.mark.parametrize(
    ("low", "high", "kind"),
    [
        (-100, -10, "linear"),
        (-100, -1, "symlog"),
        (1, 100, "symlog"),
        (-100, 0, "symlog"),
        (-3000, 170, "symlog"),
        (-170, 170, "linear"),
        (5, 5, "linear"),
        (0, 0, "linear"),
    ],
)
def test_an_axis_of_returns_holds_them_all(low, high, kind):
    axes = Figure().subplots()
    return_scale(axes.yaxis, low, high)
    assert axes.get_yscale() == kind
    bottom, top = axes.get_ylim()
    assert bottom < low
    assert high < top
    assert 2 <= len([tick for tick in axes.get_yticks() if bottom <= tick <= top]) <= 12


@pytest.mark.parametrize(
    ("most", "unit", "written"),
    [(900, "", "800"), (50_000, "thousands", "0.8"), (9_000_000, "millions", "0.0008")],
)
def test_steps_have_a_round_unit(most, unit, written):
    axes = Figure().subplots()
    assert steps_scale(axes.xaxis, most) == unit
    assert axes.xaxis.get_major_formatter()(800) == written


# -- forecasts and files -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def hunt():
    return cr.Pursuit(3, 2, discount=0.9, time_limit=30)


@pytest.fixture(scope="module")
def plan(hunt):
    chase = cr.Pursuit(3, 1, discount=0.9, time_limit=30)
    return cr.Curriculum(
        tasks={"chase": chase, "hunt": hunt},
        transfers=[
            cr.Transfer("chase", "hunt", cr.project(hunt, chase, predator=name))
            for name in hunt.predator_names
        ],
        budget={"chase": 5_000, "hunt": 500},
    )


@pytest.fixture(scope="module")
def foreseen(plan):
    return cr.forecast(plan, seeds=3)


@pytest.fixture(scope="module")
def trained(plan):
    return plan.train(2)


def test_a_forecast_has_a_bar_for_each_potential(foreseen):
    figure = draw_forecast(foreseen)
    (axes,) = figure.axes
    names = [label.get_text() for label in axes.get_yticklabels()]
    assert [name.removesuffix(" (used)") for name in names] == [o.name for o in foreseen.rows]
    assert [name for name in names if name.endswith(" (used)")] == ["mean (used)"]
    for bar, one in zip(axes.patches, foreseen.rows, strict=True):
        assert bar.get_x() == pytest.approx(foreseen.random_return)
        assert bar.get_x() + bar.get_width() == pytest.approx(one.mean("start"))
        assert f"{one.mean('optimistic'):.0%}" in texts(axes)
        assert f"× {one.scale:.2g}" in texts(axes)
    assert any(text.startswith("optimum −") for text in texts(axes))
    low, high = axes.get_xlim()
    assert low < foreseen.random_return
    assert foreseen.optimum < high
    assert "3 seeds of the sources" in words(figure)
    assert "no intervals" in words(figure)


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf", ".PNG"])
def test_a_picture_is_written_the_same_each_time(tmp_path, foreseen, suffix):
    written = []
    for name in ("one", "other"):
        figure = plot(foreseen, tmp_path / f"{name}{suffix}")
        assert isinstance(figure, Figure)
        written.append((tmp_path / f"{name}{suffix}").read_bytes())
    assert written[0] == written[1]
    assert len(written[0]) > 5_000


def test_a_comparison_is_plotted_too(tmp_path):
    assert len(plot(comparison(), str(tmp_path / "hunt.svg")).axes) == 3
    assert (tmp_path / "hunt.svg").read_text("utf-8").rstrip().endswith("</svg>")
    assert os.listdir(tmp_path) == ["hunt.svg"]


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("hunt.bmp", "must end in .png, .svg, .pdf"),
        ("hunt", "must end in .png, .svg, .pdf"),
        ("nowhere/hunt.png", "a folder that exists"),
        ("folder.png", "a folder that exists"),
    ],
)
def test_a_path_is_refused_before_anything_is_drawn(tmp_path, name, said):
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(SettingError, match=said):
        plot("no subject", tmp_path / name)
    assert os.listdir(tmp_path) == ["folder.png"]


def test_a_subject_is_refused_and_nothing_written(tmp_path):
    with pytest.raises(SettingError, match="must be a Comparison or a Forecast: got 7"):
        plot(7, tmp_path / "hunt.png")
    with pytest.raises(SettingError, match="must be a path: got 7"):
        plot(comparison(), 7)
    assert os.listdir(tmp_path) == []


def test_a_failure_leaves_the_picture_that_was_there(tmp_path, monkeypatch):
    place = tmp_path / "hunt.png"
    place.write_bytes(b"before")

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(SettingError, match="No space left on device"):
        plot(comparison(), place)
    assert os.listdir(tmp_path) == ["hunt.png"]
    assert place.read_bytes() == b"before"


# -- boards --------------------------------------------------------------------------------------


def test_a_board_of_a_pursuit_is_one_predator_s_cell(hunt):
    shown = board(hunt, {"prey": (1, 2), "predator_1": 4})
    where = hunt.states.decode(shown.states)
    assert set(where["prey"]) == {5}
    assert set(where["predator_1"]) == {4}
    assert (where["predator_2"] == 3 * shown.cells[:, 0] + shown.cells[:, 1]).all()
    assert shown.letters == (("P", 1, 2), ("1", 1, 1))
    assert shown.ended.sum() == 0  # both predators would have to be with the prey
    both = board(hunt, {"prey": (1, 2), "predator_1": "(1,2)"})
    assert both.cells[both.ended].tolist() == [[1, 2]]


def test_letters_differ():
    chase = cr.Pursuit(3, 1)
    assert board(chase, {"predator": 0}).letters == (("P", 0, 0),)
    three = cr.Pursuit(2, 3)
    at = {"prey": 0, "predator_1": 1, "predator_3": 2}
    assert [letter for letter, *_ in board(three, at).letters] == ["P", "1", "3"]


@pytest.fixture(scope="module")
def keyed():
    """A task whose state is a key, a row from 3 and a column; nothing moves."""
    states = cr.Space([cr.Component("key", 2), cr.Component("y", 2, low=3), cr.Component("x", 3)])
    return cr.FiniteMDP.from_outcomes(
        [[[(1.0, s, 0.0)]] for s in range(12)],
        states=states,
        terminal=[False] * 12,
        start=0,
        discount=0.9,
    )


def test_a_row_and_a_column_make_a_board(keyed):
    shown = board(keyed, {"key": 1})
    assert shown.states.tolist() == [6, 7, 8, 9, 10, 11]
    assert (shown.origin, shown.shape, shown.words) == ((3, 0), (2, 3), "key 1")


@pytest.mark.parametrize(
    ("at", "said"),
    [
        (None, "leaves prey, predator_1, predator_2"),
        ({"prey": 0}, "leaves predator_1, predator_2"),
        ({"prey": 0, "predator_1": 0, "predator_2": 0}, "leaves none"),
        ({"wolf": 0}, "prey, predator_1, predator_2: got 'wolf'"),
        ({"prey": 9, "predator_1": 0}, r"prey runs from \(0,0\) to \(2,2\): got 9"),
        ({"prey": (1, 3), "predator_1": 0}, r"got \(1, 3\)"),
        ({"prey": "here", "predator_1": 0}, "got 'here'"),
        ([("prey", 0)], "at must be a Mapping"),
    ],
)
def test_what_makes_no_board_is_refused(hunt, at, said):
    with pytest.raises(SettingError, match=said):
        board(hunt, at)


def test_a_maze_takes_no_at():
    with pytest.raises(SettingError, match="a maze is drawn whole"):
        board(cr.GridWorld("S.T"), {"row": 0})


# -- potentials ----------------------------------------------------------------------------------


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
    assert {"4.0", "3.0", "5.0", "6.0", "T"} == set(texts(axes))
    assert axes.get_title() == "φ (return)"
    assert any(patch.get_hatch() for patch in axes.patches)
    assert axes.get_xlim() == (0.5, 3.5)
    assert axes.get_ylim() == (3.5, 1.5)


@pytest.mark.parametrize(
    ("values", "options", "limits", "colours"),
    [
        ([-1.0, 3.0, 0.0], {}, (-3, 3), "PuOr"),
        ([1.0, 3.0, 0.0], {"difference": True}, (-3, 3), "PuOr"),
        ([0.0, 0.0, 0.0], {"difference": True}, (-1, 1), "PuOr"),
        ([1.0, 3.0, 0.0], {"limits": (0.0, 8.0)}, (0, 8), "cividis"),
        ([1.0, 3.0, 0.0], {"limits": (-2.0, 1.0)}, (-2, 2), "PuOr"),
        ([2.0, 2.0, 0.0], {}, (1, 3), "cividis"),
    ],
)
def test_colours_diverge_around_zero_only_where_there_are_two_sides(
    values, options, limits, colours
):
    image = draw_potential(
        Figure().subplots(), cr.GridWorld("S.T"), values, label="", bar=False, **options
    )
    assert image.get_clim() == limits
    assert image.get_cmap().name == colours


def test_limits_are_shared_over_what_is_shown(hunt):
    here, there = {"prey": 0, "predator_1": 1}, {"prey": 8, "predator_1": 1}
    values = hunt.states.decode()["prey"].astype(float)
    assert shared_limits(hunt, values, 2 * values + 1, at=there) == (8, 17)
    assert shared_limits(hunt, values, at=here) == (0, 0)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (np.zeros(4), r"shape \(3,\) or \(3, 4\): got \(4,\)"),
        ([0.0, np.nan, 0.0], r"entry \(1,\) is nan"),
        ("no numbers", "must be an array of numbers"),
    ],
)
def test_values_that_are_none_of_the_task_are_refused(values, said):
    with pytest.raises(SettingError, match=said):
        draw_potential(Figure().subplots(), cr.GridWorld("S.T"), values, label="")


def test_sources_are_drawn_one_by_one_and_against_the_truth(plan, trained, hunt, tmp_path):
    at = {"prey": (1, 1), "predator_2": (0, 0)}
    figure = draw_sources(trained, seed=1, at=at)
    panels = [axes for axes in figure.axes if axes.get_title()]
    titles = [axes.get_title() for axes in panels]
    assert titles == [
        "φ₁: chase -> hunt [1]",
        "φ₂: chase -> hunt [2]",
        "φ: mean",
        "V* = max Q*",
        "φ(s, a*) − V*(s)",
    ]
    images = [axes.images[0] for axes in panels]
    assert len({image.get_clim() for image in images[:4]}) == 1
    shown = board(hunt, at).states
    phi, truth = trained.potentials["hunt"][1].values, cr.solve(hunt).values
    drawn = [image.get_array().filled(np.nan).ravel() for image in images]
    assert drawn[2] == pytest.approx(phi.max(axis=1)[shown])
    assert drawn[3] == pytest.approx(truth[shown], abs=1e-5)
    assert drawn[4] == pytest.approx((phi.max(axis=1) - truth)[shown], abs=1e-5)
    assert images[4].get_cmap().name == "PuOr"
    first = plan.potentials("hunt", trained.nodes, transfers=plan.transfers[:1])[1]
    assert drawn[0] == pytest.approx(first.values.max(axis=1)[shown])
    assert "Seed 1" in words(figure)
    assert "Cells: where predator_1 is; P: prey, 2: predator_2." in words(figure)
    save(figure, tmp_path / "sources.png")


def test_a_calibrated_aggregate_says_its_scale(hunt):
    chase = cr.Pursuit(3, 1, discount=0.9, time_limit=30)
    edge = cr.Transfer(
        "chase", "hunt", cr.project(hunt, chase, predator="predator_1"), calibrate=True
    )
    plan = cr.Curriculum({"chase": chase, "hunt": hunt}, [edge], budget=5_000)
    result = plan.train()
    figure = draw_sources(result, at={"prey": 0, "predator_2": 0})
    scale = result.calibrations["hunt"][0].scale
    assert figure.axes[1].get_title() == f"φ: mean, calibrated × {scale:.2g}"


def test_sources_of_any_grid_are_drawn(keyed):
    plan = cr.Curriculum(
        {"easy": keyed, "hard": keyed},
        [cr.Transfer("easy", "hard", cr.transfer.identity(keyed))],
        budget=100,
    )
    figure = draw_sources(plan.train(), at={"key": 0})
    # A single source is its own aggregate.
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert titles == ["φ: easy -> hard", "V* = max Q*", "φ(s, a*) − V*(s)"]
    assert words(figure).endswith("Key 0.")


def test_sources_that_cannot_be_drawn_are_refused(plan, trained, hunt):
    with pytest.raises(SettingError, match="seed must be one of 0, 1: got 2"):
        draw_sources(trained, seed=2, at={"prey": 0, "predator_1": 0})
    with pytest.raises(SettingError, match="leaves prey, predator_1, predator_2"):
        draw_sources(trained)
    with pytest.raises(CurriculumError, match="'chase' has none"):
        draw_sources(trained, "chase")


def test_sources_alone_are_drawn_before_the_target_is_learnt(plan):
    result = plan.train(only=["chase"])
    figure = draw_sources(result, at={"prey": 0, "predator_1": 4})
    assert "φ: mean" in [axes.get_title() for axes in figure.axes]


# -- flips ---------------------------------------------------------------------------------------


def test_flips_are_marked_in_their_cells(hunt):
    at = {"prey": (1, 1), "predator_2": (0, 0)}
    turned = np.zeros(hunt.states.size, int)
    shown = board(hunt, at)
    turned[shown.states[[1, 2]]] = 1
    turned[shown.states[5]] = -1
    axes = Figure().subplots()
    draw_flips(axes, hunt, turned, at=at)
    marks = labelled(axes)
    assert set(marks) == {"became right: 2", "became wrong: 1"}
    wrong = marks["became wrong: 1"]
    assert (wrong.get_xdata().round().tolist(), wrong.get_ydata().round().tolist()) == ([2], [1])
    assert marks["became right: 2"].get_marker() != wrong.get_marker()
    assert {"P", "2"} == set(texts(axes))


@pytest.mark.parametrize("flips", [[1, 0], [2, 0, 0], [0.5, 0, 0], [[1, 0, 0]]])
def test_flips_of_other_states_are_refused(flips):
    with pytest.raises(SettingError, match=r"\+1, -1 or 0 for each of 3 states"):
        draw_flips(Figure().subplots(), cr.GridWorld("S.T"), flips)


def test_a_collapse_is_shown_over_time(plan, trained, hunt, tmp_path):
    phi = trained.potentials["hunt"]
    learner = cr.QLearning(epsilon=0.2)
    figure = collapse_figure(hunt, phi, learner, 4_000, [4_000, 100, 1_000], seeds=2, stream="hunt")
    returns, alike, visited = figure.axes
    assert set(labelled(returns)) == {"episodes while learning", "greedy policy"}
    optimal, alive = cr.solve(hunt, tolerance=1e-6).optimal, ~hunt.mdp.terminal
    for time, place in ((0, 0), (100, 1), (4_000, 3)):
        tables = [one.values for one in phi]
        if time:
            learning = {"seeds": 2, "potential": phi, "stream": "hunt", "eval_freq": 50}
            tables = cr.learn(hunt, learner, time, **learning).values
        greedy = [values == values.max(axis=1, keepdims=True) for values in tables]
        right = np.array([(optimal | ~each).all(axis=1)[alive].mean() for each in greedy])
        line = labelled(alike)["right"]
        assert line.get_xdata().tolist() == [0, 100, 1_000, 4_000]
        assert line.get_ydata()[place] == pytest.approx(right.mean())
    for axes in (alike, visited):
        drawn = {name: line.get_ydata() for name, line in labelled(axes).items()}
        assert drawn["became wrong"][0] == drawn["became right"][0] == 0
        balance = drawn["right"][0] + drawn["became right"] - drawn["became wrong"]
        assert drawn["right"] == pytest.approx(balance)
        assert len(axes.collections) == 3
    assert alike.get_ylim() == visited.get_ylim()
    assert "2 seeds" in words(figure)
    save(figure, tmp_path / "collapse.pdf")


def test_a_learning_in_which_no_episode_ends_is_drawn_too():
    maze = cr.GridWorld(["S..", "..T"])
    phi = cr.StateActionPotential(maze, np.zeros((6, 4)))
    figure = collapse_figure(maze, phi, cr.QLearning(), 2, [1])
    assert set(labelled(figure.axes[0])) == {"greedy policy"}
    assert words(figure).startswith("One seed: no intervals")


def test_a_collapse_has_a_budget_in_steps():
    maze = cr.GridWorld("S.T")
    phi = cr.StateActionPotential(maze, np.zeros((3, 4)))
    with pytest.raises(SettingError, match="a budget in steps"):
        collapse_figure(maze, phi, cr.QLearning(), cr.Episodes(5), [1])


@pytest.mark.parametrize("times", [[], [0, 5], [11], [2.5]])
def test_times_outside_the_budget_are_refused(times):
    maze = cr.GridWorld("S.T")
    phi = cr.StateActionPotential(maze, np.zeros((3, 4)))
    with pytest.raises(SettingError, match="times"):
        collapse_figure(maze, phi, cr.QLearning(), 10, times)
