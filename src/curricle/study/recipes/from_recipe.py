"""An ordinary study of one member of a family, written from a recipe for all of them."""

from collections.abc import Iterator, Mapping
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from curricle.curriculum.curriculum import Curriculum
from curricle.design.assembly import TARGET
from curricle.design.proposals import SourceCandidate
from curricle.design.recipe import Recipe, Stage, annealed_learner, at_target
from curricle.design.trends import Trend
from curricle.errors import ConfigError, CurricleError
from curricle.learning.shaping import LookAheadAdvice, QInitialisation, StateShaping
from curricle.study.config.merging import Positions, line_numbers
from curricle.study.config.reading import configured
from curricle.study.config.tables import parsed, users_code
from curricle.study.config.tasks import CROPPED
from curricle.study.recipes.recipe_file import StoredRecipe
from curricle.study.recipes.toml_text import comments, header, pair, pairs
from curricle.tasks.families.family import FamilyMember
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.start_states import GoalDistance, goal_distance, with_start
from curricle.tasks.task import generative_model, same_task, tables
from curricle.text_tables import counted
from curricle.transfer.component_mapping import project
from curricle.transfer.edges import Transfer
from curricle.transfer.identity_mapping import identity
from curricle.transfer.mapping import same_position

ARM, ALONE = "recipe", "target alone"
"""The arm with the recipe's sources, and the only one of a recipe without any."""
IN_FILES: Mapping[str, Any] = {
    "initialise": QInitialisation.__name__,
    "guarded": {"type": QInitialisation.__name__, "guard": True},
    "look-ahead": LookAheadAdvice.__name__,
    "state": StateShaping.__name__,
}
"""The shapings of recipes as a study file writes them."""


class _Application(NamedTuple):
    """A recipe applied to one member."""

    stored: StoredRecipe
    member: FamilyMember
    given: Mapping[str, Any]
    """The parameters that were asked for."""
    stages: list[tuple[Stage, SourceCandidate]]
    plan: Curriculum

    @property
    def recipe(self) -> Recipe:
        return self.stored.recipe


def study_text(
    stored: StoredRecipe,
    parameters: Mapping[str, Any],
    *,
    budget: int,
    seeds: int,
    file: Path = Path("study.toml"),
) -> str:
    """Return the study file of one member of a recipe's family.

    Its arm trains the curriculum that :meth:`Recipe.curriculum` returns. That of a recipe without
    sources learns the target alone.

    Parameters
    ----------
    stored : StoredRecipe
    parameters : dict
        Of the member; the others are the defaults of the recipe's file.
    budget : int
        Steps of the target.
    seeds : int
    file : Path
        Where it will be, for messages, and for a family of one's own beside it.

    Raises
    ------
    ConfigError
        When a source cannot be said in a study file.
    CurricleError
        When there is no such member, or it has no such source.

    Examples
    --------
    >>> from curricle.design import Relation, Stage
    >>> recipe = StoredRecipe(Recipe([Stage(Relation("crop", 0.5), 40)]), "maze", {"pits": 0.2})
    >>> text = study_text(recipe, {"size": 6, "seed": 1}, budget=20_000, seeds=3)
    >>> print(text[text.index("[tasks.target]"):])
    [tasks.target]
    family = "maze"
    size = 6                    # as asked for
    seed = 1                    # as asked for
    budget = 20_000             # steps; scratch has those of the sources on top
    aggregate = "mean"
    shaping = "QInitialisation"
    <BLANKLINE>
    [[transfers]]
    source = "rows 0..2, columns -2..0"
    target = "target"
    mapping = "same_position"
    scale = 1.0                 # of the recipe
    <BLANKLINE>
    [arms.recipe]
    <BLANKLINE>
    """
    family = stored.of_family()
    member = family(**parameters)
    recipe = stored.recipe
    with users_code(stored.family):
        stages = recipe.sources(member)
        plan = recipe.curriculum(member, budget=budget)
    applied = _Application(stored, member, parameters, stages, plan)
    lines = [
        *comments(_words(applied, file)),
        "",
        pair("name", family.name),
        pair("seeds", seeds),
        *([] if stages else [pair("scratch", False, "the only arm learns from scratch already")]),
        *_shared(stored),
        *(line for one in stages for line in _source(applied, *one)),
        *_target(applied, budget),
        *(line for name in plan.order for line in _transfers(applied, name)),
        "",
        header("arms", ARM if stages else ALONE),
    ]
    text = "\n".join(lines) + "\n"
    data = parsed(text)
    study = configured(data, file.parent, Positions(str(file), data, line_numbers(text)))
    _ = study.curricula  # which are built, so that what is written can be trained
    return text


