"""What forecasts for one target have in common: the solved target, and potentials judged before.

Arms of a study often read the same sources in the same ways. Their forecasts then judge the same
potentials, each of which is judged once.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from hashlib import blake2b
from typing import Any, NamedTuple

import numpy as np

from curricle.comparison.learnt_alone import LearntAlone
from curricle.learning.potential import MappedPotential, StateActionPotential
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.planning.target import Target
from curricle.transfer.calibration import AnyPotential, Calibration
from curricle.transfer.observation_rollouts import ObservationTarget, target_of
from curricle.transfer.quality import PotentialQuality


class Judgement(NamedTuple):
    """How good the potential of each of K seeds is, and the scale that a calibration finds."""

    seeds: tuple[PotentialQuality, ...]
    calibrations: tuple[Calibration, ...]


@dataclass(frozen=True)
class JudgedPotentials:
    """Targets, judgements of their potentials and what trials learn alone, computed once.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> judged, maze = JudgedPotentials(), GridWorld("S.T")
    >>> judged.target(maze, GreedyEvaluation()) is judged.target(maze, GreedyEvaluation())
    True
    """

    alone: LearntAlone = field(default_factory=LearntAlone)
    _targets: list[tuple[Any, Any, Target | ObservationTarget]] = field(default_factory=list)
    _found: dict[Any, Judgement] = field(default_factory=dict)

    def target(
        self, task: Any, evaluation: GreedyEvaluation, episodes: int | None = None
    ) -> Target | ObservationTarget:
        """Return a task as a target, solved once."""
        how = evaluation, episodes
        for known, settings, target in self._targets:
            if known is task and settings == how:
                return target
        target = target_of(task, evaluation, episodes=episodes)
        self._targets.append((task, how, target))
        return target

    def judgement(
        self,
        target: Target | ObservationTarget,
        potentials: tuple[AnyPotential, ...],
        judge: Callable[[], Judgement],
    ) -> Judgement:
        """Return the judgement of K potentials; `judge` makes it where it is the first of them."""
        tables = MappedPotential | StateActionPotential
        if not all(isinstance(one, tables) for one in potentials):
            return judge()
        key = id(target), *map(_digest, potentials)
        if key not in self._found:
            self._found[key] = judge()
        return self._found[key]


def _digest(potential: MappedPotential | StateActionPotential) -> bytes:
    """Return a digest of the numbers that a potential is made of."""
    parts: Iterable[Any] = (
        potential.lookup if isinstance(potential, MappedPotential) else (potential.values,)
    )
    found = blake2b(type(potential).__name__.encode())
    for one in parts:
        array = np.ascontiguousarray(one)
        found.update(f"{array.dtype} {array.shape}".encode())
        found.update(array.data)
    return found.digest()
