"""The curves of a study, read back from TensorBoard, MLflow and Weights & Biases."""

import json
import os
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import curricle
from curricle.errors import StoreError
from curricle.interop.tools import MLflow, TensorBoard, WandB
from curricle.interop.trackers import CURVES, TRACKERS, checkpoints, open_trackers
from curricle.learning.learners import QLearning
from curricle.learning.result import LearningResult
from curricle.tasks.gridworld import GridWorld

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


@pytest.fixture(autouse=True)
def _nothing_set(monkeypatch):
    """The tools' own settings on this machine stay out of the tests."""
    for name in os.environ:
        if name.startswith(("WANDB_", "MLFLOW_")):
            monkeypatch.delenv(name)


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
        guard_share=rng.random(shape) if guarded else np.full(shape, np.nan),
    )


def expected(result, k):
    """Tag -> steps and values of the seed at place k, written down the long way."""
    curves = {
        "rollout/ep_rew_mean": result.training_return,
        "eval/mean_reward": result.greedy_return,
        "time/episodes": result.episodes,
        "curricle/guard_share": result.guard_share,
    }
    found = {}
    for tag, curve in curves.items():
        for step, value in zip(result.steps, curve[k], strict=True):
            if step <= result.steps_used[k] and not np.isnan(value):
                found.setdefault(tag, []).append((int(step), float(value)))
    return found


def started(tracker, folder):
    tracker.start("hunting", CONFIGURATION, folder)
    return tracker


# What every tracker logs


def test_a_seed_ends_where_its_budget_did_and_holds_no_nan():
    result = some_result()
    steps = [[step for step, _ in checkpoints(result, k)] for k in range(2)]
    assert steps == [[0, 100, 200, 300, 400], [0, 100, 200]]
    ended = ["rollout/ep_rew_mean" in values for _, values in checkpoints(result, 0)]
    assert ended == [False, True, False, True, True]
    assert not any("curricle/guard_share" in values for _, values in checkpoints(result, 0))


def test_a_checkpoint_at_which_nothing_was_measured_is_left_out():
    result = some_result()
    nothing = np.full(result.guard_share.shape, np.nan)
    result = replace(result, greedy_return=nothing, episodes=nothing)
    assert [step for step, _ in checkpoints(result, 0)] == [100, 300, 400]


# TensorBoard


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
    tracker = started(TensorBoard(), tmp_path)
    tracker.record("mean", "hunt", result)
    tracker.close()
    for k, seed in enumerate(result.seeds):
        shown = read_board(tmp_path / "tensorboard" / "mean" / "hunt" / f"seed-{seed}")
        assert shown == as_float32(expected(result, k))
        assert ("curricle/guard_share" in shown) is guarded


def test_tensorboard_has_the_settings_as_hyperparameters(tmp_path):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
    from tensorboard.plugins.hparams.plugin_data_pb2 import HParamsPluginData

    tracker = started(TensorBoard(), tmp_path)
    tracker.record("mean", "hunt", some_result())
    events = EventAccumulator(str(tmp_path / "tensorboard" / "mean" / "hunt" / "seed-7"))
    events.Reload()
    (content,) = events.PluginTagToContent("hparams").values()
    shown = HParamsPluginData.FromString(content).session_start_info.hparams
    assert {name: getattr(value, value.WhichOneof("kind")) for name, value in shown.items()} == FLAT


def test_tensorboards_of_one_second_in_one_folder_overwrite_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr("curricle.interop.tools.time.time", lambda: 1e9)
    result = some_result(seeds=(0,))
    trackers = [started(TensorBoard(), tmp_path) for _ in range(2)]
    for tracker in trackers:
        tracker.record("mean", "hunt", result)
    for tracker in trackers:
        tracker.close()
    shown = read_board(tmp_path / "tensorboard" / "mean" / "hunt" / "seed-0")
    twice = {tag: curve * 2 for tag, curve in as_float32(expected(result, 0)).items()}
    assert shown == twice


def test_a_resumed_tensorboard_leaves_earlier_runs_alone(tmp_path):
    tracker = started(TensorBoard(), tmp_path)
    tracker.record("mean", "hunt", some_result(seeds=(0,)))
    earlier = {path: path.read_bytes() for path in tmp_path.rglob("*tfevents*")}
    tracker = started(TensorBoard(), tmp_path)
    tracker.record("mean", "hunt", some_result(seeds=(1, 2)))
    tracker.close()
    assert len(earlier) == 1
    assert all(path.read_bytes() == content for path, content in earlier.items())
    assert len(list(tmp_path.rglob("*tfevents*"))) == 3


