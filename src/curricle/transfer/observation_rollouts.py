"""Playing tasks seen through observations: episodes side by side, one call of the policy a step."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector.utils import concatenate, create_empty_array

from curricle.checks import whole_number
from curricle.errors import SettingError
from curricle.learning.potential_rollouts import MOST_STEPS, GreedyRollouts
from curricle.learning.run import stream_start
from curricle.planning.evaluation import NEGLIGIBLE, GreedyEvaluation
from curricle.tasks.draws import splitmix64_number
from curricle.tasks.observation_task import ObservationTask, batch_size
from curricle.tasks.spaces import frozen
from curricle.transfer.observation_potential import ObservationPotential

FloatArray = npt.NDArray[np.float64]
Act = Callable[[Any], tuple[Any, Any]]
"""n stacked observations -> their actions, and a number noted down for each."""


@dataclass(frozen=True, eq=False)
class Episode:
    """One episode of T steps.

    Attributes
    ----------
    rewards, noted : (T,) float64
    ended : bool
        Whether it reached an end, instead of being cut off.
    last : observation
        The one it ended in.
    seen : list of T observations
        Those acted in.
    """

    rewards: FloatArray
    noted: FloatArray
    ended: bool
    last: Any
    seen: list[Any]


class Stage:
    """Environments of a task in which episodes are played side by side.

    Parameters
    ----------
    task : ObservationTask
    episodes : int
        How many, E.
    longest : int
        Steps after which an episode is cut off in any case.

    Examples
    --------
    >>> from curricle import observation_task
    >>> stage = Stage(observation_task("MountainCar-v0"), episodes=2, longest=200)
    >>> left = stage.play(lambda cars: (np.zeros(len(cars), dtype=int), cars[:, 0]), seed=0)
    >>> [float(episode.rewards.sum()) for episode in left], left[0].ended
    ([-200.0, -200.0], False)
    """

    def __init__(self, task: ObservationTask, episodes: int, longest: int):
        self.task, self.longest = task, longest
        self.environments = [task.environment() for _ in range(episodes)]

    def play(self, act: Act, seed: int) -> list[Episode]:
        """Return the episodes that a policy plays; `seed` decides where each begins."""
        space, n = self.task.observations, len(self.environments)
        here = [
            environment.reset(seed=splitmix64_number(seed ^ k) >> 33)[0]
            for k, environment in enumerate(self.environments)
        ]
        rewards, noted, seen = ([list[Any]() for _ in range(n)] for _ in range(3))
        ended, going = [False] * n, list(range(n))
        for _ in range(self.longest):
            rows = [here[k] for k in going]
            room: Any = create_empty_array(space, len(rows))
            stacked = concatenate(space, rows, room)
            actions, notes = act(stacked)
            left = []
            for k, row, action, note in zip(going, rows, actions, notes, strict=True):
                here[k], reward, ended[k], cut, _ = self.environments[k].step(action)
                rewards[k].append(float(reward))
                noted[k].append(note)
                seen[k].append(row)
                if not (ended[k] or cut):
                    left.append(k)
            going = left
            if not going:
                break
        parts = zip(rewards, noted, ended, here, seen, strict=True)
        return [Episode(np.array(r), np.array(p, float), *others) for r, p, *others in parts]

    def close(self) -> None:
        """Close the environments."""
        for environment in self.environments:
            environment.close()


def longest_episode(task: ObservationTask, *, discounted: bool = True) -> int:
    """Return the steps after which an episode is cut off, or adds nothing to speak of.

    Examples
    --------
    >>> from curricle import observation_task
    >>> longest_episode(observation_task("MountainCar-v0"))
    200
    """
    if task.longest is not None:
        return task.longest
    if not discounted or task.discount == 1:
        raise SettingError(f"undiscounted returns need a task with a time limit: {task} has none")
    return int(np.ceil(np.log(NEGLIGIBLE) / np.log(max(task.discount, NEGLIGIBLE))))


def stage_for(task: ObservationTask, evaluation: GreedyEvaluation) -> Stage:
    """Return where the policies of a task are judged; SettingError if it cannot be done exactly."""
    if evaluation.method == "exact":
        raise SettingError("a task seen through observations is judged by rollouts: got 'exact'")
    longest = longest_episode(task, discounted=evaluation.discounted)
    return Stage(task, evaluation.rollouts(task), longest)


def mean_return(episodes: list[Episode], discount: float) -> float:
    """Return the mean over episodes of their discounted sums of rewards."""
    sums = [episode.rewards @ discount ** np.arange(len(episode.rewards)) for episode in episodes]
    return float(np.mean(sums))


def greedy_episodes(
    potential: ObservationPotential, *, episodes: int, seed: int = 0, stream: str = "follow"
) -> list[Episode]:
    """Return episodes of a potential's greedy policy, phi(s_t, a_t) noted at each step.

    Parameters
    ----------
    potential : ObservationPotential
        That tells actions apart.
    episodes, seed, stream
        As in :func:`greedy_rollouts`.

    Examples
    --------
    >>> from curricle import observation_task
    >>> from curricle.transfer import FunctionValues
    >>> car = observation_task("MountainCar-v0")
    >>> along = FunctionValues(lambda cars, acts: np.sign(cars[:, 1:]) * (acts - 1.0), actions=3)
    >>> met, = greedy_episodes(ObservationPotential.of(car, along), episodes=1)
    >>> met.ended, len(met.seen) == len(met.noted)
    (True, True)
    """

    def act(observations: Any) -> tuple[Any, Any]:
        pairs = potential.pairs(observations)
        actions = pairs.argmax(axis=1)
        return actions, pairs[np.arange(len(pairs)), actions]

    return _episodes(potential.task, act, episodes, stream_start(seed, stream))


def random_episodes(task: ObservationTask, *, episodes: int, seed: int = 0) -> list[Episode]:
    """Return episodes of actions that its space draws, every one alike.

    Examples
    --------
    >>> from curricle import observation_task
    >>> met = random_episodes(observation_task("CartPole-v1"), episodes=2)
    >>> [episode.ended for episode in met]
    [True, True]
    """
    start, space = stream_start(seed, "random"), deepcopy(task.actions)
    space.seed(splitmix64_number(start) >> 33)

    def act(observations: Any) -> tuple[Any, Any]:
        n = batch_size(observations)
        return [space.sample() for _ in range(n)], np.zeros(n)

    return _episodes(task, act, episodes, start)


def observations_met(task: ObservationTask, episodes: list[Episode]) -> Any:
    """Return the observations acted in, stacked as the task's space stacks them."""
    rows = [row for episode in episodes for row in episode.seen]
    room: Any = create_empty_array(task.observations, len(rows))
    return concatenate(task.observations, rows, room)


