"""Mappings by components: the identity, by names (paper E7), by position."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Any, Literal, overload

import gymnasium as gym
import numpy as np

from curricle.arrays import IntArray
from curricle.checks import brief, instance, one_of
from curricle.errors import CurricleError, MappingError, TaskError
from curricle.tasks.family import ComponentsByName, FamilyMember, Unequal
from curricle.tasks.gridworld import GridWorld
from curricle.tasks.mdp import Task, generative_model
from curricle.tasks.observation_task import ObservationTask, stable_text
from curricle.tasks.spaces import MISSING, Component, Space
from curricle.tasks.start_states import goal_states
from curricle.transfer.mapping import (
    ObservationMapping,
    PairMapping,
    StateActionMapping,
    TaskMapping,
    check_unmapped_value,
    from_function,
    pair_mapping,
)
from curricle.transfer.pair import Proposal, TaskPair

LARGEST_INDEX = 500_000_000  # target pairs for which an index array is made (4 GB)
UNEQUAL = {"clip": "other values clipped", "scale": "ranges scaled"}
"""Treatment of values that the source lacks -> its description."""
Aligned = Mapping[str, Literal["first", "last"] | int]
"""Component of the states -> the end at which its two ranges are aligned, or the number that is
added to a value of the target."""


@dataclass(frozen=True, eq=False, repr=False)
class ComponentMapping(PairMapping):
    """A mapping by names of components; :func:`project` makes it.

    It suits targets of any size: learning reads the source through :meth:`lookups`, and the index
    array is made only at first use. `renaming` maps source components to target components with
    other names; `unequal` is as in :class:`ComponentsByName`. `aligned` shifts components of the
    source's states: their "first" or "last" values correspond, or a number is added to the
    target's.

    Examples
    --------
    >>> from curricle import Pursuit
    >>> far, near = Pursuit(size=10, predators=4), Pursuit(size=10, predators=1)
    >>> project(far, near, predator="predator_4")  # ten thousand million target states
    ComponentMapping(prey=prey, predator=predator_4)
    """

    target: Task
    source: Task
    renaming: Mapping[str, str]
    unmapped_value: float | None = None
    unequal: Unequal = "unmapped"
    knows_target: bool = False
    aligned: Aligned = field(default_factory=dict)

    def __post_init__(self) -> None:
        target, source = self.target, self.source
        generative_model(target), generative_model(source)
        one_of("unequal", self.unequal, ("unmapped", "clip", "scale"), MappingError)
        check_unmapped_value(self.unmapped_value)
        names = {*source.states.names, *source.actions.names}
        for name in self.renaming:
            if name not in names:
                raise MappingError(
                    f"project names components of the source, {', '.join(sorted(names))}: got "
                    f"{name!r}"
                )
        for space, other in ((target.states, source.states), (target.actions, source.actions)):
            for component in other.components:
                _origin(space, component, self.renaming)
        for name, end in self.aligned.items():
            if name not in source.states.names:
                raise MappingError(
                    "aligned names components of the source's states, "
                    f"{', '.join(source.states.names)}: got {name!r}"
                )
            if end not in ("first", "last") and type(end) is not int:
                raise MappingError(f"aligned must be first, last or a whole number: got {end!r}")
        object.__setattr__(self, "renaming", dict(self.renaming))
        object.__setattr__(self, "aligned", dict(self.aligned))

    @property
    def _read(self) -> dict[str, str]:
        """Source component -> the target component from which it is read."""
        names = *self.source.states.names, *self.source.actions.names
        return {name: self.renaming.get(name, name) for name in names}

    @property
    def description(self) -> str:
        """The mapping in words, such as "predator is predator_2, prey by name"."""
        kept = " and ".join(name for name, origin in self._read.items() if name == origin)
        phrases = [f"{name} is {origin}" for name, origin in self._read.items() if name != origin]
        phrases += [f"{kept} by name"] if kept else []
        phrases += [aligned_text(self.aligned)] if self.aligned else []
        unequal = "" if self.unequal == "unmapped" else f"; {UNEQUAL[self.unequal]}"
        return ", ".join(phrases) + unequal

    @property
    def parts(self) -> tuple[Any, ...]:
        """The names that make the mapping."""
        return repr(self), self.unmapped_value

    @property
    def why_empty(self) -> str:
        """Why no target pair reads a source pair, such as a component without a common value."""
        target, source = self.target, self.source
        for space, other in ((target.states, source.states), (target.actions, source.actions)):
            for component in other.components:
                origin = _origin(space, component, self.renaming)
                values = _values_of(origin, component, self.unequal, self.aligned)
                inside = (values >= component.low) & (values <= component.high)
                if not inside.any() and component.name not in self.aligned:
                    target_values = f"{origin.name} of the target runs from {origin.ends}"
                    source_values = f"{component.name} of the source from {component.ends}"
                    return f"no value is in both tasks: {target_values}, and {source_values}"
            boxes = space.is_box and other.is_box
            if boxes and any((part == MISSING).all() for part in self._lookups(space, other)):
                return "a component of the target has no value that is in all that are read from it"
        return "" if target.states.is_box and source.states.is_box else super().why_empty

    @cached_property
    def index(self) -> IntArray:  # type: ignore[override]
        """The index array, (S, A) int64; MappingError for a target with too many pairs."""
        pairs = self.target.states.size * self.target.actions.size
        if pairs > LARGEST_INDEX:
            raise MappingError(
                f"a mapping has an index array for up to {LARGEST_INDEX:,} target pairs: got "
                f"{pairs:,}, which learners read one by one"
            )
        target, source = self.target, self.source
        shifts = self.renaming, self.unequal, self.aligned
        state = source_points(target.states, source.states, *shifts)
        return pair_mapping(target, source, state[:, None], self.actions).index

    @cached_property
    def actions(self) -> IntArray:
        """The source action of each target action, (A,) int64; `MISSING` where there is none."""
        return source_points(self.target.actions, self.source.actions, self.renaming, self.unequal)

    def lookups(self) -> list[IntArray] | None:
        """Return an array of offsets for each target component; their sum is the source state.

        No source state exists where an offset is `MISSING`. None if a space is not a whole box.
        """
        target, source = self.target.states, self.source.states
        return self._lookups(target, source) if target.is_box and source.is_box else None

    def _lookups(self, target: Space, source: Space) -> list[IntArray]:
        """Return the :meth:`lookups` of states or of actions."""
        offsets = {part.name: np.zeros(part.size, np.int64) for part in target.components}
        for component, stride in zip(source.components, source.strides, strict=True):
            origin = _origin(target, component, self.renaming)
            value = _values_of(origin, component, self.unequal, self.aligned) - component.low
            offset = offsets[origin.name]
            missing = (value < 0) | (value >= component.size) | (offset == MISSING)
            offsets[origin.name] = np.where(missing, MISSING, offset + value * stride)
        return list(offsets.values())

    def __repr__(self) -> str:
        shown = [f"{name}={origin}" for name, origin in self._read.items()]
        shown += [] if self.unequal == "unmapped" else [f"unequal={self.unequal!r}"]
        shown += [f"aligned={self.aligned}"] if self.aligned else []
        return f"ComponentMapping({', '.join(shown)})"


def project(
    target: Task,
    source: Task,
    *,
    unmapped_value: float | None = None,
    unequal: Unequal = "unmapped",
    aligned: Aligned | None = None,
    **renaming: str,
) -> ComponentMapping:
    """Return the mapping that reads source components from target components by name (paper E7).

    Components of states and actions correspond if they have the same name, or if `renaming` has
    ``source_component="target_component"``. If both have labels, equal labels correspond. Values
    that the source lacks leave a pair unmapped (see :class:`StateActionMapping`), or are treated as
    `unequal` says (see :class:`ComponentsByName`). With ``aligned={"row": "last"}`` the last rows
    of both correspond, with ``aligned={"row": -4}`` row 6 of the target and row 2 of the source.

    Raises
    ------
    MappingError
        When a component is unknown (the message lists the known ones), or when no pair is mapped.

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
    aligned = {} if aligned is None else aligned
    mapping = ComponentMapping(target, source, renaming, unmapped_value, unequal, aligned=aligned)
    if mapping.why_empty:
        raise MappingError(
            f"a mapping by name must map some pair: {mapping.why_empty}; give both tasks the same "
            "values, or map with from_function"
        )
    return mapping


