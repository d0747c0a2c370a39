"""Tables and numbers as text: columns stay apart at any width of a terminal."""

import math
from collections.abc import Iterable, Sequence
from textwrap import fill, wrap

GAP = 2
"""Spaces between two columns, at least."""
NARROWEST_NAME, NARROWEST_WORDS = 12, 20
"""Characters to which a column of names, and one of words, may be narrowed before they fold."""
UNBOUNDED = 10_000
"""A width in which nothing folds."""


def counted(n: int, noun: str) -> str:
    """Return a number and what is counted, in the singular for one."""
    return f"{n:,} {noun}{'s' * bool(n != 1)}"


def or_dash(value: float, form: str = ".3g") -> str:
    """Return a number in a format, and a dash where there is none."""
    return "-" if math.isnan(value) else format(value, form)


def folded(text: str, width: int) -> str:
    """Return a paragraph as lines, those after the first indented by two."""
    most = max(width, NARROWEST_NAME)
    return fill(text, most, subsequent_indent="  ", break_on_hyphens=False)


def text_table(
    heads: Sequence[str],
    rows: Iterable[Sequence[str]],
    width: int = UNBOUNDED,
    *,
    words: bool = False,
) -> list[str]:
    """Return the lines of a table: a column of names, then numbers, which are never cut.

    Where the lines would be longer than `width`, names fold, and words. Where that is not enough
    each row becomes several lines: its name, then each number below the other.
    """
    cells = [tuple(heads), *(tuple(row) for row in rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    over = sum(widths) + GAP * (len(widths) - 1) - width
    if words and over > 0:
        widths[-1], over = _narrowed(widths[-1], over, max(NARROWEST_WORDS, len(heads[-1])))
    if over > 0:
        widths[0], over = _narrowed(widths[0], over, max(NARROWEST_NAME, len(heads[0])))
    if over > 0:
        return [line for row in cells[1:] for line in _stacked(heads, row, width)]
    return [line for row in cells for line in _side_by_side(row, widths, words)]


def _narrowed(column: int, over: int, narrowest: int) -> tuple[int, int]:
    """Return a column's width without what is over, as far as it may be, and what is over then."""
    less = max(0, min(over, column - narrowest))
    return column - less, over - less


def _side_by_side(row: Sequence[str], widths: Sequence[int], words: bool) -> list[str]:
    """Return a row as lines; cells that are too long fold."""
    folded = [
        wrap(cell, max(size, 1), break_on_hyphens=False) or [""]
        for cell, size in zip(row, widths, strict=True)
    ]
    lines, last = [], len(row) - 1
    for n in range(max(map(len, folded))):
        parts = []
        for place, (cell, size) in enumerate(zip(folded, widths, strict=True)):
            part = cell[n] if n < len(cell) else ""
            left = place == 0 or (words and place == last)
            parts.append(part.ljust(size) if left else part.rjust(size))
        lines.append((" " * GAP).join(parts).rstrip())
    return lines


def _stacked(heads: Sequence[str], row: Sequence[str], width: int) -> list[str]:
    """Return a row as its name and a line for each other cell that is not empty."""
    most = max(width, NARROWEST_NAME)
    lines = wrap(row[0], most)
    for head, cell in zip(heads[1:], row[1:], strict=True):
        if cell.strip():
            text = f"{head}: {cell.strip()}" if head else cell.strip()
            lines += wrap(text, most, initial_indent="  ", subsequent_indent="    ")
    return lines
