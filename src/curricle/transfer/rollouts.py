"""Greedy rollouts of a potential: its prediction at each step, and the return that follows.

They calibrate a potential, or measure its errors, before anything is learnt. Tasks with numbered
states are rolled out in compiled loops, observation tasks in parallel environments.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from curricle.arrays import BoolArray, FloatArray, Frozen, IntArray, frozen
from curricle.checks import whole_number
from curricle.errors import SettingError
from curricle.learning.potential import PairPotential
from curricle.learning.value_lookup import ValueLookup, read_row
from curricle.planning.greedy import (
    Values,
    acting_row,
    acting_rows,
    best_of,
    greedy_actions,
    highest,
)
from curricle.planning.policy_evaluation import (
    ROLLOUTS,
    STANDARD_ERRORS,
    GreedyEvaluation,
    Target,
    greedy_policy_return,
)
from curricle.planning.rollouts import EpisodeEnds, GreedyPolicy, StepRecord, simulate
from curricle.tasks.kernel import compiled, splitmix64, stream_start
from curricle.tasks.live import open_model
from curricle.tasks.mdp import (
    availability,
    available_actions,
    closed,
    generative_model,
    live_pairs,
    reachable_states,
    tables,
)
from curricle.tasks.models import close_row
from curricle.tasks.observation_task import ObservationTask, is_observation_task, stack
from curricle.text import brief_repr
from curricle.transfer.potential import ObservationPotential

LARGEST_ARRAY = 1_000_000
"""Most pairs (S x A) of a potential that is read from an array, even if it can be looked up."""
MOST_STEPS = 50_000_000  # most steps to record (2.4 GB)
OBSERVATION_ROLLOUTS = 50  # default number of episodes for mean returns
COVERAGE_EPISODES = 20  # episodes that give the sample of observations for coverage
MAX_RANKED = 200_000  # most pairs for a rank correlation; a sample if there are more
STREAM = "potential_quality"  # name of the random stream of rollouts that judge a potential
NAN = float("nan")


@dataclass(frozen=True, eq=False)
class GreedyRollouts(Frozen):
    """E greedy episodes with n steps in all, and what the potential predicts at each step."""

    states: IntArray  # (n,); empty like actions if states are not numbered
    actions: IntArray  # (n,)
    predicted: FloatArray  # (n,) phi(s_t, a_t)
    return_to_go: FloatArray  # (n,) discounted rewards from step t to the end of its episode
    bootstrap_discount: FloatArray  # (n,) gamma^(steps to the end) if truncated, 0 if terminated
    bootstrapped_value: FloatArray  # (n,) max_a phi of the last state if truncated, else 0
    lengths: IntArray  # (E,) steps of each episode
    ended: BoolArray  # (E,) whether each episode terminated
    returns: FloatArray  # (E,) undiscounted sum of rewards of each episode
    one_reward: bool  # whether every step had the same reward

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            object.__setattr__(self, name, frozen(value) if name != "one_reward" else value)


def greedy_rollouts(
    potential: PairPotential | ObservationPotential,
    *,
    episodes: int,
    seed: int = 0,
    stream: str = "greedy_rollouts",
    max_steps: int | None = None,
) -> GreedyRollouts:
    """Return episodes of a potential's greedy policy in its task, at most `max_steps` in all."""
    if isinstance(potential, ObservationPotential):
        seen = greedy_episodes(potential, episodes, seed, stream, max_steps)
        return _of_episodes(potential, seen)
    if not isinstance(potential, PairPotential):
        raise SettingError(f"rollouts need a potential of state-action pairs: got {potential!r}")
    task = generative_model(potential.task)
    episodes, horizon = rollout_size(potential.task, episodes, max_steps)
    start, view = stream_start(seed, stream), acting_view(potential)
    draws = np.array([start], dtype=np.uint64)
    with open_model(task, start) as model:
        steps, ends = simulate(model, GreedyPolicy(view), draws, episodes=episodes, limit=horizon)
    if max_steps is not None:
        steps, ends = _first_of(steps, ends, max_steps)
    first = np.cumsum(ends.lengths) - ends.lengths
    predicted, *following = (np.empty(len(steps.states)) for _ in range(4))
    compiled(_predict, False)(view, task.discount, steps, ends, predicted, tuple(following))
    return_to_go, bootstrap_discount, bootstrapped_value = following
    return GreedyRollouts(
        states=steps.states,
        actions=steps.actions,
        predicted=predicted,
        return_to_go=return_to_go,
        bootstrap_discount=bootstrap_discount,
        bootstrapped_value=bootstrapped_value,
        lengths=ends.lengths,
        ended=ends.terminated,
        returns=np.add.reduceat(steps.rewards, first),
        one_reward=bool((steps.rewards == steps.rewards[0]).all()),
    )


