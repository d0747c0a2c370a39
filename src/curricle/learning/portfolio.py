"""A portfolio of two learners of the same steps, and which of them acts the next turn.

A learner that starts at a potential can be misled by it. An optimistic learner, which tries what it
does not know, finds the optimum without a source, but may take long. Each learns from the other's
steps, so that what counts is who acts: whoever earns more.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from curricle.arrays import FloatArray, FloatTable, IntArray
from curricle.checks import whole_number
from curricle.errors import SettingError
from curricle.learning.learners import value_bounds
from curricle.learning.storage import DenseTable
from curricle.tasks.kernel import inlined, uniform
from curricle.tasks.mdp import Task, generative_model, has_tables

OTHER, SOURCE = np.uint64(0), np.uint64(1)
"""The optimistic learner, or the learner from scratch in its place, and the source's learner."""
FIRST_OF_SOURCE = 5.0
"""Turns of the source's learner before the two are compared, spread among those of the other."""
COMPARED = 2.0  # turns of each learner from which on its returns have a variance
UNDECIDED = 0.5
"""The source's share before there is anything to compare. Above it that learner is ahead."""
LATEST = 0.05  # least weight of a return in the mean of its start
HORIZON = 0.02  # least weight of a turn's length in the mean that the optimist's rate depends on
TURN, WHOLE = 3.0, 10.0
"""An episode is a turn where it has WHOLE / (1 - discount) steps at most. Elsewhere turns are cut
after TURN / (1 - discount) steps, by when a return has 95 % of its weight."""


@dataclass(frozen=True)
class Portfolio:
    """A second learner, which explores by optimism, beside the source's: whoever earns more acts.

    Both learn from every step, and act in turns. A turn is an episode; where episodes may last
    longer than 10 / (1 - discount) steps, or without limit, it ends after 3 / (1 - discount) steps.

    The source's learner is the learner as set, with the shaping. The optimistic learner is
    :class:`OptimisticQLearning` with the rate (H + 1) / (H + n) at a pair's visit n, H being an
    exponential mean of the turns' lengths. Its second table, which starts at the lowest value, is
    what is evaluated and returned of it. Where the task has no tables to bound its values by, or
    neither a discount below 1 nor a time limit, the learner as set takes its place, without the
    shaping.

    A turn's score is its discounted return less the mean return of earlier turns from its first
    state. Each learner has an exponential mean of its scores, and the standard error of that mean.
    The source's learner acts the next turn with the probability that it earns more,

        p = Phi((mean_source - mean_other) / sqrt(error_source^2 + error_other^2)),

    which is Thompson sampling. It is ahead if p > 1/2: then it is evaluated, and its values are
    returned and transferred. Otherwise this is the other learner.

    Of any `longest_rest` successive turns each learner acts in at least one, for each seed, any
    potential and any task. So a source's learner that explores, as all but a greedy one do, never
    ceases to; both learn from all steps, and Q-learning converges to Q* under the usual conditions
    for any potential. How much a potential costs in a finite time is measured, not proved
    (docs/trust.md).

    Parameters
    ----------
    first_turns : int
        Turns of the other learner before the two are compared; the source's learner has 5.
    memory : int
        Turns of each learner over which scores are averaged; a tenth of all turns if that is more.
    longest_rest : int
        A learner that has not acted in this number of turns, less one, acts the next.

    Raises
    ------
    SettingError
        When a number is out of range.

    Examples
    --------
    >>> Portfolio(first_turns=20)
    Portfolio(first_turns=20, memory=50, longest_rest=100)
    """

    first_turns: int = 40
    memory: int = 50
    longest_rest: int = 100

    def __post_init__(self) -> None:
        for name in ("first_turns", "memory", "longest_rest"):
            whole_number(f"{name} of a portfolio", getattr(self, name), 2, SettingError)

    @property
    def kernel(self) -> "PortfolioKernel":
        """The portfolio as compiled loops read it."""
        return PortfolioKernel(*map(float, (self.first_turns, self.memory, self.longest_rest)))


class PortfolioKernel(NamedTuple):
    """A portfolio, for compiled loops."""

    first_turns: float
    memory: float
    longest_rest: float


NO_PORTFOLIO = PortfolioKernel(0.0, 0.0, 0.0)


class Tally(NamedTuple):
    """Both learners' scores in their last turns, averaged exponentially; weights add up to 1."""

    turns: FloatArray  # (2,)
    last: FloatArray  # (2,) the number of the last turn, counted from 1
    mean: FloatArray  # (2,)
    variance: FloatArray  # (2,)
    squares: FloatArray  # (2,) the sum of the squared weights: 1 / the effective sample size
    returns: FloatArray  # (S + 1,) mean return of turns from each state, and last from any
    starts: IntArray  # (S + 1,) their numbers
    share: FloatArray  # (2,) of the source's learner, and H

    @classmethod
    def empty(cls, n_states: int) -> Self:
        """Return the tally before the first turn."""
        starts = np.zeros(n_states + 1, np.int64)
        share = np.array([UNDECIDED, 0.0])
        turns, last, mean, variance, squares = np.zeros((5, 2))
        returns = np.zeros(n_states + 1)
        return cls(turns, last, mean, variance, squares, returns, starts, share)


