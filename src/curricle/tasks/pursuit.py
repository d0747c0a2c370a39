"""Predator pursuit on a grid (paper, F4; E7): predators chase a prey; all move at once."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, IntArray, frozen
from curricle.checks import BEYOND_64_BITS, check_memory
from curricle.errors import TaskError
from curricle.tasks.domain import Discount, Domain, TimeLimit, family_of, numbered_names
from curricle.tasks.family import ComponentsByName, FamilyMember, Rule
from curricle.tasks.kernel import inverse_of, quotient, splitmix64, uniform
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.models import (
    FactoredModel,
    cumulated,
    first_state,
    joint_landing,
    predators_on_prey,
    transition,
)
from curricle.tasks.spaces import Component, Decoded, Space

MOVES = {"stay": (0, 0), "north": (-1, 0), "east": (0, 1), "south": (1, 0), "west": (0, -1)}
LARGEST_SIZE, MOST_PREDATORS = 1000, 100
"""Above these the names and moves alone, which every task has, would take gigabytes."""
LARGEST_TABLE = 500_000_000
"""State-action pairs above which a task is not turned into tables (2 GB of outcome rows)."""
LARGEST_MODEL = 2**50
"""States above which a task is not learnt: their numbers are converted to double precision."""
LARGEST_SPACE = 50_000_000
"""States above which a task is not solved by its factored model (two numbers a state: 0.8 GB)."""

Named = Literal["any", "all", "as_published"]
Capture = Annotated[Named | int, Rule(values=(*get_args(Named), *range(1, MOST_PREDATORS + 1)))]


@dataclass(frozen=True)
class Pursuit(Domain):
    """Predators and a prey on a `size` x `size` grid; a step costs 1 until the prey is caught.

    A state holds the cells of the prey and of each predator, which may share a cell. An action is a
    move for each predator; the prey's moves are equally likely. Episodes start uniformly in the
    states without a caught prey.

    Parameters
    ----------
    size, predators : int
        Cells per side, 2 to 1000, and how many chase the prey, 1 to 100; together they make fewer
        than 2^63 states, size^(2 + 2 predators).
    moves : {4, 5}
        North, east, south, west; 5 adds staying.
    torus : bool
        Whether the grid wraps round; otherwise a move beyond its edge is staying.
    capture : {"all", "any", "as_published"} or int
        How many predators on the prey's cell end the episode with the capture reward. By
        "as_published" the first predator ends it, but only all of them earn the reward.
    step_reward, capture_reward : float
        Rewards of a step that does not / does catch the prey.
    discount, time_limit
        As in :class:`FiniteMDP`.

    Examples
    --------
    >>> hunt = Pursuit(size=4, predators=2)
    >>> hunt.states.names, hunt.states.size, hunt.actions.size
    (('prey', 'predator_1', 'predator_2'), 4096, 25)
    """

    size: Annotated[int, Rule(2, LARGEST_SIZE, "larger")] = 4
    predators: Annotated[int, Rule(1, MOST_PREDATORS, "larger")] = 2
    moves: Literal[4, 5] = 5
    torus: bool = False
    capture: Capture = "all"
    step_reward: float = -1.0
    capture_reward: float = 0.0
    discount: Discount = 0.99
    time_limit: TimeLimit = 200

    def _check(self) -> None:
        states = self.cells ** (1 + self.predators)
        if states >= BEYOND_64_BITS:
            raise TaskError(
                "a pursuit must have fewer than 2^63 states, size^(2 + 2 predators): size "
                f"{self.size} and {self.predators} predators make 2^{math.log2(states):.1f}"
            )
        capture: Any = self.capture
        number = isinstance(capture, int) and capture is not True and 1 <= capture <= self.predators
        if not number and not (isinstance(capture, str) and capture in get_args(Named)):
            raise TaskError(
                "capture must be 'all', 'any', 'as_published' or a number of predators from 1 to "
                f"{self.predators}: got {capture!r}"
            )

    @property
    def cells(self) -> int:
        """The number of cells."""
        return self.size**2

    @cached_property
    def predator_names(self) -> tuple[str, ...]:
        """``predator`` if there is one, else ``predator_1``, ``predator_2``, ..."""
        return numbered_names("predator", self.predators)

    @cached_property
    def states(self) -> Space:
        """The cells of the prey and of each predator, size^(2 + 2 predators) points."""
        labels = tuple(f"({i // self.size},{i % self.size})" for i in range(self.cells))
        names = ("prey", *self.predator_names)
        return Space([Component(name, self.cells, labels=labels) for name in names])

    @cached_property
    def actions(self) -> Space:
        """One move for each predator, moves^predators points."""
        labels = tuple(MOVES)[-self.moves :]
        return Space([Component(n, self.moves, labels=labels) for n in self.predator_names])

    @cached_property
    def landing(self) -> IntArray:
        """The cell that each move leads to from each cell, (cells, moves) int64."""
        sides = self.size, self.size
        row, column = np.unravel_index(np.arange(self.cells), sides)
        down, right = np.array(list(MOVES.values())[-self.moves :]).T
        to = row[:, None] + down, column[:, None] + right
        return frozen(np.ravel_multi_index(to, sides, mode="wrap" if self.torus else "clip"))

    @cached_property
    def model(self) -> "PursuitModel":
        """The generative model for compiled loops; learning needs no tables."""
        if self.states.size > LARGEST_MODEL or self.states.size * self.cells >= 2**64:
            raise TaskError(
                "a pursuit to be learnt may have at most 2^50 states, and 2^64 / cells: this one "
                f"has {self.states.size:,}"
            )
        joint = self.actions.decode()
        single = np.stack([joint[name] for name in reversed(self.predator_names)], axis=1)
        return PursuitModel(
            (None,) * self.predators,
            np.uint64(self.cells),
            inverse_of(self.cells, self.states.size),
            padded_moves(self.landing.astype(np.int32), 0),
            padded_moves(cumulated(np.full((1, self.moves), 1 / self.moves)), 1.0),
            frozen(single.astype(np.int32).ravel()),
            np.uint64(self.cells**self.predators),
            np.uint64(self._needed[0]),
            np.uint64(self._needed[1]),
            float(self.step_reward),
            float(self.capture_reward),
        )

    @cached_property
    def terminal(self) -> BoolArray:
        """States in which the episode has ended, (S,) bool; TaskError if they are too many."""
        check_memory("a flag for each state of a pursuit", 3 * self.states.size, TaskError)
        return frozen(self._ends[predators_on_prey(self.cells, self.predators)])

    @cached_property
    def factored_model(self) -> FactoredModel | None:
        """The rules without tables, for exact planning; None if too large."""
        if self.states.size > LARGEST_SPACE:
            return None
        return FactoredModel(
            landing=frozen(self.landing.astype(np.int32)),
            prey_policy=frozen(np.full((self.cells, self.moves), 1 / self.moves)),
            predators=self.predators,
            rewards=frozen(self._rewards),
            ends=frozen(self._ends),
            discount=self.discount,
        )

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The task as tables: an outcome row is (prey before, predators after), O = prey moves."""
        n_states, n_actions = self.states.size, self.actions.size
        if n_states * n_actions > LARGEST_TABLE:
            raise TaskError(
                f"a task's tables may hold at most {LARGEST_TABLE:,} state-action pairs: this "
                f"pursuit has {n_states:,} states x {n_actions} actions"
            )
        positions = np.int32(self.cells**self.predators)
        landing = self.landing.astype(np.int32)
        # States are (prey, predators): `positions` of them for each cell of the prey.
        base = np.arange(self.cells, dtype=np.int32) * positions
        outcome_row = base[:, None, None] + joint_landing(landing, self.predators)
        next_state = base[landing][:, None, :] + np.arange(positions, dtype=np.int32)[:, None]
        outcome_row = outcome_row.reshape(n_states, n_actions)
        next_state = next_state.reshape(n_states, self.moves)
        rewards = self._rewards[predators_on_prey(self.cells, self.predators)]
        return self._tables(
            frozen(np.full(next_state.shape, 1 / self.moves)),
            frozen(next_state),
            frozen(rewards[next_state]),
            terminal=self.terminal,
            starting=np.flatnonzero(~self.terminal),
            outcome_row=frozen(outcome_row),
        )

    @property
    def _needed(self) -> tuple[int, int]:
        """How many predators on the prey's cell end the episode, and earn the capture reward."""
        count = self.predators if self.capture == "all" else 1
        ends = self.capture if isinstance(self.capture, int) else count
        return ends, self.predators if self.capture == "as_published" else ends

    @property
    def _ends(self) -> BoolArray:
        """Whether the episode ends with 0, 1, ... predators on the prey's cell, (k + 1,)."""
        return np.arange(self.predators + 1) >= self._needed[0]

    @property
    def _rewards(self) -> FloatArray:
        """The reward of a step after which 0, 1, ... predators are on the prey's cell, (k + 1,)."""
        caught = np.arange(self.predators + 1) >= self._needed[1]
        return np.where(caught, float(self.capture_reward), float(self.step_reward))


