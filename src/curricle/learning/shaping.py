"""Shapings: how a potential enters learning, one class for each way.

Each class states what it adds (`adds`), what the values then mean (`offset`,
`own_rewards`) and why it is safe (`theorem` and what :func:`certify` asks for beside it).
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Protocol, Self, TypeVar

import numpy as np

from curricle.arrays import FloatArray, frozen
from curricle.checks import instance
from curricle.errors import SettingError
from curricle.learning.general_loop import BONUS, PLAIN, STATE, ShapingKernel
from curricle.learning.learners import Learner, OptimisticLearner, QLearning
from curricle.learning.portfolio import Portfolio
from curricle.learning.potential import PairPotential, StateActionPotential, StatePotential
from curricle.learning.schedules import constant
from curricle.tasks.mdp import Task, same_task

# Read-only like every potential: another kind of array would be another compilation.
_NONE = frozen(np.zeros((1, 1)))
NOTHING_ADDED = ShapingKernel(PLAIN, constant(1.0), frozen(np.zeros(1, np.int64)), _NONE, _NONE)


Judged_co = TypeVar("Judged_co", covariant=True)
Judged = TypeVar("Judged")


class ShapedView(Protocol[Judged_co]):
    """What a shaping reads of the shaped task that `certify` judges."""

    @property
    def discount(self) -> float: ...  # noqa: D102
    @property
    def task_discount(self) -> float: ...  # noqa: D102
    @property
    def zero_at_ends(self) -> bool: ...  # noqa: D102
    @property
    def phi(self) -> FloatArray: ...  # noqa: D102
    def looking_ahead(self, phi: FloatArray) -> Judged_co: ...  # noqa: D102
    def rewarded(self, reward: Callable[..., Any], off: FloatArray) -> Judged_co: ...  # noqa: D102


@dataclass(frozen=True)
class Shaping(ABC):
    """How a potential enters learning; see the classes derived from it.

    Without a potential nothing is added. A :class:`Curriculum` fills in its sources' potential.

    Examples
    --------
    >>> isinstance(QInitialisation(), Shaping)
    True
    """

    for_tables: ClassVar[bool] = True
    for_networks: ClassVar[bool] = False
    # What compiled loops add.
    adds: ClassVar[int] = PLAIN
    # Whether Q starts at the potential, so that learning itself is plain.
    starts_at_potential: ClassVar[bool] = False
    # Whether it uses the potential's values, so that these can be forecast.
    reads_values: ClassVar[bool] = True
    # What proves it safe where `meets_conditions` and the declarations below hold.
    theorem: ClassVar[str] = ""
    # Whether the reward added need not come from a potential: it is safe only if it does.
    any_reward: ClassVar[bool] = False
    # Whether another tool may compute it with a discount of its own.
    takes_discount: ClassVar[bool] = False
    # What another tool does with a potential that is not 0 at the ends; empty if nothing.
    at_ends: ClassVar[str] = ""

    @property
    @abstractmethod
    def potential(self) -> Any:
        """The potential, or None."""

    @property
    def portfolio(self) -> Portfolio | None:
        """The portfolio of learners that the potential directs, if there is one."""
        return None

    @property
    def last_weight(self) -> float:
        """The factor of the potential's values in the long run."""
        return 1.0

    @property
    def own_rewards(self) -> bool:
        """Whether Q plus the offset is in the task's own rewards, so that it can be transferred."""
        return True

    @property
    def name(self) -> str:
        """The name of the class."""
        return type(self).__name__

    def with_potential(self, potential: object) -> Self:
        """Return the same shaping of another potential."""
        return replace(self, **{"potential": potential})

    def check(self, learner: object) -> None:
        """Raise SettingError unless this shaping is valid for a learner."""
        tabular = isinstance(learner, Learner)
        if not (self.for_tables if tabular else self.for_networks):
            kind = "tables" if tabular else "networks"
            raise SettingError(
                f"{self.name} is not a shaping for learners with {kind}: got {learner!r}"
            )
        if self.portfolio is not None and not isinstance(learner, QLearning):
            raise SettingError(
                f"a portfolio is for QLearning alone, as its members are fixed: got {learner!r}"
            )
        if isinstance(learner, OptimisticLearner) and not self.starts_at_potential:
            raise SettingError(
                f"{type(learner).__name__} has bounds of the task's own values, so it takes a "
                f"potential by QInitialisation or LookAheadAdvice alone: got {self.name}"
            )

    def for_task(self, task: Task) -> Self:
        """Return the shaping with a potential of the library's own, made for this task."""
        if self.potential is None:
            return self
        potential = self._taken(task, self.potential)
        if not same_task(potential.task, task):
            raise SettingError(
                f"a potential must be made for the task it shapes: it belongs to {potential.task}"
            )
        return self.with_potential(potential)

    # -- what it adds, and what the values then mean -----------------------------------------------

    def kernel(self) -> ShapingKernel:
        """Return the additions for compiled loops; none where Q starts at the potential."""
        phi = self.potential
        if phi is None or self.adds == PLAIN:
            return NOTHING_ADDED
        if isinstance(phi, StatePotential):
            return ShapingKernel(self.adds, phi.weight, phi.frame_steps, phi.values, _NONE)
        return NOTHING_ADDED._replace(kind=self.adds, pair_values=phi.values)

    def offset(self, step: int) -> FloatArray | float:
        """Return the array that takes the shaping off Q after `step` steps, broadcast to (S, A)."""
        return 0.0

    def _taken(self, task: Task, potential: Any) -> StatePotential | PairPotential:
        """Return the potential that the shaping uses: of pairs, unless a class overrides it."""
        if isinstance(potential, StatePotential):
            raise SettingError(f"{self.name} takes a potential phi(s, a): got StatePotential")
        if isinstance(potential, PairPotential):
            return potential
        return StateActionPotential(task, potential)

    # -- why it is safe: `shaped` is the ShapedTask that `certify` judges --------------------------

    def meets_conditions(self, shaped: ShapedView[Any]) -> bool:
        """Return whether the theorem applies, the ends of the task being known."""
        return True

    def acted_on(self, shaped: ShapedView[Judged]) -> Judged:
        """Return the values that a policy acts on in the long run, as `shaped` computes them."""
        raise NotImplementedError

    def reward(self, shaped: ShapedView[Any]) -> Callable[..., Any]:
        """Return the function F(s, a, s') that is added, where it is `any_reward`."""
        raise NotImplementedError


