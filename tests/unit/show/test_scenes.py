"""Pictures of tasks and their text, and environments whose states have a row and a column."""

import base64
import io
import re
from itertools import combinations

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from IPython.core.formatters import HTMLFormatter
from PIL import Image

import curricle as cr
from curricle import Pursuit, tasks
from curricle.errors import SettingError
from curricle.interop.gymnasium import to_gymnasium
from curricle.pictures.scenes import (
    AGENT,
    FIGURES,
    PREY,
    in_a_notebook,
    painted,
    predator,
    scene_of,
)
from curricle.pictures.views import GridView, bars_of, layout_of
from curricle.show.notebook import register_with
from tests.unit.interop.environments import TASKS, WALLED

from .studies import of_cells

GRIDS = {
    "four rooms": tasks.FourRooms(size=7),
    "key, lock, pit": tasks.KeyLockPit.room(5),
    "a river": tasks.RiverSwim(),
    "a sea": tasks.DeepSea(size=4),
    "a lake": tasks.FrozenLake(),
    "a cliff": tasks.CliffWalking(),
    "a taxi": tasks.Taxi(size=3, stands=2),
}


@pytest.mark.parametrize("task", [*TASKS.values(), *GRIDS.values()], ids=[*TASKS, *GRIDS])
def test_pictures_and_texts_of_all_states_have_one_size_and_differ(task):
    scene = scene_of(task)
    states = range(0, task.states.size, 1 + task.states.size // 40)
    pictures = [scene.image(state) for state in states]  # of terminal states too
    ((shape, dtype),) = {(picture.shape, picture.dtype) for picture in pictures}
    assert dtype == np.uint8
    assert all(side % 2 == 0 for side in shape[:2])  # as video formats want it
    texts = [scene.text(state) for state in states]
    assert len({picture.tobytes() for picture in pictures}) == len(set(texts)) == len(states)
    if (layout := layout_of(task)) is not None:
        for state, text in zip(states, texts, strict=True):
            lines, (row, column) = text.splitlines(), layout.cells[state] - layout.origin
            assert lines[row][column * (1 + scene.canvas.bars.any())] == "@"  # or a thin wall
            assert "".join(lines[: layout.shape[0]]).count("@") == 1


def test_figures_differ_without_their_colours():
    figures = [AGENT, PREY, predator(1), predator(2), predator(3), *set(FIGURES.values())]

    def in_grey(figure):
        colours, through = painted(figure, 32)
        return (colours + 247 * through).mean(axis=2)

    for first, second in combinations(map(in_grey, figures), 2):
        assert abs(first - second).max() > 100


def test_text_shows_who_is_where():
    environment = to_gymnasium(WALLED, render_mode="ansi")
    environment.reset(options={"state": {"row": 0, "column": 1}})
    assert environment.render() == "S@#T\nFP.."
    hunt = Pursuit(3, 2)
    environment = to_gymnasium(hunt, render_mode="ansi")
    environment.reset(options={"state": {"prey": 0, "predator_1": 0, "predator_2": 8}})
    assert environment.render() == "P1 .  .\n.  .  .\n.  .  2"
    with pytest.warns(UserWarning, match="render_mode"):
        assert to_gymnasium(WALLED).render() is None


MOVES = ("up", "right", "down", "left")


class Tank(gym.Env):
    """Rows 1 and 2, columns 0 to 2: down and right is the end; each move takes one of `full`."""

    def __init__(self, full=4):
        self.full = full
        self.observation_space = spaces.MultiDiscrete([2, 3, full + 1], start=[1, 0, 0])
        self.action_space = spaces.Discrete(4)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.row, self.column, self.fuel = 1, 0, self.full
        return self._seen(), {}

    def step(self, action):
        down, right = ((-1, 0), (0, 1), (1, 0), (0, -1))[action]
        self.row, self.column = np.clip([self.row + down, self.column + right], [1, 0], 2)
        self.fuel -= 1
        home = (self.row, self.column) == (2, 2)
        return self._seen(), float(home), home or self.fuel == 0, False, {}

    def _seen(self):
        return np.array([self.row, self.column, self.fuel])


NAMES = ["row", "column", "fuel"]
LIVE = cr.from_gymnasium(Tank, discount=0.9, names=NAMES, actions=MOVES, time_limit=9)


def test_the_grid_is_of_the_row_and_the_column_as_an_episode_starts():
    view = GridView.of(LIVE)
    assert (view.shape, view.origin, view.words) == ((2, 3), (1, 0), "fuel 4")
    assert view.directions == (1, 2, 3, 4)
    assert LIVE.states.decode(view.states)["fuel"].tolist() == [4] * 6
    assert view.walls.size == 0
    low = GridView.of(LIVE, {"fuel": 0})
    assert LIVE.states.decode(low.states)["fuel"].tolist() == [0] * 6


def test_other_names_of_rows_and_columns_make_a_grid_and_other_components_none():
    for names in (["row", "col", "fuel"], ["y", "x", "fuel"]):
        task = cr.from_gymnasium(Tank, discount=0.9, names=names, time_limit=9)
        assert layout_of(task).components == tuple(names[:2])
        assert GridView.of(task).directions is None  # actions without labels
    task = cr.from_gymnasium(Tank, discount=0.9, names=["a", "b", "c"], time_limit=9)
    assert layout_of(task) is None
    assert not GridView.for_replay(task).is_map
    with pytest.raises(SettingError, match="at must fix all other components of a, b, c"):
        GridView.of(task)
    assert GridView.of(task, {"c": 4}).shape == (2, 3)


def test_cells_of_states_with_other_components_are_no_walls():
    tabled = cr.tabulate(Tank, discount=0.9, actions=MOVES)
    view = GridView.of(tabled)
    assert view.words == "G: goal, fuel 4"
    assert view.cells.tolist() == [[1, 0]]  # with a full tank only the start
    assert view.walls.size == 0
    assert GridView.of(tabled, {"fuel": 3}).cells.tolist() == [[1, 0], [1, 1], [2, 0]]


def test_ends_are_read_off_tables_and_keys_off_names():
    lake = cr.from_gymnasium("FrozenLake-v1", discount=0.9)
    by_hand = set(layout_of(tasks.FrozenLake()).objects)
    assert {*layout_of(lake).objects} == by_hand
    cliff = cr.from_gymnasium("CliffWalking-v1", discount=0.9)
    assert layout_of(cliff).objects == (("goal", 3, 11, True),)
    names = "row", "column", "key_row", "key_column"
    space = cr.Space([cr.Component(name, 3, -1) for name in names])
    states = {"row": 0, "column": 1, "key_row": 1, "key_column": -1}
    rooms = cr.FiniteMDP.from_outcomes(
        [[[(1.0, s, 0.0, False)]] for s in range(81)],
        states=space,
        start=0,
        discount=0.9,
        time_limit=9,
    )
    assert layout_of(rooms).markers["key"][space.encode(**states)].tolist() == [1, -1]


@pytest.mark.parametrize("task", [*GRIDS.values(), LIVE, cr.Pursuit(3, 2)], ids=repr)
def test_a_grid_task_is_a_picture_in_a_notebook(task):
    formatter = HTMLFormatter()
    register_with(formatter)
    html = formatter(task)
    content = base64.b64decode(re.search('base64,([^"]+)"', html)[1])
    with Image.open(io.BytesIO(content)) as picture:
        assert picture.format == "PNG"
        assert np.ptp(np.asarray(picture), axis=(0, 1)).max() > 100
    assert html == formatter(task)
    assert "http" not in html


def test_a_task_without_a_grid_is_printed_in_a_notebook():
    numbered = cr.FiniteMDP.from_outcomes([[[(1.0, 0, 0.0, False)]]], start=0, discount=0.9)
    assert in_a_notebook(numbered) is None


def test_thin_walls_are_read_off_the_moves_of_a_town():
    # Dietterich's town: a wall stands in two upper rows, and two stand in the lower rows.
    text = scene_of(tasks.Taxi()).text(0)
    assert [line.replace("@", ".") for line in text.splitlines()[:5]] == [
        *[". .|. . ."] * 2,
        ". . . . .",
        *[".|. .|. ."] * 2,
    ], text
    drawn, without = (scene_of(tasks.Taxi(walls=walls)).image(0) for walls in (True, False))
    columns = np.flatnonzero((drawn != without).any(axis=(0, 2))) - 4  # cells of 64 pixels
    assert np.unique((columns + 8) // 64).tolist() == [1, 2, 3]
    assert (columns % 64 < 5).any()
    assert (columns % 64 > 59).any()


def test_no_thin_wall_stands_where_moves_lead_elsewhere_or_nobody_tries():
    lake = cr.from_gymnasium("FrozenLake-v1", discount=0.9)  # which is slippery
    wind = of_cells((2, 2), [0, 1, 0, 1], "south")  # it carries up who goes south, from below too
    for task in (tasks.CliffWalking(), GRIDS["a sea"], lake, wind):
        assert bars_of(task, layout_of(task)).size == 0
    floor = of_cells((2, 2), range(4), "south", "up")
    assert bars_of(floor, layout_of(floor)).tolist() == [4, 5]  # below the two upper cells
    scene = scene_of(floor)
    assert scene.text(0) == "@ .\n- -\n. ."
