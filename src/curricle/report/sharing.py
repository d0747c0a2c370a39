"""Who shares what: arms of a study often have a task, a curve or a setting in common."""

import operator
from collections.abc import Callable, Mapping
from typing import TypeVar

Name = TypeVar("Name")
Value = TypeVar("Value")


def shared(
    values: Mapping[Name, Value], alike: Callable[[Value, Value], bool] = operator.eq
) -> list[tuple[tuple[Name, ...], Value]]:
    """Return the different values in their order, each after the names that have it.

    Parameters
    ----------
    values : dict
        Name -> value.
    alike : callable
        Whether two values are one; by default whether they are equal.

    Examples
    --------
    >>> shared({"min": 3, "mean": 4, "max": 3})
    [(('min', 'max'), 3), (('mean',), 4)]
    """
    found: list[tuple[list[Name], Value]] = []
    for name, value in values.items():
        for names, known in found:
            if alike(known, value):
                names.append(name)
                break
        else:
            found.append(([name], value))
    return [(tuple(names), value) for names, value in found]
