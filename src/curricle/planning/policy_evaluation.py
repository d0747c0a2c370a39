"""Compiled evaluation of the greedy policy: its expected return, exactly or by rollouts."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.learning.exploration import ACTION, TIED
from curricle.learning.tables import acting_row, greedy_of
from curricle.tasks.draws import draw, splitmix64
from curricle.tasks.generative_models import Tables, aside, cut_short, first_state, transition
from curricle.tasks.overloads import Overloaded

JUDGE = 0x5851F42D4C957F2D
"""Sets the stream of evaluations apart from that of learning, which they must not disturb."""


class Rollouts(NamedTuple):
    """The mean of some episodes."""

    episodes: int
    weight: float  # of a reward, relative to the one before: the discount, or 1
    horizon: int  # steps of an episode
    stream: npt.NDArray[np.uint64]  # (1,)

    def for_run(self, start: int) -> "Rollouts":
        """Return this for a run whose random stream starts at `start`."""
        return self._replace(stream=np.array([start ^ JUDGE], dtype=np.uint64))


class Exact(NamedTuple):
    """The expectation, by following the distribution over states."""

    tables: Tables
    weight: float
    horizon: int
    negligible: float  # probability still in play below which following stops
    mass: npt.NDArray[np.float64]  # (2, S) room: probability of being in a state, now and next
    alive: npt.NDArray[np.int64]  # (2, S) room: the states where that is not 0
    greedy: npt.NDArray[np.int64]  # (S,) room
    values: npt.NDArray[np.float64]  # (1, A) room

    def for_run(self, start: int) -> "Exact":
        """Return this with room of its own for a run."""
        n_states, n_actions = self.tables.outcome_row.shape
        return self._replace(
            mass=np.zeros((2, n_states)),
            alive=np.zeros((2, n_states), dtype=np.int64),
            greedy=np.zeros(n_states, dtype=np.int64),
            values=np.zeros((1, n_actions)),
        )


class Off(NamedTuple):
    """No evaluation."""

    def for_run(self, start: int) -> "Off":
        """Return this."""
        return self


NO_STREAM = np.zeros(0, np.uint64)
NO_ROOM = np.zeros((0, 0)), np.zeros((0, 0), np.int64), np.zeros(0, np.int64), np.zeros((0, 0))
"""In their places before a run has its own."""


def greedy_return(evaluation, model, view):
    """Return the greedy policy's expected return from the start to the horizon.

    `view` is what the policy is greedy on (:func:`greedy_of`); ties are broken uniformly.
    """


judgements = Overloaded(greedy_return, outlined=True)


@judgements.body(Off)
def _not_judged(evaluation, model, view):
    return np.nan


@judgements.body(Rollouts)
def _rolled_return(evaluation, model, view):
    total, place = 0.0, aside(model)
    for _ in range(evaluation.episodes):
        state, weight = first_state(place, draw(evaluation.stream)), 1.0
        for _ in range(evaluation.horizon):
            bits = draw(evaluation.stream)
            action = greedy_of(view, state, bits) & ACTION
            state, reward, over = transition(place, state, action, splitmix64(bits))
            total += weight * reward
            if over or cut_short(place):
                break
            weight *= evaluation.weight
    return total / evaluation.episodes


@judgements.body(Exact)
def _followed_return(evaluation, model, view):
    tables, mass, alive = evaluation.tables, evaluation.mass, evaluation.alive
    greedy, values = evaluation.greedy, evaluation.values
    n_actions, n_outcomes = tables.outcome_row.shape[1], tables.probability.shape[1]
    for state in range(greedy.shape[0]):
        greedy[state] = -1  # not yet asked for
    before = 0.0
    now, n_alive = 0, tables.start_states.shape[0]
    for i in range(n_alive):
        state = tables.start_states[i]
        alive[now, i] = state
        mass[now, state] = tables.start_cumulative[i] - before
        before = tables.start_cumulative[i]

    total, weight = 0.0, 1.0
    for step in range(evaluation.horizon):
        n_next, in_play = 0, 0.0
        for i in range(n_alive):
            state = alive[now, i]
            if greedy[state] < 0:
                greedy[state] = greedy_of(view, np.uint64(state), np.uint64(0))
            first, last, ties = greedy[state], greedy[state] + 1, 1
            if first >= TIED:
                acting_row(view, np.uint64(state), values)
                best = values[0, np.uint64(first) & ACTION]
                first, last, ties = 0, n_actions, 0
                for action in range(n_actions):
                    ties += values[0, action] == best
            share = mass[now, state] / ties
            mass[now, state] = 0.0
            for action in range(first, last):
                if ties > 1 and values[0, action] != best:
                    continue
                row = tables.outcome_row[state, action]
                for outcome in range(n_outcomes):
                    part = share * tables.probability[row, outcome]
                    if part > 0.0:
                        total += weight * part * tables.reward[row, outcome]
                        reached = tables.next_state[row, outcome]
                        if not tables.terminal[reached]:
                            if mass[1 - now, reached] == 0.0:
                                alive[1 - now, n_next] = reached
                                n_next += 1
                            mass[1 - now, reached] += part
                            in_play += part
        now, n_alive = 1 - now, n_next
        weight *= evaluation.weight
        if in_play * weight < evaluation.negligible or step == evaluation.horizon - 1:
            for i in range(n_alive):
                mass[now, alive[now, i]] = 0.0
            break
    return total