def _first_of(steps: StepRecord, ends: EpisodeEnds, n: int) -> tuple[StepRecord, EpisodeEnds]:
    """Return the first n steps; the episode that exceeds them is truncated there."""
    after = np.cumsum(ends.lengths)
    if after[-1] <= n:
        return steps, ends
    last = int(np.searchsorted(after, n))
    cut = EpisodeEnds(*(array[: last + 1].copy() for array in ends))  # type: ignore[arg-type]
    if after[last] > n:
        cut.lengths[last] -= after[last] - n
        cut.last_states[last] = steps.states[n]
        cut.terminated[last] = cut.truncated[last] = False
    return StepRecord(steps.states[:n], steps.actions[:n], steps.rewards[:n]), cut


def rollout_size(task: Any, episodes: int, max_steps: int | None = None) -> tuple[int, int]:
    """Return the number of episodes and the most steps of each; SettingError if too many."""
    episodes = whole_number("episodes of rollouts", episodes, 1, SettingError)
    horizon = GreedyEvaluation().horizon(task)
    horizon = horizon if max_steps is None else min(horizon, max_steps)
    if episodes * horizon > MOST_STEPS:
        raise SettingError(
            f"rollouts of {episodes:,} episodes of up to {horizon:,} steps must not exceed "
            f"{MOST_STEPS:,} steps in all: set a time limit or ask for fewer"
        )
    return episodes, horizon


# -- numbered states, in compiled loops ------------------------------------------------------------


class LookedUp(NamedTuple):
    """A potential that is looked up in its sources' values, as compiled loops read it."""

    lookup: ValueLookup
    row: FloatArray  # (A,) work space
    values: FloatArray  # (1, A) work space
    available: Any  # as of :func:`availability`


@acting_rows.body(LookedUp)
def _looked_up_row(view, state, out):
    read_row(view.lookup, state, view.row)
    for action in range(out.shape[1]):
        out[0, action] = view.row[action]
    close_row(view.available, state, out, 0)


@greedy_actions.body(LookedUp)
def _greedy_looked_up(view, state, bits):
    acting_row(view, state, view.values)
    return best_of(view.values, 0, bits)[1]


def greedy_start(potential: PairPotential, evaluation: GreedyEvaluation, *, seed: int = 0) -> float:
    """Return the greedy policy's return: the first return of :func:`learn` if Q starts at phi."""
    return greedy_policy_return(potential.task, acting_view(potential), evaluation, seed=seed)


def acting_view(potential: PairPotential) -> LookedUp | Values:
    """Return a potential as compiled loops read it: an array, or a lookup if that is too large."""
    task = generative_model(potential.task)
    n_actions, kernel = task.actions.size, potential.kernel
    if kernel is not None and task.states.size * n_actions > LARGEST_ARRAY:
        row, values = np.empty(n_actions), np.empty((1, n_actions))
        return LookedUp(kernel, row, values, availability(task))
    return Values(frozen(closed(potential.values, available_actions(task))))


