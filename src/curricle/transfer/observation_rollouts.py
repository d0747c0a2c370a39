"""Rollouts of observation tasks, side by side with one call of the policy a step; targets."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from curricle.arrays import FloatArray, frozen
from curricle.learning.potential_rollouts import GreedyRollouts, rollout_size
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.planning.target import ROLLOUTS, STANDARD_ERRORS, Target
from curricle.tasks.draws import splitmix64, stream_start
from curricle.tasks.observation_task import ObservationTask, is_observation_task, stack
from curricle.transfer.potentials import ObservationPotential

Policy = Callable[[Any, Sequence[int]], tuple[Any, Any]]
"""n stacked observations, and the environments they are of -> n actions, and predicted values."""
OBSERVATION_ROLLOUTS = 50
"""Episodes of which returns are the mean, unless another number is given."""
COVERAGE_EPISODES = 20
"""Episodes whose observations are the sample for a mapping's coverage."""


@dataclass(frozen=True, eq=False)
class ObservationEpisode:
    """One episode of T steps."""

    rewards: FloatArray  # (T,)
    predicted: FloatArray  # (T,) as the policy returned it
    terminated: bool  # rather than truncated
    last_observation: Any
    observations: list[Any]  # T of them: those in which an action was taken


class Environments:
    """As many environments of a task as `episodes`, in which a policy is rolled out side by side.

    Each episode is truncated after `max_steps` in any case.
    """

    def __init__(self, task: ObservationTask, episodes: int, max_steps: int):
        self.task, self.max_steps = task, max_steps
        self.environments = [task.environment() for _ in range(episodes)]

    def rollouts(self, policy: Policy, seed: int) -> list[ObservationEpisode]:
        """Return one episode of each environment; `seed` decides where each begins."""
        n = len(self.environments)
        current = [
            environment.reset(seed=splitmix64(seed ^ k) >> 33)[0]
            for k, environment in enumerate(self.environments)
        ]
        rewards, predicted, observations = ([list[Any]() for _ in range(n)] for _ in range(3))
        terminated, running = [False] * n, list(range(n))
        for _ in range(self.max_steps):
            rows = [current[k] for k in running]
            actions, values = policy(stack(self.task.observations, rows), running)
            still_running = []
            for k, row, action, value in zip(running, rows, actions, values, strict=True):
                current[k], reward, terminated[k], truncated, _ = self.environments[k].step(action)
                rewards[k].append(float(reward))
                predicted[k].append(value)
                observations[k].append(row)
                if not (terminated[k] or truncated):
                    still_running.append(k)
            running = still_running
            if not running:
                break
        return [
            ObservationEpisode(np.array(r), np.array(p, float), *others)
            for r, p, *others in zip(
                rewards, predicted, terminated, current, observations, strict=True
            )
        ]

    def close(self) -> None:
        """Close the environments."""
        for environment in self.environments:
            environment.close()


def episode_returns(episodes: Sequence[ObservationEpisode], discount: float) -> FloatArray:
    """Return the discounted sum of rewards of each episode."""
    sums = [episode.rewards @ discount ** np.arange(len(episode.rewards)) for episode in episodes]
    return np.array(sums)


def mean_episode_return(episodes: Sequence[ObservationEpisode], discount: float) -> float:
    """Return the mean of these."""
    return float(episode_returns(episodes, discount).mean())


def greedy_episodes(
    potential: ObservationPotential,
    *,
    episodes: int,
    seed: int = 0,
    stream: str = "greedy_rollouts",
    max_steps: int | None = None,
) -> list[ObservationEpisode]:
    """Return episodes of a potential's greedy policy, which predicts phi(s_t, a_t).

    Those of the first `max_steps` steps, if it is given; the last is truncated there.
    """

    def policy(observations: Any, _: Sequence[int]) -> tuple[Any, Any]:
        phi = potential.pairs(observations)
        actions = phi.argmax(axis=1)
        return actions, phi[np.arange(len(phi)), actions]

    start = stream_start(seed, stream)
    found = _episodes(potential.task, policy, episodes, start, max_steps)
    return found if max_steps is None else list(_first_steps(found, max_steps))


def _first_steps(found: Sequence[ObservationEpisode], n: int) -> Iterator[ObservationEpisode]:
    """Yield the episodes of the first n steps; one that goes on is truncated there."""
    for episode in found:
        if n == 0:
            return
        if len(episode.rewards) > n:
            yield ObservationEpisode(
                episode.rewards[:n],
                episode.predicted[:n],
                terminated=False,
                last_observation=episode.observations[n],
                observations=episode.observations[:n],
            )
            return
        yield episode
        n -= len(episode.rewards)


