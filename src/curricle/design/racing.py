"""Racing: successive halving of recipes over problems, with paired seeds.

Maron and Moore 1993, "Hoeffding races"; Birattari et al. 2002, "a racing algorithm for configuring
metaheuristics"; Jamieson and Talwalkar 2016, "non-stochastic best arm identification" for halving.
Each round trains what is left in runs of its own, a new seed of one problem after the other, twice
as many as in the round before, and keeps the better half by all runs so far.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from curricle.array_types import FloatArray, IntArray
from curricle.curriculum.curriculum import Curriculum
from curricle.design.problem import Problem, Training
from curricle.design.proposals import spread
from curricle.design.recipe import Recipe
from curricle.design.search_budget import BudgetSpent, SearchBudget
from curricle.design.timed_problems import CAP
from curricle.display import brief_repr, printed
from curricle.errors import CurricleError, CurriculumError
from curricle.progress import Bars, Progress, shown
from curricle.statistics.curves import SCRATCH
from curricle.tasks.task import has_tables
from curricle.text_tables import counted

FIRST_RUNS, MOST_RUNS = 4, 16
"""Runs of each arm in the first round, and in any; a run is one seed of one problem."""
PLACEBO = "placebo"
"""The control of the leader: its values shuffled over the target's pairs."""


@dataclass(frozen=True)
class Round:
    """One round of a race.

    Attributes
    ----------
    runs : int
        Of each arm.
    scores : dict of str to float
        Of each arm by all its runs so far: mean over problems of its steps over those of scratch.
        Lower is better.
    kept : tuple of str
        Arms that go on and scratch, the best first; those that always stay among them.
    cost : float
        Of the round, in steps whose price is 1.
    """

    runs: int
    scores: Mapping[str, float]
    kept: tuple[str, ...]
    cost: float

    __repr__ = brief_repr


@dataclass(frozen=True, eq=False)
class Race:
    """A race of recipes.

    Attributes
    ----------
    problems : tuple of Problem
        P of them.
    arms : dict of str to Recipe
        That ran, without scratch and the placebo.
    steps : dict of str to list of (K,) int64
        Of each arm, scratch and the placebo too: steps until learnt of its K runs in each problem.
    rounds : tuple of Round
    source_steps : dict of str to list of (K,) int64
        Of each arm, scratch and the placebo too: steps in sources of the same runs.
    dropped : dict of str to str
        Arms that some problem has no curriculum for, and why.
    unaffordable : int
        Arms that the budget did not pay for.
    ended : str
        Why it ended before one arm was left; empty if it did not.
    """

    problems: tuple[Problem, ...]
    arms: Mapping[str, Recipe]
    steps: Mapping[str, list[IntArray]]
    rounds: tuple[Round, ...]
    source_steps: Mapping[str, list[IntArray]]
    dropped: Mapping[str, str] = field(default_factory=dict)
    unaffordable: int = 0
    ended: str = ""

    __repr__ = brief_repr
    _repr_html_ = printed

    @property
    def ranking(self) -> tuple[str, ...]:
        """Arms and scratch by their scores in the last round that they were in, the best first."""
        last = dict[str, tuple[int, float]]()
        for number, one in enumerate(self.rounds):
            last |= {name: (-number, score) for name, score in one.scores.items()}
        last.pop(PLACEBO, None)
        return tuple(sorted(last, key=last.__getitem__))

    @property
    def leader(self) -> str:
        """The best of the last round: an arm, or "scratch" where none is better."""
        return self.rounds[-1].kept[0]

    def score(self, name: str) -> float:
        """Return the score of an arm in the last round that it was in."""
        return next(one.scores[name] for one in reversed(self.rounds) if name in one.scores)

    def differences(self, name: str, other: str) -> FloatArray:
        """Return by how much an arm costs more than another one, run by run, over scratch's mean.

        Of the last runs that both had, in each problem.
        """
        found = []
        for own, others, scratch in zip(
            self.steps[name], self.steps[other], self.steps[SCRATCH], strict=True
        ):
            n = min(len(own), len(others))
            if n == 0:
                continue
            found.append((own[len(own) - n :] - others[len(others) - n :]) / scratch.mean())
        return np.concatenate(found)

    def source_share(self, name: str) -> float:
        """Return the mean over problems of an arm's source steps over the steps of scratch.

        By all its runs, and the runs of scratch that have the same seeds.
        """
        found = []
        for own, scratch in zip(self.source_steps[name], self.steps[SCRATCH], strict=True):
            runs = len(scratch) if name == PLACEBO else len(own)  # which has fewer runs a round
            if len(own):
                found.append(own.mean() / scratch[:runs].mean())
        return float(np.mean(found))

    def __str__(self) -> str:
        lines = [
            f"round {n}: {counted(len(one.scores), 'arm')}, {counted(one.runs, 'run')} of each, "
            f"{one.cost:,.0f} steps"
            for n, one in enumerate(self.rounds, 1)
        ]
        best = sorted(self.rounds[-1].scores.items(), key=lambda pair: pair[1])
        return "\n".join([*lines, *(f"  {score:.3f}  {name}" for name, score in best)])


