"""What users of Stable-Baselines3 and RL Baselines3 Zoo bring works as it is."""

import inspect
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
import stable_baselines3 as sb3
import torch
from gymnasium.spaces import Box, Dict, Discrete
from gymnasium.wrappers import FrameStackObservation, TransformObservation
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.torch_layers import FlattenExtractor, NatureCNN
from stable_baselines3.common.vec_env import SubprocVecEnv, VecEnvWrapper, VecNormalize

import curricle as cr
from curricle.deep import DeepLearner, ShapedVecEnv, WeightTransfer, learn_deep, models
from curricle.deep.learner import Linear
from curricle.deep.networks import Standardized

CART = cr.observation_task("CartPole-v1", discount=0.98)
SMALL = {"n_steps": 32, "batch_size": 64, "policy_kwargs": {"net_arch": [16]}}
# As a file of RL Baselines3 Zoo has them.
ZOO = {
    "normalize": True, "n_envs": 2, "n_timesteps": 1e5, "policy": "MlpPolicy", "n_steps": 32,
    "batch_size": 64, "gae_lambda": 0.8, "gamma": 0.98, "n_epochs": 2, "learning_rate": "lin_0.001",
    "clip_range": "lin_0.2", "policy_kwargs": "dict(activation_fn=nn.ReLU, net_arch=[16, 16])",
}  # fmt: skip
TWO = {"seeds": 1, "eval_freq": 128}
pytestmark = pytest.mark.filterwarnings("ignore:You have specified a mini-batch size")


def zoo(algorithm="PPO", **changed):
    with pytest.warns(UserWarning, match=r"leaves out n_timesteps \(the budget sets it\)"):
        return DeepLearner(algorithm, settings={**ZOO, **changed})


def test_a_file_of_the_zoo_is_read_as_it_is():
    learner = zoo()
    assert (learner.envs, learner.policy) == (2, "MlpPolicy")
    assert learner.settings["learning_rate"] == Linear(0.001)
    assert learner.settings["clip_range"](0.25) == pytest.approx(0.05)
    assert learner.settings["policy_kwargs"] == {
        "activation_fn": torch.nn.ReLU, "net_arch": [16, 16],
    }  # fmt: skip
    assert not {"n_timesteps", "n_envs", "policy"} & learner.settings.keys()
    assert learner == zoo() != zoo(learning_rate="lin_0.01")
    assert repr(learner) == repr(zoo())
    with pytest.warns(UserWarning, match=r"env_wrapper \(encode of the task sets it\)"):
        DeepLearner("PPO", settings={"env_wrapper": "minigrid.wrappers.FlatObsWrapper"})
    model = models.model_for(CART, learner)
    assert model.lr_schedule(0.5) == pytest.approx(0.0005)
    nested = {"policy_kwargs": "dict(log_std_init=-2, net_arch=dict(pi=[8], vf=[8, 4]))"}
    (kwargs,) = DeepLearner("PPO", settings=nested).settings.values()
    assert kwargs == {"log_std_init": -2, "net_arch": {"pi": [8], "vf": [8, 4]}}


@pytest.mark.parametrize("kwargs", [{}, {"net_arch": [8]}])
def test_an_algorithm_that_adds_to_its_policy_kwargs_leaves_the_learners_as_they_are(kwargs):
    learner = DeepLearner("A2C", settings={"policy_kwargs": dict(kwargs)})
    model = models.model_for(CART, learner)
    assert model.policy_kwargs["optimizer_class"] is torch.optim.RMSprop
    assert learner.settings == {"policy_kwargs": kwargs}


@pytest.mark.parametrize(
    ("said", "settings"),
    [
        ("a number or lin_NUMBER: got 'cos_1'", {"learning_rate": "cos_1"}),
        ("plain values and classes of nn", {"policy_kwargs": "__import__('os').getcwd()"}),
        ("plain values and classes of nn", {"policy_kwargs": "dict(activation_fn=nn.Swosh)"}),
        ("true, false or a dict of clip_reward", {"normalize": {"norm_obss": True}}),
        ("true, false or a dict of clip_reward", {"normalize": 3}),
        (r"noise_type .* must be one of normal", {"noise_type": "pink", "noise_std": 0.1}),
        (r"must leave out .*: got seed", {"seed": 1}),
        (r"envs .* got 4 and n_envs = 2", {"n_envs": 2}),
        ("noise_type of a deep learner needs noise_std", {"noise_type": "normal"}),
    ],
)
def test_a_text_that_is_not_understood_is_refused(said, settings):
    with pytest.raises(cr.errors.SettingError, match=said) as caught:
        DeepLearner("PPO", envs=4, settings=settings)
    assert "\n" not in str(caught.value)