def source_points(
    target: Space,
    source: Space,
    renaming: Mapping[str, str],
    unequal: Unequal = "unmapped",
    aligned: Aligned | None = None,
) -> IntArray:
    """Return the source point of each target point, `MISSING` where there is none."""
    values, read = target.decode(), {}
    for component in source.components:
        origin = _origin(target, component, renaming)
        counterparts = _values_of(origin, component, unequal, aligned or {})
        read[component.name] = counterparts[values[origin.name] - origin.low]
    return source.encode(**read)


def _origin(target: Space, component: Component, renaming: Mapping[str, str]) -> Component:
    """Return the target component from which a source component is read."""
    name = renaming.get(component.name, component.name)
    if name not in target.names:
        raise MappingError(
            f"source component {component.name!r} must be read from a target component "
            f"({', '.join(target.names)}): got {name!r}"
        )
    origin = target.component(name)
    if component.arbitrary or origin.arbitrary:
        raise MappingError(
            f"a component that numbers states as found cannot be read by name: got {name!r} "
            f"for {component.name!r}; give the environment numbers or words that tell states apart"
        )
    return origin


def _values_of(
    origin: Component, component: Component, unequal: Unequal, aligned: Aligned
) -> IntArray:
    """Return the source value of each target value; equal labels correspond if both have labels."""
    if component.name in aligned or component.labels is None or origin.labels is None:
        end = aligned.get(component.name, 0)
        ends = {"first": component.low - origin.low, "last": component.high - origin.high}
        values = np.arange(origin.size) + origin.low + (ends[end] if isinstance(end, str) else end)
        if unequal == "clip":
            return np.clip(values, component.low, component.high)
        if unequal == "scale":
            return component.low + (values - origin.low) * component.size // origin.size
        return values
    value = {label: component.low + i for i, label in enumerate(component.labels)}
    return np.array([value.get(label, component.low - 1) for label in origin.labels])


