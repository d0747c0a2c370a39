"""Trackers: a study's curves in a tool of the user's."""

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from curricle.errors import SettingError, in_words
from curricle.learning.result import LearningResult

CURVES = {
    "rollout/ep_rew_mean": "training_return",
    "eval/mean_reward": "greedy_return",
    "time/episodes": "episodes",
    "curricle/source_share": "source_share",
}
"""Tag of a curve, as other libraries name it, -> field of :class:`LearningResult`."""


@runtime_checkable
class Tracker(Protocol):
    """Logs a study as it runs.

    A tracker may raise any `Exception`: it is reported, and the tracker is switched off.

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
        """Begin a study, with its settings, nested as in its file, and its absolute folder."""

    def record(self, arm: str, node: str, result: LearningResult) -> None:
        """Log the result of a task, `node`, that has been trained in an arm."""

    def close(self) -> None:
        """End the study."""


class Trackers:
    """Several trackers as one: a tracker that raises is not called again, and the study goes on.

    `report` is called with a sentence for each failure, by default printed to stderr.

    Examples
    --------
    >>> Trackers([print])
    Traceback (most recent call last):
    curricle.errors.SettingError: a tracker must have start, record and close: got <built-in...
    """

    def __init__(
        self, trackers: Iterable[Tracker], report: Callable[[str], Any] | None = None
    ) -> None:
        self._working = trackers_of(trackers)
        self._report = to_stderr if report is None else report
        self._recorded = False

    def start(self, study: str, configuration: Mapping[str, Any], folder: str | Path) -> None:
        """Begin a study with every tracker."""
        place = Path(folder).resolve()
        self._call("at the start of the study", lambda t: t.start(study, configuration, place))

    def record(self, arm: str, node: str, result: LearningResult) -> None:
        """Log a task that has been trained with every tracker."""
        self._recorded = True
        self._call(f"at arm {arm!r}, task {node!r}", lambda t: t.record(arm, node, result))

    def close(self) -> None:
        """End the study with every tracker, and report if nothing was ever recorded."""
        if self._working and not self._recorded:
            tools = ", ".join(type(tracker).__name__ for tracker in self._working)
            self._report(f"{tools}: nothing was logged, as this run finished no unit of work")
        self._call("at the end of the study", lambda t: t.close())
        self._working = []

    def _call(self, place: str, call: Callable[[Tracker], None]) -> None:
        for tracker in tuple(self._working):
            try:
                call(tracker)
            except Exception as error:
                self._working = [other for other in self._working if other is not tracker]
                reason = " ".join(in_words(error).split())
                name = type(tracker).__name__
                self._report(f"{name} failed {place} and is switched off: {reason}")


def trackers_of(trackers: Iterable[Tracker]) -> list[Tracker]:
    """Return trackers without repetition; SettingError if one lacks a method."""
    listed = [*dict.fromkeys(trackers)]
    for tracker in listed:
        if not isinstance(tracker, Tracker):
            raise SettingError(f"a tracker must have start, record and close: got {tracker!r}")
    return listed


def to_stderr(sentence: str) -> None:
    """Print a sentence to stderr."""
    print(sentence, file=sys.stderr)


def checkpoints(result: LearningResult, k: int) -> Iterator[tuple[int, dict[str, float]]]:
    """Yield the step and the values by tag of each checkpoint of the k-th seed that has any.

    Examples
    --------
    >>> from curricle import GridWorld, learn
    >>> next(checkpoints(learn(GridWorld("S.T"), budget=20), 0))
    (0, {'eval/mean_reward': 168.98, 'time/episodes': 0.0})
    """
    curves = {tag: getattr(result, field)[k] for tag, field in CURVES.items()}
    for t in np.flatnonzero(result.steps <= result.steps_used[k]):
        values = {tag: float(curve[t]) for tag, curve in curves.items() if not np.isnan(curve[t])}
        if values:
            yield int(result.steps[t]), values
