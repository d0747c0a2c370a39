"""Trackers of tools: TensorBoard, Weights & Biases, MLflow; each is imported when it is used."""

import os
import re
import time
import uuid
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from curricle.errors import StoreError
from curricle.interop.trackers import (
    as_json,
    checkpoints,
    environment_variables,
    hyperparameters,
    run_name,
)
from curricle.learning.result import LearningResult

NO_FILE_NAME = re.compile(r'[%<>:"/\\|?*\x00-\x1f]|^\.|[. ]$')
"""What is not allowed in a file name on some system."""
IDENTITY = ("curricle.folder", "curricle.arm", "curricle.node", "curricle.seed")
"""Tags by which a run is found again."""
SETTINGS = {
    "MLFLOW_ALLOW_FILE_STORE": "true",  # without SQL there is no other; from MLflow 3.13 on refused
    "MLFLOW_DISABLE_TELEMETRY": "true",
    "MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT": "true",
}
"""Defaults of MLflow's environment variables."""


class TensorBoard:
    """Event files in ``<folder>/tensorboard/<arm>/<node>/seed-<seed>``, float32.

    Each call of `record` writes a new file for each seed, so that nothing logged by another process
    or an earlier run of the study is overwritten. TensorBoard shows all files of a folder as one
    run. The settings, with arm and node, are the run's hyperparameters; seeds that share them are
    one group.
    """

    def __init__(self) -> None:
        self._written: dict[Path, int] = {}

    def start(self, study: str, configuration: Mapping[str, Any], folder: Path) -> None:
        """Make the folder."""
        import tensorboard.summary.writer.record_writer  # noqa: F401 - if it fails, then at the start

        self._configuration = configuration
        self._root = folder / "tensorboard"
        self._root.mkdir(parents=True, exist_ok=True)

    def record(self, arm: str, node: str, result: LearningResult) -> None:
        """Write a file for each seed."""
        settings = hyperparameters({**self._configuration, "arm": arm, "node": node})
        folder = self._root / _file_name(arm) / _file_name(node)
        for k, seed in enumerate(result.seeds):
            events = _events(settings, result, k)
            path = folder / f"seed-{seed}" / _unique_name()
            path.parent.mkdir(parents=True, exist_ok=True)
            _write(path, events)
            self._written[path] = len(events)

    def close(self) -> None:
        """Read the files back as TensorBoard does; StoreError when an event is not there."""
        short = {path: n for path, n in self._written.items() if _count(path) != n}
        if short:
            path, n = next(iter(short.items()))
            raise StoreError(
                f"event files must hold what was written to them: {len(short)} of "
                f"{len(self._written)} do not, the first is {path} with {_count(path)} of {n} "
                "events"
            )


def _file_name(name: str) -> str:
    """Return a name for a folder; different names stay different."""
    return NO_FILE_NAME.sub(lambda found: f"%{ord(found[0]):02X}", name)


def _unique_name() -> str:
    """Return a name for an event file; TensorBoard reads a folder's files in their names' order."""
    return f"events.out.tfevents.{int(time.time()):010d}.{uuid.uuid4().hex}"


def _events(settings: Mapping[str, Any], result: LearningResult, k: int) -> list[Any]:
    """Return the events of one seed: the format's version, the settings, the checkpoints."""
    from tensorboard.compat.proto.event_pb2 import Event
    from tensorboard.compat.proto.summary_pb2 import Summary
    from tensorboard.plugins.hparams.summary_v2 import hparams_pb

    now = time.time()
    events = [
        Event(wall_time=now, file_version="brain.Event:2"),
        Event(wall_time=now, summary=hparams_pb(dict(settings), start_time_secs=now)),
    ]
    for step, values in checkpoints(result, k):
        scalars = [Summary.Value(tag=tag, simple_value=value) for tag, value in values.items()]
        events.append(Event(wall_time=now, step=step, summary=Summary(value=scalars)))
    return events


def _write(path: Path, events: list[Any]) -> None:
    # Not with a SummaryWriter: on a full disk its thread dies and the caller waits for ever.
    from tensorboard.summary.writer.record_writer import RecordWriter

    with path.open("xb") as file:
        writer = RecordWriter(file)
        for event in events:
            writer.write(event.SerializeToString())


def _count(path: Path) -> int:
    """Return how many whole events a file holds."""
    from tensorboard.backend.event_processing.event_file_loader import RawEventFileLoader

    return sum(1 for _ in RawEventFileLoader(str(path)).Load()) if path.exists() else 0


