"""An actor that starts as a source's policy, and is kept near it less and less."""

from functools import partial

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3.common.callbacks import BaseCallback

import curricle as cr
from curricle.deep.distillation import Distillation, distil
from curricle.deep.miniature import Knowledge
from curricle.deep.models import model_for
from curricle.deep.networks import NetworkValues

from .worlds import one_hot, random_task

STEPS = 1_024


def learner(**changed):
    settings = {"n_steps": 32, "batch_size": 32, "n_epochs": 2} | changed
    return cr.deep.DeepLearner(
        "PPO", envs=2, settings={**settings, "policy_kwargs": {"net_arch": [8]}}
    )


def task_and_source(seed=0):
    rng = np.random.default_rng(seed)
    task = random_task(rng)
    observed = one_hot(task)
    wanted = rng.dirichlet(np.full(3, 0.3), 5)
    known = Knowledge.of(np.eye(5, dtype=np.float32), rng.normal(size=(5, 3)), wanted)
    fit = Distillation(updates=600, learning_rate=0.02, smoothing=0.0)
    return observed, distil(known, observed, learner(), fit), wanted


def source(observed, values):
    return cr.transfer.ObservationPotential.of(observed, values)


def probabilities(policy):
    seen, _ = policy.obs_to_tensor(np.eye(5, dtype=np.float32))
    return policy.get_distribution(seen).distribution.probs.detach().numpy()


class Weights(BaseCallback):
    def __init__(self):
        super().__init__()
        self.seen = []

    def _on_step(self):
        return True

    def _on_rollout_end(self):
        self.seen.append(self.model.policy.kl_weight)


def test_the_actor_starts_as_the_source_and_the_critic_does_not():
    observed, values, wanted = task_and_source()
    shaping = cr.deep.PolicyReuse(source(observed, values))
    model = model_for(observed, learner(), shaping, seed=9)
    assert probabilities(model.policy) == pytest.approx(wanted, abs=0.05)
    rows = np.eye(5, dtype=np.float32)
    assert not np.allclose(NetworkValues(model.policy).v(rows), values.v(rows), atol=0.05)


def test_the_pull_falls_to_0_at_half_of_the_budget():
    observed, values, _ = task_and_source()
    shaping = cr.deep.PolicyReuse(source(observed, values), kl=2.0)
    model, weights = model_for(observed, learner(), shaping, seed=9), Weights()
    model.learn(STEPS, callback=weights)
    assert model.policy.kl_weight == 0.0
    first = weights.seen[1]  # of the update after the first rollout
    assert first == pytest.approx(2.0 * (1 - 64 / (STEPS / 2)))
    half = len(weights.seen) // 2
    assert all(weight == 0.0 for weight in weights.seen[half + 1 :])
    assert all(b < a for a, b in zip(weights.seen[1:half], weights.seen[2:half], strict=False))


def test_the_pull_falls_to_0_at_half_of_a_budget_in_episodes():
    observed, values, _ = task_and_source()
    weights = Weights()
    pulled = cr.deep.DeepLearner(
        "PPO", settings={**learner().settings, "n_steps": 64}, callbacks=lambda: [weights]
    )
    shaping = cr.deep.PolicyReuse(source(observed, values), kl=2.0)
    cr.deep.learn_deep(observed, pulled, cr.learning.Episodes(400), shaping=shaping)
    half = next(k for k, weight in enumerate(weights.seen) if weight == 0.0)
    assert 2.0 >= weights.seen[0] > weights.seen[half - 1] > 0.0
    assert 0.3 < half / len(weights.seen) < 0.7
    assert all(weight == 0.0 for weight in weights.seen[half:])


def gradients(policy, loss):
    policy.zero_grad()
    loss.backward()
    return [
        None if parameter.grad is None else parameter.grad.clone()
        for parameter in policy.parameters()
    ]


