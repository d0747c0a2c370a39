"""Trackers: a study's curves in TensorBoard, Weights & Biases, MLflow or a tool of one's own."""

import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from curricle.checks import one_of
from curricle.errors import SettingError
from curricle.learning.result import LearningResult

CURVES = {
    "rollout/ep_rew_mean": "training_return",
    "eval/mean_reward": "greedy_return",
    "time/episodes": "episodes",
    "curricle/guard_share": "guard_share",
}
"""Tag of a curve, as other libraries name it, -> field of :class:`LearningResult`."""
TRACKERS = {"tensorboard": "TensorBoard", "wandb": "WandB", "mlflow": "MLflow"}
"""A tool, which is also its package and Curricle's extra -> its tracker in ``tools``."""


@runtime_checkable
class Tracker(Protocol):
    """Logs a study as it runs.

    A tracker may raise any `Exception`: :class:`Trackers` reports it and switches the tracker off.

    Examples
    --------
    >>> class Finals(Tracker):
    ...     def record(self, arm, node, result):
    ...         print(arm, node, result.greedy_return[:, -1].round(2))
    >>> from curricle import GridWorld, learn
    >>> Finals().record("scratch", "maze", learn(GridWorld("S.T"), budget=500))
    scratch maze [196.01]
    """

    def start(self, study: str, configuration: Mapping[str, Any], folder: Path) -> None:
        """Begin a study, before anything is trained.

        `configuration` has the settings, nested as in the study's file. `folder` is where its
        results are, absolute; an earlier run of the study may have logged there.
        """

    def record(self, arm: str, node: str, result: LearningResult) -> None:
        """Log a task that has been trained, in an arm, under its name there."""

    def close(self) -> None:
        """End the study."""


class Trackers:
    """Several trackers as one, which never stops the study.

    A tracker that raises is reported, with the place and the exception, and not called again; the
    others go on. KeyboardInterrupt and whatever else is no `Exception` is raised.

    Parameters
    ----------
    trackers : iterable of Tracker
    report : callable, optional
        Called with one sentence for each failure; by default it is printed to stderr.

    Attributes
    ----------
    failures : list of str
        What was reported of them.

    Examples
    --------
    >>> class Full(Tracker):
    ...     def start(self, study, configuration, folder):
    ...         raise OSError("no space left")
    >>> trackers = Trackers([Full()], report=print)
    >>> trackers.start("hunt", {}, Path("results"))
    Full failed at the start of the study and is switched off: OSError: no space left
    >>> len(trackers.failures)
    1
    """

    def __init__(
        self, trackers: Iterable[Tracker], report: Callable[[str], Any] | None = None
    ) -> None:
        self._working = list(trackers)
        self._report = to_stderr if report is None else report
        self._recorded = False
        self.failures: list[str] = []

    def start(self, study: str, configuration: Mapping[str, Any], folder: Path) -> None:
        """Begin a study with every tracker."""
        folder = folder.resolve()
        self._each("at the start of the study", lambda t: t.start(study, configuration, folder))

    def record(self, arm: str, node: str, result: LearningResult) -> None:
        """Log a task that has been trained with every tracker."""
        self._recorded = True
        self._each(f"at arm {arm!r}, task {node!r}", lambda t: t.record(arm, node, result))

    def close(self) -> None:
        """End the study with every tracker, and report if nothing was ever recorded."""
        if self._working and not self._recorded:
            tools = ", ".join(type(tracker).__name__ for tracker in self._working)
            self._report(f"{tools}: nothing was logged, as this run finished no unit of work")
        self._each("at the end of the study", lambda t: t.close())
        self._working = []

    def _each(self, place: str, call: Callable[[Tracker], None]) -> None:
        """Call all trackers that work, and switch off those that raise."""
        for tracker in tuple(self._working):
            try:
                call(tracker)
            except Exception as error:
                self._working = [other for other in self._working if other is not tracker]
                what = " ".join(f"{type(error).__name__}: {error}".split())
                failure = f"{type(tracker).__name__} failed {place} and is switched off: {what}"
                self.failures.append(failure)
                self._report(failure)


