"""When the training of a task stops: a rule applied at every checkpoint, and its decisions."""

import math
from collections import Counter
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba.extending import register_jitable

from curricle.arrays import FloatArray
from curricle.checks import number, whole_number
from curricle.errors import SettingError
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.planning.target import BATCHES, Target
from curricle.tasks.kernel import INLINED, compiled_as
from curricle.tasks.mdp import NO_LIMIT
from curricle.text import counted


@dataclass(frozen=True)
class StoppingRule:
    """A budget that ends as soon as the greedy policy is good enough, or gets no better.

    It is applied at each checkpoint after the first, to the greedy evaluations of one seed alone.
    No budget is charged for these (:class:`GreedyEvaluation`).

    Parameters
    ----------
    max_steps : int
        Steps after which learning ends in any case.
    min_steps : int
        Steps before which learning does not end.
    threshold : float, optional
        Learning ends when each of the last `patience` evaluations is at least this return.
    fraction : float, optional
        In [0, 1]: the threshold is worst + fraction (optimum - worst), where worst is the uniformly
        random policy's return. The task must be small enough to be solved.
    patience : int
    settled : float, optional
        Learning ends when the mean evaluation in the last three tenths of the steps exceeds that in
        the last three tenths of the steps before these by less than this share of the range so far,
        and lies past half of the way from random to the optimum: a return may settle with nothing
        learnt. In a task that cannot be solved it must exceed the random policy's return by more
        than the noise of ten free evaluations. Each part needs 8 evaluations. Sources end by it.
    agreed : float, optional
        Learning by :class:`OptimisticQLearning` ends when the optimistic value of the episode's
        start exceeds the learnt one by at most 1 less this share of the range of values, at each of
        the last `patience` evaluations, and the return lies as high as `settled` asks for.

    Raises
    ------
    SettingError
        When a number is out of range, or threshold and fraction are both given.

    Examples
    --------
    >>> from curricle import GridWorld, learn
    >>> rule = StoppingRule(max_steps=50_000, threshold=190.0, patience=2)
    >>> print(rule)
    50,000 steps, until a greedy return of 190.0 over 2 evaluations
    >>> result = learn(GridWorld("S..T"), budget=rule, eval_freq=100)
    >>> int(result.steps_used[0])
    200
    >>> print(rule.decisions(result.steps, result.greedy_return[0])[-1])
    ends; greedy 193 >= 190 over 2 evaluations; 200 of at most 50,000 steps used
    """

    max_steps: int
    min_steps: int = 0
    threshold: float | None = None
    fraction: float | None = None
    patience: int = 5
    settled: float | None = None
    agreed: float | None = None

    def __post_init__(self) -> None:
        for name, low in (("max_steps", 1), ("min_steps", 0), ("patience", 1)):
            label, value = f"{name} of a stopping rule", getattr(self, name)
            object.__setattr__(self, name, whole_number(label, value, low, SettingError))
        if self.min_steps > self.max_steps:
            raise SettingError(
                "min_steps of a stopping rule must not exceed max_steps: got "
                f"{self.min_steps:,} and {self.max_steps:,} steps"
            )
        for name, bounds in _BOUNDS.items():
            if getattr(self, name) is not None:
                number(f"{name} of a stopping rule", getattr(self, name), SettingError, *bounds)
        if self.threshold is not None and self.fraction is not None:
            raise SettingError(
                "a stopping rule takes a threshold or a fraction of the optimum, not both: got "
                f"{self.threshold:g} and {self.fraction:g}"
            )

    def __str__(self) -> str:
        over, ends = f"over {counted(self.patience, 'evaluation')}", list[str]()
        if self.threshold is not None:
            ends.append(f"a greedy return of {self.threshold} {over}")
        if self.fraction is not None:
            ends.append(f"{self.fraction} of the way to the optimum {over}")
        if self.settled is not None:
            ends.append("the return has settled")
        if self.agreed is not None:
            ends.append(f"an agreement of optimistic and learnt values of {self.agreed} {over}")
        until = f", until {' or '.join(ends)}" if ends else ""
        least = f"{self.min_steps:,} to " if self.min_steps else ""
        return f"{least}{counted(self.max_steps, 'step')}{until}"

    def kernel(self, level: float | None = None, floor: float = -math.inf) -> "StoppingKernel":
        """Return the rule for compiled loops; a task gives `level` and `floor`."""
        level = self.threshold if self.fraction is None else level
        bounds = level, self.settled, self.agreed
        level, settled, agreed = (math.nan if bound is None else float(bound) for bound in bounds)
        return StoppingKernel(self.min_steps, self.patience, level, settled, agreed, floor)

    def decisions(
        self,
        steps: npt.ArrayLike,
        greedy_return: npt.ArrayLike,
        *,
        agreement: npt.ArrayLike | None = None,
        level: float | None = None,
        floor: float = -math.inf,
        used: int | None = None,
    ) -> list["Decision"]:
        """Return the rule's decision at each checkpoint of one seed, up to its end.

        Parameters
        ----------
        steps : (T,) int64
        greedy_return : (T,) float64
            The seed's row of ``LearningResult.greedy_return``.
        agreement : (T,) float64, optional
            That of ``LearningResult.agreement``.
        level : float, optional
            The return that a fraction stands for.
        floor : float
            The return above which a return may have settled.
        used : int, optional
            Steps that the seed took in all; later checkpoints repeat its last value.
        """
        if self.fraction is not None and level is None:
            raise SettingError("a rule with a fraction needs the return that it stands for: level=")
        kernel, greedy = self.kernel(level, floor), np.asarray(greedy_return, dtype=np.float64)
        agreed = np.full(len(greedy), np.nan) if agreement is None else np.asarray(agreement)
        decisions = list[Decision]()
        for checkpoint, step in enumerate(np.asarray(steps).tolist()):
            if used is not None and step > used:
                break
            decisions.append(self.decision(kernel, greedy, agreed, checkpoint, step))
            if decisions[-1].ends or step >= self.max_steps:
                break
        return decisions

    def decision(
        self,
        kernel: "StoppingKernel",
        greedy: FloatArray,
        agreement: FloatArray,
        checkpoint: int,
        step: int,
    ) -> "Decision":
        """Return the decision at one checkpoint of a seed, `step` steps after its start."""
        return Decision(
            self,
            kernel,
            step,
            bool(stops(kernel, greedy, agreement, checkpoint, step)),
            lowest=float(lowest_of_last(kernel, greedy, checkpoint)),
            share=float(share_of_rise(greedy, checkpoint)),
            recent=float(recent_return(greedy, checkpoint)),
            agreement=float(lowest_of_last(kernel, agreement, checkpoint)),
        )


