"""A guard against harmful potentials: which of two learners acts, and for how many steps.

A harmful potential costs the steps in which its learner acts and which teach nothing useful. The
guard bounds these by two accounts: while that learner is ahead and while it is not.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from curricle.arrays import FloatArray
from curricle.checks import number, whole_number
from curricle.errors import SettingError
from curricle.tasks.kernel import inlined

SCRATCH, SHAPED = np.uint64(0), np.uint64(1)
"""The learner without the potential and the one with it: the first axis of guarded tables."""
FIRST_TURNS = 2  # turns of each learner before they are compared: the fewest that have a variance
UNDECIDED = 0.5
"""The share before both are compared. Above it the learner with the potential is ahead."""
TURN, WHOLE = 3.0, 10.0
"""An episode is a turn where it has WHOLE / (1 - discount) steps at most. Elsewhere turns are cut
after TURN / (1 - discount) steps, by when a return has 95 % of its weight."""


@dataclass(frozen=True)
class Guard:
    """Bounds what a harmful potential costs, and keeps the optimum.

    Two learners learn from the same steps: one with the potential, the other without it. They act
    in turns. A turn is an episode; where episodes may last longer than 10 / (1 - discount) steps,
    or without limit, it ends after 3 / (1 - discount) steps. The learner with the potential is
    ahead if the mean discounted return of its last turns is higher; else the other learner is. The
    policy of the learner that is ahead is evaluated, and its values are returned.

    While the learner with the potential is ahead, its share of the steps is the probability that it
    earns more (Student's t with two degrees of freedom), `share_ahead` at most. Otherwise its share
    is `share_behind`.

    In T steps, of which it was behind in T0, the learner with the potential acts in no more than

        share_behind T0 + 3 L

    steps of turns that began while it was behind, where L is the length of its longest turn: two
    turns before there is anything to compare, and one on account. This holds for each seed, any
    potential and any task. The other learner acts in at least (1 - share_behind) T0
    + (1 - share_ahead) (T - T0) - 4 L steps, and learns from all T: Q-learning converges to Q*
    under the usual conditions for any potential.

    Parameters
    ----------
    share_behind : float
        Share of the steps for the learner with the potential while it is not ahead, in (0, 0.5].
    share_ahead : float
        Largest share of the steps for it while it is ahead, in (0.5, 1).
    memory : int
        Turns of each learner over which discounted returns are averaged, exponentially; episodes of
        each network.

    Raises
    ------
    SettingError
        When a number is out of range.

    Examples
    --------
    >>> Guard(share_behind=0.02)
    Guard(share_behind=0.02, share_ahead=0.8, memory=20)
    """

    share_behind: float = 0.05
    share_ahead: float = 0.8
    memory: int = 20

    def __post_init__(self) -> None:
        if number("share_behind of a guard", self.share_behind, SettingError, 0.0, 0.5) == 0.0:
            raise SettingError(
                "share_behind of a guard must be above 0, or the learner with the potential would "
                "never act again: got 0"
            )
        ahead = number("share_ahead of a guard", self.share_ahead, SettingError, 0.5, 1.0)
        if ahead in (0.5, 1.0):
            raise SettingError(
                "share_ahead of a guard must be above 0.5, and below 1 or the learner without the "
                f"potential would never act again: got {ahead:g}"
            )
        whole_number("memory of a guard", self.memory, FIRST_TURNS, SettingError)

    @property
    def kernel(self) -> "GuardKernel":
        """The guard as the compiled loop reads it."""
        return GuardKernel(float(self.share_behind), float(self.share_ahead), 1.0 / self.memory)


class GuardKernel(NamedTuple):
    """A guard, for the compiled loop."""

    share_behind: float
    share_ahead: float
    forgetting: float


class Tally(NamedTuple):
    """Both learners' returns in their last turns, averaged exponentially; weights add up to 1.

    Credit is the steps in which the learner with the potential may still act, behind and ahead.
    """

    turns: FloatArray  # (2,)
    mean: FloatArray  # (2,)
    variance: FloatArray  # (2,)
    squares: FloatArray  # (2,) the sum of the squared weights: 1 / the effective sample size
    credit: FloatArray  # (2,)

    @classmethod
    def empty(cls) -> "Tally":
        """Return the tally before the first turn."""
        return cls(*np.zeros((5, 2)))


def longest_turn(discount: float, time_limit: int) -> int:
    """Return the steps after which a turn ends, if no episode has ended before."""
    if discount == 1 or time_limit * (1 - discount) <= WHOLE:
        return time_limit
    return round(TURN / (1 - discount))


@inlined
def add_return(tally, learner, earned, forgetting):
    """Add one more return to a learner's average."""
    part = 1.0 / (tally.turns[learner] + 1.0)
    part = part if part > forgetting else forgetting
    deviation = earned - tally.mean[learner]
    tally.turns[learner] += 1.0
    tally.mean[learner] += part * deviation
    variance = tally.variance[learner] + part * deviation * deviation
    tally.variance[learner] = (1.0 - part) * variance
    tally.squares[learner] = (1.0 - part) * (1.0 - part) * tally.squares[learner] + part * part


@inlined
def was_compared(tally):
    """Return whether both learners have had the turns after which they are compared."""
    return tally.turns[SCRATCH] >= FIRST_TURNS and tally.turns[SHAPED] >= FIRST_TURNS


@inlined
def shaped_share(guard, tally):
    """Return the share of steps for the learner with phi: the probability that it earns more."""
    # The distribution function of Student's t with two degrees of freedom is
    # 1/2 + t / (2 sqrt(2 + t^2)). An average of effective sample size n has n - 1 of them.
    gain = tally.mean[SHAPED] - tally.mean[SCRATCH]
    if gain <= 0.0:
        return guard.share_behind
    error = tally.variance[SCRATCH] / (1.0 / tally.squares[SCRATCH] - 1.0)
    error += tally.variance[SHAPED] / (1.0 / tally.squares[SHAPED] - 1.0)
    share = 0.5 + 0.5 * gain / np.sqrt(2.0 * error + gain * gain)
    if share <= UNDECIDED:
        return guard.share_behind
    return share if share < guard.share_ahead else guard.share_ahead


@inlined
def next_turn(guard, tally, turn, share):
    """Return the share from here on and the learner that acts next, after a turn.

    `turn` are the learner that acted, its steps and its discounted return; `share` held before it.
    """
    acting, length, earned = turn
    if was_compared(tally):
        case = 1 if share > UNDECIDED else 0
        tally.credit[case] += share * length
        if acting == SHAPED:
            tally.credit[case] -= length
    add_return(tally, acting, earned, guard.forgetting)
    if not was_compared(tally):
        return UNDECIDED, SHAPED if tally.turns[SHAPED] <= tally.turns[SCRATCH] else SCRATCH
    share = shaped_share(guard, tally)
    case = 1 if share > UNDECIDED else 0
    return share, SHAPED if tally.credit[case] > 0.0 else SCRATCH
