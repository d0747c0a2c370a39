"""Two networks side by side, one with the source: whose turn it is, its cost, and resuming."""

import numpy as np
import pytest
from curricle.deep.turns import Turns
from stable_baselines3.common.callbacks import BaseCallback

import curricle as cr
from curricle.deep import guarding, training
from curricle.deep.models import model_for, network_values
from curricle.deep.shaping import Demonstrations, PolicyReuse, WeightTransfer
from curricle.deep.vec_env import ShapedVecEnv
from curricle.learning.guard import SCRATCH, SHAPED

from .test_miniatures import plan, room
from .worlds import one_hot, random_task, table_potential

MAZE = cr.GridWorld(["..T", ".#.", "S.."], time_limit=30, rewards=cr.Rewards(treasure=10))
SMALL = {"policy_kwargs": {"net_arch": [16]}}
DQN = cr.deep.DeepLearner(
    "DQN", settings={**SMALL, "learning_starts": 20, "learning_rate": 1e-3, "train_freq": 4}
)
PPO = cr.deep.DeepLearner(
    "PPO", envs=2, settings={**SMALL, "n_steps": 16, "batch_size": 32, "n_epochs": 4}
)
GUARD = cr.Guard()
ROWS = np.eye(MAZE.states.size, dtype=np.float32)


@pytest.fixture(scope="module")
def observed():
    return one_hot(MAZE)


@pytest.fixture(scope="module")
def phi(observed):
    return table_potential(MAZE, observed, cr.solve(MAZE).action_values)


def parts(values):
    found = values.parameters()
    return [found[name] for name in sorted(found)]


def distilled(observed, learner, wanted, seed=0):
    """Return a network whose policy has these probabilities."""
    known = cr.deep.Knowledge.of(ROWS, np.zeros_like(wanted), wanted)
    fit = cr.deep.Distillation(updates=400, learning_rate=0.02)
    return cr.deep.distil(known, observed, learner, fit, seed=seed).values


# -- whose turn it is ------------------------------------------------------------------------------


def played(turns, earn, steps):
    """Take so many steps of episodes of 10 steps each; return whose they were, (steps,)."""
    whose = []
    for t in range(steps):
        if t % 10 == 0:
            turns.begin()
        whose.append([turns.acting, turns.ahead])
        ended = [{"episode": {"r": earn(turns.acting)}}] if t % 10 == 9 else [{}]
        turns.step(ended)
    return np.array(whose).T


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("worse", [0.0, 0.5, 5.0])
def test_a_source_that_is_not_ahead_acts_in_no_more_than_the_bound(shared, worse):
    rng = np.random.default_rng(0)
    for _ in range(20):
        turns = Turns(GUARD, envs=1, shared=shared)
        acting, ahead = played(turns, lambda model: rng.normal() - worse * (model == SHAPED), 4_000)
        behind = ahead == SCRATCH
        longest = 20  # two episodes
        spent = (acting[behind] == SHAPED).sum()
        assert spent <= GUARD.share_behind * behind.sum() + longest
        in_front = GUARD.share_ahead * (~behind).sum()
        least = (1 - GUARD.share_behind) * behind.sum() - 2 * longest
        assert (acting == SCRATCH).sum() >= least + (~behind).sum() - in_front
    assert behind.mean() > 0.99 or worse < 5


def test_a_source_that_changes_nothing_leaves_most_steps_to_an_on_policy_scratch():
    rng = np.random.default_rng(1)
    shares = []
    for _ in range(40):
        turns = Turns(GUARD, envs=1, shared=False)
        acting, _ = played(turns, lambda model: rng.normal(), 4_000)
        shares.append((acting == SHAPED).mean())
    assert np.mean(shares) < 0.15


@pytest.mark.parametrize("shared", [False, True])
def test_a_source_that_earns_more_gets_most_steps(shared):
    rng = np.random.default_rng(2)
    turns = Turns(GUARD, envs=1, shared=shared)
    acting, ahead = played(turns, lambda model: rng.normal() + 3 * (model == SHAPED), 4_000)
    assert ahead[-1] == SHAPED
    assert 0.65 < (acting == SHAPED).mean() <= GUARD.share_ahead + 0.01


