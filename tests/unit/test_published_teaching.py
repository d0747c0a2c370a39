"""Teachers of published claims against their formulas, and learning by the starts they draw."""

from fractions import Fraction

import numpy as np
import pytest

import curricle as cr
from benchmarks.published.teaching import (
    Episode,
    Learnability,
    PrioritizedLevelReplay,
    ReverseCurriculum,
    Uniform,
    teach,
)
from curricle.tasks import GoalDistance, with_start

MAZE = cr.GridWorld(["S...PT", ".PP...", "......"], time_limit=50)
NEAR = with_start(MAZE, GoalDistance(1, 3))
EXACT = cr.GreedyEvaluation(method="exact")


class InTurn(Uniform):
    """Draws tasks in turn, and remembers the episodes."""

    def __init__(self):
        self.seen = []

    def start(self, n_tasks):
        return np.eye(n_tasks)[0]

    def update(self, memory, episode):
        self.seen.append(episode)
        return np.roll(memory, 1)


def taught(tasks, teacher, budget, *, learner=None, target=MAZE, seeds=(0,), eval_freq=None):
    named = {str(i): task for i, task in enumerate(tasks)}
    how = {"seeds": seeds, "eval_freq": eval_freq or budget // 10, "evaluation": EXACT}
    return teach(named, target, teacher, learner or cr.QLearning(), budget, **how)


@pytest.mark.parametrize("evaluation", [EXACT, cr.GreedyEvaluation(method="rollouts", episodes=7)])
def test_starts_of_the_target_are_plain_learning_bit_for_bit(evaluation):
    how = {"seeds": [2, 7], "eval_freq": 30, "evaluation": evaluation}
    alone = cr.learn(MAZE, cr.QLearning(), 1500, **how)
    result = teach({"all": MAZE}, MAZE, Uniform(), cr.QLearning(), 1500, **how)
    np.testing.assert_array_equal(result.greedy_return, alone.greedy_return)
    for k in range(2):
        np.testing.assert_array_equal(result.results[k].values[0], alone.values[k])


def test_a_teacher_draws_the_start_of_every_episode_and_learns_how_it_ended():
    teacher = InTurn()
    result = taught([NEAR, MAZE], teacher, 5000)
    np.testing.assert_array_equal(result.drawn[0], np.arange(len(result.drawn[0])) % 2)
    assert [episode.task for episode in teacher.seen] == list(result.drawn[0][:-1])
    last = [(episode.rewards[-1], episode.success) for episode in teacher.seen]
    assert {success for _, success in last} == {True, False}
    assert all(success == (reward > 100) for reward, success in last)
    steps = sum(len(episode.rewards) for episode in teacher.seen)
    assert 5000 - 50 <= steps <= 5000 == result.results[0].steps_used[0]


def test_td_errors_are_those_of_the_values_at_the_time():
    rows = [[[(1.0, 1, 1.0)]], [[(1.0, 2, 2.0)]], [[(1.0, 2, 0.0)]]]  # s0 -> s1 -> s2, the end
    chain = cr.FiniteMDP.from_outcomes(
        rows, terminal=[False, False, True], start=0, discount=0.5, time_limit=10
    )
    teacher, v = InTurn(), [0.0, 0.0]
    taught([chain], teacher, 12, learner=cr.QLearning(learning_rate=0.25), target=chain)
    assert len(teacher.seen) == 6
    for episode in teacher.seen:
        first = 1 + 0.5 * v[1] - v[0]
        v[0] += 0.25 * first
        second = 2 - v[1]
        v[1] += 0.25 * second
        np.testing.assert_array_equal(episode.td_errors, [first, second])


# -- formulas --------------------------------------------------------------------------------------

N_TASKS = 4
CASES = [(seed, n) for seed in range(4) for n in (0, 1, 2, 3, 8, 60)]


def episodes(seed, n):
    """Return n random episodes; some tasks may never be among them."""
    rng = np.random.default_rng(seed)
    drawn = []
    for _ in range(n):
        task, length = int(rng.integers(N_TASKS)), int(rng.integers(1, 6))
        rewards, errors = rng.normal(size=length), rng.normal(size=length)
        drawn.append(Episode(task, rewards, errors, bool(rng.random() < (task + 1) / 5), 0.9))
    return drawn


def probabilities(teacher, seen):
    memory = teacher.start(N_TASKS)
    for episode in seen:
        memory = teacher.update(memory, episode)
    return teacher.probabilities(memory)


def uniform_over(tasks):
    return np.array([1 / len(tasks) if i in tasks else 0.0 for i in range(N_TASKS)])


def rates(seen, window):
    """Return the share of successes among the last `window` episodes of each task."""
    outcomes = [[e.success for e in seen if e.task == i][-window:] for i in range(N_TASKS)]
    return [np.mean(successes) if successes else 0.0 for successes in outcomes]


@pytest.mark.parametrize(("seed", "n"), CASES)
@pytest.mark.parametrize("top", [1, 2, 9])
def test_learnability_prefers_successes_by_halves(seed, n, top):
    seen = episodes(seed, n)
    rate = [Fraction(p).limit_denominator(6) for p in rates(seen, 6)]
    learnability = [p * (1 - p) for p in rate]  # exact: 1/3 and 2/3 are tied
    last = sorted(learnability, reverse=True)[:top][-1]
    best = [i for i in range(N_TASKS) if learnability[i] >= last]
    expected = 0.7 * uniform_over(best) + 0.3 / N_TASKS
    result = probabilities(Learnability(rho=0.7, top=top, window=6), seen)
    np.testing.assert_allclose(result, expected)


@pytest.mark.parametrize(("seed", "n"), CASES)
def test_replay_ranks_value_losses_and_adds_staleness(seed, n):
    seen = episodes(seed, n)
    latest = {e.task: (number, e) for number, e in enumerate(seen, 1)}
    score = {}
    for task, (_, e) in latest.items():
        length = len(e.td_errors)
        advantages = [
            sum((0.9 * 0.8) ** (k - t) * e.td_errors[k] for k in range(t, length))
            for t in range(length)
        ]
        score[task] = np.mean(np.abs(advantages))
    ranked = sorted(score, key=score.get, reverse=True)
    by_score = np.array([1 / (ranked.index(i) + 1) ** 2 if i in score else 0 for i in range(4)])
    by_age = np.array([float(n - latest[i][0]) if i in score else 0 for i in range(4)])
    unseen = [i for i in range(N_TASKS) if i not in score]
    expected = np.zeros(N_TASKS)
    if score:
        by_score = by_score / by_score.sum()
        by_age = by_age / by_age.sum() if by_age.any() else by_score
        expected = (0.7 * by_score + 0.3 * by_age) * len(score) / N_TASKS
    if unseen:
        expected = expected + uniform_over(unseen) * len(unseen) / N_TASKS
    teacher = PrioritizedLevelReplay(temperature=0.5, staleness=0.3, gae_lambda=0.8)
    np.testing.assert_allclose(probabilities(teacher, seen), expected)


@pytest.mark.parametrize(("seed", "n"), CASES)
def test_the_reverse_curriculum_expands_from_the_goal(seed, n):
    seen = episodes(seed, n)
    p, known = rates(seen, 5), {e.task for e in seen}
    old = [i for i in range(N_TASKS) if i in known and p[i] >= 0.2]
    new = [i for i in range(N_TASKS) if p[i] <= 0.7 and (i == 0 or i - 1 in old)]
    if old and new:
        expected = 0.25 * uniform_over(old) + 0.75 * uniform_over(new)
    else:
        expected = uniform_over(old or new)
    teacher = ReverseCurriculum(r_min=0.2, r_max=0.7, replay=0.25, window=5)
    np.testing.assert_allclose(probabilities(teacher, seen), expected)
