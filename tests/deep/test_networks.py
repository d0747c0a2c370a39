"""What networks value is what PyTorch says, whoever reads it."""

from importlib.util import find_spec

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Discrete
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import FlattenExtractor

import curricle as cr
from curricle.deep.models import model_for
from curricle.deep.networks import (
    FEW,
    NetworkValues,
    SmallCNN,
    Standardized,
    acting,
    greedy_layers,
    plain_network,
)  # fmt: skip
from curricle.errors import MappingError, PotentialError

CART = cr.observation_task("CartPole-v1", discount=0.99)
SETTINGS = {
    "DQN": {"policy_kwargs": {"net_arch": [16, 16]}},
    "QRDQN": {"policy_kwargs": {"net_arch": [16], "n_quantiles": 7}},
    "PPO": {"policy_kwargs": {"net_arch": {"pi": [8], "vf": [16, 16]}}, "n_steps": 64},
    "A2C": {"policy_kwargs": {"net_arch": [8], "activation_fn": torch.nn.ReLU}},
}


def policy_of(algorithm, potential=None, **policy_kwargs):
    if algorithm == "QRDQN" and find_spec("sb3_contrib") is None:
        pytest.skip("sb3-contrib is not installed")
    settings = SETTINGS[algorithm]
    settings = settings | {"policy_kwargs": settings["policy_kwargs"] | policy_kwargs}
    learner = cr.deep.DeepLearner(algorithm, settings=settings)
    shaping = None if potential is None else cr.QInitialisation(potential)
    return model_for(CART, learner, shaping, steps=100, seed=3).policy


def said_by_torch(policy, kind, rows):
    """What the network says, by its own forward pass, (n, A) or (n, 1)."""
    with torch.no_grad():
        seen = torch.as_tensor(rows)
        if kind == "value_net":
            return policy.predict_values(seen).numpy()
        said = getattr(policy, kind)(seen)
        return (said.mean(dim=1) if kind == "quantile_net" else said).numpy()


@pytest.mark.parametrize("algorithm", sorted(SETTINGS))
@pytest.mark.parametrize("n", [1, FEW, FEW + 1])
def test_values_are_the_networks_output_whatever_the_batch(algorithm, n):
    policy = policy_of(algorithm)
    values = NetworkValues(policy)
    assert plain_network(policy, values.kind) is not None
    rows = np.random.default_rng(n).normal(size=(n, 4)).astype(np.float32)
    for _ in range(2):
        said = said_by_torch(policy, values.kind, rows)
        assert values.v(rows) == pytest.approx(said.max(axis=1), rel=1e-5, abs=1e-6)
        if values.of_actions:
            eval_freq = np.tile(np.arange(2), (n, 1))
            assert values.q(rows, eval_freq) == pytest.approx(said, rel=1e-5, abs=1e-6)
            assert values.q(rows, eval_freq[:, 1]) == pytest.approx(said[:, 1], rel=1e-5, abs=1e-6)
        with torch.no_grad():  # as learning does it: in place
            for parameter in policy.parameters():
                parameter.mul_(-1.5)


def test_critics_of_quantiles_are_worth_their_mean():
    pytest.importorskip("sb3_contrib", reason="sb3-contrib is not installed")
    task = cr.observation_task("Pendulum-v1")
    settings = {"policy_kwargs": {"net_arch": [8], "n_quantiles": 5, "n_critics": 3}}
    policy = model_for(task, cr.deep.DeepLearner("TQC", settings=settings), steps=100).policy
    rows = np.random.default_rng(0).normal(size=(4, 3)).astype(np.float32)
    with torch.no_grad():
        taken = policy.actor(torch.as_tensor(rows), deterministic=True)
        quantiles = policy.critic(torch.as_tensor(rows), taken).numpy()
    wanted = quantiles.mean(axis=2).min(axis=1)
    assert NetworkValues(policy).v(rows) == pytest.approx(wanted, rel=1e-5)


def test_what_a_network_has_no_values_of_is_refused():
    policy = policy_of("DQN")
    values, rows = NetworkValues(policy), np.zeros((1, 4), np.float32)
    with pytest.raises(PotentialError, match="its own 2 actions only: action 2 is asked for"):
        values.q(rows, np.array([2]))
    with pytest.raises(PotentialError, match=r"a network reads observations of Box.*\(4,\)"):
        values.v(np.zeros((1, 6), np.float32))
    with pytest.raises(PotentialError, match=r"those of model\.policy"):
        NetworkValues(model_for(CART, cr.deep.DeepLearner("DQN"), steps=100))
    pole = cr.observation_task("Acrobot-v1")
    with pytest.raises(MappingError, match=r"the target's are \(4,\), the source's \(6,\)"):
        cr.transfer.ObservationMapping(CART, pole)


class Doubled(torch.nn.Module):
    def forward(self, observations):
        return 2 * observations


def test_what_is_not_plain_is_left_to_torch():
    from stable_baselines3.common.torch_layers import FlattenExtractor

    class Halved(FlattenExtractor):
        def forward(self, observations):
            return super().forward(observations) / 2

    height = cr.transfer.FunctionValues(lambda rows, actions: actions + rows[:, :1], actions=2)
    potential = cr.transfer.ObservationPotential.of(CART, height)
    rows = np.random.default_rng(0).normal(size=(3, 4)).astype(np.float32)
    for policy in (
        policy_of("DQN", potential),
        policy_of("DQN", features_extractor_class=Halved),
        policy_of("DQN", activation_fn=Doubled),
        policy_of("PPO", features_extractor_class=Halved),
    ):
        values = NetworkValues(policy)
        assert plain_network(policy, values.kind) is None
        said = said_by_torch(policy, values.kind, rows)
        assert values.v(rows) == pytest.approx(said.max(axis=1))


@pytest.mark.parametrize("observed", ["plain", "pictures", "normalised"])
def test_greedy_actors_choose_what_predict_chooses(observed):
    space = Box(-1, 1, (4, 6, 6) if observed == "pictures" else (9,), np.float32)
    extractors = {"plain": FlattenExtractor, "pictures": SmallCNN, "normalised": Standardized}
    policy = ActorCriticPolicy(
        space, Discrete(5), lambda _: 1e-3, features_extractor_class=extractors[observed]
    )
    assert (greedy_layers(policy) is not None) == (observed == "plain")
    rng = np.random.default_rng(0)
    act = acting(policy, [None] * 50)
    for n in [1, 5, 50] * 20:
        seen = rng.uniform(-1, 1, (n, *space.shape)).astype(np.float32)
        chosen, _ = policy.predict(seen, deterministic=True)
        np.testing.assert_array_equal(act(seen, range(n)), chosen)
