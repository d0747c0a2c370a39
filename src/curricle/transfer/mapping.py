"""Inter-task mappings f(s, a): the source pair that each target pair reads (paper E5)."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from curricle.arrays import BoolArray, FloatArray, Frozen, IntArray, frozen
from curricle.checks import brief, number, numbers
from curricle.display import block, table
from curricle.errors import MappingError
from curricle.tasks.gridworld import GridWorld
from curricle.tasks.mdp import Task, generative_model, same_task
from curricle.tasks.spaces import MISSING, Decoded
from curricle.text import counted

PairFunction = Callable[[Decoded, Decoded], tuple[Decoded, Decoded]]

UNMAPPED = -1
"""Entry of a mapping for a target pair without a source pair: of it the source knows nothing."""
MOST_LISTED = 1_000_000_000
"""Pairs of a target that a mapping by a function may list: its array takes 8 GB."""
ENDED = -2
"""Entry for a pair whose source counterpart lies in a terminal state: there the value is 0."""


class TaskMapping(ABC):
    """A mapping of batches of a target's states or observations, and of its actions."""

    target: Any
    source: Any
    unmapped_value: float | None
    steps: int = 0  # of the search for it in tasks without tables, charged as those of sources are

    @abstractmethod
    def pairs(self, values: Any, batch: Any, scale: float = 1.0, shift: float = 0.0) -> FloatArray:
        """Return phi(s, a) = scale Q_source(f(s, a)) + shift of every action, (n, A) float64."""

    @property
    @abstractmethod
    def words(self) -> str:
        """The mapping in words, such as "predator is predator_2, prey by name"."""

    @property
    @abstractmethod
    def parts(self) -> tuple[Any, ...]:
        """What tells the mapping from others of the same kind."""

    @property
    def countable(self) -> bool:
        """Whether the pairs of both tasks are numbered, and few enough to count."""
        return False


