"""Mappings by component names: the source's components are read off the target's (paper E7)."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from curricle.array_types import IntArray
from curricle.checks import one_of
from curricle.errors import MappingError
from curricle.tasks.families.family import Unequal
from curricle.tasks.spaces import MISSING, Component, Space
from curricle.tasks.task import Task, generative_model
from curricle.transfer.mapping import StateActionMapping, check_unmapped_value, pair_mapping

LARGEST_INDEX = 500_000_000
"""Target pairs for which an index array is made (4 GB)."""


class ComponentMapping(StateActionMapping):
    """A mapping given by names of components; made by :func:`project`.

    The index array is made only when it is asked for, so that the mapping serves targets of any
    size: learning reads the source through :meth:`lookups`.

    Parameters
    ----------
    target, source : Task
    renaming : dict of str to str
        Source component -> target component, where the names differ.
    unmapped_value : float, optional
        As in :class:`StateActionMapping`.
    unequal : {"unmapped", "clip", "scale"}
        What becomes of values without labels where the ranges of a component differ, as in
        :class:`ComponentsByName`.

    Examples
    --------
    >>> from curricle import Pursuit
    >>> far, near = Pursuit(size=10, predators=4), Pursuit(size=10, predators=1)
    >>> project(far, near, predator="predator_4")  # ten thousand million target states
    ComponentMapping(prey=prey, predator=predator_4)
    """

    renaming: dict[str, str]
    unequal: Unequal

    def __init__(
        self,
        target: Task,
        source: Task,
        renaming: dict[str, str],
        unmapped_value: float | None = None,
        unequal: Unequal = "unmapped",
    ):
        generative_model(target), generative_model(source)
        one_of("unequal", unequal, ("unmapped", "clip", "scale"), MappingError)
        check_unmapped_value(unmapped_value)
        known = {*source.states.names, *source.actions.names}
        for name in renaming:
            if name not in known:
                raise MappingError(
                    f"project names components of the source, {', '.join(sorted(known))}: got "
                    f"{name!r}"
                )
        for own, other in ((target.states, source.states), (target.actions, source.actions)):
            for component in other.components:
                _origin(own, component, renaming)
        fields = {"target": target, "source": source, "renaming": dict(renaming)}
        fields |= {"unmapped_value": unmapped_value, "unequal": unequal}
        for name, value in fields.items():
            object.__setattr__(self, name, value)

    def __reduce__(self) -> Any:
        """Pickle what the mapping was made from: names, and no index array."""
        given = (self.target, self.source, self.renaming, self.unmapped_value, self.unequal)
        return ComponentMapping, given

    @cached_property
    def index(self) -> IntArray:
        """The index array, (S, A) int64; MappingError for a target with too many pairs."""
        pairs = self.target.states.size * self.target.actions.size
        if pairs > LARGEST_INDEX:
            raise MappingError(
                f"a mapping has an index array for up to {LARGEST_INDEX:,} target pairs: got "
                f"{pairs:,}, which learners read one by one"
            )
        state = source_points(self.target.states, self.source.states, self.renaming, self.unequal)[
            :, None
        ]
        target, source, unmapped_value = self.target, self.source, self.unmapped_value
        return pair_mapping(target, source, state, self.actions, unmapped_value).index

    @cached_property
    def actions(self) -> IntArray:
        """The source's action for each of the target's, `MISSING` where none, (A,) int64."""
        return source_points(self.target.actions, self.source.actions, self.renaming, self.unequal)

    def lookups(self) -> list[IntArray] | None:
        """Return how to compute a source state from a target state without arrays over all states.

        One table for each component of the target's states, with an offset for each of its values:
        the source state is the sum of the offsets, and there is none where one is `MISSING`. None
        where a space is not a whole box.
        """
        target, source = self.target.states, self.source.states
        if not (target.is_box and source.is_box):
            return None
        offsets = {part.name: np.zeros(part.size, np.int64) for part in target.components}
        for component, stride in zip(source.components, source.strides, strict=True):
            origin = _origin(target, component, self.renaming)
            value = _values_of(origin, component, self.unequal) - component.low
            offset = offsets[origin.name]
            missing = (value < 0) | (value >= component.size) | (offset == MISSING)
            offsets[origin.name] = np.where(missing, MISSING, offset + value * stride)
        return list(offsets.values())

    def __repr__(self) -> str:
        names = (*self.source.states.names, *self.source.actions.names)
        read = {name: self.renaming.get(name, name) for name in names}
        shown = [f"{k}={v}" for k, v in read.items()]
        shown += [] if self.unequal == "unmapped" else [f"unequal={self.unequal!r}"]
        return f"ComponentMapping({', '.join(shown)})"


def project(
    target: Task, source: Task, *, unmapped_value: float | None = None, **renaming: str
) -> ComponentMapping:
    """Return the mapping that reads the source's components off the target's by name (paper E7).

    Each component of the source's states and actions takes its value from the target component
    of the same name, or the one named in `renaming`. Components with labels correspond label by
    label, so that (1,2) on a 5x5 grid is (1,2) on a 4x4 grid; a value the source does not have
    leaves the pair unmapped.

    Parameters
    ----------
    target, source : Task
    unmapped_value : float, optional
        As in :class:`StateActionMapping`.
    **renaming : str
        ``source_component="target_component"``.

    Raises
    ------
    MappingError
        On an unknown component, listing the valid ones.

    Examples
    --------
    >>> from curricle import Pursuit
    >>> hunt, chase = Pursuit(size=4, predators=2), Pursuit(size=4, predators=1)
    >>> f1 = project(hunt, chase, predator="predator_1")
    >>> pair = f1.index[hunt.states.encode(prey=9, predator_1=3, predator_2=5),
    ...                 hunt.actions.encode(predator_1=2, predator_2=0)]
    >>> chase.states.label(pair // 5), chase.actions.label(pair % 5)
    ('prey=(2,1) predator=(0,3)', 'predator=east')
    """
    return ComponentMapping(target, source, renaming, unmapped_value)


def source_points(
    target: Space,
    source: Space,
    renaming: Mapping[str, str],
    unequal: Unequal = "unmapped",
) -> IntArray:
    """Return the source's point for each of the target's, `MISSING` where there is none."""
    values, read = target.decode(), {}
    for component in source.components:
        origin = _origin(target, component, renaming)
        known = _values_of(origin, component, unequal)
        read[component.name] = known[values[origin.name] - origin.low]
    return source.encode(**read)


def describe_renaming(names: Sequence[str], renaming: Mapping[str, str]) -> str:
    """Return a sentence on which target component each source component is read from.

    Examples
    --------
    >>> describe_renaming(("prey", "predator"), {"predator": "predator_2"})
    'predator is predator_2, prey by name'
    """
    kept = [name for name in dict.fromkeys(names) if renaming.get(name, name) == name]
    renamed = [f"{name} is {renaming[name]}" for name in dict.fromkeys(names) if name not in kept]
    return ", ".join([*renamed, *([f"{' and '.join(kept)} by name"] if kept else [])])


def _origin(target: Space, component: Component, renaming: Mapping[str, str]) -> Component:
    """Return the target component that a source component is read from."""
    name = renaming.get(component.name, component.name)
    if name not in target.names:
        raise MappingError(
            f"source component {component.name!r} must be read from a target component "
            f"({', '.join(target.names)}): got {name!r}"
        )
    return target.component(name)


def _values_of(origin: Component, component: Component, unequal: Unequal) -> IntArray:
    """Return the source's value for each value of the target's, by label where both have labels.

    Where a label is missing it is one below the component's lowest value.
    """
    if component.labels is None or origin.labels is None:
        values = np.arange(origin.size) + origin.low
        if unequal == "clip":
            return np.clip(values, component.low, component.high)
        if unequal == "scale":
            return component.low + (values - origin.low) * component.size // origin.size
        return values
    value = {label: component.low + i for i, label in enumerate(component.labels)}
    return np.array([value.get(label, component.low - 1) for label in origin.labels])
