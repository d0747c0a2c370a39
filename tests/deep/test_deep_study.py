"""Studies with networks: stored as arrays, read again, resumed after a kill, shown as a page."""

import re
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import gymnasium as gym
import numpy as np
import pytest

import curricle as cr
from curricle.cli.output import graph, print_preview, print_results
from curricle.comparison.plan import PlannedArm
from curricle.deep import models
from curricle.errors import ConfigError, SettingError
from curricle.show.report import write_report
from curricle.study import StudyResults, merge, read_study, run_study
from curricle.study.analysis import curricula_record
from curricle.study.arms import Arms
from tests.support.hunters import observed
from tests.support.studies import OBSERVED_HUNT

# A table, then a network on its scaled values, then two others: the last potential needs the
# network before it, which needs the table.
CHAIN = """
name = "chain"
seeds = 2
seeds_per_unit = 1
snapshots = 0
[learner]
type = "deep"
settings = { learning_starts = 50, batch_size = 8, policy_kwargs = { net_arch = [8] } }
[tasks.chase]
type = "pursuit"
size = 3
predators = 1
learner = { type = "QLearning", learning_rate = 0.3 }
budget = { max_steps = 1_000 }
[tasks.alone]
type = "observation_task"
id = "Curricle/Pursuit-v0"
arguments = { size = 3, predators = 1, observation = "components" }
time_limit = 20
budget = { max_steps = 400 }
eval_freq = 100
[tasks.hunt]
type = "observation_task"
id = "Curricle/Pursuit-v0"
arguments = { size = 3, predators = 2, observation = "components" }
time_limit = 20
budget = 400
eval_freq = 200
[[transfers]]
source = "chase"
target = "alone"
observations = "tests.support.hunters:first"
scale = 1.5
[[transfers]]
source = "alone"
target = "hunt"
observations = "tests.support.hunters:second_alone"
actions = [0, 1, 2, 3, 4, 0, 1, 2, 3, 4, 0, 1, 2, 3, 4, 0, 1, 2, 3, 4, 0, 1, 2, 3, 4]
[arms.residual]
[arms.state]
shaping = "StateShaping"
"""
ONE_ARM = "scratch = false\n" + CHAIN.split("[arms.residual]")[0]
"""Its units are some of the whole study's."""


