"""Bisimulation of finite MDPs, by partition refinement.

A partition of the states is refined until all states of a block have the same rewards and the same
chance of each block (Givan, Dean, Greig 2003). As in MDP homomorphisms (Ravindran, Barto 2004), the
actions of a state may be relabelled: every action of a state has a counterpart in each equivalent
state, with the same expected reward and chance of each block. Equivalent pairs then have the same
Q*, even in different tasks that are refined jointly.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.errors import MappingError
from curricle.tasks.mdp import FiniteMDP
from curricle.transfer.mapping import UNMAPPED
from curricle.transfer.pair import Proposal, TaskPair, apart

# -- partition refinement --------------------------------------------------------------------------

PRECISION = 1e-9  # largest difference of equal numbers, in units of the largest


class Model(NamedTuple):
    """The tables of a task that refinement reads."""

    outcome_row: npt.NDArray[np.integer[Any]]  # (S, A)
    probability: FloatArray  # (Y, O)
    next_state: npt.NDArray[np.integer[Any]]  # (Y, O)
    mean_reward: FloatArray  # (Y,)
    terminal: BoolArray  # (S,)


class Blocks(NamedTuple):
    """The blocks of a task; in tasks refined jointly, equal numbers mean equivalence."""

    states: IntArray  # (S,) the block of each state; all terminal states have one block
    pairs: IntArray  # (S, A) the block of each pair, -1 in terminal states; its pairs have one Q*


def model_for_refinement(mdp: FiniteMDP, mean_reward: FloatArray | None = None) -> Model:
    """Return the Model of a FiniteMDP; `mean_reward`, (Y,), may replace the MDP's."""
    rewards = _mean_rewards(mdp) if mean_reward is None else mean_reward
    return Model(mdp.outcome_row, mdp.probability, mdp.next_state, rewards, mdp.terminal)


def _mean_rewards(mdp: FiniteMDP) -> FloatArray:
    """Return the mean reward of each outcome row, (Y,), 0 where rewards cancel up to rounding."""
    terms = mdp.probability * mdp.reward
    means = terms.sum(axis=1)
    return np.where(abs(means) > PRECISION * abs(terms).sum(axis=1), means, 0.0)


def joint_models(tasks: TaskPair) -> tuple[Model, Model]:
    """Return the models of a target and a source, both with the target's discount."""
    # The source's V* also solves V = max_a r' + gamma_t P V with r' = r + (gamma_s - gamma_t) P V.
    target, source = tasks.target_mdp, tasks.source_mdp
    rewards = _mean_rewards(source)
    if target.discount != source.discount:
        values = tasks.source_solution.values[source.next_state]
        after = (source.probability * values).sum(axis=1)
        rewards = rewards + (source.discount - target.discount) * after
    return model_for_refinement(target), model_for_refinement(source, rewards)


def refined(models: Sequence[Model]) -> list[Blocks]:
    """Return the coarsest blocks, equal in rewards and next blocks, of tasks with one discount."""
    joint = _joined(models)
    states = np.where(joint.terminal, 0, 1)
    largest = float(abs(joint.mean_reward).max(initial=0.0))
    rewards, before = levels(joint.mean_reward, PRECISION * largest), len(np.unique(states))
    while True:
        # Rows are alike if their rewards and the chances of each block are equal; states if their
        # sets of rows are equal.
        entered, chances = merged_outcomes(states[joint.next_state], joint.probability)
        rows = numbered_rows(np.column_stack([rewards, entered, levels(chances, PRECISION)]))
        pairs = np.where(joint.terminal[:, None], -1, rows[joint.outcome_row])
        ordered = np.sort(pairs, axis=1)
        ordered[:, 1:][ordered[:, 1:] == ordered[:, :-1]] = -1
        states = numbered_rows(np.column_stack([states, np.sort(ordered, axis=1)]))
        blocks = int(states.max()) + 1
        if blocks == before:
            break
        before = blocks
    ends = np.cumsum([len(model.terminal) for model in models])
    return [
        Blocks(states[end - len(model.terminal) : end],
               pairs[end - len(model.terminal) : end, : model.outcome_row.shape[1]])
        for model, end in zip(models, ends, strict=True)
    ]  # fmt: skip


