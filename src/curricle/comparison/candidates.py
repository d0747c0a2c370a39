"""Candidates: the ways of using a curriculum's sources, each a curriculum of its own.

A forecast compares them: every aggregate of all transfers into the target, and each transfer alone.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.node import SETTINGS, calibrated
from curricle.curriculum.result import Learnt
from curricle.transfer.aggregate import BUILT_IN, Aggregate
from curricle.transfer.calibration import AnyPotential
from curricle.transfer.transfer import Transfer, numbered, transfer_names

AGGREGATES = tuple(known.function for known in BUILT_IN.values())


@dataclass(frozen=True, eq=False)
class Candidate:
    """One way of using the sources of a target."""

    name: str  # the aggregate's, or the transfer's as "source -> target [n]"
    # The target, its transfers as this candidate uses them, and what these build on; no more.
    curriculum: Curriculum
    aggregate: bool  # whether it is an aggregate of all transfers
    used: bool  # whether it is what the curriculum would do

    def potentials(
        self, sources: Mapping[str, Learnt], seeds: Sequence[int]
    ) -> Sequence[AnyPotential]:
        """Return the potential of each of K seeds, calibrated where the candidate calibrates."""
        target = self.curriculum.target
        found = self.curriculum.potentials(target, sources)
        settings = self.curriculum.calibration(target)
        if settings is None:
            return found
        fitted = calibrated(self.curriculum.node(target), found, settings, seeds)
        return [one.potential for one in fitted]


def candidates_of(
    curriculum: Curriculum, target: str, aggregates: Sequence[Aggregate] = ()
) -> list[Candidate]:
    """Return the candidates for a target: aggregates first, then each transfer alone.

    The aggregates are the library's four, the curriculum's own and the given ones, each once; those
    that are not the curriculum's own are not calibrated.
    """
    edges = curriculum.in_edges(target)
    own, settings = curriculum.setting("aggregate", target), curriculum.calibration(target)
    # The minimum, the mean and the maximum of a single potential are the same.
    several = AGGREGATES if len(edges) > 1 else ()
    functions = list[Aggregate]()
    for function in (*several, own, *aggregates):
        if not any(function is known for known in functions):
            functions.append(function)
    raw = [replace(edge, calibrate=False) for edge in edges]
    names = numbered([getattr(function, "__name__", str(function)) for function in functions])
    found = []
    for label, function in zip(names, functions, strict=True):
        plan = part_of(curriculum, target, raw).replace(target, aggregate=function)
        used = function is own and settings is None
        found.append(Candidate(label, plan, aggregate=True, used=used))
        if function is own and settings is not None:
            plan = part_of(curriculum, target, edges)
            found.append(Candidate(f"{label}, calibrated", plan, aggregate=True, used=True))
    for label, edge in zip(transfer_names(edges), raw, strict=True) if len(edges) > 1 else ():
        found.append(Candidate(label, part_of(curriculum, target, [edge]), False, False))
    return found


def part_of(
    curriculum: Curriculum,
    target: str,
    transfers: Sequence[Transfer],
    rename: Callable[[str], str] = str,
) -> Curriculum:
    """Return the part of a curriculum that a target is learnt by, its tasks renamed.

    `transfers` are those into the target, in place of the curriculum's own. Random streams are
    named after tasks, so that a renamed curriculum draws other numbers for the same seeds.
    """
    before = {edge.source for edge in transfers}
    kept = before.union(*(curriculum.ancestors(name) for name in before), {target})
    edges = [edge for edge in curriculum.transfers if edge.target in kept - {target}]
    settings = {which: _of_tasks(getattr(curriculum, which), kept, rename) for which in SETTINGS}
    # A budget that is not stated depends on how many sources there are in the whole.
    settings["budget"] = {rename(name): curriculum.setting("budget", name) for name in kept}
    return Curriculum(
        tasks={rename(name): task for name, task in curriculum.tasks.items() if name in kept},
        transfers=[
            replace(edge, source=rename(edge.source), target=rename(edge.target))
            for edge in (*edges, *transfers)
        ],
        **settings,
    )


def _of_tasks(setting: Any, kept: set[str], rename: Callable[[str], str]) -> Any:
    """Return a setting, one value or a dict from task to value, for the tasks that are kept."""
    if not isinstance(setting, Mapping):
        return setting
    return {rename(name): value for name, value in setting.items() if name in kept}
