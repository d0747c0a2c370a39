"""Planning models: what exact planning reads of a task, its tables or its factored model."""

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, Frozen, IntArray
from curricle.planning import backups
from curricle.planning.backups import MixedPolicy
from curricle.tasks.mdp import FiniteMDP, Task, improper_states, tables
from curricle.tasks.models import FactoredModel, joint_landing, predators_on_prey

Policy = npt.NDArray[np.integer[Any]] | FloatArray
"""An action for each state, (S,), or the probability of each action, (S, A)."""


@dataclass(frozen=True, eq=False)
class _Model(Frozen):
    """What both kinds of model have."""

    terminal: BoolArray  # (S,)
    mean_reward: FloatArray  # (Y,) of each outcome row; or (S,) of steps from the prey's cell
    largest_reward: float  # no reward is larger in size
    n_actions: int
    n_outcomes: int  # that a backup adds up
    discount: float


@dataclass(frozen=True, eq=False)
class TabularPlanningModel(_Model):
    """A model read from the tables of a FiniteMDP."""

    mdp: FiniteMDP

    @classmethod
    def of(cls, mdp: FiniteMDP) -> Self:
        """Return the model of a FiniteMDP."""
        largest = max(mdp.reward.max(initial=0.0), -mdp.reward.min(initial=0.0))
        if not np.isfinite(largest):  # in a row that only terminal states name, hence no reward
            largest = abs(mdp.reward[np.isfinite(mdp.reward)]).max(initial=0.0)
        return cls(
            terminal=mdp.terminal,
            mean_reward=np.einsum("yo,yo->y", mdp.probability, mdp.reward),
            largest_reward=float(largest),
            n_actions=mdp.actions.size,
            n_outcomes=mdp.probability.shape[1],
            discount=mdp.discount,
            mdp=mdp,
        )

    @property
    def _rows(self) -> npt.NDArray[np.uint32]:
        return self.mdp.outcome_row.view(np.uint32)

    @property
    def _outcomes(self) -> backups.OutcomeRows:
        mdp, after = self.mdp, self.mdp.next_state.view(np.uint32)
        tables = self.mean_reward, mdp.probability, after, mdp.terminal
        return backups.OutcomeRows(*tables, self.discount)

    def greedy_backup(self) -> tuple[Any, float]:
        """Return the greedy backup, and the lowest best mean reward of a state, at most 0."""
        chosen, best = self._rows[:, 0].copy(), np.zeros(len(self.terminal))
        backups.improve(self._rows, self.terminal, self.mean_reward, best, chosen)
        space = np.empty(len(self.mean_reward))
        backup = backups.GreedyBackup(self._outcomes, self._rows, chosen, space)
        return backup, min(0.0, float(best.min()))

    def policy_backup(self, policy: Policy) -> Any:
        """Return the backup of a policy; faster where it takes one action a state."""
        mixed = mixed_policy(policy, self.terminal, self._rows)
        certain = len(mixed.row) == len(self.terminal)
        if certain and (self.terminal | (mixed.weight == 1.0)).all():
            return backups.PolicyBackup(self._outcomes, mixed.row)
        return backups.MixedPolicyBackup(self._outcomes, mixed, np.empty(len(self.mean_reward)))

    def largest_sum(self, policy: Policy | None) -> float:
        """Return a bound of the sum of a pair's probabilities, or of a state's under a policy."""
        used = np.zeros(len(self.mdp.probability), dtype=bool)
        used[self._rows[~self.terminal]] = True
        return sum_bound(self.mdp.probability[used]) * policy_sum(policy, self.terminal)

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

    def endless(self, policy: Policy | None) -> IntArray:
        """Return the states from which a policy (some policy if None) may never end."""
        if policy is not None and policy.ndim == 1:
            policy = np.arange(self.n_actions) == policy[:, None]
        return improper_states(self.mdp, None if policy is None else policy > 0)

    def counting_steps(self) -> Self:
        """Return the same with a reward of 1 for every step and discount 1."""
        ones = np.ones_like(self.mean_reward)
        return replace(self, mean_reward=ones, largest_reward=1.0, discount=1.0)


