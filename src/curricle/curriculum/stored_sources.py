"""The values of sources trained before: as plain data, and as a curriculum reads them."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from curricle.array_types import IntArray
from curricle.curriculum.node import Node
from curricle.curriculum.sources import Progress, SourceValues


class StoredValues(NamedTuple):
    """What K seeds learnt in a task, as plain data."""

    values: Any
    """(K, S, A) float array, or K dicts of a network's parameters; None where they are not read."""
    steps_used: IntArray
    """(K,) including those of retraining its own sources."""
    calibrations: Sequence[tuple[float, float]] = ()
    """Scale and shift of each seed's potential; empty unless its transfers are calibrated."""
    progress: Progress | None = None


def sources_read(curriculum: Any, name: str) -> set[str]:
    """Return the tasks whose values are needed to train a task.

    They are its sources. A network that learnt on top of a potential needs that potential, so its
    own sources are read too.
    """
    read, waiting = set[str](), [name]
    while waiting:
        for edge in curriculum.in_edges(waiting.pop()):
            if edge.source not in read and curriculum.node(edge.source).deep:
                waiting.append(edge.source)
            read.add(edge.source)
    return read


def source_values(
    curriculum: Any, seeds: tuple[int, ...], sources: Mapping[str, StoredValues]
) -> dict[str, SourceValues]:
    """Return what sources learnt as :meth:`Curriculum.train` takes it; networks are rebuilt.

    `sources` has the values of all tasks that :func:`sources_read` names for a network. Rebuilding
    one needs Stable-Baselines3, or raises ImportError.
    """
    found: dict[str, SourceValues] = {}
    for name in curriculum.order:
        if name in sources:
            node, stored = curriculum.node(name), sources[name]
            values, steps_used, calibrations, progress = stored
            if node.deep and values is not None:
                potentials: list[Any] = curriculum.potentials(name, found)
                if calibrations:
                    pairs = zip(potentials, calibrations, strict=True)
                    potentials = [phi.rescaled(scale, shift) for phi, (scale, shift) in pairs]
                values = _networks(node, potentials or [None] * len(seeds), values)
            found[name] = SourceValues(node.task, seeds, values, steps_used, progress=progress)
    return found


def _networks(node: Node, potentials: Sequence[Any], each: Sequence[Any]) -> tuple[Any, ...]:
    """Return the values of each seed's network, from its parameters."""
    node.learner.algorithm_class()  # raises ImportError that names what to install
    from curricle.deep.models import network_values

    # A network that was distilled computes its values alone, whatever its task's own sources are.
    shapings = [
        None if node.takes_no_steps else node.shaping.with_potential(potential)
        for potential in potentials
    ]
    return tuple(
        network_values(node.task, node.learner, shaping, parameters)
        for shaping, parameters in zip(shapings, each, strict=True)
    )
