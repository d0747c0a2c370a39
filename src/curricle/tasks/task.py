"""What a task is, to whoever learns, plans or maps: any object with these properties."""

from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from curricle.errors import TaskError
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.spaces import Space


class Task(Protocol):
    """Anything that can be learnt, solved and mapped: it has spaces and converts to tables."""

    @property
    def states(self) -> Space:
        """The state space, S points."""

    @property
    def actions(self) -> Space:
        """The action space, A points."""

    @property
    def mdp(self) -> FiniteMDP:
        """The task as tables."""


class GenerativeModel(Protocol):
    """What learning needs of a task: its spaces and horizon, and a model that compiled loops read.

    `terminal`, (S,) bool, may be None where nobody knows.
    """

    @property
    def states(self) -> Space: ...  # noqa: D102
    @property
    def actions(self) -> Space: ...  # noqa: D102
    @property
    def discount(self) -> float: ...  # noqa: D102
    @property
    def time_limit(self) -> int | None: ...  # noqa: D102
    @property
    def terminal(self) -> npt.NDArray[np.bool_] | None: ...  # noqa: D102
    @property
    def model(self) -> Any: ...  # noqa: D102


def generative_model(task: Any) -> GenerativeModel:
    """Return a task that computes its moves as it is, any other's tables."""
    generative: GenerativeModel = (
        task if isinstance(getattr(task, "model", None), tuple) else tables(task)
    )
    return generative


def has_tables(task: Any) -> bool:
    """Return whether a task can be turned into tables (if they fit)."""
    return hasattr(type(task), "mdp") or "mdp" in getattr(task, "__dict__", {})


def tables(task: Any) -> FiniteMDP:
    """Return the tables of a task, or raise TaskError if it is none."""
    mdp = getattr(task, "mdp", None)
    if not isinstance(mdp, FiniteMDP):
        if isinstance(getattr(task, "model", None), tuple):
            raise TaskError(
                f"a task given by functions or played live has no tables to look at: {task!r}"
            )
        raise TaskError(f"a task must be a FiniteMDP or have its tables as .mdp: got {task!r}")
    return mdp


def same_task(one: Task, other: Task) -> bool:
    """Return whether two tasks are one: the same object, or values that are equal.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> same_task(GridWorld("S.T"), GridWorld("S.T")), same_task(GridWorld("S.T"), GridWorld("ST"))
    (True, False)
    """
    return one is other or one == other
