"""An episode with its pictures: a GIF, also in a notebook."""

import base64
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from curricle.array_types import FloatArray
from curricle.checks import number
from curricle.errors import SettingError

FASTEST = 50.0
"""Pictures a second that browsers show of a GIF, at most."""
LAST = 1000
"""Milliseconds for which the last picture is shown."""


@dataclass(frozen=True, eq=False)
class Episode:
    """One episode of T steps, with pictures. A notebook shows it.

    Attributes
    ----------
    frames : tuple of T + 1 (height, width, 3) uint8 arrays
        Before the first step, and after each.
    actions : (T, ...) array
    rewards : (T,) float64
    terminated : bool
        Rather than truncated.
    fps : float
        Pictures a second, the environment's own.

    Examples
    --------
    >>> black = np.zeros((8, 8, 3), np.uint8)
    >>> Episode((black, black + 255), np.array([1]), np.array([2.0]), terminated=True, fps=4.0)
    Episode(1 steps, return 2, terminated)
    """

    frames: tuple[npt.NDArray[np.uint8], ...]
    actions: npt.NDArray[Any]
    rewards: FloatArray
    terminated: bool
    fps: float

    def save(self, path: str | Path, *, fps: float | None = None) -> Path:
        """Write the pictures as a GIF, and return the file's path.

        `fps` are pictures a second, up to 50; by default the environment's own.
        """
        file = Path(path)
        if file.suffix.lower() != ".gif":
            raise SettingError(f"an episode is saved as a GIF: got the file name {file.name!r}")
        content = self._gif(self.fps if fps is None else fps)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content)
        return file

    def _gif(self, fps: float) -> bytes:
        number("fps", fps, SettingError, low=0.01)
        # A GIF counts hundredths of a second.
        each = 10 * round(100 / min(fps, FASTEST))
        pictures = [Image.fromarray(frame) for frame in self.frames]
        durations = [each] * (len(pictures) - 1) + [max(each, LAST)]
        content = io.BytesIO()
        pictures[0].save(
            content,
            format="GIF",
            save_all=True,
            append_images=pictures[1:],
            duration=durations,
            loop=0,
        )
        return content.getvalue()

    def _repr_html_(self) -> str:
        code = base64.b64encode(self._gif(self.fps)).decode()
        return f'<img alt="{self!r}" src="data:image/gif;base64,{code}">'

    def __repr__(self) -> str:
        end = "terminated" if self.terminated else "truncated"
        return f"Episode({len(self.rewards)} steps, return {self.rewards.sum():.4g}, {end})"
