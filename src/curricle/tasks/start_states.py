"""Start states of any task with tables: near the goal, reachable, or as given.

Episodes that start near the goal first are a curriculum (Asada et al. 1996, "learning from easy
missions"; Florensa et al. 2017, "reverse curriculum generation").
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, Frozen, IntArray, adopted
from curricle.checks import indices, numbers, whole_number
from curricle.errors import TaskError
from curricle.tasks.domain import GridDomain
from curricle.tasks.graph import reachable_states, rows_in_use, steps_to
from curricle.tasks.mdp import FiniteMDP, tables
from curricle.tasks.spaces import MISSING, Space
from curricle.text import counted

Goal = npt.ArrayLike | Mapping[str, Any] | None


@dataclass(frozen=True)
class GoalDistance:
    """A ring around the goal: the states at a distance in a range that the task's start can reach.

    Parameters
    ----------
    low, high : int
        Steps, both included; `high` is `low` by default.
    goal : optional
        As in :func:`goal_distance`.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> maze = with_start(GridWorld("S...T"), GoalDistance(1, 2))
    >>> maze.start
    ((0, 2), (0, 3))
    """

    low: int
    high: int | None = None
    goal: Any = None

    def __post_init__(self) -> None:
        low = whole_number("the lowest distance to the goal", self.low, 0, TaskError)
        high = low if self.high is None else self.high
        high = whole_number("the highest distance to the goal", high, low, TaskError)
        object.__setattr__(self, "low", low)
        object.__setattr__(self, "high", high)


@dataclass(frozen=True, eq=False, repr=False)
class TaskWithStart(Frozen):
    """A task whose episodes start elsewhere; made by :func:`with_start`."""

    task: Any
    start: FloatArray  # (S,) the probability of starting in each state

    def __post_init__(self) -> None:
        numbers("start", self.start, TaskError)
        object.__setattr__(self, "start", adopted(self.start, np.float64))
        _ = self.mdp

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The tables of the task with the other start."""
        return replace(tables(self.task), start=self.start)

    @property
    def states(self) -> Space:
        """The state space of the task."""
        return self.mdp.states

    @property
    def actions(self) -> Space:
        """The action space of the task."""
        return self.mdp.actions

    @property
    def layout(self) -> Any:
        """Where the states of the task lie; AttributeError if it does not say."""
        return self.task.layout

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, TaskWithStart):
            return NotImplemented
        return bool(self.task == other.task) and np.array_equal(self.start, other.start)

    def __hash__(self) -> int:
        return hash((self.task, self.start.tobytes()))

    def __repr__(self) -> str:
        starts = counted(int(np.count_nonzero(self.start)), "start state")
        return f"TaskWithStart({self.task!r}, {starts})"


def with_start(task: object, start: object) -> Any:
    """Return the same task with episodes that start elsewhere; mappings fit both.

    Parameters
    ----------
    task : Task
        Any task with tables.
    start : str, GoalDistance, int or array
        - ``"uniform"``: in any state that does not end the episode;
        - ``"reachable"``: in any such state that the task's start can reach;
        - :class:`GoalDistance`: in a ring around the goal;
        - a whole number, or an array of them: in these states, equally likely;
        - (S,) float array: with these probabilities, for example from :func:`visit_distribution`.

    Raises
    ------
    TaskError
        When the task has no tables, no state is left, a state does not exist or ends the episode,
        or probabilities do not sum to 1.

    Examples
    --------
    >>> from curricle import Pursuit
    >>> near = with_start(Pursuit(size=3, predators=1), GoalDistance(1))
    >>> int((near.mdp.start > 0).sum())
    52
    """
    base = task.task if isinstance(task, TaskWithStart) else task
    mdp = tables(task)
    if isinstance(start, str) and start == "uniform" and hasattr(base, "with_start"):
        return base.with_start("uniform")
    distribution = _distribution(mdp, start)
    moved = replace(mdp, start=distribution)  # checks it
    if isinstance(base, FiniteMDP):
        return moved
    if hasattr(base, "start_from"):
        return base.start_from(distribution)
    positive = np.flatnonzero(distribution)
    equal = (distribution[positive] == distribution[positive[0]]).all()
    if equal and isinstance(base, GridDomain) and base.can_start_in(positive):
        return base.start_in(positive)
    return TaskWithStart(base, distribution)


