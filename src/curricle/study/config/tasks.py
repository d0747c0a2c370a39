"""The tables of a study file for tasks of every type."""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    JsonValue,
    ValidationInfo,
    model_validator,
)

from curricle.deep.miniature import HELD_OUT, MOST_STATES, RESETS, miniatures
from curricle.errors import ConfigError, TaskError
from curricle.interop.gymnasium import from_gymnasium, observation_task
from curricle.interop.tabulation import tabulate
from curricle.planning.solution import solve, visit_distribution
from curricle.study.config.settings import SHAPINGS, Settings
from curricle.study.config.tables import (
    AnyEncoder,
    Choice,
    Count,
    Flag,
    KeyPath,
    Name,
    Number,
    ObjectTable,
    Reference,
    Table,
    Whole,
    encoder,
    load,
    shown,
    suggestion,
    table,
    table_of,
    tagged,
    text_of,
    unknown,
    users_code,
    whole_number,
    word,
    wrong,
    wrong_at,
)
from curricle.tasks.block_dude import BlockDude
from curricle.tasks.built_in import BUILT_IN
from curricle.tasks.deep_sea import DeepSea
from curricle.tasks.domain import MOVES
from curricle.tasks.family import FamilyMember, TaskFamily
from curricle.tasks.four_rooms import FourRooms
from curricle.tasks.frozen_lake import FrozenLake
from curricle.tasks.gridworld import GridWorld
from curricle.tasks.key_lock_pit import KeyLockPit
from curricle.tasks.mdp import generative_model
from curricle.tasks.observation_task import EnvironmentMaker
from curricle.tasks.pursuit import Pursuit
from curricle.tasks.river_swim import RiverSwim
from curricle.tasks.start_states import GoalDistance, TaskWithStart, with_start

# -- Start states of a task in a study file: a ring around its goal, reachable ones, or visits -----

WORDS = ("uniform", "reachable")


def _distance(value: Any) -> tuple[int, int]:
    """Return a range of distances; one number is a range."""
    given = value if isinstance(value, list | tuple) else (value, value)
    if len(given) != 2:
        raise wrong(f"must be a number of steps, or the lowest and the highest: got {shown(value)}")
    low, high = (whole_number(one) for one in given)
    if not 0 <= low <= high:
        raise wrong(f"must be steps from low to high, at least 0: got {shown(value)}")
    return low, high


class StartTable(Table):
    """Where episodes start instead."""

    distance: Annotated[
        tuple[int, int] | None, BeforeValidator(_distance, json_schema_input_type=int | list[int])
    ] = Field(
        default=None,
        description="Steps to the goal, or the fewest and the most: a ring around the goal.",
    )
    goal: dict[str, JsonValue] | None = Field(
        default=None,
        description="With distance: the goal by components, each a value, a label or a list; by "
        "default the ends that are entered with the largest reward.",
    )
    visits: Literal["random", "optimal"] | None = Field(
        default=None, description="Where the random or the optimal policy goes, as often as there."
    )

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if (self.distance is None) == (self.visits is None):
            raise wrong(f"must have distance or visits: got {'both' if self.visits else 'neither'}")
        if self.goal is not None and self.distance is None:
            raise wrong("has a goal, which goes with distance")
        return self


def _word(value: Any) -> str:
    if value not in WORDS:
        raise wrong(
            "must be 'uniform', 'reachable', or a table with distance or visits: got "
            f"{shown(value)}{suggestion(value, WORDS)}"
        )
    return str(value)


StartStates = Annotated[Any, Choice((StartTable,), lambda _: StartTable, _word, str)]


def started(task: Any, start: Any) -> Any:
    """Return a task that starts where a file says; itself where the file says nothing."""
    if start is None:
        return task
    if isinstance(start, str):
        return with_start(task, start)
    if start.distance is not None:
        low, high = start.distance
        return with_start(task, GoalDistance(low, high, start.goal))
    policy = None if start.visits == "random" else solve(task).policy
    return with_start(task, visit_distribution(task, policy))


# -- What the tables of all tasks share: settings of a task alone, and whether they suit it --------


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


# -- Tasks that are environments: Gymnasium's or one's own, in tables or seen by networks ----------

TimeLimit = Annotated[
    int | Literal["none"], word("be a whole number, or 'none'", ("none",), other=whole_number)
]


