"""Figures on grids: views, potentials, sources. No pixels are compared."""

import numpy as np
import pytest
from matplotlib.figure import Figure

import curricle as cr
from curricle.errors import CurriculumError, SettingError
from curricle.show.grids import draw_potential, draw_sources, shared_limits
from curricle.show.plots import save
from curricle.show.views import GridView

from .studies import texts_of


def test_a_view_of_a_pursuit_is_one_predator_s_cell(hunt):
    shown = GridView.of(hunt, {"prey": (1, 2), "predator_1": 4})
    where = hunt.states.decode(shown.states)
    assert set(where["prey"]) == {5}
    assert set(where["predator_1"]) == {4}
    assert (where["predator_2"] == 3 * shown.cells[:, 0] + shown.cells[:, 1]).all()
    assert shown.letters == (("P", 1, 2), ("1", 1, 1))
    assert shown.ended.sum() == 0  # both predators would have to be with the prey
    both = GridView.of(hunt, {"prey": (1, 2), "predator_1": "(1,2)"})
    assert both.cells[both.ended].tolist() == [[1, 2]]


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


def test_a_row_and_a_column_make_a_view(keyed):
    shown = GridView.of(keyed, {"key": 1})
    assert shown.states.tolist() == [6, 7, 8, 9, 10, 11]
    assert (shown.origin, shown.shape, shown.words) == ((3, 0), (2, 3), "key 1")


def test_what_makes_no_grid_is_refused(hunt):
    wrong = [None, {"wolf": 0}, {"prey": (1, 3), "predator_1": 0}, [("prey", 0)]]
    wrong.append({"prey": 0, "predator_1": 0, "predator_2": 0})
    for at in wrong:
        with pytest.raises(SettingError, match=r"leaves|got 'wolf'|got \(1, 3\)|be a Mapping"):
            GridView.of(hunt, at)


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
    assert axes.get_title() == "φ (return)"
    assert any(patch.get_hatch() for patch in axes.patches)
    assert axes.get_xlim() == (0.5, 3.5)
    assert axes.get_ylim() == (3.5, 1.5)


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


@pytest.mark.parametrize("values", [np.zeros(4), [0.0, np.nan, 0.0], "no numbers"])
def test_values_that_are_none_of_the_task_are_refused(values):
    with pytest.raises(SettingError, match=r"got \(4,\)|entry \(1,\) is nan|array of numbers"):
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
    shown = GridView.of(hunt, at).states
    phi, truth = trained.potentials["hunt"][1].values, cr.solve(hunt).values
    drawn = [image.get_array().filled(np.nan).ravel() for image in images]
    assert drawn[2] == pytest.approx(phi.max(axis=1)[shown])
    assert drawn[3] == pytest.approx(truth[shown], abs=1e-5)
    assert drawn[4] == pytest.approx((phi.max(axis=1) - truth)[shown], abs=1e-5)
    assert images[4].get_cmap().name == "PuOr"
    first = plan.potentials("hunt", trained.nodes, transfers=plan.transfers[:1])[1]
    assert drawn[0] == pytest.approx(first.values.max(axis=1)[shown])
    save(figure, tmp_path / "sources.png")


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
