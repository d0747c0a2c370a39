"""How tasks move, for compiled loops: by tables, or by compiled functions.

A *model* is a NamedTuple that a loop is handed; :func:`first_state` and :func:`transition` read it.
A domain that computes its successors adds a model of its own (``pursuit_model.py``). What only a
model that plays a live environment has to say (``live_model.py``) costs the others nothing.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.tasks.draws import first_above, uniform
from curricle.tasks.overloads import Overloaded
from curricle.tasks.spaces import frozen

FloatArray = npt.NDArray[np.float64]


def first_state(model, bits):
    """Return the state an episode starts in, uint64, drawn with 64 random bits."""


def transition(model, state, action, bits):
    """Return next state (uint64), reward and whether the episode is over; 64 random bits."""


def cut_short(model):
    """Return whether the last transition's episode was cut off there by the task itself.

    No end, like cutting off at the time limit, which loops see to.
    """


def failed(model):
    """Return whether the task broke down; its transitions then mean nothing, and loops stop."""


def aside(model):
    """Return the model to evaluate a policy in, which must not disturb the one learnt in."""


starts, moves = Overloaded(first_state), Overloaded(transition)
cuts = Overloaded(cut_short, otherwise=lambda model: False)
failures = Overloaded(failed, otherwise=lambda model: False)
asides = Overloaded(aside, otherwise=lambda model: model)


class Tables(NamedTuple):
    """The tables of a :class:`FiniteMDP`."""

    direct: bool  # whether pair (s, a) has row s * A + a, so that `outcome_row` need not be read
    outcome_row: npt.NDArray[np.integer[Any]]  # (S, A) int32
    probability: FloatArray  # (Y, O)
    cumulative: FloatArray  # (Y, O)
    next_state: npt.NDArray[np.integer[Any]]  # (Y, O) int32
    reward: FloatArray  # (Y, O)
    terminal: npt.NDArray[np.bool_]  # (S,)
    start_states: npt.NDArray[np.int64]  # (n,)
    start_cumulative: FloatArray  # (n,)


@starts.body(Tables)
def _table_start(model, bits):
    place = first_above(model.start_cumulative, uniform(bits))
    return np.uint64(model.start_states[place])


@moves.body(Tables)
def _table_step(model, state, action, bits):
    if model.direct:
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


DIRECT = 100_000
"""Outcomes (S x A x O) up to which every pair gets a row of its own: one read less a step."""


def table_model(mdp: Any) -> Tables:
    """Return the model of a :class:`FiniteMDP`."""
    rows = (mdp.outcome_row, mdp.probability, mdp.cumulative, mdp.next_state, mdp.reward)
    direct = mdp.outcome_row.size * mdp.probability.shape[1] <= DIRECT
    if direct:
        row = mdp.outcome_row.ravel()
        own = np.arange(row.size, dtype=np.int32).reshape(mdp.outcome_row.shape)
        rows = (frozen(own), *(frozen(array[row]) for array in rows[1:]))
    return Tables(direct, *rows, mdp.terminal, mdp.start_states, mdp.start_cumulative)


class Moves(NamedTuple):
    """The tables of a :class:`FiniteMDP` without chance: a pair's row is the pair."""

    n_actions: np.uint64
    next_state: npt.NDArray[np.integer[Any]]  # (S * A,) int32
    reward: FloatArray  # (S * A,)
    terminal: npt.NDArray[np.bool_]  # (S,)
    start_states: npt.NDArray[np.int64]  # (n,)
    start_cumulative: FloatArray  # (n,)


starts.body(Moves)(_table_start)


@moves.body(Moves)
def _sure_step(model, state, action, bits):
    pair = state * model.n_actions + action
    next_state = np.uint64(model.next_state[pair])
    return next_state, model.reward[pair], model.terminal[next_state]


def learning_model(mdp: Any) -> Tables | Moves:
    """Return the model that learning on a :class:`FiniteMDP` runs on."""
    tables = table_model(mdp)
    if not tables.direct or tables.next_state.shape[1] > 1:
        return tables
    return Moves(
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
    """The compiled functions of a :class:`ComputedMDP` and the data they read."""

    start: Any  # (data, bits) -> state
    step: Any  # (data, state, action, bits) -> (next state, reward, over)
    data: Any


@starts.body(Functions)
def _computed_start(model, bits):
    return np.uint64(model.start(model.data, bits))


@moves.body(Functions)
def _computed_step(model, state, action, bits):
    next_state, reward, over = model.step(model.data, state, action, bits)
    return np.uint64(next_state), np.float64(reward), bool(over)
