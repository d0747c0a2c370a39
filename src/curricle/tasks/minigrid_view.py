"""MiniGrid's observations, compiled: the same numbers in a tenth of the time or less.

MiniGrid copies, turns and encodes the cells before the agent up to seven times an observation.
Here the codes of a grid are kept, and made anew when an object of it was moved or changed.
"""

import sys
from functools import cache
from operator import attrgetter
from typing import Any, Protocol

import gymnasium
import numpy as np
import numpy.typing as npt

from curricle.tasks.kernel import compiled_once

Codes = npt.NDArray[np.uint8]
EMPTY = 1, 0, 0, 1  # object, colour and state of a cell, and whether it is seen through
WALL = 2, 5, 0, 0  # what MiniGrid shows beyond a grid
OBJECTS = "minigrid.core.world_object"  # the module with MiniGrid's own classes of objects
KIND, COLOUR = attrgetter("type"), attrgetter("color")


class Grid(Protocol):
    """The grid of a level; its objects are MiniGrid's."""

    grid: list[Any]
    width: int
    height: int

    def encode(self) -> Codes: ...  # noqa: D102


class MiniGrid(Protocol):
    """What is read of an environment of MiniGrid, which need not be installed."""

    grid: Grid
    width: int
    height: int
    agent_pos: tuple[int, int]
    agent_dir: int
    agent_view_size: int
    carrying: Any
    see_through_walls: bool
    mission: str
    max_steps: int
    step_count: int

    def gen_obs(self) -> dict[str, Any]: ...  # noqa: D102


def is_minigrid(env: gymnasium.Env[Any, Any]) -> bool:
    """Return whether an environment is one of MiniGrid's, which need not be installed."""
    module = sys.modules.get("minigrid.minigrid_env")
    return module is not None and isinstance(env.unwrapped, module.MiniGridEnv)


def observes_itself(core: object) -> bool:
    """Return whether an unwrapped environment observes as its class does, compiled or not."""
    replaced = {name: vars(core)[name] for name in OF_ENVIRONMENT if name in vars(core)}
    return all(isinstance(method, CompiledView) for method in replaced.values())


def view_compiled(env: gymnasium.Env[Any, Any], compiled: bool) -> None:
    """Let an environment of MiniGrid observe by a :class:`CompiledView`, or by its own `gen_obs`.

    Nothing happens to other environments, and to those whose `gen_obs` somebody has replaced.
    """
    base: Any = env.unwrapped
    if is_minigrid(env) and observes_itself(base):
        vars(base).pop("gen_obs", None)
        if compiled:
            base.gen_obs = CompiledView(base)


def grid_codes(env: MiniGrid) -> Codes:
    """Return what `encode` of an unwrapped environment's grid returns, (width, height, 3)."""
    view = vars(env).get("gen_obs")
    if isinstance(view, CompiledView) and _views_as_minigrid(env.__class__, env.grid.__class__):
        return view.codes()[..., :3].transpose(1, 0, 2)
    return env.grid.encode()


