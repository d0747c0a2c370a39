"""The family of rivers to swim in."""

from typing import Any

import numpy as np

from curricle.tasks.families.family import FamilyMember, TaskFamily
from curricle.tasks.families.parameters import Parameter
from curricle.tasks.river_swim import RiverSwim
from curricle.tasks.spaces import Decoded

LARGEST_RIVER = 10_000


def river(
    size: int = 6,
    forward: float = 0.3,
    back: float = 0.1,
    leave_bank: float = 0.3,
    stay_at_end: float = 0.3,
    left_reward: float = 5.0,
    right_reward: float = 10_000.0,
    discount: float = 0.95,
    time_limit: int | None = 200,
) -> RiverSwim:
    """Return a river; the parameters are those of :class:`RiverSwim`.

    Episodes start at its second or third position; at the second where there are two.

    Examples
    --------
    >>> river(size=6) == RiverSwim()
    True
    """
    return RiverSwim(
        size=size,
        forward=forward,
        back=back,
        leave_bank=leave_bank,
        stay_at_end=stay_at_end,
        left_reward=left_reward,
        right_reward=right_reward,
        start=(1, 2) if size > 2 else (1,),
        discount=discount,
        time_limit=time_limit,
    )


def river_mapping(target: FamilyMember, source: FamilyMember) -> Any:
    """Return how a river reads another: counted from the right bank, and not past the left one.

    Examples
    --------
    >>> mapped = river_mapping(river_swim_family(size=6), river_swim_family(size=4))
    >>> states, _ = mapped({"position": np.arange(6)}, {})
    >>> states["position"]
    array([0, 0, 0, 1, 2, 3])
    """
    shift = target["size"] - source["size"]

    def function(states: Decoded, actions: Decoded) -> tuple[Decoded, Decoded]:
        return {"position": np.maximum(states["position"] - shift, 0)}, actions

    return function


def _chances_sum(parameters: dict[str, Any]) -> str | None:
    total = parameters["forward"] + parameters["back"]
    return None if total <= 1 else "forward and back of river_swim must be at most 1 together"


river_swim_family = TaskFamily(
    "river_swim",
    river,
    (
        Parameter("size", low=2, high=LARGEST_RIVER, harder="larger"),
        Parameter("forward", low=0, high=1, harder="smaller"),
        Parameter("back", low=0, high=1, harder="larger"),
        Parameter("leave_bank", low=0, high=1, harder="smaller"),
        Parameter("stay_at_end", low=0, high=1, harder="smaller"),
        Parameter("time_limit", low=1),
        Parameter("discount", low=0, high=1),
    ),
    mapping=river_mapping,
    constraint=_chances_sum,
)
"""Rivers (:class:`RiverSwim`); members map by :func:`river_mapping`."""
