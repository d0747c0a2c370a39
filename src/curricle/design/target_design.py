"""Designing a curriculum for one target: by a standing recipe, or a search where that can pay."""

from dataclasses import dataclass, replace

from curricle.checks import instance, whole_number
from curricle.curriculum.curriculum import Curriculum
from curricle.design.ledger import Ledger
from curricle.design.problem import Problem
from curricle.design.recipe import Recipe
from curricle.design.recipe_design import RecipeDesign, design_recipe
from curricle.design.relations import Relation
from curricle.design.search_budget import SearchBudget
from curricle.design.standing import standing_recipe
from curricle.display import brief_repr, printed
from curricle.errors import CurricleError, CurriculumError
from curricle.progress import Progress, check_progress
from curricle.tasks.families.family import FamilyMember

EXTRA = 0.1
"""Share of scratch's steps that a search saves on top of a standing recipe: .05 to .1 in mazes."""
OF_STEPS = 3
"""A training is expected to be so many times as long as scratch takes."""
MINIATURES = (0.5, 0.7)
"""Shares of a target that stand for it."""


@dataclass(frozen=True, eq=False)
class TargetDesign:
    """A curriculum for one target, and why it is this one.

    Attributes
    ----------
    problem : Problem
    recipe : Recipe
        Without stages where no curriculum is recommended.
    why : str
    search : RecipeDesign or None
        The search on miniatures; None where there was none.
    ledger : Ledger
        Of the search.
    """

    problem: Problem
    recipe: Recipe
    why: str
    search: RecipeDesign | None
    ledger: Ledger

    __repr__ = brief_repr
    _repr_html_ = printed

    @property
    def curriculum(self) -> Curriculum:
        """The curriculum of the target, with the settings of the problem."""
        return self.problem.curriculum(self.recipe)

    def __str__(self) -> str:
        return f"{self.recipe}\n{self.why}"


def design_curriculum(
    problem: Problem,
    *,
    trainings: int = 1,
    budget: SearchBudget | None = None,
    seed: int = 0,
    progress: Progress = None,
) -> TargetDesign:
    """Return a curriculum for one target.

    A search pays only where many trainings share its cost. Without a budget, the design searches on
    miniatures of the target if the trainings are expected to save what that costs: a tenth of
    what scratch takes in each, on top of what a standing recipe saves. Otherwise it takes the
    standing recipe, which costs nothing, or no curriculum where there is none for such a target.

    Parameters
    ----------
    problem : Problem
        The target, and how it is learnt.
    trainings : int
        Of the target that are to come, or of targets like it.
    budget : SearchBudget, optional
        For a search on miniatures, whatever the trainings.
    seed : int
    progress : bool or callable, optional
        Of the search, as in :func:`design_recipe`.

    Raises
    ------
    CurriculumError
        When a budget is given, and the target has no miniatures, or it pays for no race.
    SettingError
        When `progress` is none of what it may be.

    Examples
    --------
    >>> from curricle.paper.settings import maze
    >>> found = design_curriculum(Problem(maze(-5.0), steps=100_000, fraction=0.975))
    >>> print(found.why)
    A search costs more than it is expected to save in 1 training: at most 3,333 steps. The ...
    >>> found.curriculum.order
    ('rows 0..3, columns 6..9', 'rows 0..6, columns 3..9', 'target')
    """
    instance("the problem of a design", problem, Problem, CurriculumError)
    trainings = whole_number("the trainings of a design", trainings, 1, CurriculumError)
    check_progress(progress)
    worth = trainings * EXTRA * problem.steps / OF_STEPS
    small = miniatures(problem)
    if budget is not None and not small:
        raise CurriculumError(
            "a search needs miniatures: the target has no parts around its goal and is no member "
            "of a family with a size"
        )
    paid = SearchBudget(worth) if budget is None else budget
    if budget is not None or (small and worth >= sum(one.steps for one in small)):
        try:
            found = design_recipe(small, paid, seed=seed, progress=progress)
        except CurriculumError:
            if budget is not None:
                raise
        else:
            return TargetDesign(problem, found.recipe, found.why, found, found.ledger)
    why = (
        f"A search costs more than it is expected to save in {trainings:,} "
        f"training{'' if trainings == 1 else 's'}: at most {worth:,.0f} steps."
        if small
        else "No search: the target has no parts around its goal and is no member of a family with "
        "a size."
    )
    return _standing(problem, why, paid.ledger)


def miniatures(problem: Problem) -> list[Problem]:
    """Return problems that stand for one: smaller members of its family, or parts of the target.

    Learnt with the same settings, half and seven tenths of its size; none where it has neither.

    Examples
    --------
    >>> from curricle.tasks import maze_family
    >>> [one.name for one in miniatures(Problem(maze_family(size=10, seed=2), steps=1000))]
    ['maze(size=5, seed=2)', 'maze(size=7, seed=2)']
    """
    found = dict[str, Problem]()
    for share in MINIATURES:
        smaller = Relation("member", changes={"size": f"{share} n"})
        relations = [smaller] if isinstance(problem.target, FamilyMember) else []
        for one in [*relations, Relation("crop", share)]:
            try:
                source = one.source_of(problem.target)
            except CurricleError:
                continue
            target = source.task if source.member is None else source.member
            small = replace(
                problem, target=target, threshold=None, miniature=True, name=source.name
            )
            found.setdefault(source.name, small)
            break
    return list(found.values())


def _standing(problem: Problem, why: str, ledger: Ledger) -> TargetDesign:
    known = standing_recipe(problem.target, problem.learner)
    if known is None:
        why += " No curriculum: there is no standing recipe for such a target and learner."
        return TargetDesign(problem, Recipe(), why, None, ledger)
    name, recipe = known
    why += f" The standing recipe of {name} costs nothing to find."
    return TargetDesign(problem, recipe, why, None, ledger)
