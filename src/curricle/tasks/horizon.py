"""A task's discount and time limit, which every kind of task checks alike."""

from typing import Any

from curricle.checks import number, whole_number
from curricle.errors import TaskError

LONGEST = 10**12
"""Steps a time limit may have at most."""


def check_horizon(task: Any) -> None:
    """Check a frozen task's discount and time limit, and make them a float and an int."""
    object.__setattr__(
        task, "discount", number("discount", task.discount, TaskError, low=0, high=1)
    )
    if task.time_limit is not None:
        limit = whole_number("time_limit in steps", task.time_limit, 1, TaskError)
        number("time_limit in steps", limit, TaskError, high=LONGEST)
        object.__setattr__(task, "time_limit", limit)
