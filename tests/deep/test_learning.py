"""Training deep learners: curves, budgets, stopping, shapings, and runs that are resumed."""

import importlib
import random
from functools import partial
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
import torch
from stable_baselines3.common.callbacks import BaseCallback

import curricle as cr
from curricle.deep import models
from curricle.deep.learner import LIBRARIES
from curricle.deep.models import model_for
from curricle.deep.networks import NetworkValues, acting
from curricle.interop.gymnasium import TaskEnvironment
from curricle.tasks.kernel import splitmix64, stream_start
from curricle.transfer.rollouts import Environments, mean_episode_return

from .worlds import one_hot, table_potential

MAZE = cr.GridWorld(["..T", ".#.", "S.."], time_limit=30, rewards=cr.Rewards(treasure=10))
QUICK = {"learning_starts": 20, "train_freq": 4, "policy_kwargs": {"net_arch": [16]}}
DQN = cr.deep.DeepLearner("DQN", settings={**QUICK, "learning_rate": 1e-3})
PPO = cr.deep.DeepLearner("PPO", settings={"n_steps": 64, "policy_kwargs": {"net_arch": [16]}})


@pytest.fixture(scope="module")
def observed():
    return one_hot(MAZE)


def parts(values):
    return [values.parameters()[name] for name in sorted(values.parameters())]


def same(result, other):
    curves = ("steps", "greedy_return", "training_return", "episodes", "steps_used")
    assert all(
        np.array_equal(getattr(result, name), getattr(other, name), equal_nan=True)
        for name in curves
    )
    for values, other_values in zip(result.values, other.values, strict=True):
        pairs = zip(parts(values), parts(other_values), strict=True)
        assert all(np.array_equal(a, b) for a, b in pairs)


def test_checkpoints_between_the_steps_of_many_environments_are_recorded(observed):
    many = cr.deep.DeepLearner("DQN", envs=8, settings=QUICK)
    result = cr.deep.learn_deep(observed, many, 20, seeds=2, eval_freq=1)
    assert result.steps_used.tolist() == [24, 24]
    assert result.steps.tolist() == list(range(25))
    assert np.isfinite(result.greedy_return).all()


def test_a_seed_depends_on_nothing_but_itself_and_leaves_no_trace(observed):
    torch.manual_seed(1)
    before = models.generator_states()
    alone = cr.deep.learn_deep(observed, DQN, 200, seeds=[3])
    after = models.generator_states()
    assert random.getstate() == before[0]
    assert torch.equal(before[2], after[2])
    random.seed(5)
    both = cr.deep.learn_deep(observed, DQN, 200, seeds=[8, 3])
    assert np.array_equal(alone.greedy_return[0], both.greedy_return[1])
    for part, other in zip(parts(alone.values[0]), parts(both.values[1]), strict=True):
        assert np.array_equal(part, other)


def test_a_run_ends_at_its_budget_in_steps_or_episodes(observed):
    assert cr.deep.learn_deep(observed, PPO, 150).steps_used.tolist() == [150]
    counted = cr.deep.learn_deep(observed, DQN, cr.Episodes(4))
    assert counted.episodes_used.tolist() == [4]
    assert counted.steps_used[0] <= 4 * 30


LAST = [
    (PPO, 64),
    (PPO, 192),
    (cr.deep.DeepLearner("A2C", envs=2, settings={"n_steps": 5}), 10),
    (DQN, 40),
    (cr.deep.DeepLearner("DQN", envs=2, settings={**QUICK, "train_freq": 32}), 64),
]


@pytest.mark.parametrize(("learner", "budget"), LAST)
def test_the_last_rollout_is_learnt_from_and_what_it_taught_is_reported(observed, learner, budget):
    sampled = cr.GreedyEvaluation(episodes=40, sampled=True)
    result = cr.deep.learn_deep(observed, learner, budget, eval_freq=budget, evaluation=sampled)
    start = stream_start(0, "")
    with models.isolated(1):
        alone = model_for(observed, learner, seed=splitmix64(start) >> 33, steps=budget)
        before = NetworkValues(alone.policy).parameters()
        alone.learn(budget)
        environments = Environments(observed, 40, sampled.horizon(observed))
        act = acting(alone.policy, environments.environments, sampled=True)
        with models.isolated(seed=splitmix64(start ^ 2)):
            episodes = environments.rollouts(act, splitmix64(start ^ 2))
    learnt = result.values[0].parameters()
    for name, wanted in NetworkValues(alone.policy).parameters().items():
        assert np.array_equal(learnt[name], wanted)
    assert any(not np.array_equal(learnt[name], before[name]) for name in before)
    assert result.steps_used.tolist() == [budget]
    assert result.greedy_return[0, -1] == mean_episode_return(episodes, 1.0)