def race(
    problems: Sequence[Problem],
    arms: Mapping[str, Recipe],
    budget: SearchBudget,
    *,
    always: Sequence[str] = (),
    first_seed: int = 0,
    progress: Progress = None,
) -> Race:
    """Return a race of recipes on problems, all arms with the same seeds.

    Scratch is an arm, it always stays, and so does the placebo of the leader from the second round
    on, where the targets have tables. Where the budget does not pay for all arms, the first ones
    race.

    Parameters
    ----------
    problems : sequence of Problem
        Whose trainings are about as long as scratch takes (:func:`timed`).
    arms : dict of str to Recipe
    budget : SearchBudget
    always : sequence of str
        Arms that stay in the race whatever they cost, such as a fixed recipe.
    first_seed : int
        Seeds of the race begin with it.
    progress : bool or callable, optional
        True shows a bar of the trainings of each round, a function is called with each
        :class:`Round`.

    Raises
    ------
    CurriculumError
        When there is no arm, or the budget does not pay for one round.
    SettingError
        When `progress` is none of these.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.design.recipe import Stage
    >>> from curricle.design.relations import Relation
    >>> maze = Problem(GridWorld(["....T", ".PPP.", "S...."]), steps=20_000)
    >>> near = {f"{n}": Recipe([Stage(Relation("crop", 0.6), n)]) for n in (10, 1000)}
    >>> race([maze], near, SearchBudget(400_000)).leader
    '10'
    """
    if not problems:
        raise CurriculumError("a race needs a problem: got none")
    if SCRATCH in arms or PLACEBO in arms:
        raise CurriculumError(f"the names {SCRATCH!r} and {PLACEBO!r} are those of controls")
    curricula, dropped = _curricula(problems, arms)
    with shown(progress) as bars:
        state = _Running(problems, budget, first_seed, bars)
        names = state.affordable(curricula, always)
        rounds, ended = state.halved(names, curricula, always)
    ran = {name: arms[name] for name in names}
    missing = len(curricula) - len(names)
    measured = state.steps, tuple(rounds), state.source_steps
    return Race(tuple(problems), ran, *measured, dropped, missing, ended)