@dataclass(frozen=True, eq=False)
class StateActionMapping(Frozen, TaskMapping):
    """A mapping of target pairs (s, a) to source pairs, as an index array.

    Parameters
    ----------
    target, source : Task
        S states and A actions, S' and A'.
    index : (S, A) int array
        ``s' * A' + a'`` of the source pair, `UNMAPPED`, or `ENDED`. Rows of terminal target
        states do not count.
    unmapped_value : float, optional
        A value that the source is to state for unmapped pairs. By default it states none: they are
        NaN, and aggregates skip them. 0 is optimistic where rewards are negative.
    how : str
        How a search found it; empty for others.
    steps : int
        Steps that the search took in tasks without tables.

    Raises
    ------
    MappingError
        On a wrong shape, a pair out of range or in a terminal source state.

    Examples
    --------
    >>> from curricle import Pursuit, project
    >>> hunt, chase = Pursuit(size=3, predators=2), Pursuit(size=3, predators=1)
    >>> print(project(hunt, chase, predator="predator_1").coverage())
    90.0% of 18,000 target pairs mapped, 10.0% at the source's end, 0.0% unmapped; ...
    """

    target: Task
    source: Task
    index: IntArray
    unmapped_value: float | None = None
    how: str = ""
    steps: int = 0

    def __post_init__(self) -> None:
        target, source = generative_model(self.target), generative_model(self.source)
        numbers("a mapping", self.index, MappingError)
        index = np.array(self.index)
        shape = (target.states.size, target.actions.size)
        n_pairs = source.states.size * source.actions.size
        if index.shape != shape or not np.issubdtype(index.dtype, np.integer):
            raise MappingError(
                f"a mapping must be an integer array of the target's shape {shape}: got "
                f"{index.dtype} of shape {index.shape}"
            )
        check_unmapped_value(self.unmapped_value)
        if target.terminal is not None:
            index = np.where(target.terminal[:, None], ENDED, index)
        bad = np.argwhere((index < ENDED) | (index >= n_pairs))
        if len(bad):
            s, a = bad[0]
            raise MappingError(
                f"a mapping's entries must lie in 0..{n_pairs - 1}, or be UNMAPPED or ENDED: "
                f"target state {s}, action {a} has {index[s, a]}"
            )
        state = np.maximum(index, 0) // source.actions.size
        bad = np.argwhere((index >= 0) & terminal_states(self.source)[state])
        if len(bad):
            s, a = bad[0]
            raise MappingError(
                "a mapping must not point at a terminal source state, whose values are never "
                f"learnt; use ENDED or UNMAPPED: target state {s}, action {a} points at source "
                f"state {state[s, a]}"
            )
        object.__setattr__(self, "index", frozen(index))

    def read(
        self, source_values: npt.ArrayLike, scale: float = 1.0, shift: float = 0.0
    ) -> FloatArray:
        """Return phi(s, a) = scale Q_source(f(s, a)) + shift, (..., S', A') -> (..., S, A) float64.

        It is `shift` where ended, and where unmapped `unmapped_value` or NaN.
        """
        q = numbers("source_values", source_values, MappingError)
        expected = (self.source.states.size, self.source.actions.size)
        if q.shape[-2:] != expected:
            raise MappingError(
                f"source values must end in the source's shape {expected}: got {q.shape}"
            )
        values = q.reshape(*q.shape[:-2], -1)[..., np.maximum(self.index, 0)]
        return transferred(values, self.index, self.unmapped_value, scale, shift)

    def pairs(self, values: Any, batch: Any, scale: float = 1.0, shift: float = 0.0) -> FloatArray:
        """Return phi(s, a) of the states with these numbers, (n, A) float64, as :meth:`read`."""
        index = self.index[batch]
        state, action = np.divmod(np.maximum(index, 0), self.source.actions.size)
        q = values.q(state.ravel(), action.ravel()).reshape(index.shape)
        return transferred(q, index, self.unmapped_value, scale, shift)

    @property
    def words(self) -> str:
        """How the mapping was found, in words."""
        return f"found: {self.how}" if self.how else "state by state and action by action"

    @property
    def parts(self) -> tuple[Any, ...]:
        """The numbers that make the mapping."""
        return self.index.shape, self.index.tobytes(), self.unmapped_value

    @property
    def countable(self) -> bool:
        """Whether both tasks have few enough pairs for coverage to be counted."""
        models = map(generative_model, (self.target, self.source))
        return all(task.states.size * task.actions.size <= LARGEST_COVERAGE for task in models)

    def with_unmapped_value(self, value: float) -> "StateActionMapping":
        """Return the same mapping with another value of unmapped pairs."""
        return replace(self, unmapped_value=value)

    def __repr__(self) -> str:
        mapped = int((self.index >= 0).sum())
        return f"{type(self).__name__}({mapped:,} of {self.index.size:,} pairs mapped)"

    def _repr_html_(self) -> str:
        return block(repr(self), self.countable and coverage_table({"": self.coverage()}))

    def coverage(self) -> "Coverage":
        """Return how much of the target is reached, and of the source used."""
        index = self.index[~terminal_states(self.target)]
        available = np.repeat(~terminal_states(self.source), self.source.actions.size)
        readers = np.bincount(index[index >= 0], minlength=available.size)
        used = readers[readers > 0]
        return Coverage(
            target_pairs=index.size,
            mapped=float((index >= 0).mean()),
            ended=float((index == ENDED).mean()),
            unmapped=float((index == UNMAPPED).mean()),
            source_pairs=int(available.sum()),
            never_used=int((available & (readers == 0)).sum()),
            most_readers=int(readers.max()),
            mean_readers=float(used.mean()) if used.size else 0.0,
        )

    def mapped_states(self) -> BoolArray:
        """Return which target states have at least one mapped pair, (S,) bool."""
        return np.asarray((self.index >= 0).any(axis=1))


def rescale(values: FloatArray, scale: float, shift: float) -> FloatArray:
    """Return scale values + shift; the array itself where that changes nothing."""
    return values if scale == 1 and shift == 0 else scale * values + shift


def check_unmapped_value(value: float | None) -> None:
    """Raise MappingError unless an unmapped value is a finite number or None."""
    if value is not None:
        number("unmapped_value", value, MappingError)


