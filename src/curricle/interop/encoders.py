"""Encoders turn an environment's observations into the input of a table or a network.

All are frozen dataclasses: equal settings are equal encoders, with the same text in every process.
"""

from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Dict

from curricle.arrays import FloatTable, IntArray, frozen
from curricle.checks import instance, numbers, whole_number
from curricle.errors import SettingError, TaskError
from curricle.tasks.minigrid_view import MiniGrid, grid_codes, is_minigrid, view_compiled
from curricle.tasks.observation_task import stable_text
from curricle.tasks.spaces import Component, Space


@dataclass(frozen=True)
class Bins:
    """Encoder that sorts each of an observation's n numbers into the bins of a component.

    For `encode` of :func:`from_gymnasium`. Numbers outside the edges fall into the nearest bin.

    Parameters
    ----------
    edges : dict of str to (m + 1,) float array
        For each entry of an observation, in order, the name of its component and the ascending
        edges of its m bins, so that n edges make n - 1 bins; a bin includes its lower edge.

    Raises
    ------
    TaskError
        When edges do not ascend or are fewer than two, or an observation is not n numbers.

    Examples
    --------
    >>> bins = Bins({"position": [-1.2, -0.5, 0.6], "velocity": [-0.07, -0.01, 0.01, 0.07]})
    >>> bins.states
    Space(6 points: position[2] x velocity[3])
    >>> bins.states.label(bins(np.array([-0.5, -9.0])))
    'position=-0.5 and above velocity=below -0.01'
    """

    edges: Mapping[str, npt.ArrayLike] = field(hash=False)
    states: Space = field(init=False, repr=False)  # all combinations of bins
    _inner: list[tuple[float, ...]] = field(init=False, repr=False, hash=False)  # between two bins

    def __post_init__(self) -> None:
        if not isinstance(self.edges, Mapping) or not self.edges:
            raise TaskError(f"bins need a dict from names to edges: got {self.edges!r}")
        checked, components = dict[str, tuple[float, ...]](), list[Component]()
        for name, edges in self.edges.items():
            array = numbers(f"the edges of {name!r}", edges, TaskError)
            if array.ndim != 1 or array.size < 2 or not (np.diff(array) > 0).all():
                raise TaskError(
                    f"edges must be two or more ascending numbers: {name!r} has {array.tolist()}"
                )
            checked[str(name)] = tuple(array.tolist())
        for name, (_, *inner, _) in checked.items():
            shown = [f"{edge:g}" for edge in inner]
            if len(set(shown)) < len(shown):
                shown = [repr(edge) for edge in inner]
            between = [f"{low} to {high}" for low, high in pairwise(shown)]
            labels = [f"below {shown[0]}", *between, f"{shown[-1]} and above"] if inner else ["any"]
            components.append(Component(name, len(labels), labels=tuple(labels)))
        object.__setattr__(self, "edges", checked)
        object.__setattr__(self, "states", Space(components))
        object.__setattr__(self, "_inner", [edges[1:-1] for edges in checked.values()])

    def __call__(self, observation: FloatTable) -> int:
        """Return the number of the state that an observation, (n,) float, falls into."""
        values = observation.tolist()
        if len(values) != len(self._inner):
            raise TaskError(f"an observation must have {len(self._inner)} entries: got {values}")
        if any(value != value for value in values):
            raise TaskError(f"an observation must be of numbers: got {values}")
        return self.states.encode_one(tuple(map(bisect_right, self._inner, values)))

    def many(self, observations: FloatTable) -> IntArray:
        """Return the numbers of the states that N observations, (N, n) float, fall into, (N,)."""
        values = np.asarray(observations)
        if values.ndim != 2 or values.shape[1] != len(self._inner) or np.isnan(values).any():
            raise TaskError(
                f"observations must be numbers of shape (N, {len(self._inner)}): got shape "
                f"{values.shape}{', some of them NaN' * bool(np.isnan(values).any())}"
            )
        bins = map(partial(np.searchsorted, side="right"), self._inner, values.T)
        return self.states.encode(**dict(zip(self.edges, bins, strict=True)))


