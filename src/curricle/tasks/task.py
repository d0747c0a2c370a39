"""Tasks: the properties that learning, planning and mapping need of any object."""

from typing import Any, Protocol

from curricle.arrays import BoolArray
from curricle.errors import TaskError
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.spaces import Space


class Task(Protocol):
    """A task to learn, solve and map: it has spaces and converts to tables."""

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
    """What learning needs of a task: spaces, horizon, and a generative model for compiled loops.

    `terminal`, (S,) bool, is None where it is unknown.
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
    def terminal(self) -> BoolArray | None: ...  # noqa: D102
    @property
    def model(self) -> Any: ...  # noqa: D102


def generative_model(task: Any) -> GenerativeModel:
    """Return a task that has a generative model as it is, the tables of any other."""
    generative: GenerativeModel = (
        task if isinstance(getattr(task, "model", None), tuple) else tables(task)
    )
    return generative


def has_tables(task: Any) -> bool:
    """Return whether a task can be converted to tables (if they fit)."""
    return hasattr(type(task), "mdp") or "mdp" in getattr(task, "__dict__", {})


def tables(task: Any) -> FiniteMDP:
    """Return the tables of a task, or raise TaskError if it is none."""
    mdp = getattr(task, "mdp", None)
    if not isinstance(mdp, FiniteMDP):
        if isinstance(getattr(task, "model", None), tuple):
            raise TaskError(f"a task given by functions or played live has no tables: {task!r}")
        raise TaskError(
            f"a task must be a FiniteMDP or have its tables as .mdp: got {task!r}{_advice(task)}"
        )
    return mdp


def _advice(task: Any) -> str:
    """Return what was probably meant by what is no task with tables, as the end of a sentence."""
    if isinstance(task, type):
        return "; give a task of this class, not the class" if hasattr(task, "mdp") else ""
    if hasattr(task, "task"):
        return ", whose task is its .task"
    if isinstance(task, str) or (hasattr(task, "reset") and hasattr(task, "step")):
        return "; from_gymnasium makes a task of an environment or of its id"
    if hasattr(type(task), "observations") and hasattr(type(task), "environment"):
        return "; what is seen through observations is learnt by a network, a deep.DeepLearner"
    return ""


def same_task(one: Task, other: Task) -> bool:
    """Return whether two tasks are the same: one object, or equal values."""
    return one is other or one == other
