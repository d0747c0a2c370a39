"""What a task's sources know, as its potential: read, aggregated, and calibrated if asked to."""

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from curricle.errors import CurriculumError
from curricle.learning.result import LearningResult
from curricle.tasks.observation_task import is_observation_task
from curricle.transfer.aggregation import Aggregate
from curricle.transfer.calibration import AnyPotential, Calibration, attempt
from curricle.transfer.edges import Calibrate, Transfer
from curricle.transfer.observation_potential import ObservationPotential
from curricle.transfer.potentials import combined_potential
from curricle.transfer.value_sources import TableValues, ValueSource


def source_potentials(
    task: Any,
    edges: Sequence[Transfer],
    results: Mapping[str, LearningResult],
    aggregate: Aggregate,
) -> list[AnyPotential]:
    """Return the potential that each of K seeds' sources give a task; none without edges.

    Raises
    ------
    CurriculumError
        When a source's values were not kept, or not so that the task can read them.
    """
    if not edges:
        return []
    each = [_values(edge, results[edge.source], deep=is_observation_task(task)) for edge in edges]
    if is_observation_task(task):
        return [
            ObservationPotential(task, edges, values, aggregate)
            for values in zip(*each, strict=True)
        ]
    return [
        combined_potential(task, edges, values, aggregate) for values in zip(*each, strict=True)
    ]


def _values(edge: Transfer, result: LearningResult, *, deep: bool) -> list[Any]:
    """Return what each seed of a source valued, as its target reads it."""
    values: Any = result.values
    if isinstance(values, np.ndarray):
        return [TableValues(table) for table in values] if deep else [*values]
    if deep and values is not None and all(isinstance(one, ValueSource) for one in values):
        return [*values]
    raise CurriculumError(
        f"a source's values must be kept, in dense tables{' or networks' * deep}: those of "
        f"{edge.source!r}, which {edge.target!r} reads, are not (storage)"
    )


def calibrated(
    name: str, potentials: Sequence[AnyPotential], settings: Calibrate, seeds: Sequence[int]
) -> list[Calibration]:
    """Return the calibration of each seed's potential of a task."""
    return [
        attempt(potential, settings, seed=seed, stream=f"{name}/calibration")
        for potential, seed in zip(potentials, seeds, strict=True)
    ]


def warn_of_refusals(name: str, found: Sequence[Calibration]) -> None:
    """Warn where seeds could not be calibrated and take their potential as it is."""
    refused = [one.refusal for one in found if one.refusal]
    if refused:
        warnings.warn(
            f"{len(refused)} of {len(found)} seeds of {name!r} take their potential as it is: "
            f"{refused[0]}",
            stacklevel=3,
        )