@pytest.mark.parametrize("damage", [Path.unlink, lambda path: os.truncate(path, 200)])
def test_tensorboard_reports_events_that_are_not_there(tmp_path, damage):
    tracker = started(TensorBoard(), tmp_path)
    tracker.record("mean", "hunt", some_result())
    damage(next((tmp_path / "tensorboard" / "mean" / "hunt" / "seed-7").iterdir()))
    with pytest.raises(StoreError, match=r"1 of 2 do not, the first is .*seed-7.* of 5 events"):
        tracker.close()


NAMES = ["mean", "mean, placebo", "a/b", "a%2Fb", "..", ".", "C:\\x", "größe", "φ → ψ", "end."]


def test_any_name_is_a_folder_of_its_own_inside_the_study(tmp_path):
    tracker = started(TensorBoard(), tmp_path / "study")
    for name in NAMES:
        tracker.record(name, "..", some_result(seeds=(0,), n=3))
    tracker.close()
    inside = [p.relative_to(tmp_path).parts for p in tmp_path.rglob("*tfevents*")]
    assert all(len(parts) == 6 for parts in inside)  # study, tensorboard, arm, node, seed, file
    assert len({parts[2] for parts in inside}) == len(NAMES)


# MLflow


def read_mlflow(address):
    """Name of a run -> the run, and tag -> steps and values."""
    from mlflow.tracking import MlflowClient

    client = MlflowClient(tracking_uri=address)
    (experiment,) = [e for e in client.search_experiments() if e.name == "hunting"]
    return {
        run.info.run_name: (
            run,
            {
                tag: [(m.step, m.value) for m in client.get_metric_history(run.info.run_id, tag)]
                for tag in run.data.metrics
            },
        )
        for run in client.search_runs([experiment.experiment_id])
    }


@pytest.fixture
def _file_store(monkeypatch):
    monkeypatch.setenv("MLFLOW_ALLOW_FILE_STORE", "true")
    monkeypatch.setenv("MLFLOW_DISABLE_TELEMETRY", "true")


@pytest.mark.usefixtures("_file_store")
def test_mlflow_holds_the_curves(tmp_path):
    result = some_result(guarded=True)
    tracker = started(MLflow(), tmp_path)
    tracker.record("mean", "hunt", result)
    tracker.close()
    runs = read_mlflow((tmp_path / "mlflow").as_uri())
    assert sorted(runs) == ["mean/hunt/seed-0", "mean/hunt/seed-7"]
    for k, seed in enumerate(result.seeds):
        run, curves = runs[f"mean/hunt/seed-{seed}"]
        assert curves == expected(result, k)
        assert run.info.status == "FINISHED"
        assert run.data.tags["curricle.arm"] == "mean"
        assert run.data.tags["curricle.node"] == "hunt"
        assert run.data.tags["curricle.seed"] == str(seed)
        params = {name: str(value) for name, value in FLAT.items()}
        params["tasks.größe _28_m_29_.rows"] = params.pop("tasks.größe (m).rows")
        assert run.data.params == params


@pytest.mark.usefixtures("_file_store")
def test_mlflow_adds_to_a_run_that_is_recorded_again(tmp_path):
    first, second = some_result(seeds=(0,), n=3), some_result(seeds=(0, 1), n=4)
    started(MLflow(), tmp_path).record("mean", "hunt", first)
    started(MLflow(), tmp_path).record("mean", "hunt", second)
    runs = read_mlflow((tmp_path / "mlflow").as_uri())
    assert len(runs) == 2
    _, curves = runs["mean/hunt/seed-0"]
    tag = "eval/mean_reward"
    assert sorted(curves[tag]) == sorted(expected(first, 0)[tag] + expected(second, 0)[tag])


@pytest.mark.usefixtures("_file_store")
def test_mlflow_logs_where_the_user_says_and_keeps_studies_of_one_name_apart(tmp_path, monkeypatch):
    from mlflow.tracking import MlflowClient

    address = (tmp_path / "shared").as_uri()
    monkeypatch.setenv("MLFLOW_TRACKING_URI", address)
    for study in ("a", "b"):
        started(MLflow(), tmp_path / study).record("mean", "hunt", some_result(seeds=(0,)))
    assert not (tmp_path / "a").exists()
    client = MlflowClient(tracking_uri=address)
    experiment = client.get_experiment_by_name("hunting").experiment_id
    assert len(client.search_runs([experiment])) == 2


# Weights & Biases


