"""What a tracker is, and what it is told: the curves of each seed, and the study's settings."""

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from curricle.learning.result import LearningResult

CURVES = {
    "rollout/ep_rew_mean": "training_return",
    "eval/mean_reward": "greedy_return",
    "time/episodes": "episodes",
    "curricle/trust": "trust",
}
"""Tag of a curve, as other libraries name it, -> field of :class:`LearningResult`."""


@runtime_checkable
class Tracker(Protocol):
    """Somebody who is told of a study as it goes: what TensorBoard, W&B and MLflow have in common.

    A tracker may raise anything but must not end the process; :class:`Trackers` reports what it
    raised and does not call it again.

    Examples
    --------
    >>> class Finals:
    ...     def start(self, study, configuration, folder):
    ...         print(study, configuration["budget"])
    ...
    ...     def record(self, arm, node, result):
    ...         print(arm, node, result.greedy_return[:, -1].round(2))
    ...
    ...     def close(self):
    ...         pass
    >>> isinstance(Finals(), Tracker)
    True
    """

    def start(self, study: str, configuration: Mapping[str, Any], folder: Path) -> None:
        """Hear of a study before it trains anything.

        Parameters
        ----------
        study : str
            Its name.
        configuration : Mapping
            Its settings, nested as in its file.
        folder : Path
            Where its results are, absolute. An earlier run of the study may have logged there.
        """

    def record(self, arm: str, node: str, result: LearningResult) -> None:
        """Hear of a task that was trained, by the arm it belongs to and its name there."""

    def close(self) -> None:
        """Hear that nothing more will come."""


def checkpoints(result: LearningResult, k: int) -> Iterator[tuple[int, dict[str, float]]]:
    """Yield what was measured at each checkpoint of the seed at place `k`, if anything was.

    Yields
    ------
    step : int
        Steps taken in this task, at most what the seed used.
    values : dict of str to float
        Tag (:data:`CURVES`) -> value. What is NaN there is left out.

    Examples
    --------
    >>> from curricle import GridWorld, learn
    >>> result = learn(GridWorld("S.T"), budget=20, seeds=1, eval_freq=10)
    >>> for step, values in checkpoints(result, 0):
    ...     print(step, sorted(values))
    0 ['eval/mean_reward', 'time/episodes']
    10 ['eval/mean_reward', 'rollout/ep_rew_mean', 'time/episodes']
    20 ['eval/mean_reward', 'rollout/ep_rew_mean', 'time/episodes']
    """
    curves = {tag: getattr(result, field)[k] for tag, field in CURVES.items()}
    for t in np.flatnonzero(result.steps <= result.steps_used[k]):
        values = {tag: float(curve[t]) for tag, curve in curves.items() if not np.isnan(curve[t])}
        if values:
            yield int(result.steps[t]), values


def run_name(arm: str, node: str, seed: int) -> str:
    """Return what the run of one seed is called.

    Examples
    --------
    >>> run_name("scratch", "hunt", 3)
    'scratch/hunt/seed-3'
    """
    return f"{arm}/{node}/seed-{seed}"


def plain(configuration: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings as JSON knows them; what it does not know becomes text.

    Examples
    --------
    >>> plain({"folder": Path("results"), "seeds": (0, 1)})
    {'folder': 'results', 'seeds': [0, 1]}
    """
    known: dict[str, Any] = json.loads(json.dumps(dict(configuration), default=str))
    return known


def hyperparameters(configuration: Mapping[str, Any]) -> dict[str, bool | int | float | str]:
    """Return nested settings as one level, with dotted names; lists and None become JSON text.

    Examples
    --------
    >>> hyperparameters({"budget": 1000, "learner": {"epsilon": 0.1, "tags": ["a", "b"]}})
    {'budget': 1000, 'learner.epsilon': 0.1, 'learner.tags': '["a", "b"]'}
    """
    flat: dict[str, bool | int | float | str] = {}
    for name, value in plain(configuration).items():
        if isinstance(value, dict) and value:
            flat |= {f"{name}.{inner}": leaf for inner, leaf in hyperparameters(value).items()}
        elif isinstance(value, bool | int | float | str):
            flat[name] = value
        else:
            flat[name] = json.dumps(value, ensure_ascii=False)
    return flat


@contextmanager
def environment_variables(**defaults: str) -> Iterator[None]:
    """Set environment variables, those that are not set already, while the context lasts.

    Examples
    --------
    >>> with environment_variables(CURRICLE_EXAMPLE="yes"):
    ...     os.environ["CURRICLE_EXAMPLE"]
    'yes'
    >>> "CURRICLE_EXAMPLE" in os.environ
    False
    """
    added = {name: value for name, value in defaults.items() if name not in os.environ}
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            os.environ.pop(name, None)
