"""Learning a target by episodes in several tasks, and the teachers against their formulas."""

from fractions import Fraction
from functools import partial

import numpy as np
import pytest

import curricle as cr
from curricle.errors import SettingError, TaskError
from curricle.tasks import GoalDistance, with_start
from curricle.teaching import (
    Episode,
    Learnability,
    PrioritizedLevelReplay,
    ReverseCurriculum,
    Uniform,
    teach,
)
from curricle.teaching.teachers import drawn
from tests.refusals import cases, check_refusal, check_values
from tests.tasks import random_mdp

MAZE = cr.GridWorld(["S...PT", ".PP...", "......"], time_limit=50)
NEAR = with_start(MAZE, GoalDistance(1, 3))
BOTH = {"near": NEAR, "far": MAZE}


class Always:
    """Draws one task, and remembers the episodes."""

    def __init__(self, task):
        self.task, self.seen = task, []

    def start(self, n_tasks):
        return np.eye(n_tasks)[self.task]

    def update(self, memory, episode):
        self.seen.append(episode)
        return memory

    def probabilities(self, memory):
        return memory


class Recorder(Always):
    """Draws tasks in turn, and remembers the episodes."""

    def __init__(self):
        super().__init__(0)

    def update(self, memory, episode):
        return np.roll(super().update(memory, episode), 1)


class Failing(Always):
    """Raises an exception after its first episode."""

    def __init__(self, error):
        self.error = error
        super().__init__(0)

    def update(self, memory, episode):
        raise self.error


def test_tasks_are_played_by_their_own_rules():
    dear = cr.GridWorld(MAZE.map, time_limit=50, rewards=cr.Rewards(step=-7.0))
    cheap = cr.GridWorld(MAZE.map, time_limit=50, rewards=cr.Rewards(step=-2.0))
    teacher = Recorder()
    result = teach({"cheap": cheap, "dear": dear}, teacher, target="dear", budget=3000)
    np.testing.assert_array_equal(result.drawn[0], np.arange(len(result.drawn[0])) % 2)
    for number, episode in enumerate(teacher.seen):
        assert episode.task == number % 2
        assert set(episode.rewards[:-1]) == {-7.0 if episode.task else -2.0} or episode.length == 1
    lengths = [episode.length for episode in teacher.seen]
    np.testing.assert_array_equal(np.cumsum(lengths), result.begun_at[0][1:])


def test_a_success_is_an_end_in_the_goal():
    teacher = Recorder()
    teach(BOTH, teacher, target="far", budget=5000)
    last = [(episode.rewards[-1], episode.success) for episode in teacher.seen]
    assert {success for _, success in last} == {True, False}
    assert all(success == (reward > 100) for reward, success in last)


def chain(time_limit=10):
    """Return s0 -> s1 -> s2, where it ends; one action, rewards 1 and 2."""
    rows = [[[(1.0, 1, 1.0)]], [[(1.0, 2, 2.0)]], [[(1.0, 2, 0.0)]]]
    return cr.FiniteMDP.from_outcomes(
        rows, terminal=[False, False, True], start=0, discount=0.5, time_limit=time_limit
    )


@pytest.mark.parametrize("kind", [cr.QLearning, cr.SARSA])
def test_td_errors_are_those_of_the_values_at_the_time(kind):
    teacher, v = Recorder(), [0.0, 0.0]
    learner = kind(learning_rate=0.25)
    teach({"chain": chain()}, teacher, learner, target="chain", budget=12)
    assert len(teacher.seen) == 6 - (kind is cr.SARSA)  # who looks for the next one at the end
    for episode in teacher.seen:
        first = 1 + 0.5 * v[1] - v[0]
        v[0] += 0.25 * first
        second = 2 - v[1]
        v[1] += 0.25 * second
        np.testing.assert_array_equal(episode.td_errors, [first, second])


def test_values_are_zero_where_the_target_ends():
    open_maze = cr.GridWorld(MAZE.map, time_limit=50, ends={"treasure"})
    result = teach({"open": open_maze, "far": MAZE}, target="far", budget=5000)
    assert not result.learning.values[0][MAZE.mdp.terminal].any()
    assert result.learning.values[0].any()


def test_probabilities_are_those_of_the_episode_in_progress():
    result = teach(BOTH, Recorder(), target="far", budget=400, eval_freq=1)
    for step in range(400):
        episode = np.searchsorted(result.begun_at[0], step, side="right") - 1
        expected = np.eye(2)[episode % 2]
        np.testing.assert_array_equal(result.probabilities[0, step], expected)


