"""R-max: a model of what was seen, and two tables that are planned in it, a few pairs a step.

Planning is by small backups (van Seijen, Sutton 2013): what a state's value has changed by is
added, by its share, to each pair that has led there. So a backup reads no row of successors, and
changes that are too small to be propagated add up until they are not. States wait in a queue, not
by priority: five times the backups gained .02 of the way at most, and a heap could gain no more.
"""

from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.learning.storage import Change, DenseTable, tie_bits, update
from curricle.tasks.kernel import inlined

BACKUPS = 20  # pairs of a table that a step updates besides its own, or a few more
LEAST, ERROR = 1e-6, 1e-3  # shares of the range: the least change propagated, the error by the rest

PAIR = np.dtype([("visits", "i8"), ("mean_reward", "f8"), ("first_outcome", "u4")])
OUTCOME = np.dtype([(name, "u4") for name in ("state", "action", "next", "count", "of_pair", "to")])
"""An outcome: what it is, how often it was seen, and the next outcome of two lists, those of its
pair and those that lead to its state. Outcome 0 ends a list."""


class Plan(NamedTuple):
    """A table of the model's values, and the states whose change is yet to be propagated."""

    table: DenseTable
    propagated: FloatArray  # (S,) the value of each state that the pairs leading there count with
    queue: IntArray  # (S,) a ring: the states that wait
    waits: BoolArray  # (S,)
    ends: IntArray  # (2,) the number of states that have left the queue, and that have entered it


class LearntModel(NamedTuple):
    """What was seen of a task, and what is planned with it."""

    plans: tuple[Plan, ...]  # of the table that is acted on, and of Q
    highest: float  # cuts the values that are propagated
    least: float  # change of a value that is propagated
    min_visits: int  # from which on a pair is planned with
    pairs: npt.NDArray[Any]  # (S, A) of PAIR
    to_state: npt.NDArray[np.uint32]  # (S,) first outcome that leads to each state
    outcomes: npt.NDArray[Any]  # of OUTCOME, one a step at most
    used: npt.NDArray[np.uint32]  # (1,) outcomes in use, outcome 0 among them

    @classmethod
    def empty(cls, tables: Any, learner: Any, discount: float, most: int) -> Self:
        """Return the model before the first step, of `most`, of an :class:`RMax`."""
        (lowest, highest), n_states = learner.value_range, len(tables[0].q)
        values = np.minimum([table.q.max(axis=1) for table in tables], highest).astype(np.float64)
        queues, waits = np.zeros((2, n_states), np.int64), np.zeros((2, n_states), np.bool_)
        plans = tuple(map(Plan, tables, values, queues, waits, np.zeros((2, 2), np.int64)))
        least = (highest - lowest) * max(LEAST, ERROR * (1.0 - discount))
        pairs, to_state = np.zeros(tables[0].q.shape, PAIR), np.zeros(n_states, np.uint32)
        # Pages of np.zeros take no memory before they are written to.
        outcomes = np.zeros(min(most, pairs.size * n_states) + 1, OUTCOME)
        counts = pairs, to_state, outcomes, np.ones(1, np.uint32)
        return cls(plans, highest, least, learner.min_visits, *counts)


@inlined
def note_outcome(learnt, state, action, reward, next_state, terminated):
    """Count an outcome of a pair in the model. An end has value 0, and need not be listed."""
    pair = learnt.pairs[state, action]
    pair.visits += 1
    pair.mean_reward += (reward - pair.mean_reward) / pair.visits
    if terminated:
        return
    index = pair.first_outcome
    while index > 0 and learnt.outcomes[index].next != next_state:
        index = learnt.outcomes[index].of_pair
    if index == 0:
        index, learnt.used[0] = learnt.used[0], learnt.used[0] + 1
        outcome = learnt.outcomes[index]
        outcome.state, outcome.action, outcome.next = state, action, next_state
        outcome.of_pair, outcome.to = pair.first_outcome, learnt.to_state[next_state]
        pair.first_outcome = learnt.to_state[next_state] = index
    learnt.outcomes[index].count += 1


@inlined
def plan_from(learnt, plan, discount, state, action, bits):
    """Set a pair to its mean reward plus gamma times the mean value that followed; propagate."""
    pair, following = learnt.pairs[state, action], 0.0
    index = pair.first_outcome
    while index > 0:
        outcome = learnt.outcomes[index]
        following += outcome.count * plan.propagated[outcome.next]
        index = outcome.of_pair
    target = pair.mean_reward + discount * (following / pair.visits)
    set_value(learnt, plan, state, Change(action, 1.0, target, bits))
    updates = 0
    while updates < BACKUPS and plan.ends[0] < plan.ends[1]:
        # The state that has waited longest is propagated to all pairs that have led there.
        waiting = np.uint64(plan.queue[plan.ends[0] % len(plan.queue)])
        plan.ends[0] += 1
        plan.waits[waiting] = False
        value = min(learnt.highest, plan.table.row_max[waiting])
        change, plan.propagated[waiting] = value - plan.propagated[waiting], value
        index = learnt.to_state[waiting]
        while index > 0:
            outcome, updates = learnt.outcomes[index], updates + 1
            state, action, index = np.uint64(outcome.state), np.uint64(outcome.action), outcome.to
            visits = learnt.pairs[state, action].visits
            if visits >= learnt.min_visits:
                target = plan.table.q[state, action] + discount * outcome.count / visits * change
                set_value(learnt, plan, state, Change(action, 1.0, target, tie_bits(bits, state)))


@inlined
def set_value(learnt, plan, state, change):
    """Update a pair, and let its state wait where the pairs that lead there should know of it."""
    update(plan.table.q, plan.table.row_max, plan.table.row_argmax, state, change)
    difference = min(learnt.highest, plan.table.row_max[state]) - plan.propagated[state]
    if abs(difference) > learnt.least and not plan.waits[state]:
        plan.waits[state] = True
        plan.queue[plan.ends[1] % len(plan.queue)] = state
        plan.ends[1] += 1