def random_episodes(
    task: ObservationTask, *, episodes: int, seed: int = 0
) -> list[ObservationEpisode]:
    """Return episodes of a policy that samples its actions from the task's space."""
    start, space = stream_start(seed, "random"), deepcopy(task.actions)
    space.seed(splitmix64(start) >> 33)

    def policy(_: Any, running: Sequence[int]) -> tuple[Any, Any]:
        return [space.sample() for _ in running], np.zeros(len(running))

    return _episodes(task, policy, episodes, start)


def _episodes(
    task: ObservationTask, policy: Policy, episodes: int, start: int, max_steps: int | None = None
) -> list[ObservationEpisode]:
    with closing(Environments(task, *rollout_size(task, episodes, max_steps))) as environments:
        return environments.rollouts(policy, start)


def greedy_observation_rollouts(
    potential: ObservationPotential,
    *,
    episodes: int,
    seed: int = 0,
    stream: str = "greedy_rollouts",
    max_steps: int | None = None,
) -> GreedyRollouts:
    """Return greedy rollouts of a potential as :func:`greedy_rollouts` does.

    ``states`` and ``actions`` are empty, as states are not numbered.
    """
    found = greedy_episodes(
        potential, episodes=episodes, seed=seed, stream=stream, max_steps=max_steps
    )
    columns = zip(*(_returns_to_go(episode, potential) for episode in found), strict=True)
    return_to_go, bootstrap_discount, bootstrapped_value = map(np.concatenate, columns)
    rewards = np.concatenate([episode.rewards for episode in found])
    empty = frozen(np.zeros(0, np.int64))
    return GreedyRollouts(
        states=empty,
        actions=empty,
        predicted=frozen(np.concatenate([episode.predicted for episode in found])),
        return_to_go=frozen(return_to_go),
        bootstrap_discount=frozen(bootstrap_discount),
        bootstrapped_value=frozen(bootstrapped_value),
        lengths=frozen(np.array([len(episode.rewards) for episode in found])),
        ended=frozen(np.array([episode.terminated for episode in found])),
        returns=frozen(np.array([episode.rewards.sum() for episode in found])),
        one_reward=bool((rewards == rewards[0]).all()),
    )


def _returns_to_go(
    episode: ObservationEpisode, potential: ObservationPotential
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return per step the return to go, the bootstrap's discount and the bootstrapped value."""
    task, n = potential.task, len(episode.rewards)
    return_to_go, total = np.empty(n), 0.0
    for t in range(n - 1, -1, -1):
        total = episode.rewards[t] + task.discount * total
        return_to_go[t] = total
    if episode.terminated:
        return return_to_go, np.zeros(n), np.zeros(n)
    value = float(potential.v(stack(task.observations, [episode.last_observation]))[0])
    return return_to_go, task.discount ** np.arange(n, 0, -1.0), np.full(n, value)


@dataclass(frozen=True, eq=False)
class ObservationTarget:
    """A target whose optimum is unknown; as :class:`Target` is for tasks with tables.

    Its `evaluation` is by rollouts, also where that of its learner is exact: tables of the
    environment pay its own rewards, so that both are in the same units.
    """

    task: ObservationTask
    evaluation: GreedyEvaluation
    solution: None = None
    typical_reward: float = float("nan")
    optimum: float = float("nan")

    @cached_property
    def _random_returns(self) -> FloatArray:
        found = random_episodes(self.task, episodes=self.episodes)
        return episode_returns(found, self.evaluation.discount(self.task))

    @property
    def random_return(self) -> float:
        """The mean return of the random policy."""
        return float(self._random_returns.mean())

    @property
    def floor(self) -> float:
        """The return above which something was learnt: the random policy's and its noise."""
        noise = self._random_returns.std(ddof=1) / np.sqrt(self.episodes)
        return self.random_return + STANDARD_ERRORS * float(noise)

    @property
    def episodes(self) -> int:
        """Episodes of which returns are the mean."""
        return self.evaluation.episodes or OBSERVATION_ROLLOUTS

    def observations(self, potential: ObservationPotential) -> Any:
        """Return stacked observations of greedy rollouts, of random ones without action values."""
        if potential.of_actions:
            found = greedy_episodes(potential, episodes=COVERAGE_EPISODES)
        else:
            found = random_episodes(self.task, episodes=COVERAGE_EPISODES)
        rows = [row for episode in found for row in episode.observations]
        return stack(self.task.observations, rows)


def target_of(
    task: Any, evaluation: GreedyEvaluation | None = None, *, episodes: int | None = None
) -> Target | ObservationTarget:
    """Return a task of either kind as a target.

    Where returns are not exact, they are the mean of `episodes` rollouts: by default 1000, or 50 of
    a task with observations.
    """
    if not is_observation_task(task):
        return Target.of(task, evaluation, episodes=ROLLOUTS if episodes is None else episodes)
    given = GreedyEvaluation() if evaluation is None else evaluation
    number = OBSERVATION_ROLLOUTS if episodes is None else episodes
    return ObservationTarget(task, replace(given, method="rollouts", episodes=number))