_BOUNDS: dict[str, tuple[float, ...]] = {
    "threshold": (),
    "fraction": (0.0, 1.0),
    "settled": (0.0, 1.0),
    "agreed": (0.0, 1.0),
}

UNLEARNT = "all steps used, not learnt"
"""The end of a run whose return lies too low to have settled."""

# Fitted on development families (benchmarks/pairs), where shares of 2 to 10 % gain the same.
SETTLED, RECENT, MIN_EVALUATIONS = 0.05, 0.7, 8
"""Share of its range by which a source's return may still rise; where the last part of a run
begins, as a share of its steps; evaluations in each of the two parts that are compared."""
AGREED = 0.9
"""Agreement at which a source ends by default; .8 and .95 give the same returns within .004."""


ALL_STEPS, ALL_EPISODES = "all steps used", "all episodes done"
MEMORY_FULL = "memory full"


class StoppingKernel(NamedTuple):
    """A stopping rule for the compiled loops; NaN where a condition is not set."""

    min_steps: int
    patience: int
    level: float
    settled: float
    agreed: float
    floor: float  # the return above which it may have settled


NEVER_STOPS = StoppingKernel(0, 1, math.nan, math.nan, math.nan, -math.inf)

plain_and_inlined: Any = register_jitable(**INLINED)
"""Of a function for compiled loops that is called from Python too."""


@plain_and_inlined
def lowest_of_last(rule, curve, checkpoint):
    """Return the lowest of a curve at the last evaluations; NaN if there are too few."""
    if checkpoint + 1 < rule.patience:
        return np.nan
    lowest = np.inf
    for i in range(checkpoint + 1 - rule.patience, checkpoint + 1):
        if not (curve[i] >= lowest or np.isnan(lowest)):  # one NaN makes the result NaN
            lowest = curve[i]
    return lowest


