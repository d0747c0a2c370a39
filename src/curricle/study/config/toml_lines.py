"""The line of each key of a TOML text, which the standard library's parser does not report.

The text has been parsed before, so it is valid; what is left to find is where keys begin.
"""

import re
import tomllib
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

from curricle.study.config.tables import KeyPath

TOKEN = re.compile(
    r"""
      (?P<blank>[ \t\r]+|\#[^\n]*)
    | (?P<text>\"{3}(?:\\.|[^\\])*?\"{3,5} | '{3}.*?'{3,5} | "(?:\\.|[^"\\\n])*" | '[^'\n]*')
    | (?P<sign>[\[\]{},=.\n])
    | (?P<bare>[^\s\[\]{},=.\#"']+)
    """,
    re.VERBOSE | re.DOTALL,
)


class Token(NamedTuple):
    """A piece of a TOML text."""

    text: str
    kind: str
    line: int


def line_numbers(text: str) -> dict[KeyPath, int]:
    r"""Return the line on which each table, key and list entry of a TOML text begins, from 1.

    Examples
    --------
    >>> lines = line_numbers("[tasks.chase] # '''\nsize = 5\nends = ['a',\n'b']")
    >>> lines["tasks", "chase", "size"], lines["tasks", "chase", "ends", 1]
    (2, 4)
    """
    return _Scanner(text).lines


class _Scanner:
    """Walks through the tokens of a text once."""

    def __init__(self, text: str):
        self.tokens = [*_tokens(text), Token("", "end", 0)]
        self.at = 0
        self.lines: dict[KeyPath, int] = {}
        self.arrays = Counter[KeyPath]()
        here: KeyPath = ()
        while self.next().kind != "end":
            if self.next().text == "\n":
                self.take()
            elif self.next().text == "[":
                here = self.header()
            else:
                self.pair(here)

    def next(self) -> Token:
        return self.tokens[self.at]

    def take(self) -> Token:
        self.at += 1
        return self.tokens[self.at - 1]

    def skip(self, *texts: str) -> None:
        while self.next().text in texts and self.next().kind == "sign":
            self.take()

    def header(self) -> KeyPath:
        """Return the path of the table that a ``[header]`` or ``[[header]]`` begins."""
        line = self.take().line
        listed = self.next().text == "["
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
        found = [_unquoted(self.take())]
        while self.next().text == "." and self.next().kind == "sign":
            self.take()
            found.append(_unquoted(self.take()))
        return found

    def pair(self, here: KeyPath) -> None:
        """Take ``key = value``."""
        line = self.next().line
        for key in self.keys():
            here = (*here, key)
            self.lines.setdefault(here, line)
        self.take()  # =
        self.value(here)

    def value(self, here: KeyPath) -> None:
        """Take a value, with the keys and entries inside it."""
        begin = self.take()
        if begin.kind == "sign" and begin.text in "[{":
            end, entry = "]" if begin.text == "[" else "}", 0
            self.skip("\n")
            while self.next().text != end or self.next().kind != "sign":
                if end == "}":
                    self.pair(here)
                else:
                    self.lines.setdefault((*here, entry), self.next().line)
                    self.value((*here, entry))
                    entry += 1
                self.skip(",", "\n")
            self.take()
        elif begin.kind == "bare":  # a number or a date, which may have dots
            while self.next().kind == "bare" or self.next().text == ".":
                self.take()


def _tokens(text: str) -> Iterator[Token]:
    line = 1
    for match in TOKEN.finditer(text):
        kind = str(match.lastgroup)
        if kind != "blank":
            yield Token(match[0], kind, line)
        line += match[0].count("\n")


def _unquoted(token: Token) -> str:
    if token.kind != "text":
        return token.text
    return str(tomllib.loads(f"key = {token.text}")["key"])
