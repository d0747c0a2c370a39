"""How the greedy policy is judged while learning."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from curricle.checks import one_of, whole_number
from curricle.errors import SettingError
from curricle.learning import kernels
from curricle.tasks.mdp import FiniteMDP

LARGEST_EXACT = 20_000
"""Outcomes (S x A x O) up to which ``method="auto"`` follows the greedy policy exactly."""
NEGLIGIBLE = 1e-9
"""Probability (or discounted weight) of still being under way at which an evaluation stops."""


@dataclass(frozen=True)
class GreedyEvaluation:
    """How the greedy policy is judged at each checkpoint.

    It is the expected return of one episode from the start distribution, cut at the time limit,
    ties broken uniformly, in the task's own (unshaped) rewards.

    Parameters
    ----------
    method : {"auto", "exact", "rollouts"}
        Exactly, by following the distribution over states; or as the mean of some episodes. "auto"
        is exact up to 20,000 outcomes (states x actions x outcomes of a pair).
    episodes : int
        Rollouts a checkpoint.
    discounted : bool
        Whether rewards are discounted, as :func:`solve` does, or summed as the paper does.

    Examples
    --------
    >>> GreedyEvaluation(method="rollouts", episodes=10)
    GreedyEvaluation(method='rollouts', episodes=10, discounted=True)
    """

    method: Literal["auto", "exact", "rollouts"] = "auto"
    episodes: int = 100
    discounted: bool = True

    def __post_init__(self) -> None:
        one_of("method", self.method, ("auto", "exact", "rollouts"), SettingError)
        whole_number("episodes of an evaluation", self.episodes, 1, SettingError)

    def settings(self, mdp: FiniteMDP) -> kernels.Evaluation:
        """Return the evaluation of this task as the compiled loops read it."""
        if mdp.time_limit is not None:
            horizon = mdp.time_limit
        elif not self.discounted:
            raise SettingError(
                "an undiscounted evaluation needs a task with a time limit: none set"
            )
        elif 0 < mdp.discount < 1:
            horizon = int(np.ceil(np.log(NEGLIGIBLE) / np.log(mdp.discount)))
        else:
            horizon = 1 if mdp.discount == 0 else int(kernels.NO_LIMIT)
        outcomes = mdp.outcome_row.size * mdp.probability.shape[1]
        exact = self.method == "exact" or (self.method == "auto" and outcomes <= LARGEST_EXACT)
        return kernels.Evaluation(exact, self.episodes, self.discounted, horizon, NEGLIGIBLE)