def test_a_stopping_rule_ends_a_run_where_it_says(observed):
    rule = cr.StoppingRule(max_steps=2000, threshold=-1e9, patience=2)
    result = cr.deep.learn_deep(observed, DQN, rule, eval_freq=50)
    assert result.steps_used.tolist() == [50]
    assert result.steps.tolist() == [0, 50]
    with pytest.raises(cr.errors.SettingError, match="give a return instead"):
        cr.deep.learn_deep(observed, DQN, cr.StoppingRule(max_steps=2000, fraction=0.5))


def test_charges_and_warm_ups_are_on_the_budget(observed):
    warm_up = cr.learning.WarmUp(np.array([30, 25]), np.array([-30.0, -15.0]))
    result = cr.deep.learn_deep(observed, DQN, 300, eval_freq=50, warm_up=[warm_up], charged=[100])
    assert result.steps_used.tolist() == [200]
    assert result.training_return[0, 1] == -30.0
    assert np.isfinite(result.greedy_return[0, :5]).all()
    assert result.greedy_return[0, 0] == result.greedy_return[0, 1]


@pytest.mark.parametrize(
    ("learner", "way"), [(DQN, cr.QInitialisation), (DQN, cr.StateShaping), (PPO, cr.StateShaping)]
)
@pytest.mark.parametrize("kills", [1, 4])
def test_a_killed_run_goes_on_to_the_same_result(
    observed, tmp_path, monkeypatch, learner, way, kills
):
    phi = table_potential(MAZE, observed, cr.solve(MAZE).action_values / 2)
    settings = {"shaping": way(phi), "eval_freq": 100, "seeds": [2]}
    whole = cr.deep.learn_deep(observed, learner, 400, **settings)
    saved, save = [], models.Recorder._save

    def killed(recorder):
        save(recorder)
        saved.append(recorder.progress.steps)
        raise KeyboardInterrupt

    monkeypatch.setattr(models.Recorder, "_save", killed)
    for _ in range(kills):
        with pytest.raises(KeyboardInterrupt):
            cr.deep.learn_deep(observed, learner, 400, **settings, saves=tmp_path)
    monkeypatch.setattr(models.Recorder, "_save", save)
    assert 0 < saved[0] < 400
    assert saved == sorted(set(saved))
    same(whole, cr.deep.learn_deep(observed, learner, 400, **settings, saves=tmp_path))
    same(whole, cr.deep.learn_deep(observed, learner, 400, **settings, saves=tmp_path))


NAN, ZERO = float("nan"), -0.0


@pytest.mark.parametrize("dtype", ["float32", "float64", "float16", "int64", "uint8", "bool"])
@pytest.mark.parametrize("special", [[0], [1], [255], [256], [-1], [0.5], [NAN], [ZERO], [1e30]])
def test_large_arrays_are_saved_bit_by_bit(tmp_path, dtype, special):
    with np.errstate(all="ignore"):
        content = np.zeros((2**10, 1, 2**10), dtype)
        content[:7] = np.arange(2**10) % 200
        content[3, 0, 5] = np.array(special).astype(dtype)[0]
    kept = {"whole": content, "again": content, "none": np.zeros(2**17), "turned": content.T}
    models.save_checkpoint(tmp_path / "one", "run", SimpleNamespace(**kept), None)
    filled = 7 * 2**10 * content.itemsize  # of `whole`; `turned` does not end in zeros
    assert (tmp_path / "one").stat().st_size < content.nbytes + filled + 50_000
    held = models.load_checkpoint(tmp_path / "one", "run").model[1]
    for name, array in kept.items():
        assert held[name].dtype == array.dtype
        assert held[name].tobytes() == array.tobytes()
    assert held["whole"] is held["again"]
    held["whole"][0, 0, 0] = 1  # as a buffer is written to


