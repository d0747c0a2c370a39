"""Predictors: functions from what is known before training to how much a candidate will gain.

All have one signature, so that they can be compared on tasks that none of them was fitted to
(``benchmarks/pairs/predictions.py``). Most only put candidates in order; :func:`trial` also says
how much is gained, with an interval.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from curricle.comparison.candidates import Candidate
from curricle.comparison.comparing import FRACTION
from curricle.comparison.trial import SEEDS, run_trial
from curricle.curriculum.sources import SourceValues
from curricle.learning.stopping import limits
from curricle.planning.greedy import Values
from curricle.planning.models import TabularPlanningModel
from curricle.planning.policy_evaluation import greedy_policy_return
from curricle.planning.target import Target
from curricle.statistics.intervals import Interval
from curricle.tasks.task import tables
from curricle.transfer.observation_rollouts import ObservationTarget
from curricle.transfer.quality import PotentialQuality

NAN = float("nan")
MOST_SWEEPS = 2000
"""Sweeps after which :func:`sweeps_left` stops looking for a good policy."""
RANK, COST, BASE = 0.19, 0.90, 0.05
"""Weights of :func:`knowledge_for_cost`: ridge regression of the realised gain, as a share of the
way from random to optimal, on the development pairs of ``benchmarks/pairs``."""
SPARSER = 1.2
"""Factor between the numbers of sweeps after which the greedy policy is evaluated."""


@dataclass(frozen=True, eq=False)
class Case:
    """What is known of a candidate before the target is trained.

    Attributes
    ----------
    candidate : Candidate
    target : Target or ObservationTarget
    sources : dict of str to SourceValues
        Trained, of K seeds.
    potentials : sequence of K potentials
    quality : sequence of K PotentialQuality
    """

    candidate: Candidate
    target: Target | ObservationTarget
    sources: Mapping[str, SourceValues]
    potentials: Sequence[Any]
    quality: Sequence[PotentialQuality]

    @property
    def source_share(self) -> float:
        """The share of the total steps, sources included, that the sources take."""
        plan = self.candidate.curriculum
        names = plan.ancestors(plan.target)
        spent = float(sum(self.sources[name].steps_used.mean() for name in names))
        return spent / (spent + limits(plan.setting("budget", plan.target))[0])


@dataclass(frozen=True)
class Prediction:
    """What a predictor says of a candidate.

    Attributes
    ----------
    score : float
        Orders candidates for one target, the best the highest; above 0 where a gain is expected.
        NaN where the predictor has nothing to say.
    gain : Interval or None
        The strong gain in mean return, where the predictor estimates it.
    assumes : str
        What it rests on, in words.
    """

    score: float
    gain: Interval | None
    assumes: str


Predictor = Callable[[Case], Prediction]


def start_value(case: Case) -> Prediction:
    """Return the start of phi's greedy policy above the random policy's return.

    As a share of the way to the optimum where that is known.
    """
    start = _mean(case, "start") - case.target.random_return
    whole = case.target.optimum - case.target.random_return
    score = start / whole if whole > 0 else start
    return Prediction(score, None, "learning goes on from where it starts")


def rank_agreement(case: Case) -> Prediction:
    """Return Spearman's rank correlation of phi and Q*."""
    return Prediction(_mean(case, "rank"), None, "pairs in the order of Q* are learnt from")


def optimism(case: Case) -> Prediction:
    """Return the mean excess of phi over Q*, in units of the mean size of V*.

    For optimism may explore, whatever phi knows.
    """
    size = max(_mean(case, "mean_absolute_value"), 1e-12)
    return Prediction(_mean(case, "excess") / size, None, "optimism explores")


def sweeps_left(case: Case) -> Prediction:
    """Return 1 - k(phi) / k(0) - share of the steps that the sources take.

    k(phi) counts the sweeps Q <- T max_a Q, from Q = phi, until the greedy policy's return has come
    nine tenths of the way from the random policy's return to the optimum; k(0) does so from 0. NaN
    where the target is not solved.
    """
    target = case.target
    assumes = "learning takes as many steps as planning takes sweeps"
    if not isinstance(target, Target) or target.solution is None:
        return Prediction(NAN, None, assumes)
    whole = target.optimum - target.random_return
    level = target.random_return + FRACTION * whole
    if whole <= 0:
        return Prediction(NAN, None, assumes)
    zero = np.zeros(target.solution.action_values.shape)
    alone = sweeps_until(target, zero, level)
    left = np.mean([sweeps_until(target, phi.values, level) for phi in case.potentials])
    score = 1 - float(left) / max(alone, 1) - case.source_share
    return Prediction(score, None, assumes)


def sweeps_until(target: Target, action_values: Any, level: float) -> int:
    """Return the Bellman sweeps until the greedy policy's return is at least `level`.

    Looked at after 0, 1, 2, ... sweeps, later after a fifth more each time, up to `MOST_SWEEPS`.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> target = Target.of(GridWorld("S..T", discount=0.5, time_limit=9))
    >>> sweeps_until(target, np.zeros((4, 4)), target.optimum)
    3
    """
    model = TabularPlanningModel.of(tables(target.task))
    q, done, wanted = np.array(action_values, dtype=np.float64), 0, 0
    while done < MOST_SWEEPS:
        while done < wanted:
            best = np.where(model.terminal, 0.0, q.max(axis=1))
            q, done = model.action_values(best), done + 1
        if greedy_policy_return(target.task, Values(q), target.evaluation) >= level - 1e-9:
            return done
        wanted = max(done + 1, int(SPARSER * done))
    return MOST_SWEEPS


def knowledge_for_cost(case: Case) -> Prediction:
    """Return 0.19 rank agreement - 0.90 share of the total steps that sources take + 0.05.

    The best of the combinations of two, without a trial; 0 stands for a rank that is unknown.
    """
    rank = float(np.nan_to_num(_mean(case, "rank")))
    score = RANK * rank - COST * case.source_share + BASE
    return Prediction(score, None, "knowledge and cost weigh as in the development pairs")


def trial(case: Case, *, seeds: int = SEEDS) -> Prediction:
    """Return the gain in a trial in the tasks' models (:func:`run_trial`).

    NaN where the candidate cannot be trained; CurriculumError where there is no model to try it in.
    """
    found = run_trial([case.candidate], seeds=seeds)
    gain = found.gain(case.candidate.name)
    score = NAN if gain is None else float(gain.estimate)
    return Prediction(score, gain, found.assumes)


def _mean(case: Case, measure: str) -> float:
    return float(np.mean([getattr(one, measure) for one in case.quality]))


PREDICTORS: Mapping[str, Predictor] = {
    one.__name__: one
    for one in (
        start_value,
        rank_agreement,
        optimism,
        sweeps_left,
        knowledge_for_cost,
        trial,
    )
}
"""All predictors by name."""
