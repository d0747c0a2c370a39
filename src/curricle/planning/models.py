"""Planning models: a task's numbers that exact planning reads, and its compiled sweeps.

Every iteration ends with a sweep in which each value was backed up from a vector within `change` of
the values returned, which is all that the error bound in ``solution.py`` needs. Index tables are
uint32: an unsigned index needs no test for being negative.
"""

from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, Frozen, IntArray
from curricle.tasks.graph import improper_states, rows_in_use, steps_to
from curricle.tasks.kernel import compiled_once, outlined, overloaded
from curricle.tasks.mdp import FiniteMDP, Task, tables
from curricle.tasks.models import FactoredModel, joint_landing, predators_on_prey

RowArray = npt.NDArray[np.uint32]
SWEEPS = 5  # sweeps of the greedy policy after each greedy backup; 3 to 6 are about as good
PATIENCE = 100
"""Backups without progress near the limits of double precision before giving up, plus a horizon."""
CONVERGED = -1


# -- the loop ------------------------------------------------------------------------------------


class Precision(NamedTuple):
    """How far to iterate."""

    enough: float  # the residual, rounding included, at which to end
    relative: float  # or at which to end for each unit of the largest value
    unit: float  # the relative rounding error of one backup
    largest_reward: float
    horizon: float  # what a residual is multiplied by to bound the error
    discount: float


@overloaded(outlined=True)
def back_up(backup, values, sweep):
    """Back up all values in place, as the sweep of this number; return the largest change."""


@overloaded(outlined=True, otherwise=lambda backup, values, sweep, precision, progress: 0.0)
def accelerate(backup, values, sweep, precision, progress):
    """Bring values closer to the fixed point while changes shrink; return the growth of `reach`."""


class Iteration(NamedTuple):
    """The progress of an iteration."""

    sweeps: int  # done
    change: float  # the largest of a value, in the last sweep
    least: float  # the smallest change so far
    waited: int  # backups without progress, or CONVERGED
    reach: float  # a sum of changes: no value is larger


@compiled_once
def iterate(backup, values, precision, iteration, most):
    """Back up `values` in place, at most so many sweeps more; return the fields of an Iteration."""
    # A tuple is returned: Numba makes a NamedTuple by running Python, and dies if interrupted.
    first, change, least, waited, reach = iteration
    for sweep in range(first, first + most):
        change = back_up(backup, values, sweep)
        reach += change
        waited = converged(change, least, waited, values, reach, precision)
        if waited == CONVERGED:
            break
        least = min(least, change)
        reach += accelerate(backup, values, sweep, precision, waited == 0)
    return sweep + 1, change, least, waited, reach


@outlined
def largest_of(values):
    """Return max |V|."""
    largest = 0.0
    for value in values:
        largest = max(largest, abs(value))
    return largest


@outlined
def converged(change, least, waited, values, reach, precision):
    """Return for how many backups there has been no progress, or CONVERGED to end."""
    # It ends if the residual (gamma times the change, plus the rounding of a backup: `unit` times
    # the size of the numbers) is at most `enough`, or `relative` times the largest value; if the
    # change is well below that rounding; or if, near it, `least` has not been undercut for long.
    enough, relative, unit, largest_reward, horizon, discount = precision
    if not change < np.inf:
        return CONVERGED
    # While the change is far from the largest value, `reach` spares the search for that value.
    rough = max(enough, relative * reach)
    if discount * change > rough and change > 64 * horizon * unit * (largest_reward + reach):
        return 0
    largest = largest_of(values)
    rounding = unit * (largest_reward + largest)
    if discount * change + rounding <= max(enough, relative * largest) or 2 * change <= rounding:
        return CONVERGED
    if change < least:
        return 0
    return waited + 1 if waited < PATIENCE + horizon else CONVERGED


# -- the best policy -----------------------------------------------------------------------------


class OutcomeRows(NamedTuple):
    """The tables that backups read."""

    mean: FloatArray  # (Y,) mean reward
    probability: FloatArray  # (Y, O)
    next_state: RowArray  # (Y, O)
    terminal: BoolArray  # (S,)
    discount: float


