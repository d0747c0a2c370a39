"""Learning a target by a network, from episodes in several tasks that a teacher draws."""

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import curricle as cr
from curricle.deep import DeepLearner, learn_deep, taught_training, teach_deep, training
from curricle.deep.learner import SAVES
from curricle.errors import SettingError, TaskError
from curricle.tasks import GoalDistance, with_start
from curricle.teaching import (
    TSCL,
    PrioritizedLevelReplay,
    ReverseCurriculum,
    TrueRegret,
    teach,
)
from tests.refusals import cases, check_refusal

from .worlds import one_hot, table_potential

MAZE = cr.GridWorld(["..T", ".#.", "S.."], time_limit=30, rewards=cr.Rewards(treasure=10))
NEAR = with_start(MAZE, GoalDistance(1))
TASKS = {"near": one_hot(NEAR), "far": one_hot(MAZE)}
NET = {"policy_kwargs": {"net_arch": [16]}}
DQN = DeepLearner(
    "DQN", settings={**NET, "learning_starts": 20, "train_freq": 4, "learning_rate": 1e-3}
)
PPO = DeepLearner("PPO", envs=3, settings={**NET, "n_steps": 20, "batch_size": 30, "n_epochs": 2})
CURVES = ("steps", "greedy_return", "training_return", "episodes", "steps_used")


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


def parts(values):
    return [values.parameters()[name] for name in sorted(values.parameters())]


def assert_same_learning(one, other):
    for name in CURVES:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    for mine, yours in zip(one.values, other.values, strict=True):
        for a, b in zip(parts(mine), parts(yours), strict=True):
            np.testing.assert_array_equal(a, b)