def test_no_task_of_probability_0_is_drawn():
    chances = [0.0, 0.3, 0.999, np.nextafter(1.0, 0.0)]
    assert {drawn(np.array([0.0, 1.0, 0.0]), chance) for chance in chances} == {1}
    assert drawn(np.array([0.25, 0.75]), 0.25) == 1


def test_a_stopping_rule_is_judged_in_the_target():
    rule = cr.StoppingRule(30_000, threshold=100.0, patience=2)
    result = teach(BOTH, target="far", budget=rule, eval_freq=100, seeds=2).learning
    assert (result.steps_used < 30_000).all()
    for k, used in enumerate(result.steps_used // 100):
        assert (result.greedy_return[k, used - 1 : used + 1] >= 100.0).all()


@pytest.mark.parametrize("kind", [cr.QLearning, cr.SARSA])
@pytest.mark.parametrize("error", [ZeroDivisionError("mine"), KeyboardInterrupt()])
def test_what_a_teacher_raises_passes_through(kind, error):
    with pytest.raises(type(error)) as caught:
        teach(BOTH, Failing(error), kind(), target="far", budget=3000)
    assert caught.value is error


def test_padded_outcomes_are_never_taken():
    wide = random_mdp(3, width=3, time_limit=20)
    narrow = random_mdp(3, width=1, time_limit=20)
    alone = cr.learn(narrow, budget=2000)
    result = teach({"w": wide, "n": narrow}, Always(1), target="n", budget=2000)
    np.testing.assert_array_equal(result.learning.values, alone.values)


OTHER = cr.GridWorld(["S....T", ".PP...", "......"], time_limit=60)
NO_GOAL = cr.FiniteMDP.from_outcomes(
    [[[(1.0, 1, 1.0)]], [[(1.0, 0, 0.0)]]],
    terminal=[False, False],
    start=0,
    discount=0.5,
    time_limit=5,
)


def says(probabilities):
    teacher = Always(0)
    teacher.probabilities = lambda memory: probabilities
    return lambda: teach(BOTH, teacher, target="far", budget=100)


def with_third(task):
    return lambda: teach({**BOTH, "third": task}, target="far")


REFUSALS = {
    SettingError: {
        "states": (with_third(cr.GridWorld("S.T")), "share their states.*'third'"),
        "limit": (with_third(OTHER), "their time_limit: 'third' has 60 and 'far' has 50"),
        "no limit": (lambda: teach({"c": chain(None)}, target="c"), "a time limit: 'c' has none"),
        "learner": (
            lambda: teach(BOTH, None, cr.learning.OptimisticQLearning(), target="far"),
            "not by optimism",
        ),
        "sum": (says([0.5, 0.6]), "sum to 1: after 0 episodes"),
        "shape": (says([1.0]), "2 numbers from 0 up"),
        "bounds": (lambda: ReverseCurriculum(0.8, 0.2), "r_min .* got 0.8 and 0.2"),
    },
    TaskError: {
        "no goal": (
            lambda: teach({"n": NO_GOAL}, Learnability(), target="n"),
            "goal needs at least one state.*task 'n'",
        )
    },
}


@pytest.mark.parametrize(("error", "call", "says"), cases(REFUSALS))
def test_refusals(error, call, says):
    check_refusal(error, call, says)


def test_wrong_values_are_named():
    wrong = {"target": ["x"], "teacher": [3, Learnability], "learner": ["Q"]}
    check_values(SettingError, lambda **of: teach(BOTH, **{"target": "far"} | of), wrong)
    check_values(SettingError, partial(teach, target="far"), {"tasks": [{}, [MAZE], {1: MAZE}]})
    check_values(SettingError, Learnability, {"rho": [2.0], "window": [0]})
    check_values(SettingError, cr.teaching.PrioritizedLevelReplay, {"temperature": [0.0]})


def test_tasks_without_a_goal_are_for_teachers_that_need_none():
    result = teach({"n": NO_GOAL}, PrioritizedLevelReplay(), target="n", budget=100)
    assert result.learning.steps_used == 100


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


@pytest.mark.parametrize(
    "teacher",
    [Uniform(), Learnability(), PrioritizedLevelReplay(), ReverseCurriculum()],
    ids=lambda teacher: type(teacher).__name__,
)
def test_no_teacher_changes_what_it_remembers(teacher):
    memory = teacher.start(N_TASKS)
    for episode in episodes(0, 20):
        before = teacher.probabilities(memory).copy()
        after = teacher.update(memory, episode)
        np.testing.assert_array_equal(teacher.probabilities(memory), before)
        memory = after