class GreedyBackup(NamedTuple):
    """Modified policy iteration: a greedy backup, then a few sweeps of the greedy policy."""

    outcomes: OutcomeRows
    outcome_row: RowArray  # (S, A)
    chosen: RowArray  # (S,) work space: the row of a greedy action
    rows: FloatArray  # (Y,) work space: rows backed up


@back_up.body(GreedyBackup)
def _greedy_backup(backup, values, sweep):
    back_up_rows(backup.outcomes, values, backup.rows)
    terminal = backup.outcomes.terminal
    return improve(backup.outcome_row, terminal, backup.rows, values, backup.chosen)


@accelerate.body(GreedyBackup)
def _greedy_policy_sweeps(backup, values, sweep, precision, progress):
    for n in range(SWEEPS):
        change = policy_backup(backup.outcomes, backup.chosen, values, n)
        if change <= 0.5 * precision.enough:
            break
    return 0.0


@compiled_once
def back_up_rows(outcomes, values, rows):
    """Write r + gamma sum_s' P(s') V(s') of each outcome row into `rows`."""
    mean, probability, next_state, _, discount = outcomes
    for row in range(len(probability)):
        total = 0.0
        for outcome in range(probability.shape[1]):
            total += probability[row, outcome] * values[next_state[row, outcome]]
        rows[row] = mean[row] + discount * total


@compiled_once
def improve(outcome_row, terminal, rows, values, chosen):
    """Set each value to its state's best row, `chosen` to that row; return the change."""
    # A choice that is still among the best is kept. Four running maxima hide the latency of one.
    n_states, n_actions = outcome_row.shape
    fours = n_actions // 4
    change = 0.0
    for state in range(n_states):
        if terminal[state]:
            continue
        best = rows[chosen[state]]
        second, third, fourth = best, best, best
        for four in range(fours):
            value = rows[outcome_row[state, 4 * four]]
            best = value if value > best else best
            value = rows[outcome_row[state, 4 * four + 1]]
            second = value if value > second else second
            value = rows[outcome_row[state, 4 * four + 2]]
            third = value if value > third else third
            value = rows[outcome_row[state, 4 * four + 3]]
            fourth = value if value > fourth else fourth
        for action in range(4 * fours, n_actions):
            value = rows[outcome_row[state, action]]
            best = value if value > best else best
        best = max(max(best, second), max(third, fourth))
        if rows[chosen[state]] < best:
            for action in range(n_actions):
                if rows[outcome_row[state, action]] == best:
                    chosen[state] = outcome_row[state, action]
                    break
        change = max(change, abs(best - values[state]))
        values[state] = best
    return change


# -- a given policy ------------------------------------------------------------------------------


@compiled_once
def policy_backup(outcomes, chosen, values, sweep):
    """Back up a policy of one row a state in place, downwards in odd sweeps; return the change."""
    mean, probability, next_state, terminal, discount = outcomes
    n_states = len(values)
    change = 0.0
    for index in range(n_states):
        state = n_states - 1 - index if sweep % 2 else index
        if terminal[state]:
            continue
        row = chosen[state]
        total = 0.0
        for outcome in range(probability.shape[1]):
            total += probability[row, outcome] * values[next_state[row, outcome]]
        new = mean[row] + discount * total
        change = max(change, abs(new - values[state]))
        values[state] = new
    return change


class PolicyBackup(NamedTuple):
    """The backup of a policy of one row a state, in place, which takes fewer sweeps."""

    outcomes: OutcomeRows
    chosen: RowArray  # (S,)


@back_up.body(PolicyBackup)
def _policy_backup(backup, values, sweep):
    return policy_backup(backup.outcomes, backup.chosen, values, 0)  # upwards: equal sweeps


class MixedPolicy(NamedTuple):
    """A policy in compressed form: state s has the entries first[s] to first[s + 1]."""

    first: IntArray  # (S + 1,)
    row: RowArray  # (n,) outcome row of each entry
    weight: FloatArray  # (n,)


class MixedPolicyBackup(NamedTuple):
    """The backup of any policy."""

    outcomes: OutcomeRows
    policy: MixedPolicy
    rows: FloatArray  # (Y,) work space: rows backed up


@back_up.body(MixedPolicyBackup)
def _mixed_policy_backup(backup, values, sweep):
    back_up_rows(backup.outcomes, values, backup.rows)
    return mixed_policy_backup(backup.policy, backup.outcomes.terminal, backup.rows, values)