def test_the_noise_of_the_zoo_reaches_the_algorithm_and_gamma_is_the_tasks_discount():
    with pytest.raises(cr.errors.SettingError, match=r"got 0\.9 and 0\.98; discount= of the task"):
        learn_deep(CART, DeepLearner("PPO", settings={"gamma": 0.9}), 64)
    assert DeepLearner("PPO", envs=2, settings={"n_envs": 2}).envs == 2
    settings = {"noise_type": "ornstein-uhlenbeck", "noise_std": 0.3}
    model = models.model_for(
        cr.observation_task("Pendulum-v1"), DeepLearner("TD3", "MlpPolicy", settings=settings)
    )
    assert type(model.action_noise).__name__ == "OrnsteinUhlenbeckActionNoise"
    assert model.action_noise._sigma == pytest.approx([0.3])


def test_statistics_are_those_of_vec_normalize():
    model, cars = models.model_for(CART, zoo()), make_vec_env("CartPole-v1", n_envs=2, seed=0)
    venv = VecNormalize(cars, gamma=0.98)
    (part,) = Standardized.of(model.policy)
    venv.reset()
    part.see(model.policy, venv.get_original_obs(), venv)
    rng = np.random.default_rng(0)
    for _ in range(50):
        seen, *_ = venv.step(rng.integers(0, 2, 2))
        part.see(model.policy, venv.get_original_obs(), venv)
    raw = torch.as_tensor(venv.get_original_obs())
    assert part(raw).numpy() == pytest.approx(seen, abs=1e-3)
    assert float(part.running_reward) == pytest.approx(np.sqrt(venv.ret_rms.var + venv.epsilon))
    learner = zoo(normalize={"norm_reward": False, "epsilon": 100.0})
    (part,) = Standardized.of(models.model_for(CART, learner).policy)
    assert part(torch.ones(1, 4)).numpy() == pytest.approx(np.full((1, 4), 101**-0.5))


def test_a_network_keeps_its_statistics_wherever_it_goes(tmp_path):
    learner, seen = zoo(), np.random.default_rng(1).normal(size=(20, 4)).astype(np.float32)
    result = learn_deep(CART, learner, 256, **TWO)
    values, policy = result.values[0], result.policy
    (part,) = Standardized.of(policy.model.policy)
    assert 250 < part.running_count < 260
    assert not torch.equal(part.running_0_var, torch.ones(4))
    with torch.no_grad():
        raw = policy.model.policy.predict_values(torch.as_tensor(seen))[:, 0].numpy()
    spread = float(part.running_reward)
    assert spread != 1.0
    assert values.v(seen) == pytest.approx(raw * spread, rel=1e-5)
    loaded = sb3.PPO.load(policy.save(tmp_path / "cart"))
    assert np.array_equal(loaded.predict(seen, deterministic=True)[0], policy.predict(seen))
    again = cr.deep.DeepResult.load(result.save(tmp_path / "kept"), CART, learner)
    assert np.array_equal(again.values[0].v(seen), values.v(seen))


NUMBERED = cr.observation_task("FrozenLake-v1", is_slippery=False)  # no box to standardise


@pytest.mark.parametrize(("task", "normalize"), [(CART, {"norm_obs": False}), (NUMBERED, True)])
def test_values_are_in_the_tasks_rewards_where_these_alone_are_normalised(task, normalize):
    settings = {**SMALL, "normalize": normalize}
    result = learn_deep(task, DeepLearner("PPO", settings=settings), 128, **TWO)
    policy, seen = result.policy.model.policy, np.stack([task.make().reset()[0]])
    (part,) = Standardized.of(policy)
    assert not part.numbers
    assert float(part.running_reward) != 1.0
    with torch.no_grad():
        raw = policy.predict_values(policy.obs_to_tensor(seen)[0])[:, 0].numpy()
    assert result.values[0].v(seen) == pytest.approx(raw * float(part.running_reward), rel=1e-5)


def learnt(learner, **settings):
    return learn_deep(CART, learner, 64, **settings).values[0]


PLAIN = DeepLearner("PPO", settings=SMALL)
NORMALISED = replace(PLAIN, settings={**SMALL, "normalize": True})
OBSERVING = replace(PLAIN, settings={**SMALL, "normalize": {"norm_reward": False}})


