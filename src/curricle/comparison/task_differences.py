"""The differences of two tasks, found in plain data of each; none if they are the same problem.

A study's folder keeps these data of its target, so that two stored studies are compared alike.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass

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
from curricle.tasks.observation_task import ObservationTask, made_by, plain_text
from curricle.tasks.spaces import state_name

LARGEST = 5_000_000  # pairs (S x A) up to which tables are compared
AGREE = 1e-11  # relative difference of equal projections: 10^5 times the rounding of a sum
CLOSE = 1e-9  # relative difference of numbers that are named as the place of a difference
SELDOM = ("available", "action_masks")  # parameters that are stated only where they are set
MOMENTS = ("reward", "transitions", "rewarded outcomes")
SPACES = ("states", "actions", "observations")


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
    if same_task(task, other):
        return ()
    summaries = task_summary(task), task_summary(other)
    details = dict(_unequal(*summaries))
    if details.keys() & summaries[0].projections.keys():
        first, second = tables(task), tables(other)
        parts = zip(_parts(first).items(), _parts(second).values(), strict=True)
        places = {name: _place(name, first, x, y) for (name, x), y in parts if name in details}
        details |= places
    return tuple(_line(*difference) for difference in details.items())


def summary_differences(task: TaskSummary, other: TaskSummary) -> tuple[str, ...]:
    """Return the differences of two summaries, with short values; () for the same problem."""
    return tuple(_line(*difference) for difference in _unequal(task, other))


def _line(name: str, detail: str) -> str:
    return f"{name} ({detail})" if detail else name


def _unequal(first: TaskSummary, second: TaskSummary) -> Iterator[tuple[str, str]]:
    """Yield the name of each difference and both values, or no values."""
    if ("observations" in first.spaces) != ("observations" in second.spaces):
        yield "observations", f"{first.kind} against {second.kind}"
        return
    named = set[str]()
    for name in dict.fromkeys((*first.spaces, *second.spaces)):
        values = first.spaces.get(name, "absent"), second.spaces.get(name, "absent")
        if values[0] != values[1]:
            named.add(name)
            sizes = [value.partition(" (")[0] for value in values]
            yield name, " against ".join(sizes if name in ("states", "actions") else values)
    if first.projections and second.projections and not named & {*SPACES}:
        for name, (value, size) in first.projections.items():
            # Of parts that differ in consequence of a part before them only the first is named.
            consequent = name != "start" and bool(named & first.projections.keys())
            other_value, other_size = second.projections[name]
            if not consequent and not abs(value - other_value) <= AGREE * max(size, other_size):
                named.add(name)
                yield name, ""
        if not named:
            return  # the same problem, perhaps from other parameters
    if first.kind == second.kind:
        for name, parameter in first.parameters.items():
            text = second.parameters.get(name, "absent")
            if parameter != text and name not in named:
                yield name, f"{parameter} against {text}"
    elif not named:
        yield "rules", f"{first.kind} against {second.kind}, too large or functions"


def task_summary(task: Task | ObservationTask) -> TaskSummary:
    """Return the summary of a task."""
    kind = type(task).__name__
    if isinstance(task, ObservationTask):
        spaces = {name: plain_text(getattr(task, name)) for name in ("observations", "actions")}
        spaces |= {"discount": repr(task.discount), "time_limit": repr(task.longest)}
        return TaskSummary(kind, spaces, {}, {"environment": made_by(task.make)})
    model, spaces, projections = generative_model(task), dict[str, str](), {}
    for name, space in (("states", model.states), ("actions", model.actions)):
        content = repr(space.components).encode()
        if space.size < math.prod(component.size for component in space.components):
            content += b"".join(values.tobytes() for values in space.decode().values())
        spaces[name] = f"{space.size:,} ({short_digest(content)})"
    spaces |= {name: repr(getattr(model, name)) for name in ("discount", "time_limit")}
    if model.states.size * model.actions.size <= LARGEST and has_tables(task):
        projections = {name: _projected(x) for name, x in _parts(tables(task)).items()}
    parameters = {} if projections and isinstance(task, FiniteMDP) else dict(_parameters(task))
    return TaskSummary(kind, spaces, projections, parameters)


def _parameters(task: object) -> Iterator[tuple[str, str]]:
    """Yield the parameters of a task as text; none if it is not a dataclass."""
    for part in fields(task) if is_dataclass(task) else ():
        value = getattr(task, part.name)
        if part.compare and part.init and not (part.name in SELDOM and value in (None, False)):
            yield part.name, _text(value)


def _text(value: object) -> str:
    """Return a parameter as text, arrays inside tuples included."""
    if isinstance(value, tuple) and any(isinstance(part, np.ndarray) for part in value):
        return f"{type(value).__name__}({', '.join(map(_text, value))})"
    return plain_text(value)


def _parts(mdp: FiniteMDP) -> dict[str, FloatArray]:
    """Return the arrays, (S,) or (S, A), in which the tables of two problems differ."""
    # Each state has a random weight w: two distributions over successors with the same mean weight
    # are equal with probability 1. The last moment, E cos(r / unit + w(s')), tells joint
    # distributions of reward and successor apart whose means agree.
    reward, live = mdp.reward, live_pairs(mdp)
    weighed = np.random.default_rng(0).normal(size=mdp.states.size)[mdp.next_state]
    unit = float(abs(reward).max(initial=0.0)) or 1.0
    outcomes = (reward, weighed, np.cos(reward / unit + weighed))
    means = [(mdp.probability * x).sum(axis=1)[mdp.outcome_row] for x in outcomes]
    alive = ~mdp.terminal[:, None]
    return {
        "end rule": mdp.terminal.astype(np.float64),
        "available actions": live.astype(np.float64),
        **{name: np.where(alive, x, 0.0) for name, x in zip(MOMENTS, means, strict=True)},
        "start": mdp.start,
    }


def _projected(values: FloatArray) -> tuple[float, float]:
    """Return the sum of an array times random numbers, and the sum of the terms' sizes."""
    terms = values * np.random.default_rng(1).normal(size=values.shape)
    return float(terms.sum()), float(abs(terms).sum())


def _place(name: str, mdp: FiniteMDP, first: FloatArray, second: FloatArray) -> str:
    """Return the first state in which a part of two tables differs, with values if these tell."""
    apart = np.argwhere(abs(first - second) > CLOSE * np.maximum(1.0, abs(first)))
    if not len(apart):  # each number differs by less than is named
        return ""
    values = f"{first[tuple(apart[0])]:.4g} against {second[tuple(apart[0])]:.4g}"
    words = {
        "end rule": " ends one of them only",
        "reward": f": {values}",
        "start": f": {values}",
    }
    of_pair = "from " * (name in MOMENTS)
    return f"{of_pair}{state_name(mdp.states, int(apart[0][0]))}{words.get(name, '')}"