@dataclass(frozen=True, eq=False)
class FactoredPlanningModel(_Model):
    """A model computed from a factored model; its discount is below 1."""

    factored_model: FactoredModel

    @classmethod
    def of(cls, factored_model: FactoredModel) -> Self:
        """Return the planning model of a factored model."""
        n_cells, n_moves = factored_model.landing.shape
        together = predators_on_prey(n_cells, factored_model.predators)
        rewards = factored_model.rewards
        model = cls(
            terminal=np.take(factored_model.ends, together),
            mean_reward=np.zeros(len(together)),
            largest_reward=float(abs(rewards).max()),
            n_actions=n_moves**factored_model.predators,
            n_outcomes=n_moves,
            discount=1.0,
            factored_model=factored_model,
        )
        # The mean reward is that of the next state: an expectation over the prey's moves.
        mean = model._expected(np.take(rewards, together))
        return replace(model, mean_reward=mean, discount=factored_model.discount)

    @property
    def _planes(self) -> backups.Planes:
        moves = self.factored_model.landing, self.factored_model.prey_policy
        return backups.Planes(self.mean_reward, *moves, self.terminal, self.discount)

    @property
    def _plane_size(self) -> int:
        return len(self.terminal) // len(self.factored_model.landing)

    def greedy_backup(self) -> tuple[Any, float]:
        """Return the greedy backup, and the lowest reward, at most 0."""
        m, space = self.factored_model, np.empty((3, self._plane_size))
        backup = backups.GreedyPlanes(self._planes, m.predators, space)
        return backup, min(0.0, float(m.rewards.min()))

    def policy_backup(self, policy: Policy) -> Any:
        """Return the backup of a policy."""
        m = self.factored_model
        rows = joint_landing(m.landing, m.predators).view(np.uint32)
        mixed = mixed_policy(policy, self.terminal, rows)
        return backups.PolicyPlanes(self._planes, mixed, np.empty(self._plane_size))

    def largest_sum(self, policy: Policy | None) -> float:
        """Return a bound of the sum of a pair's probabilities, or of a state's under a policy."""
        return sum_bound(self.factored_model.prey_policy) * policy_sum(policy, self.terminal)

    def start_value(self, values: FloatArray) -> float:
        """Return the mean of `values` over the start distribution."""
        return float(values[~self.terminal].mean())

    def action_values(self, values: FloatArray) -> FloatArray:
        """Return sum_s' P(s' | s, a) (r + gamma V(s')), (S, A); 0 in terminal states."""
        m = self.factored_model
        rows = self._expected(values.copy()).reshape(len(m.landing), -1)
        q = np.take(rows, joint_landing(m.landing, m.predators), axis=1)
        q = q.reshape(len(values), self.n_actions)
        q[self.terminal] = 0.0
        return q

    def _expected(self, values: FloatArray) -> FloatArray:
        """Return r + gamma times the mean of `values` over the prey's moves, (S,)."""
        rows = np.empty((len(self.factored_model.landing), self._plane_size))
        for cell, plane in enumerate(rows):
            backups.expect(self._planes, values, cell, plane)
        return rows.ravel()


def sum_bound(probability: npt.NDArray[Any]) -> float:
    """Return a bound of the sum of any row: tables may sum to 1 + 1e-8, and sums are rounded."""
    rounding = (probability.shape[1] - 1) * np.finfo(np.float64).eps
    largest = probability.sum(axis=1).max(initial=0.0)
    return float(largest * (1 + rounding))


def policy_sum(policy: Policy | None, terminal: BoolArray) -> float:
    """Return a bound of the sum of a policy's probabilities; 1 where it is one action a state."""
    return 1.0 if policy is None or policy.ndim == 1 else sum_bound(policy[~terminal])


def mixed_policy(
    policy: Policy, terminal: BoolArray, row_of: npt.NDArray[np.uint32]
) -> MixedPolicy:
    """Return a policy in compressed form; a terminal state has one entry, which means nothing.

    `row_of` has the outcome row of each pair, for all states or, repeating, for a part of them.
    """
    n_states, n_actions = len(terminal), row_of.shape[1]
    if policy.ndim == 1:
        row = row_of[np.arange(n_states) % len(row_of), policy]
        return MixedPolicy(np.arange(n_states + 1), row, np.ones(n_states))
    taken = np.where(terminal[:, None], np.arange(n_actions) == 0, policy > 0)
    first = np.concatenate([[0], np.cumsum(np.count_nonzero(taken, axis=1))])
    rows = np.broadcast_to(row_of, (n_states // len(row_of), *row_of.shape))
    row, weight = rows[taken.reshape(rows.shape)], policy[taken]
    return MixedPolicy(first, row, np.asarray(weight, np.float64))


PlanningModel = TabularPlanningModel | FactoredPlanningModel


def model_of(task: Task) -> PlanningModel:
    """Return the model to plan with: the task's factored model if it has one, else its tables.

    At discount 1 it is the tables, which can be searched for policies that never end.
    """
    factored_model = getattr(task, "factored_model", None)
    if isinstance(factored_model, FactoredModel) and factored_model.discount < 1:
        return FactoredPlanningModel.of(factored_model)
    return TabularPlanningModel.of(tables(task))
