"""The family of frozen lakes: Gymnasium's maps, its random ones, and parts of them."""

from typing import Any, Literal

from curricle.checks import number, one_of, whole_number
from curricle.errors import TaskError
from curricle.tasks.families.components_by_name import ComponentsByName
from curricle.tasks.families.family import TaskFamily
from curricle.tasks.families.parameters import Parameter
from curricle.tasks.frozen_lake import (
    LARGEST_LAKE,
    LEAST_FROZEN,
    MAPS,
    FrozenLake,
    random_lake,
)


def part_of_lake(
    map: Literal["4x4", "8x8", "random"] = "4x4",
    part: int | None = None,
    size: int = 8,
    frozen_share: float = 0.8,
    seed: int = 0,
    *,
    slippery: bool = True,
    success_rate: float = 1 / 3,
    start: Literal["map", "uniform"] = "map",
    goal_reward: float = 1.0,
    hole_reward: float = 0.0,
    step_reward: float = 0.0,
    discount: float = 0.99,
    time_limit: int | None = 100,
) -> FrozenLake:
    """Return one of Gymnasium's frozen lakes, or the part of it around the goal.

    Parameters
    ----------
    map : {"4x4", "8x8", "random"}
    part : int, optional
        Rows and columns around the goal, 2 or more and fewer than the lake has; all by default. The
        part keeps the lake's coordinates.
    size, frozen_share, seed : int, float, int
        Of a random lake, as in :func:`random_lake`.
    start : {"map", "uniform"}
        Where the map has its start, in a part on any cell of ice; or on any cell of ice.
    slippery, success_rate, goal_reward, hole_reward, step_reward, discount, time_limit
        As in :class:`FrozenLake`.

    Raises
    ------
    TaskError
        When a value is out of range.

    Examples
    --------
    >>> part_of_lake("8x8", part=3).map
    ('FHF', 'FHF', 'FFG')
    """
    one_of("map of a lake", map, (*MAPS, "random"), TaskError)
    one_of("start of a lake", start, ("map", "uniform"), TaskError)
    lake = FrozenLake(
        random_lake(size, frozen_share, seed) if map == "random" else map,
        slippery=slippery,
        success_rate=success_rate,
        goal_reward=goal_reward,
        hole_reward=hole_reward,
        step_reward=step_reward,
        start=start,
        discount=discount,
        time_limit=time_limit,
    )
    if part is None:
        return lake
    whole, least = len(lake.map), whole_number("part of a lake", part, 2, TaskError)
    number("part of a lake", least, TaskError, 2, whole - 1)
    return lake.crop(rows=(whole - least, whole), columns=(whole - least, whole))


def _parts_of_maps(parameters: dict[str, Any]) -> str | None:
    """Return what is wrong with the size of a map or of its part."""
    drawn = MAPS.get(parameters["map"])
    if drawn is not None and parameters["size"] != 8:
        return "size of frozen_lake is of random lakes: leave it out with other maps"
    whole = parameters["size"] if drawn is None else len(drawn)
    if parameters["part"] is not None and parameters["part"] >= whole:
        return f"part of frozen_lake must be less than the lake's {whole} rows"
    return None


frozen_lake_family = TaskFamily(
    "frozen_lake",
    part_of_lake,
    (
        Parameter("part", low=2, high=LARGEST_LAKE - 1, harder="larger"),
        Parameter("size", low=2, high=LARGEST_LAKE, harder="larger"),
        Parameter("frozen_share", low=LEAST_FROZEN, high=1, harder="smaller"),
        Parameter("seed", low=0),
        Parameter("slippery", harder="larger"),
        Parameter("success_rate", low=0, high=1, harder="smaller"),
        Parameter("time_limit", low=1),
        Parameter("discount", low=0, high=1),
    ),
    mapping=ComponentsByName(),
    constraint=_parts_of_maps,
)
"""Frozen lakes (:func:`part_of_lake`); members map cell by cell, by the lake's coordinates."""
