"""What is known of observations is distilled into networks of every kind."""

import numpy as np
import pytest

import curricle as cr
from curricle.deep import DeepLearner
from curricle.deep.distillation import Distillation, distil
from curricle.deep.miniature import Knowledge

from .worlds import one_hot

WELL = Distillation(updates=1_500, batch_size=64, learning_rate=5e-3)
SMALL = {"policy_kwargs": {"net_arch": [32]}}


def solved_maze():
    maze = cr.GridWorld(["..T", ".P.", "S.."])
    observed, solution = one_hot(maze), cr.solve(maze)
    live = np.flatnonzero(~maze.mdp.terminal)
    rows = np.eye(maze.states.size, dtype=np.float32)[live]
    known = Knowledge.of(rows, solution.action_values[live], solution.policy[live])
    return maze, observed, known, solution, live


def agreement(values, known):
    """The share of observations in which a network does one of the best things that are known."""
    chosen = known.policy[
        np.arange(len(known.values)),
        values.policy.predict(known.observations, deterministic=True)[0],
    ]
    return (chosen >= known.policy.max(axis=1) - 1e-12).mean()


@pytest.mark.parametrize("algorithm", ["PPO", "A2C"])
def test_an_actor_critic_is_fitted_to_values_and_policy(algorithm):
    _, observed, known, solution, live = solved_maze()
    values = distil(known, observed, DeepLearner(algorithm, settings=SMALL), WELL)
    spread = solution.values[live].std()
    error = values.v(known.observations) - known.values
    assert np.sqrt((error**2).mean()) < 0.05 * spread
    assert agreement(values, known) == 1
    assert not values.of_actions


@pytest.mark.parametrize("algorithm", ["DQN", "QRDQN"])
def test_a_q_network_is_fitted_to_action_values(algorithm):
    if algorithm == "QRDQN":
        pytest.importorskip("sb3_contrib")
    _, observed, known, solution, live = solved_maze()
    values = distil(known, observed, DeepLearner(algorithm, settings=SMALL), WELL)
    wanted = solution.action_values[live]
    q = values.q(known.observations, np.tile(np.arange(4), (len(live), 1)))
    assert np.sqrt(((q - wanted) ** 2).mean()) < 0.1 * wanted.std()
    net = "q_net" if algorithm == "DQN" else "quantile_net"
    online, other = (getattr(values.policy, name).state_dict() for name in (net, f"{net}_target"))
    assert all((online[name] == other[name]).all() for name in online)


def test_the_same_seed_gives_the_same_bits_and_another_does_not():
    _, observed, known, *_ = solved_maze()
    settings = DeepLearner("PPO"), Distillation(updates=20)
    fits = [distil(known, observed, *settings, seed=seed).parameters() for seed in (1, 1, 2)]
    assert all((fits[0][name] == fits[1][name]).all() for name in fits[0])
    assert any((fits[0][name] != fits[2][name]).any() for name in fits[0])


@pytest.mark.parametrize("form", [np.asarray, lambda seen: {"a": seen, "b": np.zeros(len(seen))}])
def test_states_that_look_alike_get_their_mean(form):
    seen = np.array([[0.0], [0.0], [0.0], [1.0]], np.float32)
    q = np.array([[1.0, 0.0], [3.0, 0.0], [0.0, 5.0], [0.0, 2.0]])
    known = Knowledge.of(form(seen), q, np.eye(2)[[0, 0, 1, 1]])
    parts = known.observations
    assert (parts["a"] if isinstance(parts, dict) else parts).tolist() == [[0.0], [1.0]]
    assert known.states.tolist() == [3, 1]
    assert known.values == pytest.approx([3.0, 2.0])
    assert known.action_values == pytest.approx(np.array([[4 / 3, 5 / 3], [0.0, 2.0]]))
    assert known.policy == pytest.approx(np.array([[2 / 3, 1 / 3], [0.0, 1.0]]))
    assert known.alike == 0.75


def test_shuffled_answers_are_the_same_answers_of_others():
    _, _, known, *_ = solved_maze()
    mixed = known.shuffled(4)
    assert (mixed.observations == known.observations).all()
    assert sorted(mixed.values) == pytest.approx(sorted(known.values))
    assert not np.array_equal(mixed.values, known.values)
    pairs = [(value, *row) for value, row in zip(known.values, known.policy, strict=True)]
    mixed_pairs = [(value, *row) for value, row in zip(mixed.values, mixed.policy, strict=True)]
    assert sorted(mixed_pairs) == sorted(pairs)


def test_knowledge_of_other_actions_or_learners_is_refused():
    _, observed, known, *_ = solved_maze()
    few = Knowledge.of(known.observations, known.action_values[:, :2], known.policy[:, :2])
    with pytest.raises(cr.errors.SettingError, match=r"actions, Discrete\(4\): got 2"):
        distil(few, observed, DeepLearner("PPO"))
