"""An episode to look at: a GIF, an animation in a notebook, text in a terminal."""

import base64
import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from inspect import signature
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from curricle.arrays import FloatArray, frozen
from curricle.checks import number
from curricle.errors import SettingError
from curricle.files import local_file, write_in_folder
from curricle.planning.rollouts import Trajectory
from curricle.show.scenes import scene_of
from curricle.tasks.mdp import Task, generative_model
from curricle.tasks.observation_task import EnvironmentMaker
from curricle.tasks.spaces import Space, action_name, values_of
from curricle.text import counted

FASTEST = 50.0
"""Pictures a second that browsers show of a GIF, at most."""
LAST = 1000
"""Milliseconds for which the last picture is shown."""
OF_TASKS = 4.0
"""Pictures a second of a task that Curricle draws."""
LINE, APART = 96, 3
"""Characters of a printed line at most, and between two moments in it."""
MOST_MOMENTS = 60
"""Moments that are printed at most."""
Frame = npt.NDArray[np.uint8]


class Drawn(Sequence[Any]):
    """Drawings of states, made when they are asked for: those of a long episode fill the memory."""

    def __init__(self, draw: Callable[[int], Any], states: npt.NDArray[np.int64]):
        self._draw, self._states = draw, states

    def __len__(self) -> int:
        return len(self._states)

    def __getitem__(self, place: Any) -> Any:
        if isinstance(place, slice):
            return Drawn(self._draw, self._states[place])
        return self._draw(int(self._states[place]))