def units(folder):
    """The files of a folder's units."""
    files = (path for path in (folder / "units").rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    path = tmp_path_factory.mktemp("study") / "chain.toml"
    path.write_text(CHAIN)
    return read_study(path)


@pytest.fixture(scope="module")
def whole(study, tmp_path_factory):
    """The folder of the study, run in one go; to be read only."""
    folder = tmp_path_factory.mktemp("whole") / "chain"
    run_study(study, folder)
    return folder


def seen(task, n=40):
    space = task.observations
    space.seed(0)
    return np.stack([space.sample() for _ in range(n)])


def says(values, observations, n_actions):
    eval_freq = np.broadcast_to(np.arange(n_actions), (len(observations), n_actions))
    return np.concatenate([values.q(observations, eval_freq).ravel(), values.v(observations)])


@pytest.mark.parametrize("arm", ["residual", "state"])
def test_networks_read_again_have_the_same_values_bit_for_bit(study, whole, arm):
    arms, stored = Arms.of(study), StudyResults(whole)
    curriculum = arms.curricula[arm]
    trained = curriculum.train(study.seeds, charge=True)
    again = stored.trained(arm, curriculum)["alone"]
    assert again.seeds == (0, 1)
    task, observations = curriculum.tasks["alone"], seen(curriculum.tasks["alone"])
    for loaded, values in zip(again.values, trained["alone"].values, strict=True):
        assert np.array_equal(
            says(loaded, observations, task.n_actions), says(values, observations, task.n_actions)
        )
    hunt = stored.result(arm, "hunt", values=True)
    assert np.array_equal(hunt.greedy_return, trained["hunt"].greedy_return)
    for loaded, values in zip(hunt.values, trained["hunt"].values, strict=True):
        for name, array in values.parameters().items():
            assert np.array_equal(loaded[name], array)


def test_networks_are_plain_arrays(whole):
    units = [unit for unit in StudyResults(whole).store.units() if unit.about.task != "chase"]
    assert len(units) == (2 * 2 + 1) * 2  # two tasks of two arms, and the scratch baseline
    for unit in units:
        with np.load(unit.path, allow_pickle=False) as arrays:
            values = [name for name in arrays.files if name.startswith("values")]
            assert {name.split("/")[0] for name in values} == {"values_0"}
            assert all(arrays[name].dtype == np.float32 for name in values)
    versions = StudyResults(whole).runs[0].versions
    assert {"torch", "stable-baselines3"} <= versions.keys()


@pytest.fixture
def one_arm(tmp_path):
    """One arm of the study as a file."""
    file = tmp_path / "chain.toml"
    file.write_text(ONE_ARM)
    return file


def assert_some_of(whole, here):
    there = units(whole)
    assert len({name.split("/")[1] for name in here}) == 3
    for name, content in here.items():
        assert content == there[name], name


def test_processes_and_shards_change_nothing(whole, one_arm, tmp_path):
    study = read_study(one_arm)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        run_study(study, tmp_path / "a", executor=pool, shard=(1, 2))
    run_study(study, tmp_path / "b", shard=(2, 2))
    merge(tmp_path / "both", [tmp_path / "a", tmp_path / "b"])
    assert_some_of(whole, units(tmp_path / "both"))


def test_a_unit_killed_within_a_network_is_trained_again_whole(
    whole, one_arm, tmp_path, monkeypatch
):
    reach, folder = models.Recorder.reach, tmp_path / "killed"

    def killed(recorder):
        if recorder.checkpoint == 2:
            raise KeyboardInterrupt
        return reach(recorder)

    monkeypatch.setattr(models.Recorder, "reach", killed)
    with pytest.raises(KeyboardInterrupt):
        run_study(read_study(one_arm), folder, workers=1)
    monkeypatch.setattr(models.Recorder, "reach", reach)
    run_study(read_study(one_arm), folder, resume=True)
    assert_some_of(whole, units(folder))


def test_the_page_and_the_tables_tell_of_networks(whole, tmp_path, capsys):
    page = write_report(whole, tmp_path / "report.html").read_text()
    for text in ("observations by second_alone", "DeepLearner(DQN, MlpPolicy"):
        assert text in page, text
    assert ">nan<" not in page
    print_results(StudyResults(whole), None, None)
    assert "2 of 2 seeds finished in every arm" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ("learner.settings.batch_sise=8", "got 'batch_sise', did you mean 'batch_size'?"),
        ("shaping='WeightTransfer'", "must be networks: chase is learnt in a table"),
        ("tasks.hunt.learner={type='deep', algorithm='TD3'}", "of TD3 must be a Box"),
    ],
)
def test_what_the_library_does_not_take_is_refused_before_anything_is_trained(
    study, tmp_path, change, sentence
):
    file = tmp_path / "chain.toml"
    file.write_text(CHAIN)
    with pytest.raises(ConfigError, match=re.escape(sentence)):
        run_study(read_study(file, set=[change]), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("learner", "changes", "depends"),
    [
        ({"algorithm": "DQN"}, {}, "a schedule of DQN"),
        ({"algorithm": "stable_baselines3:PPO"}, {}, "a schedule of stable"),  # may have some
        ({"algorithm": "PPO"}, {}, ""),
        ({"algorithm": "PPO", "settings": {"learning_rate": float}}, {}, ""),
        ({"algorithm": "PPO", "settings": {"learning_rate": abs}}, {}, "a schedule of PPO"),
        ({"algorithm": "PPO"}, {"shaping": cr.deep.WeightTransfer(kl=0.1)}, "its sources' policy"),
        ({"algorithm": "PPO"}, {"shaping": cr.deep.WeightTransfer()}, ""),
        ({"algorithm": "PPO"}, {"shaping": cr.deep.PolicyReuse()}, ""),
        ({"algorithm": "SAC"}, {"shaping": cr.deep.PolicyReuse()}, "its sources' policy"),
    ],
)
def test_a_record_says_why_what_is_learnt_depends_on_the_total(learner, changes, depends):
    hunt = observed(2, time_limit=20)
    if learner["algorithm"] == "SAC":  # which takes actions of a Box alone
        hunt = cr.observation_task("Pendulum-v1", discount=0.98)
    plan = cr.Curriculum(
        {"chase": hunt, "hunt": hunt},
        [cr.Transfer("chase", "hunt", cr.transfer.ObservationMapping(hunt, hunt))],
        learner=cr.deep.DeepLearner(**learner),
        **changes,
    )
    reason = curricula_record({"transfer": PlannedArm(plan, {})}).arms["transfer"].depends_on_total
    assert reason.startswith(depends)
    assert bool(reason) is bool(depends)


