"""What a task's sources know, as its potential: read, aggregated, and calibrated if asked to."""

import warnings
from collections.abc import Mapping, Sequence

import numpy as np

from curricle.errors import CurriculumError
from curricle.learning.following import PairPotential
from curricle.learning.result import LearningResult
from curricle.tasks.task import Task
from curricle.transfer.aggregation import Aggregate
from curricle.transfer.calibration import Calibrate, Calibration, attempt
from curricle.transfer.edge import Transfer
from curricle.transfer.mapped import combined_potential


def source_potentials(
    task: Task,
    edges: Sequence[Transfer],
    results: Mapping[str, LearningResult],
    aggregate: Aggregate,
) -> list[PairPotential]:
    """Return the potential that each of K seeds' sources give a task; none without edges.

    Raises
    ------
    CurriculumError
        When a source's values were not kept, or not in a dense table.
    """
    if not edges:
        return []
    for edge in edges:
        if not isinstance(results[edge.source].values, np.ndarray):
            raise CurriculumError(
                f"a source's values must be kept, in dense tables: those of {edge.source!r}, which "
                f"{edge.target!r} reads, are not (storage)"
            )
    tables = zip(*(results[edge.source].values for edge in edges), strict=True)
    return [combined_potential(task, edges, values, aggregate) for values in tables]


def calibrated(
    name: str, potentials: Sequence[PairPotential], settings: Calibrate, seeds: Sequence[int]
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