@dataclass(frozen=True)
class WholeNumbers:
    """Encoder of observations whose n numbers are whole, though their box is one of fractions.

    For `encode` of :func:`from_gymnasium`. Numbers outside a range are read as its nearest end.

    Parameters
    ----------
    ranges : dict of str to (int, int)
        For each entry of an observation, in order, the name of its component, the lowest and the
        highest number.

    Raises
    ------
    TaskError
        When a range is not two whole numbers that ascend, or an observation is not n of them.

    Examples
    --------
    >>> jobs = WholeNumbers({"hour": (0, 8), "queue": (-2, 20)})
    >>> jobs.states.label(jobs(np.array([3.0, 99.0])))
    'hour=3 queue=20'
    """

    ranges: Mapping[str, tuple[int, int]] = field(hash=False)
    states: Space = field(init=False, repr=False)  # all combinations of numbers

    def __post_init__(self) -> None:
        if not isinstance(self.ranges, Mapping) or not self.ranges:
            raise TaskError(f"whole numbers need a dict from names to ranges: got {self.ranges!r}")
        checked, components = dict[str, tuple[int, int]](), list[Component]()
        for name, ends in self.ranges.items():
            pair = numbers(f"the range of {name!r}", ends, TaskError)
            if pair.shape != (2,) or (pair % 1).any() or pair[0] > pair[1]:
                raise TaskError(
                    f"a range must be two ascending whole numbers: {name!r} has {ends!r}"
                )
            low, high = checked[str(name)] = int(pair[0]), int(pair[1])
            components.append(Component(name, high - low + 1, low=low))
        object.__setattr__(self, "ranges", checked)
        object.__setattr__(self, "states", Space(components))

    def __call__(self, observation: FloatTable) -> int:
        """Return the number of the state that an observation, (n,) float, shows."""
        values = observation.tolist()
        if len(values) != len(self.ranges) or any(value % 1 for value in values):
            raise TaskError(
                f"an observation must be {len(self.ranges)} whole numbers: got {values}"
            )
        ends = zip(values, self.ranges.values(), strict=True)
        return self.states.encode_one(tuple(int(min(max(x, low), high)) for x, (low, high) in ends))


Environment = gym.Env[Any, Any]


class EncodedObservations(gym.ObservationWrapper[Any, Any, Any]):
    """Wrapper that shows ``encoded(unwrapped environment, observation)``; it has no state."""

    def __init__(self, env: Environment, encoded: Callable[[Any, Any], Any], space: gym.Space[Any]):
        super().__init__(env)
        self.encoded, self.observation_space = encoded, space

    def observation(self, observation: object) -> object:
        """Return the observation encoded."""
        return self.encoded(self.unwrapped, observation)


OBJECTS, COLOURS, STATES = 11, 6, 3  # MiniGrid's codes of a cell; the last is of doors
CHANNELS = OBJECTS + COLOURS + STATES
DIRECTIONS = 4
AGENT = 10  # the code of the agent among objects
VOCABULARY = (
    "a after agent and at avoid ball behind blue box door empty end fetch find floor from front "
    "get go goal green grey hallway in key lava left matching maze must near next object of on "
    "open opening pick purple put reach red right room rooms square the then to traverse "
    "unlock unseen up use wall yellow you your"
)
WORDS = tuple(VOCABULARY.split())
"""Words in missions of MiniGrid (its ``DictObservationSpaceWrapper``) and of BabyAI."""
Cells = npt.NDArray[np.float32]
FACING: Cells = frozen(np.eye(DIRECTIONS, dtype=np.float32))
EVERY_CELL: Cells = frozen(
    np.eye(CHANNELS, dtype=np.float32)[
        np.indices((OBJECTS, COLOURS, STATES))
        + np.reshape([0, OBJECTS, OBJECTS + COLOURS], (3, 1, 1, 1))
    ].sum(axis=0)
)
"""The zeros and ones of every object, colour and state, (11, 6, 3, 20)."""


class _MiniGridEncoder:
    """Joins cells, direction and mission into a vector or a picture."""

    picture: bool
    mission: bool | None

    def __post_init__(self) -> None:
        instance("picture of an encoder", self.picture, bool, SettingError)
        if self.mission is not None:
            instance("mission of an encoder", self.mission, bool, SettingError)
        if self.picture and self.mission:
            raise SettingError("a picture has no mission: got picture=True and mission=True")

    def _cells(self, base: MiniGrid, observation: Mapping[str, Any]) -> Cells:
        """Return the cells that are encoded, (width, height, 20)."""
        return _one_hot(observation["image"])

    def _size(self, base: MiniGrid, image_size: tuple[int, int]) -> tuple[int, int]:
        """Return the width and height in cells, by default of MiniGrid's own image."""
        return image_size

    def __call__(self, env: Environment) -> Environment:
        space: Any = env.observation_space
        if not is_minigrid(env):
            raise TaskError(f"{type(self).__name__} is for MiniGrid's environments: got {env}")
        image = space.spaces.get("image") if isinstance(space, Dict) else None
        if image is None or len(sides := image.shape or ()) != 3 or sides[2] != 3:
            raise TaskError(
                f"{type(self).__name__} reads MiniGrid's own observations, a Dict with an image of "
                f"codes and the direction: got {stable_text(space)}"
            )
        base: Any = env.unwrapped
        width, height = self._size(base, (sides[0], sides[1]))
        mission = self.mission
        if mission is None:
            # Without placeholders a mission is always the same; BabyAI has another space.
            missions: Any = space.spaces.get("mission")
            same = type(missions).__name__ == "MissionSpace" and not missions.ordered_placeholders
            mission = not (self.picture or missions is None or same)
        shape: tuple[int, ...] = (CHANNELS + DIRECTIONS, height, width)
        if not self.picture:
            shape = (width * height * CHANNELS + DIRECTIONS + len(WORDS) * mission,)
        view_compiled(env, True)
        encoded = partial(self._encoded, mission)
        return EncodedObservations(env, encoded, Box(0, 1, shape, np.float32))

    def _encoded(self, with_mission: bool, base: MiniGrid, observation: Mapping[str, Any]) -> Cells:
        cells = self._cells(base, observation)
        direction = FACING[observation["direction"]]
        if self.picture:
            planes = np.broadcast_to(direction[:, None, None], (DIRECTIONS, *cells.shape[1::-1]))
            return np.concatenate([cells.transpose(2, 1, 0), planes])
        mission = [_bag_of_words(observation["mission"])] if with_mission else []
        return np.concatenate([cells.reshape(-1), direction, *mission])