class Members(NamedTuple):
    """The learners of a portfolio in the fast loop, with four rows for each state, side by side.

    They are the values of the source's learner, those of the optimist, those of its second table,
    whose greedy actions are not kept, as none acts on it, and the visits of the state's pairs. So
    a step waits for few pages of memory.
    """

    portfolio: PortfolioKernel
    tally: Tally
    highest: float  # cuts the values that the optimistic values bootstrap from
    blocks: FloatTable  # (S, 4 A) the four rows
    visits: npt.NDArray[np.unsignedinteger]  # (4 S, A) the same memory, read as whole numbers
    source: DenseTable
    learnt: DenseTable  # of the optimist


class Turn(NamedTuple):
    """A turn that has ended."""

    acting: np.uint64  # who acted
    start: np.uint64  # its first state
    length: int  # its steps
    earned: float  # its discounted return


def longest_turn(discount: float, time_limit: int) -> int:
    """Return the steps after which a turn ends, if no episode has ended before."""
    if discount == 1 or time_limit * (1 - discount) <= WHOLE:
        return time_limit
    return round(TURN / (1 - discount))


def optimism(task: Task) -> tuple[float, float] | None:
    """Return :func:`value_bounds`, which values may leave at discount 1; None if undetermined."""
    model = generative_model(task)
    endless = model.discount == 1 and model.time_limit is None
    return None if endless or not has_tables(task) else value_bounds(task)


@inlined
def horizon_of(tally, length):
    """Return H; before the first turn has ended, its steps so far."""
    return tally.share[1] if tally.share[1] > 0.0 else np.float64(length)


@inlined
def optimistic_rate(horizon, visits):
    """Return (H + 1) / (H + n) at visit n (Jin et al. 2018)."""
    return (horizon + 1.0) / (horizon + visits)


@inlined
def averaged(tally, place, earned):
    """Add a return to the mean of its start."""
    tally.starts[place] += 1
    part = 1.0 / tally.starts[place]
    part = part if part > LATEST else LATEST
    tally.returns[place] += part * (earned - tally.returns[place])


@inlined
def add_turn(portfolio, tally, turn):
    """Add a turn to the tally."""
    acting, start = turn.acting, turn.start
    anywhere = np.uint64(tally.starts.shape[0] - 1)
    place = start if tally.starts[start] > 0 else anywhere
    score = turn.earned - tally.returns[place] if tally.starts[place] > 0 else 0.0
    averaged(tally, start, turn.earned)
    averaged(tally, anywhere, turn.earned)
    tally.turns[acting] += 1.0
    total = tally.turns[OTHER] + tally.turns[SOURCE]
    tally.last[acting] = total
    part = 1.0 / total if total * HORIZON < 1.0 else HORIZON
    tally.share[1] += part * (turn.length - tally.share[1])
    memory = portfolio.memory if 10.0 * portfolio.memory > total else total / 10.0
    part = 1.0 / (tally.turns[acting] if tally.turns[acting] < memory else memory)
    deviation = score - tally.mean[acting]
    tally.mean[acting] += part * deviation
    tally.variance[acting] += part * deviation * deviation
    tally.variance[acting] *= 1.0 - part
    tally.squares[acting] = (1.0 - part) * (1.0 - part) * tally.squares[acting] + part * part


@inlined
def source_share(tally):
    """Return the probability that the source's learner earns more."""
    if tally.turns[OTHER] < COMPARED or tally.turns[SOURCE] < COMPARED:
        return UNDECIDED
    gain = tally.mean[SOURCE] - tally.mean[OTHER]
    error = tally.variance[OTHER] / (1.0 / tally.squares[OTHER] - 1.0)
    error += tally.variance[SOURCE] / (1.0 / tally.squares[SOURCE] - 1.0)
    if error == 0.0:
        return 1.0 if gain > 0.0 else 0.0 if gain < 0.0 else UNDECIDED
    return 0.5 * math.erfc(-gain / np.sqrt(2.0 * error))


@inlined
def next_turn(portfolio, tally, turn, bits):
    """Take a turn into account; return which learner acts the next one."""
    add_turn(portfolio, tally, turn)
    tally.share[0] = source_share(tally)
    others, sources, first = tally.turns[OTHER], tally.turns[SOURCE], portfolio.first_turns
    latest = others + sources - portfolio.longest_rest + 1.0
    if tally.last[OTHER] <= latest:
        return OTHER
    if tally.last[SOURCE] <= latest:
        return SOURCE
    if sources < FIRST_OF_SOURCE and (sources * first <= others * FIRST_OF_SOURCE):
        return SOURCE
    if others < first:
        return OTHER
    if sources < FIRST_OF_SOURCE:
        return SOURCE
    return SOURCE if uniform(bits) < tally.share[0] else OTHER