def read_wandb(file):
    """The records of a run's log: blocks of 32 KiB, in which a record lies in one piece or more."""
    from wandb.proto.wandb_internal_pb2 import Record

    content, at, record = file.read_bytes(), 7, b""
    while at + 7 <= len(content):
        if 32768 - at % 32768 < 7:  # no room for a header
            at += 32768 - at % 32768
            continue
        length, kind = int.from_bytes(content[at + 4 : at + 6], "little"), content[at + 6]
        record += content[at + 7 : at + 7 + length]
        at += 7 + length
        if kind in (1, 4):  # whole, or the last inlined
            yield Record.FromString(record)
            record = b""


def wandb_curves(records):
    """Tag -> steps and values."""
    curves = {}
    for record in records:
        if record.WhichOneof("record_type") == "history":
            items = {
                item.key or "/".join(item.nested_key): json.loads(item.value_json)
                for item in record.history.item
            }
            for tag in CURVES.keys() & items:
                curves.setdefault(tag, []).append((items["_step"], items[tag]))
    return curves


def test_wandb_logs_offline_runs(tmp_path):
    wandb = pytest.importorskip("wandb")
    result = some_result(guarded=True)
    tracker = started(WandB(), tmp_path)
    tracker.record("mean", "hunt", result)
    tracker.close()
    wandb.teardown()  # as at the end of a program: waits for the process that writes
    files = list((tmp_path / "wandb").glob("offline-run-*/run-*.wandb"))
    runs = {}
    for file in files:
        records = list(read_wandb(file))
        (run,) = [r.run for r in records if r.WhichOneof("record_type") == "run"][:1]
        runs[run.display_name] = run, wandb_curves(records)
    assert sorted(runs) == ["mean/hunt/seed-0", "mean/hunt/seed-7"]
    for k, seed in enumerate(result.seeds):
        run, curves = runs[f"mean/hunt/seed-{seed}"]
        assert curves == expected(result, k)
        assert (run.project, run.run_group, run.job_type) == ("curricle", "hunting", "mean")
        config = {item.key: json.loads(item.value_json) for item in run.config.update}
        config.pop("_wandb", None)
        assert config == {**CONFIGURATION, "arm": "mean", "node": "hunt", "seed": seed}


ALONE = """
import pickle
import sys

calls = []
sys.addaudithook(lambda event, arguments: calls.append((event, arguments)) if (
    event == "socket.getaddrinfo" or event == "socket.connect" and type(arguments[1]) is tuple
) else None)

from curricle.interop.trackers import open_trackers

result = pickle.load(sys.stdin.buffer)
for arm in ("scratch", "mean"):
    trackers = open_trackers(sys.argv[2:], "corridor", {"budget": 100}, sys.argv[1])
    trackers.record(arm, "maze", result)
    trackers.close()
    assert not trackers.failures, trackers.failures
assert not calls, calls
"""
KEPT = ("PATH", "TMPDIR", "SYSTEMROOT")


@pytest.mark.parametrize("tool", TRACKERS)
def test_a_tool_calls_nobody_and_writes_inside_the_study_only(tmp_path, tool):
    pytest.importorskip(tool)
    for name in ("home", "here", "study"):
        (tmp_path / name).mkdir()
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", ALONE, str(tmp_path / "study"), tool],
        cwd=tmp_path / "here",
        env={n: os.environ[n] for n in KEPT if n in os.environ}
        | {
            "HOME": str(tmp_path / "home"),
            # This very package, installed or not; and its compiled code not in the home directory.
            "PYTHONPATH": str(Path(curricle.__file__).parents[1]),
            "NUMBA_CACHE_DIR": str(tmp_path / "numba"),
        },
        input=pickle.dumps(some_result()),
        capture_output=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr.decode()) == (0, b"", "")
    assert [p.name for p in (tmp_path / "study").iterdir()] == [tool]
    assert not list((tmp_path / "home").iterdir())
    assert not list((tmp_path / "here").iterdir())


def test_a_tool_that_fails_for_real_is_named_with_the_run(tmp_path):
    said = []
    trackers = open_trackers(["tensorboard"], "hunting", {}, tmp_path, said.append)
    (tmp_path / "tensorboard" / "mean").write_text("in the way")
    trackers.record("mean", "hunt", some_result())
    trackers.close()
    (sentence,) = said
    assert sentence.startswith("TensorBoard failed at arm 'mean', task 'hunt' and is switched off")
    assert str(tmp_path) in sentence


def test_a_tracker_named_twice_is_opened_once(tmp_path):
    trackers = open_trackers(["tensorboard"] * 2, "hunting", {}, tmp_path)
    trackers.record("mean", "hunt", some_result(seeds=(0,)))
    assert len(list(tmp_path.rglob("*tfevents*"))) == 1
