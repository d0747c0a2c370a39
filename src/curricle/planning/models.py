"""Planning models: what exact planning reads of a task, its tables or its factored model.

Both have the same methods: iterate to the optimum or to a policy's values, and back up once into
(S, A). ``solution.py`` decides how far to iterate and what that proves.
"""

from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np
import numpy.typing as npt

from curricle.errors import SettingError
from curricle.planning import backups, factored_backups
from curricle.planning.backups import Precision
from curricle.tasks.factored import FactoredModel
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.reachability import improper_states
from curricle.tasks.task import Task, tables

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
Policy = npt.NDArray[np.integer[Any]] | FloatArray
"""An action for each state, (S,), or the probability of each action, (S, A)."""


class Model(Protocol):
    """A task as exact planning sees it."""

    @property
    def terminal(self) -> BoolArray:
        """Which states end an episode, (S,)."""

    @property
    def n_actions(self) -> int:
        """A."""

    @property
    def outcomes(self) -> int:
        """The number of outcomes that a backup adds up."""

    @property
    def discount(self) -> float:
        """Gamma."""

    @property
    def largest_reward(self) -> float:
        """No reward is larger in size than this."""

    def optimise(self, values: FloatArray, precision: Precision) -> float:
        """Turn bounds of the lengths of episodes into the optimum; return the last change."""

    def policy_backup(self, policy: Policy, values: FloatArray, precision: Precision) -> float:
        """Bring `values` to those of a policy in place; return the last change."""

    def start_value(self, values: FloatArray) -> float:
        """Return the mean of `values` over the start distribution."""

    def action_values(self, values: FloatArray) -> FloatArray:
        """Return sum_s' P(s' | s, a) (r + gamma V(s')), (S, A); 0 in terminal states."""


@dataclass(frozen=True, eq=False)
class TabularPlanningModel:
    """A model read from the tables of a FiniteMDP.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> TabularPlanningModel.of(GridWorld("S.T").mdp).largest_reward
    199.0
    """

    mdp: FiniteMDP
    mean_reward: FloatArray
    largest_reward: float
    discount: float

    @classmethod
    def of(cls, mdp: FiniteMDP) -> Self:
        """Return the model of a FiniteMDP."""
        mean = np.einsum("yo,yo->y", mdp.probability, mdp.reward)
        largest = max(mdp.reward.max(initial=0.0), -mdp.reward.min(initial=0.0))
        if not np.isfinite(largest):  # in a row that only terminal states name, hence no reward
            largest = abs(mdp.reward[np.isfinite(mdp.reward)]).max(initial=0.0)
        return cls(mdp, mean, float(largest), mdp.discount)

    @property
    def terminal(self) -> BoolArray:
        """Which states end an episode, (S,)."""
        return self.mdp.terminal

    @property
    def n_actions(self) -> int:
        """A."""
        return self.mdp.actions.size

    @property
    def outcomes(self) -> int:
        """The number of outcomes of a row."""
        return int(self.mdp.probability.shape[1])

    @property
    def _rows(self) -> npt.NDArray[np.uint32]:
        return self.mdp.outcome_row.view(np.uint32)

    @property
    def _dynamics(self) -> tuple[Any, Any, Any, Any, float]:
        successor = self.mdp.next_state.view(np.uint32)
        return self.mdp.probability, successor, self.mean_reward, self.terminal, self.discount

    def optimise(self, values: FloatArray, precision: Precision) -> float:
        """Turn bounds of the lengths of episodes into the optimum; return the last change."""
        return float(backups.optimal_values(self._rows, *self._dynamics, values, precision))

    def policy_backup(self, policy: Policy, values: FloatArray, precision: Precision) -> float:
        """Bring `values` to those of a policy in place; return the last change."""
        entries = policy_entries(policy, self.terminal, self._rows)
        return float(backups.policy_values(*entries, *self._dynamics, values, precision))

    def start_value(self, values: FloatArray) -> float:
        """Return the mean of `values` over the start distribution."""
        return float(self.mdp.start @ values)

    def action_values(self, values: FloatArray) -> FloatArray:
        """Return sum_s' P(s' | s, a) (r + gamma V(s')), (S, A); 0 in terminal states."""
        outcomes = values[self.mdp.next_state]
        outcomes *= self.discount
        outcomes += self.mdp.reward
        outcomes *= self.mdp.probability
        q = np.asarray(outcomes.sum(axis=1)[self.mdp.outcome_row])
        q[self.terminal] = 0.0
        return q

    def check_ends(self, policy: Policy | None) -> None:
        """Raise SettingError if the policy (some policy if None) may never end."""
        if policy is not None and policy.ndim == 1:
            policy = np.arange(self.n_actions) == policy[:, None]
        endless = improper_states(
            self.terminal,
            self.mdp.outcome_row,
            self.mdp.probability,
            self.mdp.next_state,
            None if policy is None else policy > 0,
        )
        if endless.size:
            raise SettingError(
                "discount 1 needs every policy considered to end: from state "
                f"{endless[0]} an episode can go on for ever"
            )

    def counting_steps(self) -> Self:
        """Return the same with a reward of 1 for every step and discount 1."""
        return type(self)(self.mdp, np.ones_like(self.mean_reward), 1.0, 1.0)


