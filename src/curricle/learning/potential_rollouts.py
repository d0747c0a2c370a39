"""Following the greedy policy of a potential through its task, and noting what it earned.

What a potential promises, phi(s, a), is compared with what came of it before anything is learnt:
to calibrate it, or to foresee where learning will start.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.checks import whole_number
from curricle.errors import SettingError
from curricle.learning.exploration import ACTION, best_of
from curricle.learning.general_loop import Acting
from curricle.learning.potential import MappedPotential, StateActionPotential
from curricle.learning.run import compiled, stream_start
from curricle.learning.tables import acting_row, acting_rows, greedies, greedy_of
from curricle.learning.value_lookup import Reading, read_row
from curricle.planning.evaluation import GreedyEvaluation
from curricle.planning.policy_evaluation import Exact, greedy_return
from curricle.tasks.draws import draw, splitmix64
from curricle.tasks.generative_models import Functions, cut_short, first_state, transition
from curricle.tasks.live import opened
from curricle.tasks.spaces import frozen
from curricle.tasks.task import generative_model

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
PairPotential = StateActionPotential | MappedPotential
MOST_STEPS = 50_000_000
"""Steps that may be noted down (2.4 GB)."""


class Read(NamedTuple):
    """The values of a potential that is read on the fly, as compiled loops act on them."""

    reading: Reading
    row: FloatArray  # (A,) room
    values: FloatArray  # (1, A) room


@acting_rows.body(Read)
def _read_acting_row(view, state, out):
    read_row(view.reading, state, view.row)
    for action in range(out.shape[1]):
        out[0, action] = view.row[action]


@greedies.body(Read)
def _read_greedy(view, state, bits):
    acting_row(view, state, view.values)
    return best_of(view.values, 0, bits)[1]


@dataclass(frozen=True, eq=False)
class GreedyRollouts:
    """E greedy episodes of n steps in all; per step what was promised and what was earned.

    Attributes
    ----------
    states, actions : (n,) int64
    predicted : (n,) float64
        phi(s_t, a_t).
    return_to_go : (n,) float64
        The discounted rewards from step t to the end of its episode.
    bootstrap_discount : (n,) float64
        gamma^(steps to the end) where the episode was cut off and would have gone on, else 0.
    bootstrapped_value : (n,) float64
        max_a phi(s, a) of the state the episode was cut off in; 0 where it ended.
    lengths : (E,) int64
        Steps of each episode.
    ended : (E,) bool
        Whether it reached an end, instead of being cut off.
    returns : (E,) float64
        Its sum of rewards, undiscounted.
    one_reward : bool
        Whether every step was paid alike.
    """

    states: IntArray
    actions: IntArray
    predicted: FloatArray
    return_to_go: FloatArray
    bootstrap_discount: FloatArray
    bootstrapped_value: FloatArray
    lengths: IntArray
    ended: npt.NDArray[np.bool_]
    returns: FloatArray
    one_reward: bool


def greedy_rollouts(
    potential: PairPotential, *, episodes: int, seed: int = 0, stream: str = "follow"
) -> GreedyRollouts:
    """Return what the greedy policy of a potential met in its task, ties broken at random.

    Parameters
    ----------
    potential : StateActionPotential or MappedPotential
    episodes : int
        How many, E; each is cut off at the task's time limit, or without one when a reward would
        weigh less than 1e-9.
    seed, stream : int, str
        Of the random stream, as in :func:`learn`.

    Raises
    ------
    SettingError
        When an episode has no bound, or 50 million steps might not do.

    Examples
    --------
    >>> from curricle import GridWorld, solve
    >>> maze = GridWorld("S.T", discount=0.5, time_limit=10)
    >>> phi = StateActionPotential(maze, solve(maze).action_values)
    >>> met = greedy_rollouts(phi, episodes=2)
    >>> met.states, met.predicted, met.return_to_go
    (array([0, 1, 0, 1]), array([ 98.5, 199. ,  98.5, 199. ]), array([ 98.5, 199. ,  98.5, 199. ]))
    """
    task = generative_model(potential.task)
    episodes = whole_number("episodes to follow", episodes, 1, SettingError)
    horizon = GreedyEvaluation().horizon(potential.task)
    if episodes * horizon > MOST_STEPS:
        raise SettingError(
            f"following {episodes:,} episodes of up to {horizon:,} steps must not exceed "
            f"{MOST_STEPS:,} steps in all: set a time limit or follow fewer"
        )
    size = episodes * horizon
    states, actions = np.empty(size, np.int64), np.empty(size, np.int64)
    predicted, rewards = np.empty(size), np.empty(size)
    return_to_go, bootstrap_discount, bootstrapped_value = (
        np.empty(size),
        np.empty(size),
        np.empty(size),
    )
    lengths, ended = np.empty(episodes, np.int64), np.empty(episodes, np.bool_)
    start = stream_start(seed, stream)
    with opened(task.model, start) as model:
        compiled(_follow, isinstance(model, Functions))(
            model,
            acting_view(potential),
            (task.discount, horizon),
            np.array([start], dtype=np.uint64),
            (states, actions, predicted, rewards),
            (return_to_go, bootstrap_discount, bootstrapped_value),
            (lengths, ended),
        )
    n, first = int(lengths.sum()), np.cumsum(lengths) - lengths
    return GreedyRollouts(
        states=frozen(states[:n].copy()),
        actions=frozen(actions[:n].copy()),
        predicted=frozen(predicted[:n].copy()),
        return_to_go=frozen(return_to_go[:n].copy()),
        bootstrap_discount=frozen(bootstrap_discount[:n].copy()),
        bootstrapped_value=frozen(bootstrapped_value[:n].copy()),
        lengths=frozen(lengths),
        ended=frozen(ended),
        returns=frozen(np.add.reduceat(rewards[:n], first)),
        one_reward=bool((rewards[:n] == rewards[0]).all()),
    )


def greedy_start(
    potential: PairPotential, evaluation: GreedyEvaluation, *, seed: int = 0, stream: str = ""
) -> float:
    """Return the expected return of a potential's greedy policy: where learning on it starts.

    The number that :func:`learn` writes down at step 0 when its Q starts as phi, for the same seed
    and stream.

    Examples
    --------
    >>> from curricle import GridWorld, solve
    >>> maze = GridWorld("S.T", discount=0.5)
    >>> greedy_start(StateActionPotential(maze, solve(maze).action_values), GreedyEvaluation())
    98.5
    """
    task = generative_model(potential.task)
    start = stream_start(seed, stream)
    settings = evaluation.settings(potential.task).for_run(start)
    users_code = isinstance(task.model, Functions) and not isinstance(settings, Exact)
    with opened(task.model, start) as model:
        return float(compiled(_judge, users_code)(settings, model, acting_view(potential)))


def acting_view(potential: PairPotential) -> Read | Acting:
    """Return a potential as the compiled loops act on it."""
    n_actions = generative_model(potential.task).actions.size
    if isinstance(potential, MappedPotential):
        return Read(potential.reading, np.empty(n_actions), np.empty((1, n_actions)))
    return Acting(potential.values[None], np.empty((0, n_actions)), 0.0, np.empty((1, n_actions)))


def _judge(settings, model, view):
    return greedy_return(settings, model, view)


def _follow(model, view, horizon, stream, steps, outlook, episodes):
    """Fill the arrays of :class:`GreedyRollouts`; `horizon` are the discount and the steps allowed."""
    discount, limit = horizon
    states, actions, predicted, rewards = steps
    return_to_go, bootstrap_discount, bootstrapped_value = outlook
    lengths, ended = episodes
    values, n = np.empty((1, view.values.shape[1])), 0
    for episode in range(lengths.shape[0]):
        first, state, over, cut = n, first_state(model, draw(stream)), False, False
        while not over and not cut and n - first < limit:
            bits = draw(stream)
            action = greedy_of(view, state, bits) & ACTION
            acting_row(view, state, values)
            states[n], actions[n], predicted[n] = state, action, values[0, action]
            state, rewards[n], over = transition(model, state, action, splitmix64(bits))
            cut = cut_short(model)
            n += 1
        lengths[episode], ended[episode] = n - first, over
        still, left, sum_of_rewards = 0.0, 0.0, 0.0
        if not over:
            acting_row(view, state, values)
            still, left = 1.0, values.max()
        for t in range(n - 1, first - 1, -1):
            sum_of_rewards, still = rewards[t] + discount * sum_of_rewards, discount * still
            return_to_go[t], bootstrap_discount[t], bootstrapped_value[t] = (
                sum_of_rewards,
                still,
                left,
            )
