"""Tasks that are environments: Gymnasium's or one's own, in tables or seen by networks."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, JsonValue, model_validator

from curricle.interop.gymnasium import from_gymnasium, observation_task
from curricle.interop.tabulation.tabulate import tabulate
from curricle.study.config.encoders import AnyEncoder, encoder
from curricle.study.config.references import load, users_code
from curricle.study.config.tables import Name, Number, Reference, Whole, whole_number, word, wrong
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


class EnvironmentTable(TaskTable):
    """An environment of Gymnasium's, or one's own."""

    id: Name | None = Field(default=None, description="Such as CartPole-v1.")
    factory: Reference | None = Field(
        default=None,
        description="Instead: a function that returns a new environment, module:function.",
    )
    arguments: dict[str, JsonValue] = Field(
        default={}, description="Passed to gymnasium.make, or to the function, by name."
    )
    discount: Number = Field(default=0.99, description="In [0, 1].")
    encode: AnyEncoder | None = Field(
        default=None,
        description="An encoder of its observations: its name, a table, or module:function.",
    )

    @model_validator(mode="after")
    def _one_environment(self) -> Self:
        if (self.id is None) == (self.factory is None):
            found = "neither" if self.id is None else "both"
            raise wrong(f"must have id or factory: got {found}")
        return self

    def made_by(self, make: Callable[..., Any], folder: Path, **options: Any) -> Any:
        """Return what a function of the library makes of the environment."""
        encode = encoder(self.encode, folder)
        if self.id is not None and encode is None:
            return make(self.id, discount=self.discount, **options, **dict(self.arguments))
        own = str(self.id or self.factory)
        what = self.id or load(own, folder)
        maker = EnvironmentMaker(what, dict(self.arguments), encode)
        with users_code(own):
            return make(maker, discount=self.discount, **options)


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
        return self.made_by(observation_task, folder, time_limit=self.time_limit)
