"""Budgets: steps, episodes or a stopping rule; their checkpoints."""

from dataclasses import dataclass

from curricle.checks import whole_number
from curricle.errors import SettingError
from curricle.learning.stopping import StoppingRule
from curricle.tasks.mdp import NO_LIMIT
from curricle.text_tables import counted

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
        return counted(self.number, "episode")


Budget = int | Episodes | StoppingRule
"""Steps, episodes, or a stopping rule."""


def limits(budget: Budget) -> tuple[int, int]:
    """Return the most steps and the most episodes of a budget."""
    if isinstance(budget, Episodes):
        return int(NO_LIMIT), budget.number
    if isinstance(budget, StoppingRule):
        return budget.max_steps, int(NO_LIMIT)
    return whole_number("a budget in steps", budget, 1, SettingError), int(NO_LIMIT)


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
