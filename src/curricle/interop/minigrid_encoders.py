"""Encoders of MiniGrid's observations as zeros and ones."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Dict

from curricle.checks import instance, whole_number
from curricle.errors import SettingError, TaskError
from curricle.interop.encoders import EncodedObservations, Environment
from curricle.interop.tabulation.minigrid import is_minigrid
from curricle.tasks.observation_task import space_text

OBJECTS, COLOURS, STATES = 11, 6, 3
"""MiniGrid's codes of a cell: its object, the object's colour, and whether a door is open."""
CHANNELS = OBJECTS + COLOURS + STATES
DIRECTIONS = 4
AGENT = 10
"""The code of the agent among objects."""
VOCABULARY = (
    "a after agent and at avoid ball behind blue box door empty end fetch find floor from front "
    "get go goal green grey hallway in key lava left matching maze must near next object of on "
    "open opening pick purple put reach red right room rooms square the then to traverse "
    "unlock unseen up use wall yellow you your"
)
WORDS = tuple(VOCABULARY.split())
"""The words of missions: those of MiniGrid's ``DictObservationSpaceWrapper`` and of BabyAI."""

Cells = npt.NDArray[np.float32]


@dataclass(frozen=True)
class _MiniGridEncoder:
    """What both encoders of MiniGrid have in common."""

    def __post_init__(self) -> None:
        for name in ("picture", "mission"):
            instance(f"{name} of an encoder", getattr(self, name), bool, SettingError)
        if self._form.picture and self._form.mission:
            raise SettingError("a mission goes with a vector: got picture=True and mission=True")

    @property
    def _form(self) -> "_Form":
        mine: Any = self
        return _Form(mine.picture, mine.mission)

    def _wrapped(
        self, env: Environment, cells: Callable[[Any, Any], Cells], width: int, height: int
    ) -> Environment:
        space = self._form.space(width, height)
        return EncodedObservations(env, _Encoded(cells, self._form), space)


@dataclass(frozen=True)
class MiniGridView(_MiniGridEncoder):
    """What a MiniGrid agent sees before it, as zeros and ones.

    Each of the view's 7 x 7 cells is one-hot by its object (11), colour (6) and state (3), the
    agent's direction by 4 more: a vector of 984 numbers, float32. The mission is left out.

    Parameters
    ----------
    picture : bool
        The same as planes, (24, 7, 7), channels first; the direction is a plane of ones among four.
        :class:`~curricle.deep.SmallCNN` reads it.
    mission : bool
        Append which of MiniGrid's 59 words the mission has, whatever their order.

    Raises
    ------
    SettingError
        When a setting makes no sense.
    TaskError
        When an environment is not one of MiniGrid's or a wrapper has changed its observations.

    Examples
    --------
    >>> MiniGridView(), MiniGridView() == MiniGridView(mission=True)
    (MiniGridView(picture=False, mission=False), False)
    """

    picture: bool = False
    mission: bool = False

    def __call__(self, env: Environment) -> Environment:
        """Return the environment with encoded observations."""
        width, height = _checked(env, "MiniGridView")
        return self._wrapped(env, _seen, width, height)


@dataclass(frozen=True)
class MiniGridFullView(_MiniGridEncoder):
    """All of a MiniGrid level, as zeros and ones.

    Cells are one-hot as in :class:`MiniGridView`. The agent is one more object of its cell, as is
    what it carries. A level that is smaller lies in the middle, among unseen cells, so that levels
    of several sizes share a space: 20 x width x height + 4 numbers, float32.

    Parameters
    ----------
    width, height : int
        Of the largest level, walls included.
    picture, mission : bool
        As in :class:`MiniGridView`; a picture is (24, height, width).

    Raises
    ------
    SettingError
        When a setting makes no sense.
    TaskError
        When an environment is not one of MiniGrid's, or larger.

    Examples
    --------
    >>> MiniGridFullView(9, 9)
    MiniGridFullView(width=9, height=9, picture=False, mission=False)
    """

    width: int
    height: int
    picture: bool = False
    mission: bool = False

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            whole_number(f"{name} of an encoder", getattr(self, name), 3, SettingError)
        super().__post_init__()

    def __call__(self, env: Environment) -> Environment:
        """Return the environment with encoded observations."""
        _checked(env, "MiniGridFullView")
        base: Any = env.unwrapped
        self._check_size(base)
        return self._wrapped(env, self._cells, self.width, self.height)

    def _check_size(self, base: Any) -> None:
        if base.width > self.width or base.height > self.height:
            raise TaskError(
                f"a level must fit into its encoder's {self.width} x {self.height} cells: {base} "
                f"has {base.width} x {base.height}"
            )

    def _cells(self, base: Any, observation: Any) -> Cells:
        """Return the whole grid, (width, height, 20)."""
        codes = np.zeros((self.width, self.height, 3), np.uint8)  # (0, 0, 0) are unseen cells
        self._check_size(base)  # a reset may make another grid
        left, top = (self.width - base.width) // 2, (self.height - base.height) // 2
        codes[left : left + base.width, top : top + base.height] = base.grid.encode()
        cells = _one_hot(codes)
        x, y = base.agent_pos
        here = cells[left + x, top + y]
        here[AGENT] = 1
        if base.carrying is not None:
            carried, colour, _ = base.carrying.encode()
            here[[carried, OBJECTS + colour]] = 1
        return cells


