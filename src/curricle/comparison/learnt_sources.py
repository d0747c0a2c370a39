"""Did a source learn its own task? Its greedy return, against its optimum or a fresh learner's.

Values of a source that did not learn can be worse than none. No step is charged to find out: the
optimum follows from a model, and a fresh learner's steps, twice as many, are simulated. Networks
distilled from miniatures are examined on held-out levels.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from curricle.arrays import FloatArray, Frozen, frozen
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.node import Node
from curricle.curriculum.result import SourceValues
from curricle.deep.miniature import Miniatures
from curricle.display import printed
from curricle.planning.greedy import Values, VisitedValues
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.planning.target import NOT_LEARNT, STANDARD_ERRORS, Target
from curricle.progress import Bars, Progress, shown
from curricle.tasks.live import is_live
from curricle.tasks.mdp import generative_model
from curricle.tasks.observation_task import is_observation_task, made_by
from curricle.text import brief_repr, counted

LEARNT = 0.9  # share of the way from random to the reference from which a source learnt its task
OPTIMUM, FRESH, UNKNOWN = "its optimum", "a fresh learner", ""  # what a source is measured by


@dataclass(frozen=True, eq=False)
class SourceLearning(Frozen):
    """How much of its own task a source learnt. Prints as a sentence."""

    name: str
    seeds: tuple[int, ...]  # K of them
    returns: FloatArray  # (K,): of the greedy policy of each seed's values, in the source's task
    random_return: float  # of the uniformly random policy there
    reference: float  # the return of an optimal policy, or a fresh learner's mean; NaN if unknown
    measured_by: str  # what the reference is: "its optimum", "a fresh learner", or nothing
    # Standard error of the mean of `returns` that is due to rollouts, with that of the random
    # return and of the reference; 0 where all are exact.
    noise: float = 0.0
    # Steps of the fresh learner, a seed; 0 without one. They are no steps of the curriculum.
    fresh_steps: int = field(default=0, kw_only=True)

    __repr__ = brief_repr
    _repr_html_ = printed

    @property
    def shares(self) -> FloatArray:
        """(K,) shares of the way from random to the reference; NaN if there is no such way."""
        way = self.reference - self.random_return
        if not way > STANDARD_ERRORS * self.noise:
            return np.full(len(self.seeds), np.nan)
        return np.asarray((self.returns - self.random_return) / way)

    @property
    def share(self) -> float:
        """The mean of the shares; NaN if there is no way from random to the reference."""
        return float(self.shares.mean())

    @property
    def learnt(self) -> bool | None:
        """Whether it learnt at least nine tenths of the way; None if that is unknown."""
        return None if np.isnan(self.share) else self.share >= LEARNT

    def __str__(self) -> str:
        got, random = f"{self.returns.mean():.4g}", f"{self.random_return:.4g}"
        if self.measured_by == UNKNOWN:
            # No better than random is a fact, whatever the optimum is.
            if self.returns.mean() - self.random_return <= STANDARD_ERRORS * self.noise:
                return (
                    f"{self.name} did NOT learn its own task: {got}, no better than random "
                    f"({random}); its values may mislead"
                )
            return f"{self.name} returns {got} where random is {random}; its optimum is not known"
        by = self.measured_by
        if self.fresh_steps:
            by += f" of {self.fresh_steps:,} steps"
        if np.isnan(self.share):
            return (
                f"{self.name} cannot be judged: {by} returns {self.reference:.4g}, no more than "
                f"random ({random})"
            )
        if self.share < NOT_LEARNT:
            return (
                f"{self.name} did NOT learn its own task: {got} where random is {random} and {by} "
                f"{self.reference:.4g}; its values may mislead"
            )
        only = "" if self.learnt else "only "
        # 100 % only where no more than a thousandth is missing
        per_cent = round(100 * self.share)
        per_cent = per_cent if self.share >= 0.999 else min(99, per_cent)
        words = f"{self.name} learnt {only}{per_cent:d} % of the way to {by}"
        if self.shares.min() < NOT_LEARNT:
            failed = int((self.shares < NOT_LEARNT).sum())
            words += f", but {failed} of {counted(len(self.seeds), 'seed')} did NOT learn it"
        return words


def source_learning(
    curriculum: Curriculum,
    sources: Mapping[str, SourceValues],
    *,
    fresh: bool = True,
    workers: int | None = None,
    progress: Progress = None,
) -> dict[str, SourceLearning]:
    """Return for each source how much of its own task it learnt.

    Parameters
    ----------
    curriculum : Curriculum
    sources : dict of str to SourceValues
        Such as ``CurriculumResult.sources``. Only those in dense tables that others build on count.
    fresh : bool
        Whether a source that cannot be solved, and is not live, is measured by a fresh learner of
        twice its steps.
    workers : int, optional
        Threads over seeds.
    progress : bool or callable, optional
        True shows a bar for each fresh learner; a function is called with each source's name.
    """
    learnings, read = {}, {edge.source for edge in curriculum.transfers}
    with shown(progress) as bars:
        for name, learnt in sources.items():
            dense = name in read and isinstance(learnt.values, np.ndarray)
            if not dense or is_observation_task(curriculum.tasks[name]):
                continue
            generative = generative_model(curriculum.tasks[name])
            if generative.time_limit is not None or generative.discount < 1:  # episodes are bounded
                node = curriculum.node(name)
                learnings[name] = _learning(node, learnt, fresh, workers, bars.within())
                bars.tell(name)
    return learnings


def _learning(
    node: Node, learnt: SourceValues, fresh: bool, workers: int | None, bars: Bars
) -> SourceLearning:
    generative, evaluation = generative_model(node.task), node.evaluation
    if generative.time_limit is None:  # nothing else has a bound
        evaluation = replace(evaluation, discounted=True)
    target = Target.of(node.task, evaluation)
    random, random_noise = target.estimated(VisitedValues.none(generative.actions.size))
    returns, noise = _returns(target, learnt.values)
    reference, reference_noise, by, steps = float("nan"), 0.0, UNKNOWN, 0
    if target.solution is not None:
        best = Values(target.solution.optimal.astype(np.float64))
        reference, reference_noise = target.estimated(best)
        by = OPTIMUM
    elif fresh and not is_live(node.task):
        steps = 2 * int(learnt.steps_used.max())
        # Without sources, on random streams of its own.
        off = GreedyEvaluation(method="off")
        name = f"{node.name}/fresh"
        alone = replace(node, name=name, budget=steps, eval_freq=steps, evaluation=off)
        trained = alone.train(learnt.seeds, workers=workers, progress=bars)
        of_fresh, reference_noise = _returns(target, trained.values)
        reference, by = float(of_fresh.mean()), FRESH
    total = float(np.sqrt(noise**2 + random_noise**2 + reference_noise**2))
    return SourceLearning(
        node.name, learnt.seeds, frozen(returns), random, reference, by, total, fresh_steps=steps
    )


def _returns(target: Target, values: Any) -> tuple[FloatArray, float]:
    """Return the greedy return of each of K tables, and the standard error of their mean."""
    estimates = [target.estimated(Values(table)) for table in values]
    returns, noise = np.array(estimates).T
    return returns, float(np.sqrt((noise**2).sum()) / len(estimates))


@dataclass(frozen=True, eq=False)
class DistilledSource(Frozen):
    """What networks of K seeds regain of the way from the random policy to the optimum."""

    name: str
    members: tuple[str, ...]  # M: the miniatures, then those that are only tested on
    levels: tuple[str, ...]  # which levels each was examined on, and how many
    shares: FloatArray  # (K, M): what each seed regains in each

    @property
    def expected(self) -> float:
        """The share to expect of the target: that of the last member, the nearest to it."""
        # benchmarks/deep_forecast.py measures how well it ranks sources.
        return float(self.shares[:, -1].mean())

    def __str__(self) -> str:
        examined = zip(self.shares.mean(axis=0), self.levels, self.members, strict=True)
        texts = [
            f"{round(x, 2) + 0.0:.0%} on {levels} of {member}" for x, levels, member in examined
        ]
        return f"{self.name}'s network regains {', '.join(texts)} of the way from random to optimal"


def distilled_sources(
    tasks: Mapping[str, object], sources: Mapping[str, SourceValues]
) -> dict[str, DistilledSource]:
    """Return how well each source that was distilled from miniatures acts, by its name."""
    distilled = {}
    for name, learnt in sources.items():
        task = tasks.get(name)
        if isinstance(task, Miniatures) and learnt.values is not None:
            examinations = [task.examined(values) for values in learnt.values]
            shares = np.array([[exam.regained for exam in examined] for examined in examinations])
            members = tuple(made_by(exam.member.make) for exam in examinations[0])
            levels = tuple(counted(exam.levels, exam.kind) for exam in examinations[0])
            distilled[name] = DistilledSource(name, members, levels, shares)
    return distilled
