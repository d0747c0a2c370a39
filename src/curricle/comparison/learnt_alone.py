"""Tasks that arms learn without sources, each once.

What is learnt without sources depends on the task, its name, its settings and the seeds, and not on
the arm: arms share their sources, and comparisons at one total share learning from scratch.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.node import Node
from curricle.learning.result import LearningResult

LARGEST_KEPT = 50_000_000
"""Bytes of tables up to which a task's values are kept for another arm."""
_SETTINGS = ("name", "learner", "budget", "shaping", "eval_freq", "evaluation", "storage")


@dataclass(frozen=True)
class LearntAlone:
    """What was learnt without sources so far.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> plan = Curriculum(tasks={"maze": GridWorld("S.T")}, budget=100)
    >>> known = LearntAlone()
    >>> first, second = (
    ...     known.curves(plan.node("maze"), (0, 1), lambda node: node.train((0, 1)))
    ...     for _ in range(2))
    >>> first is second, first.values
    (True, None)
    """

    _found: list[tuple[Node, tuple[int, ...], LearningResult]] = field(default_factory=list)

    def curves(
        self, node: Node, seeds: Sequence[int], train: Callable[[Node], LearningResult]
    ) -> LearningResult:
        """Return a task's result without its values; `train` makes it where it is the first."""
        known = self._known(node, seeds)
        if known is None:
            known = replace(train(node), values=None, visits=None, snapshots=None)
            self._found.append((node, tuple(seeds), known))
        return known

    def sources(self, curriculum: Curriculum, seeds: Sequence[int]) -> dict[str, LearningResult]:
        """Return the results of a curriculum's sources that are known, with their values."""
        known = {one.name: self._known(one, seeds) for one in _first_sources(curriculum)}
        return {name: one for name, one in known.items() if one and one.values is not None}

    def add_sources(
        self, curriculum: Curriculum, seeds: Sequence[int], results: Mapping[str, LearningResult]
    ) -> None:
        """Keep the results of a curriculum's sources for other arms, unless they are large."""
        for node in _first_sources(curriculum):
            values = results[node.name].values
            small = isinstance(values, np.ndarray) and values.nbytes <= LARGEST_KEPT
            if small and self._known(node, seeds) is None:
                self._found.append((node, tuple(seeds), results[node.name]))

    def _known(self, node: Node, seeds: Sequence[int]) -> LearningResult | None:
        for known, numbers, result in self._found:
            if known.task is node.task and numbers == tuple(seeds) and _alike(known, node):
                return result
        return None


def _first_sources(curriculum: Curriculum) -> list[Node]:
    """Return the target's sources that have no sources of their own."""
    before = curriculum.ancestors(curriculum.target)
    return [curriculum.node(name) for name in before if not curriculum.in_edges(name)]


def _alike(one: Node, other: Node) -> bool:
    return all(getattr(one, which) == getattr(other, which) for which in _SETTINGS)
