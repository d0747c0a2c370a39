"""Tasks as tables: mazes, crops of mazes, pursuits, Gymnasium's, and a user's own."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    JsonValue,
    ValidationInfo,
    model_validator,
)

from curricle.interop.gymnasium import observation_task
from curricle.study.config.references import Call, load, users_code
from curricle.study.config.tables import (
    Flag,
    Name,
    Number,
    Table,
    Whole,
    by_type,
    either,
    no_table,
    shown,
    whole_number,
    wrong,
    wrong_at,
)
from curricle.study.config.task_table import Reference, TaskTable, TimeLimit

Cell = tuple[Whole, Whole]


class RewardsTable(Table):
    """What a step in a maze pays, by what the entered cell holds."""

    step: Number = Field(default=-1.0, description="Paid by every step.")
    treasure: Number = Field(default=200.0, description="Paid on entering a treasure's cell.")
    fire: Number = Field(default=-500.0, description="Paid on entering a fire's cell.")
    near_fire: Number = Field(default=-250.0, description="Paid on entering a cell next to a fire.")
    pit: Number = Field(default=-2500.0, description="Paid on entering a pit's cell.")
    bump: Number = Field(default=0.0, description="Paid when the edge or a wall is in the way.")


def _start(value: Any) -> Any:
    if isinstance(value, str) and value not in ("map", "uniform"):
        raise wrong(f"must be 'map', 'uniform' or a list of cells: got {value!r}")
    return value


def _in_order(value: Any) -> Any:
    """Return what is a set, but written as a list, in one order."""
    return tuple(sorted(set(value))) if isinstance(value, tuple) else value


Start = Annotated[
    Literal["map", "uniform"] | tuple[Cell, ...], BeforeValidator(_start), AfterValidator(_in_order)
]
Ends = Annotated[tuple[Literal["treasure", "pit", "fire"], ...], AfterValidator(_in_order)]


def _without_margins(drawing: str) -> str:
    return "\n".join(line.strip() for line in drawing.strip().splitlines())


class MazeTask(TaskTable):
    """A maze drawn as text."""

    type: Literal["maze"] = "maze"
    map: Annotated[str, AfterValidator(_without_margins)] = Field(
        description="The drawing, north on top: S start, T treasure, F fire, P pit, # wall, . free."
    )
    file: str | None = Field(
        default=None, description="A text file with the map instead, relative to the study file."
    )
    rewards: RewardsTable = Field(default=RewardsTable(), description="What a step pays.")
    combine: Literal["sum", "worst"] = Field(
        default="sum", description="Whether rewards add up or the worst one counts."
    )
    ends: Ends = Field(
        default=("pit", "treasure"), description="Objects whose entry ends the episode."
    )
    start: Start = Field(
        default="map", description="'map' (the S cells), 'uniform', or [row, column] cells."
    )
    representation: Literal["absolute", "relative"] = Field(
        default="absolute",
        description="The agent's row and column, or where objects lie relative to it.",
    )
    origin: Cell = Field(default=(0, 0), description="Row and column of the top-left cell.")
    discount: Number = Field(default=0.99, description="In [0, 1].")
    time_limit: TimeLimit = Field(
        default=200, description="Steps after which an episode is cut, or 'none'."
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

    def build(self, folder: Path, task: Callable[[str], Any]) -> Any:
        """Return the maze."""
        from curricle.tasks.gridworld import GridWorld, Rewards

        rules = {key: value for key, value in self.rules().items() if key != "file"}
        return GridWorld(**{**rules, "rewards": Rewards(**dict(self.rewards))})


def _text(name: Any, folder: Path) -> str:
    """Return what a file beside the study file says."""
    if not isinstance(name, str):
        raise wrong_at(("file",), f"must be text in quotes: got {shown(name)}", name)
    try:
        return (folder / name).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "not UTF-8"
        raise wrong_at(("file",), f"cannot be read: {name}, {why}", name) from None


class CropTask(TaskTable):
    """A part of a maze of the study; all else is as there."""

    type: Literal["crop"] = "crop"
    of: Name = Field(description="The maze (or crop) it is a part of, by its name in [tasks].")
    rows: Cell = Field(
        description="First row and the one after the last, in the map's coordinates."
    )
    columns: Cell = Field(description="First column and the one after the last.")
    start: Start = Field(default="uniform", description="As in a maze.")

    def build(self, folder: Path, task: Callable[[str], Any]) -> Any:
        """Return the part of the maze."""
        return task(self.of).crop(rows=self.rows, columns=self.columns, start=self.start)


def _capture(value: Any) -> Any:
    if value in ("all", "any", "as_published"):
        return value
    if isinstance(value, str):
        raise wrong(f"must be 'all', 'any', 'as_published' or a number of predators: got {value!r}")
    return whole_number(value)


def _prey(value: Any) -> Any:
    if isinstance(value, str) and value != "uniform" and ":" not in value:
        raise wrong(
            "must be 'uniform', rows of probabilities, or a function as module:function: got "
            f"{value!r}"
        )
    return value


class PursuitRules(TaskTable):
    """Predators and a prey on a grid, however they are seen."""

    size: Whole = Field(default=4, description="Cells per side.")
    predators: Whole = Field(default=2, description="How many hunt.")
    moves: Literal[4, 5] = Field(default=5, description="North, east, south, west; 5 adds staying.")
    torus: Flag = Field(default=False, description="Whether the grid wraps round.")
    capture: Annotated[Literal["all", "any", "as_published"] | int, BeforeValidator(_capture)] = (
        Field(default="all", description="How many predators must stand on the prey's cell.")
    )
    prey: Annotated[str | tuple[tuple[Number, ...], ...], BeforeValidator(_prey)] = Field(
        default="uniform",
        description="Its policy: 'uniform', rows of move probabilities for each cell (or state), "
        "or a function from decoded states to such rows as module:function.",
    )
    step_reward: Number = Field(
        default=-1.0, description="Paid by a step that does not catch the prey."
    )
    capture_reward: Number = Field(default=0.0, description="Paid by one that does.")
    discount: Number = Field(default=0.99, description="In [0, 1].")
    time_limit: TimeLimit = Field(
        default=200, description="Steps after which an episode is cut, or 'none'."
    )

    def build(self, folder: Path, task: Callable[[str], Any]) -> Any:
        """Return the pursuit."""
        from curricle.tasks.pursuit import Pursuit

        own = isinstance(self.prey, str) and ":" in self.prey
        prey = load(str(self.prey), folder) if own else self.prey
        rules = {name: value for name, value in self.rules().items() if name != "acting"}
        return Pursuit(**{**rules, "prey": prey})


class PursuitTask(PursuitRules):
    """Predators and a prey on a grid."""

    type: Literal["pursuit"] = "pursuit"


class VectorPursuitTask(PursuitRules):
    """Predators and a prey on a grid, seen as vectors of numbers by a deep learner."""

    type: Literal["vector_pursuit"] = "vector_pursuit"
    deep: ClassVar[bool] = True
    acting: Literal["all", "first"] = Field(
        default="all", description="Who acts: all predators as one, or the first among random ones."
    )

    def build(self, folder: Path, task: Callable[[str], Any]) -> Any:
        """Return the pursuit as a task seen through observations."""
        from curricle.interop.vector_pursuit import observed_pursuit

        return observed_pursuit(super().build(folder, task), acting=self.acting)


class GymnasiumTask(TaskTable):
    """An environment of Gymnasium's registry."""

    type: Literal["gymnasium"] = "gymnasium"
    id: Name = Field(description="Such as FrozenLake-v1.")
    arguments: dict[str, JsonValue] = Field(default={}, description="Passed to gymnasium.make.")
    discount: Number = Field(default=0.99, description="In [0, 1].")
    time_limit: TimeLimit | None = Field(
        default=None,
        description="Steps after which an episode is cut, or 'none'; the environment's own.",
    )
    encode: Reference | None = Field(
        default=None, description="A function from observations to states, as module:function."
    )

    def build(self, folder: Path, task: Callable[[str], Any]) -> Any:
        """Return the environment as a task."""
        from curricle.interop.gymnasium import from_gymnasium

        options: dict[str, Any] = {"discount": self.discount}
        if self.time_limit is not None:
            options["time_limit"] = self.rules()["time_limit"]
        if self.encode is not None:
            options["encode"] = load(self.encode, folder)
        return from_gymnasium(self.id, **options, **dict[str, Any](self.arguments))