def _predict(view, discount, steps, ends, predicted, following):
    """Write phi and the return to go of each step; arrays as in :class:`GreedyRollouts`."""
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


# -- observations, in parallel environments --------------------------------------------------------

Policy = Callable[[Any, Sequence[int]], tuple[Any, Any]]
"""(n stacked observations, indices of their environments) -> (n actions, n predicted values)."""


@dataclass(frozen=True, eq=False)
class ObservationEpisode:
    """One episode of T steps."""

    rewards: FloatArray  # (T,)
    predicted: FloatArray  # (T,) as returned by the policy
    terminated: bool  # rather than truncated
    last_observation: Any
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
        rewards, predicted, observations = ([list[Any]() for _ in range(n)] for _ in range(3))
        terminated, truncated, running = [False] * n, [False] * n, list(range(n))
        for _ in range(self.max_steps):
            rows = [current[k] for k in running]
            actions, values = policy(stack(self.task.observations, rows), running)
            for k, row, action, value in zip(running, rows, actions, values, strict=True):
                step = self.environments[k].step(action)
                current[k], reward, terminated[k], truncated[k], _ = step
                rewards[k].append(float(reward))
                predicted[k].append(value)
                observations[k].append(row)
            running = [k for k in running if not (terminated[k] or truncated[k])]
            if not running:
                break
        columns = map(np.array, rewards), (np.array(values, float) for values in predicted)
        return [*map(ObservationEpisode, *columns, terminated, current, observations)]

    def close(self) -> None:
        """Close the environments."""
        for environment in self.environments:
            environment.close()


def episode_returns(episodes: Sequence[ObservationEpisode], discount: float) -> FloatArray:
    """Return the discounted sum of rewards of each episode."""
    sums = [episode.rewards @ discount ** np.arange(len(episode.rewards)) for episode in episodes]
    return np.array(sums)


def mean_episode_return(episodes: Sequence[ObservationEpisode], discount: float) -> float:
    """Return the mean discounted return of episodes."""
    return float(episode_returns(episodes, discount).mean())


def greedy_episodes(
    potential: ObservationPotential,
    episodes: int,
    seed: int = 0,
    stream: str = "greedy_rollouts",
    max_steps: int | None = None,
) -> list[ObservationEpisode]:
    """Return episodes of a potential's greedy policy, which predicts phi(s_t, a_t)."""

    def policy(observations: Any, _: Sequence[int]) -> tuple[Any, Any]:
        phi = potential.pairs(observations)
        actions = phi.argmax(axis=1)
        return actions, phi[np.arange(len(phi)), actions]

    start = stream_start(seed, stream)
    rolled = _episodes(potential.task, policy, episodes, start, max_steps)
    return rolled if max_steps is None else list(_first_steps(rolled, max_steps))


def _first_steps(rolled: Sequence[ObservationEpisode], n: int) -> Iterator[ObservationEpisode]:
    """Yield the episodes of the first n steps; the episode that exceeds them is truncated."""
    for episode in rolled:
        if 0 < n < len(episode.rewards):
            yield replace(
                episode,
                rewards=episode.rewards[:n],
                predicted=episode.predicted[:n],
                terminated=False,
                last_observation=episode.observations[n],
                observations=episode.observations[:n],
            )
        elif n > 0:
            yield episode
        n -= len(episode.rewards)