# -- sampling, compiled ----------------------------------------------------------------------------

MOVE_ENTRIES = 5
"""Entries for moves in each row of a table, used or not: a constant avoids a multiplication."""


class PursuitModel(NamedTuple):
    """The rules of a :class:`Pursuit` for compiled loops."""

    predators: tuple[None, ...]  # as many as there are predators
    cells: np.uint64
    inverse: np.uint64  # 2^64 / cells
    landing: npt.NDArray[np.int32]  # (cells * MOVE_ENTRIES,)
    prey_cumulative: FloatArray  # (MOVE_ENTRIES,) probabilities of the prey's moves
    single_moves: npt.NDArray[np.int32]  # (A * predators,) of each joint action, last one first
    positions: np.uint64  # joint positions of the predators: cells^predators
    to_end: np.uint64  # predators on the prey's cell that end the episode
    to_catch: np.uint64  # ... that earn the capture reward
    step_reward: float
    capture_reward: float


def padded_moves(table: npt.NDArray[Any], filling: float) -> npt.NDArray[Any]:
    """Return a table of moves, (rows, moves), padded to :data:`MOVE_ENTRIES` moves, flat."""
    padding = ((0, 0), (0, MOVE_ENTRIES - table.shape[1]))
    return frozen(np.pad(table, padding, constant_values=filling).ravel())


