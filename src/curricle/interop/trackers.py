"""Sending a study's curves to the tools that people watch: :func:`open_trackers`."""

import sys
from collections.abc import Callable, Iterable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from curricle.checks import one_of
from curricle.errors import SettingError
from curricle.interop.mlflow import MLflow
from curricle.interop.tensorboard import TensorBoard
from curricle.interop.tracker import Tracker
from curricle.interop.wandb import WandB
from curricle.learning.result import LearningResult

TRACKERS: dict[str, type[Tracker]] = {
    "tensorboard": TensorBoard,
    "wandb": WandB,
    "mlflow": MLflow,
}
"""Name of a tool, which is also its package's and that of Curricle's extra, -> its tracker."""


def open_trackers(
    trackers: Iterable[str | Tracker],
    study: str,
    configuration: Mapping[str, Any],
    folder: str | Path,
    report: Callable[[str], Any] | None = None,
) -> "Trackers":
    """Return trackers that have been told of a study, as one.

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
    opened = Trackers([_tracker(each) for each in dict.fromkeys(trackers)], report)
    opened.start(study, configuration, Path(folder))
    return opened


class Trackers:
    """Several trackers as one, which never stops the study.

    A tracker that raises is reported, with the place and the exception, and not called again; the
    others go on. Only what is no `Exception` passes, as KeyboardInterrupt.

    Parameters
    ----------
    trackers : iterable of Tracker
    report : callable, optional
        Called with one sentence for each failure; by default it is printed to stderr.

    Attributes
    ----------
    failures : list of str
        The sentences reported of failures.

    Examples
    --------
    >>> class Full:
    ...     def start(self, study, configuration, folder):
    ...         raise OSError("no space left")
    ...     def record(self, arm, node, result):
    ...         pass
    ...     def close(self):
    ...         pass
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
        self._report = _to_stderr if report is None else report
        self._recorded = False
        self.failures: list[str] = []

    def start(self, study: str, configuration: Mapping[str, Any], folder: Path) -> None:
        """Tell every tracker of the study."""
        folder = folder.resolve()
        self._each("at the start of the study", lambda t: t.start(study, configuration, folder))

    def record(self, arm: str, node: str, result: LearningResult) -> None:
        """Tell every tracker of a task that was trained."""
        self._recorded = True
        self._each(f"at arm {arm!r}, task {node!r}", lambda t: t.record(arm, node, result))

    def close(self) -> None:
        """Tell every tracker that nothing more will come, and report if nothing ever came."""
        if self._working and not self._recorded:
            tools = ", ".join(type(tracker).__name__ for tracker in self._working)
            self._report(f"{tools}: nothing was logged, as this run finished no unit of work")
        self._each("at the end of the study", lambda t: t.close())
        self._working = []

    def _each(self, place: str, tell: Callable[[Tracker], None]) -> None:
        """Call all that work, and switch off those that raise."""
        for tracker in tuple(self._working):
            try:
                tell(tracker)
            except Exception as error:
                self._working = [other for other in self._working if other is not tracker]
                what = " ".join(f"{type(error).__name__}: {error}".split())
                failure = f"{type(tracker).__name__} failed {place} and is switched off: {what}"
                self.failures.append(failure)
                self._report(failure)


def _tracker(given: str | Tracker) -> Tracker:
    """Return the tracker of a name, if its tool is installed."""
    if isinstance(given, Tracker):
        return given
    one_of("a tracker", given, TRACKERS, SettingError)
    found = find_spec(given)
    if found is None or found.origin is None:  # a folder of that name is importable, but empty
        raise SettingError(
            f"tracker {given!r} needs a package that is not installed: "
            f"pip install curricle[{given}]"
        )
    return TRACKERS[given]()


def _to_stderr(sentence: str) -> None:
    print(sentence, file=sys.stderr)