@outlined
def mixed_policy_backup(policy, terminal, rows, values):
    """Make values the policy's mean of their rows; return the largest change."""
    first, row, weight = policy
    change = 0.0
    for state in range(len(values)):
        if terminal[state]:
            continue
        new = 0.0
        for entry in range(first[state], first[state + 1]):
            new += weight[entry] * rows[row[entry]]
        change = max(change, abs(new - values[state]))
        values[state] = new
    return change


class ExtrapolatedBackup(NamedTuple):
    """A policy's backup, extrapolated along its last step at times (Anderson 1965, depth 1)."""

    backup: Any  # linear, every sweep in the same direction
    steps: FloatArray  # (2, S) work space: changes of the last two sweeps
    last: IntArray  # (1,) work space: the sweep after which it was last extrapolated


@back_up.body(ExtrapolatedBackup)
def _recorded_backup(backup, values, sweep):
    step = backup.steps[sweep % 2]
    for state in range(len(values)):  # the assignment of slices takes seconds to compile
        step[state] = values[state]
    change = back_up(backup.backup, values, sweep)
    for state in range(len(values)):
        step[state] = values[state] - step[state]
    return change


@accelerate.body(ExtrapolatedBackup)
def _extrapolation(backup, values, sweep, precision, progress):
    if not progress or sweep - backup.last[0] < 4:
        return 0.0
    if not extrapolate(values, backup.steps[sweep % 2], backup.steps[1 - sweep % 2]):
        return 0.0
    backup.last[0] = sweep
    return largest_of(values)


@outlined
def extrapolate(values, step, last):
    """Extrapolate along the last step; return whether it was done."""
    # After two equal linear sweeps, V + last and then V + last + step, the sweep from the mixture
    # V + (1 - t) last changes it by (1 - t) step + t last, and leads to the values returned. t
    # minimises that change in the mean square. It is used only if the change is then less than half
    # of `step` in the maximum norm, so that no sweep is lost.
    along, across, longest = 0.0, 0.0, 0.0
    for state in range(len(values)):
        bend = step[state] - last[state]
        along += step[state] * bend
        across += bend * bend
        longest = max(longest, abs(step[state]))
    if across == 0.0:
        return False
    t = along / across
    for state in range(len(values)):
        if abs((1 - t) * step[state] + t * last[state]) > 0.5 * longest:
            return False
    for state in range(len(values)):
        values[state] -= t * step[state]
    return True


# -- a factored model ----------------------------------------------------------------------------
#
# No tables: first the prey moves, then each predator. The values of all states with the prey on
# one cell are a *plane*, C^k numbers. A sweep backs up plane by plane, in place: the mean over the
# prey's moves is a sum of planes, and the best joint move is the best move of each predator in
# turn, since max over (a, b) is max over a of max over b. So a state costs M + k M numbers instead
# of M^k; all loops but one run along memory.


class Planes(NamedTuple):
    """The numbers of a factored model that backups read."""

    mean: FloatArray  # (S,) reward of a step from the prey's cell to the predators' cells
    landing: npt.NDArray[np.int32]  # (C, M)
    prey_policy: FloatArray  # (C, M)
    terminal: BoolArray  # (S,)
    discount: float


class GreedyPlanes(NamedTuple):
    """Value iteration: one sweep goes through the planes upwards, the next downwards."""

    planes: Planes
    predators: int
    space: FloatArray  # (3, C^k) work space: a plane, its best moves, the largest change of each


@back_up.body(GreedyPlanes)
def _greedy_planes_backup(backup, values, sweep):
    planes, n_cells = backup.planes, len(backup.planes.landing)
    plane, best, worst = backup.space[0], backup.space[1], backup.space[2]
    worst.fill(0.0)
    for index in range(n_cells):
        cell = n_cells - 1 - index if sweep % 2 else index
        expect(planes, values, cell, plane)
        best_of_moves(plane, planes.landing, best)
        # Values that are symmetric in the predators, which are interchangeable, stay symmetric:
        # the last transposition is left out.
        for _ in range(1, backup.predators):
            next_predator_first(best, n_cells, plane)
            best_of_moves(plane, planes.landing, best)
        keep(best, planes.terminal, values, cell * len(plane), worst)
    return largest_of(worst)


