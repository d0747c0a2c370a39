"""Text files of a study, and TOML, read without trust: bounded in size and in depth."""

import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from curricle.files import read_bounded

TEXT = "utf-8-sig"
"""UTF-8, with or without a byte-order mark."""
LARGEST_FILE = 10_000_000
"""Bytes of a study file or a map: the largest example has 3,000."""
DEEPEST = 50
"""Tables and lists inside each other: what has more exhausts the stack of those that read it."""
LONGEST_NUMBER = 4096
"""Bits of a whole number: Python writes no number of more than 4,300 digits, as in a message."""
TOO_DEEP = f"tables and lists must be at most {DEEPEST} deep"
TOO_LONG = f"whole numbers must have at most {LONGEST_NUMBER:,} bits"


def text_of(path: Path) -> str:
    """Return the content of a text file; ValueError says why it cannot be read."""
    try:
        return read_bounded(path, LARGEST_FILE).decode(TEXT)
    except OSError as error:
        raise ValueError(error.strerror) from None
    except UnicodeDecodeError as error:
        raise ValueError(f"it is not UTF-8: {error}") from None


def parsed(text: str) -> dict[str, Any]:
    """Return what a TOML text says; ValueError says why it is none.

    Examples
    --------
    >>> parsed("a.b = 1")
    {'a': {'b': 1}}
    >>> parsed("a = " + "[" * 60 + "]" * 60)
    Traceback (most recent call last):
    ValueError: tables and lists must be at most 50 deep
    """
    found: dict[str, Any]
    try:
        found = tomllib.loads(text)
    except RecursionError:
        raise ValueError(TOO_DEEP) from None
    except tomllib.TOMLDecodeError:
        raise
    except ValueError:  # of Python's own limit for numbers in decimals
        raise ValueError(TOO_LONG) from None
    layer: list[Any] = [found]
    for _ in range(DEEPEST):
        values = [one for node in layer for one in _values(node)]
        if any(isinstance(one, int) and one.bit_length() > LONGEST_NUMBER for one in values):
            raise ValueError(TOO_LONG)
        layer = [one for one in values if isinstance(one, dict | list)]
    if layer:
        raise ValueError(TOO_DEEP)
    return found


def _values(node: dict[str, Any] | list[Any]) -> Iterable[Any]:
    return node.values() if isinstance(node, dict) else node
