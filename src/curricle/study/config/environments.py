"""Tasks that are environments: Gymnasium's or one's own, in tables or seen by networks."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field, JsonValue, model_validator

from curricle.deep.miniature_task import HELD_OUT, MOST_STATES, RESETS, miniatures
from curricle.interop.gymnasium import from_gymnasium, observation_task
from curricle.interop.tabulation.tabulate import tabulate
from curricle.study.config.encoders import AnyEncoder, encoder
from curricle.study.config.references import load, users_code
from curricle.study.config.tables import (
    Count,
    Flag,
    Name,
    Number,
    Reference,
    Table,
    Whole,
    whole_number,
    word,
    wrong,
)
from curricle.study.config.task_table import TaskTable
from curricle.tasks.observation_task import EnvironmentMaker

TimeLimit = Annotated[
    int | Literal["none"], word("be a whole number, or 'none'", ("none",), other=whole_number)
]


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

    def build(self, folder: Path = Path(), whole: Any = None) -> Any:
        """Return the environment as a task."""
        options: dict[str, Any] = {"discount": self.discount}
        if self.time_limit is not None:
            options["time_limit"] = None if self.time_limit == "none" else self.time_limit
        if self.encode is not None:
            options["encode"] = load(self.encode, folder)
        return from_gymnasium(self.id, **options, **dict[str, Any](self.arguments))


class Maker(Table):
    """An environment of Gymnasium's, or one's own."""

    id: Name | None = Field(default=None, description="Such as CartPole-v1.")
    factory: Reference | None = Field(
        default=None,
        description="Instead: a function that returns a new environment, module:function.",
    )
    arguments: dict[str, JsonValue] = Field(
        default={}, description="Passed to gymnasium.make, or to the function, by name."
    )

    @model_validator(mode="after")
    def _one_environment(self) -> Self:
        if (self.id is None) == (self.factory is None):
            found = "neither" if self.id is None else "both"
            raise wrong(f"must have id or factory: got {found}")
        return self

    def made_by(
        self, make: Callable[..., Any], folder: Path, encode: Any = None, **options: Any
    ) -> Any:
        """Return what a function of the library makes of the environment, encoded."""
        encode = encoder(encode, folder)
        if self.id is not None and encode is None:
            return make(self.id, **options, **dict(self.arguments))
        own = str(self.id or self.factory)
        what = self.id or load(own, folder)
        maker = EnvironmentMaker(what, dict(self.arguments), encode)
        with users_code(own):
            return make(maker, **options)


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
    reset_seeds: tuple[Whole, ...] = Field(
        default=(0,), description="Of the resets that starts are taken from."
    )
    cache: Name | None = Field(
        default=None, description="A folder beside the study file, in which tables are kept."
    )

    def build(self, folder: Path = Path(), whole: Any = None) -> Any:
        """Return the environment as tables."""
        limits: dict[Any, Any] = {None: "own", "none": None}
        return self.made_by(
            tabulate,
            folder,
            self.encode,
            discount=self.discount,
            time_limit=limits.get(self.time_limit, self.time_limit),
            seeds=self.reset_seeds,
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
