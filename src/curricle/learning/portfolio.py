"""A portfolio of learners of the same steps, and which of them acts the next turn.

A learner that starts at a potential exploits it, and tries little else. Here the potential says
where exploring pays: an optimist whose values start a margin above it tries what it holds for good
first. A second optimist starts at the highest value everywhere, so that a potential that is wrong
costs a part of the steps and no more.
"""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from curricle.arrays import FloatArray
from curricle.checks import number
from curricle.errors import SettingError
from curricle.learning.learners import Visits, value_range_of
from curricle.learning.potential import PairPotential
from curricle.learning.stopping import plain_and_inlined
from curricle.learning.storage import DenseTable, SparseTable
from curricle.tasks.kernel import inlined

# The members. The first three have a row for each state, the fourth a table that never changes.
INFORMED, OPTIMIST, SOBER, SOURCE = (np.uint64(member) for member in range(4))
VISITS = np.uint64(3)  # the row of the visits of a state's pairs
PORTFOLIO_TABLES = 5  # the members' and the visits

# Fitted on the development families of benchmarks/pairs.
SELDOM = 0.05  # share of the steps in which the sober learner acts, and the source's policy
FIRST_TURNS, FIRST_SHARE = 5.0, 0.1
"""Turns that both have at first, as long as these are no more than that share of the steps."""
MEMORY = 10.0  # turns of a member over which returns are averaged
ABOVE = 3.0  # ranges of phi above its highest value at which optimism starts without bounds
MOST_OPTIMIST = 1.0 - 3.0 * SELDOM
TURN, WHOLE = 3.0, 10.0
"""An episode is a turn where it has WHOLE / (1 - discount) steps at most. Elsewhere turns are cut
after TURN / (1 - discount) steps, by when a return has 95 % of its weight."""


@dataclass(frozen=True)
class Portfolio:
    """Learners of the same steps that act in turns, so that a potential directs exploration.

    Its members:

    - the *informed optimist*: its values start at phi + margin (max phi - min phi), cut to the
      bounds of the task's values (:func:`value_bounds`), and at the upper bound where no source
      knows a pair;
    - the *optimist*: its values start at the upper bound;
    - the *sober learner*: its values start at the lower bound, so that it prefers what was tried;
    - the *source's policy*: greedy on phi, which never changes.

    All act greedily. The two optimists learn from every step, the sober learner from every step of
    theirs: Q-learning with the rate (H + 1) / (H + n) at a pair's visit n, H = min(time limit,
    1 / (1 - discount)), for the sober learner at most 0.3. While every pair has had one outcome
    alone, a next state and a reward, the rate is 1. Of the learner as set only its class is used,
    which must be :class:`QLearning`.

    A turn is an episode; where episodes may last longer than 10 / (1 - discount) steps, or without
    limit, it ends after 3 / (1 - discount) steps. The member acts that is most behind its share of
    the steps: `optimist`, 0.05 for the sober learner and for the source's policy, and what is left
    for the informed optimist. The latter two first have five turns, as long as a tenth of the steps
    allows them. After N steps, with turns of L steps at most, a member of share p has therefore
    acted in at least p (0.8 N - 3 L) steps, for any potential and any task.

    What is evaluated, returned and transferred is the sober learner's values; it is phi while the
    turns of the source's policy earn more than those of the sober learner, by more than a standard
    error of the difference. Both are averaged over about ten turns, once each has had five.

    Where transitions are deterministic, and phi plus the margin is nowhere below Q* (an exact
    mapping; a source with errors of at most the margin), the informed optimist's values never fall
    below Q*: what it leaves untried is no better than what it does. Where phi is lower, the
    optimist remains, which no potential reaches.

    A task without tables, or with more than 10 million pairs, gives no bounds. Unless these are
    stated, the optimist starts at max phi plus three times the range of phi, and the sober learner
    at what the lowest rewards so far allow; its values fall with it. A task with neither a discount
    below 1 nor a time limit has no H, and no portfolio.

    Parameters
    ----------
    margin : float
        What the informed optimist's values start above phi, as a share of phi's range.
    optimist : float
        The optimist's share of the steps, at most 0.85.
    value_range : (float, float), optional
        Lowest and highest value of a state, in place of :func:`value_bounds`.

    Raises
    ------
    SettingError
        When a number is out of range.

    Examples
    --------
    >>> Portfolio(margin=0.3)
    Portfolio(margin=0.3, optimist=0.7, value_range=None)
    """

    margin: float = 0.1
    optimist: float = 0.7
    value_range: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        number("margin of a portfolio", self.margin, SettingError, 0.0)
        number("optimist of a portfolio", self.optimist, SettingError, 0.0, MOST_OPTIMIST)
        object.__setattr__(self, "value_range", value_range_of("a portfolio", self.value_range))

    @property
    def shares(self) -> FloatArray:
        """Return each member's share of the steps, (4,) float64."""
        informed = 1.0 - float(self.optimist) - 2.0 * SELDOM
        return np.array([informed, self.optimist, SELDOM, SELDOM])

    def starts(self, phi: PairPotential, bounds: tuple[float, float] | None) -> FloatArray:
        """Return what each row of a state adds to phi, and is then cut to, (4, 3) float64."""
        low, high = phi.extremes
        lowest, highest = bounds or (-np.inf, high + ABOVE * (high - low or 1.0))
        sober = lowest if bounds else 0.0  # which the rewards seen then lower
        informed, none = (self.margin * (high - low), lowest, highest), (0.0, 0.0, 0.0)
        return np.array([informed, (0.0, highest, highest), (0.0, sober, sober), none])

    def informed(self, phi: PairPotential, bounds: tuple[float, float] | None) -> FloatArray:
        """Return the start of the informed optimist's values, (S, A) float64."""
        values, (added, lowest, highest) = phi.known, self.starts(phi, bounds)[INFORMED]
        start = np.clip(values + added, lowest, highest)
        return np.asarray(np.where(np.isnan(values), highest, start))


