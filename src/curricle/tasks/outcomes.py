"""Outcome lists, the form of the tables of Gymnasium's toy-text tasks, and checks of outcomes."""

from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.checks import brief, number
from curricle.errors import TaskError

PROBABILITY_TOLERANCE = 1e-8
SINGLE_PRECISION = 1e-6
"""How far from 1 probabilities of float32 may sum; then they are divided by their sum."""
LARGEST_REWARD = 1e100
"""Rewards of every task are at most this large, so that no return overflows."""
REWARD_RULE = f"rewards must be finite, at most {LARGEST_REWARD:g} in size"


def number_of(reward: Any) -> float:
    """Return a reward, alone or in an array, as a float; NaN where it is no number."""
    try:
        given = reward.item() if isinstance(reward, np.ndarray) else reward
        return np.nan if isinstance(given, str | bytes) else float(given)
    except (TypeError, ValueError, OverflowError):
        return np.nan


def normalised(rows: FloatArray) -> FloatArray:
    """Return rows that sum to 1 within the rounding of float32 divided by their sums."""
    sums = rows.sum(axis=-1, keepdims=True)
    error = abs(sums - 1)
    rounded = (error > PROBABILITY_TOLERANCE) & (error <= SINGLE_PRECISION)
    return rows / np.where(rounded, sums, 1.0) if rounded.any() else rows


def check_numbers(task: Any, rewards: tuple[str, ...], chances: tuple[str, ...] = ()) -> None:
    """Check a frozen task's rewards and probabilities, and make them floats."""
    limits = dict.fromkeys(rewards, (-LARGEST_REWARD, LARGEST_REWARD)) | dict.fromkeys(
        chances, (0.0, 1.0)
    )
    for name, (low, high) in limits.items():
        object.__setattr__(task, name, number(name, getattr(task, name), TaskError, low, high))


def outcome_lists(outcomes: Any) -> list[list[Any]]:
    """Return the outcomes that :meth:`FiniteMDP.from_outcomes` takes as lists, [state][action]."""
    try:
        lists = [
            [list(outcomes[s][a]) for a in range(len(outcomes[s]))] for s in range(len(outcomes))
        ]
    except (TypeError, IndexError):
        raise TaskError(
            f"outcomes must be lists, outcomes[state][action]: got {brief(outcomes)}"
        ) from None
    except KeyError as missing:
        raise TaskError(
            f"states and actions of outcome dicts must be numbered from 0: {missing} is missing"
        ) from None
    if not lists or not lists[0]:
        raise TaskError(
            "outcomes need at least one state, and one action in each (without outcomes if it is "
            f"terminal): got {'no action in state 0' if lists else 'no state'}"
        )
    for s, row in enumerate(lists):
        if len(row) != len(lists[0]):
            raise TaskError(
                f"every state must list the same number of actions: state {s} lists {len(row)}, "
                f"state 0 lists {len(lists[0])}"
            )
    return lists


def outcome_tables(lists: list[list[Any]]) -> tuple[FloatArray, IntArray, FloatArray]:
    """Return probabilities, successors and rewards of outcome lists, (S, A, O) each."""
    shape = len(lists), len(lists[0]), max(1, max(len(pair) for row in lists for pair in row))
    p, successor, r = np.zeros(shape), np.zeros(shape, dtype=np.int64), np.zeros(shape)
    for s, row in enumerate(lists):
        for a, pair in enumerate(row):
            for o, outcome in enumerate(pair):
                try:
                    p[s, a, o], successor[s, a, o], r[s, a, o] = outcome[:3]
                    fits = len(outcome) in (3, 4) and outcome[1] == successor[s, a, o]
                except (TypeError, ValueError, OverflowError):
                    fits = False
                if not fits:
                    raise TaskError(
                        "an outcome must be (probability, next state, reward) and may have a "
                        f"terminated flag: state {s}, action {a} has {brief(outcome)}"
                    )
    return p, successor, r


def terminal_states(lists: list[list[Any]], first: list[int]) -> BoolArray:
    """Collect the ``terminated`` flags of outcome lists into one flag a state.

    Only states that can be reached from the `first` count: tables such as Taxi's also list
    impossible states, whose flags contradict the others.
    """
    flags: dict[int, bool] = {}
    waiting, seen = list(first), set(first)
    while waiting:
        s = waiting.pop()
        for a, pair in enumerate(lists[s]):
            for outcome in pair:
                if len(outcome) < 4:
                    raise TaskError(
                        "outcomes need a terminated flag where no terminal array is given: state "
                        f"{s}, action {a} has {outcome}"
                    )
                probability, reached, _, ended = outcome[:4]
                if probability == 0:
                    continue
                if flags.setdefault(reached, bool(ended)) != bool(ended):
                    raise TaskError(
                        "entering a state must end the episode always or never: state "
                        f"{reached} does both, the second time from state {s}, action {a}"
                    )
                if not ended and reached not in seen:
                    seen.add(reached)
                    waiting.append(reached)
    return np.array([flags.get(s, False) for s in range(len(lists))])


def check_rows(
    probability: FloatArray,
    reward: FloatArray,
    outcome_row: npt.NDArray[np.integer[Any]],
    terminal: BoolArray,
) -> None:
    """Raise TaskError naming the first pair whose outcome row breaks a rule.

    The arguments are tables of a :class:`FiniteMDP`. Rows that only terminal states use may hold
    anything.
    """
    sums = probability.sum(axis=1)
    small = (reward >= -LARGEST_REWARD) & (reward <= LARGEST_REWARD)
    rules = (
        ("transition probabilities must sum to 1", abs(sums - 1) <= PROBABILITY_TOLERANCE, sums),
        ("transition probabilities must not be negative", probability >= 0, probability),
        (REWARD_RULE, small, reward),
    )
    for rule, holds, values in rules:
        if holds.all():
            continue
        used = np.zeros(len(probability), dtype=bool)
        used[outcome_row[~terminal]] = True
        bad = np.flatnonzero(used & ~holds.reshape(len(used), -1).all(axis=1))
        if bad.size:
            state, action = np.argwhere((outcome_row == bad[0]) & ~terminal[:, None])[0]
            value = values[bad[0]]
            found = f"sums to {value:.10g}" if values is sums else f"has {value.tolist()}"
            raise TaskError(f"{rule}: state {state}, action {action} {found}")
