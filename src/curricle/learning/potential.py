"""Potentials: estimates of the values of states, or of state-action pairs, before learning.

They are 0 where an episode has ended (Grzes 2017): a potential there would change the optimal
policy. Values at terminal states are replaced by 0 where the task knows these beforehand; elsewhere
the reader of a potential passes whether an episode has ended. The discount is the task's.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from curricle.arrays import FloatArray, FloatTable, Frozen, IntArray, frozen, refrozen
from curricle.checks import BEYOND_64_BITS, brief, indices, number, numbers, whole_number
from curricle.errors import PotentialError
from curricle.learning.schedules import schedule
from curricle.learning.value_lookup import TOTAL, ValueLookup, array_lookup, fits_task, read_rows
from curricle.tasks.mdp import Task, available_actions, duplicated, generative_model
from curricle.text import brief_repr

LARGEST_POTENTIAL = 1e15
"""Numbers of this size are stored in steps of 1/8: rewards of ordinary size no longer change them.
Near 1e308 learning overflows."""


ROWS = 1024  # of a table that are computed at a time
MOST_SHARED = 10_000_000
"""State-action pairs up to which members of a portfolio may have dense tables by default, 400 MB a
seed, and up to which phi is read at every pair for its range."""


@dataclass(frozen=True, eq=False)
class StatePotential(Frozen):
    """Phi(s), possibly changing with time; shapes with F = gamma Phi(s', t') - Phi(s, t).

    Paper E2; Ng, Harada, Russell 1999; for a changing potential Devlin, Kudenko 2012.

    Parameters
    ----------
    task : Task
        The task to be shaped.
    values : (S,) or (M, S) float array
        Phi, or M of them in turn; set to 0 at the terminal states that the task knows.
    frame_steps : (M,) int array, optional
        The step of learning from which each of the M holds; the first must be 0.
    weight : float or Schedule
        Factor w(t) of the values that hold at step t.

    Raises
    ------
    PotentialError
        When the shape is wrong, or a value is not finite or larger than 1e15 in size.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> phi = StatePotential(GridWorld("S.T"), [0.0, 1.0, 7.0])
    >>> phi.values
    array([[0., 1., 0.]])
    >>> round(float(phi.shaping_reward(0, 1)), 2)  # gamma is 0.99
    0.99
    """

    task: Task
    values: FloatArray
    frame_steps: Any = (0,)
    weight: Any = 1.0

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        generative = generative_model(self.task)
        n_states = generative.states.size
        values = finite(self.values, "Phi")
        if values.ndim not in (1, 2) or values.shape[-1] != n_states or not values.size:
            raise PotentialError(
                f"a state potential must have shape ({n_states},) or (M, {n_states}): got "
                f"{values.shape}"
            )
        steps = indices("frame_steps", self.frame_steps, BEYOND_64_BITS, PotentialError)
        values = values.reshape(-1, n_states)
        if steps.shape != (len(values),) or steps[0] != 0 or (np.diff(steps) <= 0).any():
            raise PotentialError(
                f"frame_steps must rise from 0, one for each of the {len(values)} potentials: got "
                f"{steps.tolist()}"
            )
        object.__setattr__(self, "values", _zero_at_ends(generative.terminal, values))
        object.__setattr__(self, "frame_steps", frozen(steps))
        object.__setattr__(self, "weight", schedule(self.weight))
        ends = abs(self.weight.first), abs(self.weight.last)
        if not max(ends) * abs(values).max() <= LARGEST_POTENTIAL:
            raise too_large("weight times Phi", f"the weight is {self.weight}")

    @property
    def changes(self) -> bool:
        """Whether Phi changes with time."""
        return len(self.frame_steps) > 1 or self.weight.first != self.weight.last

    def at(self, step: int = 0) -> FloatArray:
        """Return Phi(s, t), (S,) float64, after `step` steps of learning."""
        step = whole_number("a step of learning", step, 0, PotentialError)
        current = int(np.searchsorted(self.frame_steps, step, side="right")) - 1
        return np.asarray(self.weight(step) * self.values[current])

    def shaping_reward(
        self,
        state: npt.ArrayLike,
        next_state: npt.ArrayLike,
        *,
        step: int = 0,
        terminated: npt.ArrayLike | None = None,
    ) -> FloatArray:
        """Return F = gamma Phi(s', t + 1) - Phi(s, t), t = `step`, in the shape of the states.

        Parameters
        ----------
        state, next_state : int array
        step : int
        terminated : bool array, optional
            Whether the episode ended in s', so that Phi(s') is 0. PotentialError where it is left
            out and the task does not know its terminal states.
        """
        generative = generative_model(self.task)
        phi = self.at(step)[numbered_states(self.task, state)]
        phi_after = self.at(step + 1)[numbered_states(self.task, next_state)]
        if terminated is not None:
            ended = np.asarray(terminated)
            if not ((ended == 0) | (ended == 1)).all():
                raise PotentialError(f"terminated must be True or False: got {brief(terminated)}")
            phi_after = np.where(ended == 1, 0.0, phi_after)
        elif generative.terminal is None:
            raise PotentialError(
                "the potential is 0 where an episode has ended, and this task does not know its "
                f"terminal states: give terminated= for {self.task!r}"
            )
        return np.asarray(generative.discount * phi_after - phi)


class PairPotential(Frozen, ABC):
    """phi(s, a) of a task with numbered states, as learning reads a potential of pairs."""

    task: Task
    values: Any  # phi(s, a) as an array, (S, A) float64; 0 at terminal states that the task knows
    of_actions = True

    @property
    @abstractmethod
    def known(self) -> FloatArray:
        """phi(s, a), (S, A) float64; NaN where no source knows a pair, and at known ends."""

    @cached_property
    def extremes(self) -> tuple[float, float]:
        """The lowest and the highest phi(s, a) where it is known; 0 and 0 where it is nowhere."""
        return extremes_of(self.known)

    def kernel(self, *, gaps: bool = False) -> ValueLookup:
        """Return the lookup that fills tables row by row, NaN at unknown pairs if `gaps`."""
        return array_lookup(self.known if gaps else self.values, partial=gaps)

    def fill(self, q: FloatTable, initial: float) -> None:
        """Write initial + phi(s, a) into a table, (S, A); terminal rows may hold anything."""
        np.add(self.values, initial, out=q, casting="same_kind")

    def pairs(self, states: npt.NDArray[np.integer[Any]]) -> FloatArray:
        """Return phi(s, a) of n states, (n, A) float64, computing no others."""
        return np.asarray(self.values[states])

    def v(self, states: IntArray) -> FloatArray:
        """Return Phi(s) = max_a phi(s, a) of n states, (n,) float64."""
        return np.asarray(self.pairs(states).max(axis=1))

    @abstractmethod
    def rescaled(self, scale: float, shift: float = 0.0) -> Self:
        """Return scale phi(s, a) + shift, 0 at known terminal states; it keeps the optimum."""

    def to_state(self) -> StatePotential:
        """Return the state potential Phi(s) = max_a phi(s, a)."""
        return StatePotential(self.task, self.values.max(axis=1))


@dataclass(frozen=True, eq=False)
class StateActionPotential(PairPotential):
    """phi(s, a), for Q-initialisation and advice (paper E5; Wiewiora 2003).

    Parameters
    ----------
    task : Task
        The task to be shaped.
    values : (S, A) float array
        phi; set to 0 at the terminal states that the task knows. Where an action is not available
        its values do not count, and may be -inf.
    unknown : (S, A) bool array, optional
        Pairs that no source knows, which a portfolio explores as it would without phi.

    Raises
    ------
    PotentialError
        When the shape is wrong, or a value is not finite or larger than 1e15 in size.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> phi = StateActionPotential(GridWorld("ST"), [[1.0, 2.0, 3.0, 4.0], [5.0] * 4])
    >>> phi.values
    array([[1., 2., 3., 4.],
           [0., 0., 0., 0.]])
    >>> phi.to_state().values
    array([[4., 0.]])
    """

    task: Task
    values: FloatArray
    unknown: Any = None

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        generative = generative_model(self.task)
        shape = (generative.states.size, generative.actions.size)
        values = numbers("phi", self.values, PotentialError)
        if values.shape != shape:
            raise PotentialError(
                f"a state-action potential must have shape {shape}: got {values.shape}"
            )
        # An unavailable pair has any number that changes no maximum, and is finite as all are.
        values = finite(duplicated(values, available_actions(self.task)), "phi")
        ends = None if generative.terminal is None else generative.terminal[:, None]
        object.__setattr__(self, "values", _zero_at_ends(ends, values))
        if self.unknown is not None:
            unknown = np.asarray(self.unknown)
            if unknown.shape != shape or unknown.dtype != np.bool_:
                raise PotentialError(
                    f"the unknown pairs of a potential must be a bool array of shape {shape}: got "
                    f"{unknown.dtype} of shape {unknown.shape}"
                )
            object.__setattr__(self, "unknown", frozen(unknown))

    @property
    def known(self) -> FloatArray:
        """phi(s, a), (S, A) float64; NaN at unknown pairs, and at ends that the task knows."""
        return _nan_at(self.values, self.unknown, generative_model(self.task).terminal)

    def rescaled(self, scale: float, shift: float = 0.0) -> Self:
        """Return scale phi(s, a) + shift, 0 at known terminal states; it keeps the optimum."""
        scale, shift = finite_scale(scale, shift)
        return replace(self, values=scale * self.values + shift)


@dataclass(frozen=True, eq=False)
class MappedPotential(PairPotential):
    """phi(s, a) computed from the sources' values one state at a time, without an array.

    :class:`Curriculum` makes it from transfers with mappings by name (:func:`project`) and an
    aggregate of the library. The lookup holds the sources' values, and tables that lead from the
    task's states and actions to these values.

    Raises
    ------
    PotentialError
        When the lookup does not fit the task, or the size of a value exceeds 1e15.

    Examples
    --------
    >>> from curricle import Curriculum, Pursuit, Transfer, project
    >>> hunt, chase = Pursuit(3, 2), Pursuit(3, 1)
    >>> edge = Transfer("chase", "hunt", project(hunt, chase, predator="predator_1"))
    >>> curriculum = Curriculum({"chase": chase, "hunt": hunt}, [edge], budget=1000)
    >>> phi = curriculum.train().potentials["hunt"][0]
    >>> type(phi).__name__, phi.values.shape
    ('MappedPotential', (729, 25))
    """

    task: Task
    lookup: ValueLookup

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        generative = generative_model(self.task)
        object.__setattr__(self, "lookup", refrozen(self.lookup))  # a copy, which is then checked
        if not fits_task(self.lookup, generative.states, generative.actions.size):
            raise PotentialError(f"a lookup must be made for its task: {self.task} needs another")
        values = self.lookup.values
        known = np.isfinite(values)  # NaN where a pair is unmapped
        sizes = values.max(initial=0.0, where=known), -values.min(initial=0.0, where=known)
        largest = abs(self.lookup.scale) * max(sizes) + abs(self.lookup.shift)
        if largest > LARGEST_POTENTIAL:
            raise too_large("phi", f"the sources' values give {largest:g}")

    def kernel(self, *, gaps: bool = False) -> ValueLookup:
        """Return the lookup, with NaN at unknown pairs if `gaps`."""
        return self.lookup._replace(unknown=np.nan) if gaps else self.lookup

    @cached_property
    def values(self) -> FloatArray:
        """phi(s, a) as an array, (S, A) float64, computed at first use."""
        return frozen(self.pairs(np.arange(generative_model(self.task).states.size)))

    @property
    def known(self) -> FloatArray:
        """phi(s, a), (S, A) float64; NaN where no source knows a pair, and at known ends."""
        gaps = replace(self, lookup=self.kernel(gaps=True))
        return _nan_at(gaps.values, None, generative_model(self.task).terminal)

    @cached_property
    def extremes(self) -> tuple[float, float]:
        """The lowest and the highest phi(s, a) where it is known; 0 and 0 where it is nowhere.

        Of a task with more than 10 million pairs they are bounds, by all values of the sources.
        """
        lookup, rules = self.lookup, generative_model(self.task)
        if rules.states.size * rules.actions.size <= MOST_SHARED:
            return super().extremes
        low, high = extremes_of(lookup.values)
        if lookup.combine == TOTAL:
            n = len(lookup.first)
            low, high = min(low, n * low), max(high, n * high)
        ends = [lookup.scale * end + lookup.shift for end in (low, high)]
        return min(ends), max(ends)

    def fill(self, q: FloatTable, initial: float) -> None:
        """Write initial + phi(s, a) into a table, (S, A)."""
        lookup, rows = self.lookup._replace(initial=initial), np.empty((ROWS, q.shape[1]))
        for first in range(0, len(q), ROWS):  # one type of array, so that it is compiled once
            states = np.arange(first, min(first + ROWS, len(q)))
            read_rows(lookup, states, rows)
            q[first : first + ROWS] = rows[: len(states)]

    def pairs(self, states: npt.NDArray[np.integer[Any]]) -> FloatArray:
        """Return phi(s, a) of n states, (n, A) float64, without computing other states."""
        states = numbered_states(self.task, states)
        generative = generative_model(self.task)
        phi = np.empty((len(states), generative.actions.size))
        read_rows(self.lookup, states, phi)
        if generative.terminal is not None:
            phi[generative.terminal[states]] = 0.0
        return duplicated(phi, available_actions(generative, states))

    def rescaled(self, scale: float, shift: float = 0.0) -> Self:
        """Return the potential scale phi(s, a) + shift."""
        lookup, (scale, shift) = self.lookup, finite_scale(scale, shift)
        lookup = lookup._replace(scale=scale * lookup.scale, shift=scale * lookup.shift + shift)
        return replace(self, lookup=lookup)


def extremes_of(values: FloatArray) -> tuple[float, float]:
    """Return the lowest and the highest of values that are finite; 0 and 0 where none is."""
    numbers_alone = values[np.isfinite(values)]
    if not numbers_alone.size:
        return 0.0, 0.0
    return float(numbers_alone.min()), float(numbers_alone.max())


def finite_scale(scale: float, shift: float) -> tuple[float, float]:
    """Return the scale and shift of a potential as floats; PotentialError unless finite."""
    return number("scale", scale, PotentialError), number("shift", shift, PotentialError)


def numbered_states(task: object, states: object) -> IntArray:
    """Return numbers of a task's states, checked; PotentialError where one is out of range."""
    return indices("states", states, generative_model(task).states.size, PotentialError)


