"""Units that failed: the arms that need them are left out, the others are trained and compared."""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass, field
from typing import Any

from curricle.errors import CurricleError, EngineError, StoreError, StudyError, in_words
from curricle.statistics.curves import SCRATCH
from curricle.study.folders import write_errors
from curricle.study.store import StudyStore
from curricle.study.units import Unit

FAILURES = "failures.json"
"""The units that failed in the last run, in its folder; there is no such file if none did."""
Keys = Mapping[tuple[str, str], str]
"""The key of each arm's tasks, as in :class:`Arms`."""


@dataclass
class Failures:
    """The units that failed in a run.

    Attributes
    ----------
    keys : dict of (str, str) to str
        As in :class:`Arms`.
    each : list of (Unit, Exception)
        In the order in which they failed.
    executor_failed : bool
        Whether one of them was never trained, as the executor failed.
    """

    keys: Keys
    each: list[tuple[Unit, BaseException]] = field(default_factory=list)
    executor_failed: bool = False
    _kept: set[str] = field(default_factory=set, init=False)
    """The keys that arms without a failure need, once there is one."""

    def __bool__(self) -> bool:
        return bool(self.each)

    def add(self, unit: Unit, error: Exception) -> None:
        """Note that a unit failed; a BrokenExecutor's cause is why."""
        if isinstance(error, BrokenExecutor):
            self.executor_failed = True
            self.each.append((unit, error.__cause__ or error))
        else:
            self.each.append((unit, error))
        lost = arms_of(self.keys, {one.key for one, _ in self.each})
        none = self.executor_failed or SCRATCH in lost
        self._kept = {key for (arm, _), key in self.keys.items() if not none and arm not in lost}

    def keeps(self, unit: Unit) -> bool:
        """Return whether an arm without a failure needs a unit; without scratch nothing is kept."""
        return not self.each or unit.key in self._kept

    def rows(self) -> list[dict[str, Any]]:
        """Return what :func:`failed_arms` reads; it is no arm's fault that an executor failed."""
        if self.executor_failed:
            return []
        return [
            {
                "key": unit.key,
                "seeds": list(unit.seeds),
                "error": f"{unit.label}: {without_folders(in_words(error))}",
            }
            for unit, error in self.each
        ]

    def error(self) -> StudyError:
        """Return one error for all; its cause is the first that is not the library's own."""
        (unit, first), *others = self.each
        text = f"{unit.label} failed, and all that is stored is whole: {in_words(first)}"
        for other, error in others:
            if not isinstance(error, EngineError):  # one sentence says that a cluster is lost
                text += f"; {other.label} failed too: {in_words(error)}"
        lost = any(isinstance(error, EngineError) for _, error in self.each)
        found = EngineError(text) if lost else StudyError(text)
        foreign = [error for _, error in self.each if not isinstance(error, CurricleError)]
        found.__cause__ = foreign[0] if foreign else None
        return found


def without_folders(text: str) -> str:
    """Return an error's text with the names of files only: folders are those of one machine.

    Examples
    --------
    >>> without_folders("cannot read '/home/me/thesis 2/maze.txt': 1/2 is there")
    "cannot read 'maze.txt': 1/2 is there"
    """
    quoted = re.sub(r"""(['"])(?:[A-Za-z]:)?[/\\][^'"\n]*[/\\]([^'"\n/\\]+)\1""", r"\1\2\1", text)
    return re.sub(r"(?<![\w.:/\\])(?:[A-Za-z]:)?[/\\](?:[^\s:'\"/\\]*[/\\]+)+", "", quoted)


def arms_of(keys: Keys, some: Collection[str]) -> set[str]:
    """Return the arms that need a unit with one of these keys.

    Examples
    --------
    >>> sorted(arms_of({("a", "maze"): "0f", ("b", "maze"): "0f", ("c", "maze"): "1e"}, ["0f"]))
    ['a', 'b']
    """
    return {arm for (arm, _), key in keys.items() if key in some}


def read_failures(store: StudyStore) -> list[dict[str, Any]]:
    """Return the rows of :meth:`Failures.rows` that a folder holds; StoreError if damaged."""
    found = store.read_json(FAILURES) if store.has(FAILURES) else []
    try:
        return [
            {"key": str(row["key"]), "seeds": [*map(int, row["seeds"])], "error": str(row["error"])}
            for row in found
        ]
    except (TypeError, KeyError, ValueError, OverflowError):
        raise StoreError(
            f"{store.path / FAILURES} must list units that failed, each with key, seeds and error: "
            "delete it, and show leaves out no arm"
        ) from None


def failed_arms(
    rows: Iterable[Mapping[str, Any]], keys: Keys, stored: Mapping[str, Mapping[int, Any]]
) -> dict[str, str]:
    """Return the first error of each arm that needs a unit that failed and is not stored since."""
    found: dict[str, str] = {}
    for row in rows:
        if not set(row["seeds"]) <= set(stored.get(row["key"], ())):
            for arm in sorted(arms_of(keys, [row["key"]])):
                found.setdefault(arm, row["error"])
    return found


def write_failures(store: StudyStore, rows: Sequence[dict[str, Any]]) -> None:
    """Write the failures of a run in the place of those of an earlier one."""
    if rows:
        store.write_json(FAILURES, rows)
    else:
        with write_errors(store.path):
            (store.path / FAILURES).unlink(missing_ok=True)
