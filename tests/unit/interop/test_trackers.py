"""Trackers: failures never stop a study, and TensorBoard shows its curves."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from curricle.errors import SettingError
from curricle.interop.trackers import TensorBoard, Trackers, hyperparameters
from curricle.learning.learners import QLearning
from curricle.learning.result import LearningResult
from curricle.tasks.gridworld import GridWorld


def started(trackers, folder="results", report=None):
    opened = Trackers(trackers, report)
    opened.start("hunting", {}, folder)
    return opened


class Diary:
    """A tracker that notes its calls, and raises at one of them."""

    def __init__(self, raises_at="", error=None):
        self.calls = []
        self._raises_at, self._error = raises_at, error or OSError("no space\nleft")

    def _note(self, call):
        self.calls.append(call)
        if call == self._raises_at:
            raise self._error

    def start(self, study, configuration, folder):
        self._note("start")

    def record(self, arm, node, result):
        self._note(f"{arm}/{node}")

    def close(self):
        self._note("close")


ALL = ["start", "scratch/hunt", "mean/hunt", "close"]
PLACES = {
    "start": "at the start of the study",
    "scratch/hunt": "at arm 'scratch', task 'hunt'",
    "close": "at the end of the study",
}


@pytest.mark.parametrize("place", PLACES)
def test_a_failing_tracker_is_reported_and_off_and_stops_nobody(place):
    broken, well, reported = Diary(place), Diary(), []
    trackers = started([broken, well], report=reported.append)
    trackers.record("scratch", "hunt", None)
    trackers.record("mean", "hunt", None)
    trackers.close()
    assert broken.calls == ALL[: ALL.index(place) + 1]
    assert well.calls == ALL
    assert reported == [f"Diary failed {PLACES[place]} and is switched off: OSError: no space left"]


@pytest.mark.parametrize("place", PLACES)
def test_an_interruption_passes(place):
    trackers = Trackers([Diary(place, KeyboardInterrupt())], report=pytest.fail)

    def study():
        trackers.start("hunting", {}, Path("results"))
        trackers.record("scratch", "hunt", None)
        trackers.close()

    with pytest.raises(KeyboardInterrupt):
        study()


def test_logs_that_stay_empty_are_reported(tmp_path):
    reported = []
    trackers = started(["tensorboard", Diary()], tmp_path, reported.append)
    trackers.close()
    assert reported == [
        "TensorBoard, Diary: nothing was logged, as this run finished no unit of work"
    ]


def test_a_tracker_that_is_unknown_or_not_installed_is_refused(monkeypatch):
    for unknown in ("tensorbord", "wandb", "", 3, None, object()):
        with pytest.raises(SettingError, match="a tracker must be one of tensorboard: got"):
            Trackers([unknown])
    monkeypatch.setitem(sys.modules, "tensorboard", None)
    with pytest.raises(SettingError, match=r'pip install "curricle\[tensorboard\]"$'):
        Trackers(["tensorboard"])


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=10,
)


@given(st.dictionaries(st.text(alphabet="abc", min_size=1), JSON, max_size=4))
def test_hyperparameters_are_single_values_that_hold_every_setting(configuration):
    flat = hyperparameters(configuration)
    assert all(isinstance(value, bool | int | float | str) for value in flat.values())

    def leaves(nested, prefix=""):
        for name, value in nested.items():
            if isinstance(value, dict) and value:
                yield from leaves(value, f"{prefix}{name}.")
            else:
                yield f"{prefix}{name}", value

    for name, value in dict(leaves(configuration)).items():
        single = isinstance(value, bool | int | float | str)
        assert (flat[name] if single else json.loads(flat[name])) == value


# TensorBoard


CONFIGURATION = {
    "budget": 400,
    "learner": {"kind": "QLearning", "epsilon": 0.1, "double": False},
    "transfers": [{"source": "chase"}],
    "evaluation": None,
    "tasks": {"größe (m)": {"rows": 3}},
}
FLAT = {
    "budget": 400,
    "learner.kind": "QLearning",
    "learner.epsilon": 0.1,
    "learner.double": False,
    "transfers": '[{"source": "chase"}]',
    "evaluation": "null",
    "tasks.größe (m).rows": 3,
    "arm": "mean",
    "node": "hunt",
}


def some_result(seeds=(0, 7), n=5, guarded=False):
    """Random numbers: NaN where no episode ended, one seed done before the others."""
    rng = np.random.default_rng(list(seeds))
    shape = (len(seeds), n)
    training = rng.normal(size=shape)
    training[:, 0] = np.nan
    training[0, 2] = np.nan
    used = np.full(len(seeds), 100 * (n - 1))
    used[-1] -= 150
    return LearningResult(
        task=GridWorld("S.T"),
        learner=QLearning(),
        seeds=tuple(seeds),
        values=None,
        steps=np.arange(n) * 100,
        training_return=training,
        greedy_return=rng.normal(size=shape) * 1e3,
        episodes=rng.integers(0, 100, shape).cumsum(axis=1),
        steps_used=used,
        episodes_used=np.ones(len(seeds), np.int64),
        evaluation_steps=np.zeros(len(seeds), np.int64),
        out_of_memory=np.zeros(len(seeds), np.bool_),
        own_rewards=np.ones(len(seeds), np.bool_),
        source_share=rng.random(shape) if guarded else np.full(shape, np.nan),
    )


def expected(result, k):
    """Tag -> steps and values of the seed at place k, written down the long way."""
    curves = {
        "rollout/ep_rew_mean": result.training_return,
        "eval/mean_reward": result.greedy_return,
        "time/episodes": result.episodes,
        "curricle/source_share": result.source_share,
    }
    values = {}
    for tag, curve in curves.items():
        for step, value in zip(result.steps, curve[k], strict=True):
            if step <= result.steps_used[k] and not np.isnan(value):
                values.setdefault(tag, []).append((int(step), float(value)))
    return values


def board(folder):
    """A tracker that has begun a study."""
    tracker = TensorBoard()
    tracker.start("hunting", CONFIGURATION, folder)
    return tracker


def read_board(folder):
    """Tag -> steps and float32 values, as TensorBoard reads a run's folder."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(folder), size_guidance={"scalars": 0})
    events.Reload()
    return {
        tag: [(event.step, event.value) for event in events.Scalars(tag)]
        for tag in events.Tags()["scalars"]
    }