class _Running:
    """What a race has measured so far."""

    def __init__(
        self, problems: Sequence[Problem], budget: SearchBudget, first_seed: int, bars: Bars
    ) -> None:
        self.budget, self.next_seed, self.problems = budget, first_seed, problems
        self.bars = bars
        self.order = spread(range(len(problems)))
        self.steps: dict[str, list[IntArray]] = {}
        self.source_steps: dict[str, list[IntArray]] = {}

    def _keep(self, name: str, p: int, found: Training) -> None:
        for kept, steps in (
            (self.steps, found.steps),
            (self.source_steps, found.source_steps),
        ):
            lists = kept.setdefault(name, [np.empty(0, np.int64) for _ in self.problems])
            lists[p] = np.concatenate([lists[p], steps])

    def score(self, name: str) -> float:
        """Return the mean over problems of an arm's steps over those of scratch."""
        pairs = zip(self.steps[name], self.steps[SCRATCH], strict=True)
        return float(np.mean([own.mean() / other.mean() for own, other in pairs if len(own)]))

    def affordable(self, curricula: Mapping[str, Any], always: Sequence[str]) -> list[str]:
        """Return the arms that a budget pays for: those that always stay, then the first ones."""
        stay = [name for name in always if name in curricula]
        names = stay + [name for name in curricula if name not in stay]
        if not names:
            raise CurriculumError(
                "a race needs a recipe that has sources in every problem: an easier member, a part "
                "around the goal, starts near it"
            )
        each, left = race_cost(self.problems, self.budget), self.budget.left
        while len(names) > len(stay) + 1 and each * _runs(len(names), len(stay)) > left:
            names.pop()
        least = each * _runs(len(names), len(stay))
        if least > left:
            raise CurriculumError(f"a race here needs {least:,.0f} steps: {left:,.0f} are left")
        return names

    def halved(
        self, names: list[str], curricula: Mapping[str, list[Curriculum]], always: Sequence[str]
    ) -> tuple[list[Round], str]:
        """Return the rounds of a race, and why it ended before one arm was left; or nothing."""
        left, rounds = names, list[Round]()
        for number in range(_rounds(len(names))):
            before = self.budget.ledger.cost
            playing = [SCRATCH, *left]
            try:
                runs = self.play(number, curricula, playing)
                if rounds and has_placebo(self.problems):
                    self.play_placebo(number, curricula[left[0]])
                    playing.append(PLACEBO)
            except BudgetSpent as spent:
                if not rounds:
                    raise
                return rounds, str(spent)
            scores = {name: self.score(name) for name in playing}
            ranked = sorted(left, key=lambda name: (scores[name], names.index(name)))
            half = ranked[: max(1, len(ranked) // 2)]
            left = half + [name for name in ranked if name in always and name not in half]
            kept = sorted([SCRATCH, *left], key=lambda name: (scores[name], name != SCRATCH))
            rounds.append(Round(runs, scores, tuple(kept), self.budget.ledger.cost - before))
            self.bars.tell(rounds[-1])
        return rounds, ""

    def play(
        self, number: int, curricula: Mapping[str, list[Curriculum]], names: Sequence[str]
    ) -> int:
        """Train arms in the runs of a round; return how many runs each had.

        Where the budget ends within the round none of its runs is kept: arms would not be paired.
        """
        runs, played = _runs_of(number), list[tuple[str, int, Training]]()
        turns = [*self._seeds(runs)]
        grow = self.bars.bar(f"round {number + 1}", len(turns) * len(names))
        for p, seeds in turns:
            for name in names:
                problem = self.problems[p]
                plan = problem.scratch if name == SCRATCH else curricula[name][p]
                played.append((name, p, self.budget.train(problem, plan, seeds)))
                grow()
        for name, p, found in played:
            self._keep(name, p, found)
        self.next_seed += -(-runs // len(self.problems))
        return runs

    def play_placebo(self, number: int, plans: list[Curriculum]) -> None:
        """Train the placebo of a curriculum in a quarter of the runs of a round."""
        turns = [*self._seeds(_runs_of(number) // 4)]
        grow = self.bars.bar(f"round {number + 1}, placebo", len(turns))
        for p, seeds in turns:
            found = self.budget.train(self.problems[p], plans[p], seeds, placebo=True)
            self._keep(PLACEBO, p, found)
            grow()

    def _seeds(self, runs: int) -> Iterator[tuple[int, range]]:
        """Yield each problem of a round and its seeds; problems take turns."""
        n = len(self.problems)
        for turn, p in enumerate(self.order):
            seeds = runs // n + (turn < runs % n)
            if seeds:
                yield p, range(self.next_seed, self.next_seed + seeds)


def _curricula(
    problems: Sequence[Problem], arms: Mapping[str, Recipe]
) -> tuple[dict[str, list[Curriculum]], dict[str, str]]:
    """Return the curricula of each arm, one a problem, and why others have none."""
    found, dropped = dict[str, list[Curriculum]](), dict[str, str]()
    for name, recipe in arms.items():
        try:
            found[name] = [one.curriculum(recipe) for one in problems]
        except CurricleError as error:
            dropped[name] = str(error)
    return found, dropped


def _rounds(arms: int) -> int:
    """Return the rounds of a race: until one arm is left, and at least two."""
    return max(2, math.ceil(math.log2(arms)))


def has_placebo(problems: Sequence[Problem]) -> bool:
    """Return whether values can be shuffled over the pairs of all targets: they need tables."""
    return all(has_tables(one.task) for one in problems)


def race_cost(problems: Sequence[Problem], budget: SearchBudget) -> float:
    """Return what one run of a race is expected to cost: as much as scratch, on average."""
    return float(np.mean([budget.most(one, 1) for one in problems])) / CAP


def fewest_runs(always: int) -> int:
    """Return the runs of a race of one arm besides those that always stay."""
    return _runs(always + 1, always)


def _runs_of(number: int) -> int:
    return min(MOST_RUNS, FIRST_RUNS << number)


def _runs(arms: int, always: int) -> int:
    """Return the trainings that a race of so many arms takes.

    Examples
    --------
    >>> _runs(4, 0)  # 4 of 4 arms and scratch; 8 of 2 and scratch, 2 of the placebo, which is two
    48
    """
    found, left = 0, arms
    for number in range(_rounds(arms)):
        runs = _runs_of(number)
        found += runs * (left + 1) + (2 * (runs // 4) if number else 0)
        left = min(left, max(1, left // 2) + always)
    return found