def test_models_are_compared_once_an_episode_has_ended_in_every_environment():
    turns = Turns(GUARD, envs=2, shared=False)
    short, long = {"episode": {"r": 1.0}}, {"episode": {"r": 0.0}}
    for _ in range(5):  # one of them ends again and again
        turns.step([short, {}])
        turns.begin()
    assert turns.acting == SHAPED
    turns.step([short, long])
    turns.begin()
    assert turns.acting == SCRATCH
    assert turns.tally.mean[SHAPED] == pytest.approx(6 / 7)
    assert turns.longest == 12


# -- learning --------------------------------------------------------------------------------------


class Whose(BaseCallback):
    """Notes which model took each step, and what is counted."""

    def __init__(self):
        super().__init__()
        self.seen, self.counted = [], []

    def _on_step(self):
        self.seen.append(self.locals["self"] is not self.model)
        self.counted.append(self.num_timesteps)
        return True


@pytest.mark.parametrize(("learner", "size"), [(PPO, 2), (DQN, 1)])
def test_steps_count_over_both_models(observed, phi, learner, size):
    whose = Whose()
    counting = cr.deep.DeepLearner(
        learner.algorithm, envs=size, settings=learner.settings, callbacks=lambda: [whose]
    )
    result = cr.deep.learn_deep(
        observed, counting, 800, eval_freq=200, shaping=cr.StateShaping(phi, GUARD)
    )
    assert whose.counted == list(range(size, 801, size))
    assert 0 < np.mean(whose.seen) < 1
    assert result.steps_used.tolist() == [800]
    assert result.guard_share[0, 0] == 0.5
    assert (result.guard_share[0, -1] >= GUARD.share_behind).all()
    assert np.isnan(cr.deep.learn_deep(observed, learner, 64).guard_share).all()


def ways(observed, phi):
    actor = model_for(observed, PPO, seed=5).policy
    q = model_for(observed, DQN, seed=5).policy
    source = cr.deep.NetworkValues
    return {
        ("PPO", "reuse"): PolicyReuse(source(actor), GUARD),
        ("PPO", "kl"): PolicyReuse(source(actor), GUARD, kl=1.0),
        ("PPO", "weights"): WeightTransfer(source(actor), GUARD),
        ("PPO", "residual critic"): cr.QInitialisation(phi, GUARD),
        ("PPO", "shaped"): cr.StateShaping(phi, GUARD),
        ("DQN", "reuse"): PolicyReuse(source(q), GUARD),
        ("DQN", "weights"): WeightTransfer(source(q), GUARD),
        ("DQN", "residual"): cr.QInitialisation(phi, GUARD),
        ("DQN", "shaped"): cr.StateShaping(phi, GUARD),
    }


NAMES = [
    *(("PPO", way) for way in ("reuse", "kl", "weights", "residual critic", "shaped")),
    *(("DQN", way) for way in ("reuse", "weights", "residual", "shaped")),
]


@pytest.mark.parametrize("name", NAMES, ids=" ".join)
def test_a_killed_run_goes_on_to_the_same_result(observed, phi, tmp_path, monkeypatch, name):
    learner = PPO if name[0] == "PPO" else DQN
    settings = {"shaping": ways(observed, phi)[name], "eval_freq": 160, "seeds": [2]}
    whole = cr.deep.learn_deep(observed, learner, 640, **settings)
    save = training.Recorder._save

    def killed(recorder):
        save(recorder)
        raise KeyboardInterrupt

    monkeypatch.setattr(training.Recorder, "_save", killed)
    for _ in range(3):
        with pytest.raises(KeyboardInterrupt):
            cr.deep.learn_deep(observed, learner, 640, **settings, saves=tmp_path)
    monkeypatch.setattr(training.Recorder, "_save", save)
    resumed = cr.deep.learn_deep(observed, learner, 640, **settings, saves=tmp_path)
    for curve in ("greedy_return", "training_return", "guard_share", "episodes"):
        one, other = getattr(whole, curve), getattr(resumed, curve)
        assert np.array_equal(one, other, equal_nan=True), curve
    for one, other in zip(parts(whole.values[0]), parts(resumed.values[0]), strict=True):
        assert np.array_equal(one, other)


