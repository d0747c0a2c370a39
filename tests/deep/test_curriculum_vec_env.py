"""Teachers for vector environments: episodes, seeds, copies, logs, and what is refused."""

import pickle
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

pytest.importorskip("stable_baselines3")

import cloudpickle
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

import curricle as cr
from curricle.deep import CurriculumVecEnv, NetworkValues
from curricle.errors import SettingError
from curricle.tasks import task_family
from curricle.teaching import (
    TSCL,
    Learnability,
    PrioritizedLevelReplay,
    ReverseCurriculum,
    Uniform,
)

from .walks import (
    LENGTHS,
    TASKS,
    Always,
    Recorder,
    Walk,
    actions,
    assert_same,
    curriculum,
    played,
    walk,
)

torch.set_num_threads(1)
EASY = [Uniform(), TSCL(), Learnability(), PrioritizedLevelReplay(), ReverseCurriculum()]


# -- episodes ------------------------------------------------------------------------------------


@given(st.integers(1, 3), st.sampled_from([*LENGTHS]), st.integers(1, 7), st.integers(0, 99))
@settings(max_examples=25, deadline=None)
def test_with_one_task_drawn_it_is_dummyvecenv_bit_for_bit(n, target, limit, seed):
    # DummyVecEnv copies terminal observations too late for an array that is used again
    tasks = {name: walk(length, limit, reuse=False) for name, length in LENGTHS.items()}
    teacher = Always([*LENGTHS].index(target))
    venv = CurriculumVecEnv(tasks, teacher, target=target, envs=n)
    alone = DummyVecEnv([lambda: Monitor(tasks[target].environment())] * n)
    assert_same(played(venv, seed=seed), played(alone, seed=seed), but=["task"])
    assert venv.render_mode == alone.render_mode


@pytest.mark.parametrize("teacher", EASY, ids=repr)
def test_each_step_is_of_the_task_it_names(teacher):
    venv, ends = curriculum(teacher, envs=3), {"terminated": 0, "truncated": 0}
    venv.seed(0)
    before, going = venv.reset(), [info["task"] for info in venv.reset_infos]
    for action in actions(3, 400):
        observations, rewards, dones, infos = venv.step(action)
        for i, info in enumerate(infos):
            assert info["task"] == going[i]
            last = info.get("terminal_observation", observations[i])
            assert last[0] == LENGTHS[going[i]]  # from the episode's own task
            assert last[2] == before[i][2] + 1
            assert ("terminal_observation" in info) == dones[i]
            if dones[i]:
                terminated = last[1] == LENGTHS[going[i]] - 1
                assert info["TimeLimit.truncated"] == (not terminated)
                assert rewards[i] == terminated
                assert info["episode"]["l"] == last[2]
                ends["terminated" if terminated else "truncated"] += 1
                going[i] = venv.reset_infos[i]["task"]
                assert observations[i][0] == LENGTHS[going[i]]
                assert observations[i][2] == 0
        before = observations
    assert min(ends.values()) > 20


def test_steps_episodes_and_returns_are_counted_by_task():
    venv, steps, episodes, returns = curriculum(envs=3), {}, {}, {}
    found = played(venv, 300)
    for first in found[0][3]:
        episodes[first["task"]] = episodes.get(first["task"], 0) + 1
    for _, _, dones, infos in found[1:]:
        for done, info in zip(dones, infos, strict=True):
            steps[info["task"]] = steps.get(info["task"], 0) + 1
            if done:
                returns.setdefault(info["task"], []).append(info["episode"]["r"])
    assert venv.steps_per_task.tolist() == [steps[name] for name in TASKS]
    assert venv.steps_per_task.sum() == 900
    means = [np.mean(returns[name][-100:]) for name in TASKS]
    np.testing.assert_allclose(venv.mean_returns, means)
    assert venv.counts.sum() == sum(map(len, returns.values())) + 3


def test_uniform_draws_each_task_as_often():
    venv = curriculum(Uniform(), envs=4)
    played(venv, 1500)
    n = venv.counts.sum()
    assert n > 1000
    assert abs(venv.counts / n - 1 / 3).max() < 4 * np.sqrt(2 / 9 / n)  # 4 standard errors
    np.testing.assert_allclose(venv.probabilities, 1 / 3)


