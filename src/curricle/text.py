"""Numbers, tables and values as text: columns stay apart at any width of a terminal."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from html import escape
from itertools import zip_longest
from textwrap import fill, wrap
from typing import Any

import numpy as np

GAP = 2  # spaces between two columns, at least
NARROWEST_NAME, NARROWEST_WORDS = 12, 20  # characters of a column that folds, or its longest word
UNBOUNDED = 10_000  # a width in which nothing folds
LONGEST, LONGEST_VALUE, MOST_ELEMENTS = 900, 60, 5  # of a ``repr``, a value, an array


def counted(n: int, noun: str) -> str:
    """Return a number and its noun, in the singular for 1."""
    return f"{n:,} {noun}{'s' * bool(n != 1)}"


def printed(result: object) -> str:
    """Return the printed lines of a result as HTML; serves a class as ``_repr_html_``."""
    return f"<pre>{escape(str(result))}</pre>"


def or_dash(value: float, form: str = ".3g") -> str:
    """Return a number in a format, a dash for NaN."""
    return "-" if math.isnan(value) else format(value, form)


def minus(number: str) -> str:
    """Return a printed number with a minus sign in place of the hyphen."""
    return number.replace("-", "−")


def rounded(number: float) -> str:
    """Return a number in three significant digits, trailing zeros too, or as a whole number."""
    if number == 0:
        return "0"
    return minus(f"{number:,.0f}" if abs(number) >= 99.95 else f"{number:#.3g}")


def folded(text: str, width: int) -> str:
    """Return a paragraph as lines; lines after the first are indented by two."""
    width = max(width, NARROWEST_NAME)
    return fill(text, width, subsequent_indent="  ", break_on_hyphens=False)


def text_table(
    heads: Sequence[str],
    rows: Iterable[Sequence[str]],
    width: int = UNBOUNDED,
    *,
    prose: bool = False,
) -> list[str]:
    """Return a table's lines, `width` wide: names, then numbers, never cut; `prose` comes last."""
    cells = [tuple(heads), *(tuple(row) for row in rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    excess = sum(widths) + GAP * (len(widths) - 1) - width
    for column, narrowest in ((-1, NARROWEST_WORDS), (0, NARROWEST_NAME))[not prose :]:
        words = [heads[column], *(word for row in cells for word in row[column].split())]
        room = max(0, widths[column] - max(narrowest, *map(len, words)))
        less = max(0, min(excess, room))
        widths[column], excess = widths[column] - less, excess - less
    if excess <= 0:
        return [line for row in cells for line in _side_by_side(row, widths, prose)]
    lines, width = list[str](), max(width, NARROWEST_NAME)
    for name, *numbers in cells[1:]:  # a row becomes its name and a line for each other cell
        lines += wrap(name, width)
        for head, cell in zip(heads[1:], numbers, strict=True):
            if cell.strip():
                text = f"{head}: {cell.strip()}" if head else cell.strip()
                lines += wrap(text, width, initial_indent="  ", subsequent_indent="    ")
    return lines


def _side_by_side(row: Sequence[str], widths: Sequence[int], prose: bool) -> list[str]:
    """Return a row as lines; cells that are too long fold."""
    cells = [
        wrap(cell, max(size, 1), break_on_hyphens=False) or [""]
        for cell, size in zip(row, widths, strict=True)
    ]
    lines, left = [], {0, len(row) - 1} if prose else {0}
    for parts in zip_longest(*cells, fillvalue=""):
        padded = [
            part.ljust(size) if column in left else part.rjust(size)
            for column, (part, size) in enumerate(zip(parts, widths, strict=True))
        ]
        lines.append((" " * GAP).join(padded).rstrip())
    return lines


def brief_repr(result: Any) -> str:
    """Return a short ``repr`` of a dataclass: arrays by their shape, long values by their type."""
    names = [field.name for field in fields(result) if field.repr]
    parts = [f"{name}={brief_value(getattr(result, name))}" for name in names]
    return shortened(f"{type(result).__name__}({', '.join(parts)})")


def brief_value(value: object) -> str:
    """Return a value in at most `LONGEST_VALUE` characters, about."""
    if isinstance(value, np.ndarray):
        small = value.size <= MOST_ELEMENTS
        return " ".join(repr(value).split()) if small else f"{value.dtype} {value.shape}"
    text = " ".join(repr(value).split())
    if len(text) <= LONGEST_VALUE:
        return text
    printing: Any = type(value).__str__
    if printing not in (object.__str__, str.__str__) and "\n" not in str(value):
        text = str(value)
        return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}..."
    if isinstance(value, Mapping):
        names = ", ".join(map(str, value))
        return f"{{{names}}}" if len(names) <= LONGEST_VALUE else f"dict of {len(value)}"
    if isinstance(value, tuple | list | set | frozenset):
        return f"{type(value).__name__} of {len(value)}"
    is_text = isinstance(value, str)
    return f"'{text[1:LONGEST_VALUE]}...'" if is_text else f"{type(value).__name__}(...)"


WHITE = "\n\t\u00a0\u202f"  # characters that are not printable and stay


def visible(text: str) -> str:
    """Return a text with control and format characters written out: some reverse later text."""
    return "".join(c if c.isprintable() or c in WHITE else ascii(c)[1:-1] for c in text)


def shortened(text: str) -> str:
    """Return a text of at most `LONGEST` characters."""
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 4]} ..."


def duration(seconds: float) -> str:
    """Return a duration as text."""
    if seconds < 120:
        return f"{max(1, round(seconds))} s"
    return f"{seconds / 60:,.0f} min" if seconds < 7200 else f"{seconds / 3600:,.1f} h"