def _distribution(mdp: FiniteMDP, start: object) -> FloatArray:
    """Return the start distribution that a description means, (S,) float64."""
    n_states, alive = len(mdp.terminal), ~mdp.terminal
    if isinstance(start, GoalDistance):
        far = goal_distance(mdp, start.goal)
        alive &= reachable_states(mdp)
        chosen = (far >= start.low) & (far <= (start.high or 0)) & alive
        if not chosen.any():
            most = far[alive].max(initial=MISSING)
            reached = f"the farthest lies {most} steps off" if most > 0 else "there is no way to it"
            steps = f"{start.low}..{start.high} steps"
            raise TaskError(f"no state to start in lies {steps} from the goal: {reached}")
    elif isinstance(start, str):
        if start not in ("uniform", "reachable"):
            raise TaskError(
                "start must be 'uniform', 'reachable', a GoalDistance, states or probabilities: "
                f"got {start!r}"
            )
        chosen = alive & reachable_states(mdp) if start == "reachable" else alive
        if not chosen.any():
            raise TaskError(f"start={start!r} needs a state that does not end the episode")
    elif np.asarray(start).dtype.kind in "iu":
        states = np.atleast_1d(indices("start states", start, n_states, TaskError))
        if not states.size or states.ndim > 1 or len(np.unique(states)) < states.size:
            raise TaskError(
                "start must name at least one state and none twice (probabilities are fractions, "
                f"such as 1.0): got {start!r}"
            )
        chosen = _flags(n_states, states)
    else:
        chances = numbers("start", start, TaskError)
        if chances.shape != (n_states,):
            raise TaskError(
                f"start probabilities must have shape ({n_states},): got {chances.shape}"
            )
        return chances
    return chosen / np.count_nonzero(chosen)


def goal_distance(task: object, goal: Goal = None) -> IntArray:
    """Return the fewest steps in which a policy can reach the goal, (S,) int64; -1 where none can.

    No way leads through a terminal state.

    Parameters
    ----------
    task : Task
        Any task with tables.
    goal : optional
        The goal's states: a (S,) bool array, an array of numbers, or a dict from components to a
        value, a label or a list of them. By default the terminal states that are entered with the
        largest reward: the treasure and not the pits.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> goal_distance(GridWorld(["S.PT", ".#.."]))  # a wall between south-west and south-east
    array([-1, -1, -1,  0, -1,  2,  1])
    """
    mdp = tables(task)
    wanted = goal_states(mdp, goal)
    far = steps_to(mdp, wanted, wanted | ~mdp.terminal)
    return np.where(np.isfinite(far), far, -1).astype(np.int64)


def goal_states(task: object, goal: Goal = None) -> BoolArray:
    """Return which states are the goal, (S,) bool, for the parameters of goal_distance."""
    mdp = tables(task)
    n_states, states = len(mdp.terminal), np.asarray(goal)
    if goal is None:  # the terminal states that are entered with the largest reward of all
        used = rows_in_use(mdp.outcome_row, mdp.terminal, len(mdp.probability))
        ends = used[:, None] & (mdp.probability > 0) & mdp.terminal[mdp.next_state]
        best = mdp.reward[ends].max(initial=-np.inf)
        states = _flags(n_states, mdp.next_state[ends & (mdp.reward == best)])
    elif isinstance(goal, Mapping):
        states, values = np.full(n_states, bool(goal)), mdp.states.decode()
        for name, wanted in goal.items():
            component = mdp.states.component(name)
            several = isinstance(wanted, Iterable) and not isinstance(wanted, str)
            listed = [component.value(value) for value in (wanted if several else [wanted])]
            states &= np.isin(values[name], listed)
    elif states.dtype != np.bool_:
        states = _flags(n_states, indices("the states of a goal", goal, n_states, TaskError))
    elif states.shape != (n_states,):
        raise TaskError(f"a goal of flags must have shape ({n_states},): got {states.shape}")
    if not states.any():
        raise TaskError(
            "a goal needs at least one state: none is terminal and can be entered; give the goal"
            if goal is None
            else f"a goal needs at least one state: got {goal!r}"
        )
    return states


def _flags(n_states: int, states: Any) -> BoolArray:
    flags = np.zeros(n_states, dtype=bool)
    flags[states] = True
    return flags
