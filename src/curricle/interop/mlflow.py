"""MLflow."""

import os
import re
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from curricle.interop.trackers import checkpoints, environment_variables, hyperparameters, run_name
from curricle.learning.result import LearningResult

IDENTITY = ("curricle.folder", "curricle.arm", "curricle.node", "curricle.seed")
"""Tags by which a run is found again."""
SETTINGS = {
    "MLFLOW_ALLOW_FILE_STORE": "true",  # without SQL there is no other; from MLflow 3.13 on refused
    "MLFLOW_DISABLE_TELEMETRY": "true",
    "MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT": "true",
}
"""Defaults of MLflow's environment variables."""


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