@dataclass(frozen=True)
class _ByPotential(Shaping):
    """A shaping by a potential."""

    potential: Any = field(default=None, repr=False)


@dataclass(frozen=True)
class _StartsAtPotential(_ByPotential):
    """Q-initialisation and look-ahead advice, which are the same computation."""

    portfolio: Portfolio | None = None

    for_networks: ClassVar[bool] = True
    starts_at_potential: ClassVar[bool] = True
    theorem: ClassVar[str] = "Wiewiora 2003"
    at_ends: ClassVar[str] = (
        "this holds for a learner that bootstraps from phi at the ends; a learner that masks "
        "terminated steps, as Stable-Baselines3 does, never reads it"
    )

    def __post_init__(self) -> None:
        if self.portfolio is not None:
            instance(f"portfolio of {self.name}", self.portfolio, Portfolio, SettingError)

    def meets_conditions(self, shaped: ShapedView[Any]) -> bool:
        """Return whether phi is 0 at the ends."""
        return bool(shaped.zero_at_ends)

    def acted_on(self, shaped: ShapedView[Judged]) -> Judged:
        """Return Q + phi, which becomes Q*: the fixed point of Q-learning's expected update."""
        return shaped.looking_ahead(shaped.phi)


@dataclass(frozen=True)
class QInitialisation(_StartsAtPotential):
    """Q starts at phi(s, a); the same updates as look-ahead advice (Wiewiora 2003).

    Parameters
    ----------
    potential : StateActionPotential, MappedPotential or (S, A) array, optional
    portfolio : Portfolio, optional
        Of :class:`QLearning` alone. Without one the learner itself starts at phi.

    Examples
    --------
    >>> from curricle import GridWorld, learn
    >>> phi = np.tile([0.0, 1.0, 0.0, 0.0], (3, 1))  # to the east
    >>> learn(GridWorld("S.T"), budget=500, shaping=QInitialisation(phi)).greedy_return[0, 0]
    np.float64(196.01)
    """