@dataclass(frozen=True, eq=False)
class Episode:
    """One episode of T steps, with drawings. A notebook shows it, ``print`` prints it.

    Attributes
    ----------
    frames : T + 1 (height, width, 3) uint8 arrays
        Pictures before the first step, and after each.
    actions : (T, ...) array
        Empty where they are not known: the folder of a study stores none.
    rewards : (T,) float64
    terminated : bool
        Rather than truncated.
    fps : float
        Pictures a second, the environment's own.
    texts : T + 1 str
        The same drawn with characters; empty where the environment draws none.
    action_names : T str
        The actions in words; empty where they have none.

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
    def of(cls, task: Task, path: Trajectory) -> "Episode":
        """Return the episode of a trajectory in a task with numbered states, drawn by its scene.

        Examples
        --------
        >>> from curricle import GridWorld
        >>> from curricle.planning import rollout
        >>> maze = GridWorld("S.T")
        >>> Episode.of(maze, rollout(maze, [1, 1, 0]))
        Episode(2 steps, return 198, terminated)
        """
        scene, actions = scene_of(task), generative_model(task).actions
        return cls(
            frames=Drawn(scene.image, path.states),
            actions=path.actions,
            rewards=path.rewards,
            terminated=path.terminated,
            fps=OF_TASKS,
            texts=Drawn(scene.text, path.states),
            action_names=[_words(actions, action) for action in path.actions.tolist()],
        )

    def save(self, path: str | Path, *, fps: float | None = None) -> Path:
        """Write the pictures as a GIF, and return the file's path.

        `fps` are pictures a second, up to 50; by default the environment's own.
        """
        file = local_file(path)
        if file.suffix.lower() != ".gif":
            raise SettingError(f"an episode is saved as a GIF: got the file name {file.name!r}")
        write_in_folder(file, self._gif(self.fps if fps is None else fps), "an episode")
        return file

    def _gif(self, fps: float) -> bytes:
        number("fps", fps, SettingError, low=0.01)
        # A GIF counts hundredths of a second.
        shown = 10 * round(100 / min(fps, FASTEST))
        quick = Image.Quantize.FASTOCTREE  # several times faster than Pillow's own choice
        first, *others = (
            Image.fromarray(frame).quantize(method=quick, dither=Image.Dither.NONE)
            for frame in self.frames
        )
        durations = [shown] * len(others) + [max(shown, LAST)]
        content = io.BytesIO()
        first.save(
            content,
            format="GIF",
            save_all=True,
            append_images=others,
            duration=durations,
            loop=0,
        )
        return content.getvalue()

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
        left = self.rewards.size + 1 - len(moments)
        more = [f"... and {counted(left, 'more step')}, which a GIF shows"] * (left > 0)
        return "\n".join([*_side_by_side(moments), *more, self._summary])

    def _moment(self, place: int) -> list[str]:
        """Return the lines of one moment: the step that led to it, and its drawing."""
        caption = "start"
        if place:
            words = [str(place)]
            if self.action_names:
                words += [self.action_names[place - 1]]
            elif len(self.actions):
                action = np.asarray(self.actions[place - 1])
                words += [np.array2string(action, precision=3)]
            reward = self.rewards[place - 1]
            caption = " ".join(words) + (f", {reward:+.4g}" if reward else "")
        return [caption, *(self.texts[place].splitlines() if self.texts else ())]


def _words(actions: Space, action: int) -> str:
    """Return an action in words, a joint one without the names of its parts."""
    if len(actions.names) == 1:
        return action_name(actions, action)
    values = values_of(actions, action)
    return " + ".join(part.label(values[part.name]) for part in actions.components)


def _side_by_side(moments: Sequence[list[str]]) -> Iterator[str]:
    """Yield the lines of drawings that stand side by side, as many as fit into a line."""
    width = max(len(line) for lines in moments for line in lines)
    across = max(1, (LINE + APART) // (width + APART))
    for first in range(0, len(moments), across):
        row = moments[first : first + across]
        for lines in zip_longest(*row, fillvalue=""):
            yield (" " * APART).join(line.ljust(width) for line in lines).rstrip()
        if len(row[0]) > 1:
            yield ""


def played(
    env: Any,
    act: Callable[[Any], Any],
    *,
    seed: int,
    limit: int,
    picture: Callable[[Any], Frame],
    text: Callable[[Any], str] | None = None,
) -> Episode:
    """Return one episode of a policy in an environment of Gymnasium's, reset with `seed`.

    `act`, `picture` and `text` return the action, the frame and a drawing made of characters for an
    observation; after `limit` steps the episode is cut off.
    """
    seen, _ = env.reset(seed=seed)
    frames, actions, rewards = [picture(seen)], list[Any](), list[float]()
    texts = [] if text is None else [text(seen)]
    over = terminated = False
    while not over and len(rewards) < limit:
        action = act(seen)
        seen, reward, terminated, truncated, _ = env.step(action)
        frames.append(picture(seen))
        texts += [] if text is None else [text(seen)]
        actions.append(action)
        rewards.append(float(reward))
        over = terminated or truncated
    fps = float(getattr(env, "metadata", {}).get("render_fps") or 10)
    return Episode(
        frames=tuple(frames),
        actions=frozen(np.array(actions)),
        rewards=frozen(np.array(rewards, dtype=np.float64)),
        terminated=bool(terminated),
        fps=fps,
        texts=texts,
    )


# -- pictures that environments draw themselves ----------------------------------------------------

PICTURES = "rgb_array"


def with_pictures(make: Callable[[], Any]) -> Callable[[], Any]:
    """Return what makes the same environments, with pictures where they can be asked for."""
    if not isinstance(make, EnvironmentMaker):
        return EnvironmentMaker(make, _render_mode(make)) if _render_mode(make) else make
    if isinstance(make.what, EnvironmentMaker):
        return replace(make, what=with_pictures(make.what))
    return replace(make, arguments={**make.arguments, **_render_mode(make.what)})


def _render_mode(what: Any) -> dict[str, str]:
    """Return the argument that asks for pictures, if an environment's maker has it."""
    asked = not callable(what) or "render_mode" in signature(what).parameters
    return {"render_mode": PICTURES} if asked else {}


def draws_pictures(environment: Any) -> bool:
    """Return whether an environment says that it can draw pictures."""
    return PICTURES in getattr(environment, "metadata", {}).get("render_modes", ())


def frame_of(environment: Any) -> Frame:
    """Return a picture of an environment, (height, width, 3) uint8; SettingError if it has none."""
    mode = getattr(environment, "render_mode", None)
    picture: Any = environment.render() if mode == PICTURES else None
    if np.ndim(picture) != 3:
        raise SettingError(
            'an episode\'s environment must draw pictures, render_mode="rgb_array": got '
            f"render_mode={mode!r} from {environment}"
        )
    return np.array(picture, dtype=np.uint8)
