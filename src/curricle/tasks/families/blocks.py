"""The family of Block Dude: BURLAP's levels and their parts around the exit."""

from typing import Any, Literal

from curricle.checks import whole_number
from curricle.errors import TaskError
from curricle.tasks.block_dude import BlockDude
from curricle.tasks.families.components_by_name import ComponentsByName
from curricle.tasks.families.family import FamilyMember, TaskFamily
from curricle.tasks.families.parameters import Parameter

WIDTH = 25
"""Columns of the levels."""
PARTS: dict[int, tuple[int, ...]] = {
    1: (10, 11, 12, *range(15, WIDTH)),
    2: tuple(range(17, WIDTH)),
    3: tuple(range(17, WIDTH)),
}
"""Level -> the columns of its parts that have blocks and a way to the exit."""


def part_of_level(
    level: Literal[1, 2, 3] = 1,
    columns: int | None = None,
    start: Literal["map", "uniform"] = "map",
    step_reward: float = -1.0,
    exit_reward: float = -1.0,
    discount: float = 0.99,
    time_limit: int | None = 500,
) -> BlockDude:
    """Return one of BURLAP's levels, or the part of it around the exit.

    Parameters
    ----------
    level : {1, 2, 3}
    columns : int, optional
        From the exit on; all 25 by default. Where the agent's column is not among them, it begins
        in the last one, on top of what is there.
    start, step_reward, exit_reward, discount, time_limit
        As in :class:`BlockDude`.

    Raises
    ------
    TaskError
        When a value is out of range. Some parts have no way to the exit, as blocks lie outside;
        :data:`block_dude_family` refuses these, and those without any block.

    Examples
    --------
    >>> part_of_level(1, columns=10).level[2:]
    ('...#.....>', 'E..#...#.B')
    """
    whole = BlockDude(
        level,
        step_reward=step_reward,
        exit_reward=exit_reward,
        start=start,
        discount=discount,
        time_limit=time_limit,
    )
    if columns is None:
        return whole
    columns = whole_number("columns of a level", columns, 2, TaskError)
    (agent,) = (line.find(what) for line in whole.level for what in "<>" if what in line)
    inside = agent < columns
    return whole.crop(columns=(0, columns), agent=None if inside else columns - 1, start=start)


def block_mapping(target: FamilyMember, source: FamilyMember) -> ComponentsByName:
    """Return how a level reads another: by name, blocks in their order from the exit on.

    Examples
    --------
    >>> block_mapping(block_dude_family(), block_dude_family(columns=10)).renaming
    (('block', 'block_1'),)
    """
    own, other = (
        [name for name in one.task.states.names if name.startswith("block")]
        for one in (target, source)
    )
    if len(other) > len(own):
        raise TaskError(
            f"a level reads levels with at most its {len(own)} blocks: got {source}, which has "
            f"{len(other)}"
        )
    return ComponentsByName(
        renaming={theirs: mine for theirs, mine in zip(other, own, strict=False) if theirs != mine}
    )


def _has_a_way(parameters: dict[str, Any]) -> str | None:
    """Return what is wrong with a part from which there is no way to the exit."""
    known = PARTS[parameters["level"]]
    if parameters["columns"] is None or parameters["columns"] in known:
        return None
    return (
        f"columns of level {parameters['level']} of block_dude must be one of "
        f"{', '.join(map(str, known))}, as others have no block or no way to the exit"
    )


block_dude_family = TaskFamily(
    "block_dude",
    part_of_level,
    (
        Parameter("level", harder="later"),
        Parameter("columns", low=2, high=WIDTH - 1, harder="larger"),
        Parameter("time_limit", low=1),
        Parameter("discount", low=0, high=1),
    ),
    mapping=block_mapping,
    constraint=_has_a_way,
)
"""Block Dude's levels (:func:`part_of_level`); members map by :func:`block_mapping`."""
