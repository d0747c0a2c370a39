"""Learning from miniatures, by distillation: :func:`learn_miniatures`."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from curricle.deep.distilling import distil
from curricle.deep.learner import DeepLearner
from curricle.deep.miniature_task import Miniatures
from curricle.deep.result import DeepResult
from curricle.errors import TaskError
from curricle.learning.record import Record
from curricle.learning.result import learning_result
from curricle.learning.run import Outcome
from curricle.progress import Progress, shown

WORTH = 0.02
"""Of the way from random to optimal: what a network must regain on held-out levels at least."""


def learn_miniatures(
    task: Miniatures,
    learner: DeepLearner,
    seeds: Sequence[int],
    potentials: Sequence[Any] = (),
    *,
    eval_freq: int = 1,
    progress: Progress = None,
) -> DeepResult:
    """Return networks fitted to what is known of miniatures, one for each seed, in no steps.

    ``greedy_return`` has one checkpoint: the exact discounted return of the network's policy on
    held-out levels, mean over members.

    Parameters
    ----------
    task : Miniatures
    learner : DeepLearner
        Whose networks they are.
    seeds : sequence of K int
    potentials : sequence of K potentials
        What each seed's sources say of the observations, instead of exact answers. Or none.
    eval_freq : int
        Of the result.
    progress : bool or callable, optional
        As in :func:`learn`.

    Raises
    ------
    SettingError
        As :func:`distil`.
    TaskError
        When a network acts no better than at random on held-out levels.
    """
    outcomes = []
    with shown(progress) as bars:
        grow = bars.bar("distilling", len(seeds))
        for k, seed in enumerate(seeds):
            known = task.knowledge(potential=potentials[k] if potentials else None, seed=seed)
            values = distil(known, task, learner, seed=seed).values
            outcomes.append(_outcome(task, values))
            grow()
            bars.tell(seed)
    each: Any = tuple(one.values for one in outcomes)
    found = learning_result(task, learner, tuple(seeds), each, outcomes, eval_freq)  # type: ignore[arg-type]
    return DeepResult.of(found)


def _outcome(task: Miniatures, values: Any) -> Outcome:
    """Return what one seed learnt; TaskError if it is worth nothing."""
    examined = task.examined(values)[: len(task.members)]
    record = Record.empty(1)
    record.greedy_return[0] = np.mean([one.best for one in examined])
    shares = [one.regained for one in examined if not np.isnan(one.regained)]
    regained = np.mean(shares) if shares else 1.0
    if regained < WORTH and not task.shuffled:
        raise TaskError(
            "a network distilled from miniatures must act better than at random on held-out "
            f"levels: it regains {regained:.0%} of the way to the optimum of {task}"
        )
    return Outcome(record, values, 0, 0, out_of_memory=False, evaluation_steps=0)
