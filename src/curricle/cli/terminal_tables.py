"""Tables and texts on the terminal, as wide as it is; where there is none, nothing is folded."""

import sys
from collections.abc import Iterable, Sequence
from shutil import get_terminal_size
from textwrap import fill

from curricle.text_tables import UNBOUNDED, text_table

LINE = 80
"""Characters of a line of text where there is no terminal, and at most where there is one."""


def table_width() -> int:
    """Return the columns that a table may have."""
    return get_terminal_size().columns if sys.stdout.isatty() else UNBOUNDED


def line_width() -> int:
    """Return the characters that a line of text may have."""
    return min(LINE, table_width())


def print_table(
    heads: Sequence[str], rows: Iterable[Sequence[str]], *, words: bool = False
) -> None:
    """Print a table of names and numbers to standard output.

    Examples
    --------
    >>> print_table(("", "seeds", "steps"), [("scratch: maze", "20", "1,000")])
                   seeds  steps
    scratch: maze     20  1,000
    """
    for line in text_table(heads, rows, table_width(), words=words):
        print(line)


def print_text(text: str, indent: int = 0) -> None:
    """Print a paragraph, its lines after the first indented by two more."""
    print(wrapped(text, indent))


def wrapped(text: str, indent: int = 0) -> str:
    """Return a paragraph as lines that fit."""
    first, later = " " * indent, " " * (indent + 2)
    return fill(
        text, line_width(), initial_indent=first, subsequent_indent=later, break_on_hyphens=False
    )