class Maker(Table):
    """An environment of Gymnasium's, or one's own."""

    id: Name | None = Field(default=None, description="Of Gymnasium's registry: CartPole-v1.")
    factory: Reference | None = Field(
        default=None,
        description="Instead: a class or function of one's own that makes it, module:Class.",
    )
    arguments: dict[str, JsonValue] = Field(
        default={}, description="Passed by name to gymnasium.make, or to the class or function."
    )

    @model_validator(mode="after")
    def _one_environment(self) -> Self:
        if (self.id is None) == (self.factory is None):
            found = "neither" if self.id is None else "both"
            raise wrong(f"must have id or factory: got {found}")
        return self

    def made_by(
        self, make: Callable[..., Any], folder: Path, wrapped: Any = None, **options: Any
    ) -> Any:
        """Return what a function of the library makes of the environment.

        `wrapped` is an encoder of its observations, as a study file has it.
        """
        own = str(self.id or self.factory)
        what = self.id or load(own, folder)
        maker = EnvironmentMaker(what, dict(self.arguments), encoder(wrapped, folder))
        with users_code(own):
            try:
                return make(maker, **options)
            except TaskError as error:
                if self.factory or ":" not in own or re.search(r"-v\d+$", own):
                    raise
                hint = "a class or function of your own is named by factory, not by id"
                raise TaskError(f"{error}; {hint}") from error


Names = tuple[Name, ...] | None


class GymnasiumTask(Maker, TaskTable):
    """An environment of Gymnasium's registry, or one's own."""

    type: Literal["gymnasium"] = "gymnasium"
    discount: Number = Field(default=0.99, description="In [0, 1].")
    time_limit: TimeLimit | None = Field(
        default=None,
        description="Steps after which an episode is cut, or 'none'; the environment's own.",
    )
    names: Names = Field(
        default=None, description="Of a state's components, the numbers in an observation."
    )
    sizes: tuple[Count, ...] | None = Field(
        default=None,
        description="How many values each has, where an observation is one number.",
    )
    actions: Names = Field(
        default=None,
        description="A label for each action; north, east, south and west are drawn as arrows.",
    )
    encode: Reference | None = Field(
        default=None,
        description="A function from observations to states, module:function, with its states as "
        "its attribute.",
    )
    live: Flag | None = Field(  # None is not stored, so that keys of older results stay
        default=None, description="Whether to call step for every step even if there is a table."
    )

    def build(self, folder: Path = Path(), whole: Any = None) -> Any:
        """Return the environment as a task."""
        given: dict[str, Any] = {"names": self.names, "sizes": self.sizes, "actions": self.actions}
        given |= {"discount": self.discount, "live": bool(self.live)}
        if self.encode is not None:
            given["encode"] = load(self.encode, folder)
        return self.made_by(from_gymnasium, folder, time_limit=_limit(self.time_limit), **given)


def _limit(given: int | str | None) -> Any:
    """Return a time limit as Python takes it."""
    limits: dict[Any, Any] = {None: "own", "none": None}
    return limits.get(given, given)


class EnvironmentTable(Maker, TaskTable):
    """An environment as a task."""

    discount: Number = Field(default=0.99, description="In [0, 1].")
    encode: AnyEncoder | None = Field(
        default=None,
        description="An encoder of its observations: its name, a table, or module:function.",
    )


class TabulatedTaskTable(EnvironmentTable):
    """An environment as exact tables of every state that can be reached."""

    type: Literal["tabulated"] = "tabulated"
    time_limit: TimeLimit | None = Field(
        default=None,
        description="Steps after which an episode is cut, or 'none'; the environment's own.",
    )
    names: Names = Field(default=None, description="Other names for a state's components.")
    actions: Names = Field(default=None, description="A label for each action.")
    reset_seeds: tuple[Whole, ...] = Field(
        default=(0,), description="Of the resets that starts are taken from."
    )
    outcomes: Reference | None = Field(
        default=None,
        description="Of random steps: a function of a state and an action, module:function.",
    )
    samples: Count | None = Field(
        default=None, description="Instead: steps that each pair's outcomes are estimated from."
    )
    cache: Name | None = Field(
        default=None, description="A file beside the study, which keeps the tables."
    )

    def build(self, folder: Path = Path(), whole: Any = None) -> Any:
        """Return the environment as tables."""
        return self.made_by(
            tabulate,
            folder,
            self.encode,
            discount=self.discount,
            time_limit=_limit(self.time_limit),
            names=self.names,
            actions=self.actions,
            seeds=self.reset_seeds,
            outcomes=None if self.outcomes is None else load(self.outcomes, folder),
            samples=self.samples,
            cache=None if self.cache is None else folder / self.cache,
        )


class ObservationTaskTable(EnvironmentTable):
    """An environment whose observations a network reads."""

    type: Literal["observation_task"] = "observation_task"
    deep: ClassVar[bool] = True
    time_limit: Whole | None = Field(
        default=None, description="Steps after which an episode is cut; the environment's own."
    )

    def build(self, folder: Path = Path(), whole: Any = None) -> Any:
        """Return the environment as a task seen through observations."""
        settings: Any = {"discount": self.discount, "time_limit": self.time_limit}
        return self.made_by(observation_task, folder, self.encode, **settings)


