"""What the tables of all tasks share: settings of a task alone, and whether they suit it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

from pydantic import Field

from curricle.study.config.derived_tables import ObjectTable
from curricle.study.config.settings import SHAPINGS, Settings
from curricle.study.config.start_states import StartStates
from curricle.study.config.tables import KeyPath


class TaskTable(ObjectTable, Settings):
    """A task, and settings for it alone."""

    deep: ClassVar[bool] = False
    """Whether it is seen through observations and learnt by a network."""

    start_states: StartStates = Field(
        default=None,
        description="Where episodes start instead: 'uniform', 'reachable', { distance = [1, 3] } "
        'from the goal, or { visits = "random" }.',
    )

    def mismatches(self, name: str) -> Iterator[tuple[KeyPath, str]]:
        """Yield the settings that do not suit the task `name`, each with what is wrong."""
        found = _mismatches_of_networks if self.deep else _mismatches_of_tables
        return found(self, name)

    def arguments_in(self, folder: Path) -> dict[str, Any]:
        """Return the arguments for what makes the task."""
        given = super().arguments_in(folder)
        if given.get("time_limit") == "none":
            given["time_limit"] = None
        return given

    def build(self, folder: Path = Path(), whole: Any = None) -> Any:
        """Return the task; `whole` is what a crop is a part of, or a member of a family."""
        return super().build(folder)


def _mismatches_of_networks(task: Settings, name: str) -> Iterator[tuple[KeyPath, str]]:
    """Yield the settings that do not suit a task that is learnt by a network."""
    if not task.deep_learner:
        yield (
            ("learner",),
            f'must be {{ type = "deep", ... }} for {name}, which is seen through observations and '
            "learnt by a network",
        )
    if task.shaping is not None and not task.shaping.makes.for_networks:
        known = ", ".join(one.__name__ for one in SHAPINGS if one.makes.for_networks)
        yield (
            ("shaping",),
            f"must be one of {known} for {name}, which a network learns: got {task.shaping.type!r}",
        )
    left_out = f"must be left out for {name}: it is for tables, and a network learns {name}"
    if getattr(task, "start_states", None) is not None:
        yield ("start_states",), left_out


def _mismatches_of_tables(task: Settings, name: str) -> Iterator[tuple[KeyPath, str]]:
    """Yield the settings that do not suit a task that is learnt in a table."""
    if task.deep_learner:
        yield (
            ("learner",),
            f'must be tabular for {name}, such as {{ type = "QLearning" }}: networks learn tasks '
            "seen through observations, of type 'observation_task'",
        )
    if task.shaping is not None and not task.shaping.makes.for_tables:
        yield ("shaping",), f"must be for tables, to learn {name}: got {task.shaping.type!r}"