# -- the identity ----------------------------------------------------------------------------------

IDENTITY = "identity needs tasks of one shape"


@overload
def identity(
    target: ObservationTask, source: ObservationTask | None = None
) -> ObservationMapping: ...
@overload
def identity(target: Task, source: Task | None = None) -> StateActionMapping: ...
def identity(target: Any, source: Any = None) -> Any:
    """Return the mapping of each state and action to itself in a task of the same shape.

    Tasks have one shape if their components have the same values in the same order, under any
    names; or if their observations have the same shape. The source is the target by default.

    Raises
    ------
    MappingError
        When the shapes differ; the message says how.

    Examples
    --------
    >>> easy, hard = GridWorld("S.T"), GridWorld("SPT")
    >>> identity(hard, easy).index[0]
    array([0, 1, 2, 3])
    >>> identity(hard, GridWorld("S..T"))
    Traceback (most recent call last):
    curricle.errors.MappingError: identity needs tasks of one shape: the target's states have
    column[3], the source's column[4]; project maps by name what both have
    """
    source = target if source is None else source
    if isinstance(target, ObservationTask):
        check_same_observations(target, source)
        return ObservationMapping(target, source)
    models = generative_model(target), generative_model(source)
    for kind in ("states", "actions"):
        difference = _difference(kind, *(getattr(model, kind) for model in models))
        if difference:
            raise MappingError(f"{IDENTITY}: {difference}; project maps by name what both have")
    states, actions = np.arange(models[0].states.size), np.arange(models[0].actions.size)
    return pair_mapping(target, source, states[:, None], actions)


