"""Seeds side by side on threads, or one after another where a task is played live."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from curricle.checks import whole_number
from curricle.errors import SettingError
from curricle.tasks.live import is_live

Done = TypeVar("Done")


def threads_for(task: Any, workers: int | None, seeds: int) -> int:
    """Return the threads on which seeds of a task run: `workers`, by default one a processor.

    A live task gets one. Python runs its environment, and lets one thread at a time do so.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> threads_for(GridWorld("S.T"), workers=4, seeds=3)
    3
    """
    if workers is not None:
        workers = whole_number("workers", workers, 1, SettingError)
    return 1 if is_live(task) else min(workers or os.cpu_count() or 1, seeds)


def over_seeds(work: Callable[[int], Done], seeds: int, threads: int) -> list[Done]:
    """Return work(0) .. work(seeds - 1).

    One thread is the caller's own, so that an interrupt from the keyboard reaches an environment.

    Examples
    --------
    >>> over_seeds(lambda k: 10 * k, seeds=3, threads=2)
    [0, 10, 20]
    """
    if threads == 1:
        return [work(k) for k in range(seeds)]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, range(seeds)))
