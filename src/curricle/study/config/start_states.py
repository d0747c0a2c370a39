"""Start states of a task in a study file: a ring around its goal, reachable ones, or visits."""

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, JsonValue, model_validator

from curricle.planning.solution import solve, visit_distribution
from curricle.study.config.tables import Choice, Table, shown, suggestion, whole_number, wrong
from curricle.tasks.start_states import GoalDistance, with_start

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
