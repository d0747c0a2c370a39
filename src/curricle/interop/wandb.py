"""A study's curves as runs of Weights & Biases."""

import os
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from curricle.interop.tracker import checkpoints, environment_variables, plain, run_name
from curricle.learning.result import LearningResult


class WandB:
    """A run for each seed, in ``<folder>/wandb``; offline unless ``WANDB_MODE`` says otherwise.

    The group is the study, the job type the arm, the configuration the study's settings with arm,
    node and seed. The project is ``WANDB_PROJECT``, by default "curricle". Every recording is a
    run of its own, as offline runs cannot be added to. W&B writes from a process of its own, which
    this one waits for when it ends; files may lag until then.

    Examples
    --------
    >>> from curricle.interop.tracker import Tracker
    >>> isinstance(WandB(), Tracker)
    True
    """

    def start(self, study: str, configuration: Mapping[str, Any], folder: Path) -> None:
        """Make the folder; W&B would rather fall back to a temporary one than fail."""
        self._study, self._folder, self._configuration = study, folder, plain(configuration)
        (folder / "wandb").mkdir(parents=True, exist_ok=True)
        with self._own_places():
            import wandb  # noqa: F401  fails now or not at all

    def record(self, arm: str, node: str, result: LearningResult) -> None:
        """Log a run for each seed."""
        import wandb

        mode: Any = os.environ.get("WANDB_MODE", "offline")
        settings = wandb.Settings(
            reinit="create_new",  # leave alone a run that the caller has under way
            console="off",
            quiet=True,
            silent=mode == "offline",
            disable_git=True,
            # Nothing about this process: it only passes on what was learnt, three times as fast.
            x_disable_meta=True,
            x_disable_stats=True,
            x_save_requirements=False,
        )
        for k, seed in enumerate(result.seeds):
            with (
                self._own_places(),
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
        """Do nothing: every run was finished when it was logged."""

    def _own_places(self) -> AbstractContextManager[None]:
        """Keep W&B's logs out of the home directory, and send no error reports."""
        cache = str(self._folder / "wandb" / "cache")
        return environment_variables(WANDB_CACHE_DIR=cache, WANDB_ERROR_REPORTING="false")