def test_a_checkpoint_of_something_else_is_refused(observed, tmp_path):
    cr.deep.learn_deep(observed, DQN, 100, saves=tmp_path)
    with pytest.raises(cr.errors.StoreError, match="belongs to one run"):
        cr.deep.learn_deep(observed, DQN, 200, saves=tmp_path)
    for changed in ({"eval_freq": 50}, {"evaluation": cr.GreedyEvaluation(episodes=2)}):
        with pytest.raises(cr.errors.StoreError, match="belongs to one run"):
            cr.deep.learn_deep(observed, DQN, 100, saves=tmp_path, **changed)
    (tmp_path / "seed-0.checkpoint").write_bytes(b"nonsense")
    with pytest.raises(cr.errors.StoreError, match="must be written by curricle"):
        cr.deep.learn_deep(observed, DQN, 100, saves=tmp_path)


def test_a_checkpoint_of_another_schedule_is_refused(observed, tmp_path):
    def schedule(start, share):
        return start if isinstance(start, partial) else lambda left: start * (left + share)

    def learnt(start, share=0.0):
        settings = {**DQN.settings, "learning_rate": schedule(start, share)}
        learner = cr.deep.DeepLearner("DQN", settings=settings)
        return cr.deep.learn_deep(observed, learner, 100, saves=tmp_path / "function")

    assert np.array_equal(learnt(1e-3).greedy_return, learnt(1e-3).greedy_return)
    for changed in ((1e-1,), (1e-3, 0.5), (partial(pow, 2.0),)):
        with pytest.raises(cr.errors.StoreError, match="belongs to one run"):
            learnt(*changed)
    texts = [repr(cr.deep.DeepLearner(settings={"x": partial(pow, n)})) for n in (2, 3)]
    assert texts == [f"DeepLearner(DQN, MlpPolicy, x=pow({n}))" for n in (2, 3)]


def test_a_checkpoint_of_another_source_is_refused(observed, tmp_path):
    def shaped(height):
        phi = cr.transfer.FunctionValues(state_values=lambda seen: np.full(len(seen), height))
        shaping = cr.StateShaping(phi)
        return cr.deep.learn_deep(observed, DQN, 100, saves=tmp_path, shaping=shaping)

    assert np.array_equal(shaped(1.0).greedy_return, shaped(1.0).greedy_return)
    with pytest.raises(cr.errors.StoreError, match=r"belongs to one source: .* another folder"):
        shaped(2.0)


def test_a_task_of_any_name_is_saved_within_the_folder(observed, tmp_path):
    cr.Curriculum({"../far/maze": observed}, learner=DQN, budget=100).train(saves=tmp_path / "in")
    assert [path.name for path in tmp_path.iterdir()] == ["in"]
    assert len(list((tmp_path / "in").glob("*/seed-0.checkpoint"))) == 1


class Infos(BaseCallback):
    """Keeps what steps tell."""

    seen: ClassVar = []

    def _on_step(self):
        self.seen.extend(self.locals["infos"])
        return True


@pytest.mark.parametrize("shaped", [False, True])
def test_an_environment_that_cannot_be_saved_begins_a_new_episode(tmp_path, monkeypatch, shaped):
    class Shy(TaskEnvironment):
        def __reduce__(self):
            raise TypeError("this environment cannot be pickled")

    task = cr.tasks.ObservationTask(lambda: Shy(MAZE, observation="components"), MAZE.discount)
    save = models.Recorder._save
    row = cr.transfer.FunctionValues(state_values=lambda cells: cells[:, 0].astype(float))
    settings = {"saves": tmp_path, "shaping": cr.StateShaping(row) if shaped else None}
    learner = cr.deep.DeepLearner("DQN", settings=QUICK, callbacks=lambda: [Infos()])

    def killed(recorder):
        save(recorder)
        raise KeyboardInterrupt

    monkeypatch.setattr(models.Recorder, "_save", killed)
    with pytest.raises(KeyboardInterrupt):
        cr.deep.learn_deep(task, learner, 200, **settings)
    monkeypatch.setattr(models.Recorder, "_save", save)
    Infos.seen.clear()
    result = cr.deep.learn_deep(task, learner, 200, **settings)
    assert Infos.seen
    assert all(("shaping" in info) is shaped for info in Infos.seen)
    assert result.steps_used.tolist() == [200]
    assert np.isfinite(result.greedy_return).all()


