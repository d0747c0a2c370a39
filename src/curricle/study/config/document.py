"""Studies as data: how one is written in a file, and how it is when nothing is left to resolve."""

import re
from collections.abc import Iterator
from typing import Annotated, Any, Self

from pydantic import (
    BeforeValidator,
    Field,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    model_validator,
)

from curricle.study.config.settings import Settings
from curricle.study.config.tables import (
    Count,
    Flag,
    Name,
    Number,
    Place,
    Table,
    Whole,
    all_wrong,
    shown,
    wrong,
)
from curricle.study.config.tasks import TASKS, AnyTask
from curricle.study.config.transfers import TransferTable

MOST_SEEDS = 100_000


def _seeds(value: Any) -> tuple[int, ...]:
    """Return 30, [0, 1, 7] or "0-9,20-29" as seeds."""
    numbers: Any = _spelt(value) if isinstance(value, str) else value
    if type(numbers) is int:
        numbers = range(numbers)
    listed = isinstance(numbers, list | tuple | range) and 0 < len(numbers) <= MOST_SEEDS
    whole = listed and all(type(n) is int and n >= 0 for n in numbers)
    if not whole or len(set(numbers)) < len(numbers):
        raise wrong(
            'must be a number of seeds, a list of different ones, or ranges such as "0-9,20-29", '
            f"{MOST_SEEDS:,} at most: got {shown(value)}"
        )
    return tuple(numbers)


def _spelt(text: str) -> list[int]:
    """Return the seeds that ranges name; none where they make no sense, or name far too many."""
    numbers = list[int]()
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d{1,18})\s*(?:-\s*(\d{1,18})\s*)?", part, re.ASCII)
        named = range(int(match[1]), int(match[2] or match[1]) + 1) if match else range(0)
        if not 0 < len(named) <= MOST_SEEDS:
            return []
        numbers += named
    return numbers


class Running(Table):
    """How a study is run and read."""

    name: Name = Field(description="What the study is called.")
    seeds: Annotated[
        tuple[int, ...], BeforeValidator(_seeds, json_schema_input_type=int | str | list[int])
    ] = Field(default=tuple(range(30)), description='How many, a list, or ranges such as "0-29".')
    seeds_per_unit: Count = Field(
        default=5, description="Seeds trained together as one unit of work."
    )
    threshold: Number | None = Field(default=None, description="Return that counts as learnt.")
    window: Count = Field(default=5, description="Checkpoints over which curves are smoothed.")
    snapshots: Whole = Field(
        24, description="Tables of the first seed kept on the way, to be watched in the report."
    )
    scratch: Flag = Field(
        default=True, description="Whether learning the target directly is an arm too."
    )


class Plan(Table):
    """A curriculum as data: tasks, each with all its settings, and transfers."""

    tasks: dict[str, AnyTask] = Field(min_length=1)
    transfers: tuple[TransferTable, ...] = ()

    @model_validator(mode="after")
    def _all_fits(self) -> Self:
        if found := list(self._misfits()):
            raise all_wrong(found)
        return self

    def _misfits(self) -> Iterator[tuple[Place, str]]:
        """Yield what does not go with tables, or with observations."""
        for name, task in self.tasks.items():
            for place, text in task.misfits(name):
                yield ("tasks", name, *place), text
        for index, transfer in enumerate(self.transfers):
            if not {transfer.source, transfer.target} <= self.tasks.keys():
                continue  # which is said elsewhere
            source, target = self.tasks[transfer.source], self.tasks[transfer.target]
            if source.deep and not target.deep:
                yield (
                    ("transfers", index, "source"),
                    f"must have tables as its target has: {transfer.source} is seen through "
                    "observations",
                )
            for key, text in transfer.misfits(deep=target.deep):
                yield ("transfers", index, key), text

    @classmethod
    def known(cls) -> tuple[str, ...]:
        """Return the keys that a file may give a curriculum, settings for all tasks included."""
        return (*cls.model_fields, *Settings.model_fields)


class Document(Running):
    """A study of which nothing is left to resolve: every arm is complete, every map is there.

    Two files that mean the same are the same document, and a study's results depend on nothing
    else but the modules of its own functions.
    """

    arms: dict[str, Plan]


def _as_table(value: Any, _: ValidatorFunctionWrapHandler) -> Any:
    if not isinstance(value, dict):
        raise wrong(f"must be a table: got {shown(value)}")
    return value


Later = WrapValidator(_as_table)
"""A table that is validated when what it leaves open has been filled in."""


class Patch(Settings):
    """An arm as written: a part of a curriculum that takes the place of the study's."""

    tasks: dict[str, dict[str, Any]] = Field(default={}, description="Changes of tasks, by name.")
    transfers: list[int] | list[TransferTable] | dict[str, dict[str, Any]] = Field(
        default=[],
        description="Which of the study's transfers to keep, by number from 0; others instead; or "
        "changes of some, by number.",
    )


class Written(Running, Settings):
    """A study as it is written in a file."""

    tasks: dict[str, Annotated[AnyTask, Later]] = Field(
        description="The tasks by name, each with settings of its own.", min_length=1
    )
    transfers: tuple[TransferTable, ...] = Field(
        default=(), description="What is handed on, and how."
    )
    arms: dict[str, Annotated[Patch, Later]] = Field(
        default={}, description="What is compared: by name, what each changes; one arm by default."
    )


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of study files, for editors that complete and check TOML.

    Examples
    --------
    >>> schema = json_schema()
    >>> schema["properties"]["scratch"]["description"]
    'Whether learning the target directly is an arm too.'
    """
    schema = Written.model_json_schema()
    for table in TASKS:
        # An arm may give what a task leaves open, but for its type.
        schema["$defs"][table.__name__]["required"] = ["type"]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "Curricle study",
    }
