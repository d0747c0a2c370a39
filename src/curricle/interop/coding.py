"""Points of Curricle's spaces as Gymnasium's spaces hold them."""

import operator
from functools import cached_property
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Discrete, MultiDiscrete

from curricle.errors import SettingError
from curricle.tasks.spaces import Space

Form = Literal["index", "components"]


class Coding:
    """The points of a space as Gymnasium's spaces hold them.

    Parameters
    ----------
    space : Space
    form : {"index", "components"}
        A point's number; or an array with the place of each component's value among its values,
        which is the value itself where the component starts at 0.

    Examples
    --------
    >>> from curricle import Pursuit
    >>> joint = Coding(Pursuit(4, 2).actions, "components")
    >>> joint.held, joint.shown(9), joint.point([1, 4])
    (MultiDiscrete([5 5]), array([1, 4]), 9)
    """

    def __init__(self, space: Space, form: Form):
        self.space, self.form = space, form
        self._rows: npt.NDArray[np.int64] | None = None
        if not space.is_box:
            lows = [component.low for component in space.components]
            self._rows = np.stack(list(space.decode().values()), axis=1) - lows

    # The type is quoted: in older versions of Gymnasium these classes are not generic.
    @cached_property
    def held(self) -> "Discrete[np.int64] | MultiDiscrete[np.int64]":
        """Gymnasium's space: ``Discrete(size)`` or ``MultiDiscrete(shape)``."""
        if self.form == "index":
            return Discrete(self.space.size)
        return MultiDiscrete(list(self.space.shape))

    def shown(self, point: int) -> Any:
        """Return a point as Gymnasium holds it: an int, or an int64 array."""
        return point if self.form == "index" else np.array(self.places(point))

    def places(self, point: int) -> list[int]:
        """Return the place of each component's value among its values, from 0."""
        if self._rows is not None:
            return self._rows[point].tolist()  # type: ignore[no-any-return]
        return [int(place) for place in np.unravel_index(point, self.space.shape)]

    def label(self, point: int) -> str:
        """Return a point in words, as :meth:`Space.label` does, but faster."""
        named = zip(self.space.components, self.places(point), strict=True)
        return " ".join(f"{part.name}={part.label(part.low + place)}" for part, place in named)

    def point(self, given: Any) -> int:
        """Return the number of a point of a box that is given as Gymnasium holds it."""
        shape = (self.space.size,) if self.form == "index" else self.space.shape
        try:
            values = [given] if self.form == "index" else np.asarray(given).tolist()
            return int(np.ravel_multi_index(tuple(map(operator.index, values)), shape))
        except (TypeError, ValueError):
            raise SettingError(f"an action must lie in {self.held}: got {given!r}") from None