class CompiledView:
    """Returns an environment's observations in the place of its method `gen_obs`."""

    def __init__(self, env: MiniGrid):
        self.env = env
        self.cells: list[Any] | None = None  # of which the following was read
        self.things, self.doors, self.looks = list[Any](), list[Any](), list[object]()
        self.kept: Codes = np.empty((0, 0, 4), np.uint8)

    def __reduce__(self) -> tuple[Any, ...]:
        """Let copies begin without codes: they are no part of an environment's state."""
        return CompiledView, (self.env,)

    def __call__(self) -> dict[str, Any]:
        """Return what `gen_obs` returns; by `gen_obs`, unless what it calls is MiniGrid's."""
        env: Any = self.env
        if not _views_as_minigrid(env.__class__, env.grid.__class__):
            observed: dict[str, Any] = type(env).gen_obs(env)
            return observed
        x, y = env.agent_pos
        image = _image(
            self.codes(),
            (int(x), int(y)),
            int(env.agent_dir),
            int(env.agent_view_size),
            EMPTY if env.carrying is None else _codes_of(env.carrying),
            bool(env.see_through_walls),
        )
        return {"image": image, "direction": env.agent_dir, "mission": env.mission}

    def codes(self) -> Codes:
        """Return the codes of the grid's cells, (height, width, 4)."""
        grid, cells = self.env.grid, self.env.grid.grid
        if cells == self.cells and self._looks() == self.looks:
            return self.kept
        self.things = [thing for thing in cells if thing is not None]
        self.doors = [thing for thing in self.things if thing.type == "door"]
        self.looks = self._looks()
        rows = [EMPTY if thing is None else _codes_of(thing) for thing in cells]
        self.kept = np.array(rows, np.uint8).reshape(grid.height, grid.width, 4)
        # What an object of another class looks like may depend on anything: it is read each time.
        own = all(type(thing).__module__ == OBJECTS for thing in self.things)
        self.cells = list(cells) if own else None
        return self.kept

    def _looks(self) -> list[object]:
        """Return all on which the codes of MiniGrid's objects depend."""
        size, doors = (self.env.grid.width, self.env.grid.height), map(_codes_of, self.doors)
        return [size, *map(KIND, self.things), *map(COLOUR, self.things), *doors]


def _codes_of(thing: Any) -> tuple[int, int, int, int]:
    """Return object, colour and state of an object, and whether it is seen through."""
    kind, colour, state = thing.encode()
    return kind, colour, state, 1 if thing.see_behind() else 0


OF_ENVIRONMENT = "gen_obs", "gen_obs_grid", "get_view_exts"
OF_GRID = "get", "set", "slice", "rotate_left", "process_vis", "encode"
"""The methods by which MiniGrid observes."""


@cache
def _views_as_minigrid(kind: type, grid: type) -> bool:
    """Return whether classes of environments and of grids inherit MiniGrid's methods."""
    bases: Any = sys.modules["minigrid.minigrid_env"]
    return all(
        getattr(own, name) is getattr(base, name)
        for own, base, names in (
            (kind, bases.MiniGridEnv, OF_ENVIRONMENT),
            (grid, bases.Grid, OF_GRID),
        )
        for name in names
    )


@compiled_once
def _image(
    codes: Codes,
    place: tuple[int, int],
    direction: int,
    size: int,
    carried: tuple[int, int, int, int],
    through: bool,
) -> Codes:
    """Return what an agent at a place sees of a grid, (size, size, 3).

    Cells of the image are numbered from the agent's left to its right, and from afar to the agent.
    """
    height, width = codes.shape[:2]
    image = np.zeros((size, size, 3), np.uint8)
    clear = np.zeros((size, size), np.bool_)  # whether cells are seen through
    for i in range(size):
        for j in range(size):
            aside, ahead = i - size // 2, size - 1 - j
            if direction == 0:
                right, down = ahead, aside
            elif direction == 1:
                right, down = -aside, ahead
            elif direction == 2:
                right, down = -ahead, -aside
            else:
                right, down = aside, -ahead
            column, row = place[0] + right, place[1] + down
            if 0 <= column < width and 0 <= row < height:
                for k in range(3):
                    image[i, j, k] = codes[row, column, k]
                clear[i, j] = codes[row, column, 3] != 0
            else:
                for k in range(3):
                    image[i, j, k] = WALL[k]
    for k in range(3):
        image[size // 2, size - 1, k] = carried[k]
    if through:
        return image
    visible = np.zeros((size, size), np.bool_)
    visible[size // 2, size - 1] = True
    for j in range(size - 1, -1, -1):  # as MiniGrid's `process_vis` does
        behind = max(j - 1, 0)
        for i in range(size - 1):
            if visible[i, j] and clear[i, j]:
                visible[i + 1, j] = visible[i, behind] = visible[i + 1, behind] = True
        for i in range(size - 1, 0, -1):
            if visible[i, j] and clear[i, j]:
                visible[i - 1, j] = visible[i, behind] = visible[i - 1, behind] = True
    for i in range(size):
        for j in range(size):
            if not visible[i, j]:
                for k in range(3):
                    image[i, j, k] = 0
    return image
