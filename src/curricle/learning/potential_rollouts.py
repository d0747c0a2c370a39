"""Greedy rollouts of a potential: what it predicts at each step, and the return that follows.

They calibrate a potential, or forecast where learning will start, before anything is learnt.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from curricle.array_types import BoolArray, FloatArray, IntArray
from curricle.checks import whole_number
from curricle.display import brief_repr
from curricle.errors import SettingError
from curricle.frozen_arrays import Frozen, frozen
from curricle.learning.potential import MappedPotential, StateActionPotential
from curricle.learning.value_lookup import ValueLookup, read_row
from curricle.planning.greedy import (
    ONLY_ROW,
    Values,
    acting_row,
    acting_rows,
    best_of,
    greedy_actions,
    highest,
)
from curricle.planning.policy_evaluation import GreedyEvaluation, greedy_policy_return
from curricle.planning.simulator import EpisodeEnds, GreedyPolicy, StepRecord, simulate
from curricle.tasks.draws import stream_start
from curricle.tasks.live import open_model
from curricle.tasks.overloads import compiled
from curricle.tasks.task import generative_model

PairPotential = StateActionPotential | MappedPotential
LARGEST_ARRAY = 1_000_000
"""Pairs (S x A) up to which a mapped potential is read from an array, as others are."""
MOST_STEPS = 50_000_000
"""Steps that may be recorded (2.4 GB)."""


class LookedUp(NamedTuple):
    """The values of a potential that is looked up in its sources' values."""

    lookup: ValueLookup
    row: FloatArray  # (A,) work space
    values: FloatArray  # (1, A) work space


@acting_rows.body(LookedUp)
def _looked_up_row(view, state, out):
    read_row(view.lookup, state, view.row)
    for action in range(out.shape[1]):
        out[0, action] = view.row[action]


@greedy_actions.body(LookedUp)
def _greedy_looked_up(view, state, bits):
    acting_row(view, state, view.values)
    return best_of(view.values, ONLY_ROW, bits)[1]


@dataclass(frozen=True, eq=False)
class GreedyRollouts(Frozen):
    """E greedy episodes with n steps in all, and what the potential predicts at each step."""

    states: IntArray  # (n,)
    actions: IntArray  # (n,)
    predicted: FloatArray  # (n,) phi(s_t, a_t)
    return_to_go: FloatArray  # (n,) discounted rewards from step t to the end of its episode
    bootstrap_discount: FloatArray  # (n,) gamma^(steps to the end) if truncated, 0 if terminated
    bootstrapped_value: FloatArray  # (n,) max_a phi of the last state if truncated, else 0
    lengths: IntArray  # (E,) steps of each episode
    ended: BoolArray  # (E,) whether it terminated
    returns: FloatArray  # (E,) its sum of rewards, undiscounted
    one_reward: bool  # whether every step had the same reward

    __repr__ = brief_repr


def greedy_rollouts(
    potential: PairPotential,
    *,
    episodes: int,
    seed: int = 0,
    stream: str = "greedy_rollouts",
    max_steps: int | None = None,
) -> GreedyRollouts:
    """Return episodes of the greedy policy of a potential in its task, ties broken at random.

    Each is truncated at the task's time limit or, without one, where rewards are discounted by a
    factor below 1e-9. All stop after `max_steps`, the last of them truncated there.
    """
    if not isinstance(potential, StateActionPotential | MappedPotential):
        raise SettingError(f"rollouts need a potential of state-action pairs: got {potential!r}")
    task = generative_model(potential.task)
    episodes, horizon = rollout_size(potential.task, episodes, max_steps)
    start, view = stream_start(seed, stream), acting_view(potential)
    draws = np.array([start], dtype=np.uint64)
    with open_model(task, start) as model:
        policy = GreedyPolicy(view)
        steps, ends = simulate(model, policy, draws, episodes=episodes, limit=horizon)
    if max_steps is not None:
        steps, ends = _first_steps(steps, ends, max_steps)
    first = np.cumsum(ends.lengths) - ends.lengths
    predicted, *following = (np.empty(len(steps.states)) for _ in range(4))
    compiled(_predict, False)(view, task.discount, steps, ends, predicted, tuple(following))
    return_to_go, bootstrap_discount, bootstrapped_value = map(frozen, following)
    return GreedyRollouts(
        states=frozen(steps.states),
        actions=frozen(steps.actions),
        predicted=frozen(predicted),
        return_to_go=return_to_go,
        bootstrap_discount=bootstrap_discount,
        bootstrapped_value=bootstrapped_value,
        lengths=frozen(ends.lengths),
        ended=frozen(ends.terminated),
        returns=frozen(np.add.reduceat(steps.rewards, first)),
        one_reward=bool((steps.rewards == steps.rewards[0]).all()),
    )