def open_trackers(
    trackers: Iterable[str | Tracker],
    study: str,
    configuration: Mapping[str, Any],
    folder: str | Path,
    report: Callable[[str], Any] | None = None,
) -> Trackers:
    """Return trackers as one, started on a study.

    Parameters
    ----------
    trackers : iterable of str or Tracker
        "tensorboard", "wandb", "mlflow", or a :class:`Tracker` of one's own; each is opened once.
    study : str
        Its name.
    configuration : Mapping
        Its settings; logged as hyperparameters.
    folder : str or Path
        The study's folder. What the tools write stays inside.
    report : callable, optional
        Called with one sentence for each failure; by default it is printed to stderr.

    Raises
    ------
    SettingError
        When a name is unknown or its tool is not installed.

    Examples
    --------
    >>> open_trackers(["tensorbord"], "hunt", {}, "results")
    Traceback (most recent call last):
        ...
    curricle.errors.SettingError: a tracker must be one of tensorboard, wandb, mlflow: got ...
    """
    opened = Trackers(trackers_of(trackers), report)
    opened.start(study, configuration, Path(folder))
    return opened


def trackers_of(given: Iterable[str | Tracker]) -> list[Tracker]:
    """Return trackers, each once; SettingError where a name is unknown or its tool is missing."""
    if isinstance(given, str):
        raise SettingError(f"trackers must be a list of them: got {given!r}")
    return [_tracker_of(each) for each in dict.fromkeys(given)]


def _tracker_of(given: str | Tracker) -> Tracker:
    if isinstance(given, Tracker):
        return given
    one_of("a tracker", given, TRACKERS, SettingError)
    found = find_spec(given)
    if found is None or found.origin is None:  # a folder of that name is importable, but empty
        raise SettingError(
            f"tracker {given!r} needs a package that is not installed: "
            f'pip install "curricle[{given}]"'
        )
    made: Tracker = getattr(import_module("curricle.interop.tools"), TRACKERS[given])()
    return made


def to_stderr(sentence: str) -> None:
    """Print a sentence to stderr."""
    print(sentence, file=sys.stderr)


# What the trackers of tools share


def checkpoints(result: LearningResult, k: int) -> Iterator[tuple[int, dict[str, float]]]:
    """Yield the steps and values of each checkpoint of the k-th seed at which any was measured.

    Steps are those taken in this task, at most what the seed used. Values are by tag
    (:data:`CURVES`); NaN is left out.
    """
    curves = {tag: getattr(result, field)[k] for tag, field in CURVES.items()}
    for t in np.flatnonzero(result.steps <= result.steps_used[k]):
        values = {tag: float(curve[t]) for tag, curve in curves.items() if not np.isnan(curve[t])}
        if values:
            yield int(result.steps[t]), values


def run_name(arm: str, node: str, seed: int) -> str:
    """Return the name of the run of one seed."""
    return f"{arm}/{node}/seed-{seed}"


def as_json(configuration: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings in JSON's types; values of other types become text."""
    found: dict[str, Any] = json.loads(json.dumps(dict(configuration), default=str))
    return found


def hyperparameters(configuration: Mapping[str, Any]) -> dict[str, bool | int | float | str]:
    """Return nested settings as one level, with dotted names; lists and None become JSON text.

    Examples
    --------
    >>> hyperparameters({"budget": 1000, "learner": {"epsilon": 0.1, "tags": ["a", "b"]}})
    {'budget': 1000, 'learner.epsilon': 0.1, 'learner.tags': '["a", "b"]'}
    """
    flat: dict[str, bool | int | float | str] = {}
    for name, value in as_json(configuration).items():
        if isinstance(value, dict) and value:
            flat |= {f"{name}.{inner}": leaf for inner, leaf in hyperparameters(value).items()}
        elif isinstance(value, bool | int | float | str):
            flat[name] = value
        else:
            flat[name] = json.dumps(value, ensure_ascii=False)
    return flat


@contextmanager
def environment_variables(**defaults: str) -> Iterator[None]:
    """Set environment variables, those that are not set already, while the context lasts."""
    added = {name: value for name, value in defaults.items() if name not in os.environ}
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            os.environ.pop(name, None)