def test_ones_own_callbacks_are_called_and_may_end_a_run(observed):
    class Until(BaseCallback):
        def _on_step(self):
            return self.num_timesteps < 120

    learner = cr.deep.DeepLearner("DQN", settings=QUICK, callbacks=lambda: [Until()])
    result = cr.deep.learn_deep(observed, learner, 300, seeds=2)
    assert result.steps_used.tolist() == [120, 120]


def test_weights_and_a_policy_are_carried_over(observed):
    source = cr.deep.learn_deep(observed, DQN, 300).values[0]
    still = {**QUICK, "learning_starts": 10_000}
    learner = cr.deep.DeepLearner("DQN", settings=still)
    carried = cr.deep.learn_deep(
        observed, learner, 50, shaping=cr.deep.WeightTransfer(source)
    ).values[0]
    for part, other in zip(parts(source), parts(carried), strict=True):
        assert np.array_equal(part, other)
    critic = cr.deep.learn_deep(observed, PPO, 100).values[0]
    actor = cr.deep.learn_deep(
        observed, PPO, 64, shaping=cr.deep.PolicyReuse(critic), seeds=[9]
    ).values[0]
    rows = np.eye(MAZE.states.size, dtype=np.float32)
    assert not np.array_equal(actor.v(rows), critic.v(rows))
    layers = {**QUICK, "policy_kwargs": {"net_arch": [8, 8]}}
    source = cr.deep.learn_deep(observed, cr.deep.DeepLearner("DQN", settings=layers), 50).values[0]
    for net_arch in ([8], [4, 8], [8, 8, 8]):
        other = cr.deep.DeepLearner("DQN", settings={"policy_kwargs": {"net_arch": net_arch}})
        with pytest.raises(cr.errors.SettingError, match="networks of one shape"):
            cr.deep.learn_deep(observed, other, 50, shaping=cr.deep.WeightTransfer(source))
    with pytest.raises(cr.errors.SettingError, match="in the source and missing in the target"):
        cr.deep.learn_deep(observed, DQN, 50, shaping=cr.deep.PolicyReuse(critic))
    table = table_potential(MAZE, observed, cr.solve(MAZE).action_values)
    with pytest.raises(cr.errors.SettingError, match="a single source, a network"):
        cr.deep.learn_deep(observed, DQN, 50, shaping=cr.deep.WeightTransfer(table))


def test_a_reused_policy_is_acted_on_at_first(observed):
    phi = table_potential(MAZE, observed, cr.solve(MAZE).action_values)
    lazy = cr.deep.DeepLearner("DQN", settings={**QUICK, "learning_starts": 10_000})
    plain, reusing = (
        cr.deep.learn_deep(observed, lazy, 400, eval_freq=100, shaping=cr.deep.PolicyReuse(prior))
        for prior in (None, phi)
    )
    assert reusing.training_return[0, 1] > plain.training_return[0, 1]
    assert np.array_equal(plain.greedy_return[:, 0], reusing.greedy_return[:, 0])


class Rates(BaseCallback):
    """Keeps the share of the budget that is left, and how often a learner explores."""

    seen: ClassVar = []

    def _on_step(self):
        self.seen.append((self.model._current_progress_remaining, self.model.exploration_rate))
        return True


@pytest.mark.parametrize("way", [None, cr.deep.PolicyReuse])
def test_schedules_follow_a_budget_in_episodes(observed, way):
    settings = {**QUICK, "exploration_fraction": 0.5, "exploration_final_eps": 0.1}
    learner = cr.deep.DeepLearner("DQN", settings=settings, callbacks=lambda: [Rates()])
    phi = table_potential(MAZE, observed, cr.solve(MAZE).action_values)
    shaping = None if way is None else way(phi)
    Rates.seen.clear()
    cr.deep.learn_deep(observed, learner, cr.learning.Episodes(4), shaping=shaping)
    assert dict(Rates.seen[1:]) == pytest.approx({1.0: 1.0, 0.75: 0.55, 0.5: 0.1, 0.25: 0.1})


