"""The file of a design: a family, the members that a recipe is designed on, how they are learnt."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from math import prod
from os import PathLike
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, JsonValue

from curricle.comparison.comparing import FRACTION
from curricle.curriculum.defaults import DEFAULT_STEPS
from curricle.design.problem import Problem
from curricle.design.recipe_design import RecipeDesign
from curricle.display import brief_repr
from curricle.errors import ConfigError, CurricleError
from curricle.frozen_arrays import Frozen
from curricle.learning.learners import Learner
from curricle.study.config.merging import Positions, Problems
from curricle.study.config.tables import (
    Count,
    KeyPath,
    Number,
    Table,
    shown,
    unknown,
    whole_number,
    wrong,
)
from curricle.study.config.tasks import NONE, family_of, task_of
from curricle.study.recipes.recipe_file import (
    StoredRecipe,
    judgement_data,
    learner_of,
    read_data,
    recipe_text,
    validated,
)
from curricle.study.recipes.recipe_tables import OfFamily, compact
from curricle.tasks.families.family import FamilyMember, TaskFamily
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.task import generative_model

MOST_MEMBERS = 1000
"""On which a recipe is designed: each is solved, and trained several times."""


def _steps(value: Any) -> Any:
    """Return steps as a number, or by the values of one parameter."""
    if not isinstance(value, dict):
        return _at_least_one(value)
    by = next(iter(value.values()), None)
    if len(value) != 1 or not isinstance(by, dict) or not by:
        raise wrong(
            "must be a number, or a table by one parameter such as { size = { 6 = 20_000 } }: got "
            f"{shown(value)}"
        )
    return {name: {key: _at_least_one(one) for key, one in by.items()} for name in value}


def _at_least_one(value: Any) -> int:
    found = whole_number(value)
    if found < 1:
        raise wrong(f"must be at least 1: got {shown(value)}")
    return found


def _share(value: float) -> float:
    if not 0 <= value <= 1:
        raise wrong(f"must lie in [0, 1]: got {value:g}")
    return value


class TrainingTable(Table):
    """How each member is trained in the design."""

    steps: Annotated[Any, BeforeValidator(_steps)] = Field(
        default=DEFAULT_STEPS, description="Of a training at most, its sources included."
    )
    fraction: Annotated[Number, AfterValidator(_share)] = Field(
        default=FRACTION, description="Of the way from the random return to the optimum: learnt."
    )
    threshold: Number | None = Field(
        default=None, description="The return itself instead, which members without tables need."
    )
    eval_freq: Count | None = Field(default=None, description="Steps between evaluations.")


class DesignTable(OfFamily):
    """The file of a design; its other tables are members, each parameter a value or a list."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, JsonValue]

    training: TrainingTable = TrainingTable()


@dataclass(frozen=True, eq=False)
class DesignPlan(Frozen):
    """What a recipe is designed on.

    Attributes
    ----------
    problems : tuple of Problem
        The smaller ones first.
    family : str
    defaults, learner : dict
        As the file has them.
    file : Path
    on : str
        The table with the members.
    """

    problems: tuple[Problem, ...]
    family: str
    defaults: Mapping[str, Any]
    learner: Mapping[str, Any]
    file: Path
    on: str

    __repr__ = brief_repr

    def stored(self, found: RecipeDesign) -> StoredRecipe:
        """Return what is kept of a design: its draws compact, its ledger without seconds."""
        return StoredRecipe(
            compact(found.recipe),
            self.family,
            self.defaults,
            self.learner,
            judgement_data(found),
            found.ledger,
            self.file.parent,
        )

    def recipe_file(self, found: RecipeDesign, budget: float, seed: int) -> str:
        """Return the file of the recipe that a design found."""
        words = [
            f"A recipe for members of the family {self.family}, designed on {len(self.problems)} "
            f"of them: {self.file.name}, table {self.on}, budget {budget:,.0f} steps, seed {seed}.",
            'Write the study of a member with: curricle apply FILE --to "PARAMETER=VALUE"',
            "",
            *str(found.recipe).splitlines(),
            "",
            found.why,
        ]
        if found.best.stages and not found.recipe.stages:
            words += ["", "The best in the race was:", *str(found.best).splitlines()]
        return recipe_text(self.stored(found), words)


