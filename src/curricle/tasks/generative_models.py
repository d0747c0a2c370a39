"""Generative models: what compiled loops sample a task from.

A *generative model* is a NamedTuple; :func:`first_state` and :func:`transition` sample from it.
Here are those of tasks with tables and of tasks given by functions; ``pursuit.py`` adds that of
a domain that computes its successors, ``live.py`` that of an environment.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import types
from numba.extending import overload

from curricle.arrays import BoolArray, FloatArray, IntArray, frozen
from curricle.tasks.draws import first_above, uniform
from curricle.tasks.outcomes import LARGEST_REWARD
from curricle.tasks.overloads import INLINED, Overloaded


def first_state(model, bits):
    """Return the state an episode starts in, uint64, drawn with 64 random bits."""


def transition(model, state, action, bits):
    """Return next state (uint64), reward and whether the episode terminated; 64 random bits."""


def truncated(model):
    """Return whether the task itself truncated the episode at the last transition.

    Loops apply the time limit; only live environments have limits of their own.
    """


def has_failed(model):
    """Return whether the task has failed; its transitions are then invalid, and loops stop."""


def evaluation_model(model):
    """Return the model to evaluate a policy in, which leaves the one learnt in unchanged."""


first_states, transitions = Overloaded(first_state), Overloaded(transition)
truncations = Overloaded(truncated, otherwise=lambda model: False)
failures = Overloaded(has_failed, otherwise=lambda model: False)
evaluation_models = Overloaded(evaluation_model, otherwise=lambda model: model)


class Tables(NamedTuple):
    """The tables of a :class:`FiniteMDP`."""

    row_per_pair: bool  # pair (s, a) has row s * A + a, so that `outcome_row` need not be read
    outcome_row: npt.NDArray[np.integer[Any]]  # (S, A) int32
    probability: FloatArray  # (Y, O)
    cumulative: FloatArray  # (Y, O)
    next_state: npt.NDArray[np.integer[Any]]  # (Y, O) int32
    reward: FloatArray  # (Y, O)
    terminal: BoolArray  # (S,)
    start_states: IntArray  # (n,)
    start_cumulative: FloatArray  # (n,)


@first_states.body(Tables)
def _table_start(model, bits):
    index = first_above(model.start_cumulative, uniform(bits))
    return np.uint64(model.start_states[index])


@transitions.body(Tables)
def _table_step(model, state, action, bits):
    if model.row_per_pair:
        row = state * np.uint64(model.outcome_row.shape[1]) + action
    else:
        row = np.uint64(model.outcome_row[state, action])
    outcome, last = np.uint64(0), np.uint64(model.cumulative.shape[1] - 1)
    if last > np.uint64(0):
        chance = uniform(bits)
        for i in range(last):  # to the end: leaving early would be mispredicted half the time
            outcome += np.uint64(chance >= model.cumulative[row, i])
    next_state = np.uint64(model.next_state[row, outcome])
    return next_state, model.reward[row, outcome], model.terminal[next_state]


LARGEST_WITH_ROW_PER_PAIR = 100_000
"""Outcomes (S x A x O) up to which every pair gets a row of its own: one read less a step."""


def table_model(mdp: Any) -> Tables:
    """Return the tables of a :class:`FiniteMDP` as a generative model."""
    rows = (mdp.outcome_row, mdp.probability, mdp.cumulative, mdp.next_state, mdp.reward)
    row_per_pair = mdp.outcome_row.size * mdp.probability.shape[1] <= LARGEST_WITH_ROW_PER_PAIR
    if row_per_pair:
        row = mdp.outcome_row.ravel()
        own = np.arange(row.size, dtype=np.int32).reshape(mdp.outcome_row.shape)
        rows = (frozen(own), *(frozen(array[row]) for array in rows[1:]))
    return Tables(row_per_pair, *rows, mdp.terminal, mdp.start_states, mdp.start_cumulative)


class DeterministicTables(NamedTuple):
    """The tables of a :class:`FiniteMDP` with one outcome a pair, which has a row of its own."""

    n_actions: np.uint64
    next_state: npt.NDArray[np.integer[Any]]  # (S * A,) int32
    reward: FloatArray  # (S * A,)
    terminal: BoolArray  # (S,)
    start_states: IntArray  # (n,)
    start_cumulative: FloatArray  # (n,)


first_states.body(DeterministicTables)(_table_start)


@transitions.body(DeterministicTables)
def _deterministic_step(model, state, action, bits):
    pair = state * model.n_actions + action
    next_state = np.uint64(model.next_state[pair])
    return next_state, model.reward[pair], model.terminal[next_state]


def learning_model(mdp: Any) -> Tables | DeterministicTables:
    """Return the generative model of a :class:`FiniteMDP` for learning: the fastest that fits."""
    tables = table_model(mdp)
    if not tables.row_per_pair or tables.next_state.shape[1] > 1:
        return tables
    return DeterministicTables(
        np.uint64(mdp.actions.size),
        frozen(tables.next_state.ravel()),
        frozen(tables.reward.ravel()),
        *tables[-3:],
    )


def cumulated(probability: FloatArray) -> FloatArray:
    """Return cumulative probabilities along each row; the last possible outcome gets 1."""
    total = np.cumsum(probability, axis=1)
    remaining = np.cumsum(probability[:, ::-1], axis=1)[:, ::-1]
    after = np.concatenate([remaining[:, 1:], np.zeros((len(remaining), 1))], axis=1)
    return frozen(np.where(after == 0, 1.0, total))


class Functions(NamedTuple):
    """The compiled functions of a :class:`ComputedMDP`, the data they read, their first mistake.

    What they return is checked at every step: a state that does not exist would be a place outside
    of every table. From the first mistake on, episodes end at once.
    """

    start: Any  # (data, bits) -> state
    step: Any  # (data, state, action, bits) -> (next state, reward, terminated)
    data: Any
    n_states: np.uint64
    failure: npt.NDArray[np.void]  # (1,) of FAILURE


FAILURE = np.dtype(
    [("by", "u8"), ("state", "u8"), ("action", "u8"), ("next_state", "f8"), ("reward", "f8")]
)
"""A mistake of a user's function: in which, the pair it was asked for, what it returned."""
START, STEP = 1, 2
"""The function that made it; 0 is none."""