def _member(value: Any) -> Any:
    """Return an id as the table of a member."""
    return {"id": value} if isinstance(value, str) else value


Members = tuple[Annotated[Maker, BeforeValidator(_member, json_schema_input_type=str | Maker)], ...]


class DistilledTask(TaskTable):
    """Small relatives that are solved; a network is distilled from them in no steps.

    What their own sources say takes the place of exact answers, if transfers lead to them.
    """

    type: Literal["distilled"] = "distilled"
    deep: ClassVar[bool] = True
    members: Members = Field(
        min_length=1, description="Ids, or tables with id or factory, and arguments."
    )
    tested_on: Members = Field(
        default=(), description="Relatives that are only tested on, of growing size."
    )
    discount: Number = Field(default=0.99, description="In [0, 1].")
    encode: AnyEncoder | None = Field(
        default=None,
        description="An encoder of their observations: its name, a table, or module:function.",
    )
    time_limit: Whole | None = Field(
        default=None, description="Steps after which an episode is cut; the environments' own."
    )
    resets: Count = Field(default=RESETS, description="Of each member; alike levels count once.")
    held_out: Number = Field(default=HELD_OUT, description="Share of the levels that is held out.")
    max_states: Count = Field(default=MOST_STATES, description="Of each member.")
    shuffled: Flag = Field(
        default=False,
        description="Whether each observation has the answer of another: a placebo.",
    )

    def build(self, folder: Path = Path(), whole: Any = None) -> Any:
        """Return the miniatures; they are solved when they are first needed."""
        settings: Any = {"discount": self.discount, "time_limit": self.time_limit}
        members, tested_on = (
            [one.made_by(observation_task, folder, self.encode, **settings) for one in given]
            for given in (self.members, self.tested_on)
        )
        made = miniatures(
            *members,
            tested_on=tested_on,
            resets=self.resets,
            held_out=self.held_out,
            max_states=self.max_states,
        )
        return replace(made, shuffled=self.shuffled)


# -- Task families in a study file: tables that name one, and tasks that are members of one --------

NONE = "none"
"""What a file writes for None."""


class FamilyTable(Table):
    """A family of tasks with defaults of one's own; its other keys are parameters."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, JsonValue]

    family: str = Field(
        description=f"One of {', '.join(BUILT_IN)}, or one's own as module:function."
    )

    @model_validator(mode="after")
    def _known_parameters(self, info: ValidationInfo) -> Self:
        self.__pydantic_extra__.update(checked_parameters(self.family, self.__pydantic_extra__, ()))
        return self


def of_family(task: dict[str, Any], families: Mapping[str, Any]) -> dict[str, Any]:
    """Return a task as data with the table of the family that it names under it."""
    name = task.get("family")
    if not isinstance(name, str) or task.get("type", "family") != "family":
        return task
    own = table(families.get(name))
    defaults = {key: value for key, value in own.items() if key != "family"}
    return {**defaults, **task, "family": own.get("family", name), "type": "family"}


def checked_parameters(
    family: str, given: Mapping[str, Any], families: tuple[str, ...]
) -> dict[str, Any]:
    """Return parameters as a built-in family's members hold them, those of others as they are.

    `families` are the names of the study's own, for messages.
    """
    if ":" in family:  # its module is imported when the task is built
        return dict(given)
    if family not in BUILT_IN:
        known = (*families, *BUILT_IN)
        raise wrong_at(
            (
                ("family",),
                f"must be one of {', '.join(known)}, or a family of one's own as module:function: "
                f"got {shown(family)}{suggestion(family, known)}",
            )
        )
    return _checked_by(BUILT_IN[family], given)


def _checked_by(family: TaskFamily, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameters as a family's members hold them, or raise what is wrong at each key."""
    found, wrong = dict[str, Any](), list[tuple[KeyPath, str]]()
    by_name = {one.name: one for one in family.parameters}
    for name, value in given.items():
        if name not in by_name:
            wrong.append(((name,), unknown(name, by_name)))
            continue
        try:
            none = by_name[name].optional and value == NONE  # which data hold as it is written
            found[name] = NONE if none else by_name[name].checked(value, family.name)
        except TaskError as error:
            wrong.append(((name,), str(error).removeprefix(f"{name} of {family.name} ")))
    if wrong:
        raise wrong_at(*wrong)
    return found


def _own(reference: str, folder: Path) -> TaskFamily:
    found = load(reference, folder)
    if not isinstance(found, TaskFamily):
        raise ConfigError(
            f"{reference} must be a TaskFamily, such as a function under @task_family(): got "
            f"{found!r}"
        )
    taken = [one.name for one in found.parameters if one.name in FamilyTask.model_fields]
    if taken:
        raise ConfigError(
            f"{reference} has the parameter {taken[0]}, which is a key of every task in a file: "
            "give it another name"
        )
    return found


