"""Pursuit as vectors, for learners that see observations instead of numbered states."""

from dataclasses import fields
from functools import partial
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box

from curricle.array_types import IntArray
from curricle.checks import instance, one_of
from curricle.errors import MappingError, SettingError, TaskError
from curricle.frozen_arrays import frozen
from curricle.interop.environment import RenderMode, TaskEnvironment
from curricle.interop.spaces import Coding
from curricle.tasks.observation_task import EnvironmentMaker, ObservationTask
from curricle.tasks.pursuit import Pursuit
from curricle.tasks.spaces import Space
from curricle.transfer.component_mapping import (
    ComponentMapping,
    describe_renaming,
    source_points,
)
from curricle.transfer.mapping import ENDED, UNMAPPED
from curricle.transfer.observation_mapping import ObservationMapping

Vectors = npt.NDArray[np.float32]
Acting = Literal["all", "first"]


class PursuitVectors:
    """The states of a pursuit as vectors, and back.

    A vector has 2 + 4 N numbers for N predators, all in [-1, 1]: row and column of the prey, then
    for each predator its row and column and the prey's displacement from it, downwards and to the
    right. Rows and columns are scaled from -1, the first, to 1, the last; displacements are divided
    by ``size - 1``. On a torus they are the shortest; of two equal ones, up or to the left.

    So a network need not learn differences. A predator's numbers are adjacent, so a pursuit's
    vector begins with that of the pursuit with fewer predators.

    Parameters
    ----------
    pursuit : Pursuit

    Examples
    --------
    >>> seen = PursuitVectors(Pursuit(size=5, predators=1))
    >>> seen.of(np.array([[12, 4]]))  # the prey in the middle, the predator in the last column
    array([[ 0. ,  0. , -1. ,  1. ,  0.5, -0.5]], dtype=float32)
    >>> seen.cells(seen.of(np.array([[12, 4]])))
    array([[12,  4]])
    """

    def __init__(self, pursuit: Pursuit):
        instance("pursuit", pursuit, Pursuit, SettingError)
        self.pursuit = pursuit
        size, last, n = pursuit.size, pursuit.size - 1, pursuit.predators
        self._row_column = frozen(np.stack(np.divmod(np.arange(size**2), size), axis=1))
        # Numbers are looked up: by row or column in the first part, by difference in the second.
        away = np.arange(-last, size)
        if pursuit.torus:
            away = (away + size // 2) % size - size // 2
        places = 2 * np.arange(size) / last - 1
        self._numbers = frozen(np.concatenate([places, away / last]).astype(np.float32))
        one, none = np.eye(2, dtype=np.int64), np.zeros((2, 2), np.int64)
        prey = np.hstack([one, *[none, one] * n])
        predators = np.kron(np.eye(n, dtype=np.int64), np.hstack([one, -one]))
        # (2 + 2 N, 2 + 4 N): from rows and columns to indices within the two parts.
        self._looked_up = frozen(np.vstack([prey, np.pad(predators, ((0, 0), (2, 0)))]))
        self._begins = frozen(np.array([0, 0, *[0, 0, size + last, size + last] * n]))
        # (2 + 4 N, 1 + N): back from places to cells, row * size + column.
        self._weights = np.zeros((2 + 4 * n, 1 + n))
        self._weights[self._begins == 0] = np.kron(np.eye(1 + n), [[last / 2 * size], [last / 2]])
        self._middle = last / 2 * (size + 1)

    @property
    def space(self) -> Box:
        """The space of the vectors, ``Box(-1, 1, (2 + 4 N,), float32)``."""
        return Box(-1.0, 1.0, (2 + 4 * self.pursuit.predators,), np.float32)

    def of(self, cells: IntArray) -> Vectors:
        """Return vectors, (n, 2 + 4 N) float32, of the prey's and predators' cells, (n, 1 + N)."""
        where = self._row_column[cells].reshape(len(cells), -1)
        found: Vectors = self._numbers[where @ self._looked_up + self._begins]
        return found

    def cells(self, observations: npt.ArrayLike) -> IntArray:
        """Return the cells, (n, 1 + N) int64, of vectors as :meth:`of` returns them."""
        cells = np.asarray(observations, np.float64) @ self._weights + (self._middle + 0.5)
        return np.asarray(cells.astype(np.int64))  # cutting off x + 1/2 rounds x


class VectorPursuit(TaskEnvironment):
    """A pursuit whose observations are vectors, for deep learners.

    All else is as in :class:`TaskEnvironment`. ``vectors`` is its :class:`PursuitVectors`.

    Parameters
    ----------
    pursuit : Pursuit
        Of any size: no table is made.
    acting : {"all", "first"}
        Who takes the actions: all predators as one, ``Discrete(moves**N)``; or the first one alone,
        ``Discrete(moves)``, while the others move uniformly at random, drawn from ``np_random``.
        That is the task of one agent among several, as in :class:`PursuitParallelEnv`.
    render_mode : {"rgb_array", "ansi"}, optional
        As in :class:`TaskEnvironment`.

    Examples
    --------
    >>> hunt = VectorPursuit(Pursuit(size=10, predators=4))
    >>> hunt.observation_space.shape, hunt.action_space
    ((18,), Discrete(625))
    >>> seen, info = hunt.reset(options={"state": {"prey": 99, "predator_1": 0, "predator_2": 9,
    ...                                            "predator_3": 90, "predator_4": 98}})
    >>> seen[:6], hunt.cells(seen[None])
    (array([ 1.,  1., -1., -1.,  1.,  1.], dtype=float32), array([[99,  0,  9, 90, 98]]))
    """

    def __init__(
        self, pursuit: Pursuit, *, acting: Acting = "all", render_mode: RenderMode | None = None
    ):
        self.vectors = PursuitVectors(pursuit)
        one_of("acting", acting, ("all", "first"), SettingError)
        super().__init__(pursuit, render_mode=render_mode)
        parts = pursuit.actions.components
        self.moves = pursuit.actions if acting == "all" else Space(parts[:1])
        """The space of the moves that an action stands for."""
        self._own = Coding(self.moves, "index")
        self._moves_of_others = pursuit.actions.size // self.moves.size
        self.observation_space, self.action_space = self.vectors.space, self._own.gym_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Vectors, dict[str, Any]]:
        """Begin an episode; return the observation and the info."""
        state, info = super().reset(seed=seed, options=options)
        return self._seen(state), info

    def step(self, action: Any) -> tuple[Vectors, float, bool, bool, dict[str, Any]]:
        """Act; return observation, reward, terminated, truncated and info."""
        joint = self._own.number(action) * self._moves_of_others
        if self._moves_of_others > 1:
            joint += int(self.np_random.integers(self._moves_of_others))
        state, reward, terminated, truncated, info = super().step(joint)
        return self._seen(state), reward, terminated, truncated, info

    def cells(self, observations: npt.ArrayLike) -> IntArray:
        """Return the cells of the prey and of each predator, (n, 1 + N) int64, from n vectors."""
        return self.vectors.cells(observations)

    def _seen(self, state: int) -> Vectors:
        seen: Vectors = self.vectors.of(np.array([self._states.offsets(state)]))[0]
        return seen


