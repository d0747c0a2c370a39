"""Threads over seeds; seeds of a live task run one after the other."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from curricle.checks import whole_number
from curricle.errors import SettingError
from curricle.tasks.live import is_live

Done = TypeVar("Done")


def threads_for(task: Any, workers: int | None, seeds: int) -> int:
    """Return the number of threads for the seeds of a task: `workers`, by default one a processor.

    A live task gets one thread, as Python runs its environment in one thread at a time.

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

    A single thread is the caller's, so that an interrupt from the keyboard reaches an environment.

    Examples
    --------
    >>> over_seeds(lambda k: 10 * k, seeds=3, threads=2)
    [0, 10, 20]
    """
    if threads == 1:
        return [work(k) for k in range(seeds)]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, range(seeds)))
