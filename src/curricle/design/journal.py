"""The journal of a design: its trainings in order, in a file that a killed run goes on from."""

import json
import os
from pathlib import Path
from typing import Any

from curricle.errors import CurriculumError


class Journal:
    """A file with one line of JSON for each training, in the order in which they were made.

    A design does the same trainings in the same order every time, so that what was written is read
    in order. A last line that a kill cut short is left out, and its training made again.

    Parameters
    ----------
    path : path
        Of the file; it is made where it is not there.

    Raises
    ------
    CurriculumError
        When a line in it is no training.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "trainings.jsonl"
    >>> Journal(path).add("a", {"steps": [3]})
    >>> again = Journal(path)
    >>> again.next("a"), again.next("b")
    ({'steps': [3]}, None)
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._known = _entries(self.path)
        self._at = 0

    def next(self, key: str) -> dict[str, Any] | None:
        """Return what the next training in the file gave; None where there is no more.

        Raises
        ------
        CurriculumError
            When it is another training than the one with this key.
        """
        if self._at == len(self._known):
            return None
        entry = self._known[self._at]
        if entry["key"] != key:
            raise CurriculumError(
                f"{self.path} holds another design: its training {self._at + 1} is not that of "
                "this one; go on with the same problems, budget and seed, or give another file"
            )
        self._at += 1
        found: dict[str, Any] = entry["found"]
        return found

    def add(self, key: str, found: dict[str, Any]) -> None:
        """Append a training to the file; it is on the disk when this returns."""
        line = json.dumps({"key": key, "found": found}) + "\n"
        with self.path.open("ab") as file:
            file.write(line.encode())
            file.flush()
            os.fsync(file.fileno())


def _entries(path: Path) -> list[dict[str, Any]]:
    """Return the entries of a journal, and cut what a kill left of a line."""
    if not path.exists():
        return []
    content = path.read_bytes()
    whole = content[: content.rfind(b"\n") + 1]
    if len(whole) < len(content):
        with path.open("r+b") as file:
            file.truncate(len(whole))
    found = []
    for number, line in enumerate(whole.splitlines(), 1):
        try:
            entry = json.loads(line)
            if set(entry) != {"key", "found"}:
                raise ValueError
        except (ValueError, TypeError):
            raise CurriculumError(f"line {number} of {path} is no training of a design") from None
        found.append(entry)
    return found
