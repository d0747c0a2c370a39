"""Bisimulation of finite MDPs by partition refinement, of one task or of several jointly.

Givan, Dean, Greig 2003 refine a partition of the states until all states of a block have the same
rewards and the same chance of each block. As in MDP homomorphisms (Ravindran, Barto 2004), the
actions of every state may be relabelled: two states are equivalent if each action of the one has
an action of the other with the same expected reward and the same chance of each block, and the
other way round. Equivalent pairs then have the same Q*, and equivalent states the same V*.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, IntArray

PRECISION = 1e-9
"""Numbers no further apart than this, in units of the largest, count as equal."""


class Model(NamedTuple):
    """What refinement reads of a task."""

    outcome_row: npt.NDArray[np.integer[Any]]  # (S, A)
    probability: FloatArray  # (Y, O)
    next_state: npt.NDArray[np.integer[Any]]  # (Y, O)
    mean_reward: FloatArray  # (Y,)
    terminal: BoolArray  # (S,)


@dataclass(frozen=True, eq=False)
class Blocks:
    """The blocks of one task; equal numbers mean equivalent, also in tasks refined with it."""

    states: IntArray  # (S,) all terminal states are one block
    pairs: IntArray  # (S, A) -1 in terminal states; pairs of a block have the same Q*


def model_for_refinement(mdp: Any, mean_reward: FloatArray | None = None) -> Model:
    """Return what refinement reads of a FiniteMDP; `mean_reward`, (Y,), may replace its own."""
    own = (mdp.probability * mdp.reward).sum(axis=1) if mean_reward is None else mean_reward
    return Model(mdp.outcome_row, mdp.probability, mdp.next_state, own, mdp.terminal)


def refined(models: Sequence[Model]) -> list[Blocks]:
    """Return the coarsest blocks of several tasks whose pairs agree in reward and next block.

    The tasks must have one discount for Q* to be equal in a block.
    """
    joint = _joined(models)
    states = np.where(joint.terminal, 0, 1)
    rewards, found = levels(joint.mean_reward), len(np.unique(states))
    while True:
        rows = _row_classes(joint, rewards, states)
        pairs = np.where(joint.terminal[:, None], -1, rows[joint.outcome_row])
        states = numbered_rows(np.column_stack([states, _as_sets(pairs)]))
        blocks = int(states.max()) + 1
        if blocks == found:
            break
        found = blocks
    ends = np.cumsum([len(model.terminal) for model in models])
    return [
        Blocks(states[end - len(model.terminal) : end],
               pairs[end - len(model.terminal) : end, : model.outcome_row.shape[1]])
        for model, end in zip(models, ends, strict=True)
    ]  # fmt: skip


def levels(values: FloatArray) -> IntArray:
    """Return a number for each value, the same where values differ by rounding alone."""
    order = np.argsort(values, axis=None)
    ordered = values.ravel()[order]
    apart = np.diff(ordered) > PRECISION * max(1.0, float(abs(ordered).max(initial=0.0)))
    numbers = np.empty(values.size, np.int64)
    numbers[order] = np.concatenate([[0], np.cumsum(apart)]) if values.size else []
    return numbers.reshape(values.shape)


def numbered_rows(rows: npt.NDArray[np.integer[Any]]) -> IntArray:
    """Return a number for each row of a table, (n,) int64, the same where rows are equal."""
    table = np.ascontiguousarray(rows, dtype=np.int64)
    records = table.view(np.dtype((np.void, table.shape[1] * 8))).ravel()
    return np.unique(records, return_inverse=True)[1].reshape(-1).astype(np.int64)


def merged_outcomes(
    blocks: npt.NDArray[np.integer[Any]], probability: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return each row's blocks, in order and each once, with their chances, both (Y, O).

    Places that are not needed have block -1 and chance 0.
    """
    blocks = np.where(probability > 0, blocks, -1)
    order = np.argsort(blocks, axis=1, kind="stable")
    blocks = np.take_along_axis(blocks, order, axis=1).astype(np.int64)
    chances = np.take_along_axis(np.where(probability > 0, probability, 0.0), order, axis=1)
    first = np.ones(blocks.shape, bool)
    first[:, 1:] = blocks[:, 1:] != blocks[:, :-1]
    sums = np.add.reduceat(chances.ravel(), np.flatnonzero(first))
    totals = np.zeros(blocks.shape)
    totals[first] = sums
    kept = first & (blocks >= 0)
    order = np.argsort(~kept, axis=1, kind="stable")
    return (
        np.take_along_axis(np.where(kept, blocks, -1), order, axis=1),
        np.take_along_axis(np.where(kept, totals, 0.0), order, axis=1),
    )


def _row_classes(joint: Model, rewards: IntArray, states: IntArray) -> IntArray:
    """Return a number for each outcome row: its reward and the chance of each block."""
    blocks, chances = merged_outcomes(states[joint.next_state], joint.probability)
    return numbered_rows(np.column_stack([rewards, blocks, levels(chances)]))


def _as_sets(pairs: IntArray) -> IntArray:
    """Return the different classes of each state's pairs, in order, padded with -1."""
    ordered = np.sort(pairs, axis=1)
    ordered[:, 1:][ordered[:, 1:] == ordered[:, :-1]] = -1
    return np.sort(ordered, axis=1)


def _joined(models: Sequence[Model]) -> Model:
    """Return the tasks side by side as one; actions that a task lacks repeat its first."""
    width = max(model.probability.shape[1] for model in models)
    actions = max(model.outcome_row.shape[1] for model in models)
    first_row = np.cumsum([0, *(len(model.probability) for model in models)])
    first_state = np.cumsum([0, *(len(model.terminal) for model in models)])
    parts = []
    for model, row, state in zip(models, first_row[:-1], first_state[:-1], strict=True):
        spare = ((0, 0), (0, width - model.probability.shape[1]))
        more = np.repeat(model.outcome_row[:, :1], actions - model.outcome_row.shape[1], axis=1)
        parts.append(
            Model(
                np.concatenate([model.outcome_row, more], axis=1).astype(np.int64) + row,
                np.pad(model.probability, spare),
                np.pad(model.next_state, spare).astype(np.int64) + state,
                model.mean_reward,
                model.terminal,
            )
        )
    return Model(*(np.concatenate(column) for column in zip(*parts, strict=True)))
