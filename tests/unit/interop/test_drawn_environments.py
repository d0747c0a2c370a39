"""Environments whose states have a row and a column are drawn as grids."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces

import curricle as cr
from curricle.errors import SettingError
from curricle.show.views import GridView
from curricle.tasks.grid_layout import layout_of

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
        self.row = min(max(self.row + down, 1), 2)
        self.column = min(max(self.column + right, 0), 2)
        self.fuel -= 1
        home = (self.row, self.column) == (2, 2)
        return self._seen(), float(home), home or self.fuel == 0, False, {}

    def _seen(self):
        return np.array([self.row, self.column, self.fuel])


NAMES = ["row", "column", "fuel"]
LIVE = cr.from_gymnasium(Tank, discount=0.9, names=NAMES, actions=MOVES, time_limit=9)


@pytest.fixture(scope="module")
def tabled():
    return cr.tabulate(Tank, discount=0.9, actions=MOVES)


def test_the_grid_is_of_the_row_and_the_column_as_an_episode_starts():
    view = GridView.of(LIVE)
    assert (view.shape, view.origin, view.words) == ((2, 3), (1, 0), "fuel 4")
    assert view.directions == (1, 2, 3, 4)
    assert LIVE.states.decode(view.states)["fuel"].tolist() == [4] * 6
    assert view.walls.size == 0
    low = GridView.of(LIVE, {"fuel": 0})
    assert LIVE.states.decode(low.states)["fuel"].tolist() == [0] * 6


@pytest.mark.parametrize("names", [["row", "col", "fuel"], ["y", "x", "fuel"]])
def test_other_names_of_rows_and_columns(names):
    task = cr.from_gymnasium(Tank, discount=0.9, names=names, time_limit=9)
    assert layout_of(task).components == tuple(names[:2])
    assert GridView.of(task).directions is None  # actions without labels


def test_other_components_are_no_grid():
    task = cr.from_gymnasium(Tank, discount=0.9, names=["a", "b", "c"], time_limit=9)
    assert layout_of(task) is None
    assert not GridView.for_replay(task).is_map
    with pytest.raises(SettingError, match="at must fix all other components of a, b, c"):
        GridView.of(task)
    assert GridView.of(task, {"c": 4}).shape == (2, 3)


def test_cells_of_states_with_other_components_are_no_walls(tabled):
    view = GridView.of(tabled)
    assert view.words == "fuel 4"
    assert view.cells.tolist() == [[1, 0]]  # with a full tank only the start
    assert view.walls.size == 0
    assert GridView.of(tabled, {"fuel": 3}).cells.tolist() == [[1, 0], [1, 1], [2, 0]]
