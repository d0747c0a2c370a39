"""The tables of a study: as a file writes them, and as they are with all settings filled in."""

from typing import Annotated, Any, Self

from pydantic import (
    BeforeValidator,
    Field,
    WrapValidator,
    model_validator,
)

from curricle.study.config.families import FamilyTable, FamilyTask
from curricle.study.config.seed_numbers import seeds_of
from curricle.study.config.settings import AnyLearner, Settings
from curricle.study.config.sweeps import SweepTable
from curricle.study.config.tables import (
    Count,
    Flag,
    KeyPath,
    Name,
    Number,
    Table,
    Whole,
    as_table,
    wrong_at,
)
from curricle.study.config.tasks import TASKS, AnyTask
from curricle.study.config.transfers import TransferTable
from curricle.study.config.tuning_tables import TuneTable

Unvalidated = WrapValidator(lambda value, _: as_table(value))
"""A table that is validated only once it is complete, but is in the JSON Schema."""


class RunTable(Table):
    """How a study is run and read: its top-level keys that are no settings of tasks."""

    name: Name = Field(description="Name of the study.")
    seeds: Annotated[
        tuple[int, ...], BeforeValidator(seeds_of, json_schema_input_type=int | str | list[int])
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
    sweep: SweepTable = Field(
        default=SweepTable(), description="Lists of settings, which make arms of every arm."
    )
    tune: TuneTable | None = Field(
        default=None, description="Settings that are searched for every arm before it is run."
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
