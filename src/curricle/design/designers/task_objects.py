"""The objects of a task: what stands on its map, and the components of its states."""

import re
from collections import Counter
from collections.abc import Callable, Hashable, Iterable
from typing import Any

from curricle.checks import brief
from curricle.errors import CurriculumError

NO_OBJECTS = frozenset("#S ")
"""Characters of a map that are walls, the start or nothing."""
NUMBERED = re.compile(r"_?\d+$")

Object = tuple[str, Hashable]
"""Its class, and what tells it from others of its class."""
Objects = Callable[[Any], Iterable[Object]]


def objects_of(task: Any, target: Any = None) -> frozenset[Object]:
    """Return the objects of a task, each its class and what tells it from others of the class.

    Every character of a map is a class of objects in its cells, but for walls, the start and the
    most frequent of the others, which is the ground. Components of the states are objects too: the
    second predator of a pursuit is the second object of the class ``predator``. A task of plain
    tables has no map, so that its components are all that is known of it.

    Parameters
    ----------
    task : Task
    target : Task, optional
        Whose map says what the ground is; by default that of the task.

    Examples
    --------
    >>> from curricle import GridWorld, Pursuit
    >>> sorted(objects_of(GridWorld(["S.P", "..T"])))
    [('P', (0, 2)), ('T', (1, 2)), ('column', 1), ('row', 1)]
    >>> sorted(objects_of(Pursuit(size=3, predators=2)))
    [('predator', 1), ('predator', 2), ('prey', 1)]
    """
    ground = _ground(task if target is None else target)
    row, column = getattr(task, "origin", (0, 0))
    placed: set[Object] = {
        (character, (row + i, column + j))
        for i, line in enumerate(_map(task))
        for j, character in enumerate(line)
        if character not in NO_OBJECTS and character != ground
    }
    counts = Counter[str]()
    for component in task.states.components:
        kind = NUMBERED.sub("", component.name) or component.name
        counts[kind] += 1
        placed.add((kind, counts[kind]))
    return frozenset(placed)


def objects_by(objects: Objects | None, task: Any, target: Any) -> frozenset[Object]:
    """Return the objects of a task by a user's function, checked; by default :func:`objects_of`."""
    if objects is None:
        return objects_of(task, target)
    if not callable(objects):
        raise CurriculumError(f"objects must be a function of a task: got {brief(objects)}")
    given = objects(task)
    try:
        found = frozenset((kind, which) for kind, which in given)
        if not all(isinstance(kind, str) for kind, _ in found):
            raise TypeError
    except (TypeError, ValueError):
        raise CurriculumError(
            "objects of a task must be pairs, a class in words and what tells it from others of "
            f"the class: got {brief(given)}"
        ) from None
    return found


def _ground(task: Any) -> str:
    counts = Counter(one for line in _map(task) for one in line if one not in NO_OBJECTS)
    return counts.most_common(1)[0][0] if counts else ""


def _map(task: Any) -> tuple[str, ...]:
    given = getattr(task, "map", ())
    return given if isinstance(given, tuple) and all(isinstance(one, str) for one in given) else ()
