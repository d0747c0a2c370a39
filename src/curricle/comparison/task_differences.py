"""Whether two tasks are the same problem, and their differences if not."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from curricle.array_types import FloatArray
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.spaces import state_name
from curricle.tasks.task import (
    GenerativeModel,
    Task,
    generative_model,
    has_tables,
    same_task,
    tables,
)

LARGEST = 5_000_000
"""Pairs (S x A) up to which tables are compared."""
CLOSE = 1e-9
"""Relative difference of moments, and difference of start probabilities, up to which they agree."""


def differences(one: Task, other: Task) -> tuple[str, ...]:
    """Return the differences of two tasks, with both values or a state; () for the same problem.

    Compared are spaces, discount, time limit, end rule, rewards, transitions and start, by the
    tables if they fit in memory, and the parameters of tasks of one type. Observation tasks are the
    same problem if the same function with the same arguments makes their environments.

    Examples
    --------
    >>> from curricle import GridWorld, Rewards
    >>> for line in differences(GridWorld("S.T"), GridWorld("S.T", rewards=Rewards(treasure=9))):
    ...     print(line)
    reward (from state 1 (row 0, column 1): 199 against 8)
    rewards (Rewards(step=-1.0, ...) against Rewards(step=-1.0, ...))
    """
    if same_task(one, other):
        return ()
    if is_observation_task(one) or is_observation_task(other):
        return tuple(_of_observation_tasks(one, other))
    mine, yours = generative_model(one), generative_model(other)
    found = list(_of_settings(mine, yours))
    alike = not found or found[0].split()[0] not in ("states", "actions")
    small = mine.states.size * mine.actions.size <= LARGEST
    looked_up = alike and small and has_tables(one) and has_tables(other)
    if looked_up:
        found += _of_tables(tables(one), tables(other))
        if not found:
            return ()  # the same problem from other parameters
    by_parameters = type(one) is type(other) and is_dataclass(one)
    if by_parameters and (not isinstance(one, FiniteMDP) or (alike and not looked_up)):
        firsts = {line.split()[0] for line in found}
        found += [line for line in _of_parameters(one, other) if line.split()[0] not in firsts]
    if not found and not by_parameters:
        found = ["rules (too large, or given by functions, to be compared)"]
    return tuple(found)


def _of_observation_tasks(one: Any, other: Any) -> Iterator[str]:
    """Yield the differences of two tasks of which at least one is an observation task."""
    if not (is_observation_task(one) and is_observation_task(other)):
        yield f"observations ({one!r} against {other!r})"
        return
    yield from _unequal(one, other, observations="", actions="", discount="", longest="time_limit")
    yield from _unequal(one, other, make="environment")


def _of_settings(one: GenerativeModel, other: GenerativeModel) -> Iterator[str]:
    for kind in ("states", "actions"):
        mine, yours = getattr(one, kind), getattr(other, kind)
        if mine != yours:
            yield f"{kind} ({mine.size:,} against {yours.size:,})"
    yield from _unequal(one, other, discount="", time_limit="")


def _unequal(one: Any, other: Any, **names: str) -> Iterator[str]:
    """Yield the attributes that differ, under the name given for each, if it is not empty."""
    for attribute, name in names.items():
        mine, yours = getattr(one, attribute), getattr(other, attribute)
        if mine != yours:
            yield f"{name or attribute} ({mine} against {yours})"


def _of_tables(one: FiniteMDP, other: FiniteMDP) -> Iterator[str]:
    """Yield each kind of difference between tables over the same spaces, with one state."""
    space = one.states
    ends = np.flatnonzero(one.terminal != other.terminal)
    if ends.size:
        yield f"end rule ({state_name(space, int(ends[0]))} ends one of them only)"
    alive = ~(one.terminal | other.terminal)
    # With a random weight for each state, two distributions over successors with the same mean
    # weight are equal with probability 1.
    weight = np.random.default_rng(0).normal(size=space.size)
    unit = max(largest_reward(one), largest_reward(other))
    names = ("reward", "transitions", "rewarded outcomes")
    for name, mine, yours in zip(
        names, moments(one, weight, unit), moments(other, weight, unit), strict=True
    ):
        apart = abs(mine - yours) > CLOSE * np.maximum(1.0, abs(mine))
        where = np.argwhere(apart & alive[:, None])
        if len(where):
            s, a = where[0]
            values = f": {mine[s, a]:g} against {yours[s, a]:g}" if name == "reward" else ""
            yield f"{name} (from {state_name(space, int(s))}{values})"
            break  # the later moments differ as a consequence
    if abs(one.start - other.start).max() > CLOSE:
        s = int(abs(one.start - other.start).argmax())
        yield f"start ({state_name(space, s)}: {one.start[s]:.3g} against {other.start[s]:.3g})"


def moments(mdp: FiniteMDP, weight: FloatArray, unit: float) -> list[FloatArray]:
    """Return E r, E w(s') and E cos(r / unit + w(s')) of each pair, (S, A).

    The last separates joint distributions of reward and successor with the same first two.
    """
    reward, weighed = _rewards(mdp), weight[mdp.next_state]
    each = (reward, weighed, np.cos(reward / unit + weighed))
    return [np.asarray((mdp.probability * x).sum(axis=1)[mdp.outcome_row]) for x in each]


def _rewards(mdp: FiniteMDP) -> FloatArray:
    """Return the rewards, 0 for outcomes that cannot occur, which may hold any number."""
    used = np.zeros((len(mdp.reward), 1), dtype=bool)
    used[mdp.outcome_row[~mdp.terminal]] = True
    return np.where(used & (mdp.probability > 0), mdp.reward, 0.0)


def largest_reward(mdp: FiniteMDP) -> float:
    """Return the largest absolute reward of an outcome that can occur; 1 where all are 0."""
    return float(abs(_rewards(mdp)).max(initial=0.0)) or 1.0


def _of_parameters(one: Any, other: Any) -> Iterator[str]:
    for part in fields(one):
        mine, yours = getattr(one, part.name), getattr(other, part.name)
        if part.compare and part.init and not _equal(mine, yours):
            arrays = isinstance(mine, np.ndarray) and isinstance(yours, np.ndarray)
            yield f"{part.name} ({'entries' if arrays else f'{mine!r} against {yours!r}'})"


def _equal(mine: Any, yours: Any) -> bool:
    """Return whether two parameters are equal, arrays inside tuples included."""
    if isinstance(mine, tuple) and isinstance(yours, tuple):
        alike = type(mine) is type(yours) and len(mine) == len(yours)
        return alike and all(map(_equal, mine, yours))
    if isinstance(mine, np.ndarray) or isinstance(yours, np.ndarray):
        return np.array_equal(mine, yours)
    return bool(mine == yours)
