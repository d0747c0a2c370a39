"""The loop of R-max: a model of what was seen, and two tables that are planned in it on the way.

Planning is by small backups (van Seijen, Sutton 2013): what a state's value has changed by is
added, by its share, to each pair that has led there. So a backup reads no row of successors, and
changes that are too small to be propagated add up until they are not. States wait in a queue, not
by priority: five times the backups gained .02 of the way at most, and a heap could gain no more.
"""

from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.learning.general_loop import is_spent
from curricle.learning.learners import explore
from curricle.learning.q_learning import Change, update
from curricle.learning.record import Checkpoint, noted_end
from curricle.learning.storage import DenseTable, find_row_maxima, tie_bits
from curricle.planning.greedy import ACTION
from curricle.planning.policy_evaluation import greedy_return
from curricle.tasks.kernel import STRIDE, called, inlined, splitmix64
from curricle.tasks.models import first_state, has_failed, transition, truncated

PAIR, NEXT_STATE, COUNT, OF_PAIR, TO_STATE = range(5)
"""Columns of an outcome: what it is, how often it was seen, and the next outcome of two lists:
those of its pair, and those that lead to its state. Outcome 0 ends a list."""


class LearntModel(NamedTuple):
    """What was seen of each pair."""

    min_visits: int  # visits from which on a pair is planned with
    visits: IntArray  # (S, A)
    reward: FloatArray  # (S, A) the mean
    of_pair: npt.NDArray[np.int32]  # (S * A,) first outcome of each pair
    to_state: npt.NDArray[np.int32]  # (S,) first outcome that leads to each state
    outcomes: npt.NDArray[np.int32]  # (M, 5)
    used: IntArray  # (1,) outcomes in use, outcome 0 among them

    @classmethod
    def empty(cls, min_visits: int, shape: tuple[int, int], most: int) -> Self:
        """Return the model before the first step, with up to so many outcomes."""
        # Pages of np.zeros take no memory before they are written to.
        pairs, states = np.zeros(shape[0] * shape[1], np.int32), np.zeros(shape[0], np.int32)
        outcomes, used = np.zeros((most + 1, 5), np.int32), np.ones(1, np.int64)
        return cls(
            min_visits, np.zeros(shape, np.int64), np.zeros(shape), pairs, states, outcomes, used
        )


class Plan(NamedTuple):
    """A table of the model's values, and the states whose change is yet to be propagated."""

    table: DenseTable
    propagated: FloatArray  # (S,) the value of each state that the pairs leading there count with
    queue: IntArray  # (S,) a ring: the states that wait
    waits: BoolArray  # (S,)
    ends: IntArray  # (2,) the number of states that have left the queue, and that have entered it
    highest: float  # cuts what is propagated
    least: float  # change of a value that is propagated

    @classmethod
    def of(cls, table: DenseTable, bounds: tuple[float, float], discount: float) -> Self:
        """Return the plan before the first step, for values within bounds."""
        propagated = np.minimum(table.q.max(axis=1), bounds[1]).astype(np.float64)
        queue, waits = np.zeros(len(propagated), np.int64), np.zeros(len(propagated), np.bool_)
        least = (bounds[1] - bounds[0]) * max(LEAST, ERROR * (1.0 - discount))
        return cls(table, propagated, queue, waits, np.zeros(2, np.int64), bounds[1], least)


ERROR = 1e-3
"""What is not propagated may change a value by, as a share of the range of values."""
LEAST = 1e-6  # share of that range below which no change is propagated


def train_in_model(model, rule, learns, course):
    """Learn in place, fill the record, return the steps and episodes done.

    `learns` are the model, the optimistic plan that is acted on, the plan that is evaluated, and
    how many pairs are backed up in each step and plan.
    """
    learnt, optimistic, sober, backups = learns
    table, evaluated, record = optimistic.table, sober.table, course.record
    find_row_maxima(table)
    find_row_maxima(evaluated)
    step = episodes = ended = checkpoint = length = np.int64(0)
    ended_return, episode_return, counter = 0.0, 0.0, course.stream + STRIDE
    fresh, state = True, np.uint64(0)
    while True:
        if step == checkpoint * course.eval_freq:
            value = greedy_return(course.evaluation, model, evaluated)
            curves = ended, ended_return, value, np.nan, np.nan
            reached = Checkpoint(checkpoint, step, episodes, *curves)
            noted = record, course.stopping, reached, evaluated.q, evaluated.q
            if called(course.noting, noted) > 0.0:
                return step, episodes
            checkpoint, ended, ended_return = checkpoint + 1, np.int64(0), 0.0
        full = learnt.used[0] == len(learnt.outcomes)
        if full or is_spent(course, step, episodes) or has_failed(model):
            return step, episodes
        if fresh:
            state, counter = first_state(model, splitmix64(counter)), counter + STRIDE
            length, episode_return = np.int64(0), 0.0
        drawn = explore(rule.exploration, table.q, state, table.row_max[state], step, counter)
        action, bits, counter, exploits = drawn
        if exploits:
            action = np.uint64(table.row_argmax[state]) & ACTION
        next_state, reward, terminated = transition(model, state, action, splitmix64(bits))
        note_outcome(learnt, state, action, reward, next_state, terminated)
        if learnt.visits[state, action] >= learnt.min_visits:
            for plan in (optimistic, sober):
                back_up(learnt, plan, course.discount, state, action, bits)
                sweep(learnt, plan, course.discount, backups, bits)
        step, length, episode_return = step + 1, length + 1, episode_return + reward
        ends = noted_end(record, next_state, terminated)
        # Cutting off at the time limit is not termination: the model knows where the step led.
        state, fresh = next_state, ends or length >= course.limit or truncated(model)
        if fresh:
            episodes, ended, ended_return = episodes + 1, ended + 1, ended_return + episode_return


