"""Seeds as a study file writes them."""

import re
from typing import Any

from curricle.checks import BEYOND_64_BITS
from curricle.learning.seeds import MOST_SEEDS
from curricle.study.config.tables import shown, wrong


def seeds_of(value: Any) -> tuple[int, ...]:
    """Return what a file says of seeds, such as 30, [0, 1, 7] or "0-9,20-29".

    Examples
    --------
    >>> seeds_of(2), seeds_of("0-1,7")
    ((0, 1), (0, 1, 7))
    """
    numbers: Any = _ranges(value) if isinstance(value, str) else value
    if type(numbers) is int:
        numbers = range(min(numbers, MOST_SEEDS + 1))
    listed = isinstance(numbers, list | tuple | range) and 0 < len(numbers) <= MOST_SEEDS
    whole = listed and all(type(n) is int and 0 <= n < BEYOND_64_BITS for n in numbers)
    if not whole or len(set(numbers)) < len(numbers):
        raise wrong(
            'must be a number of seeds, a list of different ones, or ranges such as "0-9,20-29", '
            f"{MOST_SEEDS:,} at most: got {shown(value)}"
        )
    return tuple(numbers)


def _ranges(text: str) -> list[int]:
    """Return the seeds in ranges such as "0-9,20-29"; none if malformed or far too many."""
    numbers = list[int]()
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d{1,18})\s*(?:-\s*(\d{1,18})\s*)?", part, re.ASCII)
        named = range(int(match[1]), int(match[2] or match[1]) + 1) if match else range(0)
        if not 0 < len(named) <= MOST_SEEDS:
            return []
        numbers += named
    return numbers
