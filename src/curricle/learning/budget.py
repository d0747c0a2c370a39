"""Budgets: steps, episodes or a stopping rule; their checkpoints."""

from dataclasses import dataclass

from curricle.checks import whole_number
from curricle.errors import SettingError
from curricle.learning.stopping import SETTLED, StoppingRule
from curricle.tasks.mdp import NO_LIMIT

MOST_CHECKPOINTS = 10_000_000


@dataclass(frozen=True)
class Episodes:
    """A budget in episodes; a bare number means steps.

    Parameters
    ----------
    number : int

    Raises
    ------
    SettingError
        Unless the number is whole and at least 1.

    Examples
    --------
    >>> Episodes(800)
    Episodes(number=800)
    """

    number: int

    def __post_init__(self) -> None:
        number = whole_number("a budget in episodes", self.number, 1, SettingError)
        object.__setattr__(self, "number", number)

    def __str__(self) -> str:
        return f"{self.number:,} episodes"


Budget = int | Episodes | StoppingRule
"""Steps, episodes, or a stopping rule."""


UNTIL_LEARNT = StoppingRule(100_000, settled=SETTLED)
"""The budget of a source that is given none: the steps need not be guessed."""


def default_budget(is_source: bool) -> Budget:
    """Return the budget of a task that is given none."""
    return UNTIL_LEARNT if is_source else UNTIL_LEARNT.max_steps


def limits(budget: Budget) -> tuple[int, int]:
    """Return the most steps and the most episodes of a budget."""
    if isinstance(budget, Episodes):
        return int(NO_LIMIT), budget.number
    if isinstance(budget, StoppingRule):
        return budget.max_steps, int(NO_LIMIT)
    return whole_number("a budget in steps", budget, 1, SettingError), int(NO_LIMIT)


def settling_spacing(budget: Budget, pairs: int) -> int:
    """Return the steps between checkpoints of a task with so many pairs (S x A), its rule's own.

    A rule that waits for the return to settle needs more checkpoints than others, and soon: as
    often as every pair could be tried once, between a 400th and a 4,000th of the steps.
    """
    most = limits(budget)[0]
    return max(1, most // 4000, min(most // 400, pairs))


def spacing(eval_freq: int | None, budget: Budget) -> int:
    """Return the steps between checkpoints; a hundredth of a step budget where not given."""
    if eval_freq is None:
        return 100 if isinstance(budget, Episodes) else max(1, limits(budget)[0] // 100)
    steps = whole_number("eval_freq, the steps between checkpoints,", eval_freq, 1, SettingError)
    if steps > limits(budget)[0]:
        raise SettingError(
            f"eval_freq must not exceed the budget of {limits(budget)[0]} steps: got {eval_freq}"
        )
    return steps


def longest_run(time_limit: int | None, budget: Budget, eval_freq: int) -> int:
    """Return the most steps that a run can take, or raise SettingError if they are unbounded."""
    steps, episodes = limits(budget)
    if isinstance(budget, Episodes):
        if time_limit is None:
            raise SettingError("a budget in episodes needs a task with a time limit: none set")
        steps = episodes * time_limit
    if steps // eval_freq > MOST_CHECKPOINTS:
        raise SettingError(
            f"a run may have at most {MOST_CHECKPOINTS:,} checkpoints: up to {steps:,} steps with "
            f"eval_freq {eval_freq:,} make {steps // eval_freq:,}"
        )
    return steps


def ended_by(budget: Budget, out_of_memory: bool) -> str:
    """Return what ended a run that no stopping rule ended, in a few fixed words."""
    if out_of_memory:
        return "memory full"
    return "all episodes done" if isinstance(budget, Episodes) else "all steps used"
