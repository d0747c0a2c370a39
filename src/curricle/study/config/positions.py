"""Where in a study file each key is, for messages."""

import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from pydantic import ValidationError

from curricle.errors import ConfigError, CurricleError
from curricle.study.config.merging import SETTINGS
from curricle.study.config.tables import SHOWN, KeyPath, shown
from curricle.study.config.task_names import table


@dataclass(frozen=True)
class Positions:
    """Where the keys of a study file are."""

    file: str
    """What messages call it."""
    study: Mapping[str, Any]
    """Its content, with what was set from outside."""
    lines: Mapping[KeyPath, int] = field(default_factory=dict)
    """The line of each key."""
    given: Sequence[KeyPath] = ()
    """What was set from outside."""
    varied: Mapping[str, tuple[str, Mapping[KeyPath, KeyPath]]] = field(default_factory=dict)
    """Arm that a sweep or a tuning makes -> the arm in the file, and place in its curriculum ->
    where the file says how that varies."""

    def line(self, path: KeyPath) -> int:
        """Return the line of a key path, or of the table it is in; 0 if it is not in the file."""
        begins = [path[:n] for n in range(len(path), 0, -1)]
        if any(begin in self.given for begin in begins):
            return 0
        return next((self.lines[begin] for begin in begins if begin in self.lines), 0)

    def sentence(self, path: KeyPath, text: str) -> str:
        """Return what is wrong as a sentence on one line: file, line, key path and text."""
        line = self.line(path)
        # Set from outside: the key, the table it is in, or a key in the table that it names.
        given = path and any(
            path[: len(one)] == one or one[: len(path)] == path for one in self.given
        )
        where = (f", line {line}" if line else "") + (", as set" if given else "")
        return f"{self.file}{where}: {path_text(path) or 'the study'} {' '.join(text.split())}"

    def in_file(self, arm: str, path: KeyPath) -> KeyPath:
        """Return where the file has a part of an arm's complete curriculum, given by its path."""
        arm, varied = self.varied.get(arm, (arm, {}))
        for place, home in varied.items():
            n = min(len(place), len(path))
            setting = place[0] == "tasks" and place[2] in SETTINGS
            if place[:n] == path[:n] and n > 1 + setting:  # not only the task that has it
                return home
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
        elif len(path) > 2 and path[0] == "tasks":
            written = [table(one.get("tasks")).get(str(path[1])) for one in (patch, self.study)]
            named = [table(one).get("family") for one in written]
            homes += [("families", name, *path[2:]) for name in named if isinstance(name, str)]
        return min(homes, key=lambda home: len(home) - _reach(self.study, home))


def path_text(path: KeyPath) -> str:
    """Return a key path as messages name it.

    Examples
    --------
    >>> path_text(("transfers", 0, "scale")), path_text(("tasks", "5 by 5", "size"))
    ('transfers[0].scale', 'tasks."5 by 5".size')
    """
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            plain = re.fullmatch(r"[\w-]+", part) and len(part) <= SHOWN
            word = part if plain else f'"{shown(part)[1:-1]}"'
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

    def __init__(self, positions: Positions):
        self.positions = positions
        self.found: dict[str, None] = {}
        self.cause: Exception | None = None

    def add(self, wrong: Iterable[tuple[KeyPath, str]]) -> None:
        """Add key paths with what is wrong there, in the order of the file, each once."""
        for path, text in sorted(wrong, key=lambda one: self.positions.line(one[0])):
            self.found[self.positions.sentence(path, text)] = None

    @contextmanager
    def at(self, arm: str, path: KeyPath) -> Iterator[None]:
        """Add what the library refuses in this context, about a part of an arm's curriculum."""
        try:
            yield
        except ValidationError as error:
            wrong = [((*path, *one["loc"]), one["msg"]) for one in error.errors(include_url=False)]
            self.add([(self.positions.in_file(arm, place), text) for place, text in wrong])
        except CurricleError as error:
            self.cause = self.cause or error
            self.add([(self.positions.in_file(arm, path), f"is refused: {error}")])

    def raise_any(self) -> None:
        """Raise ConfigError if anything is wrong."""
        if self.found:
            raise ConfigError("\n".join(self.found)) from self.cause


