"""Where in a study file something is written, to say so in a message."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from curricle.errors import ConfigError, CurricleError
from curricle.study.config.merging import SETTINGS
from curricle.study.config.tables import KeyPath
from curricle.study.config.task_names import table


@dataclass(frozen=True)
class Positions:
    """Where the keys of a study file stand.

    Parameters
    ----------
    file : str
        What messages call it.
    study : dict
        Its content, with what was set.
    lines : dict of key path to int
        The line of each key.
    given : sequence of key path
        What was set from outside.
    """

    file: str
    study: Mapping[str, Any]
    lines: Mapping[KeyPath, int] = field(default_factory=dict)
    given: Sequence[KeyPath] = ()

    def line(self, path: KeyPath) -> int:
        """Return the line of a key path, or of the table it is in; 0 if it is not in the file."""
        begins = [path[:n] for n in range(len(path), 0, -1)]
        if any(begin in self.given for begin in begins):
            return 0
        return next((self.lines[begin] for begin in begins if begin in self.lines), 0)

    def sentence(self, path: KeyPath, text: str) -> str:
        """Return what is wrong as a sentence on one line: file, line, key path and text."""
        line = self.line(path)
        given = any(path[: len(one)] == one for one in self.given)
        where = f", line {line}" if line else ", as set" if given else ""
        return f"{self.file}{where}: {spelt(path) or 'the study'} {' '.join(text.split())}"

    def written(self, arm: str, path: KeyPath) -> KeyPath:
        """Return where a part of an arm's curriculum is written in the file.

        Parameters
        ----------
        arm : str
        path : key path
            In the complete curriculum, such as ``("tasks", "chase", "budget")``.
        """
        patch = table(table(self.study.get("arms")).get(arm))
        chosen = patch.get("transfers")
        if path[:1] == ("transfers",) and len(path) > 1 and isinstance(chosen, list):
            one = chosen[int(path[1])]
            return ("transfers", one, *path[2:]) if type(one) is int else ("arms", arm, *path)
        if not path or (len(path) == 1 and path[0] not in patch):
            return path or (("arms", arm) if patch else ())
        # Transfers are a list, but an arm that changes some of them has a table of numbers.
        keys = map(str, path) if path[0] == "transfers" else path
        homes = [("arms", arm, *keys), path]
        if len(path) > 2 and path[0] == "tasks" and path[2] in SETTINGS:
            homes += [("arms", arm, *path[2:]), path[2:]]  # a setting for all tasks
        return min(homes, key=lambda home: len(home) - _reach(self.study, home))


def spelt(path: KeyPath) -> str:
    """Return a key path as messages name it.

    Examples
    --------
    >>> spelt(("transfers", 0, "scale")), spelt(("tasks", "5 by 5", "size"))
    ('transfers[0].scale', 'tasks."5 by 5".size')
    """
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            word = part if re.fullmatch(r"[\w-]+", part) else f'"{part}"'
            text += f".{word}" if text else word
    return text


def _reach(node: Any, path: KeyPath) -> int:
    """Return how many keys of a path there are."""
    for done, part in enumerate(path):
        try:
            node = node[part]
        except (KeyError, IndexError, TypeError):
            return done
    return len(path)


class Problems:
    """What is wrong with a study, collected to be reported at once."""

    def __init__(self) -> None:
        self.found: dict[str, None] = {}
        self.cause: Exception | None = None

    def add(self, sentences: Iterable[str]) -> None:
        """Add sentences; each is reported once."""
        self.found.update(dict.fromkeys(sentences))

    @contextmanager
    def at(self, positions: Positions, path: KeyPath) -> Iterator[None]:
        """Add what the library refuses in this context, with the key path."""
        try:
            yield
        except CurricleError as error:
            self.cause = self.cause or error
            self.found[positions.sentence(path, f"is refused: {error}")] = None

    def raise_any(self) -> None:
        """Raise ConfigError if anything is wrong."""
        if self.found:
            raise ConfigError("\n".join(self.found)) from self.cause
