"""Task families in a study file: tables that name one, and tasks that are members of one."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import ConfigDict, Field, JsonValue, ValidationInfo, model_validator

from curricle.errors import ConfigError, TaskError
from curricle.study.config.references import load, users_code
from curricle.study.config.tables import KeyPath, Table, shown, suggestion, unknown, wrong_at
from curricle.study.config.task_names import table
from curricle.study.config.task_table import TaskTable
from curricle.tasks.families.built_in import BUILT_IN
from curricle.tasks.families.family import FamilyMember, Parameter, TaskFamily
from curricle.tasks.task import generative_model

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
    """Return a task as data with the table of the family that it names under it.

    Examples
    --------
    >>> of_family({"family": "ring", "size": 3}, {"ring": {"family": "pursuit", "torus": True}})
    {'torus': True, 'family': 'pursuit', 'size': 3, 'type': 'family'}
    """
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
            found[name] = _checked(by_name[name], value, family.name)
        except TaskError as error:
            wrong.append(((name,), str(error).removeprefix(f"{name} of {family.name} ")))
    if wrong:
        raise wrong_at(*wrong)
    return found


def _checked(parameter: Parameter, value: Any, family: str) -> Any:
    """Return a parameter's value as data hold it: None is written "none"."""
    if parameter.optional and value == NONE:
        return NONE
    return parameter.checked(value, family)


def all_parameters(family: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters of a built-in family's member, those that are not given too."""
    if family not in BUILT_IN:
        return dict(given)
    defaults = {one.name: one.default for one in BUILT_IN[family].parameters if not one.required}
    complete = {**defaults, **given}
    return {name: NONE if value is None else value for name, value in complete.items()}


def member_of(family: str, given: Mapping[str, Any], folder: Path) -> FamilyMember:
    """Return the member with these parameters of a family, which may be the user's own."""
    found = BUILT_IN.get(family) or _own(family, folder)
    return found(**_plain(found, _checked_by(found, given)))


def _plain(family: TaskFamily, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameters with None where a file writes "none" for it."""
    optional = {one.name for one in family.parameters if one.optional}
    return {
        name: None if value == NONE and name in optional else value for name, value in given.items()
    }


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


def task_of(member: FamilyMember, family: str) -> Any:
    """Return a member's task; what a user's function raises names the function."""
    with users_code(family):
        return member.task


def wrong_families(study: Mapping[str, Any]) -> Iterator[tuple[KeyPath, str]]:
    """Yield what is wrong with the names of a study's families, each with its key path."""
    for name in table(study.get("families")):
        if ":" in name:
            yield ("families", name), "must have a name without a colon, which functions have"


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
        self.__pydantic_extra__.update(all_parameters(self.family, given))
        return self

    def member(self, folder: Path) -> FamilyMember:
        """Return the address of the task in its family."""
        return member_of(self.family, self.__pydantic_extra__, folder)

    def build(self, folder: Path = Path(), whole: Any = None) -> Any:
        """Return the task that the family makes."""
        task = task_of(whole or self.member(folder), self.family)
        generative_model(task)
        return task