def as_float32(curves):
    return {tag: [(s, float(np.float32(v))) for s, v in curve] for tag, curve in curves.items()}


@pytest.mark.parametrize("guarded", [False, True])
def test_tensorboard_shows_the_curves(tmp_path, guarded):
    result = some_result(guarded=guarded)
    tracker = board(tmp_path)
    tracker.record("mean", "hunt", result)
    tracker.close()
    for k, seed in enumerate(result.seeds):
        shown = read_board(tmp_path / "tensorboard" / "mean" / "hunt" / f"seed-{seed}")
        assert shown == as_float32(expected(result, k))
        assert ("curricle/source_share" in shown) is guarded


def test_tensorboard_has_the_settings_as_hyperparameters(tmp_path):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
    from tensorboard.plugins.hparams.plugin_data_pb2 import HParamsPluginData

    tracker = board(tmp_path)
    tracker.record("mean", "hunt", some_result())
    events = EventAccumulator(str(tmp_path / "tensorboard" / "mean" / "hunt" / "seed-7"))
    events.Reload()
    (content,) = events.PluginTagToContent("hparams").values()
    shown = HParamsPluginData.FromString(content).session_start_info.hparams
    assert {name: getattr(value, value.WhichOneof("kind")) for name, value in shown.items()} == FLAT


def test_tensorboards_of_one_second_in_one_folder_overwrite_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr("curricle.interop.trackers.time.time", lambda: 1e9)
    result = some_result(seeds=(0,))
    trackers = [board(tmp_path) for _ in range(2)]
    for tracker in trackers:
        tracker.record("mean", "hunt", result)
    for tracker in trackers:
        tracker.close()
    shown = read_board(tmp_path / "tensorboard" / "mean" / "hunt" / "seed-0")
    twice = {tag: curve * 2 for tag, curve in as_float32(expected(result, 0)).items()}
    assert shown == twice


NAMES = ["mean", "mean, placebo", "a/b", "a%2Fb", "..", ".", "C:\\x", "größe", "φ → ψ", "end."]


def test_any_name_is_a_folder_of_its_own_inside_the_study(tmp_path):
    tracker = board(tmp_path / "study")
    for name in NAMES:
        tracker.record(name, "..", some_result(seeds=(0,), n=3))
    tracker.close()
    inside = [p.relative_to(tmp_path).parts for p in tmp_path.rglob("*tfevents*")]
    assert all(len(parts) == 6 for parts in inside)  # study, tensorboard, arm, node, seed, file
    assert len({parts[2] for parts in inside}) == len(NAMES)