@pytest.mark.parametrize(("episodes", "envs"), [(2, 8), (1, 3), (9, 8)])
def test_episodes_are_counted_in_several_environments(observed, episodes, envs):
    many = cr.deep.DeepLearner("PPO", envs=envs, settings={"n_steps": 16, "batch_size": 16})
    result = cr.deep.learn_deep(observed, many, cr.learning.Episodes(episodes), eval_freq=10)
    assert result.episodes[0].max() <= episodes + envs - 1
    assert result.steps_used[0] <= (episodes + envs - 1) * MAZE.time_limit + envs - 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"learner": cr.QLearning()}, "learner must be a DeepLearner"),
        (
            {"shaping": cr.StateShaping(portfolio=cr.Portfolio())},
            "a portfolio is for learners with tables",
        ),
        ({"evaluation": cr.GreedyEvaluation("exact")}, "since an exact evaluation needs tables"),
        ({"learner": cr.deep.DeepLearner("PPO")}, "a budget must hold a rollout of PPO"),
        ({"learner": cr.deep.DeepLearner("DNQ")}, "an algorithm must be one of"),
    ],
)
def test_what_makes_no_sense_is_refused(observed, arguments, message):
    with pytest.raises(cr.errors.SettingError, match=message):
        cr.deep.learn_deep(observed, **{"budget": 100, **arguments})


def test_networks_have_values(observed):
    rows = np.eye(MAZE.states.size, dtype=np.float32)
    critic = cr.deep.learn_deep(observed, PPO, 100).values[0]
    assert critic.v(rows).shape == (len(rows),)
    with pytest.raises(cr.errors.PotentialError, match="cannot tell actions apart"):
        critic.q(rows, np.tile(np.arange(4), (len(rows), 1)))
    table = cr.deep.learn_deep(observed, DQN, 30).values[0]
    for action in (-1, 4):
        with pytest.raises(cr.errors.PotentialError, match=f"4 actions only: action {action} is"):
            table.q(rows[:2], np.array([0, action]))
    soft = cr.deep.DeepLearner("SAC", settings={"learning_starts": 20})
    swing = cr.observation_task("Pendulum-v1", time_limit=20)
    values = cr.deep.learn_deep(swing, soft, 40).values[0]
    seen = np.zeros((3, 3), dtype=np.float32)
    assert values.q(seen, np.zeros((3, 1))).shape == values.v(seen).shape == (3,)
    assert not values.of_actions


def test_the_potential_is_added_to_values_learnt_with_state_shaping(observed):
    phi = table_potential(MAZE, observed, cr.solve(MAZE).action_values)
    result = cr.deep.learn_deep(observed, DQN, 60, shaping=cr.StateShaping(phi))
    (values,) = result.values
    rows = np.eye(MAZE.states.size, dtype=np.float32)
    bare = cr.deep.NetworkValues(values.policy)
    assert values.v(rows) == pytest.approx(bare.v(rows) + phi.v(rows))


def test_a_deep_node_is_calibrated_by_episodes_it_is_charged_for(observed):
    mapping = cr.transfer.ObservationMapping(observed, MAZE, lambda rows: rows.argmax(axis=1))
    edge = cr.Transfer("maze", "deep", mapping, calibrate=cr.transfer.Calibrate(20))
    plan = cr.Curriculum(
        {"maze": MAZE, "deep": observed}, [edge],
        learner={"deep": DQN}, budget={"maze": cr.StoppingRule(5000), "deep": 600},
    )  # fmt: skip
    result = plan.train(seeds=1)
    (fitted,) = result.calibrations["deep"]
    assert not fitted.refusal
    assert fitted.steps > 0
    assert result["deep"].steps_used.tolist() == [600]
    assert result.source_steps("deep").tolist() == [5000]


def test_algorithms_whose_exploration_falls_are_known_without_importing_them():
    for library in map(importlib.import_module, LIBRARIES):
        for name in (name for name in library.__all__ if isinstance(getattr(library, name), type)):
            learner = cr.deep.DeepLearner(name)
            assert learner.scheduled == ("exploration_fraction" in learner.takes)
