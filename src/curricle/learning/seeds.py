"""The seeds of a training: their numbers, the settings of each, threads over them."""

import os
from collections.abc import Callable, Iterable, Sequence
from itertools import repeat
from threading import current_thread, main_thread
from typing import Any, NamedTuple, TypeGuard, TypeVar

import numpy as np
import numpy.typing as npt

from curricle.checks import whole_number
from curricle.errors import SettingError
from curricle.learning.shaping import Shaping
from curricle.progress import interruptible
from curricle.tasks.live import is_live

Result = TypeVar("Result")
MOST_SEEDS = 100_000  # seeds of a study or a training


def seed_tuple(seeds: Any) -> tuple[int, ...]:
    """Return the seeds as a tuple, 0 .. K-1 for a number K, or raise SettingError."""
    if isinstance(seeds, str) or not isinstance(seeds, Sequence | np.ndarray | range):
        seeds = range(whole_number("seeds", seeds, 1, SettingError))
    if len(seeds) > MOST_SEEDS:
        raise SettingError(f"seeds must be at most {MOST_SEEDS:,}: got {len(seeds):,}")
    numbers = tuple(whole_number("each of seeds", s, 0, SettingError) for s in seeds)
    if not numbers or len(set(numbers)) != len(numbers):
        raise SettingError(f"seeds must be different, at least one: got {seeds}")
    return numbers


class SeedSettings(NamedTuple):
    """The settings of one seed's training."""

    seed: int
    shaping: Shaping | None
    charged: int  # steps of the budget that were used elsewhere


def seed_settings(
    seeds: object,
    learner: object,
    most_steps: int,
    fitted: Callable[[Shaping], Shaping],
    *,
    shaping: Shaping | Sequence[Shaping] | None,
    charged: Sequence[int] | npt.NDArray[np.integer[Any]] | None,
) -> list[SeedSettings]:
    """Return the settings of each seed's training, or raise SettingError."""
    numbers = seed_tuple(seeds)

    def checked(shaping: object) -> Shaping | None:
        if shaping is None:
            return None
        if not isinstance(shaping, Shaping):
            raise SettingError(
                "shaping must be a Shaping, such as QInitialisation(potential): got "
                f"{type(shaping).__name__}"
            )
        shaping.check(learner)
        if shaping.portfolio is not None and shaping.potential is None:
            raise SettingError("a portfolio needs a potential: got a shaping without one")
        shaping = fitted(shaping)
        return None if shaping.potential is None else shaping  # nothing added is no shaping

    # A shaping of all seeds is fitted once, as each fitting may make an array of S x A.
    shapings: Iterable[Shaping | None]
    if _is_list(shaping):
        shapings = map(checked, _of_seeds("shaping", shaping, len(numbers), None))
    else:
        shapings = repeat(checked(shaping), len(numbers))
    settings = list[SeedSettings]()
    costs = _of_seeds("charge", charged, len(numbers), 0)
    for seed, fit, cost in zip(numbers, shapings, costs, strict=True):
        cost = whole_number("each of charged", cost, 0, SettingError)
        if cost >= most_steps:
            raise SettingError(
                f"a budget must exceed the steps charged to it: got {most_steps:,} and {cost:,} "
                "steps"
            )
        settings.append(SeedSettings(seed, fit, cost))
    return settings


def _is_list(value: object) -> TypeGuard[Sequence[Any]]:
    return isinstance(value, Sequence | np.ndarray) and not isinstance(value, str)


def _of_seeds(name: str, values: Any, n_seeds: int, default: Any) -> list[Any]:
    if values is not None and not _is_list(values):
        raise SettingError(f"{name} must be a list with an entry per seed: got {values!r}")
    of_seeds = [default] * n_seeds if values is None else list(values)
    if len(of_seeds) != n_seeds:
        raise SettingError(f"{name} must have an entry per seed, {n_seeds}: got {len(of_seeds)}")
    return of_seeds


def threads_for(task: object, workers: int | None, seeds: int) -> int:
    """Return the threads for the seeds of a task: `workers`, by default one a processor."""
    if workers is not None:
        workers = whole_number("workers", workers, 1, SettingError)
    # 0, the caller's thread, for a live task: an interrupt must reach its environment, which Python
    # runs in one thread at a time.
    return 0 if is_live(task) else min(workers or os.cpu_count() or 1, seeds)


def over_seeds(
    work: Callable[[int], Result],
    seeds: int,
    threads: int,
    ended: Callable[[int], Any] = lambda k: None,
) -> list[Result]:
    """Return work(0) .. work(seeds - 1); each number, in order, is handed to `ended` when done."""
    # The main thread does no work itself but for 0 threads, so that it answers an interrupt.
    results = list[Result]()
    if not threads or (threads == 1 and current_thread() is not main_thread()):
        for k in range(seeds):  # no iterator does the work: an environment may raise StopIteration
            results.append(work(k))
            ended(k)
        return results
    with interruptible(threads) as pool:
        for k, result in enumerate(pool.map(work, range(seeds))):
            results.append(result)
            ended(k)
    return results
