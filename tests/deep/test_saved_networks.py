"""Results of networks: saved as plain arrays, loaded with the networks built again, watched."""

import numpy as np
import pytest

import curricle as cr
from curricle.curriculum import CurriculumResult
from curricle.deep import DeepLearner, DeepResult, learn_deep
from curricle.errors import SettingError, StoreError

from .worlds import ACTOR, DEEP_Q, LAKE, MAZE, one_hot, table_potential

ROWS = np.eye(16, dtype=np.int64)


@pytest.fixture(scope="module")
def lake():
    return learn_deep(LAKE, ACTOR, 128, seeds=[5, 2], eval_freq=64)


def parameters(result):
    return [one.parameters() for one in result.values]


def same_networks(one, other):
    for mine, yours in zip(parameters(one), parameters(other), strict=True):
        assert mine.keys() == yours.keys()
        for name, value in mine.items():
            assert np.array_equal(value, yours[name])


def test_networks_are_loaded_as_they_were(tmp_path, lake):
    file = lake.save(tmp_path / "lake")
    again = DeepResult.load(file, LAKE, ACTOR)
    same_networks(lake, again)
    assert again.save(tmp_path / "two").read_bytes() == file.read_bytes()
    assert again.learner == ACTOR
    for mine, yours in zip(lake.policies, again.policies, strict=True):
        assert np.array_equal(mine.predict(ROWS), yours.predict(ROWS))
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
    for mine, yours in zip(result.values, again.values, strict=True):
        assert np.array_equal(mine.v(rows), yours.v(rows))
    each = DeepResult.load(file, task, DEEP_Q, shaping=[shaped, shaped])
    assert np.array_equal(each.values[1].v(rows), result.values[1].v(rows))
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
        for mine, yours in zip(result[name].values, again[name].values, strict=True):
            # phi is cached as the batch it was first computed in rounds it.
            np.testing.assert_allclose(mine.v(ROWS), yours.v(ROWS), rtol=1e-6)
    assert again.save(tmp_path / "two").read_bytes() == file.read_bytes()
    assert np.array_equal(again.policy.predict(ROWS), result.policy.predict(ROWS))
    small = DeepLearner("DQN", settings={"policy_kwargs": {"net_arch": [8]}})
    other = cr.Curriculum({"alone": LAKE, "lake": LAKE}, [edge], learner=small, budget=64)
    with pytest.raises(SettingError, match="with the learners they were trained with: Error"):
        CurriculumResult.load(file, other)
    given = plan.train(seeds=2, trained={"alone": result.sources["alone"]})
    loaded = CurriculumResult.load(given.save(tmp_path / "given"), plan)
    same_networks(loaded.given["alone"], given.given["alone"])


@pytest.mark.parametrize(
    ("task", "learner", "words"),
    [
        (cr.observation_task("CartPole-v1"), ACTOR, "own task: .* has observations"),
        (LAKE, DEEP_Q, "the task, learner and shaping they were trained with: .*DQN"),
        (
            LAKE,
            DeepLearner("PPO", settings={"n_steps": 64, "policy_kwargs": {"net_arch": [8]}}),
            "does not take these parameters",
        ),
        (LAKE, "PPO", "learner must be a DeepLearner"),
    ],
)
def test_another_task_or_learner_is_one_sentence(tmp_path, lake, task, learner, words):
    file = lake.save(tmp_path / "lake")
    with pytest.raises(SettingError, match=words) as found:
        DeepResult.load(file, task, learner)
    assert "\n" not in str(found.value)


def test_a_policy_that_cannot_be_written_leaves_nothing(tmp_path, lake, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(StoreError, match=r"cannot be written to .*lake.zip: No space left"):
        lake.policy.save(tmp_path / "lake")
    with pytest.raises(StoreError, match=r"not at a URL: got 's3://b/lake'"):
        lake.policy.save("s3://b/lake")
    assert not list(tmp_path.iterdir())