def test_a_critic_of_other_rewards_or_values_with_a_scale_stays_where_it_is():
    height = cr.transfer.FunctionValues(state_values=lambda seen: 50 + 0 * seen[:, 0])
    plain = learnt(PLAIN)
    edge = cr.Transfer("other", "cart", cr.transfer.ObservationMapping(CART, CART), scale=10.0)
    for source, learner, says in (
        (plain, NORMALISED, "needs rewards as they are"),
        (learnt(NORMALISED), OBSERVING, r"normalised rewards; PolicyReuse takes over"),
        (learnt(PLAIN, shaping=cr.StateShaping(height)), PLAIN, "shaped rewards; PolicyReuse"),
        (cr.transfer.ObservationPotential(CART, [edge], [plain]), PLAIN, "has values with a scale"),
        (
            cr.transfer.ObservationPotential.of(CART, plain).rescaled(7.0),
            PLAIN,
            "has values with a scale",
        ),
    ):
        with pytest.raises(cr.errors.SettingError, match=says):
            learnt(learner, shaping=WeightTransfer(source))
        if learner is not NORMALISED:
            reused = learnt(learner, shaping=cr.deep.PolicyReuse(source))
            assert all(part.running_reward == 1 for part in Standardized.of(reused.policy))


def test_a_residual_refuses_rewards_in_other_units():
    phi = cr.transfer.FunctionValues(lambda seen, actions: 0.0 * actions, actions=2)
    learner = DeepLearner("DQN", settings={"normalize": True, "learning_starts": 10})
    with pytest.raises(cr.errors.SettingError, match="needs rewards as they are"):
        learn_deep(CART, learner, 64, shaping=cr.QInitialisation(phi))
    alone = replace(learner, settings={**learner.settings, "normalize": {"norm_reward": False}})
    result = learn_deep(CART, alone, 64, shaping=cr.QInitialisation(phi), eval_freq=32)
    assert np.isfinite(result.greedy_return).all()


class Halved(VecEnvWrapper):
    """Halves rewards."""

    def reset(self):
        return self.venv.reset()

    def step_wait(self):
        observations, rewards, dones, infos = self.venv.step_wait()
        return observations, rewards / 2, dones, infos


class Halving(sb3.PPO):
    """PPO with a wrapper of its own around its environments."""

    __signature__ = inspect.signature(sb3.PPO)

    def __init__(self, policy, env, **settings):
        super().__init__(policy, Halved(env) if env else env, **settings)


def painted(env):
    """Return an environment whose observations are pictures, channels last."""
    space = Box(0, 255, (40, 40, 3), np.uint8)
    picture = np.ones((40, 40, 3), np.uint8)
    return TransformObservation(env, lambda seen: picture * np.uint8(seen[0] * 50 + 99), space)


@pytest.mark.parametrize(
    ("policy", "inner"), [("MlpPolicy", FlattenExtractor), ("CnnPolicy", NatureCNN)]
)
def test_a_picture_that_is_standardised_is_read_as_its_policy_reads_it(policy, inner):
    task = cr.observation_task("CartPole-v1", encode=painted)
    learner = DeepLearner("PPO", policy, settings={"n_steps": 8, "normalize": True})
    (part,) = Standardized.of(models.model_for(task, learner).policy)
    assert type(part.inner) is inner


def goals(env):
    """Return an environment with goals, for hindsight replay."""
    space = Box(-9, 9, (1,), np.float32)
    parts = {"observation": env.observation_space, "achieved_goal": space, "desired_goal": space}
    env = TransformObservation(
        env,
        lambda seen: {"observation": seen, "achieved_goal": seen[:1], "desired_goal": 0 * seen[:1]},
        Dict(parts),
    )
    env.compute_reward = lambda achieved, desired, infos: -np.abs(achieved - desired)[..., 0]
    return env


HINDSIGHT = {"replay_buffer_class": sb3.HerReplayBuffer, "learning_starts": 60, "train_freq": 4}
SDE = {"use_sde": True, "policy_kwargs": {"net_arch": [8]}}
NOISE = {"noise_type": "ornstein-uhlenbeck", "noise_std": 0.5, "learning_starts": 10,
         "policy_kwargs": {"net_arch": [8]}}  # fmt: skip


