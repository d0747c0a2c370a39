"""The values that sources learnt, and the potentials that they give."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple, Self

import numpy as np

from curricle.arrays import IntArray
from curricle.curriculum.node import Node
from curricle.learning.result import LearningResult
from curricle.learning.stopping import limits
from curricle.text import brief_repr
from curricle.transfer.calibration import AnyPotential, Calibration, fit_calibration
from curricle.transfer.transfer import Calibrate


@dataclass(frozen=True, eq=False)
class SourceValues:
    """The values that K seeds learnt in a task: all that later tasks need of it.

    Attributes
    ----------
    task : Task or ObservationTask
    seeds : tuple of int
        K of them.
    values : (K, S, A) float array or K ValueSource
        None if they were not kept.
    steps_used : (K,) int64
        Steps of each seed in the task.
    own_rewards : bool
        Whether the values are in the task's own rewards (:class:`LearningResult`).

    Examples
    --------
    >>> from curricle import GridWorld, learn
    >>> SourceValues.of(learn(GridWorld("S.T"), budget=500, seeds=3)).first(2).seeds
    (0, 1)
    """

    task: Any
    seeds: tuple[int, ...]
    values: Any
    steps_used: IntArray
    own_rewards: bool = True

    __repr__ = brief_repr

    @classmethod
    def of(cls, result: "Learnt") -> Self:
        """Return the values of a result."""
        own_rewards = bool(np.all(result.own_rewards))
        return cls(result.task, result.seeds, result.values, result.steps_used, own_rewards)

    def first(self, n: int) -> "SourceValues":
        """Return the values of the first n seeds."""
        values = None if self.values is None else self.values[:n]
        return replace(self, seeds=self.seeds[:n], values=values, steps_used=self.steps_used[:n])


Learnt = LearningResult | SourceValues


def calibrated(
    node: Node,
    potentials: Sequence[AnyPotential],
    settings: Calibrate,
    seeds: Sequence[int],
    charged: IntArray | None = None,
) -> list[Calibration]:
    """Return the calibrations of a task's potentials within its budget, less (K,) charged steps."""
    steps, episodes = limits(node.budget)
    left = [steps] * len(seeds) if charged is None else (steps - charged).tolist()
    return [
        fit_calibration(
            potential, settings.within(most, episodes), seed=k, stream=f"{node.name}/calibration"
        )
        for potential, k, most in zip(potentials, seeds, left, strict=True)
    ]


class StoredValues(NamedTuple):
    """The values that K seeds learnt in a task, as plain data."""

    values: Any  # (K, S, A) float array, or K dicts of a network's parameters; None if not read
    steps_used: IntArray  # (K,) in the task
    scales: Sequence[float] = ()  # of each seed's potential, if it is calibrated


def sources_read(curriculum: Any, name: str) -> set[str]:
    """Return the tasks whose values are needed to train a task: its sources, and theirs if deep."""
    read, waiting = set[str](), [name]
    while waiting:
        for edge in curriculum.in_edges(waiting.pop()):
            # A network that learnt on top of a potential needs that potential.
            if edge.source not in read and curriculum.node(edge.source).deep:
                waiting.append(edge.source)
            read.add(edge.source)
    return read


def source_values(
    curriculum: Any, seeds: tuple[int, ...], sources: Mapping[str, StoredValues]
) -> dict[str, SourceValues]:
    """Return stored values as :meth:`Curriculum.train` takes them; networks are rebuilt."""
    learnt: dict[str, SourceValues] = {}
    for name in (name for name in curriculum.order if name in sources):
        node, (values, steps_used, scales) = curriculum.node(name), sources[name]
        if node.deep and values is not None:
            potentials: list[Any] = curriculum.potentials(name, learnt)
            if scales:
                pairs = zip(potentials, scales, strict=True)
                potentials = [phi.rescaled(scale) for phi, scale in pairs]
            node.learner.algorithm_class()  # raises an ImportError that names what to install
            from curricle.deep.models import network_values  # needs PyTorch

            # A distilled network computes its values alone, whatever its task's sources are.
            shapings = [
                None if node.takes_no_steps else node.shaping.with_potential(potential)
                for potential in potentials or [None] * len(seeds)
            ]
            values = tuple(map(partial(network_values, node.task, node.learner), shapings, values))
        learnt[name] = SourceValues(node.task, seeds, values, steps_used)
    return learnt
