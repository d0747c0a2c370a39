"""The families that come with the library, by name; random mazes have a module of their own."""

from collections.abc import Callable, Iterator
from typing import Any, Literal

import numpy as np

from curricle.arrays import IntArray
from curricle.errors import TaskError
from curricle.tasks.block_dude import BlockDude
from curricle.tasks.cliff_walking import LARGEST_SIDE, CliffWalking
from curricle.tasks.deep_sea import LARGEST_SEED, LARGEST_SIZE as LARGEST_SEA, DeepSea
from curricle.tasks.domain import MOVES
from curricle.tasks.families.family import (
    ComponentsByName,
    FamilyMember,
    Parameter,
    TaskFamily,
    complete_parameters,
)
from curricle.tasks.families.mazes import maze_family
from curricle.tasks.four_rooms import (
    LARGEST_SIZE as LARGEST_ROOMS,
    SMALLEST_SIZE as SMALLEST_ROOMS,
    FourRooms,
)
from curricle.tasks.frozen_lake import LARGEST_LAKE, LEAST_FROZEN, MAPS, FrozenLake, random_lake
from curricle.tasks.key_lock_pit import LARGEST_ROOM, SMALLEST_ROOM, KeyLockPit
from curricle.tasks.pursuit import LARGEST_SIZE as LARGEST_GRID, MOST_PREDATORS, Pursuit
from curricle.tasks.river_swim import RiverSwim
from curricle.tasks.spaces import Decoded
from curricle.tasks.taxi import LARGEST_TOWN, STANDS, Taxi

HORIZON = (Parameter("time_limit", low=1), Parameter("discount", low=0, high=1))
"""Parameters that all domains have."""


def fields_of(
    domain: type, *names: str, declared: tuple[Parameter, ...] = ()
) -> tuple[Parameter, ...]:
    """Return parameters with the kind and default of these fields of a domain, and its horizon."""
    known = complete_parameters((*declared, *HORIZON), domain, domain.__name__)
    fields = {parameter.name: parameter for parameter in known}
    return tuple(fields[name] for name in (*names, "discount", "time_limit"))


# -- frozen lakes ----------------------------------------------------------------------------------


def part_of_lake(
    map: Literal["4x4", "8x8", "random"] = "4x4",
    part: int | None = None,
    size: int = 8,
    frozen_share: float = 0.8,
    seed: int = 0,
    **rules: Any,
) -> FrozenLake:
    """Return one of Gymnasium's frozen lakes, or the `part` around the goal, that many rows square.

    A part keeps the lake's coordinates and starts on any cell of ice.
    """
    lake = FrozenLake(random_lake(size, frozen_share, seed) if map == "random" else map, **rules)
    if part is None:
        return lake
    whole = len(lake.map)
    return lake.crop(rows=(whole - part, whole), columns=(whole - part, whole))


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
        *fields_of(
            FrozenLake,
            *("slippery", "success_rate", "start", "goal_reward", "hole_reward", "step_reward"),
            declared=(
                Parameter("slippery", harder="larger"),
                Parameter("success_rate", low=0, high=1, harder="smaller"),
                Parameter("start", values=("map", "uniform")),
            ),
        ),
    ),
    constraint=_parts_of_maps,
)
"""Frozen lakes: a `map` of Gymnasium, or a random one, or its `part` around the goal.

`part` is its rows and columns, 2 or more; `size`, `frozen_share` and `seed` are of random lakes.
Members map cell by cell, by the lake's coordinates.
"""

# -- walks along a cliff ---------------------------------------------------------------------------


cliff_walking_family = TaskFamily(
    "cliff_walking",
    CliffWalking,
    (
        Parameter("rows", low=2, high=LARGEST_SIDE, harder="larger"),
        Parameter("columns", low=3, high=LARGEST_SIDE, harder="larger"),
        Parameter("slippery", harder="larger"),
        Parameter("start", values=("map", "uniform")),
        *HORIZON,
    ),
    mapping=ComponentsByName("clip"),
)
"""Walks along a cliff (:class:`CliffWalking`).

Members map cell by cell, counted from the goal; cells farther off than the source has are read at
its edge.
"""

# -- taxis: towns of any size, 2 to 4 stands, with and without walls and rain ----------------------