def _difference(kind: str, target: Space, source: Space) -> str:
    """Return the difference of the points of two spaces as text, "" if there is none."""
    names, other_names = ", ".join(target.names), ", ".join(source.names)
    if len(target.components) != len(source.components):
        return f"the target's {kind} have {names}, the source's {other_names}"
    for part, other in zip(target.components, source.components, strict=True):
        target_range, source_range = (
            f"{of.name}[{of.size}{f' from {of.low}' if of.low else ''}]" for of in (part, other)
        )
        if (part.size, part.low) != (other.size, other.low):
            return f"the target's {kind} have {target_range}, the source's {source_range}"
        labels, other_labels = part.labels or (), other.labels or ()
        pairs = zip(labels, other_labels, strict=False)  # either may have none
        if any(label != another and label in other_labels for label, another in pairs):
            return (
                f"values of {part.name} are {', '.join(labels)} in the target and "
                f"{', '.join(other_labels)} in the source"
            )
    if target.is_box and source.is_box:
        return ""
    points, source_points = (np.stack([*space.decode().values()]) for space in (target, source))
    if np.array_equal(points, source_points):
        return ""
    return (
        f"{kind} of {names} are {target.size:,} in the target and {source.size:,} in the source, "
        "not the same points in the same order"
    )


def check_same_observations(target: ObservationTask, source: object) -> None:
    """Raise MappingError if a source has observations of another shape."""
    if not isinstance(source, ObservationTask):
        return
    target_space, source_space = target.observations, source.observations
    if _form(target_space) != _form(source_space):
        raise MappingError(
            f"{IDENTITY}: the target's observations are {stable_text(target_space)}, the source's "
            f"{stable_text(source_space)}; a function of observations maps others"
        )


def _form(space: gym.Space[Any]) -> object:
    """Return the parts and shapes of a space of observations, which must agree."""
    if isinstance(space, gym.spaces.Dict):
        return {key: _form(part) for key, part in space.spaces.items()}
    if isinstance(space, gym.spaces.Tuple):
        return [_form(part) for part in space.spaces]
    counts = getattr(space, "n", None), getattr(space, "nvec", None)
    return type(space).__name__, space.shape, str(counts)


# -- members of a family ---------------------------------------------------------------------------


def family_mappings(
    target: FamilyMember, source: FamilyMember, *, unmapped_value: float | None = None
) -> tuple[Any, ...]:
    """Return the mappings from a member of a family to another, as the family declares them.

    Several mappings mean several transfers: each predator of a pursuit can read the only predator
    of its source. Mappings that the family's function returns keep their `unmapped_value`.

    Raises
    ------
    MappingError
        When the members belong to two families, or the family's declaration does not fit them.

    Examples
    --------
    >>> from curricle.tasks import pursuit_family
    >>> hunt, chase = pursuit_family(size=4, predators=2), pursuit_family(size=4, predators=1)
    >>> for mapping in family_mappings(hunt, chase):
    ...     print(mapping)
    ComponentMapping(prey=prey, predator=predator_1)
    ComponentMapping(prey=prey, predator=predator_2)
    """
    instance("target", target, FamilyMember, MappingError)
    instance("source", source, FamilyMember, MappingError)
    return member_mappings(target, source, target.task, source.task, unmapped_value)


