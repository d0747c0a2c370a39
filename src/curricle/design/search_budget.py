"""The budget of a design: every training that it takes is paid from it, booked, and kept."""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from curricle.checks import number
from curricle.curriculum.curriculum import Curriculum
from curricle.design.journal import Journal
from curricle.design.ledger import Ledger
from curricle.design.problem import Problem, Training
from curricle.errors import CurriculumError
from curricle.tasks.families.family import FamilyMember
from curricle.transfer.component_mapping import ComponentMapping
from curricle.transfer.mapping import StateActionMapping


class BudgetSpent(CurriculumError):
    """What is left of a design's budget does not pay for a training."""


class SearchBudget:
    """What a design may spend on trainings, and what it has spent.

    A training is made only if the most that it can cost is left, so that a design never spends
    more than its budget. Where evaluations are rollouts, their steps are part of it.

    Parameters
    ----------
    cost : float
        Steps whose price is 1; infinite for no bound.
    prices : dict of str to float, optional
        Of a step of each class, as in :class:`Ledger`.
    workers : int, optional
        Threads over seeds. Results do not depend on them.
    journal : path, optional
        A file to which every training is written. Where it has trainings of the same design, these
        are read and not made again, so that a killed design goes on where it was.

    Raises
    ------
    CurriculumError
        When the cost is negative, or the journal is that of another design.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> problem, budget = Problem(GridWorld("S..T"), steps=2000), SearchBudget(5000)
    >>> one = budget.train(problem, problem.scratch, seeds=range(2))
    >>> bool(one.learnt.all()), bool(budget.left == 5000 - one.steps.sum())
    (True, True)
    """

    def __init__(
        self,
        cost: float,
        *,
        prices: Mapping[str, float] | None = None,
        workers: int | None = None,
        journal: str | Path | None = None,
    ) -> None:
        if cost != math.inf:
            cost = number("the budget of a design", cost, CurriculumError, 0)
        self.cost = self._limit = float(cost)
        self.ledger = Ledger(prices={} if prices is None else prices)
        self.workers = workers
        self._journal = None if journal is None else Journal(journal)

    @property
    def left(self) -> float:
        """What may still be spent, in steps whose price is 1."""
        return self._limit - self.ledger.cost

    @contextmanager
    def share(self, share: float, *, aside: float = 0.0) -> Iterator[None]:
        """Keep what is trained in this context to a share of what is left, less what is set aside.

        Examples
        --------
        >>> budget = SearchBudget(1000)
        >>> with budget.share(0.25):
        ...     print(budget.left)
        250.0
        """
        before = self._limit
        if math.isfinite(self.left):
            self._limit = self.ledger.cost + share * max(0.0, self.left - aside)
        try:
            yield
        finally:
            self._limit = before

    def most(
        self,
        problem: Problem,
        seeds: int,
        *,
        placebo: bool = False,
        curriculum: Curriculum | None = None,
    ) -> float:
        """Return the most that a training of a problem can cost for so many seeds.

        Parameters
        ----------
        problem : Problem
        seeds : int
        placebo : bool
            As in :meth:`Problem.train`.
        curriculum : Curriculum, optional
            What is trained, whose sources may be evaluated by rollouts too; by default the target
            alone.
        """
        prices = self.ledger.prices
        kinds = ("miniatures",) if problem.miniature else ("target", "sources")
        plan = problem.scratch if curriculum is None else curriculum
        trained = max(prices[kind] for kind in kinds) * problem.steps
        each: float = trained + prices["evaluation"] * problem.evaluated_at_most(plan)
        return each * seeds * (2 if placebo else 1)

    def affords(
        self,
        problem: Problem,
        seeds: int,
        *,
        placebo: bool = False,
        curriculum: Curriculum | None = None,
    ) -> bool:
        """Return whether that is left."""
        return self.most(problem, seeds, placebo=placebo, curriculum=curriculum) <= self.left

    def train(
        self,
        problem: Problem,
        curriculum: Curriculum,
        seeds: Sequence[int] | range,
        *,
        placebo: bool = False,
    ) -> Training:
        """Return what a curriculum costs in a problem, and book it.

        Parameters
        ----------
        problem : Problem
        curriculum : Curriculum
            Whose target is the problem's, such as ``recipe.curriculum(problem.target,
            **problem.settings)``.
        seeds : sequence of K int
        placebo : bool
            As in :meth:`Problem.train`.

        Raises
        ------
        BudgetSpent
            When what is left does not pay for the most that it can cost.
        """
        most = self.most(problem, len(seeds), placebo=placebo, curriculum=curriculum)
        if most > self.left:
            raise BudgetSpent(
                f"a training of {problem.name} for {len(seeds)} seeds may cost {most:,.0f} steps: "
                f"{self.left:,.0f} of the budget are left"
            )
        given = [int(seed) for seed in seeds]
        key = _key(problem, curriculum, given, placebo)
        known = None if self._journal is None else self._journal.next(key)
        if known is None:
            found, spent = problem.train(curriculum, given, placebo=placebo, workers=self.workers)
            if self._journal is not None:
                self._journal.add(key, {**_plain(found), "spent": dict(spent.steps)})
            steps = spent.steps
        else:
            steps = known["spent"]
            found = Training(
                np.array(known["steps"], np.int64),
                np.array(known["learnt"], bool),
                np.array(known["source_steps"], np.int64),
            )
        self.ledger = self.ledger.book(**steps)
        return found


def _plain(found: Training) -> dict[str, Any]:
    return {name: values.tolist() for name, values in found._asdict().items()}


def _key(problem: Problem, curriculum: Curriculum, seeds: list[int], placebo: bool) -> str:
    """Return a digest of all that a training depends on, but for code."""
    parts = [
        repr(problem.target) if isinstance(problem.target, FamilyMember) else problem.name,
        problem.level,
        problem.steps,
        problem.eval_freq,
        repr(problem.evaluation),
    ]
    for name in curriculum.order:
        node = curriculum.node(name)
        parts += [name, repr(node.learner), str(node.budget), repr(node.shaping)]
        parts += [getattr(node.aggregate, "__name__", repr(node.aggregate)), node.unknown_value]
        for edge in curriculum.in_edges(name):
            parts += [edge.source, edge.scale, edge.shift, repr(edge.calibration)]
            if isinstance(edge.mapping, ComponentMapping):  # which has an index once it was read
                parts += [repr(edge.mapping), edge.mapping.unmapped_value]
            elif isinstance(edge.mapping, StateActionMapping):
                parts.append(hashlib.sha256(np.asarray(edge.mapping.index).tobytes()).hexdigest())
    return hashlib.sha256(json.dumps([*parts, seeds, placebo]).encode()).hexdigest()[:32]
