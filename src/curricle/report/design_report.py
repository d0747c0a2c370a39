"""The report of a design: how its recipe was found, what it saves, and what the search cost."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from curricle.design.judgement import RECIPE
from curricle.design.ledger import amount
from curricle.design.problem import Problem
from curricle.design.racing import PLACEBO, Race
from curricle.design.recipe import Recipe
from curricle.design.recipe_design import BEST, FIXED, LEADER, RecipeDesign
from curricle.design.timed_problems import CAP
from curricle.report.design_figures import SIZES, bracket, last_scores, recipe_graph, scatter
from curricle.report.templates import Script, render, write_page
from curricle.statistics.curves import SCRATCH
from curricle.tasks.families.family import FamilyMember
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.task import generative_model
from curricle.text_tables import counted


def write_design_report(design: RecipeDesign, path: str | PathLike[str]) -> Path:
    """Write the report of a design as one HTML page that works offline, and return its path.

    It has the recipe and why it is recommended, the recipes of the first race by cost and saving,
    the rounds of each race, the graph of the recipe, the ledger, and the judgement. The same design
    gives the same page, byte for byte.

    Parameters
    ----------
    design : RecipeDesign
    path : path

    Raises
    ------
    StoreError
        When the page cannot be written.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> from curricle.design import Problem, SearchBudget
    >>> from curricle.design.recipe_design import design_recipe
    >>> from curricle.tasks import maze_family
    >>> maze = Problem(maze_family(size=4, seed=3), steps=4000, miniature=True)
    >>> found = design_recipe([maze], SearchBudget(60_000))
    >>> write_design_report(found, Path(mkdtemp()) / "recipe.html").name
    'recipe.html'
    """
    return write_page(design_page(design), Path(path))


def design_page(design: RecipeDesign) -> str:
    """Return the page of a design."""
    first, problems = design.races[0], design.races[0].problems
    shown = shown_recipe(design)
    return render(
        "design.html",
        name=f"A recipe for {_family(first)}",
        design=design,
        pays=bool(design.recipe.stages),
        words=str(design.recipe).splitlines(),
        saving=design.judgement.saving(design.recommended),
        paid=break_even_words(design),
        race=first,
        cap=CAP,
        scatters={size: scatter(first, size) for size in SIZES},
        brackets=[bracket(one) for one in design.races],
        graph=recipe_graph(shown, sizes_of(problems)) if shown.stages else None,
        lessons=list(lessons(design)),
        spent=ledger_rows(design),
        judged=judged_rows(design),
        problems=problems,
        scripts=[Script.of("scroll.js")],
    )


def shown_recipe(design: RecipeDesign) -> Recipe:
    """Return the recipe that is recommended, or the best that was found where none is."""
    return design.recipe if design.recipe.stages else design.best


def _family(found: Race) -> str:
    """Return what the problems of a race have in common."""
    targets = [one.target for one in found.problems]
    families = {one.family.name for one in targets if isinstance(one, FamilyMember)}
    alike = len(families) == 1 and all(isinstance(one, FamilyMember) for one in targets)
    return families.pop() if alike else found.problems[-1].name


def sizes_of(problems: Sequence[Problem]) -> list[int]:
    """Return the states of each problem; none where targets have observations in their place."""
    if any(is_observation_task(one.task) for one in problems):
        return []
    return [int(generative_model(one.task).states.size) for one in problems]


def break_even_words(design: RecipeDesign) -> str:
    """Return after how many trainings of the largest problem the search would have paid."""
    cost = amount(design.ledger.cost)
    if not design.recipe.stages:
        return f"The search cost {cost} steps and found nothing to use: it is not paid back."
    largest = design.races[0].problems[-1]
    kind = "miniature" if largest.miniature else "problem"
    scratch = float(design.judgement.steps[SCRATCH][-1].mean())
    return (
        f"For a target that takes as long from scratch as {largest.name}, the largest {kind} "
        f"({scratch:,.0f} steps), {design.break_even(scratch)}."
    )


def lessons(design: RecipeDesign) -> Iterator[str]:
    """Yield what was learnt, a sentence each."""
    first = design.races[0]
    scores = last_scores(first)
    less = sum(scores[name] < 1 for name in first.arms)
    yield (
        f"{counted(len(first.arms), 'recipe')} raced over sources and chains of them. "
        f"{less} of them cost less than scratch in the last round that they were in."
    )
    if first.leader == SCRATCH:
        yield "None of those that stayed to the end was better than scratch."
    else:
        yield f"The best of them is “{first.leader}”: {scores[first.leader]:.2f} of scratch."
    for number, other in enumerate(design.races[1:], 1):
        found = last_scores(other)
        own = [name for name in other.ranking if name in variations_of(other)]
        best = f"the best of them, “{own[0]}”, cost {found[own[0]]:.2f}" if own else "none had runs"
        yield (
            f"Race {number + 1}: {counted(len(own), 'variation')} of the leader; {best}, the "
            f"leader {found[LEADER]:.2f} of scratch. A variation takes the leader’s place only "
            "if it is better by two standard errors."
        )
    for number, one in enumerate(design.races, 1):
        if one.dropped:
            dropped = counted(len(one.dropped), "recipe")
            yield f"Race {number} left out {dropped}, without a source in some problem."
        if one.unaffordable:
            more = counted(one.unaffordable, "more recipe")
            yield f"Race {number}: the budget did not pay for {more}."
    slopes = {f"{one.steps.slope:.2g}" for one in shown_recipe(design).stages if one.steps.slope}
    if slopes:
        yield f"Steps a state go with the states of the target to the power {', '.join(slopes)}."
    elif design.best.stages and not design.standing and len(set(sizes_of(first.problems))) > 1:
        yield "Steps a state are the same at all sizes: no trend was shown."


def variations_of(found: Race) -> list[str]:
    """Return the arms of a race of variations that are neither its leader nor a fixed recipe."""
    return [name for name in found.arms if name not in (LEADER, FIXED)]


@dataclass(frozen=True)
class LedgerRow:
    """A class of steps in the ledger that has some."""

    name: str
    steps: int
    price: float
    cost: str
    share: float  # of the steps of all classes


def ledger_rows(design: RecipeDesign) -> tuple[LedgerRow, ...]:
    """Return the classes of a design's ledger that have steps."""
    spent = design.ledger
    return tuple(
        LedgerRow(
            name.replace("_", " "),
            steps,
            spent.prices[name],
            amount(spent.costs[name]),
            steps / spent.total_steps,
        )
        for name, steps in spent.steps.items()
        if steps
    )


