"""A level of MiniGrid: what is constant in it, and what steps may change."""

from collections.abc import Iterator, Sequence
from operator import itemgetter
from typing import Any

import numpy as np

from curricle.interop.tabulation.fingerprint import fingerprint
from curricle.interop.tabulation.state_access import Words

MOVED = frozenset({"agent_pos", "agent_dir", "carrying", "step_count"})
"""Attributes that every step of MiniGrid may change, beside the grid."""
SHOWN = frozenset({"window", "clock", "render_size", "_np_random", "_np_random_seed"})
"""Attributes that are no part of a state."""
REPLACED = frozenset({"gen_obs", "_reward"})
"""Methods that are replaced while an environment is tabulated."""
PLAIN = (type(None), bool, int, float, str, np.generic)
DIRECTIONS = "right", "down", "left", "up"
DOOR_STATES = "open", "closed", "locked"
CARRIED, AWAY = -1, -2
"""Coordinates of an object that the agent carries; of one in a box, or gone."""
STANDARD = "minigrid.core.world_object"
"""The module of objects of which it is known what steps change."""
STILL = {"wall", "floor", "goal", "lava"}
"""Types of objects without a state."""


class Level:
    """What a reset made: constant attributes, objects with a state, plain attributes."""

    def __init__(self, number: int, env: Any):
        self.number = number
        self.constants = {
            name: value for name, value in vars(env).items() if name not in MOVED | SHOWN | REPLACED
        }
        self.plain = [name for name, value in self.constants.items() if _is_plain(value)]
        self.objects = [each for each in _objects(env.grid.grid) if each.type not in STILL]
        self.values_of_plain = itemgetter(*self.plain, "mission")
        self.doors = [each for each in self.objects if each.type == "door"]
        self.movable = [each for each in self.objects if each.type != "door"]
        standard = [each for each in self.objects if type(each).__module__ == STANDARD]
        self.standard_doors = [each for each in standard if each.type == "door"]
        self.standard_movable = [each for each in standard if each.type != "door"]
        self.others = [each for each in self.objects if type(each).__module__ != STANDARD]
        self.names = {
            id(each): name
            for kind in {each.type for each in self.objects}
            for each, name in _numbered(kind, [o for o in self.objects if o.type == kind])
        }

    def object_states(self) -> tuple[Any, ...]:
        """Return what steps may change of the objects."""
        return (
            tuple([(door.is_open, door.is_locked) for door in self.standard_doors]),
            tuple(
                [(_place(each.cur_pos), _place(each.init_pos)) for each in self.standard_movable]
            ),
            tuple([_items(each) for each in self.others]),
        )

    def set_objects(self, states: tuple[Any, ...]) -> None:
        """Set the objects to states that were returned before."""
        doors, places, items = states
        for door, state in zip(self.standard_doors, doors, strict=True):
            door.is_open, door.is_locked = state
        for each, place in zip(self.standard_movable, places, strict=True):
            each.cur_pos, each.init_pos = place
        for each, values in zip(self.others, items, strict=True):
            vars(each).update(values)

    def digests(self) -> dict[str, bytes]:
        """Return a digest of each attribute that is not plain, to see whether it has changed."""
        return {
            name: fingerprint(value)
            for name, value in self.constants.items()
            if name not in self.plain
        }

    def words(self, env: Any) -> Words:
        """Return the components of the state that an environment of this level is in."""
        x, y = env.agent_pos
        found: dict[str, int | str] = {
            "level": self.number,
            "x": int(x),
            "y": int(y),
            "direction": DIRECTIONS[env.agent_dir],
        }
        for door in self.doors:
            state = 0 if door.is_open else 2 if door.is_locked else 1
            found[self.names[id(door)]] = DOOR_STATES[state]
        places = {id(each): i for i, each in enumerate(env.grid.grid) if each is not None}
        for each in self.movable:
            x = y = CARRIED if each is env.carrying else AWAY
            if id(each) in places:
                y, x = divmod(places[id(each)], env.width)
            found |= {f"{self.names[id(each)]}_x": x, f"{self.names[id(each)]}_y": y}
        for name in self.plain:
            value = vars(env)[name]
            if isinstance(value, str | bool | int) and value != "":
                found.setdefault(name, value)
        return found


def _is_plain(value: Any) -> bool:
    if isinstance(value, tuple):
        return all(map(_is_plain, value))
    return isinstance(value, PLAIN)


def _objects(cells: Sequence[Any]) -> list[Any]:
    """Return the different objects in the cells and in boxes, in the order of the cells."""
    found = dict[int, Any]()
    for each in cells:
        while each is not None and id(each) not in found:
            found[id(each)] = each
            each = each.contains
    return list(found.values())


def _numbered(kind: str, objects: Sequence[Any]) -> Iterator[tuple[Any, str]]:
    for i, each in enumerate(objects):
        yield each, kind if len(objects) == 1 else f"{kind}_{i + 1}"


def _place(place: Any) -> Any:
    """Return the coordinates of an object as MiniGrid first has them: a tuple, or None."""
    return place if place is None or type(place) is tuple else tuple(place.tolist())


def _items(each: Any) -> tuple[tuple[str, Any], ...]:
    """Return the attributes of an object that is none of MiniGrid's own."""
    return tuple(
        (name, tuple(value.tolist()) if isinstance(value, np.ndarray) else value)
        for name, value in vars(each).items()
    )