# -- the line of each key ----------------------------------------------------------------------

TOKEN = re.compile(
    r"""
      (?P<blank>[ \t\r]+|\#[^\n]*)
    | (?P<text>\"{3}(?:\\.|[^\\])*?\"{3,5} | '{3}.*?'{3,5} | "(?:\\.|[^"\\\n])*" | '[^'\n]*')
    | (?P<sign>[\[\]{},=.\n])
    | (?P<bare>[^\s\[\]{},=.\#"']+)
    """,
    re.VERBOSE | re.DOTALL,
)


def line_numbers(text: str) -> dict[KeyPath, int]:
    r"""Return the line on which each table, key and list entry of a TOML text begins, from 1.

    The standard library's parser does not report them. It has accepted the text before.

    Examples
    --------
    >>> lines = line_numbers("[tasks.chase] # '''\nsize = 5\nends = ['a',\n'b']")
    >>> lines["tasks", "chase", "size"], lines["tasks", "chase", "ends", 1]
    (2, 4)
    """
    return _Scanner(text).lines


class _Token(NamedTuple):
    text: str
    sign: str
    """The text if it is a sign, such as ``=``; "end" after the last token."""
    line: int


class _Scanner:
    """Reads the tokens of a text once, one ahead."""

    def __init__(self, text: str):
        self.tokens = _tokens(text)
        self.next = next(self.tokens)
        self.lines: dict[KeyPath, int] = {}
        self.arrays = Counter[KeyPath]()
        here: KeyPath = ()
        while self.next.sign != "end":
            if self.next.sign == "\n":
                self.take()
            elif self.next.sign == "[":
                here = self.header()
            else:
                self.pair(here)

    def take(self) -> _Token:
        taken, self.next = self.next, next(self.tokens, self.next)
        return taken

    def skip(self, *signs: str) -> None:
        while self.next.sign in signs:
            self.take()

    def header(self) -> KeyPath:
        """Return the path of the table that a ``[header]`` or ``[[header]]`` begins."""
        line = self.take().line
        listed = self.next.sign == "["
        self.skip("[")
        path: KeyPath = ()
        keys = self.keys()
        for n, key in enumerate(keys):
            path = (*path, key)
            self.lines.setdefault(path, line)
            if listed and n == len(keys) - 1:
                self.arrays[path] += 1
            if path in self.arrays:
                path = (*path, self.arrays[path] - 1)
                self.lines.setdefault(path, line)
        self.skip("]")
        return path

    def keys(self) -> list[str]:
        """Take a dotted key."""
        found = [_unquoted(self.take().text)]
        while self.next.sign == ".":
            self.take()
            found.append(_unquoted(self.take().text))
        return found

    def pair(self, here: KeyPath) -> None:
        """Take ``key = value``."""
        line = self.next.line
        for key in self.keys():
            here = (*here, key)
            self.lines.setdefault(here, line)
        self.take()  # =
        self.value(here)

    def value(self, here: KeyPath) -> None:
        """Take a value, with the keys and entries inside it."""
        begin = self.take().sign
        if begin in ("[", "{"):
            end, entry = "]" if begin == "[" else "}", 0
            self.skip("\n")
            while self.next.sign != end:
                if end == "}":
                    self.pair(here)
                else:
                    self.lines.setdefault((*here, entry), self.next.line)
                    self.value((*here, entry))
                    entry += 1
                self.skip(",", "\n")
            self.take()
        while self.next.sign in ("", "."):  # the rest of a number or a date
            self.take()


def _tokens(text: str) -> Iterator[_Token]:
    line = 1
    for match in TOKEN.finditer(text):
        if match.lastgroup != "blank":
            yield _Token(match[0], match[0] if match.lastgroup == "sign" else "", line)
        line += match[0].count("\n")
    yield _Token("", "end", line)


def _unquoted(key: str) -> str:
    return str(tomllib.loads(f"key = {key}")["key"]) if key[0] in "'\"" else key
