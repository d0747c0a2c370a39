"""An episode to look at: a GIF, an animation in a notebook, text in a terminal."""

import base64
import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from inspect import signature
from itertools import zip_longest
from pathlib import Path
from typing import Any, SupportsFloat, TypeVar, overload

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from curricle.arrays import FloatArray, frozen
from curricle.checks import number
from curricle.errors import SettingError
from curricle.files import local_file, write_in_folder
from curricle.pictures.scenes import FLOOR, INK, scene_of
from curricle.planning.rollouts import Trajectory
from curricle.tasks.live import is_live
from curricle.tasks.mdp import Task, generative_model
from curricle.tasks.observation_task import EnvironmentMaker, layers_of
from curricle.tasks.spaces import action_name, values_of
from curricle.text import counted

FASTEST = 50.0  # pictures a second that browsers show of a GIF, at most
LAST = 1000  # milliseconds for which the last picture is shown
OF_TASKS = 4.0  # pictures a second of a task that Curricle draws
CAPTION, NARROWEST = 24, 280  # pixels: height of the line below a picture, least width of both
LINE, APART = 96, 3  # characters of a printed line at most, and between two moments in it
MOST_MOMENTS = 60  # moments that are printed at most
Frame = npt.NDArray[np.uint8]


Drawing = TypeVar("Drawing")


class Drawn(Sequence[Drawing]):
    """Drawings of states, each made on access: all of a long episode's would fill the memory."""

    def __init__(self, draw: Callable[[int], Drawing], states: npt.NDArray[np.int64]):
        self._draw, self._states = draw, states

    def __len__(self) -> int:
        return len(self._states)

    @overload
    def __getitem__(self, place: int) -> Drawing: ...
    @overload
    def __getitem__(self, place: slice) -> "Drawn[Drawing]": ...
    def __getitem__(self, place: int | slice) -> "Drawing | Drawn[Drawing]":
        if isinstance(place, slice):
            return Drawn(self._draw, self._states[place])
        return self._draw(int(self._states[place]))