def number_or_nan(unmapped_value: float | None) -> float:
    """Return an unmapped value; NaN, for nothing known, where it is None."""
    return math.nan if unmapped_value is None else unmapped_value


def transferred(
    values: FloatArray, index: IntArray, unmapped_value: float | None, scale: float, shift: float
) -> FloatArray:
    """Return scale Q + shift where mapped, shift where ended, and `unmapped_value` elsewhere."""
    unmapped_value = number_or_nan(unmapped_value)
    fixed = np.where(index == UNMAPPED, unmapped_value, shift)
    return np.asarray(np.where(index >= 0, rescale(values, scale, shift), fixed))


def same_position(
    target: GridWorld, source: GridWorld, *, unmapped_value: float | None = None
) -> StateActionMapping:
    """Return the mapping of each cell of a maze to the same cell of another (paper F2, F3).

    Cells are compared in map coordinates, which a crop keeps.

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
    """Return Svetlik's mapping: states whose objects lie alike around the agent (paper E4, F1).

    A target state matches a source state if every object of the source lies, relative to the agent,
    where the target has an object of its class: s_target = [s_source, rest]. Of several shifts of
    the source's map that fit, the smallest (upwards, then to the left) is taken.

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


def from_function(
    target: Task, source: Task, function: PairFunction, *, unmapped_value: float | None = None
) -> StateActionMapping:
    """Return the mapping that a function on decoded components computes.

    Parameters
    ----------
    target, source : Task
    function : callable
        Takes the target's decoded states (name -> (S, 1) int64) and actions (name -> (1, A)) and
        returns the source's as two dicts of arrays that broadcast to (S, A). Values that are no
        point of the source's space leave the pair unmapped.
    unmapped_value : float, optional
        As in :class:`StateActionMapping`.

    Raises
    ------
    MappingError
        When the function asks for or returns other components than the tasks have, or the target
        has more than 1,000,000,000 pairs.

    Examples
    --------
    >>> line, half = GridWorld("S...T"), GridWorld("S.T")
    >>> coarse = from_function(line, half, lambda state, action: (
    ...     {"row": state["row"], "column": state["column"] // 2}, action))
    >>> coarse.index[:, 0]
    array([ 0,  0,  4,  4, -2])
    """
    if not callable(function):
        raise MappingError(f"a mapping needs a function of two dicts: got {brief(function)}")
    for task in (target, source):
        generative_model(task)
    pairs = target.states.size * target.actions.size
    if pairs > MOST_LISTED:
        raise MappingError(
            f"a mapping by a function lists all pairs of the target, at most {MOST_LISTED:,}: it "
            f"has {pairs:,}; map it by components"
        )
    states = _Components({k: v[:, None] for k, v in target.states.decode().items()}, "states")
    actions = _Components({k: v[None, :] for k, v in target.actions.decode().items()}, "actions")
    returned = function(states, actions)
    if not isinstance(returned, tuple) or [isinstance(p, dict) for p in returned] != [True, True]:
        raise MappingError(
            f"the function must return two dicts, of states and of actions: got {brief(returned)}"
        )
    encoded = []
    for kind, space, values in zip(
        ("state", "action"), (source.states, source.actions), returned, strict=True
    ):
        if set(values) != set(space.names):
            raise MappingError(
                f"the function must return the source's {kind} components "
                f"{', '.join(space.names)}: got {', '.join(map(str, values)) or 'none'}"
            )
        encoded.append(space.encode(**values))
    return pair_mapping(target, source, encoded[0], encoded[1], unmapped_value)


class _Components(dict[str, IntArray]):
    """The values of components by name, which tells the names that there are."""

    def __init__(self, values: Decoded, what: str):
        super().__init__(values)
        self._what = what

    def __missing__(self, name: str) -> IntArray:
        raise MappingError(
            f"a mapping's function must ask for components of the target's {self._what}, "
            f"{', '.join(self)}: got {name!r}"
        )