def member_mappings(
    target: FamilyMember,
    source: FamilyMember,
    target_task: Task,
    source_task: Task,
    unmapped_value: float | None = None,
) -> tuple[Any, ...]:
    """Return the mappings of :func:`family_mappings` between the tasks made of two members."""
    if target.family.factory is not source.family.factory:
        raise MappingError(
            f"members of one family map onto each other: got {target}, of {target.family.name}, "
            f"and {source}, of {source.family.name}"
        )
    declared = target.family.mapping
    if not isinstance(declared, ComponentsByName):
        try:
            declared = declared(target, source)
        except CurricleError as error:
            raise MappingError(str(error)) from error
    mappings = [*declared] if isinstance(declared, list | tuple | Iterator) else [declared]
    if not mappings:
        raise MappingError(
            f"a family must declare at least one mapping: {target} <- {source} has none"
        )
    tasks = target_task, source_task
    for i, mapping in enumerate(mappings):
        if isinstance(mapping, ComponentsByName):
            renaming = dict(mapping.renaming)
            mappings[i] = ComponentMapping(*tasks, renaming, unmapped_value, mapping.unequal)
        elif not isinstance(mapping, TaskMapping):
            if not callable(mapping):
                raise MappingError(
                    f"the mapping of {target.family.name} must return a ComponentsByName, a "
                    "function of states and actions, a mapping, or a list of them: got "
                    f"{brief(mapping)}"
                )
            mappings[i] = from_function(*tasks, mapping, unmapped_value=unmapped_value)
    return tuple(mappings)


# -- mazes, by position and by objects -------------------------------------------------------------


def same_position(
    target: GridWorld, source: GridWorld, *, unmapped_value: float | None = None
) -> StateActionMapping:
    """Return the mapping of each cell of a maze to the same cell of another (paper F2, F3).

    Positions are in map coordinates, which a crop keeps. MappingError for other tasks.

    Examples
    --------
    >>> maze = GridWorld("S..T")
    >>> same_position(maze, maze.crop(rows=(0, 1), columns=(2, 4))).index[:3, 0]
    array([-1, -1,  0])
    """
    _check_mazes("same_position", target, source)
    state = source.states_at(target.cells[:, 0], target.cells[:, 1])
    moves = np.arange(target.actions.size)
    return pair_mapping(target, source, state[:, None], moves, unmapped_value)


def relative_objects(
    target: GridWorld, source: GridWorld, *, unmapped_value: float | None = None
) -> StateActionMapping:
    """Return Svetlik's mapping to states with the same objects around the agent (paper E4, F1).

    A target state matches a source state if every object of the source has an object of its class
    in the target at the same place relative to the agent: s_target = [s_source, rest]. If several
    shifts of the source's map fit, the smallest is used (up, then left). MappingError for other
    tasks.

    Examples
    --------
    >>> source = GridWorld("S.T")
    >>> relative_objects(GridWorld(["S....", "....T"]), source).index[:, 0].reshape(2, 5)
    array([[-1, -1, -1, -1, -1],
           [-1, -1,  0,  4, -2]])
    """
    _check_mazes("relative_objects", target, source)
    objects = set(target.objects)
    name, row, column = source.objects[0]
    shifts = sorted((r - row, c - column) for n, r, c in target.objects if n == name)
    state = np.full(target.states.size, MISSING)
    for down, right in shifts:
        if all((n, r + down, c + right) in objects for n, r, c in source.objects):
            shifted = source.states_at(target.cells[:, 0] - down, target.cells[:, 1] - right)
            state = np.where(state == MISSING, shifted, state)
    moves = np.arange(target.actions.size)
    return pair_mapping(target, source, state[:, None], moves, unmapped_value)


def _check_mazes(mapping: str, target: Task, source: Task) -> None:
    for role, task in (("target", target), ("source", source)):
        if not isinstance(task, GridWorld):
            raise MappingError(f"{mapping} maps a GridWorld to a GridWorld: the {role} is {task}")


# -- searches by name ------------------------------------------------------------------------------

BY_NAME: dict[Unequal, str] = {
    "unmapped": "components by name",
    "scale": "components by name, unequal ranges scaled",
    "clip": "components by name, unequal ranges clipped",
}
ALIGNED: dict[Unequal, str] = {"unmapped": "", "clip": ", clipped"}
MOST_UNEQUAL = 3  # most components of unequal ranges that are aligned


