"""The generative model of a pursuit: successors are computed, without tables."""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.array_types import FloatArray
from curricle.frozen_arrays import frozen
from curricle.tasks.draws import splitmix64, uniform
from curricle.tasks.generative_models import first_states, transitions
from curricle.tasks.simd import quotient

MOVES = 5
"""Entries for moves in each row of a table, used or not: a constant avoids a multiplication."""


class PursuitModel(NamedTuple):
    """The rules of a :class:`Pursuit` for compiled loops.

    The number of predators is a type, so that loops over them are unrolled.
    """

    predators: tuple[None, ...]  # as many as there are predators
    cells: np.uint64
    inverse: np.uint64  # 2^64 / cells
    landing: npt.NDArray[np.int32]  # (cells * MOVES,)
    prey_cumulative: FloatArray  # (rows * MOVES,) probabilities of the prey's moves
    single_moves: npt.NDArray[np.int32]  # (A * predators,) of each joint action, last one first
    positions: np.uint64  # joint positions of the predators: cells^predators
    to_end: np.uint64  # predators on the prey's cell that end the episode
    to_catch: np.uint64  # ... that earn the capture reward
    step_reward: float
    capture_reward: float


def padded_moves(table: npt.NDArray[Any], filling: float) -> npt.NDArray[Any]:
    """Return a table of moves, (rows, moves), padded to :data:`MOVES` moves, flat."""
    padding = ((0, 0), (0, MOVES - table.shape[1]))
    return frozen(np.pad(table, padding, constant_values=filling).ravel())


@first_states.body(PursuitModel)
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


@transitions.body(PursuitModel)
def _step(model, state, action, bits):
    """Move the prey by its policy and the predators by the joint action."""
    cells, predators = model.cells, np.uint64(len(model.predators))
    prey = state
    for _ in range(predators):  # the last predator's cell varies fastest in a state's number
        prey = quotient(prey, model.inverse)
    rows, chance = np.uint64(model.prey_cumulative.shape[0]), uniform(bits)
    row = np.uint64(0)
    if rows > np.uint64(MOVES):
        row = prey if rows == cells * np.uint64(MOVES) else state
    move = np.uint64(0)
    for i in range(np.uint64(MOVES - 1)):
        move += np.uint64(chance >= model.prey_cumulative[row * np.uint64(MOVES) + i])
    prey = np.uint64(model.landing[prey * np.uint64(MOVES) + move])

    next_state, weight, together = prey * model.positions, np.uint64(1), np.uint64(0)
    for i in range(predators):
        rest = quotient(state, model.inverse)
        move = np.uint64(model.single_moves[action * predators + i])
        cell = np.uint64(model.landing[(state - rest * cells) * np.uint64(MOVES) + move])
        next_state += cell * weight
        together += np.uint64(cell == prey)
        state, weight = rest, weight * cells
    reward = model.capture_reward if together >= model.to_catch else model.step_reward
    return next_state, reward, together >= model.to_end