def test_the_teacher_sees_all_that_ended_in_a_step_before_it_draws():
    teacher = Recorder()
    venv = curriculum(teacher, envs=2, tasks={"a": walk(9, 4), "b": walk(9, 4)}, target="a")
    venv.seed(0)
    venv.reset()
    for _ in range(4):
        venv.step([0, 0])
    assert len(teacher.seen) == 2  # memory went on by two tasks before the first draw
    assert venv.record.sampler.tasks == [0, 0, 0, 0]
    assert venv.record.sampler.begun_at == [0, 0, 8, 8]


def test_episodes_are_what_the_teacher_sees():
    teacher = Recorder()
    venv = curriculum(teacher, envs=1)
    found = played(venv)
    ended = [info for step in found[1:] for info in step[3] if "episode" in info]
    assert len(teacher.seen) == len(ended) > 10
    for episode, info in zip(teacher.seen, ended, strict=True):
        assert [*TASKS][episode.task] == info["task"]
        assert episode.length == info["episode"]["l"]
        assert episode.rewards.sum() == info["episode"]["r"]
        assert episode.success == (not info["TimeLimit.truncated"])
        assert episode.discount == 0.9
        assert episode.td_errors is None
    with pytest.raises(SettingError, match="computed from the tasks' tables"):
        episode.greedy_returns()


class Known:
    """V by the place and the length of a walk."""

    def v(self, observations):
        return observations[:, 0] * 10 + observations[:, 1]


def test_td_errors_are_those_of_the_values_given():
    teacher = Recorder()
    venv = curriculum(teacher, envs=1)
    venv.values = Known()
    found = played(venv)
    path, number, kinds = [found[0][0][0]], 0, set()
    for seen, _, dones, (info,) in found[1:]:
        path.append(info.get("terminal_observation", seen[0]))
        if dones[0]:
            episode, v = teacher.seen[number], Known().v(np.array(path))
            v[-1] *= info["TimeLimit.truncated"]
            kinds.add(info["TimeLimit.truncated"])
            expected = episode.rewards + 0.9 * v[1:] - v[:-1]
            if not info["TimeLimit.truncated"]:
                expected[-1] = episode.rewards[-1] - v[-2]
            np.testing.assert_allclose(episode.td_errors, expected, rtol=1e-5)
            path, number = [seen[0]], number + 1
    assert kinds == {True, False}


def test_replay_goes_by_regret_where_there_are_no_values():
    teacher = PrioritizedLevelReplay(temperature=1.0, staleness=0.0)
    memory = teacher.start(2)
    for task, reward in ((0, 1.0), (1, 5.0), (1, 2.0), (0, 0.5)):
        one = cr.teaching.Episode(task, np.array([reward]), None, False, 0.9)
        memory = teacher.update(memory, one)
    np.testing.assert_allclose(memory.score, [0.5, 3.0])
    np.testing.assert_allclose(teacher.probabilities(memory), [1 / 3, 2 / 3])


@pytest.mark.parametrize(
    ("success", "expected"),
    [(1.0, {True, False}), (0.0, {True}), (lambda info: info["episode"]["l"] < 3, {True, False})],
)
def test_a_success_is_what_the_user_says(success, expected):
    teacher = Recorder()
    venv = curriculum(teacher, success=success)
    played(venv)
    wanted = (lambda e: e.length < 3) if callable(success) else lambda e: e.rewards.sum() >= success
    assert {episode.success for episode in teacher.seen} == expected
    assert all(episode.success == wanted(episode) for episode in teacher.seen)


def test_reverse_starts_go_outwards_in_the_order_of_the_tasks():
    venv = curriculum(ReverseCurriculum(window=5), envs=1)
    venv.seed(0)
    venv.reset()
    for _ in range(200):
        venv.step([1])  # always to the goal
    drawn = venv.record.sampler.tasks
    first = [drawn.index(task) for task in range(3)]
    assert first == sorted(first)
    assert first[0] == 0


# -- seeds, copies, environments -----------------------------------------------------------------


