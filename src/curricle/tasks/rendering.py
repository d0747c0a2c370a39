"""Environments that draw pictures of themselves."""

from collections.abc import Callable
from dataclasses import replace
from inspect import signature
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.errors import SettingError
from curricle.tasks.observation_task import EnvironmentMaker

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


def frame_of(environment: Any) -> npt.NDArray[np.uint8]:
    """Return a picture of an environment, (height, width, 3) uint8; SettingError if it has none."""
    mode = getattr(environment, "render_mode", None)
    drawn: Any = environment.render() if mode == PICTURES else None
    if np.ndim(drawn) != 3:
        raise SettingError(
            'an episode\'s environment must draw pictures, render_mode="rgb_array": got '
            f"render_mode={mode!r} from {environment}"
        )
    return np.array(drawn, dtype=np.uint8)