taxi_family = TaskFamily(
    "taxi",
    Taxi,
    (
        Parameter("size", low=3, high=LARGEST_TOWN, harder="larger"),
        Parameter("stands", low=2, high=len(STANDS), harder="larger"),
        Parameter("walls", harder="larger"),
        Parameter("rainy", harder="larger"),
        Parameter("success_rate", low=0, high=1, harder="smaller"),
        *HORIZON,
    ),
    mapping=ComponentsByName("scale"),
)
"""Taxis (:class:`Taxi`); members map by name, rows and columns in proportion."""

# -- four rooms; rooms with a key, a lock and pits -------------------------------------------------


def _four_rooms(**rules: Any) -> FourRooms:
    """Return four rooms with the goal in a hallway."""
    return FourRooms(**rules)


def _room(size: int = 8, **rules: Any) -> KeyLockPit:
    """Return the square room of :meth:`KeyLockPit.room`."""
    return KeyLockPit.room(size, **rules)


def _four_rooms_mapping(target: FamilyMember, source: FamilyMember) -> Any:
    """Return how four rooms read others: hallways as hallways, the cells of rooms in proportion."""
    own, other = (_plan(one["size"]) for one in (target, source))

    def function(states: Decoded, actions: Decoded) -> tuple[Decoded, Decoded]:
        row, column = states["row"], states["column"]
        west, east = (_between(row, own[side], other[side]) for side in ("west", "east"))
        rows = np.where(column < target["size"] // 2, west, east)
        columns = _between(column, own["columns"], other["columns"])
        return {"row": rows, "column": columns}, actions

    return function


def _key_lock_pit_mapping(target: FamilyMember, source: FamilyMember) -> Any:
    """Return how a room reads another: key, pits and lock as such, other cells in proportion."""

    def marks(size: int) -> tuple[list[int], list[int]]:
        pits = size // 2
        return [0, 1, 2, size - 1], [0, 1, pits - 1, pits, pits + 1, size - 1]

    rows, columns = zip(marks(target["size"]), marks(source["size"]), strict=True)

    def function(states: Decoded, actions: Decoded) -> tuple[Decoded, Decoded]:
        row, column = _between(states["row"], *rows), _between(states["column"], *columns)
        return {**states, "row": row, "column": column}, actions

    return function


def _plan(size: int) -> dict[str, list[int]]:
    """Return the rows, in the west and the east, and the columns of hallways, walls and corners."""
    half, sixth, first = size // 2, (size - 1) // 6, size // 4
    last = size - 1 - sixth
    return {
        "west": [first, last, half, half - 1, half + 1, 1, size - 2],
        "east": [first, last, half + 1, half, half + 2, 1, size - 2],
        "columns": [sixth, half + half // 2, half, half - 1, half + 1, 1, size - 2],
    }


def _between(values: IntArray, own: list[int], other: list[int]) -> IntArray:
    """Return values so that each of one's own marks becomes the other's, in proportion between.

    Of two marks in one place the first counts.
    """
    marks, first = np.unique(own, return_index=True)
    read = np.interp(values, marks, np.array(other)[first])
    return np.asarray(np.rint(read), dtype=np.int64)


four_rooms_family = TaskFamily(
    "four_rooms",
    _four_rooms,
    fields_of(
        FourRooms,
        *("size", "slip", "goal", "start", "step_reward", "goal_reward"),
        declared=(
            Parameter("size", low=SMALLEST_ROOMS, high=LARGEST_ROOMS, harder="larger"),
            Parameter("slip", low=0, high=1, harder="larger"),
            Parameter("goal", values=tuple(MOVES)),
            Parameter("start", values=("corner", "uniform")),
        ),
    ),
    mapping=_four_rooms_mapping,
)
"""Four rooms (:class:`FourRooms`); members map hallways as such, other cells in proportion."""
key_lock_pit_family = TaskFamily(
    "key_lock_pit",
    _room,
    (
        Parameter("size", low=SMALLEST_ROOM, high=LARGEST_ROOM, harder="larger"),
        *fields_of(
            KeyLockPit,
            *("keys_held", "start", "key_reward", "lock_reward", "pit_reward", "step_reward"),
            declared=(
                Parameter("keys_held", harder="smaller"),
                Parameter("start", values=("map", "uniform")),
            ),
        ),
    ),
    mapping=_key_lock_pit_mapping,
)
"""Square rooms with a key, a lock and pits (:meth:`KeyLockPit.room`).

Members map key, pits and lock as such, other cells in proportion.
"""

# -- pursuits: size, predators, torus, capture (paper, F4; E7) -------------------------------------


Renaming = dict[str, str]


def _pursuit_mappings(target: FamilyMember, source: FamilyMember) -> list[Any]:
    """Return how a pursuit reads a smaller one, or one with fewer predators.

    There is one mapping for each group of predators that stands for the source's: each predator
    and those after it, in a circle (paper E7: f_1 and f_2 of two predators from one). Between
    grids of equal size cells correspond by label. On another size the distances between the prey
    and the predators of the group stay the same where they fit: a window of the source's size is
    laid over all of them, and is the nearer to an edge the nearer they are to it. Distances that do
    not fit become the largest that do.
    """
    if source["predators"] > target["predators"]:
        raise TaskError(
            f"a pursuit reads pursuits with at most its {target['predators']} predators: got "
            f"{source}"
        )
    groups = list(_groups(target.task.predator_names, source.task.predator_names))
    if target["size"] == source["size"]:
        return [ComponentsByName(renaming=group) for group in groups]
    return [_on_another_size(target, source, group) for group in groups]


def _groups(own: tuple[str, ...], others: tuple[str, ...]) -> Iterator[Renaming]:
    """Yield renamings of the source's predators, so that all of the target's are read equally."""
    for first in range(len(own) if len(own) > len(others) else 1):
        yield {name: own[(first + i) % len(own)] for i, name in enumerate(others)}


def _on_another_size(
    target: FamilyMember, source: FamilyMember, group: Renaming
) -> Callable[[Decoded, Decoded], tuple[Decoded, Decoded]]:
    """Return the function from the target's decoded states and actions to the source's."""
    size, smaller = target["size"], source["size"]
    five, other_five = target["moves"] == 5, source["moves"] == 5

    def function(states: Decoded, actions: Decoded) -> tuple[Decoded, Decoded]:
        bodies = ["prey", *group.values()]
        cells = np.stack(np.broadcast_arrays(*[states[name] for name in bodies]))
        place = _around_prey if source["torus"] else _window
        rows, columns = (
            place(axis, size, smaller, target["torus"]) for axis in np.divmod(cells, size)
        )
        read = rows * smaller + columns
        # Moves are numbered without staying where nobody stays: 0 is then north.
        moves = {name: actions[own] - five + other_five for name, own in group.items()}
        return dict(zip(["prey", *group], read, strict=True)), moves

    return function


def _window(axis: IntArray, size: int, smaller: int, torus: bool) -> IntArray:
    """Return coordinates in a walled grid of another size, (bodies, ...) as given."""
    low, high = axis.min(axis=0), axis.max(axis=0)
    before, after = low, size - 1 - high
    # The window begins at `first` of 0 .. size - smaller, in proportion to the room on both sides.
    room = np.maximum(before + after, 1)
    first = ((size - smaller) * before * 2 + room) // (2 * room)
    spread = high - low
    wide = spread > smaller - 1
    shifted = axis - np.clip(first, high - smaller + 1, low)
    squeezed = (2 * (axis - low) * (smaller - 1) + spread) // np.maximum(2 * spread, 1)
    return np.asarray(np.where(wide, squeezed, shifted))


def _around_prey(axis: IntArray, size: int, smaller: int, torus: bool) -> IntArray:
    """Return coordinates on a torus of another size: the prey's cell, and distances from it."""
    prey, distance = axis[0], axis - axis[0]
    if torus:
        distance = (distance + size // 2) % size - size // 2
    nearest = np.clip(distance, -((smaller - 1) // 2), smaller // 2)
    return np.asarray((prey + nearest) % smaller)


def _enough_predators(parameters: dict[str, Any]) -> str | None:
    """Return what is wrong where more predators are needed than there are."""
    needed, there = parameters["capture"], parameters["predators"]
    if isinstance(needed, int) and needed > there:
        return f"capture of pursuit must be at most the number of predators, {there}"
    return None


pursuit_family = TaskFamily(
    "pursuit",
    Pursuit,
    (
        Parameter("size", low=2, high=LARGEST_GRID, harder="larger"),
        Parameter("predators", low=1, high=MOST_PREDATORS, harder="larger"),
        Parameter("capture", values=("any", "all", "as_published", *range(1, MOST_PREDATORS + 1))),
        *HORIZON,
    ),
    mapping=_pursuit_mappings,
    constraint=_enough_predators,
)
"""Pursuits (:class:`Pursuit`).

A member reads one with fewer predators by each group of predators that stands for the source's, and
a smaller one by the distances between prey and predators.
"""

# -- Block Dude: BURLAP's levels and their parts around the exit -----------------------------------


WIDTH = 25
"""Columns of the levels."""
PARTS: dict[int, tuple[int, ...]] = {
    1: (10, 11, 12, *range(15, WIDTH)),
    2: tuple(range(17, WIDTH)),
    3: tuple(range(17, WIDTH)),
}
"""Level -> the columns of its parts that have blocks and a way to the exit."""


def part_of_level(
    level: Literal[1, 2, 3] = 1, columns: int | None = None, **rules: Any
) -> BlockDude:
    """Return one of BURLAP's levels, or the part that has these columns from the exit on.

    Where the agent's column is not among them, it begins in the last one, on top of what is there.
    """
    whole = BlockDude(level, **rules)
    if columns is None:
        return whole
    (agent,) = (line.find(what) for line in whole.level for what in "<>" if what in line)
    inside = agent < columns
    begins = None if inside else columns - 1
    return whole.crop(columns=(0, columns), agent=begins, start=whole.start)


def _block_mapping(target: FamilyMember, source: FamilyMember) -> ComponentsByName:
    """Return how a level reads another: by name, blocks in their order from the exit on."""
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
        *fields_of(BlockDude, "start", "step_reward", "exit_reward"),
    ),
    mapping=_block_mapping,
    constraint=_has_a_way,
)
"""BURLAP's levels of :class:`BlockDude`, or their `columns` around the exit, 2 or more.

Members map by name, blocks in their order from the exit on.
"""

# -- rivers to swim in -----------------------------------------------------------------------------


LARGEST_RIVER = 10_000


def _river(**rules: Any) -> RiverSwim:
    """Return a river whose episodes start at its second or third position, where it has them."""
    return RiverSwim(start=(1, 2) if rules["size"] > 2 else (1,), **rules)


def _river_mapping(target: FamilyMember, source: FamilyMember) -> Any:
    """Return how a river reads another: counted from the right bank, and not past the left one."""
    shift = target["size"] - source["size"]

    def function(states: Decoded, actions: Decoded) -> tuple[Decoded, Decoded]:
        return {"position": np.maximum(states["position"] - shift, 0)}, actions

    return function


def _chances_of_a_river(parameters: dict[str, Any]) -> str | None:
    total = parameters["forward"] + parameters["back"]
    return None if total <= 1 else "forward and back of river_swim must be at most 1 together"


river_swim_family = TaskFamily(
    "river_swim",
    _river,
    fields_of(
        RiverSwim,
        *("size", "forward", "back", "leave_bank", "stay_at_end", "left_reward", "right_reward"),
        declared=(
            Parameter("size", low=2, high=LARGEST_RIVER, harder="larger"),
            Parameter("forward", low=0, high=1, harder="smaller"),
            Parameter("back", low=0, high=1, harder="larger"),
            Parameter("leave_bank", low=0, high=1, harder="smaller"),
            Parameter("stay_at_end", low=0, high=1, harder="smaller"),
        ),
    ),
    mapping=_river_mapping,
    constraint=_chances_of_a_river,
)
"""Rivers (:class:`RiverSwim`); members map by position, counted from the right bank."""

# -- deep seas: the last rows of a sea are a smaller one -------------------------------------------


def _sea(**rules: Any) -> DeepSea:
    """Return a whole sea."""
    return DeepSea(**rules)


def _sea_mapping(target: FamilyMember, source: FamilyMember) -> Any:
    """Return how a sea reads another: cells counted from the ground, right moves as right ones.

    Columns are counted from the right, where the treasure is. What lies farther off than the source
    has is unmapped.
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
    _sea,
    fields_of(
        DeepSea,
        *("size", "move_cost", "treasure", "slip", "noise", "mapping_seed", "start"),
        declared=(
            Parameter("size", low=1, high=LARGEST_SEA, harder="larger"),
            Parameter("slip", low=0, high=1, harder="larger"),
            Parameter("noise", low=0, harder="larger"),
            Parameter("mapping_seed", low=0, high=LARGEST_SEED),
            Parameter("start", values=("surface", "uniform")),
        ),
    ),
    mapping=_sea_mapping,
)
"""Deep seas (:class:`DeepSea`); members map cell by cell, counted from the ground and the right."""

# -- all of them -----------------------------------------------------------------------------------

BUILT_IN: dict[str, TaskFamily] = {
    one.name: one
    for one in (
        maze_family,
        pursuit_family,
        frozen_lake_family,
        cliff_walking_family,
        taxi_family,
        four_rooms_family,
        key_lock_pit_family,
        block_dude_family,
        river_swim_family,
        deep_sea_family,
    )
}
"""Name -> family."""
