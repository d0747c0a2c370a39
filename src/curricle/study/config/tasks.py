"""Tasks: mazes, crops, pursuits, other domains, Gymnasium's environments, and a user's own."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    JsonValue,
    ValidationInfo,
    model_validator,
)

from curricle.errors import TaskError
from curricle.study.config.derived_tables import table_of
from curricle.study.config.environments import (
    DistilledTask,
    GymnasiumTask,
    ObservationTaskTable,
    TabulatedTaskTable,
    TimeLimit,
)
from curricle.study.config.families import FamilyTask
from curricle.study.config.parsing import text_of
from curricle.study.config.references import load, users_code
from curricle.study.config.tables import (
    Choice,
    Name,
    Number,
    Reference,
    Table,
    Whole,
    shown,
    tagged,
    whole_number,
    word,
    wrong,
    wrong_at,
)
from curricle.study.config.task_table import TaskTable
from curricle.tasks.block_dude import BlockDude
from curricle.tasks.deep_sea import DeepSea
from curricle.tasks.four_rooms import FourRooms
from curricle.tasks.frozen_lake import FrozenLake
from curricle.tasks.grid_layout import MOVES
from curricle.tasks.gridworld import GridWorld
from curricle.tasks.key_lock_pit import KeyLockPit
from curricle.tasks.pursuit import Pursuit
from curricle.tasks.river_swim import RiverSwim
from curricle.tasks.start_states import TaskWithStart
from curricle.tasks.task import generative_model

Pair = tuple[Whole, Whole]
CROPPED = (GridWorld, FourRooms, KeyLockPit, FrozenLake)
"""Tasks that lie on a map, of which a crop may be a part."""


def _in_order(value: Any) -> Any:
    """Return a list that stands for a set sorted, without repetitions."""
    return tuple(sorted(set(value))) if isinstance(value, tuple) else value


def _without_margins(drawing: str) -> str:
    return "\n".join(line.strip() for line in drawing.strip().splitlines())


Start = Annotated[
    Literal["map", "uniform"] | tuple[Pair, ...],
    word("be 'map', 'uniform' or a list of cells", ("map", "uniform"), lists=tuple[Pair, ...]),
    AfterValidator(_in_order),
]
Ends = Annotated[tuple[Literal["treasure", "pit", "fire"], ...], AfterValidator(_in_order)]


class _MazeTask(TaskTable):
    file: str | None = Field(
        default=None, description="A text file with the map instead, relative to the study file."
    )

    @model_validator(mode="before")
    @classmethod
    def _read_file(cls, data: Any, info: ValidationInfo) -> Any:
        """Put the map in its file's place, so that the study no longer depends on the file."""
        if not isinstance(data, dict) or data.get("file") is None:
            return data
        if "map" in data:
            raise wrong("has both map and file: one of them is enough")
        others = {key: value for key, value in data.items() if key != "file"}
        return {**others, "map": _text(data["file"], (info.context or {}).get("folder", Path()))}


def _text(name: Any, folder: Path) -> str:
    """Return the content of a text file beside the study file."""
    if not isinstance(name, str):
        raise wrong_at((("file",), f"must be text in quotes: got {shown(name)}"))
    try:
        return text_of(folder / name)
    except ValueError as error:
        raise wrong_at((("file",), f"cannot be read: {shown(name)}, {error}")) from None


MazeTask = table_of(
    GridWorld,
    _MazeTask,
    tag="maze",
    map=Annotated[str, AfterValidator(_without_margins)],
    ends=Ends,
    start=Start,
    time_limit=TimeLimit,
)


def _level(value: Any) -> int | str:
    """Return a level's number, or its map without margins."""
    return _without_margins(value) if isinstance(value, str) else whole_number(value)


