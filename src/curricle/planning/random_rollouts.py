"""Wandering: walks of the uniform policy through tasks of any size, tables or none."""

# Numba infers the types of what is compiled here.
# mypy: allow-untyped-defs, allow-untyped-calls

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.checks import whole_number
from curricle.errors import SettingError
from curricle.learning.run import compiled, stream_start
from curricle.tasks.draws import draw, integers, splitmix64
from curricle.tasks.generative_models import Functions, cut_short, first_state, transition
from curricle.tasks.live import is_live, opened
from curricle.tasks.spaces import frozen
from curricle.tasks.task import Task, generative_model

IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class RandomRollouts:
    """W walks of up to L steps.

    Attributes
    ----------
    states : (W, L + 1) int64
        From where each starts; after its end the state reached last, repeated.
    actions : (W, L) int64
        0 after the end.
    length : (W,) int64
        Steps taken.
    terminated : (W,) bool
        Whether the walk came to an end of the task; the others were cut off.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> walks = random_rollouts(GridWorld("S.T"), walks=2, length=3)
    >>> walks.states, walks.terminated
    (array([[0, 0, 1, 2],
           [0, 0, 0, 1]]), array([ True, False]))
    """

    states: IntArray
    actions: IntArray
    length: IntArray
    terminated: npt.NDArray[np.bool_]

    @property
    def taken(self) -> npt.NDArray[np.bool_]:
        """Which steps were taken, (W, L)."""
        return np.asarray(np.arange(self.actions.shape[1]) < self.length[:, None])

    @property
    def ending(self) -> npt.NDArray[np.bool_]:
        """Which steps led to an end of the task, (W, L)."""
        last = np.arange(self.actions.shape[1]) == self.length[:, None] - 1
        return np.asarray(last & self.terminated[:, None])


def random_rollouts(
    task: Task,
    *,
    walks: int,
    length: int,
    seed: int = 0,
    starts: npt.NDArray[np.integer[Any]] | None = None,
) -> RandomRollouts:
    """Return walks in which every action is equally likely at every step.

    Parameters
    ----------
    task : Task
        With or without tables.
    walks, length : int
        W and L, at least 1. A walk shorter than L has come to an end of the task.
    seed : int
        Equal seeds give equal walks.
    starts : (W,) int array, optional
        States, not terminal, that the walks start in; drawn as episodes start by default.

    Raises
    ------
    SettingError
        When a number is too small, or there is not one start for each walk or a live task to start.

    Examples
    --------
    >>> from curricle import Pursuit
    >>> walks = random_rollouts(Pursuit(size=10, predators=3), walks=5, length=100)
    >>> walks.states.shape, bool(walks.terminated.any())
    ((5, 101), False)
    """
    n = whole_number("walks", walks, 1, SettingError)
    length = whole_number("the length of a walk in steps", length, 1, SettingError)
    seed = whole_number("seed", seed, 0, SettingError)
    generative = generative_model(task)
    given = np.zeros(0, np.int64) if starts is None else np.array(starts, np.int64)
    if starts is not None and given.shape != (n,):
        raise SettingError(f"starts must have shape ({n},), one a walk: got {given.shape}")
    states = np.zeros((n, length + 1), np.int64)
    actions = np.zeros((n, length), np.int64)
    taken, terminated = np.zeros(n, np.int64), np.zeros(n, np.bool_)
    if starts is not None and is_live(generative):
        raise SettingError(
            "a live task starts where its episodes do: walks from states given are impossible there"
        )
    stream = stream_start(seed, "wandering")
    with opened(generative.model, stream) as model:
        compiled(_walk, isinstance(model, Functions))(
            model,
            np.uint64(generative.actions.size),
            np.array([stream], np.uint64),
            given,
            states,
            actions,
            taken,
            terminated,
        )
    return RandomRollouts(frozen(states), frozen(actions), frozen(taken), frozen(terminated))


def _walk(model, n_actions, stream, starts, states, actions, length, terminated):
    for walk in range(states.shape[0]):
        if starts.shape[0] > 0:
            state = np.uint64(starts[walk])
        else:
            state = np.uint64(first_state(model, draw(stream)))
        states[walk, 0] = np.int64(state)
        over, cut = False, False
        for step in range(actions.shape[1]):
            if not over and not cut:
                bits = draw(stream)
                action = integers(bits, n_actions)
                state, _, over = transition(model, state, action, splitmix64(bits))
                cut = cut_short(model)
                actions[walk, step] = np.int64(action)
                length[walk] = step + 1
            states[walk, step + 1] = np.int64(state)
        terminated[walk] = over