def _share_of_rise(greedy, checkpoint):
    """Return by how much the return rose lately, as a share of its range; NaN if that is 0."""
    # The longer a run takes, the longer is the part in which its return must not rise.
    recent = int(RECENT * checkpoint) + 1
    before = int(RECENT * RECENT * checkpoint) + 1
    if recent - before < MIN_EVALUATIONS:
        return np.nan
    lowest, highest, last, earlier = np.inf, -np.inf, 0.0, 0.0
    for i in range(checkpoint + 1):
        lowest = greedy[i] if greedy[i] < lowest else lowest  # as `min`, which compiles slowly
        highest = greedy[i] if greedy[i] > highest else highest
        if i >= recent:
            last += greedy[i]
        elif i >= before:
            earlier += greedy[i]
    if not highest > lowest:
        return np.nan
    rise = last / (checkpoint + 1 - recent) - earlier / (recent - before)
    return rise / (highest - lowest)


@compiled_as(_share_of_rise)
def share_of_rise(greedy: FloatArray, checkpoint: int) -> float:
    """Return the same in Python, bit for bit, for runs of ten thousand checkpoints."""
    returns, recent = greedy[: checkpoint + 1], int(RECENT * checkpoint) + 1
    before = int(RECENT * RECENT * checkpoint) + 1
    if recent - before < MIN_EVALUATIONS:
        return math.nan
    extent = float(np.fmax.reduce(returns) - np.fmin.reduce(returns))
    if not extent > 0:
        return math.nan
    return (_mean_in_order(returns[recent:]) - _mean_in_order(returns[before:recent])) / extent


def _mean_in_order(values: FloatArray) -> float:
    """Return a mean whose sum is added up from the first to the last, as compiled loops do."""
    return float(np.add.accumulate(values)[-1] / len(values))


def _recent_return(greedy, checkpoint):
    """Return the mean of the evaluations in the last three tenths of the steps; NaN before any."""
    first = int(RECENT * checkpoint) + 1
    total = 0.0
    for i in range(first, checkpoint + 1):
        total += greedy[i]
    return total / (checkpoint + 1 - first) if checkpoint >= first else np.nan


@compiled_as(_recent_return)
def recent_return(greedy: FloatArray, checkpoint: int) -> float:
    """Return the same in Python, bit for bit."""
    recent = greedy[int(RECENT * checkpoint) + 1 : checkpoint + 1]
    return _mean_in_order(recent) if len(recent) else math.nan


@plain_and_inlined
def stops(rule, greedy, agreement, checkpoint, step):
    """Return whether a rule ends a run at a checkpoint, given two curves, (T,) each."""
    if step == 0 or step < rule.min_steps:
        return False
    if lowest_of_last(rule, greedy, checkpoint) >= rule.level:  # false where a side is NaN
        return True
    settled = share_of_rise(greedy, checkpoint) < rule.settled
    if not (settled or lowest_of_last(rule, agreement, checkpoint) >= rule.agreed):
        return False
    return not recent_return(greedy, checkpoint) <= rule.floor  # true where nothing is evaluated