@dataclass(frozen=True)
class LookAheadAdvice(_StartsAtPotential):
    """Rewards get F = gamma phi(s', a*) - phi(s, a); the policy acts on Q + phi.

    It is computed as :class:`QInitialisation`, on Q + phi, which is the same but for rounding
    (Wiewiora 2003; Wiewiora, Cottrell, Elkan 2003).

    Parameters
    ----------
    potential, portfolio : optional
        As for :class:`QInitialisation`.

    Examples
    --------
    >>> LookAheadAdvice().theorem
    'Wiewiora 2003'
    """


@dataclass(frozen=True)
class StateShaping(_ByPotential):
    """Rewards get F = gamma Phi(s', t') - Phi(s, t) (Ng, Harada, Russell 1999).

    Q is learnt as Q* - Phi. Where Phi changes with time, Q lags behind it by an unknown amount: the
    values are not in the task's own rewards.

    Parameters
    ----------
    potential : StatePotential or (S,) array, optional
        From phi(s, a), also an (S, A) array, it takes Phi(s) = max_a phi(s, a).

    Examples
    --------
    >>> from curricle import GridWorld
    >>> StateShaping(np.eye(3, 4)).for_task(GridWorld("S.T")).potential.values
    array([[1., 1., 0.]])
    """

    for_networks: ClassVar[bool] = True
    adds: ClassVar[int] = STATE
    theorem: ClassVar[str] = "Ng, Harada, Russell 1999"
    takes_discount: ClassVar[bool] = True
    at_ends: ClassVar[str] = "this holds for a tool that adds gamma Phi(end) to the reward there"

    @property
    def last_weight(self) -> float:
        """The last weight of the potential."""
        phi = self.potential
        return float(phi.weight.last) if isinstance(phi, StatePotential) else 1.0

    @property
    def own_rewards(self) -> bool:
        """Whether Phi never changes."""
        return not (isinstance(self.potential, StatePotential) and self.potential.changes)

    def offset(self, step: int) -> FloatArray | float:
        """Return Phi(s, t), (S, 1): Q is learnt as Q* - Phi."""
        return 0.0 if self.potential is None else self.potential.at(step)[:, None]

    def _taken(self, task: Task, potential: Any) -> StatePotential | PairPotential:
        if isinstance(potential, StatePotential):
            return potential
        if np.ndim(potential) == 1:
            return StatePotential(task, potential)
        phi = super()._taken(task, potential)
        return phi.to_state() if isinstance(phi, PairPotential) else phi

    def meets_conditions(self, shaped: ShapedView[Any]) -> bool:
        """Return whether F has the task's discount, and Phi is 0 at the ends."""
        return bool(shaped.discount == shaped.task_discount and shaped.zero_at_ends)

    def acted_on(self, shaped: ShapedView[Judged]) -> Judged:
        """Return Q* for r + gamma Phi(s') - Phi(s): by theory Q* - Phi."""
        phi, discount = shaped.phi, shaped.discount
        return shaped.rewarded(lambda s, a, after: discount * phi[after] - phi[s], phi)


@dataclass(frozen=True)
class RewardBonus(_ByPotential):
    """Rewards get phi(s, a) itself.

    This is not potential-based and can change the optimal policy; it is here to show reward
    hacking. The values learnt contain the bonus, which cannot be taken off again.

    Parameters
    ----------
    potential : optional
        As for :class:`QInitialisation`.

    Examples
    --------
    >>> RewardBonus().any_reward, RewardBonus().own_rewards
    (True, False)
    """

    adds: ClassVar[int] = BONUS
    theorem: ClassVar[str] = "Ng, Harada, Russell 1999"
    any_reward: ClassVar[bool] = True
    own_rewards: ClassVar[bool] = False  # the bonus cannot be taken off again

    def reward(self, shaped: ShapedView[Any]) -> Callable[..., Any]:
        """Return phi(s, a) as a function of transitions."""
        return lambda state, action, after: shaped.phi[state, action]
