"""The differences of two tasks (none if they are the same problem), and tasks as plain data.

The plain data of two targets are enough to tell whether two stored studies have the same target.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np

from curricle.arrays import FloatArray
from curricle.files import short_digest
from curricle.tasks.mdp import (
    FiniteMDP,
    Task,
    generative_model,
    has_tables,
    live_pairs,
    same_task,
    tables,
)
from curricle.tasks.observation_task import is_observation_task, plain_text
from curricle.tasks.spaces import state_name

LARGEST = 5_000_000  # pairs (S x A) up to which tables are compared
CLOSE = 1e-9  # difference of start probabilities, relative difference of moments, still equal


def differences(task: Task, other: Task) -> tuple[str, ...]:
    """Return the differences of two tasks, with the two values or a state; () for the same problem.

    It compares spaces, discount, time limit, end rule, rewards, transitions and start, by tables
    where these fit in memory, and the parameters of tasks of one type. Observation tasks are the
    same problem if the same function with the same arguments makes their environments.

    Examples
    --------
    >>> from curricle import GridWorld, Rewards
    >>> for line in differences(GridWorld("S.T"), GridWorld("S.T", rewards=Rewards(treasure=9))):
    ...     print(line)
    reward (from state 1 (row 0, column 1): 199 against 8)
    rewards (Rewards(step=-1.0, ...) against Rewards(step=-1.0, ...))
    """
    pair = task, other
    if same_task(task, other):
        return ()
    if any(map(is_observation_task, pair)):
        if not all(map(is_observation_task, pair)):
            return (f"observations ({task!r} against {other!r})",)
        names = {"longest": "time_limit", "make": "environment"}
        parts = ("observations", "actions", "discount", "longest", "make")
        settings = ({names.get(x, x): getattr(seen, x) for x in parts} for seen in pair)
        return tuple(_unequal(*settings))
    first, second = map(generative_model, pair)
    lines = [
        f"{kind} ({getattr(first, kind).size:,} against {getattr(second, kind).size:,})"
        for kind in ("states", "actions")
        if getattr(first, kind) != getattr(second, kind)
    ]
    alike = not lines
    settings = ({x: getattr(m, x) for x in ("discount", "time_limit")} for m in (first, second))
    lines += _unequal(*settings)
    looked_up = alike and all(map(_comparable, pair))
    if looked_up:
        lines += _of_tables(tables(task), tables(other))
        if not lines:
            return ()  # the same problem from other parameters
    by_parameters = type(task) is type(other) and is_dataclass(task)
    if by_parameters and (not isinstance(task, FiniteMDP) or (alike and not looked_up)):
        named = {line.split()[0] for line in lines}
        for name in _parameters(task):
            one_value, other_value = getattr(task, name), getattr(other, name)
            if name not in named and not _equal(one_value, other_value):
                arrays = isinstance(one_value, np.ndarray) and isinstance(other_value, np.ndarray)
                values = "entries" if arrays else f"{one_value!r} against {other_value!r}"
                lines.append(f"{name} ({values})")
    if not lines and not by_parameters:
        lines = ["rules (too large, or given by functions, to be compared)"]
    return tuple(lines)


def _unequal(first: Mapping[str, Any], second: Mapping[str, Any]) -> Iterator[str]:
    """Yield the names whose values differ between two mappings, with both values."""
    for name in dict.fromkeys((*first, *second)):
        value, other = first.get(name, "absent"), second.get(name, "absent")
        if value != other:
            yield f"{name} ({value} against {other})"


def _comparable(task: Task) -> bool:
    """Return whether a task has tables that are small enough to be compared."""
    model = generative_model(task)
    return model.states.size * model.actions.size <= LARGEST and has_tables(task)


def _parameters(task: Any) -> list[str]:
    """Return the names of a task's parameters; none if it is not a dataclass."""
    parts = fields(task) if is_dataclass(task) else ()
    return [part.name for part in parts if part.compare and part.init]


def _of_tables(mdp: FiniteMDP, other: FiniteMDP) -> Iterator[str]:
    """Yield each kind of difference between tables over the same spaces, with one state."""
    space = mdp.states
    ends = np.flatnonzero(mdp.terminal != other.terminal)
    if ends.size:
        yield f"end rule ({state_name(space, int(ends[0]))} ends one of them only)"
    alive = ~(mdp.terminal | other.terminal)
    if len(where := np.argwhere((live_pairs(mdp) != live_pairs(other)) & alive[:, None])):
        yield f"available actions ({state_name(space, int(where[0][0]))})"
    # Each state gets a random weight. Two distributions over successors that have the same mean
    # weight are equal with probability 1.
    weight = np.random.default_rng(0).normal(size=space.size)
    unit = max(largest_reward(mdp), largest_reward(other))
    pairs = zip(moments(mdp, weight, unit), moments(other, weight, unit), strict=True)
    for name, (first, second) in zip(MOMENTS, pairs, strict=True):
        apart = abs(first - second) > CLOSE * np.maximum(1.0, abs(first))
        where = np.argwhere(apart & alive[:, None])
        if len(where):
            s, a = where[0]
            values = f": {first[s, a]:g} against {second[s, a]:g}" if name == "reward" else ""
            yield f"{name} (from {state_name(space, int(s))}{values})"
            break  # later moments differ because this moment differs
    if abs(mdp.start - other.start).max() > CLOSE:
        s = int(abs(mdp.start - other.start).argmax())
        yield f"start ({state_name(space, s)}: {mdp.start[s]:.3g} against {other.start[s]:.3g})"


