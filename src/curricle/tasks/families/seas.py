"""The family of deep seas; the last rows of a sea are a smaller one."""

from typing import Any, Literal

import numpy as np

from curricle.tasks.deep_sea import LARGEST_SEED, LARGEST_SIZE, DeepSea
from curricle.tasks.families.family import FamilyMember, TaskFamily
from curricle.tasks.families.parameters import Parameter
from curricle.tasks.spaces import Decoded


def sea(
    size: int = 10,
    move_cost: float = 0.01,
    treasure: float = 1.0,
    slip: float = 0.0,
    noise: float = 0.0,
    mapping_seed: int | None = None,
    start: Literal["surface", "uniform"] = "surface",
    discount: float = 0.99,
    time_limit: int | None = None,
) -> DeepSea:
    """Return a whole sea; the parameters are those of :class:`DeepSea`.

    Examples
    --------
    >>> sea(size=4) == DeepSea(size=4)
    True
    """
    return DeepSea(
        size=size,
        move_cost=move_cost,
        treasure=treasure,
        slip=slip,
        noise=noise,
        mapping_seed=mapping_seed,
        start=start,
        discount=discount,
        time_limit=time_limit,
    )


def sea_mapping(target: FamilyMember, source: FamilyMember) -> Any:
    """Return how a sea reads another: cells counted from the ground, right moves as right ones.

    Columns are counted from the right, where the treasure is. What lies farther off than the source
    has is unmapped.

    Examples
    --------
    >>> mapped = sea_mapping(deep_sea_family(size=10), deep_sea_family(size=3))
    >>> states, _ = mapped({"row": 8, "column": 9}, {"move": np.array([[0, 1]])})
    >>> states
    {'row': 1, 'column': 2}
    """
    down = target["size"] - source["size"]
    whole, other = target.task, source.task

    def function(states: Decoded, actions: Decoded) -> tuple[Decoded, Decoded]:
        (action,) = actions.values()
        read = {name: value - down for name, value in states.items()}
        own, known = whole.states.encode(**states), other.states.encode(**read)
        is_right = action == whole.right[own]
        right = other.right[np.maximum(known, 0)]
        return read, {other.actions.names[0]: np.where(is_right, right, 1 - right)}

    return function


deep_sea_family = TaskFamily(
    "deep_sea",
    sea,
    (
        Parameter("size", low=1, high=LARGEST_SIZE, harder="larger"),
        Parameter("slip", low=0, high=1, harder="larger"),
        Parameter("noise", low=0, harder="larger"),
        Parameter("mapping_seed", low=0, high=LARGEST_SEED),
        Parameter("time_limit", low=1),
        Parameter("discount", low=0, high=1),
    ),
    mapping=sea_mapping,
)
"""Deep seas (:class:`DeepSea`); members map by :func:`sea_mapping`."""
