"""A task in plain data: enough to tell whether two stored studies have one target."""

import inspect
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from hashlib import blake2b
from typing import Any

import numpy as np

from curricle.comparison.task_differences import LARGEST, largest_reward, moments
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.spaces import Space
from curricle.tasks.task import generative_model, has_tables, tables

AGREE = 1e-11
"""Relative difference up to which two projections are equal: 10^5 times the rounding of a sum."""
DIGEST_BYTES = 8


@dataclass(frozen=True)
class TaskSummary:
    """What a task is, in plain data.

    Attributes
    ----------
    kind : str
        Its type.
    spaces : dict of str to str
        Its spaces, discount and time limit.
    projections : dict of str to (float, float)
        Each part of its tables, projected onto a random direction that is the same for all tasks of
        one size, and the sum of the absolute terms: two tables with equal projections are equal but
        for a set of probability 0. Empty for a task whose tables are too large, or that has none.
    parameters : dict of str to str
        Of its type, with a digest of what is too long.

    Examples
    --------
    >>> from curricle import GridWorld, Rewards
    >>> one, other = (task_summary(GridWorld("S.T", rewards=Rewards(treasure=t))) for t in (9, 8))
    >>> summary_differences(one, other)[0]
    'reward'
    """

    kind: str
    spaces: dict[str, str]
    projections: dict[str, tuple[float, float]]
    parameters: dict[str, str]


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
    spaces = {
        name: f"{space.size:,} ({_space_digest(space)})"
        for name, space in (("states", generative.states), ("actions", generative.actions))
    }
    spaces |= {"discount": repr(generative.discount), "time_limit": repr(generative.time_limit)}
    small = generative.states.size * generative.actions.size <= LARGEST and has_tables(task)
    projections = dict(_projections(tables(task))) if small else {}
    return TaskSummary(type(task).__name__, spaces, projections, parameters)


def summary_differences(one: TaskSummary, other: TaskSummary) -> tuple[str, ...]:
    """Return how two tasks differ, with both values where they are short; () for one problem."""
    found = list(_unequal(one.spaces, other.spaces))
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
    return (*found, *_unequal(one.parameters, other.parameters))


def plain_text(value: Any) -> str:
    """Return a value as text that is the same in every process and on every machine.

    Functions are named, with a digest of their source; arrays too long to print have one too.

    Examples
    --------
    >>> plain_text(np.arange(3)), plain_text(plain_text)
    ('array([0, 1, 2])', 'plain_text (...)')
    """
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
    """Return a text without addresses, which differ between processes, and without folders.

    The package of a study's own modules is named after its folder, and code after its file.
    """
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


def _unequal(one: dict[str, str], other: dict[str, str]) -> Iterator[str]:
    for name in dict.fromkeys((*one, *other)):
        mine, yours = one.get(name, "absent"), other.get(name, "absent")
        if mine != yours:
            yield f"{name} ({mine} against {yours})"


def _space_digest(space: Space) -> str:
    content = repr(space.components).encode()
    if space.size < math.prod(component.size for component in space.components):
        content += b"".join(values.tobytes() for values in space.decode().values())
    return _digest(content)


def _digest(content: str | bytes) -> str:
    content = content.encode() if isinstance(content, str) else content
    return blake2b(content, digest_size=DIGEST_BYTES).hexdigest()