def compose(first: StateActionMapping, second: StateActionMapping) -> StateActionMapping:
    """Return `second` after `first`: from the target of `first` to the source of `second`.

    The source of `first` must be the target of `second`. Pairs that either leaves unmapped are
    unmapped, with the value of `first`.

    Examples
    --------
    >>> from curricle.transfer import identity
    >>> maze = GridWorld("S..T")
    >>> crop = maze.crop(rows=(0, 1), columns=(2, 4))
    >>> both = compose(same_position(maze, crop), identity(crop))
    >>> bool((both.index == same_position(maze, crop).index).all())
    True
    """
    if not same_task(first.source, second.target):
        raise MappingError(
            "composition needs the first mapping's source to be the second's target: got "
            f"{first.source} and {second.target}"
        )
    through = second.index.ravel()[np.maximum(first.index, 0)]
    index = np.where(first.index >= 0, through, first.index)
    return StateActionMapping(first.target, second.source, index, first.unmapped_value)


def terminal_states(task: Task) -> BoolArray:
    """Return which states are known to be terminal, (S,) bool."""
    terminal = generative_model(task).terminal
    return np.zeros(task.states.size, dtype=bool) if terminal is None else terminal


def pair_mapping(
    target: Task,
    source: Task,
    state: IntArray,
    action: IntArray,
    unmapped_value: float | None = None,
) -> StateActionMapping:
    """Return the mapping to these source states and actions, which broadcast to (S, A)."""
    state, action = np.broadcast_arrays(state, action)
    missing = (state == MISSING) | (action == MISSING)
    ended = terminal_states(source)[np.maximum(state, 0)]
    pair = np.where(ended, ENDED, state * source.actions.size + action)
    return StateActionMapping(target, source, np.where(missing, UNMAPPED, pair), unmapped_value)


def _check_mazes(mapping: str, target: Task, source: Task) -> None:
    for role, task in (("target", target), ("source", source)):
        if not isinstance(task, GridWorld):
            raise MappingError(f"{mapping} maps a GridWorld to a GridWorld: the {role} is {task}")


# -- coverage --------------------------------------------------------------------------------------

LARGEST_COVERAGE = 5_000_000  # pairs of either task up to which a mapping's coverage is counted


@dataclass(frozen=True)
class Coverage:
    """Coverage of a mapping between tasks with numbered states; shares sum to 1."""

    target_pairs: int  # (s, a), s not terminal
    mapped: float  # the share of them that read a source pair
    ended: float  # that fall on a terminal state of the source, of value 0
    unmapped: float  # that have no counterpart
    source_pairs: int  # of states that are not terminal
    never_used: int  # by any target pair
    most_readers: int  # target pairs that read one source pair
    mean_readers: float  # over the source pairs that are read

    def __str__(self) -> str:
        return (
            f"{self.mapped:.1%} of {counted(self.target_pairs, 'target pair')} mapped, "
            f"{self.ended:.1%} at the source's end, {self.unmapped:.1%} unmapped; "
            f"{self.never_used:,} of {counted(self.source_pairs, 'source pair')} are never read, "
            f"each of the others by {self.mean_readers:.1f} target pairs on average, by "
            f"{self.most_readers:,} at most"
        )

    def _repr_html_(self) -> str:
        readers = ["source pairs", "never used", "read on average by", "at most by"]
        used = (self.source_pairs, self.never_used, self.mean_readers, self.most_readers)
        return block("Coverage", coverage_table({"": self}), table(readers, [used]))


def coverage_table(covers: Mapping[str, Any]) -> Markup:
    """Return the coverage of mappings as a table, name -> Coverage or ObservationCoverage."""
    rows = []
    for name, cover in covers.items():
        pairs = cover.target_pairs if isinstance(cover, Coverage) else cover.observations
        parts = (cover.mapped, cover.ended, cover.unmapped)
        rows.append((name, pairs, *(f"{part:.1%}" for part in parts)))
    pairs = (
        "pairs" if all(isinstance(cover, Coverage) for cover in covers.values()) else "observations"
    )
    head = ["mapping", pairs, "mapped", "at the source's end", "unmapped"]
    named = int(not any(covers))  # the first column is left out where the names are empty
    return table(head[named:], [row[named:] for row in rows])