@pytest.mark.parametrize("teacher", EASY, ids=repr)
def test_results_depend_on_the_seed_alone(teacher):
    np.random.seed(7)  # noqa: NPY002 - whatever else was drawn
    one = played(curriculum(teacher), seed=5)
    np.random.seed(8)  # noqa: NPY002
    assert_same(one, played(curriculum(teacher), seed=5))
    first = [info["task"] for step in one for info in step[3]]
    other = [info["task"] for step in played(curriculum(teacher), seed=6) for info in step[3]]
    assert first != other or isinstance(teacher, ReverseCurriculum)


def test_sub_environments_and_tasks_have_seeds_of_their_own():
    venv = curriculum(envs=3)
    drawn = [seen[3] for step in played(venv, 400) for seen in step[0] if seen[2] == 0]
    assert len(set(drawn)) > 100
    starts = {(step[3][i]["task"], seen[3]) for step in played(venv, 3) for i, seen in
              enumerate(step[0]) if seen[2] == 0}  # fmt: skip
    assert len({value for _, value in starts}) == len(starts)


@pytest.mark.parametrize("library", [pickle, cloudpickle])
@pytest.mark.parametrize("teacher", EASY, ids=repr)
def test_a_copy_goes_on_where_the_original_is(library, teacher):
    venv = curriculum(teacher, envs=2)
    played(venv, 7)
    twin = library.loads(library.dumps(venv))
    steps = actions(2, 150, seed=3)
    assert_same([venv.step(a) for a in steps], [twin.step(a) for a in steps])
    assert twin.steps_per_task.tolist() == venv.steps_per_task.tolist()


def test_environments_are_made_once_when_they_are_drawn_and_closed():
    made, closed = [], []

    def make(length):
        made.append(length)
        return Walk(length, closed=closed)

    tasks = {
        name: cr.observation_task(partial(make, length), time_limit=6)
        for name, length in LENGTHS.items()
    }
    made.clear(), closed.clear()  # they were inspected
    venv = curriculum(Always(2), envs=2, tasks=tasks)
    played(venv, 50)
    assert made == [8, 8]
    venv = curriculum(Uniform(), envs=2, tasks=tasks)
    made.clear()
    played(venv, 300)
    assert sorted(made) == [3, 3, 5, 5]  # the target's are there from the start
    venv.close()
    assert sorted(closed) == [3, 3, 5, 5, 8, 8]


def test_attributes_are_those_of_the_episode_going_on():
    venv = curriculum(envs=3)
    assert venv.get_attr("length") == [8, 8, 8]  # the target's before the first episode
    venv.set_options({"start": 1})
    venv.seed(3)
    venv.reset()
    assert [info["options"] for info in venv.reset_infos] == [{"start": 1}] * 3
    assert venv.get_attr("length") == [LENGTHS[info["task"]] for info in venv.reset_infos]
    assert venv.env_is_wrapped(Monitor) == [True] * 3
    assert venv.env_is_wrapped(Walk) == [False] * 3
    seen = venv.env_method("seen", indices=[1])[0]
    assert seen[0] == venv.get_attr("length", 1)[0]
    venv.set_attr("mark", 4, indices=[0])
    assert venv.get_attr("mark", 0) == [4]


def test_members_of_a_family_are_tasks():
    @task_family()
    def walks(length: int = 3):
        return walk(length)

    tasks = {"near": walks(), "far": walks(length=8)}
    venv = CurriculumVecEnv(tasks, target="far")
    assert venv.tasks["far"].make.args == (8,)
    assert {info["task"] for step in played(venv) for info in step[3]} == {"near", "far"}


def test_observations_may_be_dicts():
    class InDict(gym.ObservationWrapper):
        def __init__(self, length):
            super().__init__(Walk(length))
            self.observation_space = gym.spaces.Dict({"all": self.env.observation_space})

        def observation(self, observation):
            return {"all": observation}

    tasks = {n: cr.observation_task(partial(InDict, k), time_limit=6) for n, k in LENGTHS.items()}
    teacher = PrioritizedLevelReplay()
    venv = curriculum(teacher, tasks=tasks)
    model = PPO("MultiInputPolicy", venv, n_steps=64, n_epochs=1, seed=0)
    venv.values = NetworkValues(model.policy)
    model.learn(256)
    assert (venv.record.sampler.memory.score > 0).any()