def _words(applied: _Application, file: Path) -> Iterator[str]:
    """Yield what stands above the study."""
    yield f"{applied.member}, by a recipe. Check it with: curricle check {file.name}"
    yield ""
    yield from str(applied.recipe).splitlines()
    left_out = len(applied.recipe.stages) - len(applied.stages)
    if left_out:
        yield f"{left_out} of its sources would be this target or another one, and are left out."
    if judged := applied.stored.judgement:
        saving = judged["saving"]
        interval = (
            f" [{saving['low']:.0%}, {saving['high']:.0%}]" if {"low", "high"} <= {*saving} else ""
        )
        it = "it" if applied.recipe.stages else "the best in the race"
        yield (
            f"Where it was designed, {it} saved {saving['estimate']:.0%}{interval} of the steps "
            f"from scratch, in {judged['problems_paid']} of "
            f"{counted(len(judged['problems']), 'problem')}, on "
            f"{counted(judged['seeds'], 'new seed')} each. "
            "Whether it does here is what this study measures."
        )


def _shared(stored: StoredRecipe) -> Iterator[str]:
    """Yield the tables that all tasks share."""
    if stored.learner:
        yield from ("", header("learner"), *pairs(stored.learner))
    name = stored.of_family().name
    if stored.defaults or name != stored.family:
        yield from ("", header("families", name), pair("family", stored.family))
        yield from pairs(stored.defaults)


def _address(applied: _Application, member: FamilyMember) -> Iterator[str]:
    """Yield the family of a member, and the parameters that differ from the defaults."""
    family = applied.stored.of_family()
    yield pair("family", family.name)
    defaults = {one.name: one.default for one in family.parameters} | dict(family.settings)
    for name, value in member.parameters.items():
        same = type(value) is type(defaults[name]) and value == defaults[name]
        if not same or name in applied.given:
            comment = "as asked for" if member == applied.member else ""
            yield pair(name, value, comment)


def _source(applied: _Application, stage: Stage, source: SourceCandidate) -> Iterator[str]:
    yield ""
    words = source.words[:1].upper() + source.words[1:]
    yield from comments([f"{words}. In the recipe: {stage.relation}."])
    yield header("tasks", source.name)
    if stage.relation.kind == "member" and source.member is not None:
        yield from _address(applied, source.member)
    elif stage.relation.kind == "crop" and (part := _part(applied.member.task, source.task)):
        yield pair("type", "crop")
        yield pair("of", TARGET)
        yield from pairs(part)
    elif stage.relation.kind == "starts" and (most := _ring(applied.member.task, source.task)):
        yield from _address(applied, applied.member)
        yield pair("start_states", {"distance": [1, most]}, "steps from the goal")
    else:
        raise _unsaid(f"a source that is a {stage.relation}")
    states, target = source.task.states.size, applied.member.task
    budget = stage.budget(states, target)
    rule: dict[str, Any] = {"max_steps": budget.max_steps}
    if budget.settled is not None:
        rule["settled"] = budget.settled
    each = f"{at_target(stage.steps, target):.4g} steps a state x {states:,} states"
    whole = _states(applied.member)
    yield pair("budget", rule, each + _interval(stage.steps, whole, states, "steps"))
    if applied.recipe.annealed:
        learner = annealed_learner(budget.max_steps)
        falls: Any = learner.learning_rate
        rate = {
            "type": "linear",
            "first": falls.first,
            "last": falls.last,
            "steps": round(falls.span),
        }
        own = {"type": "QLearning", "learning_rate": rate, "epsilon": learner.epsilon}
        yield pair("learner", own, "annealed, as the recipe has it")
    if applied.plan.in_edges(source.name):
        yield pair("shaping", IN_FILES["initialise"], "it builds on the one before")


