"""What tasks that were trained before hand on, as plain data, and results of it."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.node import Node
from curricle.learning.result import LearningResult, without_curves


class Knowledge(NamedTuple):
    """What is known of a task that K seeds have learnt, as plain data."""

    values: Any
    """(K, S, A) float array, or K dicts of a network's parameters; None where nobody reads them."""
    steps_used: npt.NDArray[np.int64]
    """(K,) those of going back to its own sources included."""
    calibrations: Sequence[tuple[float, float]] = ()
    """Scale and shift of each seed's potential; none unless its transfers are calibrated."""


def read_by(curriculum: Curriculum, name: str) -> set[str]:
    """Return the tasks whose values a task's training reads.

    A network that learnt on a potential says nothing without it, so its own sources are read too.

    Examples
    --------
    >>> from curricle import GridWorld, Transfer
    >>> from curricle.transfer import identity
    >>> maze = GridWorld("S.T")
    >>> chain = Curriculum({"a": maze, "b": maze, "c": maze},
    ...                    [Transfer("a", "b", identity(maze)), Transfer("b", "c", identity(maze))])
    >>> read_by(chain, "c")
    {'b'}
    """
    read, waiting = set[str](), [name]
    while waiting:
        for edge in curriculum.in_edges(waiting.pop()):
            if edge.source not in read and curriculum.node(edge.source).deep:
                waiting.append(edge.source)
            read.add(edge.source)
    return read


def recalled(
    curriculum: Curriculum, seeds: tuple[int, ...], known: Mapping[str, Knowledge]
) -> dict[str, LearningResult]:
    """Return the results of which that is known; networks are made anew and value the same.

    Parameters
    ----------
    curriculum : Curriculum
    seeds : tuple of K int
    known : dict of str to Knowledge
        With the values of all tasks that :func:`read_by` names for a network.

    Raises
    ------
    ImportError
        When there is a network, and Stable-Baselines3 is not installed.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> known = {"maze": Knowledge(np.zeros((1, 3, 4)), np.array([100]))}
    >>> recalled(Curriculum({"maze": GridWorld("S.T")}), (7,), known)["maze"].seeds
    (7,)
    """
    found: dict[str, LearningResult] = {}
    for name in curriculum.order:
        if name in known:
            node, (values, steps_used, calibrations) = curriculum.node(name), known[name]
            if node.deep and values is not None:
                potentials: list[Any] = curriculum.potentials(name, found)
                if calibrations:
                    pairs = zip(potentials, calibrations, strict=True)
                    potentials = [phi.rescaled(scale, shift) for phi, (scale, shift) in pairs]
                values = _networks(node, potentials or [None] * len(seeds), values)
            found[name] = without_curves(node.task, node.learner, seeds, values, steps_used)
    return found


def _networks(node: Node, potentials: Sequence[Any], each: Sequence[Any]) -> tuple[Any, ...]:
    """Return what each seed's network values."""
    node.learner.algorithm_class()  # says how to install what is missing
    from curricle.deep.models import network_values

    return tuple(
        network_values(node.task, node.learner, node.shaping.with_potential(potential), parameters)
        for potential, parameters in zip(potentials, each, strict=True)
    )