def by_name(tasks: TaskPair) -> Iterator[Proposal]:
    """Yield the mappings that :func:`project` makes without renaming.

    There are three of them: values that the source lacks are left unmapped, scaled or clipped.

    Examples
    --------
    >>> from curricle import Pursuit
    >>> tasks = TaskPair(Pursuit(size=3, predators=2), Pursuit(size=3, predators=1))
    >>> list(by_name(tasks))
    Traceback (most recent call last):
    curricle.errors.MappingError: source component 'predator' must be read from a target ...
    """
    for unequal, how in BY_NAME.items():
        yield Proposal(ComponentMapping(tasks.target, tasks.source, {}, unequal=unequal), how)


def by_alignment(tasks: TaskPair) -> Iterator[Proposal]:
    """Yield mappings by name in which ranges of unequal size are aligned at either end.

    A wide grid and a narrow grid may correspond at the side of the goal. Values outside the
    narrower range are left unmapped, or read its last value.

    Raises
    ------
    MappingError
        When the target lacks a component of the source, or no range without labels is unequal.

    Examples
    --------
    >>> tasks = TaskPair(GridWorld("S....T"), GridWorld("S.T"))
    >>> [proposal.how for proposal in by_alignment(tasks)]
    ['components by name, last column aligned', 'components by name, last column aligned, clipped']
    """
    target, source = tasks.target.states, tasks.source.states
    unequal = []
    for component in source.components:
        origin = _origin(target, component, {})
        same = (origin.size, origin.low) == (component.size, component.low)
        if not same and origin.labels is None:
            unequal.append(component)
    if not unequal or len(unequal) > MOST_UNEQUAL:
        raise MappingError(
            f"ranges are aligned where 1 to {MOST_UNEQUAL} components differ: got {len(unequal)}"
        )
    for ends in product(("first", "last"), repeat=len(unequal)):
        aligned = {part.name: end for part, end in zip(unequal, ends, strict=True)}
        if set(ends) == {"first"} and all(
            part.low == target.component(part.name).low for part in unequal
        ):
            continue  # :func:`by_name` yields this mapping
        yield from _aligned(tasks, aligned)


def at_goal(tasks: TaskPair) -> Iterator[Proposal]:
    """Yield mappings by name in which the goals of both tasks correspond.

    The goal is the end that is entered with the largest reward (:func:`goal_distance`). A component
    in which the goal has one value in both tasks is read at the same distance from it.

    Raises
    ------
    MappingError
        When the target lacks a component of the source, or no component is shifted.

    Examples
    --------
    >>> tasks = TaskPair(GridWorld("S...T."), GridWorld("S.T"))
    >>> [proposal.how for proposal in at_goal(tasks)]
    ['components by name, column - 2 aligned', 'components by name, column - 2 aligned, clipped']
    """
    shifts = dict[str, int]()
    try:
        goals = [mdp.states.decode(np.flatnonzero(goal_states(mdp))) for mdp in tasks.models]
    except TaskError as error:
        raise MappingError(str(error)) from None
    for component in tasks.source.states.components:
        origin = _origin(tasks.target.states, component, {})
        of_target, of_source = ({*goal[component.name].tolist()} for goal in goals)
        if len(of_target) == len(of_source) == 1 and origin.labels is None:
            shifts[component.name] = min(of_source) - min(of_target)
    shifts = {name: shift for name, shift in shifts.items() if shift}
    if not shifts:
        raise MappingError("goals are aligned where each has one place, and these differ")
    yield from _aligned(tasks, shifts)


def _aligned(tasks: TaskPair, aligned: Any) -> Iterator[Proposal]:
    how = f"{BY_NAME['unmapped']}, {aligned_text(aligned)}"
    for unequal, ending in ALIGNED.items():
        mapping = ComponentMapping(tasks.target, tasks.source, {}, unequal=unequal, aligned=aligned)
        yield Proposal(mapping, how + ending)


def aligned_text(aligned: Aligned) -> str:
    """Return which components are aligned, as in "first row and last column aligned"."""
    phrases = (
        f"{end} {name}" if isinstance(end, str) else f"{name} {'-' if end < 0 else '+'} {abs(end)}"
        for name, end in aligned.items()
    )
    return f"{' and '.join(phrases)} aligned"
