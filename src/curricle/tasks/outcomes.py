"""Outcome lists, the form of the tables of Gymnasium's toy-text tasks, and checks of outcomes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.errors import TaskError

FloatArray = npt.NDArray[np.float64]
PROBABILITY_TOLERANCE = 1e-8


def outcome_tables(
    outcomes: Any, terminal: npt.ArrayLike | None, start: npt.ArrayLike
) -> tuple[FloatArray, npt.NDArray[np.int64], FloatArray, npt.NDArray[np.bool_]]:
    """Return probabilities, successors and rewards, (S, A, O) each, and terminal flags, (S,).

    The arguments are those of :meth:`FiniteMDP.from_outcomes`; without `terminal`, the flags are
    collected from the outcomes.
    """
    n_states = len(outcomes)
    n_actions = len(outcomes[0]) if n_states and _has_first(outcomes) else 0
    if not n_actions:
        raise TaskError(
            "outcomes need states from 0, each with at least one action (without outcomes if it is "
            f"terminal): got {n_states} states, and state 0 "
            + ("lists no action" if n_states and _has_first(outcomes) else "is none of them")
        )
    try:
        for s in range(n_states):
            if len(outcomes[s]) != n_actions:
                raise TaskError(
                    f"every state must list the same number of actions: state {s} lists "
                    f"{len(outcomes[s])}, state 0 lists {n_actions}"
                )
        lists = [[outcomes[s][a] for a in range(n_actions)] for s in range(n_states)]
    except KeyError as missing:
        raise TaskError(
            f"outcome dicts need the keys 0..{n_states - 1} and 0..{n_actions - 1}: {missing} is "
            "missing"
        ) from None
    shape = (n_states, n_actions, max(1, max(len(pair) for row in lists for pair in row)))
    p, successor, r = np.zeros(shape), np.zeros(shape, dtype=np.int64), np.zeros(shape)
    for s, row in enumerate(lists):
        for a, pair in enumerate(row):
            for o, outcome in enumerate(pair):
                if len(outcome) not in (3, 4) or outcome[1] != int(outcome[1]):
                    raise TaskError(
                        "an outcome must be (probability, next state, reward) and may have a "
                        f"terminated flag: state {s}, action {a} has {outcome}"
                    )
                p[s, a, o], successor[s, a, o], r[s, a, o] = outcome[:3]
    if terminal is not None:
        return p, successor, r, np.asarray(terminal)
    first = [int(np.asarray(start))] if np.ndim(start) == 0 else np.flatnonzero(start).tolist()
    return p, successor, r, _terminal_states(lists, first)


def _has_first(outcomes: Any) -> bool:
    return not isinstance(outcomes, dict) or 0 in outcomes


def _terminal_states(lists: Sequence[Any], first: list[int]) -> npt.NDArray[np.bool_]:
    """Collect the ``terminated`` flags of outcome lists into one flag a state.

    Only reachable states count: tables such as Taxi's also list impossible states, whose flags
    contradict the others.
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
    terminal: npt.NDArray[np.bool_],
) -> None:
    """Raise TaskError naming the first pair whose outcome row breaks a rule.

    The arguments are tables of a :class:`FiniteMDP`. Rows that only terminal states use may hold
    anything.
    """
    sums = probability.sum(axis=1)
    rules = (
        ("transition probabilities must sum to 1", abs(sums - 1) <= PROBABILITY_TOLERANCE),
        ("transition probabilities must not be negative", probability >= 0),
        ("rewards must be finite", np.isfinite(reward)),
    )
    for rule, holds in rules:
        if holds.all():
            continue
        used = np.zeros(len(probability), dtype=bool)
        used[outcome_row[~terminal]] = True
        bad = np.flatnonzero(used & ~holds.reshape(len(used), -1).all(axis=1))
        if bad.size:
            owner = (outcome_row == bad[0]) & ~terminal[:, None]
            state, action = np.argwhere(owner)[0]
            if "sum" in rule:
                value = f"sums to {sums[bad[0]]:.10g}"
            else:
                table = reward if "reward" in rule else probability
                value = f"has {table[bad[0]].tolist()}"
            raise TaskError(f"{rule}: state {state}, action {action} {value}")