def random_episodes(
    task: ObservationTask, episodes: int, seed: int = 0
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


def _of_episodes(
    potential: ObservationPotential, episodes: Sequence[ObservationEpisode]
) -> GreedyRollouts:
    """Return greedy episodes with their predictions and returns to go."""
    task, columns = potential.task, []
    for episode in episodes:
        n, total, value = len(episode.rewards), 0.0, 0.0
        return_to_go, bootstrap_discount = np.empty(n), np.zeros(n)
        for t in range(n - 1, -1, -1):
            total = episode.rewards[t] + task.discount * total
            return_to_go[t] = total
        if not episode.terminated:
            value = float(potential.v(stack(task.observations, [episode.last_observation]))[0])
            bootstrap_discount = task.discount ** np.arange(n, 0, -1.0)
        columns.append((return_to_go, bootstrap_discount, np.full(n, value)))
    joined = map(np.concatenate, zip(*columns, strict=True))
    return_to_go, bootstrap_discount, bootstrapped_value = joined
    rewards = np.concatenate([episode.rewards for episode in episodes])
    return GreedyRollouts(
        states=np.zeros(0, np.int64),
        actions=np.zeros(0, np.int64),
        predicted=np.concatenate([episode.predicted for episode in episodes]),
        return_to_go=return_to_go,
        bootstrap_discount=bootstrap_discount,
        bootstrapped_value=bootstrapped_value,
        lengths=np.array([len(episode.rewards) for episode in episodes]),
        ended=np.array([episode.terminated for episode in episodes]),
        returns=np.array([episode.rewards.sum() for episode in episodes]),
        one_reward=bool((rewards == rewards[0]).all()),
    )


# -- targets whose optimum is unknown --------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ObservationTarget:
    """A target whose optimum is unknown, in place of :class:`Target` for tasks with tables."""

    task: ObservationTask
    # Evaluated by rollouts, even if the learner's evaluation is exact: exact tables of the
    # environment have the same rewards, so that both returns are in the same units.
    evaluation: GreedyEvaluation
    solution: None = None
    typical_reward: float = float("nan")
    optimum: float = float("nan")

    @cached_property
    def _random_returns(self) -> FloatArray:
        rolled = random_episodes(self.task, self.episodes)
        return episode_returns(rolled, self.evaluation.discount(self.task))

    @property
    def random_return(self) -> float:
        """The mean return of the random policy."""
        return float(self._random_returns.mean())

    @property
    def floor(self) -> float:
        """The random policy's return plus its noise; higher returns show learning."""
        noise = self._random_returns.std(ddof=1) / np.sqrt(self.episodes)
        return self.random_return + STANDARD_ERRORS * float(noise)

    @property
    def episodes(self) -> int:
        """Number of episodes for mean returns."""
        return self.evaluation.episodes or OBSERVATION_ROLLOUTS

    def observations(self, potential: ObservationPotential) -> Any:
        """Return stacked observations of greedy rollouts; of random ones without action values."""
        if potential.of_actions:
            rolled = greedy_episodes(potential, COVERAGE_EPISODES)
        else:
            rolled = random_episodes(self.task, COVERAGE_EPISODES)
        rows = [row for episode in rolled for row in episode.observations]
        return stack(self.task.observations, rows)


def target_of(
    task: Any, evaluation: GreedyEvaluation | None = None, *, episodes: int | None = None
) -> Target | ObservationTarget:
    """Return a task with tables or observations as a target."""
    if not is_observation_task(task):
        return Target.of(task, evaluation, episodes=ROLLOUTS if episodes is None else episodes)
    number = OBSERVATION_ROLLOUTS if episodes is None else episodes
    evaluation = replace(evaluation or GreedyEvaluation(), method="rollouts", episodes=number)
    return ObservationTarget(task, evaluation)


# -- the errors of a potential ---------------------------------------------------------------------


@dataclass(frozen=True)
class PotentialQuality:
    """Comparison of a potential with the values of its target."""

    start: float  # expected return of its greedy policy: where learning starts
    optimistic: float  # share of pairs (s, a) with phi > Q*
    excess: float  # mean of phi - Q*
    mean_absolute_value: float  # mean abs(V*), the scale of an excess
    rank: float  # Spearman's correlation of phi and Q*; NaN if phi or Q* does not vary
    # The largest min(V*, 0) - max_a phi over the states that optimal policies visit: how far phi
    # lies below both V* and an initial value of 0. Learning avoids such a state, and so does not
    # correct its value. NaN unless exact.
    largest_underestimate: float = NAN
    most_underestimated_state: int = -1  # that state; -1 if there is none
    # True: phi is compared with Q*. False: with the returns to go of greedy rollouts, which are
    # at most Q*, over the steps of the rollouts.
    exact: bool = False


def potential_quality(
    potential: PairPotential | ObservationPotential,
    target: Target | ObservationTarget,
    *,
    seed: int = 0,
) -> PotentialQuality:
    """Return the comparison of a potential with the values of its target."""
    roll = partial(greedy_rollouts, potential, seed=seed, stream=STREAM)
    if isinstance(target, ObservationTarget):
        if not potential.of_actions:
            return PotentialQuality(NAN, NAN, NAN, NAN, NAN)
        rollouts = roll(episodes=target.episodes)
        first = np.cumsum(rollouts.lengths) - rollouts.lengths
        discounted = target.evaluation.discounted
        returns = rollouts.return_to_go[first] if discounted else rollouts.returns
        return _by_rollouts(rollouts, float(returns.mean()), seed)
    assert not isinstance(potential, ObservationPotential)
    start = greedy_start(potential, target.evaluation, seed=seed)
    if target.solution is None:
        rollouts = roll(episodes=target.evaluation.rollouts(target.task))
        return _by_rollouts(rollouts, start, seed)
    mdp = tables(target.task)
    alive, solution = ~mdp.terminal, target.solution
    pairs = live_pairs(target.task)
    phi, q = potential.values[pairs], solution.finite_action_values[pairs]
    below = np.minimum(solution.values, 0.0) - potential.values.max(axis=1)
    below[~(reachable_states(mdp, solution.optimal) & alive)] = 0.0
    state = int(below.argmax())
    underestimate, state = (float(below[state]), state) if below[state] > 0 else (0.0, -1)
    return PotentialQuality(
        start=start,
        # Differences within the proven error of Q* count as 0.
        optimistic=float((phi > q + solution.error_bound).mean()),
        excess=float((phi - q).mean()),
        mean_absolute_value=float(abs(solution.values[alive]).mean()),
        rank=_rank_correlation(phi, q, seed),
        largest_underestimate=underestimate,
        most_underestimated_state=state,
        exact=True,
    )


def _by_rollouts(rollouts: GreedyRollouts, start: float, seed: int) -> PotentialQuality:
    """Return the comparison with the returns to go; `start` is the greedy policy's mean return."""
    return_to_go = rollouts.return_to_go + rollouts.bootstrap_discount * rollouts.bootstrapped_value
    return PotentialQuality(
        start=start,
        optimistic=float((rollouts.predicted > return_to_go).mean()),
        excess=float((rollouts.predicted - return_to_go).mean()),
        mean_absolute_value=float(abs(return_to_go).mean()),
        rank=_rank_correlation(rollouts.predicted, return_to_go, seed),
    )


def _rank_correlation(phi: FloatArray, truth: FloatArray, seed: int) -> float:
    """Return Spearman's rank correlation, of a sample if there are many pairs."""
    if phi.size > MAX_RANKED:
        drawn = np.random.default_rng(seed).choice(phi.size, MAX_RANKED, False, shuffle=False)
        phi, truth = phi[drawn], truth[drawn]
    if not (np.ptp(phi) > 0 and np.ptp(truth) > 0):
        return NAN
    return float(np.corrcoef(_ranks(phi), _ranks(truth))[0, 1])


def _ranks(values: FloatArray) -> FloatArray:
    """Return the rank of each value from 1 on, the mean of their ranks for equal values."""
    # SciPy's rankdata is the same, but importing scipy.stats takes half a second.
    _, which, counts = np.unique(values, return_inverse=True, return_counts=True)
    return np.asarray((np.cumsum(counts) - (counts - 1) / 2)[which])