@compiled_once
def expect(planes, values, cell, plane):
    """Write r + gamma times the mean over the prey's moves from `cell` into `plane`."""
    mean, landing, prey_policy, _, discount = planes
    n, n_moves = len(plane), landing.shape[1]
    base = mean[cell * n : (cell + 1) * n]
    source = values[landing[cell, 0] * n : (landing[cell, 0] + 1) * n]
    chance = discount * prey_policy[cell, 0]
    for index in range(n):
        plane[index] = base[index] + chance * source[index]
    for move in range(1, n_moves):
        source = values[landing[cell, move] * n : (landing[cell, move] + 1) * n]
        chance = discount * prey_policy[cell, move]
        for index in range(n):
            plane[index] += chance * source[index]


@outlined
def best_of_moves(plane, landing, best):
    """Write the best over the moves of the first predator, the slowest axis, into `best`."""
    n_cells, n_moves = landing.shape
    n = len(plane) // n_cells
    second = min(1, n_moves - 1)
    for cell in range(n_cells):
        target = best[cell * n : (cell + 1) * n]
        source = plane[landing[cell, 0] * n : (landing[cell, 0] + 1) * n]
        other = plane[landing[cell, second] * n : (landing[cell, second] + 1) * n]
        for index in range(n):
            target[index] = source[index] if source[index] > other[index] else other[index]
        for move in range(2, n_moves):
            source = plane[landing[cell, move] * n : (landing[cell, move] + 1) * n]
            for index in range(n):
                target[index] = source[index] if source[index] > target[index] else target[index]


@outlined
def next_predator_first(plane, n_cells, turned):
    """Write the plane with its first axis moved to the end into `turned`."""
    n = len(plane) // n_cells
    source, target = plane.reshape(n_cells, n), turned.reshape(n, n_cells)
    for cell in range(n_cells):
        for index in range(n):
            target[index, cell] = source[cell, index]


@outlined
def keep(best, terminal, values, start, worst):
    """Store a plane, terminal states at 0; `worst` collects the largest change of each entry."""
    n = len(best)
    target, ended = values[start : start + n], terminal[start : start + n]
    for index in range(n):
        new = 0.0 if ended[index] else best[index]
        change = abs(new - target[index])
        worst[index] = change if change > worst[index] else worst[index]
        target[index] = new


# -- the models of a task --------------------------------------------------------------------------


Policy = npt.NDArray[np.integer[Any]] | FloatArray
"""An action for each state, (S,), or the probability of each action, (S, A)."""


@dataclass(frozen=True, eq=False)
class _Model(Frozen):
    """The fields of both kinds of model."""

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
    def available(self) -> BoolArray | None:
        """The actions that can be taken in each state, (S, A); None where all can."""
        return self.mdp.available

    @property
    def _rows(self) -> npt.NDArray[np.uint32]:
        return self.mdp.outcome_row.view(np.uint32)

    @property
    def _outcomes(self) -> OutcomeRows:
        mdp, after = self.mdp, self.mdp.next_state.view(np.uint32)
        tables = self.mean_reward, mdp.probability, after, mdp.terminal
        return OutcomeRows(*tables, self.discount)

    def greedy_backup(self) -> tuple[Any, float]:
        """Return the greedy backup, and the lowest best mean reward of a state, at most 0."""
        chosen, best = self._rows[:, 0].copy(), np.zeros(len(self.terminal))
        improve(self._rows, self.terminal, self.mean_reward, best, chosen)
        space = np.empty(len(self.mean_reward))
        backup = GreedyBackup(self._outcomes, self._rows, chosen, space)
        return backup, min(0.0, float(best.min()))

    def policy_backup(self, policy: Policy) -> Any:
        """Return the backup of a policy; faster where it takes one action a state."""
        mixed = mixed_policy(policy, self.terminal, self._rows)
        certain = len(mixed.row) == len(self.terminal)
        if certain and (self.terminal | (mixed.weight == 1.0)).all():
            return PolicyBackup(self._outcomes, mixed.row)
        return MixedPolicyBackup(self._outcomes, mixed, np.empty(len(self.mean_reward)))

    def largest_sum(self, policy: Policy | None) -> float:
        """Return a bound of the sum of a pair's probabilities, or of a state's under a policy."""
        used = rows_in_use(self.mdp.outcome_row, self.terminal, len(self.mdp.probability))
        bound = sum_bound(self.mdp.probability[used])
        if policy is None or policy.ndim == 1:  # one action a state
            return bound
        return bound * sum_bound(policy[~self.terminal])

    def start_value(self, values: FloatArray) -> float:
        """Return the mean of `values` over the start distribution."""
        return float(self.mdp.start @ values)

    def action_values(self, values: FloatArray) -> FloatArray:
        """Return sum_s' P(s' | s, a) (r + gamma V(s')), (S, A); 0 in terminal states.

        An unavailable pair has the value of the pair that stands for it.
        """
        outcomes = values[self.mdp.next_state]
        outcomes *= self.discount
        outcomes += self.mdp.reward
        outcomes *= self.mdp.probability
        q = np.asarray(outcomes.sum(axis=1)[self.mdp.outcome_row])
        q[self.terminal] = 0.0
        return q

    def endless(self, policy: Policy | None) -> IntArray:
        """Return the states from which a policy (some policy if None) may never end."""
        if policy is None:
            return improper_states(self.mdp)
        taken = policy > 0 if policy.ndim == 2 else np.arange(self.n_actions) == policy[:, None]
        return np.flatnonzero(np.isinf(steps_to(self.mdp, self.terminal, taken=taken)))

    def counting_steps(self) -> Self:
        """Return the model with a reward of 1 for every step and discount 1."""
        ones = np.ones_like(self.mean_reward)
        return replace(self, mean_reward=ones, largest_reward=1.0, discount=1.0)