@pytest.mark.parametrize(
    ("learner", "name", "encode"),
    [
        (DeepLearner(f"{__name__}:Halving", settings=SMALL), "CartPole-v1", None),
        (
            DeepLearner("PPO", "CnnPolicy", settings={"n_steps": 64, "batch_size": 32}),
            "CartPole-v1",
            painted,
        ),
        (DeepLearner("DQN", "MultiInputPolicy", settings=HINDSIGHT), "CartPole-v1", goals),
        (DeepLearner("PPO", settings={**SDE, "n_steps": 16}), "Pendulum-v1", None),
        (DeepLearner("SAC", settings={**SDE, "learning_starts": 20}), "Pendulum-v1", None),
        (DeepLearner("TD3", settings=NOISE), "Pendulum-v1", None),
    ],
)
def test_equal_seeds_agree_whatever_noise_wrappers_and_buffers_a_learner_has(learner, name, encode):
    task = cr.observation_task(name, encode=encode, time_limit=20)
    first, second = (learn_deep(task, learner, 128, eval_freq=64) for _ in range(2))
    networks = [result.values[0].parameters() for result in (first, second)]
    assert all(np.array_equal(networks[0][key], networks[1][key]) for key in networks[0])
    assert np.array_equal(first.training_return, second.training_return, equal_nan=True)


class Parts(gymnasium.ObservationWrapper):
    """CartPole's observation as a Dict with a number, and a part that its space does not have."""

    def __init__(self, env):
        super().__init__(env)
        box = Box(-1e3, 1e3, (2,), np.float32)
        self.observation_space = Dict({"x": box, "speed": box, "side": Discrete(2)})

    def observation(self, seen):
        parts = {"x": seen[::2], "speed": seen[1::2], "side": int(seen[0] > 0)}
        return parts | {"action_mask": np.ones(2)}


def four(env):
    return FrameStackObservation(env, 4)


@pytest.mark.parametrize("algorithm", ["PPO", "DQN"])
@pytest.mark.parametrize(("encode", "policy"), [(Parts, "MultiInputPolicy"), (four, "MlpPolicy")])
def test_parts_and_frames_are_normalised_too(algorithm, encode, policy):
    task = cr.observation_task("CartPole-v1", encode=encode, time_limit=10)  # PPO reads the last
    settings = SMALL if algorithm == "PPO" else {"learning_starts": 20}
    learner = DeepLearner(algorithm, policy, envs=2, settings={**settings, "normalize": True})
    result = learn_deep(task, learner, 128, eval_freq=64)
    assert np.isfinite(result.greedy_return).all()
    parts = [*Standardized.of(result.policy.model.policy)]
    assert all(part.running_count > 100 for part in parts)
    assert [len(part.numbers) for part in parts] == [1 + (encode is Parts)] * len(parts)


def test_processes_learn_what_one_process_learns():
    learner = DeepLearner("PPO", envs=2, settings=SMALL)
    apart = learn_deep(CART, replace(learner, processes=True), 128, eval_freq=64)
    assert "processes" in repr(apart.learner)
    together = learn_deep(CART, learner, 128, eval_freq=64)
    assert np.array_equal(apart.greedy_return, together.greedy_return)
    with pytest.raises(cr.errors.SettingError, match="processes of a deep learner must be a bool"):
        DeepLearner(processes=2)


@pytest.mark.parametrize("algorithm", ["PPO", "DQN", "SAC"])
def test_a_saved_model_goes_on_with_its_optimizer(tmp_path, algorithm):
    task = cr.observation_task("Pendulum-v1") if algorithm == "SAC" else CART
    off_policy = {"learning_starts": 40, "batch_size": 16, "policy_kwargs": {"net_arch": [16]}}
    settings = SMALL if algorithm == "PPO" else off_policy
    off = cr.GreedyEvaluation(method="off")
    result = learn_deep(task, DeepLearner(algorithm, settings=settings), 64, evaluation=off)
    model = getattr(sb3, algorithm).load(result.policy.save(tmp_path / "model"))
    owner, wanted = model.policy, result.values[0].policy
    if algorithm == "SAC":
        owner, wanted = owner.critic, wanted.critic
    here, there = (x.optimizer.state_dict()["state"] for x in (owner, wanted))
    assert here.keys() == there.keys() != set()
    for number, state in there.items():
        assert all(torch.equal(state[name], here[number][name]) for name in state)
    model.set_env(make_vec_env(task.make))
    model.learn(32, reset_num_timesteps=False)
    assert model.num_timesteps >= 96


def test_normalisation_and_processes_of_ones_own_are_around_the_shaping():
    cars = make_vec_env("CartPole-v1", n_envs=2, seed=0, vec_env_cls=SubprocVecEnv)
    shaped = ShapedVecEnv(cars, lambda seen: float(seen[2]), discount=0.98)
    venv = VecNormalize(shaped, gamma=0.98)
    try:
        sb3.PPO("MlpPolicy", venv, gamma=0.98, **SMALL).learn(128)
    finally:
        venv.close()
    assert venv.obs_rms.count > 120
