"""The tables of a study file for tasks of every type."""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar

from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    JsonValue,
    ValidationInfo,
    model_validator,
)

from curricle import tasks
from curricle.candidates.candidates import KINDS
from curricle.deep.miniature import miniatures
from curricle.errors import ConfigError, TaskError
from curricle.files import read_bounded
from curricle.interop.encoders import Bins, WholeNumbers
from curricle.interop.gymnasium import from_gymnasium, observation_task
from curricle.interop.states import DeepCopy
from curricle.interop.tabulation import tabulate
from curricle.planning.solution import solve, visit_distribution
from curricle.study_file.own_code import load, registered, suggestion, users_code
from curricle.study_file.schema import (
    SHAPINGS,
    AnyEncoder,
    Choice,
    Count,
    DeepLearnerTable,
    Flag,
    KeyPath,
    Name,
    Number,
    ObjectTable,
    Reference,
    Settings,
    Table,
    Whole,
    as_table,
    built,
    seeds_of,
    shown,
    table_of,
    unknown,
    whole_number,
    word,
    wrong,
    wrong_at,
)
from curricle.tasks.domain import Domain, GridDomain, MapDomain, name_of
from curricle.tasks.family import FamilyMember, TaskFamily, rules_of
from curricle.tasks.grid import MOVES
from curricle.tasks.gridworld import LEGENDS, GridWorld
from curricle.tasks.mdp import generative_model
from curricle.tasks.observation_task import EnvironmentMaker
from curricle.tasks.pursuit import Pursuit
from curricle.tasks.rooms import FourRooms, KeyLockPit
from curricle.tasks.start_states import GoalDistance, TaskWithStart, with_start
from curricle.tasks.toy_text import CliffWalking, FrozenLake, Taxi

Made = TypeVar("Made")

# -- Where episodes start: a ring around the goal, reachable states, or states a policy visits ----


def _distance(value: object) -> tuple[int, int]:
    """Return a range of distances; one number is a range."""
    ends = value if isinstance(value, list | tuple) else (value, value)
    if len(ends) != 2:
        raise wrong(f"must be a number of steps, or the lowest and the highest: got {shown(value)}")
    low, high = map(whole_number, ends)
    if not 0 <= low <= high:
        raise wrong(f"must be steps from low to high, at least 0: got {shown(value)}")
    return low, high


class StartTable(Table):
    """The states in which episodes start."""

    distance: Annotated[
        tuple[int, int] | None, BeforeValidator(_distance, json_schema_input_type=int | list[int])
    ] = None
    """Steps to the goal, or the fewest and the most: a ring around the goal."""
    goal: dict[str, JsonValue] | None = None
    """With distance: the goal by components, each a value, a label or a list; by default the ends
    that are entered with the largest reward."""
    visits: Literal["random", "optimal"] | None = None
    """Start in the states that the random or the optimal policy visits, as often as it does."""

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if (self.distance is None) == (self.visits is None):
            raise wrong(f"must have distance or visits: got {'both' if self.visits else 'neither'}")
        if self.goal is not None and self.distance is None:
            raise wrong("has a goal, which goes with distance")
        return self


_START = "be 'uniform', 'reachable', or a table with distance or visits"
_StartWord = Annotated[str, word(_START, ("uniform", "reachable"))]


def started(task: Any, start: StartTable | str | None) -> Any:
    """Return a task with the start of its table; the task itself if its table has none."""
    if start is None:
        return task
    if isinstance(start, str):
        return with_start(task, start)
    if start.distance is not None:
        low, high = start.distance
        return with_start(task, GoalDistance(low, high, start.goal))
    policy = None if start.visits == "random" else solve(task).policy
    return with_start(task, visit_distribution(task, policy))


# -- The common part of all task tables: a task's own settings, and whether they suit the task -----