def _episodes(task: ObservationTask, act: Act, episodes: int, start: int) -> list[Episode]:
    episodes = whole_number("episodes to follow", episodes, 1, SettingError)
    longest = longest_episode(task)
    if episodes * longest > MOST_STEPS:
        raise SettingError(
            f"following {episodes:,} episodes of up to {longest:,} steps must not exceed "
            f"{MOST_STEPS:,} steps in all: set a time limit or follow fewer"
        )
    stage = Stage(task, episodes, longest)
    met = stage.play(act, start)
    stage.close()
    return met


def greedy_observation_rollouts(
    potential: ObservationPotential, *, episodes: int, seed: int = 0, stream: str = "follow"
) -> GreedyRollouts:
    """Return what the greedy policy of a potential met in its task, as :func:`greedy_rollouts` does.

    ``states`` and ``actions`` are empty: there are no numbers of states.

    Parameters
    ----------
    potential : ObservationPotential
        That tells actions apart.
    episodes, seed, stream
        As in :func:`greedy_rollouts`.

    Examples
    --------
    >>> from curricle import observation_task
    >>> from curricle.transfer import FunctionValues
    >>> car = observation_task("MountainCar-v0")
    >>> along = FunctionValues(lambda cars, acts: np.sign(cars[:, 1:]) * (acts - 1.0), actions=3)
    >>> met = greedy_observation_rollouts(ObservationPotential.of(car, along), episodes=3)
    >>> met.ended, bool(met.returns.max() > -200)
    (array([ True,  True,  True]), True)
    """
    met = greedy_episodes(potential, episodes=episodes, seed=seed, stream=stream)
    outlook = [_outlook(episode, potential) for episode in met]
    return_to_go, bootstrap_discount, bootstrapped_value = (
        np.concatenate(each) for each in zip(*outlook, strict=True)
    )
    rewards = np.concatenate([episode.rewards for episode in met])
    none = frozen(np.zeros(0, np.int64))
    return GreedyRollouts(
        states=none,
        actions=none,
        predicted=frozen(np.concatenate([episode.noted for episode in met])),
        return_to_go=frozen(return_to_go),
        bootstrap_discount=frozen(bootstrap_discount),
        bootstrapped_value=frozen(bootstrapped_value),
        lengths=frozen(np.array([len(episode.rewards) for episode in met])),
        ended=frozen(np.array([episode.ended for episode in met])),
        returns=frozen(np.array([episode.rewards.sum() for episode in met])),
        one_reward=bool((rewards == rewards[0]).all()),
    )


def _outlook(
    episode: Episode, potential: ObservationPotential
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return per step what was earned from it on, and what lies beyond a cut: weight and value."""
    task, n = potential.task, len(episode.rewards)
    return_to_go, still = np.empty(n), 0.0
    for t in range(n - 1, -1, -1):
        still = episode.rewards[t] + task.discount * still
        return_to_go[t] = still
    if episode.ended:
        return return_to_go, np.zeros(n), np.zeros(n)
    one: Any = create_empty_array(task.observations, 1)
    value = float(potential.v(concatenate(task.observations, [episode.last], one))[0])
    return return_to_go, task.discount ** np.arange(n, 0, -1.0), np.full(n, value)