def assert_same(one, other):
    assert_same_learning(one.learning, other.learning)
    np.testing.assert_array_equal(one.steps_per_task, other.steps_per_task)
    np.testing.assert_array_equal(one.probabilities, other.probabilities)
    for name in ("drawn", "begun_at"):
        for a, b in zip(getattr(one, name), getattr(other, name), strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("learner", [DQN, PPO], ids=str)
@pytest.mark.parametrize("shaped", [False, True])
def test_always_the_target_is_plain_learning_bit_for_bit(learner, shaped):
    shaping = None
    if shaped:
        phi = table_potential(MAZE, TASKS["far"], cr.solve(MAZE).action_values / 2)
        shaping = cr.StateShaping(phi)
    settings = {"eval_freq": 100, "seeds": [4, 1], "shaping": shaping, "stream": "x"}
    alone = learn_deep(TASKS["far"], learner, 300, **settings)
    found = teach_deep(TASKS, Always(1), learner, 300, target="far", **settings)
    assert_same_learning(found.learning, alone)
    np.testing.assert_array_equal(found.steps_per_task, [[0, 300], [0, 300]])


@pytest.mark.parametrize("learner", [DQN, PPO], ids=str)
@pytest.mark.parametrize("teacher", [TSCL(), PrioritizedLevelReplay()], ids=repr)
def test_what_was_drawn_adds_up(learner, teacher):
    found = teach_deep(TASKS, teacher, learner, 600, target="far", seeds=2, eval_freq=50)
    learning = found.learning
    assert found.tasks == ("near", "far")
    assert found.teacher == teacher
    np.testing.assert_array_equal(found.steps_per_task.sum(axis=1), learning.steps_used)
    assert (found.steps_per_task.sum(axis=0) > 0).all()
    np.testing.assert_allclose(found.probabilities.sum(axis=2), 1)
    assert found.counts.shape == found.probabilities.shape == (2, 13, 2)
    for k in range(2):
        assert (np.diff(found.begun_at[k]) >= 0).all()
        assert found.begun_at[k][0] == 0
        begun, ended = len(found.drawn[k]), learning.episodes_used[k]
        assert 0 <= begun - ended <= learner.envs
    alone = teach_deep(TASKS, teacher, learner, 600, target="far", seeds=[1], eval_freq=50)
    np.testing.assert_array_equal(alone.drawn[0], found.drawn[1])
    np.testing.assert_array_equal(alone.learning.greedy_return[0], learning.greedy_return[1])


def test_the_greedy_policy_is_evaluated_in_the_target_alone():
    found = teach_deep(TASKS, Always(0), DQN, 300, target="far", eval_freq=100)
    assert found.steps_per_task.tolist() == [[300, 0]]
    alone = learn_deep(TASKS["far"], DQN, 300, eval_freq=100)
    # before learning the network is the same, and so is its return in the target
    assert found.learning.greedy_return[0, 0] == alone.greedy_return[0, 0]
    assert found.learning.task == TASKS["far"]


def test_replay_goes_by_the_errors_of_the_networks_values(monkeypatch):
    seen = []
    update = PrioritizedLevelReplay.update
    monkeypatch.setattr(
        PrioritizedLevelReplay,
        "update",
        lambda self, memory, episode: seen.append(episode) or update(self, memory, episode),
    )
    teach_deep(TASKS, PrioritizedLevelReplay(), PPO, 300, target="far")
    assert seen
    assert all(len(episode.td_errors) == episode.length for episode in seen)
    # V is the network's: no error is the reward alone
    assert all(not np.array_equal(e.td_errors, e.rewards) for e in seen)


def unpicklable(tasks):
    """Return tasks whose environments cannot be pickled."""

    def make(task):
        environment = task.make()
        environment.unwrapped.generator = (number for number in range(9))
        return environment

    return {
        name: cr.tasks.ObservationTask(lambda task=task: make(task), task.discount)
        for name, task in tasks.items()
    }


@pytest.mark.parametrize("learner", [DQN, PPO], ids=str)
@pytest.mark.parametrize("whole_environments", [True, False])
def test_a_killed_run_goes_on(tmp_path, monkeypatch, learner, whole_environments):
    tasks = TASKS if whole_environments else unpicklable(TASKS)
    settings = {"target": "far", "eval_freq": 100, "seeds": [2]}
    teacher = PrioritizedLevelReplay()
    whole = teach_deep(tasks, teacher, learner, 360, **settings)
    saved, save = [], training.Recorder._save

    def killed(recorder):
        save(recorder)
        saved.append(recorder.progress.steps)
        raise KeyboardInterrupt

    monkeypatch.setattr(training.Recorder, "_save", killed)
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            teach_deep(tasks, teacher, learner, 360, **settings, saves=tmp_path)
    monkeypatch.setattr(training.Recorder, "_save", save)
    assert 0 < saved[0] < saved[1] < 360
    assert saved[0] >= 360 // SAVES
    again = teach_deep(tasks, teacher, learner, 360, **settings, saves=tmp_path)
    if whole_environments:
        assert_same(again, whole)
    assert again.steps_per_task.sum() == again.learning.steps_used == 360
    once_more = teach_deep(tasks, teacher, learner, 360, **settings, saves=tmp_path)
    assert_same(once_more, again)


def test_a_checkpoint_of_another_teacher_is_refused(tmp_path):
    settings = {"target": "far", "saves": tmp_path}
    teach_deep(TASKS, TSCL(), DQN, 100, **settings)
    with pytest.raises(cr.errors.StoreError, match="belongs to one run"):
        teach_deep(TASKS, TSCL(epsilon=0.2), DQN, 100, **settings)


def test_returns_of_tasks_are_logged():
    seen = {}

    class Look(taught_training.BaseCallback):
        def _on_step(self):
            seen.update(self.logger.name_to_value)
            return True

    learner = DeepLearner("PPO", settings={**NET, "n_steps": 64}, callbacks=lambda: [Look()])
    teach_deep(TASKS, None, learner, 400, target="far")
    assert {f"curriculum/{name}/ep_rew_mean" for name in TASKS} <= set(seen)


@pytest.mark.parametrize(
    ("error", "call", "says"),
    cases(
        {
            SettingError: {
                "target": (lambda: teach_deep(TASKS, target="x"), "one of near, far: got 'x'"),
                "one": (
                    lambda: teach_deep({"far": TASKS["far"]}, target="far"),
                    "two tasks or more",
                ),
                "tables": (
                    lambda: teach_deep({"near": NEAR, "far": MAZE}, target="far"),
                    "through observations: 'near' is",
                ),
                "exact": (
                    lambda: teach_deep(TASKS, TrueRegret(), target="far"),
                    "without exact values",
                ),
                "learner": (
                    lambda: teach_deep(TASKS, None, cr.QLearning(), target="far"),
                    "learner must be a DeepLearner",
                ),
                "no success": (
                    lambda: teach_deep(TASKS, ReverseCurriculum(), DQN, 200, target="far"),
                    "needs successes, by info",
                ),
                "seeds": (lambda: teach_deep(TASKS, target="far", seeds=0), "seeds must be"),
            },
            TaskError: {
                "teach": (lambda: teach(TASKS, target="far"), "no tables, teach_deep takes it"),
            },
        }
    ),
)
def test_refusals(error, call, says):
    check_refusal(error, call, says)