@inlined
def note_outcome(learnt, state, action, reward, next_state, terminated):
    """Count an outcome of a pair in the model. An end has value 0, and need not be listed."""
    pair, outcomes = state * np.uint64(learnt.visits.shape[1]) + action, learnt.outcomes
    learnt.visits[state, action] += 1
    visits = learnt.visits[state, action]
    learnt.reward[state, action] += (reward - learnt.reward[state, action]) / visits
    if terminated:
        return
    outcome = np.uint64(learnt.of_pair[pair])
    while outcome > 0 and np.uint64(outcomes[outcome, NEXT_STATE]) != next_state:
        outcome = np.uint64(outcomes[outcome, OF_PAIR])
    if outcome == 0:
        outcome = np.uint64(learnt.used[0])
        learnt.used[0] += 1
        outcomes[outcome, PAIR], outcomes[outcome, NEXT_STATE] = pair, next_state
        outcomes[outcome, OF_PAIR] = learnt.of_pair[pair]
        outcomes[outcome, TO_STATE] = learnt.to_state[next_state]
        learnt.of_pair[pair] = learnt.to_state[next_state] = outcome
    outcomes[outcome, COUNT] += 1


@inlined
def back_up(learnt, plan, discount, state, action, bits):
    """Set a pair to its mean reward plus gamma times the mean value that followed."""
    pair, following = state * np.uint64(learnt.visits.shape[1]) + action, 0.0
    outcome = np.uint64(learnt.of_pair[pair])
    while outcome > 0:
        count, next_state = learnt.outcomes[outcome, COUNT], learnt.outcomes[outcome, NEXT_STATE]
        following += count * plan.propagated[np.uint64(next_state)]
        outcome = np.uint64(learnt.outcomes[outcome, OF_PAIR])
    mean = following / learnt.visits[state, action]
    target = learnt.reward[state, action] + discount * mean
    set_value(plan, state, Change(action, 1.0, target, bits))


@inlined
def sweep(learnt, plan, discount, backups, bits):
    """Propagate the change of the states that have waited longest, to so many pairs and more."""
    n_states, n_actions = np.int64(len(plan.queue)), np.uint64(learnt.visits.shape[1])
    done = 0
    while done < backups and plan.ends[0] < plan.ends[1]:
        next_state = np.uint64(plan.queue[plan.ends[0] % n_states])
        plan.ends[0] += 1
        plan.waits[next_state] = False
        value = value_of(plan, next_state)
        change, plan.propagated[next_state] = value - plan.propagated[next_state], value
        outcome = np.uint64(learnt.to_state[next_state])
        while outcome > 0:
            done += 1
            pair, count = np.uint64(learnt.outcomes[outcome, PAIR]), learnt.outcomes[outcome, COUNT]
            outcome = np.uint64(learnt.outcomes[outcome, TO_STATE])
            state = pair // n_actions
            action = pair - state * n_actions
            visits = learnt.visits[state, action]
            if visits >= learnt.min_visits:
                target = plan.table.q[state, action] + discount * count / visits * change
                set_value(plan, state, Change(action, 1.0, target, tie_bits(bits, state)))


@inlined
def set_value(plan, state, change):
    """Update a pair, and let its state wait where the pairs that lead there should know of it."""
    update(plan.table.q, plan.table.row_max, plan.table.row_argmax, state, change)
    difference = abs(value_of(plan, state) - plan.propagated[state])
    if difference > plan.least and not plan.waits[state]:
        plan.waits[state] = True
        plan.queue[plan.ends[1] % len(plan.queue)] = state
        plan.ends[1] += 1


@inlined
def value_of(plan, state):
    """Return the value of a state, cut at the highest."""
    value = np.float64(plan.table.row_max[state])
    return value if value < plan.highest else plan.highest
