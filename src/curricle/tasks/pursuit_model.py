"""Pursuit as a compiled model: successors are computed, no table of them is needed."""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.tasks.draws import piece, scramble, unit
from curricle.tasks.dynamics import moves, starts


class Chase(NamedTuple):
    """The rules of a :class:`Pursuit`, as compiled loops read them."""

    landing: npt.NDArray[np.integer[Any]]  # (cells, moves) int32
    prey_cumulative: npt.NDArray[np.float64]  # (cells, moves), or (S, moves)
    shares: npt.NDArray[np.integer[Any]]  # (A, predators) int32: each one's move, the last first
    inverse: npt.NDArray[np.float64]  # (predators + 1,) cells^-i
    others: np.uint64  # joint positions of the predators: cells^predators
    to_end: np.uint64  # predators on the prey's cell that end the episode
    to_catch: np.uint64  # ... that are paid the capture reward
    step_reward: float
    capture_reward: float


@piece
def quotient(number, inverse):
    """Return number // divisor for inverse = 1 / divisor; a division takes several times longer.

    Exact below 2^50: number + 1/2 is at least half a unit away from the multiples of the divisor,
    which is more than the product is rounded by.
    """
    return np.uint64((np.float64(number) + 0.5) * inverse)


@starts.body(Chase)
def _start(model, bits):
    """Draw positions uniformly until the prey is not caught."""
    cells, n_states = np.uint64(model.landing.shape[0]), model.others * model.landing.shape[0]
    while True:
        state = np.uint64(unit(bits) * np.float64(n_states))
        prey, rest, touching = state // model.others, state, np.uint64(0)
        for _ in range(model.shares.shape[1]):
            touching += np.uint64(rest % cells == prey)
            rest //= cells
        if touching < model.to_end:
            return state
        bits = scramble(bits)


@moves.body(Chase)
def _step(model, state, action, bits):
    """Move the prey by its policy and the predators by their shares of the joint action."""
    cells, predators = np.uint64(model.landing.shape[0]), np.uint64(model.shares.shape[1])
    prey = quotient(state, model.inverse[predators])
    by_cell = model.prey_cumulative.shape[0] == model.landing.shape[0]
    row, move, chance = prey if by_cell else state, np.uint64(0), unit(bits)
    for i in range(np.uint64(model.landing.shape[1]) - np.uint64(1)):
        move += np.uint64(chance >= model.prey_cumulative[row, i])
    prey = np.uint64(model.landing[prey, move])

    # The last predator's cell varies fastest in the state's number.
    next_state, weight, touching = prey * model.others, np.uint64(1), np.uint64(0)
    number = state
    for i in range(predators):
        further = quotient(state, model.inverse[i + np.uint64(1)])
        share = np.uint64(model.shares[action, i])
        cell = np.uint64(model.landing[number - further * cells, share])
        next_state += cell * weight
        touching += np.uint64(cell == prey)
        number, weight = further, weight * cells
    reward = model.capture_reward if touching >= model.to_catch else model.step_reward
    return next_state, reward, touching >= model.to_end
