"""Study files with networks: observed tasks, learners, mappings into them; without torch."""

import numpy as np
import pytest

import curricle as cr
from curricle.comparison.task_differences import differences
from curricle.study import StudyConfig
from curricle.study.arms import Arms
from tests.support.hunters import observed
from tests.support.studies import OBSERVED_HUNT as HUNT, reader

FIRST = HUNT.partition('target = "hunt"\n')[2].partition("[[")[0].rstrip()
"""What the first transfer reads."""
DEEP = 'learner = { type = "deep", settings = { learning_rate = 1e-3 } }'
CART = """
name = "cart"
[learner]
type = "deep"
algorithm = "PPO"
policy = "MlpPolicy"
envs = 2
threads = 2
settings = { n_steps = 64, train_freq = [1, "episode"], policy_kwargs = { net_arch = [8, 8] } }
[tasks.short]
type = "observation_task"
id = "CartPole-v1"
time_limit = 50
[tasks.cart]
type = "observation_task"
id = "CartPole-v1"
discount = 0.98
[[transfers]]
source = "short"
target = "cart"
mapping = "identity"
"""
OWN = """
import gymnasium
import numpy as np

def corridor(length):
    return gymnasium.make("CartPole-v1", max_episode_steps=length)

def no_environment():
    return 3

def leaning(carts):
    return (carts[:, 2] > 0).astype(int)

def upright(carts):
    return abs(carts[:, 2]) < 0.1

def broken(target, source):
    raise ValueError("no idea")

def made(target, source):
    import curricle as cr
    return cr.transfer.ObservationMapping(target, source, leaning, [1, 0])

class Extractor:
    pass
"""


@pytest.fixture
def read(tmp_path):
    (tmp_path / "own.py").write_text(OWN)

    def read_changed(text, *changes):
        for old, new in changes:
            assert old in text
            text = text.replace(old, new, 1)
        return reader(tmp_path)(text)

    return read_changed


def test_a_network_reads_a_table(read):
    plan = read(HUNT).curriculum("transfer")
    assert plan.tasks["hunt"] == observed(2, time_limit=30)
    assert plan.setting("learner", "hunt") == cr.deep.DeepLearner(settings={"learning_rate": 1e-3})
    assert plan.setting("learner", "chase") == cr.QLearning(learning_rate=0.2, epsilon=0.2)
    cells = np.array([[4, 0, 8], [2, 1, 7]])
    for edge, predator in zip(plan.transfers, (1, 2), strict=True):
        states = edge.mapping.observations(cells)
        assert states.tolist() == (9 * cells[:, 0] + cells[:, predator]).tolist()


def test_an_environment_is_seen_as_it_is(read):
    plan = read(CART).curriculum("transfer")
    assert plan.tasks["cart"] == cr.observation_task("CartPole-v1", discount=0.98)
    assert plan.tasks["short"] == cr.observation_task("CartPole-v1", time_limit=50)
    settings = {"n_steps": 64, "train_freq": (1, "episode"), "policy_kwargs": {"net_arch": [8, 8]}}
    expected = cr.deep.DeepLearner("PPO", envs=2, threads=2, settings=settings)
    assert plan.setting("learner", "cart") == expected
    assert plan.transfers[0].mapping.observations is None


def test_environments_of_ones_own_are_made_again_and_again(read):
    def corridor(length):
        factory = f"factory = 'own:corridor'\narguments = {{ length = {length} }}"
        study = read(CART, ('id = "CartPole-v1"\ntime_limit = 50', factory))
        return study.curriculum("transfer").tasks["short"]

    task = corridor(7)
    assert task.longest == 7
    assert task.make() is not task.make()
    assert task == corridor(7)
    (limit, environment) = differences(task, corridor(8))
    assert limit == "time_limit (7 against 8)"
    assert "own:corridor(length=7) against" in environment


def test_classes_of_ones_own_are_named_in_settings(read, tmp_path):
    kwargs = 'policy_kwargs = { features_extractor_class = "own:Extractor" }'
    study = read(CART, ("policy_kwargs = { net_arch = [8, 8] }", kwargs))
    learner = study.curriculum("transfer").setting("learner", "cart")
    extractor = learner.settings["policy_kwargs"]["features_extractor_class"]
    assert extractor.__name__ == "Extractor"
    assert " at 0x" not in repr(learner)
    algorithm = read(CART, ('"PPO"', '"own:Extractor"')).curriculum("transfer")
    assert algorithm.setting("learner", "cart").algorithm_class() is extractor


def test_mappings_are_functions_of_batches(read):
    table = 'observations = "own:leaning"\nstatus = "own:upright"\nactions = [1, -1]\n'
    source = ('id = "CartPole-v1"\ntime_limit = 50', 'map = "ST"')
    tabular = ('type = "observation_task"', 'type = "maze"\nlearner = { type = "QLearning" }')
    edge = ('mapping = "identity"', table + "unmapped_value = -9")
    mapping = read(CART, source, tabular, edge).curriculum("transfer").transfers[0].mapping
    carts = np.zeros((3, 4))
    carts[:, 2] = [-0.05, 0.05, 0.5]
    q = cr.transfer.TableValues(np.array([[1.0, 2.0, 0.0, 0.0], [3.0, 4.0, 0.0, 0.0]]))
    assert mapping.pairs(q, carts).tolist() == [[2, -9], [4, -9], [-9, -9]]
    assert mapping.description == "observations by leaning, actions as 1 -1, status by upright"
    made = ('mapping = "identity"', 'factory = "own:made"')
    mapping = read(CART, source, tabular, made).curriculum("transfer").transfers[0].mapping
    assert mapping.pairs(q, carts).tolist() == [[2, 1], [4, 3], [4, 3]]


def test_a_deep_learner_takes_a_tables_place_and_the_other_way_round(read):
    text = HUNT.replace("[tasks.chase]", "[arms.small.tasks.chase]\nsize = 4\n[tasks.chase]")
    assert read(text).curriculum("small").tasks["chase"].size == 4
    deep = '[learner]\ntype = "deep"\nenvs = 3\nsettings = { batch_size = 8 }\n[tasks.chase]'
    other = HUNT.replace("learner = { learning_rate = 0.2, epsilon = 0.2 }\n", "")
    other = other.replace(f"{DEEP}\n", "")
    settings = 'predators = 1\nlearner = { type = "SARSA" }'
    plan = read(other, ("predators = 1", settings), ("[tasks.chase]", deep)).curriculum("transfer")
    assert plan.setting("learner", "chase") == cr.SARSA()
    assert plan.setting("learner", "hunt") == cr.deep.DeepLearner(
        envs=3, settings={"batch_size": 8}
    )


@pytest.mark.parametrize(
    "name", ["QInitialisation", "LookAheadAdvice", "StateShaping", "WeightTransfer", "PolicyReuse"]
)
def test_every_shaping_of_a_network_may_be_named(read, name):
    plan = read(HUNT, ("aggregate", f"shaping = {name!r}\naggregate")).curriculum("transfer")
    assert plan.setting("shaping", "hunt").name == name
    assert plan.setting("shaping", "hunt").portfolio is None


def test_arms_share_mappings_and_the_whole_survives_json(read, tmp_path):
    study = read(HUNT + "[arms.a]\n[arms.b]\nshaping = 'StateShaping'\n")
    first, second = (study.curricula[arm].transfers[0].mapping for arm in "ab")
    assert first is second
    again = StudyConfig.from_data(study.to_data(), tmp_path)
    assert again.to_data() == study.to_data()
    assert Arms.of(again).keys == Arms.of(study).keys
    assert Arms.of(study).serial