@dataclass(frozen=True, eq=False)
class Episode:
    """One episode of T steps, with drawings. A notebook shows it, ``print`` prints it.

    Attributes
    ----------
    frames : T + 1 (height, width, 3) uint8 arrays
        Pictures before the first step and after every step.
    actions : (T, ...) array
        Empty where they are unknown, as in a study's folder.
    rewards : (T,) float64
    terminated : bool
        Whether the episode terminated; otherwise it was truncated.
    fps : float
        Pictures per second.
    texts : T + 1 str
        The states drawn with characters, or empty.
    action_names : T str
        The actions' names, or empty.

    Examples
    --------
    >>> from curricle import GridWorld, learn
    >>> print(learn(GridWorld("S.T"), budget=2000).watch())
    start          1 east, -1     2 east, +199
    @.T            S@T            S.@
    <BLANKLINE>
    2 steps, return 198, terminated
    """

    frames: Sequence[Frame]
    actions: npt.NDArray[Any]
    rewards: FloatArray
    terminated: bool
    fps: float
    texts: Sequence[str] = ()
    action_names: Sequence[str] = ()

    @classmethod
    def of(cls, task: Task, path: Trajectory, film: "Film | None" = None) -> "Episode":
        """Return the episode of a trajectory in a task with numbered states.

        It is drawn by the task's scene, unless there is a film.

        Examples
        --------
        >>> from curricle import GridWorld
        >>> from curricle.planning import rollout
        >>> maze = GridWorld("S.T")
        >>> Episode.of(maze, rollout(maze, [1, 1, 0]))
        Episode(2 steps, return 198, terminated)
        """
        scene, actions = scene_of(task), generative_model(task).actions

        def name(action: int) -> str:
            if len(actions.names) == 1:
                return action_name(actions, action)
            values = values_of(actions, action)  # of a joint action, without names of its parts
            return " + ".join(part.label(values[part.name]) for part in actions.components)

        return cls(
            frames=Drawn(scene.image, path.states) if film is None else film.frames,
            actions=path.actions,
            rewards=path.rewards,
            terminated=path.terminated,
            fps=OF_TASKS if film is None else film.fps,
            texts=Drawn(scene.text, path.states),
            action_names=[name(action) for action in path.actions.tolist()],
        )

    def save(self, path: str | Path, *, fps: float | None = None) -> Path:
        """Write the pictures as a GIF, and return the file's path.

        `fps` are pictures per second, up to 50; by default the episode's. SettingError unless the
        file ends in ``.gif`` and `fps` is at least 0.01; StoreError if it cannot be written.
        """
        file = local_file(path)
        if file.suffix.lower() != ".gif":
            raise SettingError(f"an episode's file must end in .gif: got {file.name!r}")
        write_in_folder(file, self._gif(self.fps if fps is None else fps), "an episode")
        return file

    def _gif(self, fps: float) -> bytes:
        number("fps", fps, SettingError, low=0.01)
        # A GIF counts hundredths of a second.
        shown = 10 * round(100 / min(fps, FASTEST))
        quick = Image.Quantize.FASTOCTREE  # several times faster than Pillow's own choice
        if not self.frames:
            raise SettingError("a GIF needs pictures: this episode was stored as text alone")
        first, *later = (
            picture.quantize(method=quick, dither=Image.Dither.NONE) for picture in self._pictures()
        )
        durations = [shown] * len(later) + [max(shown, LAST)]
        content, moving = io.BytesIO(), {"save_all": True, "append_images": later, "loop": 0}
        first.save(content, format="GIF", duration=durations, **moving)
        return content.getvalue()

    def _pictures(self) -> Iterator[Image.Image]:
        """Yield the frames, each above the step that led to it and the return so far."""
        returns = np.cumsum([0.0, *self.rewards])
        for place, frame in enumerate(self.frames):
            drawn, caption = Image.fromarray(frame), self._moment(place)[0]
            size = max(drawn.width, NARROWEST), drawn.height + CAPTION
            picture = Image.new("RGB", size, FLOOR)
            picture.paste(drawn)
            text, font = f"{caption}; return {returns[place]:.4g}", ImageFont.load_default(14)
            middle = CAPTION // 3, size[1] - CAPTION // 2
            ImageDraw.Draw(picture).text(middle, text, INK, font, anchor="lm")
            yield picture

    def _repr_html_(self) -> str:
        code = base64.b64encode(self._gif(self.fps)).decode()
        return f'<img alt="{self!r}" style="max-width: 100%" src="data:image/gif;base64,{code}">'

    def __repr__(self) -> str:
        return f"Episode({self._summary})"

    @property
    def _summary(self) -> str:
        end, n = "terminated" if self.terminated else "truncated", len(self.rewards)
        return f"{counted(n, 'step')}, return {self.rewards.sum():.4g}, {end}"

    def __str__(self) -> str:
        moments = [self._moment(place) for place in range(self.rewards.size + 1)[:MOST_MOMENTS]]
        width = max(len(line) for moment in moments for line in moment)
        across, lines = max(1, (LINE + APART) // (width + APART)), list[str]()
        for first in range(0, len(moments), across):
            row = moments[first : first + across]
            for parts in zip_longest(*row, fillvalue=""):
                lines.append((" " * APART).join(part.ljust(width) for part in parts).rstrip())
            lines += [""] * (len(row[0]) > 1)
        if further := self.rewards.size + 1 - len(moments):
            lines.append(f"... and {counted(further, 'more step')}, which a GIF shows")
        return "\n".join([*lines, self._summary])

    def _moment(self, place: int) -> list[str]:
        """Return the lines of one moment: the step that led to it, and its drawing."""
        caption = "start"
        if place:
            caption, reward = str(place), self.rewards[place - 1]
            if self.action_names:
                caption += f" {self.action_names[place - 1]}"
            elif len(self.actions):
                action = np.asarray(self.actions[place - 1])
                caption += f" {np.array2string(action, precision=3)}"
            caption += f", {reward:+.4g}" if reward else ""
        return [caption, *(self.texts[place].splitlines() if self.texts else ())]


def played(env: gym.Env[Any, Any], act: Callable[[Any], Any], *, seed: int, limit: int) -> Episode:
    """Return one episode, of up to `limit` steps, in an environment; `act` maps observations."""
    observation, _ = env.reset(seed=seed)
    frames, actions, rewards = [frame_of(env)], list[Any](), list[float]()
    over = terminated = False
    while not over and len(rewards) < limit:
        action = act(observation)
        observation, reward, terminated, truncated, _ = env.step(action)
        frames.append(frame_of(env))
        actions.append(action)
        rewards.append(float(reward))
        over = terminated or truncated
    shown = frozen(np.array(actions)), frozen(np.array(rewards, dtype=np.float64))
    return Episode(tuple(frames), *shown, bool(terminated), fps_of(env))


# -- pictures that environments draw themselves ----------------------------------------------------

PICTURES, TEXT = "rgb_array", "ansi"
SILENT: tuple[Any, ...] = object.__str__, gym.Env.__str__  # which say nothing of a state
EnvironmentFunction = Callable[[], gym.Env[Any, Any]]


def own_text(environment: gym.Env[Any, Any]) -> str | None:
    """Return an environment's own text of its state; None if it has none, or in colours alone."""
    bare, shown = layers_of(environment)[-1], None
    if getattr(environment, "render_mode", None) == TEXT:
        shown = environment.render()
    elif type(bare).__str__ not in SILENT:
        shown = str(bare)
    return shown.strip("\n") if isinstance(shown, str) and "\x1b" not in shown else None


def with_pictures(make: EnvironmentFunction, mode: str = PICTURES) -> EnvironmentFunction:
    """Return a function that makes the same environments in a mode, where they take any."""
    maker = make if isinstance(make, EnvironmentMaker) else EnvironmentMaker(make, {})
    if isinstance(maker.recipe, EnvironmentMaker):
        return replace(maker, recipe=with_pictures(maker.recipe, mode))
    if callable(maker.recipe) and "render_mode" not in signature(maker.recipe).parameters:
        return make
    return replace(maker, arguments={**maker.arguments, "render_mode": mode})


@dataclass(frozen=True)
class Film:
    """The pictures of an episode in a live task, which an environment draws as it is played."""

    frames: list[Frame]
    fps: float

    @classmethod
    def of(cls, task: Any) -> tuple[Any, "Film | None"]:
        """Return a task that makes a film when it is played, and the film; itself if it draws none.

        It must be played once.
        """
        if not is_live(task):
            return task, None
        with closing(task.make()) as environment:
            if PICTURES not in getattr(environment, "metadata", {}).get("render_modes", ()):
                return task, None
            film = cls([], fps_of(environment))
        make = with_pictures(task.make)
        return replace(task, make=lambda: _Filmed(make(), film.frames)), film


class _Filmed:
    """An environment that adds a picture to a film at every reset and step."""

    def __init__(self, environment: gym.Env[Any, Any], frames: list[Frame]):
        self._environment, self._frames = environment, frames

    def __getattr__(self, name: str) -> Any:
        return getattr(self._environment, name)

    def reset(self, *, seed: int | None = None) -> tuple[object, dict[str, Any]]:
        begun = self._environment.reset(seed=seed)
        self._frames.append(frame_of(self._environment))
        return begun

    def step(self, action: object) -> tuple[object, SupportsFloat, bool, bool, dict[str, Any]]:
        followed = self._environment.step(action)
        self._frames.append(frame_of(self._environment))
        return followed


def fps_of(environment: gym.Env[Any, Any]) -> float:
    """Return the pictures a second that an environment states; 10 by default."""
    return float(getattr(environment, "metadata", {}).get("render_fps") or 10)


def frame_of(environment: gym.Env[Any, Any]) -> Frame:
    """Return a picture of an environment, (height, width, 3) uint8; SettingError if it has none."""
    mode = getattr(environment, "render_mode", None)
    picture: Any = environment.render() if mode == PICTURES else None
    if np.ndim(picture) != 3:
        raise SettingError(
            'an episode\'s environment must draw pictures, render_mode="rgb_array": got '
            f"render_mode={mode!r} from {environment}"
        )
    return np.array(picture, dtype=np.uint8)
