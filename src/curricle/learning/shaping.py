"""Shapings: how a potential enters learning, one class for each way.

The methods and class variables of :class:`Shaping` are all that a class may define.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal, Self

import numpy as np

from curricle.checks import instance
from curricle.errors import SettingError
from curricle.frozen_arrays import frozen
from curricle.learning.general_loop import ADVICE, BONUS, LOOK_BACK, PLAIN, STATE, ShapingKernel
from curricle.learning.guard import Guard
from curricle.learning.learners import SARSA, Learner, OptimisticQLearning
from curricle.learning.potential import MappedPotential, StateActionPotential, StatePotential
from curricle.learning.schedules import constant, schedule
from curricle.tasks.task import Task, generative_model, same_task

Claim = Literal["telescoping", "fixed_point", "one_way_in", "added_values", "added_rewards"]
"""What holds of a shaping in the long run, for :func:`certify` to check.

- telescoping: rewards get gamma Phi(s') - Phi(s), so that Q becomes Q* - Phi;
- fixed_point: Q + phi, or Q started at phi, becomes Q*;
- one_way_in: rewards get phi(s, a) - phi(before) / gamma, and every state is entered with one phi;
- added_values: the policy acts on Q* + w phi with the last weight w;
- added_rewards: rewards get phi(s, a) or F(s, a, s'), which need not be potential-based.
"""

# Read-only like every potential: another kind of array would be another compilation.
_NONE = frozen(np.zeros((1, 1)))
NOTHING_ADDED = ShapingKernel(PLAIN, constant(1.0), frozen(np.zeros(1, np.int64)), _NONE, _NONE)


@dataclass(frozen=True)
class Shaping(ABC):
    """How a potential enters learning; see the classes derived from it.

    Without a potential nothing is added. A :class:`Curriculum` takes a shaping without one and
    fills in the one from its sources.

    Examples
    --------
    >>> isinstance(QInitialisation(), Shaping)
    True
    """

    claim: ClassVar[Claim]
    for_tables: ClassVar[bool] = True
    for_networks: ClassVar[bool] = False
    starts_at_potential: ClassVar[bool] = False
    """Whether Q starts at the potential, so that learning itself is plain."""
    reads_values: ClassVar[bool] = True
    """Whether it uses the potential's values, so that these can be calibrated or forecast."""

    def __post_init__(self) -> None:
        if self.guard is not None:
            instance(f"guard of {self.name}", self.guard, Guard, SettingError)

    @property
    @abstractmethod
    def potential(self) -> Any:
        """The potential, or None."""

    @property
    def guard(self) -> Guard | None:
        """The guard against a harmful potential, if there is one."""
        return None

    @property
    def last_weight(self) -> float:
        """The factor of the potential's values in the long run."""
        return 1.0

    @property
    def own_rewards(self) -> bool:
        """Whether Q plus the offset is in the task's own rewards, so that it can be handed on."""
        return self.claim not in ("one_way_in", "added_rewards")

    @property
    def name(self) -> str:
        """The name of the class."""
        return type(self).__name__

    def with_potential(self, potential: Any) -> Self:
        """Return the same shaping of another potential."""
        return replace(self, **{"potential": potential})

    def check(self, learner: Any) -> None:
        """Raise SettingError unless this shaping is valid for a learner."""
        tabular = isinstance(learner, Learner)
        if not (self.for_tables if tabular else self.for_networks):
            kind = "tables" if tabular else "networks"
            raise SettingError(
                f"{self.name} is not a shaping for learners with {kind}: got {learner!r}"
            )
        if self.guard is not None and not tabular:
            raise SettingError(f"a guard is for learners with tables: got {learner!r}")
        if not isinstance(learner, OptimisticQLearning):
            return
        if self.guard is not None:
            raise SettingError(f"OptimisticQLearning takes no guard: got {self.guard!r}")
        if not self.starts_at_potential:
            raise SettingError(
                "OptimisticQLearning has bounds of the task's own values, so it takes a potential "
                f"by QInitialisation or LookAheadAdvice alone: got {self.name}"
            )

    def for_task(self, task: Task) -> Self:
        """Return the shaping with a potential of the library's own, made for this task.

        PotentialError for a malformed array, SettingError for a potential of another kind or task.
        """
        if self.potential is None:
            return self
        potential = self._taken(task, self.potential)
        if not same_task(potential.task, task):
            raise SettingError(
                f"a potential must be made for the task it shapes: it belongs to {potential.task}"
            )
        return self.with_potential(potential)

    def kernel(self) -> ShapingKernel:
        """Return what compiled loops add; nothing where Q starts at the potential."""
        return NOTHING_ADDED if self.potential is None else NOTHING_ADDED._replace(**self._added())

    def offset(self, step: int) -> Any:
        """Return what takes the shaping off Q again after `step` steps, broadcast to (S, A)."""
        return 0.0

    def advice(self, step: int) -> Any:
        """Return what the policy acts on besides Q and the offset, broadcast to (S, A)."""
        return 0.0

    def _added(self) -> dict[str, Any]:
        """Return the fields of the kernel that differ from ``NOTHING_ADDED``."""
        return {}

    def _taken(self, task: Task, given: Any) -> Any:
        """Return the potential that the shaping uses: of pairs, unless a class overrides it."""
        if isinstance(given, StatePotential):
            raise SettingError(f"{self.name} takes a potential phi(s, a): got StatePotential")
        if isinstance(given, StateActionPotential | MappedPotential):
            return given
        return StateActionPotential(task, given)


@dataclass(frozen=True)
class _StartsAtPotential(Shaping):
    """Q-initialisation and look-ahead advice, which are the same computation."""

    potential: Any = field(default=None, repr=False)
    guard: Guard | None = None

    claim: ClassVar[Claim] = "fixed_point"
    for_networks: ClassVar[bool] = True
    starts_at_potential: ClassVar[bool] = True


@dataclass(frozen=True)
class QInitialisation(_StartsAtPotential):
    """Q starts at phi(s, a); the same updates as look-ahead advice (Wiewiora 2003).

    Parameters
    ----------
    potential : StateActionPotential, MappedPotential or (S, A) array, optional
    guard : Guard, optional
        Bounds what a harmful potential costs.

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
    potential : StateActionPotential, MappedPotential or (S, A) array, optional
    guard : Guard, optional
        As for :class:`QInitialisation`.

    Examples
    --------
    >>> LookAheadAdvice().claim
    'fixed_point'
    """


@dataclass(frozen=True)
class LookBackAdvice(Shaping):
    """Rewards get F = phi(s_t, a_t) - phi(s_{t-1}, a_{t-1}) / gamma; for :class:`SARSA` only.

    A target contains phi of the step before, averaged over all ways into a state, so the optimum
    is certainly kept only where each state is entered in one way (Wiewiora, Cottrell, Elkan 2003).
    What is learnt is Q(s, a) - phi(before) / gamma there and nothing so simple elsewhere: it cannot
    be turned into values of the task's own rewards.

    Parameters
    ----------
    potential : StateActionPotential, MappedPotential or (S, A) array, optional
    guard : Guard, optional
        As for :class:`QInitialisation`.

    Examples
    --------
    >>> LookBackAdvice().claim
    'one_way_in'
    """

    potential: Any = field(default=None, repr=False)
    guard: Guard | None = None

    claim: ClassVar[Claim] = "one_way_in"

    def check(self, learner: Any) -> None:
        """Raise SettingError unless the learner is on-policy SARSA."""
        super().check(learner)
        if not isinstance(learner, SARSA):
            raise SettingError(
                f"LookBackAdvice is valid for on-policy SARSA only: got {type(learner).__name__}"
            )

    def for_task(self, task: Task) -> Self:
        """Return the shaping for a task, or raise SettingError if its discount is 0."""
        if generative_model(task).discount == 0:
            raise SettingError(
                "LookBackAdvice divides by the task's discount, which must be positive: got 0"
            )
        return super().for_task(task)

    def _added(self) -> dict[str, Any]:
        return {"kind": LOOK_BACK, "pair_values": self.potential.values}


@dataclass(frozen=True)
class StateShaping(Shaping):
    """Rewards get F = gamma Phi(s', t') - Phi(s, t) (Ng, Harada, Russell 1999).

    Q is learnt as Q* - Phi. Where Phi changes with time Q lags behind it: a state holds the Phi of
    its last visits, so that the values are not in the task's own rewards, by no known amount.

    Parameters
    ----------
    potential : StatePotential or (S,) array, optional
        Given phi(s, a), which may be an (S, A) array, it uses Phi(s) = max_a phi(s, a).
    guard : Guard, optional
        As for :class:`QInitialisation`.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> StateShaping(np.eye(3, 4)).for_task(GridWorld("S.T")).potential.values
    array([[1., 1., 0.]])
    """

    potential: Any = field(default=None, repr=False)
    guard: Guard | None = None

    claim: ClassVar[Claim] = "telescoping"
    for_networks: ClassVar[bool] = True

    @property
    def last_weight(self) -> float:
        """The last weight of the potential."""
        phi = self.potential
        return float(phi.weight.last) if isinstance(phi, StatePotential) else 1.0

    @property
    def own_rewards(self) -> bool:
        """Whether Phi never changes."""
        return not (isinstance(self.potential, StatePotential) and self.potential.changes)

    def _added(self) -> dict[str, Any]:
        phi = self.potential
        return {
            "kind": STATE,
            "weight": phi.weight,
            "steps": phi.frame_steps,
            "state_values": phi.values,
        }

    def offset(self, step: int) -> Any:
        """Return Phi(s, t), (S, 1): Q is learnt as Q* - Phi."""
        return 0.0 if self.potential is None else self.potential.at(step)[:, None]

    def _taken(self, task: Task, given: Any) -> Any:
        if isinstance(given, StatePotential):
            return given
        if np.ndim(given) == 1:
            return StatePotential(task, given)
        return super()._taken(task, given).to_state()


@dataclass(frozen=True)
class DecayingAdvice(Shaping):
    """Q learns on plain rewards; the policy acts on Q + xi(t) phi (Behboudian et al. 2020).

    The policy is the task's own only as the weight xi goes to 0; Q is in the task's own rewards all
    the time.

    Parameters
    ----------
    potential : StateActionPotential, MappedPotential or (S, A) array, optional
    weight : float or Schedule
        xi(t); a schedule counts steps.
    guard : Guard, optional
        As for :class:`QInitialisation`.

    Examples
    --------
    >>> from curricle.learning import linear
    >>> DecayingAdvice(weight=linear(1.0, 0.0, steps=1000)).weight(500)
    0.5
    """

    potential: Any = field(default=None, repr=False)
    weight: Any = 1.0
    guard: Guard | None = None

    claim: ClassVar[Claim] = "added_values"

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "weight", schedule(self.weight))

    @property
    def last_weight(self) -> float:
        """The last value of xi."""
        return float(self.weight.last)

    def _added(self) -> dict[str, Any]:
        return {"kind": ADVICE, "weight": self.weight, "pair_values": self.potential.values}

    def advice(self, step: int) -> Any:
        """Return xi(t) phi(s, a), (S, A)."""
        return 0.0 if self.potential is None else self.weight(step) * self.potential.values


@dataclass(frozen=True)
class RewardBonus(Shaping):
    """Rewards get phi(s, a) itself.

    This is not potential-based and can change the optimal policy; it is here to show reward
    hacking. The values learnt contain the bonus, which cannot be taken off again.

    Parameters
    ----------
    potential : StateActionPotential, MappedPotential or (S, A) array, optional
    guard : Guard, optional
        As for :class:`QInitialisation`.

    Examples
    --------
    >>> RewardBonus().claim
    'added_rewards'
    """

    potential: Any = field(default=None, repr=False)
    guard: Guard | None = None

    claim: ClassVar[Claim] = "added_rewards"

    def _added(self) -> dict[str, Any]:
        return {"kind": BONUS, "pair_values": self.potential.values}