def _interval(trend: Trend, states: int, times: float = 1.0, unit: str = "") -> str:
    """Return the interval of a number in words; nothing where it has none."""
    low, high = (times * one for one in trend.interval(states))
    return "" if low != low else f"; 95 % interval {low:.4g} to {high:.4g} {unit}".rstrip()


def _part(whole: Any, source: Any) -> dict[str, list[int]] | None:
    """Return the rows and columns of a crop; None where a file's crop is another task."""
    if not isinstance(whole, CROPPED) or getattr(source, "layout", None) is None:
        return None
    ranges = {}
    for name, first, length in zip(
        ("rows", "columns"), source.layout.origin, source.layout.shape, strict=True
    ):
        ranges[name] = int(first), int(first + length)
    cropped: Any = whole
    if not same_task(cropped.crop(**ranges, start="uniform"), source):
        return None
    return {name: list(one) for name, one in ranges.items()}


def _ring(whole: Any, source: Any) -> int | None:
    """Return how far from the goal a ring of starts leads; None where a file's is another."""
    starts = tables(source).start_states
    most = int(goal_distance(whole)[starts].max(initial=0))
    same = most > 0 and same_task(with_start(whole, GoalDistance(1, most)), source)
    return most if same else None


def _target(applied: _Application, budget: int) -> Iterator[str]:
    yield from ("", header("tasks", TARGET), *_address(applied, applied.member))
    yield pair("budget", budget, "steps; scratch has those of the sources on top")
    if applied.stages:
        yield pair("aggregate", applied.recipe.aggregate)
        yield pair("shaping", IN_FILES[applied.recipe.shaping])


def _transfers(applied: _Application, name: str) -> Iterator[str]:
    """Yield the transfers into a task, one table for all mappings of one source."""
    edges = applied.plan.in_edges(name)
    for source, several in groupby(edges, key=lambda one: one.source):
        each = list(several)
        yield from ("", header("transfers", listed=True))
        yield pair("source", source)
        yield pair("target", name)
        yield pair(*_mapping(applied, name, each))
        if name != TARGET:
            continue
        if applied.recipe.scale == "calibrated":
            yield pair("calibrate", {"cautious": False}, "the scale is measured in the target")
        else:
            trend, states = applied.recipe.scale, _states(applied.member)
            yield pair("scale", float(each[0].scale), f"of the recipe{_interval(trend, states)}")


def _states(member: FamilyMember) -> int:
    return 1 if is_observation_task(member.task) else generative_model(member.task).states.size


def _mapping(applied: _Application, name: str, edges: list[Transfer]) -> tuple[str, Any]:
    """Return the key that says how one task reads another, which is checked pair by pair."""
    members = {one.name: one.member for _, one in applied.stages} | {TARGET: applied.member}
    if members[name] is not None and members[edges[0].source] is not None:
        return "mapping", "family"
    target, source = (applied.plan.node(one).task for one in (name, edges[0].source))
    ways: list[tuple[str, Any, Any]] = [
        ("mapping", "same_position", lambda: same_position(target, source)),
        ("mapping", "identity", lambda: identity(target, source)),
        ("project", {}, lambda: project(target, source)),
    ]
    for key, value, make in ways:
        try:
            made = make()
        except CurricleError:
            continue
        own = edges[0].mapping
        if (
            len(edges) == 1
            and np.array_equal(made.index, own.index)
            and made.unmapped_value == own.unmapped_value
        ):
            return key, value
    raise _unsaid(f"how {name!r} reads {edges[0].source!r}")


def _unsaid(what: str) -> ConfigError:
    return ConfigError(
        f"a study file cannot say {what}: train it in Python, with "
        "read_recipe(FILE).recipe.curriculum(member, budget=...).train(seeds)"
    )
