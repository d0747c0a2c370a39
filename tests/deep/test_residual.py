"""A network phi + residual is Q-learning started at phi; terminal and cut-off steps are right."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Discrete
from stable_baselines3 import DQN
from stable_baselines3.common.callbacks import BaseCallback

import curricle as cr
from curricle.deep import ways_in
from curricle.deep.learner import residual_policy
from curricle.deep.models import model_for
from curricle.deep.networks import FEW, NetworkValues
from curricle.deep.ways_in import ResidualMlpPolicy

from .worlds import one_hot, random_task, table_potential

SGD = {"optimizer_class": torch.optim.SGD, "net_arch": []}
OBSERVING = SGD | {"reads": "nothing"}
RATE = 0.25


def linear(observed, potential=None, **changed):
    """Return a DQN whose network is a table: linear, without bias, a plain gradient step each."""
    settings = {
        "learning_rate": RATE, "buffer_size": 1, "batch_size": 1, "learning_starts": 0,
        "train_freq": 1, "target_update_interval": 1, "exploration_fraction": 1.0,
        "exploration_final_eps": 0.5,
        "policy_kwargs": SGD if potential is None else OBSERVING, **changed,
    }  # fmt: skip
    learner = cr.deep.DeepLearner("DQN", settings=settings)
    model = model_for(observed, learner, shaping=cr.QInitialisation(potential), seed=3)
    for net in (model.q_net, model.q_net_target):
        torch.nn.init.zeros_(net.q_net[0].weight)
        torch.nn.init.zeros_(net.q_net[0].bias)
        net.q_net[0].bias.requires_grad_(requires_grad=False)
    return model


class Steps(BaseCallback):
    """Keeps every transition, as the environment told it."""

    def __init__(self):
        super().__init__()
        self.seen, self.cut = [], 0

    def _on_step(self):
        scope = self.locals
        (info,), (done,) = scope["infos"], scope["dones"]
        cut = info.get("TimeLimit.truncated", False)
        after = info["terminal_observation"] if done else scope["new_obs"][0]
        state = int(self.model._last_obs[0].argmax())
        action, reward = int(scope["actions"][0]), float(scope["rewards"][0])
        self.seen.append((state, action, reward, int(after.argmax()), bool(done and not cut)))
        self.cut += cut
        return True


@pytest.mark.parametrize("seed", range(5))
def test_a_linear_network_learns_what_the_table_started_at_phi_learns(seed):
    rng = np.random.default_rng(seed)
    task = random_task(rng)
    observed = one_hot(task)
    phi = np.where(task.terminal[:, None], 0.0, 0.1 * rng.normal(size=(5, 3)))
    model, steps = linear(observed, table_potential(task, observed, phi)), Steps()
    model.learn(400, callback=steps)
    assert {ended for *_, ended in steps.seen} == {False, True}
    assert steps.cut > 5
    q = phi.copy()
    for state, action, reward, after, ended in steps.seen:
        target = reward + (0.0 if ended else task.discount * q[after].max())
        q[state, action] += RATE * (target - q[state, action])
    states = np.flatnonzero(~task.terminal)
    q_values = NetworkValues(model.policy).q(np.eye(5, dtype=np.float32), np.tile(range(3), (5, 1)))
    assert q_values[states] == pytest.approx(q[states], abs=1e-5)


@pytest.mark.parametrize("reads", ["actions", "state"])
def test_a_residual_tells_states_apart_by_phi_alone(reads):
    rng = np.random.default_rng(11)
    task = random_task(rng)
    observed = one_hot(task)
    phi = 50 + 20 * rng.normal(size=(5, 3))
    how = {"net_arch": [16], "reads": reads}
    settings = {"learning_starts": 50, "batch_size": 32, "policy_kwargs": how}
    learner = cr.deep.DeepLearner("DQN", settings=settings)
    model = model_for(
        observed, learner, shaping=cr.QInitialisation(table_potential(task, observed, phi))
    )
    model.learn(44)
    online, target = model.q_net, model.q_net_target
    assert (online.running_shift, online.running_scale) == (0, 1)
    model.learn(60, reset_num_timesteps=False)
    met = phi[~task.terminal]
    features, scale = met if reads == "actions" else met.max(axis=1), online.running_scale.item()
    assert features.min() < -online.running_shift.item() / scale < features.max()  # a batch's mean
    assert 0 < 1 / scale < np.ptp(features)  # and spread
    before = online.running_shift.item(), scale
    model.learn(100, reset_num_timesteps=False)
    assert (online.running_shift.item(), online.running_scale.item()) == before
    model.target_update_interval = 1
    model.learn(4, reset_num_timesteps=False)
    assert (target.running_shift.item(), target.running_scale.item()) == before
    online.q_net[0].weight.data[:, :5] = 0.0  # blind to the observation
    with torch.no_grad():
        rows = torch.as_tensor(np.eye(5, dtype=np.float32)[~task.terminal])
        residual = online(rows).numpy() - met.astype(np.float32)
    assert np.ptp(residual, axis=0).min() > 0


@pytest.mark.parametrize("reads", ways_in.READS)
def test_it_acts_greedily_on_the_sum_whatever_the_batch(reads):
    cart = cr.observation_task("CartPole-v1", discount=0.99)
    height = cr.transfer.FunctionValues(lambda rows, actions: rows[:, :1] * actions, actions=2)
    potential = cr.transfer.ObservationPotential.of(cart, height)
    settings = {
        "learning_starts": 10, "batch_size": 8, "learning_rate": 0.03,
        "policy_kwargs": {"net_arch": [16], "reads": reads},
    }  # fmt: skip
    learner = cr.deep.DeepLearner("DQN", settings=settings)
    model = model_for(cart, learner, shaping=cr.QInitialisation(potential), seed=5)
    model.learn(60)
    rows = np.random.default_rng(1).normal(size=(FEW + 1, 4)).astype(np.float32)
    with torch.no_grad():
        best = model.q_net(torch.as_tensor(rows)).numpy().argmax(axis=1)
    assert len(set(best)) == 2
    for n in (1, FEW, FEW + 1):
        acts, _ = model.predict(rows[:n], deterministic=True)
        assert acts.tolist() == best[:n].tolist()


def test_a_residual_is_saved_and_loaded_with_its_potential(tmp_path):
    rng = np.random.default_rng(0)
    task = random_task(rng)
    observed = one_hot(task)
    model = linear(observed, table_potential(task, observed, rng.normal(size=(5, 3))))
    model.learn(50)
    model.save(tmp_path / "model")
    again = DQN.load(tmp_path / "model")
    assert isinstance(again.policy, ResidualMlpPolicy)
    rows = np.eye(5, dtype=np.float32)
    before, other = (NetworkValues(network.policy) for network in (model, again))
    assert (before.v(rows) == other.v(rows)).all()
    both = [network.policy.predict(rows, deterministic=True)[0] for network in (before, other)]
    assert np.array_equal(*both)


def test_what_cannot_be_a_residual_is_refused():
    from stable_baselines3 import PPO

    with pytest.raises(cr.errors.SettingError, match=r"needs DQN and one of .*: got PPO with Mlp"):
        residual_policy(PPO, "MlpPolicy")
    observed = one_hot(cr.GridWorld("S.T"))
    height = cr.transfer.FunctionValues(state_values=lambda rows: rows.sum(axis=1))
    with pytest.raises(cr.errors.SettingError, match="StateShaping does not"):
        cr.deep.learn_deep(
            observed, cr.deep.DeepLearner("DQN"), 100, shaping=cr.QInitialisation(height)
        )
    actions = cr.transfer.FunctionValues(lambda rows, actions: 1.0 * actions, actions=4)
    blind = cr.deep.DeepLearner("DQN", settings={"policy_kwargs": {"reads": "none"}})
    with pytest.raises(cr.errors.SettingError, match="actions, state, nothing: got 'none'"):
        cr.deep.learn_deep(observed, blind, 100, shaping=cr.QInitialisation(actions))
    car = cr.transfer.ObservationPotential.of(
        cr.observation_task("MountainCar-v0"),
        cr.transfer.FunctionValues(lambda seen, actions: 0.0 * actions, actions=3),
    )
    with pytest.raises(cr.errors.SettingError, match="made for the task it enters"):
        DQN(residual_policy(DQN), "Acrobot-v1", policy_kwargs={"potential": car})


class Picture(gymnasium.Env):
    """A red bar in one of three places of a picture, channels last; acting on it right pays 1."""

    observation_space = Box(0, 255, (40, 36, 3), np.uint8)
    action_space = Discrete(2)
    best = np.array([0, 1, 0])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.seen(), {}

    def seen(self):
        self.place = int(self.np_random.integers(3))
        picture = np.zeros((40, 36, 3), np.uint8)
        picture[10 * self.place : 10 * self.place + 10, :, 0] = 200
        return picture

    def step(self, action):
        right = float(action == self.best[self.place])
        return self.seen(), right, False, False, {}


@pytest.mark.parametrize("shaping", [cr.QInitialisation, cr.deep.PolicyReuse])
def test_phi_reads_pictures_as_the_task_has_them(shaping):
    def worth(pictures, actions):
        places = (pictures[:, ::10, 20, 0] == 200).argmax(axis=1)
        return 1.0 * (actions == Picture.best[places][:, None])

    task = cr.observation_task(Picture, time_limit=10)
    phi = shaping(cr.transfer.FunctionValues(worth, actions=2))
    learner = cr.deep.DeepLearner("DQN", "CnnPolicy", settings={"learning_starts": 100})
    result = cr.deep.learn_deep(task, learner, 200, shaping=phi, eval_freq=20)
    at_first = result.greedy_return[0, 0], result.training_return[0, 1]
    assert at_first[shaping is cr.deep.PolicyReuse] >= 8  # of 10, and of 5 at random


def test_numbered_observations_have_a_residual():
    task = cr.observation_task("FrozenLake-v1", is_slippery=False, time_limit=20)
    lake = cr.from_gymnasium("FrozenLake-v1", is_slippery=False, discount=0.95)
    mapping = cr.transfer.ObservationMapping(task, lake, lambda squares: squares)
    edge = cr.Transfer("solved", "lake", mapping)
    values = cr.transfer.TableValues(cr.solve(lake).action_values)
    phi = cr.transfer.ObservationPotential(task, [edge], [values])
    learner = cr.deep.DeepLearner("DQN", settings={"learning_starts": 8, "batch_size": 8})
    result = cr.deep.learn_deep(task, learner, 40, shaping=cr.QInitialisation(phi), eval_freq=40)
    assert result.greedy_return[0, 0] == 1
