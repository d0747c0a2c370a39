"""The tables of a study: as a file writes them, and as they are with all settings filled in."""

import re
from typing import Annotated, Any, Self

from pydantic import (
    BeforeValidator,
    Field,
    WrapValidator,
    model_validator,
)

from curricle.checks import BEYOND_64_BITS
from curricle.learning.seeds import MOST_SEEDS
from curricle.study.config.families import FamilyTable, FamilyTask
from curricle.study.config.settings import AnyLearner, Settings
from curricle.study.config.tables import (
    Count,
    Flag,
    KeyPath,
    Name,
    Number,
    Table,
    Whole,
    as_table,
    shown,
    wrong,
    wrong_at,
)
from curricle.study.config.tasks import TASKS, AnyTask
from curricle.study.config.transfers import TransferTable


def _seeds(value: Any) -> tuple[int, ...]:
    """Return 30, [0, 1, 7] or "0-9,20-29" as seeds."""
    numbers: Any = _ranges(value) if isinstance(value, str) else value
    if type(numbers) is int:
        numbers = range(min(numbers, MOST_SEEDS + 1))
    listed = isinstance(numbers, list | tuple | range) and 0 < len(numbers) <= MOST_SEEDS
    whole = listed and all(type(n) is int and 0 <= n < BEYOND_64_BITS for n in numbers)
    if not whole or len(set(numbers)) < len(numbers):
        raise wrong(
            'must be a number of seeds, a list of different ones, or ranges such as "0-9,20-29", '
            f"{MOST_SEEDS:,} at most: got {shown(value)}"
        )
    return tuple(numbers)


def _ranges(text: str) -> list[int]:
    """Return the seeds in ranges such as "0-9,20-29"; none if malformed or far too many."""
    numbers = list[int]()
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d{1,18})\s*(?:-\s*(\d{1,18})\s*)?", part, re.ASCII)
        named = range(int(match[1]), int(match[2] or match[1]) + 1) if match else range(0)
        if not 0 < len(named) <= MOST_SEEDS:
            return []
        numbers += named
    return numbers


Unvalidated = WrapValidator(lambda value, _: as_table(value))
"""A table that is validated only once it is complete, but is in the JSON Schema."""


class RunTable(Table):
    """How a study is run and read: its top-level keys that are no settings of tasks."""

    name: Name = Field(description="Name of the study.")
    seeds: Annotated[
        tuple[int, ...], BeforeValidator(_seeds, json_schema_input_type=int | str | list[int])
    ] = Field(default=tuple(range(30)), description='How many, a list, or ranges such as "0-29".')
    seeds_per_unit: Count = Field(
        default=5, description="Seeds trained together as one unit of work."
    )
    threshold: Number | None = Field(
        default=None, description="Return at which the target counts as learnt."
    )
    window: Count = Field(default=5, description="Checkpoints over which curves are smoothed.")
    snapshots: Whole = Field(
        24, ge=0, description="Value tables of the first seed kept during training, for the report."
    )
    scratch: Flag = Field(
        default=True, description="Whether learning the target from scratch is an arm too."
    )
    scratch_learners: dict[Name, AnyLearner] = Field(
        default={},
        description="Further learners from scratch by name, each what it changes in the target's.",
    )


class ArmTables(Table):
    """The curriculum of one arm: tasks, each with all its settings, and transfers."""

    tasks: dict[str, AnyTask] = Field(min_length=1)
    transfers: tuple[TransferTable, ...] = ()

    @model_validator(mode="after")
    def _all_fits(self) -> Self:
        """Refuse keys for observations in tables' tasks and transfers, and vice versa."""
        found: list[tuple[KeyPath, str]] = []
        for name, task in self.tasks.items():
            found += [(("tasks", name, *path), text) for path, text in task.mismatches(name)]
        for index, transfer in enumerate(self.transfers):
            if not {transfer.source, transfer.target} <= self.tasks.keys():
                continue  # reported with the names
            here, target = ("transfers", index), self.tasks[transfer.target]
            if self.tasks[transfer.source].deep and not target.deep:
                text = f"must have tables as its target has: {transfer.source} is seen through "
                found.append(((*here, "source"), text + "observations"))
            strangers = [
                one
                for one in (transfer.source, transfer.target)
                if not isinstance(self.tasks[one], FamilyTask)
            ]
            if transfer.mapping == "family" and strangers:
                text = f"must map members of a family: {strangers[0]} is none"
                found.append(((*here, "mapping"), text))
            mismatches = transfer.mismatches(deep=target.deep)
            found += [((*here, key), text) for key, text in mismatches]
        if found:
            raise wrong_at(*found)
        return self

    @classmethod
    def known(cls) -> tuple[str, ...]:
        """Return the keys that a file may give an arm, settings for all tasks included."""
        return (*cls.model_fields, *Settings.model_fields)


class ArmPatch(Settings):
    """An arm as written: what it changes in the study's curriculum."""

    tasks: dict[str, dict[str, Any]] = Field(default={}, description="Changes of tasks, by name.")
    transfers: list[int] | list[TransferTable] | dict[str, dict[str, Any]] = Field(
        default=[],
        description="Which of the study's transfers to keep, by number from 0; others instead; or "
        "changes of some, by number.",
    )


class FileTable(RunTable, Settings):
    """A study as it is written in a file."""

    families: dict[str, FamilyTable] = Field(
        default={}, description="Families of tasks by name, each with defaults of its own."
    )
    tasks: dict[str, Annotated[AnyTask, Unvalidated]] = Field(
        description="The tasks by name, each with settings of its own.", min_length=1
    )
    transfers: tuple[TransferTable, ...] = Field(
        default=(), description="The transfers between tasks."
    )
    scratch_learners: dict[Name, Annotated[AnyLearner, Unvalidated]] = Field(
        default={},
        description="Further learners from scratch by name, each what it changes in the target's.",
    )
    arms: dict[str, Annotated[ArmPatch, Unvalidated]] = Field(
        default={}, description="What is compared: by name, what each changes; one arm by default."
    )


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of study files, for editors that complete and check TOML.

    Examples
    --------
    >>> schema = json_schema()
    >>> schema["properties"]["scratch"]["description"]
    'Whether learning the target from scratch is an arm too.'
    """
    schema = FileTable.model_json_schema()
    for table in schema["$defs"].values():
        if table.get("title") in _TASK_TITLES:
            # An arm may give what a task leaves open, but for its type.
            table["required"] = ["family" if table["title"] == FamilyTask.__name__ else "type"]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "Curricle study",
    }


_TASK_TITLES = {task.__name__ for task in TASKS}
