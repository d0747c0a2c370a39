"""TensorBoard."""

import re
import time
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from curricle.errors import StoreError
from curricle.interop.trackers import checkpoints, hyperparameters
from curricle.learning.result import LearningResult

NO_FILE_NAME = re.compile(r'[%<>:"/\\|?*\x00-\x1f]|^\.|[. ]$')
"""What is not allowed in a file name on some system."""


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
