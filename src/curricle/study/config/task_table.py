"""What every task's table is: the task itself, with settings that go with its kind."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BeforeValidator

from curricle.study.config.settings import (
    BY_NETWORKS,
    OF_NETWORKS,
    DeepLearnerTable,
    GuardedShapingTable,
    Settings,
)
from curricle.study.config.tables import Place, whole_number, wrong


def _time_limit(value: Any) -> int | str:
    return value if value == "none" else whole_number(value)


def _reference(value: str) -> str:
    if ":" not in value:
        raise wrong(f"must name a function as module:function: got {value!r}")
    return value


TimeLimit = Annotated[int | Literal["none"], BeforeValidator(_time_limit)]
Reference = Annotated[str, AfterValidator(_reference)]


class TaskTable(Settings):
    """A task, and settings for it alone."""

    deep: ClassVar[bool] = False
    """Whether it is seen through observations, and learnt by a network."""

    def misfits(self, name: str) -> Iterator[tuple[Place, str]]:
        """Yield the settings that do not go with its kind, each with what is wrong about it.

        Parameters
        ----------
        name : str
            What the task is called.
        """
        return _of_networks(self, name) if self.deep else _of_tables(self, name)

    def rules(self) -> dict[str, Any]:
        """Return what the task itself is, without type and settings, as its class takes it."""
        names = [name for name in type(self).model_fields if name not in Settings.model_fields]
        rules = {name: getattr(self, name) for name in names if name != "type"}
        if rules.get("time_limit") == "none":
            rules["time_limit"] = None
        return rules

    def build(self, folder: Path, task: Callable[[str], Any]) -> Any:
        """Return the task.

        Parameters
        ----------
        folder : Path
            The study file's, with the modules of a user's own functions.
        task : callable
            Returns another task of the study, by its name.
        """
        raise NotImplementedError


def _of_networks(task: Settings, name: str) -> Iterator[tuple[Place, str]]:
    """Yield what does not go with a task that is learnt by a network."""
    if not isinstance(task.learner, DeepLearnerTable):
        yield (
            ("learner",),
            f'must be {{ type = "deep", ... }} for {name}, which is seen through observations and '
            "learnt by a network",
        )
    shaping = task.shaping
    if shaping.type not in BY_NETWORKS:
        known = ", ".join(BY_NETWORKS)
        yield (
            ("shaping",),
            f"must be one of {known} for {name}, which a network learns: got {shaping.type!r}",
        )
    left_out = f"must be left out for {name}: it is of tables, and a network learns it"
    if isinstance(shaping, GuardedShapingTable) and shaping.guard:
        yield ("shaping", "guard"), left_out
    if task.retrain:
        yield ("retrain",), left_out
    if task.evaluation.method == "exact":
        yield (
            ("evaluation", "method"),
            f"must be 'auto', 'rollouts' or 'off' for {name}, which is seen through observations: "
            "got 'exact'",
        )


def _of_tables(task: Settings, name: str) -> Iterator[tuple[Place, str]]:
    """Yield what does not go with a task that is learnt in a table."""
    if isinstance(task.learner, DeepLearnerTable):
        yield (
            ("learner",),
            f'must be of tables for {name}, such as {{ type = "QLearning" }}: networks learn tasks '
            "seen through observations, of type 'observed' or 'vector_pursuit'",
        )
    if task.shaping.type in OF_NETWORKS:
        yield ("shaping",), f"must be a shaping of tables for {name}: got {task.shaping.type!r}"