class VectorPursuitEnvironment(VectorPursuit):
    """What ``Curricle/VectorPursuit-v0`` makes: :class:`VectorPursuit`, given a pursuit's rules."""

    def __init__(
        self, *, acting: Acting = "all", render_mode: RenderMode | None = None, **rules: Any
    ):
        super().__init__(Pursuit(**rules), acting=acting, render_mode=render_mode)


def observed_pursuit(pursuit: Pursuit, *, acting: Acting = "all") -> ObservationTask:
    """Return a pursuit as a task for deep learners, which see its vectors.

    Equal pursuits give equal tasks. The discount and the time limit are the pursuit's.

    Parameters
    ----------
    pursuit : Pursuit
        Of any size.
    acting : {"all", "first"}
        As in :class:`VectorPursuit`; ``"first"`` is one agent's task, on which potentials for
        agents that share one model are made.

    Examples
    --------
    >>> hunt = Pursuit(size=5, predators=3)
    >>> observed_pursuit(hunt)
    ObservationTask(Curricle/VectorPursuit-v0(size=5, predators=3), discount 0.99, ...)
    >>> observed_pursuit(hunt).n_actions, observed_pursuit(hunt, acting="first").n_actions
    (125, 5)
    """
    instance("pursuit", pursuit, Pursuit, TaskError)
    one_of("acting", acting, ("all", "first"), TaskError)
    rules = {rule.name: (getattr(pursuit, rule.name), rule.default) for rule in fields(pursuit)}
    arguments = {name: value for name, (value, default) in rules.items() if value != default}
    if acting != "all":
        arguments["acting"] = acting
    make = EnvironmentMaker("Curricle/VectorPursuit-v0", arguments)
    return ObservationTask(make, pursuit.discount)


