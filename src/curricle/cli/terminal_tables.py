"""Tables on the terminal: names fold at its width, numbers are never cut."""

import sys
from functools import partial

from rich.console import Console
from rich.table import Table

PIPED_WIDTH = 10_000
"""Columns of an output that is no terminal: nothing is folded there."""


def table(*columns: str) -> Table:
    """Return a table whose first column is a name and whose others are numbers.

    Examples
    --------
    >>> rows = table("", "seeds", "steps")
    >>> rows.add_row("scratch: maze", "20", "1,000")
    >>> print_table(rows)
                     seeds   steps
    scratch: maze       20   1,000
    """
    made = Table(box=None, pad_edge=False, padding=(0, 3, 0, 0), header_style="bold")
    name, *numbers = columns
    made.add_column(name, overflow="fold")
    for one in numbers:
        made.add_column(one, justify="right", no_wrap=True)
    return made


def print_table(rows: Table) -> None:
    """Print a table to standard output, without colour codes where that is no terminal."""
    plain = partial(Console, file=sys.stdout, highlight=False, markup=False, emoji=False)
    console = plain()
    if not console.is_terminal:
        console = plain(width=PIPED_WIDTH, no_color=True)
    with console.capture() as captured:
        console.print(rows)
    for line in captured.get().splitlines():
        print(line.rstrip())
