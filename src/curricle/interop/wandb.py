"""Weights & Biases."""

import os
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from curricle.interop.trackers import as_json, checkpoints, environment_variables, run_name
from curricle.learning.result import LearningResult


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
