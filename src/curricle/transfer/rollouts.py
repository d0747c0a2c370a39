"""The return of a potential's greedy policy, before anything is learnt, and of random ones.

Tasks with numbered states are rolled out in compiled loops, observation tasks in parallel
environments.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from curricle.arrays import FloatArray, IntArray, frozen
from curricle.checks import whole_number
from curricle.errors import SettingError
from curricle.learning.potential import PairPotential
from curricle.planning.greedy import Values
from curricle.planning.policy_evaluation import GreedyEvaluation, greedy_policy_return
from curricle.planning.target import BATCHES, ROLLOUTS, STANDARD_ERRORS, Estimated, Target
from curricle.tasks.kernel import splitmix64, stream_start
from curricle.tasks.live import is_live
from curricle.tasks.mdp import Task, available_actions, closed, generative_model
from curricle.tasks.observation_task import Observations, ObservationTask, check_observation, stack
from curricle.transfer.potential import ObservationPotential

LARGEST_ROLLED_OUT = 10_000_000  # most pairs (S x A) of a potential whose policy is rolled out
OBSERVATION_ROLLOUTS = 50  # default number of episodes for mean returns; side by side at most
RANDOM_ROLLOUTS = 200  # most episodes of random play where environments play
COVERAGE_EPISODES = 20  # episodes that give the sample of observations for coverage
STREAM = "potential_quality"  # name of the random stream of rollouts that judge a potential


# -- observations, in parallel environments --------------------------------------------------------

Policy = Callable[[Any, Sequence[int]], Any]
"""(n stacked observations, indices of their environments) -> n actions."""


@dataclass(frozen=True, eq=False)
class ObservationEpisode:
    """One episode of T steps."""

    rewards: FloatArray  # (T,)
    observations: list[Any]  # the T observations in which an action was taken


class Environments:
    """Environments of a task, one for each episode, in which a policy is rolled out in parallel."""

    def __init__(self, task: ObservationTask, episodes: int, max_steps: int):
        self.task, self.max_steps = task, max_steps
        self.environments = [task.environment() for _ in range(episodes)]

    def rollouts(self, policy: Policy, seed: int) -> list[ObservationEpisode]:
        """Return one episode of each environment; `seed` determines their first states."""
        n = len(self.environments)
        current = [
            environment.reset(seed=splitmix64(seed ^ k) >> 33)[0]
            for k, environment in enumerate(self.environments)
        ]
        check_observation(self.task.observations, current[0])
        rewards, observations = ([list[Any]() for _ in range(n)] for _ in range(2))
        terminated, truncated, running = [False] * n, [False] * n, list(range(n))
        for _ in range(self.max_steps):
            rows = [current[k] for k in running]
            actions = policy(stack(self.task.observations, rows), running)
            for k, row, action in zip(running, rows, actions, strict=True):
                step = self.environments[k].step(action)
                current[k], reward, terminated[k], truncated[k], _ = step
                rewards[k].append(float(reward))
                observations[k].append(row)
            running = [k for k in running if not (terminated[k] or truncated[k])]
            if not running:
                break
        return [*map(ObservationEpisode, map(np.array, rewards), observations)]

    def close(self) -> None:
        """Close the environments."""
        for environment in self.environments:
            environment.close()


def mean_episode_return(episodes: Iterable[ObservationEpisode], discount: float) -> float:
    """Return the mean discounted return of episodes."""
    return float(discounted([episode.rewards for episode in episodes], discount).mean())


def discounted(rewards: Sequence[FloatArray], discount: float) -> FloatArray:
    """Return the discounted sum of the rewards of each episode."""
    return np.array([episode @ discount ** np.arange(len(episode)) for episode in rewards])


def greedy_episodes(
    potential: ObservationPotential, episodes: int, seed: int = 0, stream: str = "greedy_rollouts"
) -> Iterator[ObservationEpisode]:
    """Yield episodes of a potential's greedy policy."""

    def policy(observations: Observations, _: Sequence[int]) -> IntArray:
        return np.asarray(potential.pairs(observations).argmax(axis=1))

    return _episodes(potential.task, policy, episodes, stream_start(seed, stream))


def random_episodes(
    task: ObservationTask, episodes: int, evaluation: GreedyEvaluation | None = None
) -> Iterator[ObservationEpisode]:
    """Yield episodes of a policy that samples its actions from the task's space."""
    start, space = stream_start(0, "random"), deepcopy(task.actions)
    space.seed(splitmix64(start) >> 33)

    def policy(_: object, running: Sequence[int]) -> list[Any]:
        return [space.sample() for _ in running]

    return _episodes(task, policy, episodes, start, evaluation)