class FamilyTask(TaskTable):
    """A member of a task family; its other keys are the member's parameters."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, JsonValue]

    type: Literal["family"] = "family"
    family: str = Field(
        description="The name of a table in [families], of a family that is built in, or "
        "module:function."
    )

    @model_validator(mode="after")
    def _known_parameters(self, info: ValidationInfo) -> Self:
        families = (info.context or {}).get("families", ())
        given = checked_parameters(self.family, self.__pydantic_extra__, families)
        defaults = BUILT_IN[self.family].parameters if self.family in BUILT_IN else ()
        given = {**{one.name: one.default for one in defaults if not one.required}, **given}
        if self.family in BUILT_IN:
            given = {name: NONE if value is None else value for name, value in given.items()}
        self.__pydantic_extra__.update(given)
        return self

    def member(self, folder: Path) -> FamilyMember:
        """Return the address of the task in its family, which may be the user's own."""
        family = BUILT_IN.get(self.family) or _own(self.family, folder)
        optional = {one.name for one in family.parameters if one.optional}
        values = _checked_by(family, self.__pydantic_extra__).items()
        return family(**{k: None if v == NONE and k in optional else v for k, v in values})

    def build(self, folder: Path = Path(), whole: Any = None) -> Any:
        """Return the task that the family makes."""
        member = whole or self.member(folder)
        with users_code(self.family):
            task = member.task
        generative_model(task)
        return task


# -- Tasks: mazes, crops, pursuits, other domains, Gymnasium's environments, and a user's own ------

Pair = tuple[Whole, Whole]
CROPPED = (GridWorld, FourRooms, KeyLockPit, FrozenLake)
"""Tasks that lie on a map, of which a crop may be a part."""


def _in_order(value: Any) -> Any:
    """Return a list that stands for a set sorted, without repetitions."""
    return tuple(sorted(set(value))) if isinstance(value, tuple) else value


def _without_margins(drawing: str) -> str:
    return "\n".join(line.strip() for line in drawing.strip().splitlines())


def _cells_or(*words: str) -> Any:
    """Return the type of one of some words, or of a list of cells that stands for a set."""
    rule = f"be {', '.join(map(repr, words))} or a list of cells"
    cells = tuple[Pair, ...]
    return Annotated[
        Literal[words] | cells, word(rule, words, lists=cells), AfterValidator(_in_order)
    ]


Start: Any = _cells_or("map", "uniform")
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


def _task_table(makes: Any, tag: str, base: type[TaskTable] = TaskTable, **types: Any) -> Any:
    """Return the table of a task of the library's."""
    return table_of(makes, base, tag=tag, time_limit=TimeLimit, **types)


Map = Annotated[str, AfterValidator(_without_margins)]
MazeTask = _task_table(GridWorld, "maze", _MazeTask, map=Map, ends=Ends, start=Start)


def _level(value: Any) -> int | str:
    """Return a level's number, or its map without margins."""
    return _without_margins(value) if isinstance(value, str) else whole_number(value)


FourRoomsTask = _task_table(
    FourRooms,
    "four_rooms",
    goal=Annotated[
        Literal["north", "east", "south", "west"] | Pair,
        word("be a hallway or a list of a row and a column", tuple(MOVES), lists=Pair),
    ],
    start=_cells_or("corner", "uniform"),
)
KeyLockPitTask = _task_table(
    KeyLockPit,
    "key_lock_pit",
    _MazeTask,
    map=Map,
    needs=Annotated[
        Literal["all"] | tuple[tuple[Whole, ...], ...],
        word(
            "be 'all' or a list of keys for each lock",
            ("all",),
            lists=tuple[tuple[Whole, ...], ...],
        ),
    ],
    start=Start,
)
BlockDudeTask = _task_table(
    BlockDude, "block_dude", level=Annotated[int | str, BeforeValidator(_level)]
)
RiverSwimTask = _task_table(
    RiverSwim,
    "river_swim",
    start=Annotated[
        Literal["uniform"] | tuple[Whole, ...],
        word("be 'uniform' or a list of positions", ("uniform",), lists=tuple[Whole, ...]),
        AfterValidator(_in_order),
    ],
)
DeepSeaTask = _task_table(DeepSea, "deep_sea", start=_cells_or("surface", "uniform"))


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


PursuitTask = _task_table(
    Pursuit,
    "pursuit",
    _PursuitTask,
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
AnyTask = Annotated[
    Any,
    Choice(
        TASKS,
        lambda value: (
            FamilyTask if "family" in value and "type" not in value else _BY_TYPE.choose(value)
        ),
    ),
]