@dataclass(frozen=True)
class MiniGridView(_MiniGridEncoder):
    """Encoder of what a MiniGrid agent sees, as zeros and ones.

    Each of the view's 7 x 7 cells is one-hot by its object (11), colour (6) and state (3), the
    agent's direction by 4 more: a vector of 984 numbers, float32.

    Parameters
    ----------
    picture : bool
        Return planes instead, (24, 7, 7), channels first, for :class:`~curricle.deep.SmallCNN`.
    mission : bool, optional
        Append a number for each of MiniGrid's 59 words: 1 if the mission contains it, else 0. By
        default vectors have them where an environment's missions differ.

    Raises
    ------
    SettingError, TaskError
        When a setting is invalid, or an environment's observations are not MiniGrid's own.

    Examples
    --------
    >>> MiniGridView(), MiniGridView() == MiniGridView(mission=True)
    (MiniGridView(picture=False, mission=None), False)
    """

    picture: bool = False
    mission: bool | None = None


@dataclass(frozen=True)
class MiniGridFullView(_MiniGridEncoder):
    """Encoder of a whole MiniGrid level, as zeros and ones.

    Cells are one-hot as in :class:`MiniGridView`. The agent's cell also holds the agent and the
    object that it carries. A smaller level lies in the middle, among unseen cells, so that levels
    of several sizes share a space: 20 x width x height + 4 numbers, float32.

    Parameters
    ----------
    width, height : int
        Cells of the largest level, walls included.
    picture : bool
    mission : bool, optional
        As in :class:`MiniGridView`; a picture is (24, height, width).

    Raises
    ------
    SettingError, TaskError
        As in :class:`MiniGridView`, and when a level is larger.

    Examples
    --------
    >>> MiniGridFullView(9, 9)
    MiniGridFullView(width=9, height=9, picture=False, mission=None)
    """

    width: int
    height: int
    picture: bool = False
    mission: bool | None = None

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            whole_number(f"{name} of an encoder", getattr(self, name), 3, SettingError)
        super().__post_init__()

    def _size(self, base: MiniGrid, image_size: tuple[int, int]) -> tuple[int, int]:
        if base.width > self.width or base.height > self.height:
            raise TaskError(
                f"a level must fit into its encoder's {self.width} x {self.height} cells: {base} "
                f"has {base.width} x {base.height}"
            )
        return self.width, self.height

    def _cells(self, base: MiniGrid, observation: Mapping[str, Any]) -> Cells:
        codes = np.zeros((self.width, self.height, 3), np.uint8)  # (0, 0, 0) are unseen cells
        self._size(base, (0, 0))  # a reset may make another grid
        left, top = (self.width - base.width) // 2, (self.height - base.height) // 2
        codes[left : left + base.width, top : top + base.height] = grid_codes(base)
        cells, (x, y) = _one_hot(codes), base.agent_pos
        agent_cell = cells[left + x, top + y]
        agent_cell[AGENT] = 1
        if base.carrying is not None:
            carried, colour, _ = base.carrying.encode()
            agent_cell[[carried, OBJECTS + colour]] = 1
        return cells


def _one_hot(codes: npt.NDArray[Any]) -> Cells:
    """Return codes of cells, (width, height, 3), as zeros and ones, (width, height, 20)."""
    try:
        cells: Cells = EVERY_CELL[codes[..., 0], codes[..., 1], codes[..., 2]]
        return cells
    except IndexError:
        raise TaskError(
            "MiniGrid's codes of object, colour and state must be below "
            f"{(OBJECTS, COLOURS, STATES)}: got up to {codes.max(axis=(0, 1)).tolist()}"
        ) from None


def _bag_of_words(mission: str) -> Cells:
    """Return 1 for each of MiniGrid's words that a mission contains, else 0, (59,)."""
    has = np.zeros(len(WORDS), np.float32)
    for word in mission.lower().replace(",", " ").split():
        if word not in WORDS:
            raise TaskError(
                f"a mission must have MiniGrid's words: got {word!r} in {mission!r}; mission=False "
                "leaves it out"
            )
        has[WORDS.index(word)] = 1
    return has
