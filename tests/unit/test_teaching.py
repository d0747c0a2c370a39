"""Learning a target by episodes in several tasks: what teachers see, and what is refused."""

from functools import partial

import numpy as np
import pytest

import curricle as cr
from curricle.errors import SettingError, TaskError
from curricle.tasks import GoalDistance, with_start
from curricle.teaching import TSCL, Learnability, ReverseCurriculum, teach
from curricle.teaching.teachers import drawn
from tests.refusals import cases, check_refusal, check_values
from tests.tasks import random_mdp

MAZE = cr.GridWorld(["S...PT", ".PP...", "......"], time_limit=50)
NEAR = with_start(MAZE, GoalDistance(1, 3))
BOTH = {"near": NEAR, "far": MAZE}


class Recorder:
    """Draws tasks in turn, and remembers the episodes."""

    def __init__(self):
        self.seen = []

    def start(self, n_tasks):
        return np.eye(n_tasks)[0]

    def update(self, memory, episode):
        self.seen.append(episode)
        return np.roll(memory, 1)

    def probabilities(self, memory):
        return memory


class Always:
    """Draws one task."""

    def __init__(self, task):
        self.task = task

    def start(self, n_tasks):
        return np.eye(n_tasks)[self.task]

    def update(self, memory, episode):
        return memory

    def probabilities(self, memory):
        return memory


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
    found = teach({"cheap": cheap, "dear": dear}, teacher, target="dear", budget=3000)
    np.testing.assert_array_equal(found.drawn[0], np.arange(len(found.drawn[0])) % 2)
    for number, episode in enumerate(teacher.seen):
        assert episode.task == number % 2
        assert set(episode.rewards[:-1]) == {-7.0 if episode.task else -2.0} or episode.length == 1
    lengths = [episode.length for episode in teacher.seen]
    np.testing.assert_array_equal(np.cumsum(lengths), found.begun_at[0][1:])


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
    found = teach({"open": open_maze, "far": MAZE}, target="far", budget=5000)
    assert not found.learning.values[0][MAZE.mdp.terminal].any()
    assert found.learning.values[0].any()


def test_probabilities_are_those_of_the_episode_in_progress():
    found = teach(BOTH, Recorder(), target="far", budget=400, eval_freq=1)
    for step in range(400):
        episode = np.searchsorted(found.begun_at[0], step, side="right") - 1
        expected = np.eye(2)[episode % 2]
        np.testing.assert_array_equal(found.probabilities[0, step], expected)


def test_no_task_of_probability_0_is_drawn():
    chances = [0.0, 0.3, 0.999, np.nextafter(1.0, 0.0)]
    assert {drawn(np.array([0.0, 1.0, 0.0]), chance) for chance in chances} == {1}
    assert drawn(np.array([0.25, 0.75]), 0.25) == 1


def test_a_stopping_rule_is_judged_in_the_target():
    rule = cr.StoppingRule(30_000, threshold=100.0, patience=2)
    found = teach(BOTH, target="far", budget=rule, eval_freq=100, seeds=2).learning
    assert (found.steps_used < 30_000).all()
    for k, used in enumerate(found.steps_used // 100):
        assert (found.greedy_return[k, used - 1 : used + 1] >= 100.0).all()


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
    found = teach({"w": wide, "n": narrow}, Always(1), target="n", budget=2000)
    np.testing.assert_array_equal(found.learning.values, alone.values)


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


@pytest.mark.parametrize(
    ("error", "call", "says"),
    cases(
        {
            SettingError: {
                "states": (
                    lambda: teach({**BOTH, "s": cr.GridWorld("S.T")}, target="far"),
                    "share their states.*'s'",
                ),
                "limit": (
                    lambda: teach({**BOTH, "o": OTHER}, target="far"),
                    "share their time_limit: 'o' has 60 and 'far' has 50",
                ),
                "no limit": (
                    lambda: teach({"c": chain(None)}, target="c"),
                    "need a time limit: 'c' has none",
                ),
                "learner": (
                    lambda: teach(BOTH, None, cr.learning.OptimisticQLearning(), target="far"),
                    "not by a start",
                ),
                "sum": (says([0.5, 0.6]), "sum to 1: after 0 episodes"),
                "shape": (says([1.0]), "2 numbers from 0 up"),
                "bounds": (lambda: ReverseCurriculum(0.8, 0.2), "r_min .* got 0.8 and 0.2"),
            },
            TaskError: {
                "no goal": (
                    lambda: teach({"n": NO_GOAL}, Learnability(), target="n"),
                    "goal needs at least one state.*task 'n'",
                ),
            },
        }
    ),
)
def test_refusals(error, call, says):
    check_refusal(error, call, says)


def test_wrong_values_are_named():
    wrong = {"target": ["x"], "teacher": [3, TSCL], "learner": ["Q"]}
    check_values(SettingError, lambda **of: teach(BOTH, **{"target": "far"} | of), wrong)
    check_values(SettingError, partial(teach, target="far"), {"tasks": [{}, [MAZE], {1: MAZE}]})
    check_values(SettingError, TSCL, {"epsilon": [2.0]})
    check_values(SettingError, Learnability, {"window": [0]})
    check_values(SettingError, cr.teaching.PrioritizedLevelReplay, {"temperature": [0.0]})


def test_tasks_without_a_goal_are_for_teachers_that_need_none():
    found = teach({"n": NO_GOAL}, TSCL(), target="n", budget=100)
    assert found.learning.steps_used == 100