class TaskTable(ObjectTable, Settings):
    """A task, and the settings of this task only."""

    deep: ClassVar[bool] = False
    """Whether it is seen through observations and learnt by a network."""

    start_states: Annotated[Any, Choice((StartTable,), simple=_StartWord)] = None
    """Where episodes start instead: 'uniform', 'reachable', { distance = [1, 3] } from the goal, or
    { visits = "random" }."""

    def mismatches(self, name: str) -> Iterator[tuple[KeyPath, str]]:
        """Yield the settings that do not suit the task `name`, with a message for each."""
        network, shaping = isinstance(self.learner, DeepLearnerTable), self.shaping
        if network and not self.deep:
            yield (
                ("learner",),
                f'must be tabular for {name}, such as {{ type = "QLearning" }}: networks learn '
                "tasks seen through observations, of type 'observation_task'",
            )
        if self.deep and not network:
            yield (
                ("learner",),
                f'must be {{ type = "deep", ... }} for {name}, which is seen through observations '
                "and learnt by a network",
            )
        if shaping is not None and not self.deep and not shaping.makes.for_tables:
            yield ("shaping",), f"must be for tables, to learn {name}: got {shaping.type!r}"
        if shaping is not None and self.deep and not shaping.makes.for_networks:
            fitting = ", ".join(of.makes.__name__ for of in SHAPINGS if of.makes.for_networks)
            text = f"must be one of {fitting} for {name}, which a network learns: got "
            yield ("shaping",), f"{text}{shaping.type!r}"
        if self.deep and self.start_states is not None:
            text = f"must be left out for {name}: it is for tables, and a network learns {name}"
            yield ("start_states",), text

    def arguments_in(self, folder: Path) -> dict[str, Any]:
        """Return the arguments of the function that makes the task."""
        arguments = super().arguments_in(folder)
        if arguments.get("time_limit") == NONE:
            arguments["time_limit"] = None
        return arguments

    def build(self, folder: Path = Path(), whole: object = None) -> Any:
        """Return the task; `whole` is the task that a crop is a part of, or a family's member."""
        return super().build(folder)


NONE = "none"  # what a file writes for None
TimeLimit = Annotated[
    int | Literal["none"], word("be a whole number, or 'none'", (NONE,), other=whole_number)
]


# -- Tasks that are environments: Gymnasium's or a user's, as tables or learnt by networks ---------


class Maker(Table):
    """An environment of Gymnasium's registry, or one of yours."""

    id: Name | None = None
    """An id in Gymnasium's registry: CartPole-v1."""
    factory: Reference | None = None
    """Instead of an id: a class or function of yours that makes it, module:Class."""
    arguments: dict[str, JsonValue] = Field({})
    """Passed by name to gymnasium.make, or to the class or function."""

    @model_validator(mode="after")
    def _one_environment(self) -> Self:
        if (self.id is None) == (self.factory is None):
            raise wrong(f"must have id or factory: got {'both' if self.id else 'neither'}")
        return self

    def made_by(
        self,
        make: Callable[..., Made],
        folder: Path,
        options: Mapping[str, object],
        encode: object = None,
    ) -> Made:
        """Return the task that the library's function `make` makes of the environment."""
        reference = str(self.id or self.factory)
        of = registered(self.id, folder) if self.id else built(self.factory, folder)
        maker = EnvironmentMaker(of, dict(self.arguments), built(encode, folder))
        with users_code(reference):
            try:
                return make(maker, **options)
            except TaskError as error:
                if self.factory or ":" not in reference or re.search(r"-v\d+$", reference):
                    raise
                hint = "a class or function of your own is named by factory, not by id"
                raise TaskError(f"{error}; {hint}") from error


Names = tuple[Name, ...] | None


_MADE = ("environment", "make_arguments")  # by `Maker`
_DISCOUNT = (Number, 0.99)
_LIMIT = (TimeLimit | None, None)  # None: the environment's own limit


class EnvironmentTable(Maker, TaskTable):
    """A task that a function of the library makes of an environment."""

    def build(self, folder: Path = Path(), whole: object = None) -> Any:
        """Return the environment as a task; omitted keys have the function's defaults."""
        arguments = self.arguments_in(folder).items()
        stated = {
            name: value for name, value in arguments if getattr(self, name, value) is not None
        }
        return self.made_by(type(self).makes, folder, stated, self.wrapper)

    @property
    def wrapper(self) -> object:
        """What wraps the environment before the library's function reads it; None by default."""
        return None


_SORTED = (
    table_of(Bins, tag="Bins", edges=dict[str, tuple[Number, ...]]),
    table_of(WholeNumbers, tag="WholeNumbers", ranges=dict[str, tuple[Whole, Whole]]),
)
GymnasiumTask = table_of(
    from_gymnasium,
    EnvironmentTable,
    tag="gymnasium",
    without=(*_MADE, "states"),
    discount=_DISCOUNT,
    time_limit=_LIMIT,
    names=Names,
    sizes=tuple[Count, ...] | None,
    actions=Names,
    encode=Annotated[Any, Choice(_SORTED, simple=Reference | None)],
    live=(Flag | None, None),  # None is not stored, so that older results keep their keys
    action_masks=(Flag | None, None),
)


class _EncodedTable(EnvironmentTable):
    encode: AnyEncoder | None = None
    """An encoder of its observations: its name, a table, or module:function."""

    @property
    def wrapper(self) -> object:
        """The encoder."""
        return self.encode