MOMENTS = ("reward", "transitions", "rewarded outcomes")


def moments(mdp: FiniteMDP, weight: FloatArray, unit: float) -> list[FloatArray]:
    """Return E r, E w(s') and E cos(r / unit + w(s')) of each pair, (S, A)."""
    # The third tells joint distributions of reward and successor apart whose first two agree.
    reward, weighed = mdp.reward, weight[mdp.next_state]
    values = (reward, weighed, np.cos(reward / unit + weighed))
    return [np.asarray((mdp.probability * x).sum(axis=1)[mdp.outcome_row]) for x in values]


def largest_reward(mdp: FiniteMDP) -> float:
    """Return the largest absolute reward of an outcome that can occur; 1 where all are 0."""
    return float(abs(mdp.reward).max(initial=0.0)) or 1.0


def _equal(first: Any, second: Any) -> bool:
    """Return whether two parameters are equal, arrays inside tuples included."""
    if isinstance(first, tuple) and isinstance(second, tuple):
        alike = type(first) is type(second) and len(first) == len(second)
        return alike and all(map(_equal, first, second))
    if isinstance(first, np.ndarray) or isinstance(second, np.ndarray):
        return np.array_equal(first, second)
    return bool(first == second)


# -- The same comparison from the plain data in a study's folder -----------------------------------

SELDOM = ("available", "action_masks")  # parameters that are stated only where they are set
AGREE = 1e-11  # relative difference of equal projections: 10^5 times the rounding of a sum


@dataclass(frozen=True)
class TaskSummary:
    """A task as plain data."""

    kind: str  # its type
    spaces: dict[str, str]  # its spaces, discount and time limit
    # For each part of the tables, its projection onto a random direction (the same for all tasks of
    # one size) and the sum of the absolute terms. Tables with equal projections are equal with
    # probability 1. Empty for a task without tables, or with tables that are too large.
    projections: dict[str, tuple[float, float]]
    parameters: dict[str, str]  # parameters of its type; long values as digests


def task_summary(task: Any) -> TaskSummary:
    """Return the summary of a task."""
    kind = type(task).__name__
    parameters = {
        name: plain_text(getattr(task, name))
        for name in _parameters(task)
        if name not in SELDOM or not (getattr(task, name) is None or getattr(task, name) is False)
    }
    spaces = dict[str, str]()
    if is_observation_task(task):
        names = {"observations": "observations", "actions": "actions", "longest": "time_limit"}
        spaces |= {name: plain_text(getattr(task, part)) for part, name in names.items()}
        return TaskSummary(kind, spaces | {"discount": repr(task.discount)}, {}, parameters)
    generative = generative_model(task)
    for name, space in (("states", generative.states), ("actions", generative.actions)):
        content = repr(space.components).encode()
        if space.size < math.prod(component.size for component in space.components):
            content += b"".join(values.tobytes() for values in space.decode().values())
        spaces[name] = f"{space.size:,} ({short_digest(content)})"
    spaces |= {name: repr(getattr(generative, name)) for name in ("discount", "time_limit")}
    if _comparable(task) and (available := tables(task).available) is not None:
        spaces["available actions"] = f"{available.sum():,} ({short_digest(available.tobytes())})"
    projections = dict(_projections(tables(task))) if _comparable(task) else {}
    return TaskSummary(kind, spaces, projections, parameters)


def summary_differences(task: TaskSummary, other: TaskSummary) -> tuple[str, ...]:
    """Return the differences of two summaries, with short values; () for the same problem."""
    lines = list(_unequal(task.spaces, other.spaces))
    alike = not lines or lines[0].split()[0] not in ("states", "actions", "observations")
    if alike and task.projections and other.projections:
        for name, (value, size) in task.projections.items():
            other_value, other_size = other.projections.get(name, (np.nan, 0.0))
            if not abs(value - other_value) <= AGREE * max(size, other_size):
                lines.append(name)
                break  # later parts differ because this part differs
        if not lines:
            return ()  # the same problem, perhaps from other parameters
    if task.kind != other.kind:
        return (*lines, f"type ({task.kind} against {other.kind})")
    return (*lines, *_unequal(task.parameters, other.parameters))


def _projections(mdp: FiniteMDP) -> Iterator[tuple[str, tuple[float, float]]]:
    draws, alive = np.random.default_rng(0), ~mdp.terminal
    weight = draws.normal(size=mdp.states.size)
    pairs = draws.normal(size=(mdp.states.size, mdp.actions.size)) * alive[:, None]
    yield "end rule", _projected(weight, alive.astype(np.float64))
    for name, values in zip(MOMENTS, moments(mdp, weight, largest_reward(mdp)), strict=True):
        yield name, _projected(pairs, values)
    yield "start", _projected(weight, mdp.start)


def _projected(direction: Any, values: Any) -> tuple[float, float]:
    terms = np.where(direction != 0, values, 0.0) * direction
    return float(terms.sum()), float(abs(terms).sum())