def read_design(
    path: str | PathLike[str], on: str = "miniatures", *, set: Sequence[str] = ()
) -> DesignPlan:
    r"""Return what the TOML file of a design describes.

    Parameters
    ----------
    path : path
    on : str
        The table with the members.
    set : sequence of str
        Changes, as in :func:`read_study`.

    Raises
    ------
    ConfigError
        With a line for each mistake: file, line, key path and what is wrong.
    CurricleError
        When a member cannot be built, or its threshold is not known.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "design.toml"
    ...     _ = path.write_text("family = 'maze'\nminiatures = { size = [3, 4], seed = 1 }")
    ...     [problem.name for problem in read_design(path).problems]
    ['size=3, seed=1', 'size=4, seed=1']
    """
    path = Path(path)
    data, positions = read_data(path, set)
    file = validated(DesignTable, data, positions)
    tables: dict[str, Any] = dict(file.__pydantic_extra__)
    found = Problems(positions)
    found.add(_no_tables(tables, on))
    found.raise_any()
    with found.at("", ("family",)):
        family = family_of(file.family, path.parent, file.defaults)
    found.raise_any()
    if len(family.parameters) == 0 or _one_member(family):
        raise ConfigError(
            positions.sentence(
                ("family",), f"must have several members: {file.family} has one, {family()}"
            )
        )
    values = {name: _values(family, table) for name, table in tables.items()}
    found.add(
        ((name, *place), text)
        for name, (_, wrong_ones) in values.items()
        for place, text in wrong_ones
    )
    found.raise_any()
    chosen = values[on][0]
    members = _members(family, chosen, positions, on)
    for one in members:
        task_of(one, file.family)
    learner = learner_of(file, positions)
    problems = [_problem(one, chosen, file.training, learner, positions) for one in members]
    problems.sort(key=lambda one: _states(one.task))  # stable
    return DesignPlan(
        tuple(problems), file.family, file.defaults, data.get("learner", {}), path, on
    )


def _states(task: Any) -> int:
    return 0 if is_observation_task(task) else int(generative_model(task).states.size)


def _no_tables(tables: Mapping[str, Any], on: str) -> Iterator[tuple[KeyPath, str]]:
    """Yield what is wrong with the tables of members as a whole."""
    for name, table in tables.items():
        if not isinstance(table, dict):
            yield (name,), f"must be a table of members: got {shown(table)}"
        elif not table:
            yield (name,), "must give a parameter, such as size = [6, 8]"
    if on not in tables:
        others = unknown(on, tables) if tables else "is missing: it gives the members"
        yield (on,), others


def _one_member(family: TaskFamily) -> bool:
    """Return whether no parameter of a family has a second value."""
    for one in family.parameters:
        try:
            if len(one.choices(family.name)) > 1:
                return False
        except CurricleError:  # too many to be listed
            return False
    return True


def _values(
    family: TaskFamily, table: Mapping[str, Any]
) -> tuple[dict[str, list[Any]], list[tuple[KeyPath, str]]]:
    """Return the values of each parameter in a table of members, and what is wrong with them."""
    found, wrong_ones = dict[str, list[Any]](), list[tuple[KeyPath, str]]()
    by_name = {one.name: one for one in family.parameters}
    for name, given in table.items():
        if name not in by_name:
            wrong_ones.append(((name,), unknown(name, by_name)))
            continue
        listed = given if isinstance(given, list) else [given]
        if not listed:
            wrong_ones.append(((name,), "must have a value: got an empty list"))
        for number, value in enumerate(listed):
            optional = by_name[name].optional and value == NONE
            try:
                one = by_name[name].checked(None if optional else value, family.name)
            except CurricleError as error:
                place = (name, number) if isinstance(given, list) else (name,)
                text = str(error).removeprefix(f"{name} of {family.name} ")
                wrong_ones.append((place, text))
            else:
                found.setdefault(name, []).append(one)
    return found, wrong_ones


def _members(
    family: TaskFamily, values: Mapping[str, list[Any]], positions: Positions, on: str
) -> list[FamilyMember]:
    """Return the members with all combinations of some values, each of them once."""
    missing = [one.name for one in family.parameters if one.required and one.name not in values]
    missing = [name for name in missing if name not in dict(family.settings)]
    if missing:
        text = f"must give {missing[0]}, which has no default"
        raise ConfigError(positions.sentence((on,), text))
    if prod(map(len, values.values())) > MOST_MEMBERS:
        text = f"must make {MOST_MEMBERS:,} members at most"
        raise ConfigError(positions.sentence((on,), text))
    members = list(dict.fromkeys(islice(family.members(**values), MOST_MEMBERS)))
    if not members:
        text = f"makes no member that {family.name} allows"
        raise ConfigError(positions.sentence((on,), text))
    return members


def _problem(
    member: FamilyMember,
    values: Mapping[str, Any],
    training: TrainingTable,
    learner: Learner,
    positions: Positions,
) -> Problem:
    """Return a member as a problem of a design, named by what tells it from the others."""
    steps = training.steps
    if isinstance(steps, dict):
        ((name, by),) = steps.items()
        key = str(member[name]) if name in member.parameters else ""
        if key not in by:
            what = f"has no steps for {member}" if key else unknown(name, member.parameters)
            path = ("training", "steps", name)
            raise ConfigError(positions.sentence(path, what))
        steps = by[key]
    return Problem(
        member,
        steps,
        learner=learner,
        fraction=training.fraction,
        threshold=training.threshold,
        eval_freq=training.eval_freq,
        miniature=True,
        name=", ".join(f"{name}={member[name]}" for name in values)[:100],
    )