class _CopiedTable(TaskTable):
    ignore: tuple[Name, ...] | None = None
    """Attributes that change no observation and no reward, such as a count of steps."""
    observed: tuple[Name, ...] | None = None
    """Take states that look alike for one, whatever else the environment holds; names of an
    observation's numbers, or an empty list."""

    def arguments_in(self, folder: Path) -> dict[str, Any]:
        """Return the arguments, with what states are copied without under the function's name."""
        arguments = super().arguments_in(folder)
        if self.ignore is not None or self.observed is not None:
            arguments["state"] = DeepCopy(self.ignore or (), self.observed)
        return arguments


class _TabulatedTable(_EncodedTable, _CopiedTable):
    reset_seeds: Annotated[
        tuple[Whole, ...], BeforeValidator(seeds_of, json_schema_input_type=str | list[int])
    ] = (0,)
    """Seeds of the resets, which are equally likely starts: a list, or ranges such as "0-35"."""

    def arguments_in(self, folder: Path) -> dict[str, Any]:
        """Return the arguments, with seeds under the function's name."""
        return {**super().arguments_in(folder), "seeds": self.reset_seeds}


class _ObservationTable(_EncodedTable):
    deep: ClassVar[bool] = True


TabulatedTaskTable = table_of(
    tabulate,
    _TabulatedTable,
    tag="tabulated",
    without=(*_MADE, "seeds", "state", "max_states", "max_seconds", "progress"),
    discount=_DISCOUNT,
    time_limit=_LIMIT,
    names=Names,
    sizes=(tuple[Count, ...] | None, None),  # None is not stored
    actions=Names,
    samples=Count | None,
    action_masks=(Flag | None, None),
)
ObservationTaskTable = table_of(
    observation_task,
    _ObservationTable,
    tag="observation_task",
    without=(*_MADE, "encode"),
    compiled_view=(Flag | None, None),  # None is not stored
)
_by_id = BeforeValidator(
    lambda value: {"id": value} if isinstance(value, str) else value,
    json_schema_input_type=str | Maker,
)
Members = tuple[Annotated[Maker, _by_id], ...]


class _DistilledTable(_CopiedTable):
    deep: ClassVar[bool] = True
    members: Members = Field(min_length=1)
    """Ids, or tables with id or factory, and arguments."""
    tested_on: Members = ()
    """Relatives for tests only, of growing size."""
    discount: Number = 0.99
    """In [0, 1]."""
    encode: AnyEncoder | None = None
    """An encoder of their observations: its name, a table, or module:function."""
    time_limit: Whole | None = None
    """Steps after which an episode is cut; the environments' own."""
    shuffled: Flag = False
    """Whether answers are shuffled over observations: a placebo."""

    def build(self, folder: Path = Path(), whole: object = None) -> Any:
        """Return the miniatures, which are solved at first use."""
        options = {"discount": self.discount, "time_limit": self.time_limit}
        members, tested_on = (
            [maker.made_by(observation_task, folder, options, self.encode) for maker in makers]
            for makers in (self.members, self.tested_on)
        )
        made = miniatures(*members, tested_on=tested_on, **self.arguments_in(folder))
        return replace(made, shuffled=self.shuffled)


DistilledTask = table_of(
    miniatures,
    _DistilledTable,
    tag="distilled",
    without=("members", "tested_on", "state"),
    resets=Count,
    max_states=Count,
    max_seconds=Number,
    samples=(Count | None, None),  # None is not stored
    charged=Whole,
)


# -- Tasks that are members of a family ------------------------------------------------------------

BUILT_IN = {
    family.name: family
    for name in dir(tasks)
    if isinstance(family := getattr(tasks, name), TaskFamily)
}
"""Public name -> family of the library."""


def _family(name: str) -> TaskFamily | None:
    """Return a built-in family; None for a user's family, which is not imported here."""
    if ":" in name or name in BUILT_IN:
        return BUILT_IN.get(name)
    text = f"must be one of {', '.join(BUILT_IN)}, or a family of one's own as module:function: "
    raise wrong_at((("family",), f"{text}got {shown(name)}{suggestion(name, BUILT_IN)}"))