FourRoomsTask = table_of(
    FourRooms,
    TaskTable,
    tag="four_rooms",
    goal=Annotated[
        Literal["north", "east", "south", "west"] | Pair,
        word("be a hallway or a list of a row and a column", tuple(MOVES), lists=Pair),
    ],
    start=Annotated[
        Literal["corner", "uniform"] | tuple[Pair, ...],
        word(
            "be 'corner', 'uniform' or a list of cells",
            ("corner", "uniform"),
            lists=tuple[Pair, ...],
        ),
        AfterValidator(_in_order),
    ],
    time_limit=TimeLimit,
)
KeyLockPitTask = table_of(
    KeyLockPit,
    _MazeTask,
    tag="key_lock_pit",
    map=Annotated[str, AfterValidator(_without_margins)],
    needs=Annotated[
        Literal["all"] | tuple[tuple[Whole, ...], ...],
        word(
            "be 'all' or a list of keys for each lock",
            ("all",),
            lists=tuple[tuple[Whole, ...], ...],
        ),
    ],
    start=Start,
    time_limit=TimeLimit,
)
BlockDudeTask = table_of(
    BlockDude,
    TaskTable,
    tag="block_dude",
    level=Annotated[int | str, BeforeValidator(_level)],
    time_limit=TimeLimit,
)
RiverSwimTask = table_of(
    RiverSwim,
    TaskTable,
    tag="river_swim",
    start=Annotated[
        Literal["uniform"] | tuple[Whole, ...],
        word("be 'uniform' or a list of positions", ("uniform",), lists=tuple[Whole, ...]),
        AfterValidator(_in_order),
    ],
    time_limit=TimeLimit,
)
DeepSeaTask = table_of(
    DeepSea,
    TaskTable,
    tag="deep_sea",
    start=Annotated[
        Literal["surface", "uniform"] | tuple[Pair, ...],
        word(
            "be 'surface', 'uniform' or a list of cells",
            ("surface", "uniform"),
            lists=tuple[Pair, ...],
        ),
        AfterValidator(_in_order),
    ],
    time_limit=TimeLimit,
)


# The tables below that are not derived stand for functions, some of whose parameters are a task, a
# function of the user's or free keyword arguments.


class CropTask(TaskTable):
    """A part of a maze, or of another task drawn as one, of the study; all else is as there."""

    type: Literal["crop"] = "crop"
    of: Name = Field(description="The task (or crop) it is a part of, by its name in [tasks].")
    rows: Pair = Field(
        description="First row and the one after the last, in the map's coordinates."
    )
    columns: Pair = Field(description="First column and the one after the last.")
    start: Start = Field(default="uniform", description="As in a maze.")

    def build(self, folder: Path = Path(), whole: Any = None) -> Any:
        """Return the part of the whole."""
        if isinstance(whole, TaskWithStart):
            whole = whole.task
        if not isinstance(whole, CROPPED):
            known = ", ".join(kind.__name__ for kind in CROPPED)
            raise TaskError(f"what a crop is a part of must be one of {known}: got {whole!r}")
        cropped: Any = whole
        return cropped.crop(rows=self.rows, columns=self.columns, start=self.start)


class _PursuitTask(TaskTable):
    def arguments_in(self, folder: Path) -> dict[str, Any]:
        """Return the arguments, a function that moves the prey loaded."""
        given = super().arguments_in(folder)
        if isinstance(given["prey"], str) and ":" in given["prey"]:
            given["prey"] = load(given["prey"], folder)
        return given


PursuitTask = table_of(
    Pursuit,
    _PursuitTask,
    tag="pursuit",
    capture=Annotated[
        Literal["all", "any", "as_published"] | int,
        word(
            "be 'all', 'any', 'as_published' or a number of predators",
            ("all", "any", "as_published"),
            other=whole_number,
        ),
    ],
    prey=Annotated[
        str | tuple[tuple[Number, ...], ...],
        word(
            "be 'uniform', rows of probabilities, or a function as module:function",
            ("uniform",),
            function=True,
            lists=tuple[tuple[Number, ...], ...],
        ),
    ],
    time_limit=TimeLimit,
)


class FactoryTask(TaskTable):
    """A task that a function of the user's makes."""

    type: Literal["factory"] = "factory"
    factory: Reference = Field(description="The function that returns the task, module:function.")
    arguments: dict[str, JsonValue] = Field(default={}, description="Passed to it by name.")

    def build(self, folder: Path = Path(), whole: Any = None) -> Any:
        """Return what the function returns, if it is a task."""
        make = load(self.factory, folder)
        with users_code(self.factory):
            made = make(**self.arguments)
            generative_model(made)
        return made


TASKS = (
    MazeTask,
    CropTask,
    PursuitTask,
    FourRoomsTask,
    KeyLockPitTask,
    BlockDudeTask,
    RiverSwimTask,
    DeepSeaTask,
    GymnasiumTask,
    TabulatedTaskTable,
    FactoryTask,
    FamilyTask,
    ObservationTaskTable,
    DistilledTask,
)
_BY_TYPE = tagged(*TASKS)


def _table_of_task(value: dict[str, Any]) -> type[Table]:
    """Return the table that a task is meant to be: by its type, or a member of a family."""
    return FamilyTask if "family" in value and "type" not in value else _BY_TYPE.choose(value)


AnyTask = Annotated[Any, Choice(TASKS, _table_of_task)]