@first_state.body(PursuitModel)
def _start(model, bits):
    """Draw positions uniformly until the prey is not caught."""
    n_states = model.positions * model.cells
    while True:
        state = np.uint64(uniform(bits) * np.float64(n_states))
        prey, rest, together = state // model.positions, state, np.uint64(0)
        for _ in range(len(model.predators)):
            together += np.uint64(rest % model.cells == prey)
            rest //= model.cells
        if together < model.to_end:
            return state
        bits = splitmix64(bits)


@transition.body(PursuitModel)
def _step(model, state, action, bits):
    """Move the prey at random and the predators by the joint action."""
    cells, predators = model.cells, np.uint64(len(model.predators))
    prey = state
    for _ in range(predators):  # the last predator's cell varies fastest in a state's number
        prey = quotient(prey, model.inverse)
    chance, move = uniform(bits), np.uint64(0)
    for i in range(np.uint64(MOVE_ENTRIES - 1)):
        move += np.uint64(chance >= model.prey_cumulative[i])
    prey = np.uint64(model.landing[prey * np.uint64(MOVE_ENTRIES) + move])

    next_state, weight, together = prey * model.positions, np.uint64(1), np.uint64(0)
    for i in range(predators):
        rest = quotient(state, model.inverse)
        move = np.uint64(model.single_moves[action * predators + i])
        cell = np.uint64(model.landing[(state - rest * cells) * np.uint64(MOVE_ENTRIES) + move])
        next_state += cell * weight
        together += np.uint64(cell == prey)
        state, weight = rest, weight * cells
    reward = model.capture_reward if together >= model.to_catch else model.step_reward
    return next_state, reward, together >= model.to_end


# -- the family ------------------------------------------------------------------------------------


def _pursuit_mappings(target: FamilyMember, source: FamilyMember) -> list[Any]:
    """Return how a pursuit reads a smaller one, or one with fewer predators."""
    if source["predators"] > target["predators"]:
        raise TaskError(
            f"a pursuit reads pursuits with at most its {target['predators']} predators: got "
            f"{source}"
        )
    groups = predator_groups(target.task, source.task)
    if target["size"] == source["size"]:
        return [ComponentsByName(renaming=group) for group in groups]
    return [_on_another_size(target, source, group) for group in groups]


def predator_groups(target: Pursuit, source: Pursuit) -> list[dict[str, str]]:
    """Return the groups of a target's predators that stand for a source's, by the source's names.

    Each predator and those after it, in a circle (paper E7: f_1 and f_2 of two from one).
    """
    names, source_names = target.predator_names, source.predator_names
    return [
        {name: names[(first + i) % len(names)] for i, name in enumerate(source_names)}
        for first in range(len(names) if len(names) > len(source_names) else 1)
    ]


def _on_another_size(
    target: FamilyMember, source: FamilyMember, group: dict[str, str]
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
        moves = {name: actions[predator] - five + other_five for name, predator in group.items()}
        return dict(zip(["prey", *group], read, strict=True)), moves

    return function


def _window(axis: IntArray, size: int, smaller: int, torus: bool) -> IntArray:
    """Return coordinates in a walled grid of another size, (bodies, ...) as given."""
    # Distances stay the same where they fit, else become the largest that do: a window of the
    # source's size is laid over all, the nearer to an edge the nearer they are to it.
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
    needed, predators = parameters["capture"], parameters["predators"]
    if isinstance(needed, int) and needed > predators:
        return f"capture of pursuit must be at most the number of predators, {predators}"
    return None


pursuit_family = family_of(Pursuit, mapping=_pursuit_mappings, constraint=_enough_predators)
"""Pursuits (:class:`Pursuit`).

A member reads one with fewer predators by each group of predators that stands for the source's, and
a smaller one by the distances between prey and predators.
"""
