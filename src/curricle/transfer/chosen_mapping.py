"""The best mapping that is found between two tasks, or the reason why none is used."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

from curricle.errors import CurriculumError, MappingError
from curricle.progress import Progress, check_progress
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.task import Task, has_tables
from curricle.transfer.edges import Transfer
from curricle.transfer.found_mappings import (
    LEAST_REGAINED,
    MOST_UNEXPLAINED,
    FoundMapping,
    FoundMappings,
    clears_bar,
    find_mappings,
    replace_unmapped_value,
)
from curricle.transfer.observation_mapping import ObservationMapping
from curricle.transfer.unmapped_values import fitted_unmapped_value

REMEMBERED = 16
"""Searches whose result is kept while the program runs; one may take half a minute."""


def auto_mapping(
    target: Task,
    source: Task,
    *,
    unmapped_value: float | None = None,
    fit_unmapped: bool = True,
    scale: float = 1.0,
    shift: float = 0.0,
    progress: Progress = None,
) -> FoundMapping:
    """Return the best mapping of :func:`find_mappings`, if it fits well enough to be used unseen.

    Where it knows anything its greedy policy must regain at least 25 % of the way to the optimum,
    and its values may leave unexplained at most 75 % of what a constant does
    (:class:`MappingScores`). The scores are of what it maps alone.

    Parameters
    ----------
    target, source : Task
    unmapped_value : float, optional
        Of the mapping.
    fit_unmapped : bool
        Whether unmapped pairs are given the value that fits what is mapped
        (:func:`fitted_unmapped_value`), where that is below 0 and `unmapped_value` is not given.
        Not for one of several transfers into a task: an aggregate is to skip what it does not know.
    scale, shift : float
        Of the transfer, for that fit.
    progress : bool or callable, optional
        Of the search, as in :func:`find_mappings`. What was found for the same tasks before is
        taken from memory.

    Raises
    ------
    MappingError
        When no mapping that is found clears that bar.
    SettingError
        When `progress` is none of what it may be.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> auto_mapping(GridWorld("S..T"), GridWorld("T..S")).how
    'exact homomorphism: 100% of pairs have a source pair of the same Q*'
    """
    check_progress(progress)
    best = best_of(_found(target, source, unmapped_value, progress))
    if not fit_unmapped or unmapped_value is not None:
        return best
    value = best.unmapped_value
    if (scale, shift) != (1.0, 0.0):
        value = fitted_unmapped_value(best.mapping, scale=scale, shift=shift)
    if value is None:
        return best
    mapping = replace_unmapped_value(best.mapping, value)
    return replace(
        best,
        mapping=mapping,
        how=f"{best.how}, {value:.3g} where unmapped",
        unmapped_value=None,
    )


def best_of(found: FoundMappings) -> FoundMapping:
    """Return the first candidate if it clears the bar, or raise MappingError."""
    bar = (
        f"a mapping is used unseen if it regains at least {LEAST_REGAINED:.0%} where it is known "
        f"and leaves at most {MOST_UNEXPLAINED:.0%} unexplained"
    )
    if not len(found):
        raise MappingError(f"{bar}: none is found between these tasks")
    best: FoundMapping = found[0]
    if not clears_bar(best.scores):
        raise MappingError(
            f"{bar}: the best that is found, {best.how}, regains "
            f"{best.scores.regained_where_known:.0%} and leaves {best.scores.unexplained:.0%} "
            "unexplained"
        )
    return best


def with_mapping(
    transfer: Transfer, target: Any, source: Any, *, fit_unmapped: bool = True
) -> Transfer:
    """Return a transfer as it is, or with the mapping that is found; what is found is printed.

    Between two tasks seen through observations it is the identity, if these are of one space.

    Raises
    ------
    CurriculumError
        When a mapping has to be found, and a task has no tables or no mapping fits well enough.
    """
    if transfer.mapping is not None:
        return transfer
    edge = f"{transfer.source} -> {transfer.target}"
    if is_observation_task(target) and is_observation_task(source):
        if target.observations != source.observations:
            raise CurriculumError(
                f"a transfer between different observations needs a mapping: {edge} has none, and "
                f"the target has {target.observations}, the source {source.observations}"
            )
        return replace(transfer, mapping=ObservationMapping(target, source))
    scale, shift = transfer.scale, transfer.shift
    try:
        mapping = announced(
            edge, target, source, fit_unmapped=fit_unmapped, scale=scale, shift=shift
        ).mapping
    except MappingError as error:
        raise CurriculumError(f"no mapping for {edge}: {error}") from error
    return replace(transfer, mapping=mapping)


def announced(
    edge: str,
    target: Task,
    source: Task,
    unmapped_value: float | None = None,
    *,
    say: Callable[[str], Any] = print,
    **settings: Any,
) -> FoundMapping:
    """Return the mapping that is found for an edge, and say what it is, and the runner-up.

    `settings` are those of :func:`auto_mapping`; `say` takes each line.

    Raises
    ------
    MappingError
        As :func:`auto_mapping`, or when a task has no tables.
    """
    for role, task in (("target", target), ("source", source)):
        if not has_tables(task):
            raise MappingError(
                f"a mapping is found between tasks with tables: the {role} has none, "
                "find_mappings(..., samples=20_000) estimates them from steps"
            )
    best = auto_mapping(target, source, unmapped_value=unmapped_value, **settings)
    found = _found(target, source, unmapped_value)
    say(f"mapping found for {edge}: {best}")
    say(f"  runner-up: {found[1] if len(found) > 1 else 'none'}")
    return best


class _Search:
    """A search for the mappings between two tasks, which is made when its result is asked for."""

    def __init__(self, target: Any, source: Any, unmapped_value: float | None):
        self.tasks, self.unmapped_value = (target, source), unmapped_value
        self._found: FoundMappings | None = None

    def found(self, progress: Progress) -> FoundMappings:
        """Return what is found, from memory where it was asked for before."""
        if self._found is None:
            how: Any = {"unmapped_value": self.unmapped_value, "progress": progress}
            self._found = find_mappings(*self.tasks, **how)
        return self._found


def _found(
    target: Any, source: Any, unmapped_value: float | None, progress: Progress = None
) -> FoundMappings:
    """Return what is found, from memory where the same tasks were asked for."""
    try:
        hash((target, source))
    except TypeError:  # of a user's own task
        return _Search(target, source, unmapped_value).found(progress)
    return _remembered(target, source, unmapped_value).found(progress)


_remembered = lru_cache(maxsize=REMEMBERED)(_Search)
