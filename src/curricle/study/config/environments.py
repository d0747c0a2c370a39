"""Tasks that are environments: Gymnasium's or one's own, in tables or seen by networks."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field, JsonValue, model_validator

from curricle.deep.miniature import HELD_OUT, MOST_STATES, RESETS, miniatures
from curricle.errors import TaskError
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

    def build(self, folder: Path = Path(), whole: Any = None) -> Any:
        """Return the environment as a task."""
        given: dict[str, Any] = {"names": self.names, "sizes": self.sizes, "actions": self.actions}
        if self.encode is not None:
            given["encode"] = load(self.encode, folder)
        limit = _limit(self.time_limit)
        return self.made_by(
            from_gymnasium, folder, discount=self.discount, time_limit=limit, **given
        )


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