def levels(values: FloatArray, gap: float) -> IntArray:
    """Return a number for each value, equal unless a wider gap lies between two values."""
    order = np.argsort(values, axis=None)
    ordered = values.ravel()[order]
    apart = np.diff(ordered) > gap
    numbers = np.empty(values.size, np.int64)
    numbers[order] = np.concatenate([[0], np.cumsum(apart)]) if values.size else []
    return numbers.reshape(values.shape)


def numbered_rows(rows: npt.NDArray[np.integer[Any]]) -> IntArray:
    """Return a number for each row of a table, (n,) int64, equal for equal rows."""
    table = np.ascontiguousarray(rows, dtype=np.int64)
    records = table.view(np.dtype((np.void, table.shape[1] * 8))).ravel()
    return np.unique(records, return_inverse=True)[1].reshape(-1).astype(np.int64)


def merged_outcomes(
    blocks: npt.NDArray[np.integer[Any]], probability: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return the different next blocks of each row in order, and their chances, both (Y, O)."""
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


def _joined(models: Sequence[Model]) -> Model:
    """Return one model of all tasks; actions that a task lacks are copies of its first action."""
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


LARGEST_REFINED = 20_000_000  # state-action pairs of both tasks up to which they are refined


def by_homomorphism(tasks: TaskPair) -> Iterator[Proposal]:
    """Yield the mapping of target pairs to equivalent source pairs, if there are any.

    Equivalent pairs have the same Q*, up to rounding. A target state reads the first equivalent
    source state. If no source state is equivalent, its pairs read the first source pair with the
    same reward and equivalent next states.

    Raises
    ------
    MappingError
        When no pair has an equivalent, or the tasks have more than 20 million pairs.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> maze = GridWorld(["S.P", "..T"])
    >>> tasks = TaskPair(maze, GridWorld(["T..", "P.S"]))  # turned by 180 degrees
    >>> next(by_homomorphism(tasks)).how
    'exact homomorphism: 100% of pairs have a source pair of the same Q*'
    """
    sizes = [mdp.outcome_row.size for mdp in (tasks.target_mdp, tasks.source_mdp)]
    if sum(sizes) > LARGEST_REFINED:
        raise MappingError(
            f"tasks are refined together up to {LARGEST_REFINED:,} pairs: these have {sum(sizes):,}"
        )
    target, source = refined(joint_models(tasks))
    index = equivalent_pairs(target, source)
    solutions = tasks.own_solutions or (tasks.target_solution, tasks.source_solution)
    error = 2 * sum(solution.error_bound for solution in solutions)
    index = np.where(apart(index, *solutions) <= error, index, UNMAPPED)
    live = ~tasks.target_mdp.terminal
    share = float((index[live] >= 0).mean())
    if share == 0:
        raise MappingError("no pair of the target is equivalent to a pair of the source")
    how = f"exact homomorphism: {int(100 * share)}% of pairs have a source pair of the same Q*"
    yield tasks.proposal(index, how)


def equivalent_pairs(target: Blocks, source: Blocks) -> IntArray:
    """Return for each target pair an equivalent source pair, or `UNMAPPED`, (S, A) int64."""
    most = int(max(target.pairs.max(), source.pairs.max())) + 2

    def keys(blocks: Blocks) -> IntArray:
        key = blocks.states[:, None] * most + blocks.pairs
        return np.where(blocks.pairs < 0, -1, key).ravel()

    index = _first_of(keys(source), keys(target))
    elsewhere = _first_of(source.pairs.ravel(), target.pairs.ravel())
    index = np.where(index == UNMAPPED, elsewhere, index)
    return np.where(target.pairs.ravel() < 0, UNMAPPED, index).reshape(target.pairs.shape)


def _first_of(keys: IntArray, wanted: IntArray) -> IntArray:
    """Return the first index of each wanted key; `UNMAPPED` if it is missing or negative."""
    different, first = np.unique(keys, return_index=True)
    place = np.minimum(np.searchsorted(different, wanted), len(different) - 1)
    present = (different[place] == wanted) & (wanted >= 0)
    return np.where(present, first[place], UNMAPPED).astype(np.int64)