def _first_steps(steps: StepRecord, ends: EpisodeEnds, n: int) -> tuple[StepRecord, EpisodeEnds]:
    """Return the first n steps; an episode that goes on is truncated there."""
    after = np.cumsum(ends.lengths)
    if after[-1] <= n:
        return steps, ends
    last = int(np.searchsorted(after, n))
    kept: list[Any] = [array[: last + 1].copy() for array in ends]
    cut = EpisodeEnds(*kept)
    if after[last] > n:
        cut.lengths[last] -= after[last] - n
        cut.last_states[last] = steps.states[n]
        cut.terminated[last] = cut.truncated[last] = False
    return StepRecord(steps.states[:n], steps.actions[:n], steps.rewards[:n]), cut


def rollout_size(task: Any, episodes: int, max_steps: int | None = None) -> tuple[int, int]:
    """Return the episodes, checked, and the most steps of each; SettingError if too many."""
    episodes = whole_number("episodes of rollouts", episodes, 1, SettingError)
    horizon = GreedyEvaluation().horizon(task)
    horizon = horizon if max_steps is None else min(horizon, max_steps)
    if episodes * horizon > MOST_STEPS:
        raise SettingError(
            f"rollouts of {episodes:,} episodes of up to {horizon:,} steps must not exceed "
            f"{MOST_STEPS:,} steps in all: set a time limit or ask for fewer"
        )
    return episodes, horizon


def greedy_start(potential: PairPotential, evaluation: GreedyEvaluation, *, seed: int = 0) -> float:
    """Return the greedy policy's return, which :func:`learn` records where Q starts at phi."""
    return greedy_policy_return(potential.task, acting_view(potential), evaluation, seed=seed)


def acting_view(potential: PairPotential) -> LookedUp | Values:
    """Return a potential as compiled loops read it: an array, unless that would be large."""
    task = generative_model(potential.task)
    n_actions = task.actions.size
    if isinstance(potential, MappedPotential) and task.states.size * n_actions > LARGEST_ARRAY:
        return LookedUp(potential.lookup, np.empty(n_actions), np.empty((1, n_actions)))
    return Values(potential.values)


def _predict(view, discount, steps, ends, predicted, following):
    """Fill in phi of each step and what followed it; arrays as in :class:`GreedyRollouts`."""
    return_to_go, bootstrap_discount, bootstrapped_value = following
    row, first = np.empty((1, view.values.shape[1])), 0
    for episode in range(ends.lengths.shape[0]):
        last = first + ends.lengths[episode]
        total, weight, value = 0.0, 0.0, 0.0
        if not ends.terminated[episode]:
            acting_row(view, np.uint64(ends.last_states[episode]), row)
            weight, value = 1.0, highest(row, np.uint64(0))
        for t in range(last - 1, first - 1, -1):
            acting_row(view, np.uint64(steps.states[t]), row)
            predicted[t] = row[0, np.uint64(steps.actions[t])]
            total, weight = steps.rewards[t] + discount * total, discount * weight
            return_to_go[t], bootstrap_discount[t], bootstrapped_value[t] = total, weight, value
        first = last
