"""Graphs of sources by transfer potential (Svetlik et al. 2017)."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from curricle.design.assembly import TARGET
from curricle.design.between_sources import mappings_between
from curricle.design.designers.source_settings import Edge
from curricle.design.proposals import SourceCandidate
from curricle.errors import CurricleError, CurriculumError
from curricle.transfer.mapping import StateActionMapping

Descriptor = frozenset[Any]
"""What a task has, so that one group's tasks are simpler than another's if theirs is a subset."""
TransferPotential = Callable[
    [SourceCandidate, SourceCandidate | None, Sequence[SourceCandidate]], float
]
"""Of a source for another one (or for the target: None), given those that lead there already."""


def source_graph(
    candidates: Sequence[SourceCandidate],
    potential: TransferPotential,
    descriptor: Callable[[SourceCandidate], Descriptor],
    threshold: float,
) -> tuple[list[SourceCandidate], list[Edge]]:
    """Return the sources and edges of a curriculum graph.

    Candidates whose transfer potential for the target is above the threshold are grouped by their
    descriptors, and sorted by it within a group. Each is led to by the best one after it in its
    group, and by the best one of each group whose descriptor is a proper subset, where their
    potential is above the threshold. What leads to no other source leads to the target.
    """
    kept, values = list[SourceCandidate](), dict[str, float]()
    for one in candidates:
        value = potential(one, None, kept)
        if value > threshold:
            kept.append(one)
            values[one.name] = value
    groups: dict[Descriptor, list[SourceCandidate]] = {}
    for one in sorted(kept, key=lambda one: -values[one.name]):  # stable
        groups.setdefault(descriptor(one), []).append(one)
    leading: dict[str, list[SourceCandidate]] = {one.name: [] for one in kept}

    def link(after: SourceCandidate, among: Sequence[SourceCandidate]) -> None:
        found = [(potential(one, after, leading[after.name]), one) for one in among]
        best = max(found, key=lambda each: each[0], default=None)
        if best is not None and best[0] > threshold:
            leading[after.name].append(best[1])

    for group in groups.values():
        for place, one in enumerate(group):
            link(one, group[place + 1 :])
    for has, group in groups.items():
        for simpler, others in groups.items():
            if simpler < has:
                for one in group:
                    link(one, others)
    edges = [(one.name, after) for after, those in leading.items() for one in those]
    leads = {before for before, _ in edges}
    return kept, [*edges, *((one.name, TARGET) for one in kept if one.name not in leads)]


def applicable_states(target: Any, before: SourceCandidate, after: SourceCandidate | None) -> int:
    """Return how many states of a task read a source's values: some pair of theirs is mapped.

    Those of another source, or of the target itself; 0 where it cannot read the source.
    """
    try:
        mappings = before.mappings if after is None else mappings_between(target, after, before)
    except CurricleError:
        return 0
    if not all(isinstance(one, StateActionMapping) for one in mappings):
        raise CurriculumError(
            f"transfer potentials need tables: {before.name!r} is read through observations"
        )
    read = np.any([(one.index >= 0).any(axis=1) for one in mappings], axis=0)
    return int(read.sum())