def state_number(found, n_states):
    """Return what a user's function returned for a state as uint64; `n_states` if it is none."""


def _number_of_integer(found, n_states):
    return min(np.uint64(found), n_states)  # a negative number becomes a large one


def _number_of_float(found, n_states):
    if not 0.0 <= found < np.float64(n_states):  # NaN, too
        return n_states
    number = np.uint64(found)
    return number if np.float64(number) == found else n_states


@overload(state_number, jit_options=INLINED)
def _state_number(found, n_states):
    return _number_of_float if isinstance(found, types.Float) else _number_of_integer


@first_states.body(Functions)
def _computed_start(model, bits):
    found = model.start(model.data, bits)
    state = state_number(found, model.n_states)
    if state >= model.n_states:
        if model.failure[0].by == 0:
            model.failure[0].by = START
            model.failure[0].next_state = np.float64(found)
        return np.uint64(0)
    return state


@transitions.body(Functions)
def _computed_step(model, state, action, bits):
    found, reward, terminated = model.step(model.data, state, action, bits)
    next_state = state_number(found, model.n_states)
    if next_state >= model.n_states or not abs(np.float64(reward)) <= LARGEST_REWARD:
        if model.failure[0].by == 0:
            model.failure[0].by = STEP
            model.failure[0].state, model.failure[0].action = state, action
            model.failure[0].next_state = np.float64(found)
            model.failure[0].reward = np.float64(reward)
        return np.uint64(0), 0.0, True
    return next_state, np.float64(reward), bool(terminated)


@failures.body(Functions)
def _computed_failure(model):
    return model.failure[0].by != 0