def test_environments_that_cannot_be_saved_begin_new_episodes(phi, tmp_path, monkeypatch):
    class Shy(cr.interop.TaskEnvironment):
        def __reduce__(self):
            raise TypeError("this environment cannot be pickled")

    task = cr.tasks.ObservationTask(lambda: Shy(MAZE, observation="components"), MAZE.discount)
    row = cr.transfer.FunctionValues(state_values=lambda cells: cells[:, 0].astype(float))
    settings = {"saves": tmp_path, "shaping": cr.StateShaping(row, GUARD)}
    save = training.Recorder._save

    def killed(recorder):
        save(recorder)
        raise KeyboardInterrupt

    for learner, seed in ((PPO, 0), (DQN, 1)):
        monkeypatch.setattr(training.Recorder, "_save", killed)
        with pytest.raises(KeyboardInterrupt):
            cr.deep.learn_deep(task, learner, 320, seeds=[seed], **settings)
        monkeypatch.setattr(training.Recorder, "_save", save)
        result = cr.deep.learn_deep(task, learner, 320, seeds=[seed], **settings)
        assert result.steps_used.tolist() == [320]


def test_the_model_without_the_source_is_the_one_of_scratch(observed, phi):
    for learner in (PPO, DQN):
        guarded = guarding.guarded_model(
            observed, learner, cr.StateShaping(phi, GUARD), seed=7, steps=100
        )
        alone = model_for(observed, learner, seed=7, steps=100)
        mine, theirs = guarded.policy.state_dict(), alone.policy.state_dict()
        assert all((mine[name] == theirs[name]).all() for name in mine)
        assert not isinstance(guarded.env, ShapedVecEnv)


def test_both_learn_from_one_replay_buffer_each_by_its_rewards(observed, phi):
    shaping = cr.StateShaping(phi, GUARD)
    model = guarding.guarded_model(observed, DQN, shaping, seed=3, steps=400)
    assert model.replay_buffer is not model.shaped.replay_buffer
    model.learn(400)
    plain, shaped = model.replay_buffer, model.shaped.replay_buffer
    assert plain.size() == shaped.size() == 400
    assert np.array_equal(plain.observations, shaped.observations)
    venv = ShapedVecEnv(model_for(observed, DQN).env, phi)  # its rule, on the same steps
    discount = venv.discount
    terminated = plain.dones * (1 - plain.timeouts) == 1
    after = np.where(terminated, 0.0, phi.v(plain.next_observations[:, 0])[:, None])
    extra = discount * after - phi.v(plain.observations[:, 0])[:, None]
    assert (shaped.rewards - plain.rewards) == pytest.approx(extra, abs=1e-4)
    reuse = guarding.guarded_model(observed, DQN, cr.QInitialisation(phi, GUARD), seed=3, steps=400)
    assert reuse.replay_buffer is reuse.shaped.replay_buffer


def test_demonstrations_are_not_in_the_buffer_of_scratch():
    curriculum = plan(Demonstrations(guard=GUARD, steps=50), learner=DQN, budget=100)
    result = curriculum.train(seeds=1)
    assert result["large"].guard_share[0, 0] == 0.5
    (phi,) = result.potentials["large"]
    model = guarding.guarded_model(
        room(8), DQN, Demonstrations(phi, GUARD, steps=50), seed=3, steps=400
    )
    model.learn(40)
    assert model.shaped.replay_buffer.size() >= 90
    assert model.replay_buffer.size() == 40


@pytest.mark.parametrize("ahead", [SCRATCH, SHAPED])
def test_stored_networks_are_those_of_the_model_that_was_ahead(observed, phi, ahead):
    for learner, way in (
        (PPO, cr.QInitialisation),
        (DQN, cr.QInitialisation),
        (DQN, cr.StateShaping),
    ):
        shaping = way(phi, GUARD)
        model = guarding.guarded_model(observed, learner, shaping, seed=3, steps=400)
        model.learn(128)
        model.turns.ahead = ahead
        values = guarding.learnt_values(model, shaping)()
        assert values.without_source is (ahead == SCRATCH)
        again = network_values(observed, learner, shaping, values.parameters())
        assert again.v(ROWS) == pytest.approx(values.v(ROWS), abs=1e-5)
        assert again.without_source is values.without_source