class Tally(NamedTuple):
    """The members' turns and steps; returns averaged exponentially, weights adding up to 1."""

    turns: FloatArray  # (4,)
    steps: FloatArray  # (4,)
    mean: FloatArray  # (4,)
    variance: FloatArray  # (4,)
    squares: FloatArray  # (4,) the sum of the squared weights: 1 / the effective sample size

    @classmethod
    def empty(cls) -> Self:
        """Return the tally before the first turn."""
        return cls(*np.zeros((5, 4)))


class Floor(NamedTuple):
    """What the sober learner's values have lost, all alike, where there are no bounds."""

    least: FloatArray  # (2,) the lowest reward of a step that went on, and of one that terminated
    lost: FloatArray  # (1,) minus what H of them allow
    horizon: float


class Members(NamedTuple):
    """The members in the fast loop, with four rows for each state, side by side.

    They are the values of the informed optimist, of the optimist and of the sober learner, whose
    greedy actions are not kept, and the visits of the state's pairs. So a step waits for few pages
    of memory.
    """

    shares: FloatArray  # (4,)
    tally: Tally
    highest: float  # cuts the values that the optimists bootstrap from
    floor: Floor | None  # where there are no bounds
    pairs: FloatArray  # (4 S A,) the four rows
    visits: Visits  # the same memory, read as whole numbers
    sober: DenseTable | SparseTable
    source: DenseTable | SparseTable  # phi


def longest_turn(discount: float, time_limit: int) -> int:
    """Return the steps after which a turn ends, if no episode has ended before."""
    if discount == 1 or time_limit * (1 - discount) <= WHOLE:
        return time_limit
    return round(TURN / (1 - discount))


@inlined
def add_turn(tally, acting, length, earned):
    """Add a turn to the tally: who acted, its steps, its discounted return."""
    tally.turns[acting] += 1.0
    tally.steps[acting] += length
    weight = 1.0 / (tally.turns[acting] if tally.turns[acting] < MEMORY else MEMORY)
    deviation, kept = earned - tally.mean[acting], 1.0 - weight
    tally.mean[acting] += weight * deviation
    tally.variance[acting] += weight * deviation * deviation
    tally.variance[acting] *= kept
    tally.squares[acting] = kept * kept * tally.squares[acting] + weight * weight


@plain_and_inlined
def source_is_ahead(tally):
    """Return whether the source's policy earns more than the sober learner, beyond noise."""
    if tally.turns[SOURCE] < FIRST_TURNS or tally.turns[SOBER] < FIRST_TURNS:
        return False
    error = tally.variance[SOBER] / (1.0 / tally.squares[SOBER] - 1.0)
    error += tally.variance[SOURCE] / (1.0 / tally.squares[SOURCE] - 1.0)
    return tally.mean[SOURCE] - tally.mean[SOBER] > np.sqrt(error)


@inlined
def next_member(shares, tally):
    """Return who acts the next turn."""
    for member in (SOURCE, SOBER):
        early = tally.turns[member] < FIRST_TURNS
        if early and tally.steps[member] <= FIRST_SHARE * tally.steps.sum():
            return member
    furthest_behind, fewest = INFORMED, np.inf
    for member in range(np.uint64(shares.shape[0])):
        steps = tally.steps[member] / shares[member] if shares[member] > 0.0 else np.inf
        if steps < fewest:
            furthest_behind, fewest = member, steps
    return furthest_behind
