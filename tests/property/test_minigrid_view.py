"""The compiled view of MiniGrid against MiniGrid's own, bit for bit."""

from copy import deepcopy

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import curricle as cr
from curricle.errors import TaskError
from curricle.interop import MiniGridFullView
from curricle.tasks.minigrid_view import CompiledView, grid_codes, view_compiled

minigrid = pytest.importorskip("minigrid", reason="the extra minigrid is not installed")
from minigrid.core.constants import COLOR_NAMES  # noqa: E402 - only where it is installed
from minigrid.core.world_object import (  # noqa: E402
    Ball,
    Box,
    Door,
    Floor,
    Goal,
    Key,
    Lava,
    Wall,
)  # fmt: skip

KINDS = (Wall, Floor, Ball, Key, Box, Door, Goal, Lava)


class Level(minigrid.minigrid_env.MiniGridEnv):
    """A level whose cells a test fills."""

    def __init__(self, **settings):
        mission = minigrid.minigrid_env.MissionSpace(mission_func=lambda: "walk")
        super().__init__(mission, max_steps=100, **settings)

    def _gen_grid(self, width, height):
        self.grid = minigrid.core.grid.Grid(width, height)
        self.agent_pos, self.agent_dir = (1, 1), 0


def thing(rng):
    kind = KINDS[rng.integers(len(KINDS))]
    if kind is Lava:
        return Lava()
    colour = str(rng.choice(COLOR_NAMES))
    return kind(colour, *(rng.random(2) < 0.5)) if kind is Door else kind(colour)


def fill(level, rng, share):
    """Put objects of all kinds into a share of the cells, and the agent anywhere."""
    for i in range(len(level.grid.grid)):
        level.grid.grid[i] = thing(rng) if rng.random() < share else None
    level.agent_pos = (int(rng.integers(level.width)), int(rng.integers(level.height)))
    level.agent_dir = int(rng.integers(4))
    level.carrying = thing(rng) if rng.random() < 0.5 else None


def change(level, rng):
    """Change an object in place, move one, or let the agent move."""
    cells = level.grid.grid
    at = int(rng.integers(len(cells)))
    found = cells[at]
    match int(rng.integers(5)):
        case 0 if found is not None:
            found.color = str(rng.choice(COLOR_NAMES))
        case 1 if isinstance(found, Door):
            found.is_open, found.is_locked = (rng.random(2) < 0.5).tolist()
        case 2:
            cells[at], level.carrying = level.carrying, found
        case 3:
            level.agent_dir = int(rng.integers(4))
        case _:
            level.agent_pos = (int(rng.integers(level.width)), int(rng.integers(level.height)))


def check(level, view):
    """Compare a view with the level's own."""
    own, compiled = type(level).gen_obs(level), view()
    assert compiled.keys() == own.keys()
    image = compiled.pop("image")
    assert (image.dtype, image.shape) == (np.uint8, own["image"].shape)
    np.testing.assert_array_equal(image, own.pop("image"))
    assert compiled == own


@settings(max_examples=60, deadline=None)
@given(
    width=st.integers(3, 12),
    height=st.integers(3, 12),
    size=st.sampled_from([3, 5, 7, 9]),
    through=st.booleans(),
    share=st.floats(0, 1),
    seed=st.integers(0, 2**32 - 1),
)
def test_any_grid_looks_as_by_minigrid_before_and_after_changes(
    width, height, size, through, share, seed
):
    rng = np.random.default_rng(seed)
    level = Level(width=width, height=height, agent_view_size=size, see_through_walls=through)
    level.reset()
    fill(level, rng, share)
    view_compiled(level, True)
    for _ in range(12):
        check(level, level.gen_obs)
        np.testing.assert_array_equal(grid_codes(level), level.grid.encode())
        change(level, rng)


def walks(names, steps):
    """Compare the views of environments with random actions, their own wrappers left out."""
    rng = np.random.default_rng(0)
    for name in names:
        base = gym.make(name, disable_env_checker=True).unwrapped
        view_compiled(base, True)
        base.reset(seed=1)
        for step in range(steps):
            check(base, base.gen_obs)
            _, _, terminated, truncated, _ = base.step(int(rng.integers(7)))
            if terminated or truncated:
                base.reset(seed=step)


IDS = sorted(
    name
    for name in gym.registry
    if name.startswith(("MiniGrid-", "BabyAI-")) and "WFC" not in name  # needs another package
)


@pytest.mark.filterwarnings("ignore:.*is out of date")
def test_registered_levels_look_as_by_minigrid():
    walks(IDS[::6], 40)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*is out of date")
@pytest.mark.parametrize("part", range(8))
def test_all_registered_levels_look_as_by_minigrid(part):
    walks(IDS[part::8], 150)


class Mirror(Ball):
    """An object whose code changes with every look."""

    looks = 0

    def encode(self):
        return 6, 0, self.looks

    def see_behind(self):
        return self.looks % 2 == 0


def test_objects_of_other_classes_are_read_each_time():
    level = Level(width=5, height=5)
    level.reset()
    level.put_obj(mirror := Mirror(), 2, 1)
    view = CompiledView(level)
    for mirror.looks in range(4):
        check(level, view)


class Nearsighted(Level):
    """A level with a view of its own."""

    def gen_obs_grid(self, agent_view_size=None):
        grid, visible = super().gen_obs_grid(agent_view_size)
        return grid, visible & (np.arange(self.agent_view_size) > 3)


def test_an_environment_with_methods_of_its_own_keeps_them():
    level = Nearsighted(width=5, height=5)
    level.reset()
    view_compiled(level, True)
    check(level, level.gen_obs)
    assert not level.gen_obs()["image"][:, :4].any()
    level.gen_obs = replaced = dict
    view_compiled(level, True)
    assert level.gen_obs is replaced


def test_a_copy_observes_itself():
    level = gym.make("MiniGrid-DoorKey-5x5-v0").unwrapped
    view_compiled(level, True)
    level.reset(seed=3)
    other = deepcopy(level)
    other.step(0)
    assert other.gen_obs()["direction"] != level.gen_obs()["direction"]
    check(other, other.gen_obs)
    check(level, level.gen_obs)


@pytest.mark.parametrize("encode", [None, MiniGridFullView(5, 5)])
def test_a_tasks_environment_has_the_compiled_view_unless_it_is_off(encode):
    name = "MiniGrid-DoorKey-5x5-v0"
    tasks = [cr.observation_task(name, encode=encode, compiled_view=on) for on in (True, False)]
    assert tasks[0] == tasks[1]
    compiled, own = (task.environment() for task in tasks)
    assert isinstance(compiled.unwrapped.gen_obs, CompiledView)
    assert not isinstance(own.unwrapped.gen_obs, CompiledView)
    rng = np.random.default_rng(0)
    seen = [env.reset(seed=1)[0] for env in (compiled, own)]
    for _ in range(50):
        np.testing.assert_equal(*seen)
        action = int(rng.integers(6))
        seen = [env.step(action)[0] for env in (compiled, own)]


def test_compiled_view_is_true_or_false():
    with pytest.raises(TaskError, match="compiled_view must be a bool"):
        cr.observation_task("CartPole-v1", compiled_view="no")