def _checked(family: TaskFamily | None, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameters as a family's members store them, or raise an error with all mistakes."""
    if family is None:
        return dict(values)
    checked, messages = dict[str, Any](), list[tuple[KeyPath, str]]()
    by_name = {parameter.name: parameter for parameter in family.parameters}
    for name, value in values.items():
        if name not in by_name:
            messages.append(((name,), unknown(name, by_name)))
            continue
        try:
            none = by_name[name].optional and value == NONE  # plain data keep the word "none"
            checked[name] = NONE if none else by_name[name].checked(value, family.name)
        except TaskError as error:
            messages.append(((name,), str(error).removeprefix(f"{name} of {family.name} ")))
    if messages:
        raise wrong_at(*messages)
    return checked


class FamilyTask(TaskTable):
    """A member of a task family; its other keys are the member's parameters."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, JsonValue]

    type: Literal["family"] = "family"
    family: str = Field(
        description=f"One of {', '.join(BUILT_IN)}, or one's own as module:function."
    )

    @model_validator(mode="after")
    def _known_parameters(self) -> Self:
        family = _family(self.family)
        values = _checked(family, self.__pydantic_extra__)
        parameters = () if family is None else family.parameters
        defaults = {of.name: of.default for of in parameters if not of.required}
        for name, value in {**defaults, **values}.items():
            self.__pydantic_extra__[name] = NONE if value is None and family else value
        return self

    def member(self, folder: Path) -> FamilyMember:
        """Return the address of the task in its family, which may be a user's."""
        family: Any = BUILT_IN.get(self.family) or load(self.family, folder)
        if not isinstance(family, TaskFamily):
            raise ConfigError(
                f"{self.family} must be a TaskFamily, such as a function under @task_family(): got "
                f"{family!r}"
            )
        for parameter in family.parameters if self.family not in BUILT_IN else ():
            if parameter.name in type(self).model_fields:
                raise ConfigError(
                    f"{self.family} has the parameter {parameter.name}, which is a key of every "
                    "task in a file: give it another name"
                )
        optional = {parameter.name for parameter in family.parameters if parameter.optional}
        values = _checked(family, self.__pydantic_extra__).items()
        return family(**{k: None if v == NONE and k in optional else v for k, v in values})

    def build(self, folder: Path = Path(), whole: Any = None) -> Any:
        """Return the task that the family makes."""
        member = whole or self.member(folder)
        with users_code(self.family):
            task = member.task
        generative_model(task)
        return task


# -- Tasks of the library: mazes, crops, pursuits, other domains -----------------------------------

LARGEST_FILE = 2**20  # most bytes of a study file or a map; the largest example has 3,000
Pair = tuple[Whole, Whole]
CROPPED = (GridWorld, FourRooms, KeyLockPit, FrozenLake)  # tasks that can be cropped


def text_of(path: Path) -> str:
    """Return the content of a text file; ValueError says why it cannot be read."""
    try:
        return read_bounded(path, LARGEST_FILE).decode("utf-8-sig")  # a byte-order mark is optional
    except OSError as error:
        raise ValueError(error.strerror) from None
    except UnicodeDecodeError as error:
        raise ValueError(f"it is not UTF-8: {error}") from None


def _in_order(value: object) -> object:
    """Return a list, which stands for a set, sorted and without repetitions."""
    return tuple(sorted(set(value))) if isinstance(value, tuple) else value


def _without_margins(drawing: str) -> str:
    return "\n".join(line.strip() for line in drawing.strip().splitlines())


def _cells_or(*words: str) -> object:
    """Return the type of a known word or a list of cells, which stands for a set."""
    rule = f"be {', '.join(map(repr, words))} or a list of cells"
    return Annotated[_listed_or(rule, tuple[Pair, ...], *words), AfterValidator(_in_order)]


def _listed_or(rule: str, lists: object, *words: str) -> object:
    """Return the type of a known word or a list."""
    return Annotated[Literal[words] | lists, word(rule, words, lists=lists)]


class _MazeTask(TaskTable):
    file: str | None = None
    """A text file with the map instead, relative to the study file."""

    @model_validator(mode="before")
    @classmethod
    def _read_file(cls, data: object, info: ValidationInfo) -> object:
        """Replace the key `file` by the file's map, so that the study stores the map itself."""
        if not isinstance(data, dict) or data.get("file") is None:
            return data
        if "map" in data:
            raise wrong("has both map and file: one of them is enough")
        name, folder = data["file"], (info.context or {}).get("folder", Path())
        if not isinstance(name, str):
            raise wrong_at((("file",), f"must be text in quotes: got {shown(name)}"))
        try:
            text = text_of(folder / name)
        except ValueError as error:
            raise wrong_at((("file",), f"cannot be read: {shown(name)}, {error}")) from None
        return {**{key: value for key, value in data.items() if key != "file"}, "map": text}


class CropTask(TaskTable):
    """A part of a maze of the study, or of another task drawn as a maze; rules do not change."""

    type: Literal["crop"] = "crop"
    of: Name
    """The task (or crop) it is a part of, by its name in [tasks]."""
    rows: Pair
    """First row and the one after the last, in the map's coordinates."""
    columns: Pair
    """First column and the one after the last."""
    start: _cells_or("map", "uniform") = "uniform"  # type: ignore[valid-type]
    """As in a maze."""

    def build(self, folder: Path = Path(), whole: object = None) -> Any:
        """Return this part of `whole`."""
        if isinstance(whole, TaskWithStart):
            whole = whole.task
        if not isinstance(whole, CROPPED):
            kinds = ", ".join(kind.__name__ for kind in CROPPED)
            raise TaskError(f"what a crop is a part of must be one of {kinds}: got {whole!r}")
        cropped: Any = whole
        return cropped.crop(rows=self.rows, columns=self.columns, start=self.start)


class CandidateTask(TaskTable):
    """A candidate source of another task of the study, as `source_candidates` lists it."""

    type: Literal["candidate"] = "candidate"
    of: Name
    """The task that it is a candidate of, by its name in [tasks]."""
    kind: Literal[KINDS]  # type: ignore[valid-type]
    """The kind of the candidate."""
    candidate: Name
    """Its name in the list."""

    def build(self, folder: Path = Path(), whole: Any = None) -> Any:
        """Return the candidate's task; `whole` is the candidate."""
        return whole.task


class FactoryTask(TaskTable):
    """A task that a user's function makes."""

    type: Literal["factory"] = "factory"
    factory: Reference
    """The function that returns the task, module:function."""
    arguments: dict[str, JsonValue] = Field({})
    """Passed to it by name."""

    def build(self, folder: Path = Path(), whole: object = None) -> Any:
        """Return the function's result; ConfigError unless it is a task."""
        make = built(self.factory, folder)
        with users_code(self.factory):
            made = make(**self.arguments)
            generative_model(made)
        return made


def _domain(makes: Any, tag: str, **types: object) -> Any:
    """Return the table of a domain; `types` are those that differ between TOML and the class."""
    base: type[TaskTable] = TaskTable
    if issubclass(makes, GridDomain):
        types.setdefault("start", _cells_or(*(rules_of(makes)["start"][1].values or ())))
    if issubclass(makes, MapDomain):
        base, types["map"] = _MazeTask, Annotated[str, AfterValidator(_without_margins)]
    return table_of(makes, base, tag=tag, time_limit=TimeLimit, **types)


_ENDS = Annotated[tuple[Literal["treasure", "pit", "fire"], ...], AfterValidator(_in_order)]
_HALLWAY = _listed_or("be a hallway or a list of a row and a column", Pair, *MOVES)
_PLACES = _listed_or("be 'uniform' or a list of positions", tuple[Whole, ...], "uniform")
_CAPTURES = ("all", "any", "as_published")
_LEGEND = Annotated[
    str | dict[str, str],
    word(f"be {', '.join(map(repr, LEGENDS))} or a table of characters", LEGENDS, other=as_table),
]
MazeTask = _domain(GridWorld, "maze", ends=_ENDS, legend=_LEGEND)
PursuitTask = _domain(
    Pursuit,
    "pursuit",
    capture=Annotated[
        Literal[_CAPTURES] | int,
        word(
            "be 'all', 'any', 'as_published' or a number of predators",
            _CAPTURES,
            other=whole_number,
        ),
    ],
)
_WRITTEN: dict[str, dict[str, Any]] = {
    "four_rooms": {"goal": _HALLWAY},
    "river_swim": {"start": Annotated[_PLACES, AfterValidator(_in_order)]},
}
"""Domain -> the types of parameters that TOML writes otherwise than the class."""
# GridWorld and Pursuit have tables above; other tasks are Gymnasium's, or members of families.
_OTHERWISE = (GridWorld, Pursuit, FrozenLake, CliffWalking, Taxi)
DOMAIN_TASKS = tuple(
    _domain(kind, name_of(kind), **_WRITTEN.get(name_of(kind), {}))
    for name in dir(tasks)
    if isinstance(kind := getattr(tasks, name), type)
    if issubclass(kind, Domain) and kind not in _OTHERWISE
)
TASKS = (
    MazeTask,
    CropTask,
    CandidateTask,
    PursuitTask,
    *DOMAIN_TASKS,
    GymnasiumTask,
    TabulatedTaskTable,
    FactoryTask,
    FamilyTask,
    ObservationTaskTable,
    DistilledTask,
)
AnyTask = Annotated[
    Any,
    Choice(
        TASKS,
        choose=lambda value: FamilyTask if "family" in value and "type" not in value else None,
    ),
]