@dataclass(frozen=True)
class _Form:
    """Puts cells, direction and mission together, as a vector or a picture."""

    picture: bool
    mission: bool

    def space(self, width: int, height: int) -> Box:
        """Return the space of encoded observations of so many cells."""
        if self.picture:
            return Box(0, 1, (CHANNELS + DIRECTIONS, height, width), np.float32)
        words = len(WORDS) if self.mission else 0
        return Box(0, 1, (width * height * CHANNELS + DIRECTIONS + words,), np.float32)

    def of(self, cells: Cells, observation: Any) -> Cells:
        """Return an encoded observation; cells are (width, height, 20)."""
        direction = _identity(DIRECTIONS)[observation["direction"]]
        if self.picture:
            width, height, _ = cells.shape
            planes = np.broadcast_to(direction[:, None, None], (DIRECTIONS, height, width))
            return np.concatenate([cells.transpose(2, 1, 0), planes])
        words = [_words(observation["mission"])] if self.mission else []
        return np.concatenate([cells.reshape(-1), direction, *words])


@dataclass(frozen=True)
class _Encoded:
    """The function of an :class:`EncodedObservations` of MiniGrid."""

    cells: Callable[[Any, Any], Cells]
    form: _Form

    def __call__(self, base: Any, observation: Any) -> Cells:
        return self.form.of(self.cells(base, observation), observation)


def _seen(base: Any, observation: Any) -> Cells:
    """Return the cells before the agent, (7, 7, 20)."""
    return _one_hot(observation["image"])


def _checked(env: Environment, encoder: str) -> tuple[int, int]:
    """Return the width and height of MiniGrid's view; TaskError where observations are others."""
    space: gym.Space[Any] = env.observation_space
    if not is_minigrid(env):
        raise TaskError(f"{encoder} is for MiniGrid's environments: got {env}")
    image = space.spaces.get("image") if isinstance(space, Dict) else None
    if image is None or len(shape := image.shape or ()) != 3 or shape[2] != 3:
        raise TaskError(
            f"{encoder} reads MiniGrid's own observations, a Dict with an image of codes and the "
            f"direction: got {space_text(space)}"
        )
    return shape[0], shape[1]


def _one_hot(codes: npt.NDArray[Any]) -> Cells:
    """Return codes of cells, (width, height, 3), as zeros and ones, (width, height, 20)."""
    sizes = (OBJECTS, COLOURS, STATES)
    try:
        return np.concatenate([_identity(n)[codes[..., k]] for k, n in enumerate(sizes)], axis=-1)
    except IndexError:
        raise TaskError(
            f"MiniGrid's codes of object, colour and state must be below {sizes}: got up to "
            f"{codes.max(axis=(0, 1)).tolist()}"
        ) from None


def _words(mission: str) -> Cells:
    """Return which of MiniGrid's words a mission has, (59,)."""
    found = np.zeros(len(WORDS), np.float32)
    for word in mission.lower().replace(",", " ").split():
        if word not in WORDS:
            raise TaskError(f"a mission must have words of MiniGrid's: got {word!r} in {mission!r}")
        found[WORDS.index(word)] = 1
    return found


@cache
def _identity(n: int) -> Cells:
    return np.eye(n, dtype=np.float32)