@pytest.mark.parametrize("entropy", [0.0, 0.3])
def test_the_pull_is_a_term_of_its_own_in_the_loss(entropy):
    observed, values, _ = task_and_source()
    shaping = cr.deep.PolicyReuse(source(observed, values), kl=0.7)
    model = model_for(observed, learner(ent_coef=entropy), shaping, seed=9)
    policy = model.policy
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter.add_(0.3 * torch.randn_like(parameter))
    seen, actions = torch.eye(5), torch.tensor([0, 1, 2, 0, 1])

    def loss(values, log_prob, entropies):  # any that an algorithm may compute
        return (
            (log_prob.exp() * torch.arange(5)).mean() - entropy * entropies.mean() + values.mean()
        )

    computed = gradients(policy, loss(*policy.evaluate_actions(seen, actions)))
    policy.kl_weight = 0.0
    plain = loss(*policy.evaluate_actions(seen, actions))
    wanted = policy.source.get_distribution(seen).distribution.probs.detach()
    logs = policy.get_distribution(seen).distribution.logits
    far = (wanted * (wanted.log() - logs)).sum(dim=1).mean()
    explicit = gradients(policy, plain + 0.7 * far)
    assert far > 0.01
    for gradient, other in zip(computed, explicit, strict=True):
        assert (gradient is None) == (other is None)
        assert gradient is None or torch.allclose(gradient, other, atol=1e-6)


class Annealed(BaseCallback):
    """Sets the weight of the entropy, and notes what it was."""

    seen = ()

    def _on_step(self):
        self.seen = (*self.seen, self.model.ent_coef)
        self.model.ent_coef = self.model.ent_coef / 2
        return True


def test_the_weight_of_the_entropy_stays_the_learners_own():
    observed, values, _ = task_and_source()
    shaping = cr.deep.WeightTransfer(source(observed, values), kl=0.7)
    model, halved = model_for(observed, learner(ent_coef=0.5), shaping, seed=9), Annealed()
    model.learn(64, callback=halved)
    assert halved.seen[:3] == (0.5, 0.25, 0.125)


def test_a_pull_takes_noise_that_depends_on_the_state():
    task = cr.observation_task("Pendulum-v1", time_limit=16)
    settings = {**learner().settings, "use_sde": True}
    noisy = cr.deep.DeepLearner("PPO", envs=2, settings=settings)
    policy = learn_off(task, noisy, None).values[0]
    near = learn_off(task, noisy, cr.deep.PolicyReuse(policy, kl=1.0))
    assert np.isfinite(near.values[0].v(np.zeros((1, 3), np.float32))).all()


def learn_off(task, chosen, shaping):
    off = cr.GreedyEvaluation(method="off")
    return cr.deep.learn_deep(task, chosen, 128, shaping=shaping, evaluation=off)


def test_weights_of_other_layers_and_a_pull_of_an_unknown_policy_are_refused():
    task = cr.observation_task("CartPole-v1")
    network = source(task, NetworkValues(model_for(task, learner()).policy))
    kwargs = {"net_arch": [8], "activation_fn": torch.nn.ReLU}
    for target, kl, says in (
        (cr.deep.DeepLearner("PPO", settings={"policy_kwargs": kwargs}), 0.0, "Tanh in the source"),
        (cr.deep.DeepLearner("PPO", "MlpPolcy"), 0.1, r"must be one of .*: got 'MlpPolcy'"),
    ):
        with pytest.raises(cr.errors.SettingError, match=says):
            model_for(task, target, cr.deep.WeightTransfer(network, kl=kl))


class Parts(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-1, 1, (2,), np.float32)

    def __init__(self, actions):
        self.action_space = actions

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(2, np.float32), {}

    def step(self, action):
        return np.zeros(2, np.float32), float(action[0]), False, False, {}


def test_a_pull_takes_actions_of_several_parts():
    actions = gymnasium.spaces.MultiDiscrete([2, 3])
    task = cr.observation_task(partial(Parts, actions), discount=0.9, time_limit=10)
    first = model_for(task, learner(), seed=1)
    shaping = cr.deep.WeightTransfer(source(task, NetworkValues(first.policy)), kl=1.0)
    model = model_for(task, learner(), shaping, seed=2)
    seen, weights = torch.zeros((4, 2)), Weights()
    with torch.no_grad():
        model.policy.evaluate_actions(seen, torch.zeros((4, 2)))
        assert torch.allclose(model.policy._distance(seen), torch.zeros(4), atol=1e-6)
    model.learn(256, callback=weights)
    assert weights.seen[1] > 0