def predator_mapping(
    target: ObservationTask,
    source: ObservationTask | Pursuit,
    *,
    unmapped_value: float | None = None,
    **renaming: str,
) -> ObservationMapping:
    """Return the mapping from the target's prey and predators to the source's, by name.

    It is :func:`project` between pursuits observed as vectors: cells correspond by row and column,
    moves by name; a pair with a cell or move that the source lacks is unmapped, and states that are
    terminal in the source are `ENDED`.

    Parameters
    ----------
    target : ObservationTask
        Of :func:`observed_pursuit`, or made of the registered environment.
    source : ObservationTask or Pursuit
        A task like `target`, or a pursuit whose values are a table.
    unmapped_value : float, optional
        As in :class:`ObservationMapping`.
    **renaming : str
        ``source_predator="target_predator"``, where the names differ. In a task with
        ``acting="first"`` only that predator, ``predator_1`` or ``predator``, can be read.

    Raises
    ------
    MappingError
        When a task is no pursuit observed as vectors, or on an unknown predator, listing the known.

    Examples
    --------
    Each of three predators reads the values of one that hunts alone.

    >>> from curricle.transfer import TableValues
    >>> hunt, chase = observed_pursuit(Pursuit(size=5, predators=3)), Pursuit(size=5, predators=1)
    >>> by_second = predator_mapping(hunt, chase, predator="predator_2")
    >>> q = np.zeros((chase.states.size, chase.actions.size))
    >>> q[chase.states.encode(prey=12, predator=11)] = [-2, -3, -1, -3, -3]  # east catches
    >>> seen = PursuitVectors(Pursuit(size=5, predators=3)).of(np.array([[12, 0, 11, 24]]))
    >>> by_second.pairs(TableValues(q), seen)[0, :15]  # of moves (0, 0..2, 0..4)
    array([-2., -2., -2., -2., -2., -3., -3., -3., -3., -3., -1., -1., -1., -1., -1.])
    """
    mine = _environment("target", target)
    tabular = isinstance(source, Pursuit)
    theirs: Any = source if tabular else _environment("source", source)
    hunt, moves = (theirs, theirs.actions) if tabular else (theirs.task, theirs.moves)
    shares = np.stack(ComponentMapping(mine.task, hunt, renaming).lookups() or [])
    # One missing share outweighs all others, so that the sum is negative.
    shares = np.where(shares < 0, -hunt.states.size, shares)
    states = partial(_states, mine.vectors, frozen(shares))
    known: dict[str, Any] = {
        "actions": source_points(mine.moves, moves, renaming),
        "unmapped_value": unmapped_value,
        "description": describe_renaming(hunt.states.names, renaming),
    }
    if tabular:
        numbers = np.where(hunt.terminal, ENDED, np.arange(hunt.states.size))
        numbers = frozen(np.append(numbers, UNMAPPED))
        return ObservationMapping(target, source, partial(_numbers, states, numbers), **known)
    status = partial(_status, states, theirs.vectors)
    vectors = partial(_vectors, states, theirs.vectors)
    return ObservationMapping(target, source, vectors, status=status, **known)


# Functions of the module, not closures, so that mappings can be pickled.


def _states(seen: PursuitVectors, shares: IntArray, observations: Any) -> IntArray:
    """Return the source's states, `UNMAPPED` where none; shares are (1 + N, cells)."""
    each = shares[np.arange(len(shares)), seen.cells(observations)]
    return np.asarray(np.maximum(each.sum(axis=1), UNMAPPED))


def _numbers(states: Any, numbers: IntArray, observations: Any) -> IntArray:
    """Return the entries of `numbers` at the source's states; its last is `UNMAPPED`."""
    return np.asarray(numbers[states(observations)])


def _vectors(states: Any, seen: PursuitVectors, observations: Any) -> Vectors:
    """Return the source's vectors, arbitrary ones where its state is unmapped."""
    return seen.of(_cells_of(seen.pursuit, states(observations)))


def _status(states: Any, seen: PursuitVectors, observations: Any) -> IntArray:
    """Return `UNMAPPED` or `ENDED` where the source's states are, else 0."""
    found = states(observations)
    cells = _cells_of(seen.pursuit, found)
    on_the_prey = (cells[:, 1:] == cells[:, :1]).sum(axis=1)
    status = np.where(on_the_prey >= int(seen.pursuit.model.to_end), ENDED, 0)
    return np.asarray(np.where(found == UNMAPPED, UNMAPPED, status))


def _cells_of(pursuit: Pursuit, states: IntArray) -> IntArray:
    cells: Any = np.unravel_index(np.maximum(states, 0), pursuit.states.shape)
    return np.stack(cells, axis=1)


def _environment(role: str, task: Any) -> VectorPursuit:
    """Return the environment of a task, which must be a pursuit observed as vectors."""
    made = task.make().unwrapped if isinstance(task, ObservationTask) else None
    if not isinstance(made, VectorPursuit) or task.observations != made.observation_space:
        raise MappingError(
            f"a mapping of predators needs pursuits observed as vectors: the {role} is {task!r}"
        )
    return made
