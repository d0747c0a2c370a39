"""Records in a file, a line of JSON each, by key: a killed run loses the one it was making."""

import fcntl
import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

Record = dict[str, Any]


class Lines:
    """The records of a file. What a kill left of a last line is cut off.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "unit.jsonl"
    >>> Lines(path).once(["judged", "a"], lambda: {"steps": [3]})
    {'steps': [3]}
    >>> Lines(path).once(["judged", "a"], lambda: {"steps": [4]})
    {'steps': [3]}
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._records = dict(_records(path))

    def get(self, key: list[Any]) -> Record | None:
        """Return the record of a key; None where there is none."""
        return self._records.get(json.dumps(key))

    def once(self, key: list[Any], make: Callable[[], Record]) -> Record:
        """Return the record of a key; it is made and written where there is none."""
        known = self.get(key)
        if known is not None:
            return known
        text = json.dumps({"key": key, "record": make()})
        with self.path.open("ab") as file:
            file.write(text.encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())
        found: Record = json.loads(text)["record"]
        self._records[json.dumps(key)] = found
        return found


def _records(path: Path) -> Iterator[tuple[str, Record]]:
    if not path.exists():
        return
    content = path.read_bytes()
    whole = content[: content.rfind(b"\n") + 1]
    if len(whole) < len(content):
        os.truncate(path, len(whole))
    for line in whole.splitlines():
        entry = json.loads(line)
        yield json.dumps(entry["key"]), entry["record"]


@contextmanager
def held(path: Path) -> Iterator[bool]:
    """Yield whether this process alone has a file; False where another one has it.

    Several commands may so share one folder. A lock ends with its process, however it ends.
    """
    with path.with_suffix(".lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
            return
        yield True
