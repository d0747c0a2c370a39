"""How long the trainings of a problem are to be: a little longer than scratch takes."""

import math
from collections.abc import Sequence

from curricle.design.problem import Problem
from curricle.design.search_budget import SearchBudget
from curricle.progress import Progress, shown

TIMED_SEEDS = 2
"""Of scratch, by which the length of trainings is set."""
CAP = 1.5
"""A training ends at so many times what scratch takes: what costs more is no better for it."""


def timed(
    problems: Sequence[Problem],
    budget: SearchBudget,
    first_seed: int = 0,
    progress: Progress = None,
) -> list[Problem]:
    """Return problems whose trainings end at one and a half times what scratch takes.

    Scratch is trained for two seeds in each. Those measured by area keep their length.

    Parameters
    ----------
    problems : sequence of Problem
    budget : SearchBudget
    first_seed : int
    progress : bool or callable, optional
        True shows a bar of the problems, a function is called with each shortened one.

    Raises
    ------
    SettingError
        When `progress` is none of what it may be.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> (short,) = timed([Problem(GridWorld("S..T"), steps=20_000)], SearchBudget(40_000))
    >>> short.steps < 20_000
    True
    """
    found, seeds = [], range(first_seed, first_seed + TIMED_SEEDS)
    with shown(progress) as bars:
        grow = bars.bar("scratch", len(problems))
        for one in problems:
            scratch = budget.train(one, one.scratch, seeds).steps
            most = CAP * scratch.mean() if one.measure == "time" else one.steps
            found.append(one.within(math.ceil(most)))
            grow()
            bars.tell(found[-1])
    return found
