"""Plain data as the text of TOML files that people read: short lines, inline tables."""

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from textwrap import wrap
from typing import Any

from curricle.study.config.tasks import NONE

WIDTH = 100
"""Characters of a line, where it can be broken."""
COMMENTS = 28
"""Column in which comments behind values begin, where they can."""


def toml_value(value: Any) -> str:
    r"""Return a value on one line.

    Numbers come back exactly; None is written as the text that files have for it.

    Examples
    --------
    >>> print(toml_value([True, 60_000, 0.1, None, 'a "b"', {"size": "0.5 n"}]))
    [true, 60_000, 0.1, "none", "a \"b\"", { size = "0.5 n" }]
    """
    if value is None:
        return f'"{NONE}"'
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return f"{int(value):_}"
    if isinstance(value, float):
        return repr(float(value))
    if isinstance(value, str):
        # JSON escapes what TOML does, but for DEL.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", r"\u007f")
    if isinstance(value, Mapping):
        inside = ", ".join(f"{toml_key(key)} = {toml_value(one)}" for key, one in value.items())
        return f"{{ {inside} }}" if inside else "{}"
    return f"[{', '.join(map(toml_value, value))}]"


def toml_key(key: str) -> str:
    """Return a key, in quotes where it needs them."""
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else toml_value(key)


def header(*keys: str, listed: bool = False) -> str:
    """Return the line that begins a table, or one of a list of tables.

    Examples
    --------
    >>> header("tasks", "rows 0..2"), header("stages", listed=True)
    ('[tasks."rows 0..2"]', '[[stages]]')
    """
    name = ".".join(map(toml_key, keys))
    return f"[[{name}]]" if listed else f"[{name}]"


def pair(key: str, value: Any, comment: str = "") -> str:
    """Return a line with a key and its value; a long list takes several.

    Examples
    --------
    >>> print(pair("chain", True, "each builds on the one before"))
    chain = true                # each builds on the one before
    """
    text = f"{toml_key(key)} = {toml_value(value)}"
    if len(text) > WIDTH and isinstance(value, list | tuple):
        items = ", ".join(toml_value(one).replace(" ", "\0") for one in value)  # unbroken
        lines = wrap(items, WIDTH - 4, break_long_words=False, break_on_hyphens=False)
        inside = "\n".join(f"    {line}".replace("\0", " ") for line in lines)
        text = f"{toml_key(key)} = [\n{inside},\n]"
    return f"{text:<{COMMENTS - 1}} # {comment}" if comment else text


def pairs(table: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of a table without its header."""
    for key, value in table.items():
        yield pair(key, value)


def comments(lines: Iterable[str]) -> Iterator[str]:
    """Yield lines as comments; what is empty stays so."""
    for line in lines:
        shown = "".join(one if one.isprintable() else " " for one in line)  # as TOML asks
        yield from (f"# {part}".rstrip() for part in (wrap(shown, WIDTH - 2) or [""]))