@dataclass(frozen=True, eq=False)
class FactoredPlanningModel(_Model):
    """A model computed from a factored model, for the best policy; its discount is below 1."""

    factored_model: FactoredModel
    available: ClassVar[None] = None

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
    def _planes(self) -> Planes:
        moves = self.factored_model.landing, self.factored_model.prey_policy
        return Planes(self.mean_reward, *moves, self.terminal, self.discount)

    @property
    def _plane_size(self) -> int:
        return len(self.terminal) // len(self.factored_model.landing)

    def greedy_backup(self) -> tuple[Any, float]:
        """Return the greedy backup, and the lowest reward, at most 0."""
        m, space = self.factored_model, np.empty((3, self._plane_size))
        backup = GreedyPlanes(self._planes, m.predators, space)
        return backup, min(0.0, float(m.rewards.min()))

    def largest_sum(self, policy: Policy | None = None) -> float:
        """Return a bound of the sum of a pair's probabilities."""
        return sum_bound(self.factored_model.prey_policy)

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
            expect(self._planes, values, cell, plane)
        return rows.ravel()


def sum_bound(probability: npt.NDArray[Any]) -> float:
    """Return a bound of the sum of any row: tables may sum to 1 + 1e-8, and sums are rounded."""
    rounding = (probability.shape[1] - 1) * np.finfo(np.float64).eps
    largest = probability.sum(axis=1).max(initial=0.0)
    return float(largest * (1 + rounding))


def mixed_policy(
    policy: Policy, terminal: BoolArray, row_of: npt.NDArray[np.uint32]
) -> MixedPolicy:
    """Return a policy in compressed form; a terminal state has one entry, which is not used.

    `row_of` has the outcome row of each pair.
    """
    n_states, n_actions = row_of.shape
    if policy.ndim == 1:
        row = row_of[np.arange(n_states), policy]
        return MixedPolicy(np.arange(n_states + 1), row, np.ones(n_states))
    taken = np.where(terminal[:, None], np.arange(n_actions) == 0, policy > 0)
    first = np.concatenate([[0], np.cumsum(np.count_nonzero(taken, axis=1))])
    return MixedPolicy(first, row_of[taken], np.asarray(policy[taken], np.float64))


PlanningModel = TabularPlanningModel | FactoredPlanningModel


def model_of(task: Task) -> PlanningModel:
    """Return the model to plan with: the task's factored model if it has one, else its tables.

    At discount 1 it is the tables, which can be searched for policies that never end.
    """
    factored_model = getattr(task, "factored_model", None)
    if isinstance(factored_model, FactoredModel) and factored_model.discount < 1:
        return FactoredPlanningModel.of(factored_model)
    return TabularPlanningModel.of(tables(task))