def _zero_at_ends(ends: Any, values: FloatArray) -> FloatArray:
    """Return the values with 0 in terminal states, where these are known; read-only."""
    return frozen(values.copy() if ends is None else np.where(ends, 0.0, values))


def _nan_at(values: FloatArray, unknown: Any, ends: Any) -> FloatArray:
    """Return a copy of values, (S, A), with NaN at unknown pairs and in terminal states."""
    with_gaps = values.copy()
    if unknown is not None:
        with_gaps[unknown] = np.nan
    if ends is not None:
        with_gaps[ends] = np.nan
    return with_gaps


def finite(array: npt.ArrayLike, name: str) -> FloatArray:
    """Return a float64 copy; PotentialError unless it is finite and at most 1e15 in size."""
    values = numbers(name, array, PotentialError)
    bad = np.argwhere(~(abs(values) <= LARGEST_POTENTIAL))
    if not len(bad):
        return values
    place = tuple(int(i) for i in bad[0])
    if np.isfinite(values[place]):
        raise too_large(name, f"entry {place} is {values[place]:g}")
    raise PotentialError(f"{name} must be finite: entry {place} is {values[place]}")


def too_large(name: str, where: str) -> PotentialError:
    """Return the error that a potential has numbers beside which rewards vanish."""
    return PotentialError(
        f"{name} must be at most {LARGEST_POTENTIAL:.0e} in size, as rewards vanish beside larger "
        f"numbers: {where}"
    )
