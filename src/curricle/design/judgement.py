"""Whether a recipe pays on some problems: on new seeds, with its controls."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from curricle.array_types import FloatArray
from curricle.design.problem import Problem
from curricle.design.racing import PLACEBO, has_placebo
from curricle.design.recipe import Recipe
from curricle.design.search_budget import SearchBudget
from curricle.display import brief_repr
from curricle.errors import CurriculumError
from curricle.frozen_arrays import Frozen
from curricle.progress import Progress, shown
from curricle.statistics.curves import SCRATCH
from curricle.statistics.intervals import Interval, mean_interval

SEEDS = 16
"""Of a judgement, where the budget pays for them."""
MANY = 5
"""Problems from which on the interval is over them; of fewer it is over seeds."""
FEWEST = 3
"""Seeds of a judgement of few problems; of many, one."""
RECIPE = "recipe"


@dataclass(frozen=True, eq=False)
class Judgement(Frozen):
    """What recipes cost on problems, in seeds that no choice rests on.

    Attributes
    ----------
    steps : dict of str to (P, K) int64
        Until learnt, of scratch, the recipe, its placebo where targets have tables, and each other
        recipe.
    """

    steps: Mapping[str, npt.NDArray[np.int64]]

    __repr__ = brief_repr

    def shares(self, name: str) -> FloatArray:
        """Return the steps of an arm over the mean of scratch in the same problem, (P, K)."""
        return np.asarray(self.steps[name] / self.steps[SCRATCH].mean(axis=1, keepdims=True))

    def cost(self, name: str = RECIPE) -> float:
        """Return the mean over problems of an arm's steps over those of scratch."""
        return float(self.shares(name).mean())

    def saving(self, name: str = RECIPE, than: str = SCRATCH) -> Interval:
        """Return what an arm saves of what another one costs, as a share of scratch.

        With an interval over problems where they are five or more, else over seeds: it then holds
        for these problems alone.

        Examples
        --------
        >>> one = Judgement({"scratch": np.array([[100, 120]]), "recipe": np.array([[55, 55]])})
        >>> float(one.saving().estimate)
        0.5
        """
        less = self.shares(than) - self.shares(name)
        over_problems = less.shape[0] >= MANY
        return mean_interval(less.mean(axis=1) if over_problems else less.mean(axis=0))

    def problems_paid(self, name: str = RECIPE) -> tuple[int, int]:
        """Return in how many problems an arm cost less than scratch, and how many there are."""
        paid = self.steps[name].mean(axis=1) < self.steps[SCRATCH].mean(axis=1)
        return int(paid.sum()), len(paid)


def judge(
    problems: Sequence[Problem],
    recipe: Recipe,
    budget: SearchBudget,
    *,
    others: Mapping[str, Recipe] | None = None,
    seeds: int = SEEDS,
    first_seed: int = 0,
    progress: Progress = None,
) -> Judgement:
    """Return what a recipe, its controls and other recipes cost on problems.

    Parameters
    ----------
    problems : sequence of Problem
    recipe : Recipe
    budget : SearchBudget
    others : dict of str to Recipe, optional
    seeds : int
        At most; fewer where the budget does not pay for so many.
    first_seed : int
    progress : bool or callable, optional
        True shows a bar of all trainings, a function is called with the name of each problem that
        is judged.

    Raises
    ------
    CurriculumError
        When the budget does not pay for three seeds, or one where there are many problems.
    SettingError
        When `progress` is none of these.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.design.recipe import Stage
    >>> from curricle.design.relations import Relation
    >>> maze = Problem(GridWorld(["....T", ".PPP.", "S...."]), steps=20_000)
    >>> found = judge([maze], Recipe([Stage(Relation("crop", 0.6), 10)]), SearchBudget(2_000_000))
    >>> found.cost() < found.cost("placebo")
    True
    """
    arms = {RECIPE: recipe, **(others or {})}
    least = judgement_cost(problems, budget, len(arms) - 1)
    each = least / _fewest(problems)
    paid = int(min(seeds, budget.left / each)) if each else seeds
    if paid < _fewest(problems):
        raise CurriculumError(
            f"a judgement here may cost {least:,.0f} steps: {budget.left:,.0f} are left"
        )
    numbers = range(first_seed, first_seed + paid)
    steps: dict[str, list[npt.NDArray[np.int64]]] = {}
    placebo = bool(recipe.stages) and has_placebo(problems)
    with shown(progress) as bars:
        grow = bars.bar("judgement", len(problems) * (1 + len(arms) + placebo))
        for problem in problems:
            plans = {name: problem.curriculum(one) for name, one in arms.items()}
            played = [(SCRATCH, problem.scratch), *plans.items()]
            played += [(PLACEBO, plans[RECIPE])] * placebo
            for name, plan in played:
                found = budget.train(problem, plan, numbers, placebo=name == PLACEBO)
                steps.setdefault(name, []).append(found.steps)
                grow()
            bars.tell(problem.name)
    return Judgement({name: np.stack(rows) for name, rows in steps.items()})


def judgement_cost(problems: Sequence[Problem], budget: SearchBudget, others: int) -> float:
    """Return the most that a judgement of the fewest seeds can cost, with so many other recipes."""
    # Scratch, the recipe, and its placebo, whose sources are trained again.
    return _fewest(problems) * sum(budget.most(one, 1) for one in problems) * (4 + others)


def _fewest(problems: Sequence[Problem]) -> int:
    return 1 if len(problems) >= MANY else FEWEST