def actors(observed, learner):
    """Return networks that act as the optimal policy does, and as the worst one."""
    q = cr.solve(MAZE).action_values
    best = (q >= q.max(axis=1, keepdims=True) - 1e-9) * 1.0
    worst = (q <= q.min(axis=1, keepdims=True) + 1e-9) * 1.0
    return [
        distilled(observed, learner, each / each.sum(axis=1, keepdims=True))
        for each in (best, worst)
    ]


def returns(observed, learner, shaping, steps=4_000, seeds=2):
    """Return what is earned while learning, by tenths of the steps."""
    found = cr.deep.learn_deep(
        observed, learner, steps, seeds=seeds, shaping=shaping, eval_freq=steps // 10,
        evaluation=cr.GreedyEvaluation("off"),
    )  # fmt: skip
    return found.training_return[:, 1:].mean(axis=0)


def ppo(learning_rate):
    settings = {**PPO.settings, "learning_rate": learning_rate}
    return cr.deep.DeepLearner("PPO", envs=2, settings=settings)


def test_an_adversarial_actor_costs_little(observed):
    learner = ppo(3e-3)
    _, wrong = actors(observed, learner)
    scratch, bare, guarded = (
        returns(observed, learner, shaping)
        for shaping in (None, PolicyReuse(wrong), PolicyReuse(wrong, GUARD))
    )
    span = scratch[-1] - scratch[0]  # from a new network to a trained one
    assert (scratch.mean() - bare.mean()) / span > 0.2
    assert (scratch.mean() - guarded.mean()) / span < 0.1
    assert (scratch[-3:].mean() - guarded[-3:].mean()) / span < 0.1


def test_a_good_actor_keeps_most_of_its_gain(observed):
    learner = ppo(1e-4)  # with which scratch takes long
    right, _ = actors(observed, learner)
    scratch, bare, guarded = (
        returns(observed, learner, shaping)
        for shaping in (None, PolicyReuse(right), PolicyReuse(right, GUARD))
    )
    gain = bare.mean() - scratch.mean()
    assert gain > 10
    assert guarded.mean() - scratch.mean() > 0.6 * gain


# -- what is refused -------------------------------------------------------------------------------


def test_what_a_guard_cannot_do_is_refused(observed, phi):
    endless = cr.tasks.ObservationTask(
        lambda: cr.interop.TaskEnvironment(random_task(np.random.default_rng(0), time_limit=None)),
        0.9,
    )
    row = cr.transfer.FunctionValues(state_values=lambda cells: np.zeros(len(cells)))
    off = cr.GreedyEvaluation("off")
    with pytest.raises(cr.errors.SettingError, match="needs a time limit"):
        cr.deep.learn_deep(endless, DQN, 100, shaping=cr.StateShaping(row, GUARD), evaluation=off)
    lean = {**DQN.settings, "optimize_memory_usage": True}
    lean["replay_buffer_kwargs"] = {"handle_timeout_termination": False}
    with pytest.raises(cr.errors.SettingError, match="keeps each step by itself"):
        cr.deep.learn_deep(
            observed, cr.deep.DeepLearner("DQN", settings=lean), 100,
            shaping=cr.QInitialisation(phi, GUARD),
        )  # fmt: skip
    with pytest.raises(cr.errors.SettingError, match="a guard needs a potential"):
        cr.deep.learn_deep(observed, DQN, 100, shaping=PolicyReuse(guard=GUARD))
    with pytest.raises(cr.errors.SettingError, match="not for a teacher's"):
        cr.deep.teach_deep(
            {"one": observed, "two": observed}, None, DQN, 100, target="one",
            shaping=cr.StateShaping(phi, GUARD),
        )  # fmt: skip