@dataclass(frozen=True)
class JudgedRow:
    """What the arms of a judgement cost in one problem, or on average."""

    problem: str
    scratch: float  # steps, on average over seeds
    costs: tuple[tuple[str, float], ...]  # arm, and its steps over those of scratch


def judged_rows(design: RecipeDesign) -> tuple[JudgedRow, ...]:
    """Return the judgement: the recipe, others and the placebo over scratch, per problem."""
    judged, problems = design.judgement, design.races[0].problems
    others = [name for name in judged.steps if name not in (SCRATCH, RECIPE, PLACEBO)]
    own = BEST if design.standing else RECIPE
    names = [RECIPE, *others, *([PLACEBO] if PLACEBO in judged.steps else [])]
    shares = {name: judged.shares(name).mean(axis=1) for name in names}
    scratch = judged.steps[SCRATCH].mean(axis=1)
    shown = {name: own if name == RECIPE else name for name in names}
    rows = [
        JudgedRow(one.name, float(steps), tuple((shown[k], float(v[p])) for k, v in shares.items()))
        for p, (one, steps) in enumerate(zip(problems, scratch, strict=True))
    ]
    means = tuple((shown[name], judged.cost(name)) for name in names)
    return (*rows, JudgedRow("mean", float(scratch.mean()), means))