class ObservationTask(TaskTable):
    """An environment whose observations a deep learner sees: of Gymnasium's, or one's own."""

    type: Literal["observed"] = "observed"
    deep: ClassVar[bool] = True
    id: Name | None = Field(default=None, description="Such as CartPole-v1.")
    factory: Reference | None = Field(
        default=None,
        description="Instead: a function that returns a new environment, module:function.",
    )
    arguments: dict[str, JsonValue] = Field(
        default={}, description="Passed to gymnasium.make, or to the function, by name."
    )
    discount: Number = Field(default=0.99, description="In [0, 1].")
    time_limit: Whole | None = Field(
        default=None, description="Steps after which an episode is cut; the environment's own."
    )

    @model_validator(mode="after")
    def _one_environment(self) -> Self:
        if (self.id is None) == (self.factory is None):
            found = "neither" if self.id is None else "both"
            raise wrong(f"must have id or factory: got {found}")
        return self

    def build(self, folder: Path, task: Callable[[str], Any]) -> Any:
        """Return the environment as a task seen through observations."""
        options: dict[str, Any] = {"discount": self.discount, "time_limit": self.time_limit}
        if self.id is not None:
            return observation_task(self.id, **options, **dict[str, Any](self.arguments))
        own = str(self.factory)
        make = Call(load(own, folder), dict(self.arguments))
        with users_code(own):
            return observation_task(make, **options)


class FactoryTask(TaskTable):
    """A task that a function of the user's makes."""

    type: Literal["factory"] = "factory"
    factory: Reference = Field(description="The function that returns the task, module:function.")
    arguments: dict[str, JsonValue] = Field(default={}, description="Passed to it by name.")

    def build(self, folder: Path, task: Callable[[str], Any]) -> Any:
        """Return what the function returns, if it is a task."""
        from curricle.tasks.task import generative_model

        make = load(self.factory, folder)
        with users_code(self.factory):
            made = make(**self.arguments)
            generative_model(made)
        return made


TASKS = (
    MazeTask,
    CropTask,
    PursuitTask,
    GymnasiumTask,
    FactoryTask,
    ObservationTask,
    VectorPursuitTask,
)
AnyTask = Annotated[
    MazeTask
    | CropTask
    | PursuitTask
    | GymnasiumTask
    | FactoryTask
    | ObservationTask
    | VectorPursuitTask,
    either(by_type(*TASKS), no_table),
]
