"""A policy to take away: acting, files that Stable-Baselines3 reads, episodes as pictures."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.envs.classic_control import CartPoleEnv
from stable_baselines3 import DQN, PPO

import curricle as cr
from curricle.curriculum import CurriculumResult
from curricle.deep import DeepLearner, DeepResult, SmallCNN, TrainedPolicy, learn_deep
from curricle.errors import SettingError, StoreError
from curricle.interop import MiniGridView
from curricle.study import StudyResults, read_study, run_study
from curricle.study.analysis import played_episode, stored_episode

from .worlds import ACTOR, DEEP_Q, LAKE, MAZE, generator_states, one_hot, table_potential

KWARGS = {"features_extractor_class": SmallCNN, "normalize_images": False}
CNN = DeepLearner(
    "PPO", "CnnPolicy", settings={"n_steps": 32, "batch_size": 32, "policy_kwargs": KWARGS}
)


@pytest.fixture(scope="module")
def lake():
    return learn_deep(LAKE, ACTOR, 128, seeds=[5, 2, 9], eval_freq=64)


ROWS = np.eye(16, dtype=np.int64)


@pytest.mark.parametrize(("algorithm", "learner"), [(PPO, ACTOR), (DQN, DEEP_Q)])
def test_a_saved_policy_is_read_by_stable_baselines3_and_here(tmp_path, algorithm, learner):
    result = learn_deep(LAKE, learner, 192, seeds=2, eval_freq=64)
    assert len(result.policies) == 2
    for k, policy in enumerate(result.policies):
        file = policy.save(tmp_path / f"new/seed-{k}")
        assert file == tmp_path / f"new/seed-{k}.zip"
        theirs = algorithm.load(file)
        loaded = TrainedPolicy(LAKE, theirs)
        wanted = result.values[k].policy.predict(ROWS, deterministic=True)[0]
        assert np.array_equal(policy.predict(ROWS), wanted)
        assert np.array_equal(loaded.predict(ROWS), wanted)
        assert np.array_equal(theirs.predict(ROWS, deterministic=True)[0], wanted)
        assert policy.predict(ROWS[3]) == wanted[3]
        assert theirs.num_timesteps == result.steps_used[k]
    for name, value in result.values[1].parameters().items():
        assert np.array_equal(theirs.policy.state_dict()[name].numpy(), value)


def test_the_policy_is_that_of_the_best_last_return(lake):
    best = int(lake.greedy_return[:, -1].argmax())
    assert lake.policy is lake.policies[best]
    off = learn_deep(LAKE, ACTOR, 64, seeds=2, evaluation=cr.GreedyEvaluation("off"), eval_freq=64)
    assert off.policy is off.policies[0]


def test_a_policy_leaves_the_random_generators_alone(lake):
    before = generator_states()
    sampled, again, other = (
        lake.policies[0].episode(seed=seed, deterministic=False) for seed in (1, 1, 2)
    )
    after = generator_states()
    assert torch.equal(before[2], after[2])
    assert np.array_equal(before[1][1], after[1][1])
    assert sampled.actions.tolist() == again.actions.tolist() != other.actions.tolist()


def test_an_episode_is_what_the_policy_does(lake):
    episode, env = lake.policy.episode(seed=4), LAKE.environment()
    seen, _ = env.reset(seed=4)
    for action, reward in zip(episode.actions, episode.rewards, strict=True):
        assert action == lake.policy.predict(seen)
        seen, paid, terminated, truncated, _ = env.step(int(action))
        assert paid == reward
    assert terminated == episode.terminated
    assert terminated or truncated
    assert len(episode.frames) == len(episode.actions) + 1
    assert lake.policy.episode(max_steps=2).actions.shape == (2,)


STUDY = """
name = "level"
scratch = false
seeds = 2
seeds_per_unit = 1
budget = 64
eval_freq = 32
[learner]
type = "deep"
algorithm = "PPO"
policy = "CnnPolicy"
[learner.settings]
n_steps = 32
batch_size = 32
[learner.settings.policy_kwargs]
normalize_images = false
features_extractor_class = "curricle.deep:SmallCNN"
[tasks.level]
type = "observation_task"
id = "minigrid:MiniGrid-Empty-5x5-v0"
encode = { type = "MiniGridView", picture = true }
"""


def test_the_policies_of_a_study_are_read_from_its_folder(tmp_path):
    pytest.importorskip("minigrid", reason="the extra minigrid is not installed")
    (tmp_path / "level.toml").write_text(STUDY)
    study = read_study(tmp_path / "level.toml")
    run_study(study, tmp_path / "results")
    stored = StudyResults(tmp_path / "results")
    (arm,) = stored.record.arms
    curriculum = study.curriculum(arm)
    policies = stored.policies(arm, curriculum)
    parameters = stored.result(arm, "level", values=True).values
    assert len(policies) == 2
    for policy, kept in zip(policies, parameters, strict=True):
        for name, value in policy.model.policy.state_dict().items():
            assert np.array_equal(value.numpy(), kept[name])
    trained = curriculum.train(seeds=2).policies
    seen = np.stack([curriculum.tasks["level"].observations.sample() for _ in range(9)])
    for stored_policy, other_policy in zip(policies, trained, strict=True):
        assert np.array_equal(stored_policy.predict(seen), other_policy.predict(seen))
    (single,) = stored.policies(arm, curriculum, seeds=[1])
    assert np.array_equal(single.predict(seen), policies[1].predict(seen))
    assert policies[0].episode(max_steps=3).frames[0].shape == (160, 160, 3)
    seed, episode = played_episode(stored, study, arm, "level", 1)
    assert (seed, episode.frames[0].ndim) == (1, 3)
    with pytest.raises(StoreError, match="stores no episode of 'level'"):
        stored_episode(stored, arm, "level")
    with pytest.raises(StoreError, match="for seed 7 yet"):
        stored.policies(arm, curriculum, seeds=[7])


def test_a_network_reads_encoded_levels_and_is_evaluated_in_tables():
    pytest.importorskip("minigrid", reason="the extra minigrid is not installed")
    level = "minigrid:MiniGrid-Empty-5x5-v0"
    task = cr.observation_task(level, encode=MiniGridView(picture=True))
    policy = learn_deep(task, CNN, 64, eval_freq=32).policy
    table = cr.tabulate(task.make, discount=0.99, seeds=[0])
    episode = policy.episode(seed=0)
    earned = 0.99 ** (len(episode.actions) - 1) * episode.terminated
    assert cr.evaluate(table, policy).start_value == pytest.approx(earned, abs=1e-9)


def drawn_nowhere():
    return one_hot(MAZE).make()


CART = cr.observation_task("CartPole-v1")
TINY = DeepLearner("PPO", settings={"n_steps": 64, "policy_kwargs": {"net_arch": [8]}})


def refused_by_sb3(policy="MlpPolicy", **settings):
    return lambda lake, folder: learn_deep(LAKE, DeepLearner("DQN", policy, settings=settings), 10)


def loaded(task, learner):
    return lambda lake, folder: DeepResult.load(lake.save(folder / "saved"), task, learner)


MISTAKES = {
    r"seed of a network's .* below 2\^32: got 4294967296": lambda lake, _: lake.policy.episode(
        seed=2**32
    ),
    r"a policy takes observations of Box.*\(3,\)": lambda lake, _: lake.policy.predict(np.zeros(3)),
    "must draw pictures, .*: got render_mode=None": lambda lake, _: TrainedPolicy(
        cr.tasks.ObservationTask(drawn_nowhere), lake.policy.model
    ).episode(),
    "DQN must take its task .* says .*Policy Mlp unknown": refused_by_sb3("Mlp"),
    "DQN must take its task .* says .*nan": refused_by_sb3(learning_rate=float("nan")),
    "DQN must take its task .* says .*negative dim": refused_by_sb3(
        policy_kwargs={"net_arch": [-3]}
    ),
    "DQN must take its task .* says ": refused_by_sb3(policy_kwargs={"net_arch": "x"}),
    "evaluation of 'cart' cannot end: an undiscounted": lambda *_: cr.Curriculum(
        {"cart": cr.observation_task(CartPoleEnv, discount=0.9)}, learner=DEEP_Q
    ),
    "own task: .* has observations": loaded(CART, ACTOR),
    "the task, learner and shaping they were trained with: .*DQN": loaded(LAKE, DEEP_Q),
    "does not take these parameters": loaded(LAKE, TINY),
    "learner must be a DeepLearner": loaded(LAKE, "PPO"),
}


@pytest.mark.parametrize("sentence", MISTAKES)
def test_a_mistake_is_one_sentence(lake, tmp_path, sentence):
    with pytest.raises(SettingError, match=sentence) as caught:
        MISTAKES[sentence](lake, tmp_path)
    assert "\n" not in str(caught.value)


def parameters(result):
    return [values.parameters() for values in result.values]


def same_networks(result, other):
    for parameter, other_parameter in zip(parameters(result), parameters(other), strict=True):
        assert parameter.keys() == other_parameter.keys()
        for name, value in parameter.items():
            assert np.array_equal(value, other_parameter[name])


def test_networks_are_loaded_as_they_were(tmp_path, lake):
    file = lake.save(tmp_path / "lake")
    again = DeepResult.load(file, LAKE, ACTOR)
    same_networks(lake, again)
    assert again.save(tmp_path / "two").read_bytes() == file.read_bytes()
    assert again.learner == ACTOR
    for policy, loaded_policy in zip(lake.policies, again.policies, strict=True):
        assert np.array_equal(policy.predict(ROWS), loaded_policy.predict(ROWS))
    assert repr(again.watch(seed=3)) == repr(lake.watch(seed=3))
    with np.load(file, allow_pickle=False) as arrays:
        assert any(name.startswith("values_1/") for name in arrays.files)


def test_without_a_learner_there_are_curves_and_parameters(tmp_path, lake):
    file = lake.save(tmp_path / "lake")
    again = DeepResult.load(file, LAKE)
    same_networks(lake, DeepResult.load(again.save(tmp_path / "two"), LAKE, ACTOR))
    assert np.array_equal(again.greedy_return, lake.greedy_return)
    assert again.values[0].keys() == parameters(lake)[0].keys()
    with pytest.raises(SettingError, match="these are their parameters alone, see load"):
        _ = again.policy


@pytest.mark.parametrize("shaping", [cr.QInitialisation, cr.StateShaping])
def test_a_network_on_a_potential_needs_it_again(tmp_path, shaping):
    task, table = one_hot(MAZE), cr.solve(MAZE).action_values
    shaped = shaping(table_potential(MAZE, task, table))
    result = learn_deep(task, DEEP_Q, 64, seeds=2, shaping=shaped, eval_freq=32)
    file = result.save(tmp_path / "maze")
    again = DeepResult.load(file, task, DEEP_Q, shaping=shaped)
    rows = np.eye(MAZE.states.size, dtype=np.float32)
    for values, loaded_values in zip(result.values, again.values, strict=True):
        assert np.array_equal(values.v(rows), loaded_values.v(rows))
    of_each_seed = DeepResult.load(file, task, DEEP_Q, shaping=[shaped, shaped])
    assert np.array_equal(of_each_seed.values[1].v(rows), result.values[1].v(rows))
    with pytest.raises(SettingError):
        DeepResult.load(file, task, DEEP_Q)
    if shaping is cr.StateShaping:
        other = shaping(table_potential(MAZE, task, table + 1))
        with pytest.raises(SettingError, match="the StateShaping that they were trained with"):
            DeepResult.load(file, task, DEEP_Q, shaping=other)
    with pytest.raises(SettingError, match="a shaping for each of 2 seeds is needed: got 1"):
        DeepResult.load(file, task, DEEP_Q, shaping=[shaped])


def test_a_curriculum_of_networks_is_loaded_as_it_was(tmp_path):
    edge = cr.Transfer("alone", "lake", cr.transfer.ObservationMapping(LAKE, LAKE))
    plan = cr.Curriculum({"alone": LAKE, "lake": LAKE}, [edge], learner=DEEP_Q, budget=64)
    result = plan.train(seeds=2)
    file = result.save(tmp_path / "plan")
    again = CurriculumResult.load(file, plan)
    for name in result.nodes:
        same_networks(result[name], again[name])
        for values, loaded_values in zip(result[name].values, again[name].values, strict=True):
            # phi is cached as the batch it was first computed in rounds it.
            np.testing.assert_allclose(values.v(ROWS), loaded_values.v(ROWS), rtol=1e-6)
    assert again.save(tmp_path / "two").read_bytes() == file.read_bytes()
    assert np.array_equal(again.policy.predict(ROWS), result.policy.predict(ROWS))
    small = DeepLearner("DQN", settings={"policy_kwargs": {"net_arch": [8]}})
    other = cr.Curriculum({"alone": LAKE, "lake": LAKE}, [edge], learner=small, budget=64)
    with pytest.raises(SettingError, match="with the learners they were trained with: Error"):
        CurriculumResult.load(file, other)
    partly = plan.train(seeds=2, trained={"alone": result.sources["alone"]})
    loaded = CurriculumResult.load(partly.save(tmp_path / "given"), plan)
    same_networks(loaded.given["alone"], partly.given["alone"])


def test_a_policy_that_draws_is_worth_the_mean():
    task = cr.tabulate("FrozenLake-v1", discount=0.9)
    model = PPO("MlpPolicy", gym.make("FrozenLake-v1"), seed=0, device="cpu")
    policy = task.policy(model, deterministic=False)
    assert policy.shape == (16, 4)
    np.testing.assert_allclose(policy.sum(axis=1), 1)
    state = task.state(6)
    drawn = [int(model.predict(np.array([6]))[0][0]) for _ in range(2000)]
    shares = np.bincount(drawn, minlength=4) / 2000
    # Five standard deviations of a share of 2,000.
    np.testing.assert_allclose(policy[state], shares, atol=5 * 0.0112)
    assert 0 < cr.evaluate(task, policy).start_value < cr.solve(task).start_value
    with pytest.raises(cr.CurricleError, match="must have a distribution"):
        task.policy(DQN("MlpPolicy", gym.make("FrozenLake-v1")), deterministic=False)