@dataclass(frozen=True, eq=False)
class FactoredPlanningModel:
    """A model computed from a factored model; its discount is below 1.

    Examples
    --------
    >>> from curricle import Pursuit
    >>> FactoredPlanningModel.of(Pursuit(size=2, predators=1).factored_model).largest_reward
    1.0
    """

    factored_model: FactoredModel
    terminal: BoolArray
    mean_reward: FloatArray

    @classmethod
    def of(cls, factored_model: FactoredModel) -> Self:
        """Return the planning model of a factored model."""
        together = factored_model.predators_on_prey()
        rewards = np.take(factored_model.rewards, together)
        mean = expected(factored_model, np.zeros(len(rewards)), 1.0, rewards)
        return cls(factored_model, np.take(factored_model.ends, together), mean)

    @property
    def n_actions(self) -> int:
        """A = M^k."""
        return int(self.factored_model.landing.shape[1] ** self.factored_model.predators)

    @property
    def outcomes(self) -> int:
        """The number of moves of the prey."""
        return int(self.factored_model.landing.shape[1])

    @property
    def discount(self) -> float:
        """Gamma."""
        return self.factored_model.discount

    @property
    def largest_reward(self) -> float:
        """No reward is larger in size than this."""
        return float(abs(self.factored_model.rewards).max())

    @property
    def _dynamics(self) -> tuple[Any, Any, int, Any, Any, float]:
        m = self.factored_model
        return m.landing, m.prey_policy, m.predators, self.mean_reward, self.terminal, m.discount

    def optimise(self, values: FloatArray, precision: Precision) -> float:
        """Turn bounds of the lengths of episodes into the optimum; return the last change."""
        values *= min(0.0, float(self.factored_model.rewards.min()))
        values[self.terminal] = 0.0
        return float(factored_backups.optimal_values(*self._dynamics, values, precision))

    def policy_backup(self, policy: Policy, values: FloatArray, precision: Precision) -> float:
        """Bring `values` to those of a policy in place; return the last change."""
        entries = policy_entries(
            policy, self.terminal, self.factored_model.joint_landing().view(np.uint32)
        )
        return float(factored_backups.policy_values(*entries, *self._dynamics, values, precision))

    def start_value(self, values: FloatArray) -> float:
        """Return the mean of `values` over the start distribution."""
        return float(values[~self.terminal].mean())

    def action_values(self, values: FloatArray) -> FloatArray:
        """Return sum_s' P(s' | s, a) (r + gamma V(s')), (S, A); 0 in terminal states."""
        m = self.factored_model
        rows = expected(m, self.mean_reward, m.discount, values.copy())
        q = np.take(rows.reshape(len(m.landing), -1), m.joint_landing(), axis=1)
        q = q.reshape(len(values), self.n_actions)
        q[self.terminal] = 0.0
        return q


def expected(
    factored_model: FactoredModel, mean_reward: FloatArray, discount: float, values: FloatArray
) -> FloatArray:
    """Return r + gamma times the mean of `values` over the prey's moves, (S,)."""
    rows = np.empty((len(factored_model.landing), len(values) // len(factored_model.landing)))
    for cell, plane in enumerate(rows):
        factored_backups.expect(
            values,
            mean_reward,
            factored_model.landing,
            factored_model.prey_policy,
            discount,
            cell,
            plane,
        )
    return rows.ravel()


def policy_entries(
    policy: Policy, terminal: BoolArray, row_of: npt.NDArray[np.uint32]
) -> tuple[Any, Any, Any]:
    """Return a policy in compressed form, as :func:`backups.policy_entries` does."""
    if policy.ndim == 2:
        first, row, weight = backups.policy_entries(policy, terminal, row_of)
        return first, row, weight
    n_states = len(policy)
    row = row_of[np.arange(n_states) % len(row_of), policy]
    return np.arange(n_states + 1), row, np.ones(n_states)


def model_of(task: Task) -> Model:
    """Return the model to plan with: the task's factored model if it has one, else its tables.

    At discount 1 it is the tables, which can be searched for policies that never end.

    Examples
    --------
    >>> from curricle import GridWorld, Pursuit
    >>> type(model_of(Pursuit(size=2))).__name__, type(model_of(GridWorld("ST"))).__name__
    ('FactoredPlanningModel', 'TabularPlanningModel')
    """
    factored_model = getattr(task, "factored_model", None)
    if isinstance(factored_model, FactoredModel) and factored_model.discount < 1:
        return FactoredPlanningModel.of(factored_model)
    return TabularPlanningModel.of(tables(task))