@dataclass(frozen=True)
class Decision:
    """The decision of a stopping rule at one checkpoint, and why. Prints as a sentence."""

    rule: StoppingRule
    kernel: StoppingKernel
    step: int
    ends: bool  # whether the rule ended the run
    lowest: float  # of the last evaluations, a return; NaN if there were too few
    share: float  # the rise over the last three tenths of the steps, of the range; NaN if unknown
    recent: float  # the mean of the evaluations in these steps
    agreement: float  # the lowest at the last evaluations
    evaluation_steps: int = 0  # of all of a run's decisions, in its last one
    ended_by: str = ""  # what ended the run, as its result recorded it; "" before its last decision

    @property
    def ended(self) -> bool:
        """Whether the run ended here."""
        return bool(self.criterion)

    @property
    def unlearnt(self) -> bool:
        """Whether the return lies too low to have settled."""
        return self.recent <= self.kernel.floor

    @property
    def criterion(self) -> str:
        """What ended the run, in a few fixed words; "" where the run went on."""
        if self.ended_by:
            return self.ended_by
        if self.ends:
            level = "threshold" if self.rule.fraction is None else "fraction of the optimum"
            conditions = {
                level: self.lowest >= self.kernel.level,
                "settled return": self.share < self.kernel.settled and not self.unlearnt,
                "agreement": self.agreement >= self.kernel.agreed and not self.unlearnt,
            }
            return f"{' and '.join(name for name, holds in conditions.items() if holds)} reached"
        if self.step < self.rule.max_steps:
            return ""
        return UNLEARNT if self.unlearnt else ALL_STEPS

    def __str__(self) -> str:
        """Return the verdict, each condition with the numbers that it compared, and the steps."""
        n, rule, kernel, few = self.rule.patience, self.rule, self.kernel, "too few evaluations"
        over = f"over {counted(n, 'evaluation')}"
        settled = f"{few}, or all equal, to tell whether the return has settled"
        parts = ["ends" if self.ended else "goes on"]
        for bound, value, name, form, of, unknown in (
            (kernel.level, self.lowest, "greedy", ".4g", over, f"{few} for a value over {n}"),
            (kernel.settled, self.share, "rise", ".2g", "of its range", settled),
            (kernel.agreed, self.agreement, "agreement", ".2g", over, f"{few} for an agreement"),
        ):
            if not math.isnan(bound):
                sign = "<" if value < bound else ">="
                compared = f"{name} {value:{form}} {sign} {bound:{form}} {of}"
                parts.append(unknown if math.isnan(value) else compared)
        if self.unlearnt:
            low = f"greedy {self.recent:.4g} <= {kernel.floor:.4g}, too low to have settled"
            parts.append(low)
        if self.step < rule.min_steps:
            parts.append(f"at least {rule.min_steps:,} steps first")
        parts.append(f"{self.step:,} of at most {rule.max_steps:,} steps used")
        if self.evaluation_steps:
            free = f"and {counted(self.evaluation_steps, 'step')} of evaluations, which are free"
            parts[-1] += f", {free}"
        return "; ".join(parts)


def stopping_kernel(
    budget: "Budget", task: Any, evaluation: GreedyEvaluation, target: Any = Target.of
) -> tuple[StoppingKernel, int]:
    """Return a budget's rule in a task for compiled loops, and the steps that its floor took.

    `target` makes a :class:`Target` of a task.
    """
    if not isinstance(budget, StoppingRule):
        return NEVER_STOPS, 0
    evaluated = evaluation.method != "off" and evaluation.horizon(task) < NO_LIMIT
    settles = (budget.settled, budget.agreed) != (None, None) and evaluated
    if budget.fraction is None and not settles:
        return budget.kernel(), 0
    solved = target(task, evaluation, episodes=BATCHES * evaluation.rollouts(task))
    level = None if budget.fraction is None else solved.level(budget.fraction)
    if not settles:
        return budget.kernel(level), 0
    return budget.kernel(level, solved.floor), solved.floor_steps


# -- what a stopping rule decided ------------------------------------------------------------------


class Decisions(list[list[Decision]]):
    """The decisions of a stopping rule at each checkpoint of each seed: a list of K lists."""

    def __repr__(self) -> str:
        ends = Counter(decisions[-1].criterion or "none yet" for decisions in self if decisions)
        criteria = ", ".join(f"{criterion} ({number})" for criterion, number in ends.most_common())
        return f"Decisions({counted(len(self), 'seed')}: {criteria or 'no stopping rule'})"


# -- budgets ---------------------------------------------------------------------------------------


MOST_CHECKPOINTS = 10_000_000


@dataclass(frozen=True)
class Episodes:
    """A budget in episodes; a bare number means steps.

    Parameters
    ----------
    number : int
        SettingError unless it is whole and at least 1.

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


Budget = int | Episodes | StoppingRule  # steps, episodes, or a stopping rule


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


def longest_run(time_limit: int | None, budget: Budget, eval_freq: int, envs: int = 1) -> int:
    """Return the most steps that a run can take, or raise SettingError if they are unbounded."""
    steps, episodes = limits(budget)
    if isinstance(budget, Episodes):
        if time_limit is None:
            raise SettingError("a budget in episodes needs a task with a time limit: none set")
        steps = (episodes + envs - 1) * time_limit  # the last ends beside unfinished episodes
    if steps // eval_freq > MOST_CHECKPOINTS:
        raise SettingError(
            f"a run may have at most {MOST_CHECKPOINTS:,} checkpoints: up to {steps:,} steps with "
            f"eval_freq {eval_freq:,} make {steps // eval_freq:,}"
        )
    return steps
