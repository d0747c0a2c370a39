"""Whether two tasks are the same problem, and their differences if not; tasks in plain data.

The plain data of a task is enough to tell whether two stored studies have one target.
"""

import inspect
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from hashlib import blake2b
from typing import Any, cast

import numpy as np

from curricle.arrays import FloatArray
from curricle.tasks.mdp import FiniteMDP, Task, generative_model, has_tables, same_task, tables
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.spaces import state_name

LARGEST = 5_000_000  # pairs (S x A) up to which tables are compared
CLOSE = 1e-9  # relative difference of moments, or difference of start probabilities, that is none


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
        if not (is_observation_task(one) and is_observation_task(other)):
            return (f"observations ({one!r} against {other!r})",)
        names = {"observations": "", "actions": "", "discount": "", "longest": "time_limit"}
        return (*_unequal(one, other, **names), *_unequal(one, other, make="environment"))
    mine, yours = generative_model(one), generative_model(other)
    found = [
        f"{kind} ({getattr(mine, kind).size:,} against {getattr(yours, kind).size:,})"
        for kind in ("states", "actions")
        if getattr(mine, kind) != getattr(yours, kind)
    ]
    found += _unequal(mine, yours, discount="", time_limit="")
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
        for part in fields(cast(Any, one)):
            mine, yours = getattr(one, part.name), getattr(other, part.name)
            shown = part.compare and part.init and part.name not in firsts
            if shown and not _equal(mine, yours):
                arrays = isinstance(mine, np.ndarray) and isinstance(yours, np.ndarray)
                values = "entries" if arrays else f"{mine!r} against {yours!r}"
                found.append(f"{part.name} ({values})")
    if not found and not by_parameters:
        found = ["rules (too large, or given by functions, to be compared)"]
    return tuple(found)


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
    """Return E r, E w(s') and E cos(r / unit + w(s')) of each pair, (S, A)."""
    # The last separates joint distributions of reward and successor with the same first two.
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


def _equal(mine: Any, yours: Any) -> bool:
    """Return whether two parameters are equal, arrays inside tuples included."""
    if isinstance(mine, tuple) and isinstance(yours, tuple):
        alike = type(mine) is type(yours) and len(mine) == len(yours)
        return alike and all(map(_equal, mine, yours))
    if isinstance(mine, np.ndarray) or isinstance(yours, np.ndarray):
        return np.array_equal(mine, yours)
    return bool(mine == yours)


AGREE = 1e-11  # relative difference of equal projections: 10^5 times the rounding of a sum
DIGEST_BYTES = 8


@dataclass(frozen=True)
class TaskSummary:
    """What a task is, in plain data."""

    kind: str  # its type
    spaces: dict[str, str]  # its spaces, discount and time limit
    # Each part of its tables, projected onto a random direction that is the same for all tasks of
    # one size, and the sum of the absolute terms: two tables with equal projections are equal but
    # for a set of probability 0. Empty for a task whose tables are too large, or that has none.
    projections: dict[str, tuple[float, float]]
    parameters: dict[str, str]  # of its type, with a digest of what is too long


def task_summary(task: Any) -> TaskSummary:
    """Return the summary of a task."""
    parameters = {
        part.name: plain_text(getattr(task, part.name))
        for part in (fields(task) if is_dataclass(task) else ())
        if part.compare and part.init
    }
    if is_observation_task(task):
        names = {"observations": "observations", "actions": "actions", "longest": "time_limit"}
        spaces = {name: plain_text(getattr(task, given)) for given, name in names.items()}
        spaces["discount"] = repr(task.discount)
        return TaskSummary(type(task).__name__, spaces, {}, parameters)
    generative = generative_model(task)
    spaces = dict[str, str]()
    for name, space in (("states", generative.states), ("actions", generative.actions)):
        content = repr(space.components).encode()
        if space.size < math.prod(component.size for component in space.components):
            content += b"".join(values.tobytes() for values in space.decode().values())
        spaces[name] = f"{space.size:,} ({_digest(content)})"
    spaces |= {"discount": repr(generative.discount), "time_limit": repr(generative.time_limit)}
    small = generative.states.size * generative.actions.size <= LARGEST and has_tables(task)
    projections = dict(_projections(tables(task))) if small else {}
    return TaskSummary(type(task).__name__, spaces, projections, parameters)


def summary_differences(one: TaskSummary, other: TaskSummary) -> tuple[str, ...]:
    """Return how two tasks differ, with both values where they are short; () for one problem."""
    found = list(_unequal_texts(one.spaces, other.spaces))
    alike = not found or found[0].split()[0] not in ("states", "actions", "observations")
    looked_up = alike and bool(one.projections and other.projections)
    if looked_up:
        for name, (mine, size) in one.projections.items():
            yours, its_size = other.projections.get(name, (np.nan, 0.0))
            if not abs(mine - yours) <= AGREE * max(size, its_size):
                found.append(name)
                break  # later parts differ as a consequence
        if not found:
            return ()  # the same problem, perhaps from other parameters
    if one.kind != other.kind:
        return (*found, f"type ({one.kind} against {other.kind})")
    return (*found, *_unequal_texts(one.parameters, other.parameters))


def plain_text(value: Any) -> str:
    """Return a value as text that is the same in every process and on every machine."""
    if isinstance(value, np.ndarray):
        text = repr(value)
        return text if "..." not in text else f"array {value.shape} ({_digest(value.tobytes())})"
    function = getattr(value, "py_func", value)
    if inspect.isfunction(function):
        try:
            source = inspect.getsource(function)
        except OSError:
            source = repr(function.__code__.co_code)
        constants = function.__code__.co_consts, inspect.getclosurevars(function).nonlocals
        return f"{function.__name__} ({_digest(source + _of_any_process(repr(constants)))})"
    return _of_any_process(repr(value))


def _of_any_process(text: str) -> str:
    """Return a text without addresses, which differ between processes, and without folders."""
    # The package of a study's own modules is named after its folder, and code after its file.
    parts = r' at 0x[0-9a-f]+|\bcurricle_study_[0-9a-f]+\.|, file "[^"]*", line \d+'
    return re.sub(parts, "", text)


def _projections(mdp: FiniteMDP) -> Iterator[tuple[str, tuple[float, float]]]:
    draws = np.random.default_rng(0)
    weight = draws.normal(size=mdp.states.size)
    alive = ~mdp.terminal
    unit = largest_reward(mdp)
    pairs = draws.normal(size=(mdp.states.size, mdp.actions.size)) * alive[:, None]
    yield "end rule", _projected(weight, alive.astype(np.float64))
    for name, values in zip(
        ("reward", "transitions", "rewarded outcomes"), moments(mdp, weight, unit), strict=True
    ):
        yield name, _projected(pairs, values)
    yield "start", _projected(weight, mdp.start)


def _projected(direction: Any, values: Any) -> tuple[float, float]:
    terms = np.where(direction != 0, values, 0.0) * direction
    return float(terms.sum()), float(abs(terms).sum())


def _unequal_texts(one: dict[str, str], other: dict[str, str]) -> Iterator[str]:
    for name in dict.fromkeys((*one, *other)):
        mine, yours = one.get(name, "absent"), other.get(name, "absent")
        if mine != yours:
            yield f"{name} ({mine} against {yours})"


def _digest(content: str | bytes) -> str:
    content = content.encode() if isinstance(content, str) else content
    return blake2b(content, digest_size=DIGEST_BYTES).hexdigest()