def test_settings_of_a_tuning_that_no_network_takes_are_refused_beforehand(tmp_path):
    file = tmp_path / "hunt.toml"
    space = "tasks.hunt.learner.settings.n_step = [1, 2]"
    file.write_text(f"{OBSERVED_HUNT}[tune]\ntrials = 2\n[tune.space]\n{space}\n")
    wrong = pytest.raises(ConfigError, match="got 'n_step', did you mean 'n_steps'")
    with wrong:
        run_study(read_study(file), tmp_path / "out")
    assert not (tmp_path / "out").exists()
    with wrong:
        print_preview(read_study(file))


class Drive(gym.Env):
    """A car that stays where it is, with some ways to go."""

    observation_space = gym.spaces.Box(-1, 1, (2,))

    def __init__(self, ways=2):
        self.action_space = gym.spaces.Discrete(ways)

    def reset(self, *, seed=None, options=None):
        return np.zeros(2, np.float32), {}

    def step(self, action):
        return np.zeros(2, np.float32), 0.0, True, False, {}


@pytest.mark.parametrize(
    ("sources", "said"),
    [
        ([2, 2], "takes over the network of one source, .*: 'target' has source 0, source 1"),
        ([3], r"equal numbers of actions .*: 'source 0' has Discrete\(3\), 'target' has Discr"),
        ([2], ""),
    ],
)
def test_weights_that_cannot_be_taken_over_are_refused_beforehand(sources, said):
    tasks = {
        f"source {k}": cr.observation_task(Drive, ways=n, time_limit=9)
        for k, n in enumerate(sources)
    }
    plan = cr.Curriculum(
        {**tasks, "target": cr.observation_task(Drive, time_limit=9)},
        [cr.Transfer(name, "target") for name in tasks],
        shaping=cr.deep.WeightTransfer(),
        learner=cr.deep.DeepLearner("PPO"),
    )
    if said:
        with pytest.raises(SettingError, match=said):
            plan.check_networks()
    else:
        plan.check_networks()
        assert [line for line in graph(plan) if line.endswith("; WeightTransfer")]


def test_an_actor_critic_is_shaped_and_hands_on_its_weights(tmp_path):
    file = tmp_path / "carts.toml"
    file.write_text(
        """
        name = "carts"
        seeds = 1
        [learner]
        type = "deep"
        algorithm = "PPO"
        settings = { n_steps = 64, batch_size = 64, policy_kwargs = { net_arch = [8] } }
        [tasks.short]
        type = "observation_task"
        id = "CartPole-v1"
        time_limit = 50
        budget = 128
        eval_freq = 64
        [tasks.cart]
        type = "observation_task"
        id = "CartPole-v1"
        budget = 192
        eval_freq = 64
        evaluation = { discounted = false }
        [[transfers]]
        source = "short"
        target = "cart"
        mapping = "identity"
        [arms.state]
        shaping = "StateShaping"
        [arms.weights]
        shaping = "WeightTransfer"
        """
    )
    results = run_study(read_study(file), tmp_path / "out")
    assert results.result("weights", "cart", values=True).values
    starts = [results.results[arm]["cart"].greedy_return[0, 0] for arm in ("scratch", "weights")]
    assert starts[0] != starts[1]
    state = Arms.of(read_study(file)).curricula["state"]
    short = results.trained("state", state)["short"]
    assert not short.values[0].of_actions
    assert short.values[0].v(seen(state.tasks["short"])).shape == (40,)
    page = write_report(tmp_path / "out").read_text()
    assert "This study kept no snapshots" in page
    assert ">nan" not in page