def _episodes(
    task: ObservationTask,
    policy: Policy,
    episodes: int,
    start: int,
    evaluation: GreedyEvaluation | None = None,
) -> Iterator[ObservationEpisode]:
    episodes = whole_number("episodes of rollouts", episodes, 1, SettingError)
    horizon = (evaluation or GreedyEvaluation()).horizon(task)
    together = min(episodes, OBSERVATION_ROLLOUTS)
    with closing(Environments(task, together, horizon)) as environments:
        for first in range(0, episodes, together):
            # Environments' numbers are in the lower bits, so that all episodes begin differently.
            played = environments.rollouts(policy, start ^ first << 32)
            yield from played[: episodes - first]


# -- targets whose optimum is unknown --------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ObservationTarget:
    """A target whose optimum is unknown, in place of :class:`Target` for tasks with tables."""

    task: ObservationTask
    # Evaluated by rollouts, even if the learner's evaluation is exact: exact tables of the
    # environment have the same rewards, so that both returns are in the same units.
    evaluation: GreedyEvaluation
    solution: None = None
    optimum: float = float("nan")

    @property
    def random_return(self) -> float:
        """The mean return of the random policy."""
        return self.random.value

    @cached_property
    def random(self) -> Estimated:
        """The return of the random policy, its standard error, and the steps of its rollouts."""
        played = random_episodes(self.task, self.episodes, self.evaluation)
        rewards = [episode.rewards for episode in played]
        returns = discounted(rewards, self.evaluation.discount(self.task))
        spread = returns.std(ddof=1) if len(returns) > 1 else np.nan
        noise = float(spread / np.sqrt(len(returns)))
        return Estimated(float(returns.mean()), noise, sum(map(len, rewards)))

    @property
    def floor(self) -> float:
        """The random policy's return plus its noise; higher returns show learning."""
        return self.random_return + STANDARD_ERRORS * self.random.noise

    @property
    def floor_steps(self) -> int:
        """The steps of the rollouts that :attr:`floor` rests on."""
        return self.random.steps

    @property
    def episodes(self) -> int:
        """Number of episodes for mean returns."""
        return self.evaluation.episodes or OBSERVATION_ROLLOUTS

    def observations(self, potential: ObservationPotential) -> Observations:
        """Return stacked observations of greedy rollouts; of random ones without action values."""
        if potential.of_actions:
            rolled = greedy_episodes(potential, COVERAGE_EPISODES)
        else:
            rolled = random_episodes(self.task, COVERAGE_EPISODES)
        rows = [row for episode in rolled for row in episode.observations]
        stacked: Observations = stack(self.task.observations, rows)
        return stacked


def target_of(
    task: Task | ObservationTask,
    evaluation: GreedyEvaluation | None = None,
    *,
    episodes: int | None = None,
) -> Target | ObservationTarget:
    """Return a task with tables or observations as a target."""
    if not isinstance(task, ObservationTask):
        return Target.of(task, evaluation, episodes=ROLLOUTS if episodes is None else episodes)
    number = OBSERVATION_ROLLOUTS if episodes is None else episodes
    evaluation = replace(evaluation or GreedyEvaluation(), method="rollouts", episodes=number)
    return ObservationTarget(task, evaluation)


def random_play(
    task: Task | ObservationTask, evaluation: GreedyEvaluation
) -> tuple[Estimated, float]:
    """Return what the random policy returns in rollouts, and the noise of one evaluation of it.

    The rollouts are those of `BATCHES` evaluations, but at most 200 where environments play.
    """
    of_one, observed = evaluation.rollouts(task), isinstance(task, ObservationTask)
    played = observed or is_live(generative_model(task))
    episodes = min(BATCHES * of_one, RANDOM_ROLLOUTS if played else ROLLOUTS)
    part = replace(evaluation, method="rollouts", episodes=episodes)
    if isinstance(task, ObservationTask):
        random = ObservationTarget(task, part).random
    else:
        random = Target(task, part, None).random
    return random, random.noise * math.sqrt(episodes / of_one)


# -- the return of a potential's own policy --------------------------------------------------------


def potential_return(
    potential: PairPotential | ObservationPotential,
    target: Target | ObservationTarget,
    *,
    seed: int = 0,
) -> float:
    """Return what a potential's greedy policy returns in a target; NaN if it has none.

    That is the first return of :func:`learn` if Q starts at phi. There is none without action
    values, and none is computed for more than 10,000,000 pairs, as phi is read from an array.
    """
    if isinstance(target, ObservationTarget):
        assert isinstance(potential, ObservationPotential)
        if not potential.of_actions:
            return float("nan")
        episodes = greedy_episodes(potential, target.episodes, seed, STREAM)
        return mean_episode_return(episodes, target.evaluation.discount(target.task))
    assert not isinstance(potential, ObservationPotential)
    task = generative_model(potential.task)
    if task.states.size * task.actions.size > LARGEST_ROLLED_OUT:
        return float("nan")
    view = Values(frozen(closed(potential.values, available_actions(task))))
    return greedy_policy_return(potential.task, view, target.evaluation, seed=seed).value