class WandB:
    """A run for each seed, in ``<folder>/wandb``; offline unless ``WANDB_MODE`` says otherwise.

    The group is the study, the job type the arm, the configuration the study's settings with arm,
    node and seed. The project is ``WANDB_PROJECT``, by default "curricle". Each call of `record`
    makes a new run, as offline runs cannot be added to. W&B writes from a process of its own;
    files are complete when the program has ended.
    """

    def start(self, study: str, configuration: Mapping[str, Any], folder: Path) -> None:
        """Make the folder; without it W&B falls back to a temporary one."""
        self._study, self._folder, self._configuration = study, folder, as_json(configuration)
        (folder / "wandb").mkdir(parents=True, exist_ok=True)
        with self._inside_the_folder():
            import wandb  # noqa: F401 - if it fails, then at the start

    def record(self, arm: str, node: str, result: LearningResult) -> None:
        """Log a run for each seed."""
        import wandb

        mode: Any = os.environ.get("WANDB_MODE", "offline")
        settings = wandb.Settings(
            reinit="create_new",  # beside a run that the caller may have under way
            console="off",
            quiet=True,
            silent=mode == "offline",
            disable_git=True,
            x_disable_meta=True,  # without data on this process logging is three times as fast
            x_disable_stats=True,
            x_save_requirements=False,
        )
        for k, seed in enumerate(result.seeds):
            with (
                self._inside_the_folder(),
                wandb.init(
                    mode=mode,
                    dir=self._folder,
                    project=os.environ.get("WANDB_PROJECT", "curricle"),
                    group=self._study,
                    job_type=arm,
                    name=run_name(arm, node, seed),
                    config={**self._configuration, "arm": arm, "node": node, "seed": seed},
                    settings=settings,
                ) as run,
            ):
                for step, values in checkpoints(result, k):
                    run.log(values, step=step)

    def close(self) -> None:
        """Do nothing: each run is finished when it is logged."""

    def _inside_the_folder(self) -> AbstractContextManager[None]:
        """Keep W&B's logs out of the home directory, and send no error reports."""
        cache = str(self._folder / "wandb" / "cache")
        return environment_variables(WANDB_CACHE_DIR=cache, WANDB_ERROR_REPORTING="false")


class MLflow:
    """An experiment named after the study, with a tagged run for each arm, node and seed.

    It logs to files in ``<folder>/mlflow``, or to ``MLFLOW_TRACKING_URI``. The settings, with arm
    and node, are the parameters. A seed that is recorded again is added to its run.
    """

    def start(self, study: str, configuration: Mapping[str, Any], folder: Path) -> None:
        """Find the study's experiment and its runs, or make the experiment."""
        address = os.environ.get("MLFLOW_TRACKING_URI") or (folder / "mlflow").as_uri()
        with environment_variables(**SETTINGS):
            from mlflow.tracking import MlflowClient

            self._client = MlflowClient(tracking_uri=address)
        found = self._client.get_experiment_by_name(study)
        self._experiment = found.experiment_id if found else self._client.create_experiment(study)
        self._configuration = configuration
        self._folder = str(folder)
        self._runs = self._earlier_runs()

    def record(self, arm: str, node: str, result: LearningResult) -> None:
        """Log a run for each seed."""
        from mlflow.entities import Metric

        now = round(1000 * time.time())
        for k, seed in enumerate(result.seeds):
            run = self._run(arm, node, seed)
            metrics = [
                Metric(tag, value, now, step)
                for step, values in checkpoints(result, k)
                for tag, value in values.items()
            ]
            self._client.log_batch(run, metrics=metrics)
            with environment_variables(**SETTINGS):
                self._client.set_terminated(run)

    def close(self) -> None:
        """Do nothing: each run is ended when it is logged."""

    def _earlier_runs(self) -> dict[tuple[str | None, ...], str]:
        """Return the experiment's runs: their tags (:data:`IDENTITY`) -> id."""
        runs: dict[tuple[str | None, ...], str] = {}
        token = None
        while token != "":
            page = self._client.search_runs([self._experiment], page_token=token)
            for run in page:
                runs[tuple(run.data.tags.get(tag) for tag in IDENTITY)] = run.info.run_id
            token = page.token or ""
        return runs

    def _run(self, arm: str, node: str, seed: int) -> str:
        """Return the id of the run of one seed; make the run if there is none."""
        from mlflow.entities import Param

        identity = (self._folder, arm, node, str(seed))
        if identity not in self._runs:
            tags = dict(zip(IDENTITY, identity, strict=True))
            name = run_name(arm, node, seed)
            run = self._client.create_run(self._experiment, tags=tags, run_name=name).info.run_id
            settings = hyperparameters({**self._configuration, "arm": arm, "node": node})
            params = [Param(_parameter_name(key), str(value)) for key, value in settings.items()]
            self._client.log_batch(run, params=params)
            self._runs[identity] = run
        return self._runs[identity]


def _parameter_name(name: str) -> str:
    """Return a name in the letters MLflow allows; another letter becomes its code, "(" "_28_"."""
    return re.sub(r"[^\w.\- ]", lambda found: f"_{ord(found[0]):x}_", name)
