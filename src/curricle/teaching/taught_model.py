"""The generative model of several tasks of the same space, which change from episode to episode.

For learning loops it is a model like any other: ``first_state`` asks a Python object for the next
task, and transitions are those of its tables. The rewards and errors of an episode are recorded for
the teacher, which reads them at its end.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, FloatTable, IntArray
from curricle.tasks.draws import uniform
from curricle.tasks.generative_models import (
    Tables,
    evaluation_models,
    failures,
    first_states,
    table_model,
    transitions,
)
from curricle.tasks.live import answer
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.overloads import inlined


class SharedTables(NamedTuple):
    """The tables of M tasks of a space; tasks that differ only in their start share W worlds."""

    world: IntArray  # (M,) the world of a task
    outcome_row: npt.NDArray[np.integer[Any]]  # (W, S, A)
    cumulative: FloatArray  # (Y, O) of all worlds, one after the other
    next_state: npt.NDArray[np.integer[Any]]  # (Y, O)
    reward: FloatArray  # (Y, O)
    terminal: BoolArray  # (W, S)
    target: Tables
    discount: float

    @classmethod
    def of(cls, mdps: Sequence[FiniteMDP], target: int) -> "SharedTables":
        """Return the tables of tasks; `target` is the place of the target among them."""
        worlds, world = list[FiniteMDP](), list[int]()
        for mdp in mdps:
            place = next((w for w, other in enumerate(worlds) if _same_world(mdp, other)), None)
            world.append(len(worlds) if place is None else place)
            worlds += [mdp] if place is None else []
        n_outcomes = max(mdp.probability.shape[1] for mdp in worlds)
        rows = np.cumsum([0, *(len(mdp.probability) for mdp in worlds)])

        def stacked(name: str, filling: float) -> Any:
            arrays = [np.asarray(getattr(mdp, name)) for mdp in worlds]
            widths = [((0, 0), (0, n_outcomes - array.shape[1])) for array in arrays]
            padded = map(partial(np.pad, constant_values=filling), arrays, widths)
            return np.concatenate([*padded])

        return cls(
            np.array(world),
            np.stack([mdp.outcome_row + rows[w] for w, mdp in enumerate(worlds)]),
            stacked("cumulative", 1.0),  # outcomes that no draw exceeds are never taken
            stacked("next_state", 0),
            stacked("reward", 0.0),
            np.stack([mdp.terminal for mdp in worlds]),
            table_model(mdps[target]),
            mdps[target].discount,
        )


def _same_world(task: FiniteMDP, other: FiniteMDP) -> bool:
    """Return whether two tasks differ in nothing but where episodes start."""
    names = ("outcome_row", "probability", "next_state", "reward", "terminal")
    return all(np.array_equal(getattr(task, name), getattr(other, name)) for name in names)


class EpisodeRecord(NamedTuple):
    """The episode in progress, step by step; L is the time limit."""

    task: IntArray  # (1,) its task
    length: IntArray  # (1,) steps so far
    rewards: FloatArray  # (L,)
    td_errors: FloatArray  # (L,) r + gamma V(s') - V(s), with V = max_a Q when the step was taken
    last_state: IntArray  # (1,)
    terminated: BoolArray  # (1,) whether it ended there

    @classmethod
    def empty(cls, time_limit: int) -> "EpisodeRecord":
        """Return the record of an episode that has not begun."""
        n, last = np.zeros((2, 1), np.int64)
        task = np.full(1, -1)
        return cls(task, n, np.zeros(time_limit), np.zeros(time_limit), last, np.zeros(1, np.bool_))


class TaughtModel(NamedTuple):
    """Several tasks, a record of the present episode, and the address of who draws the next."""

    asked: npt.NDArray[np.uint64]  # (1,) the address of the callable of :func:`answer`
    failed: BoolArray  # (1,) whether the callable has failed
    tables: SharedTables
    q: FloatTable  # (n, S, A) the learner's n tables
    episode: EpisodeRecord


@first_states.body(TaughtModel)
def _taught_start(model, bits):
    state = answer(model.asked[0], np.int64(bits))[0]
    model.episode.length[0] = 0  # after a failure too: a loop may take one more step
    if state < 0:
        model.failed[0] = True
        return np.uint64(0)
    return np.uint64(state)


@inlined
def _highest_mean(q, state):
    """Return max_a of the mean of the learner's tables."""
    best = -np.inf
    for action in range(q.shape[2]):
        value = 0.0
        for table in range(q.shape[0]):
            value += q[table, state, action]
        best = max(best, value / q.shape[0])
    return best


@transitions.body(TaughtModel)
def _taught_step(model, state, action, bits):
    tables, episode = model.tables, model.episode
    world = tables.world[episode.task[0]]
    row, outcome = tables.outcome_row[world, state, action], np.uint64(0)
    last = np.uint64(tables.cumulative.shape[1] - 1)
    if last > np.uint64(0):
        chance = uniform(bits)
        for i in range(last):
            outcome += np.uint64(chance >= tables.cumulative[row, i])
    next_state = np.uint64(tables.next_state[row, outcome])
    reward, terminated = tables.reward[row, outcome], tables.terminal[world, next_state]
    ahead = 0.0 if terminated else tables.discount * _highest_mean(model.q, next_state)
    n = episode.length[0]
    episode.rewards[n] = reward
    episode.td_errors[n] = reward + ahead - _highest_mean(model.q, state)
    episode.length[0] = n + 1
    episode.last_state[0], episode.terminated[0] = next_state, terminated
    return next_state, reward, terminated


@failures.body(TaughtModel)
def _taught_failure(model):
    return model.failed[0]


@evaluation_models.body(TaughtModel)
def _target_model(model):
    return model.tables.target
