"""Potentials of a task: its sources' values, mapped, aggregated, and calibrated if asked for."""

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from curricle.errors import CurriculumError
from curricle.learning.result import LearningResult
from curricle.tasks.observation_task import is_observation_task
from curricle.transfer.aggregation import Aggregate
from curricle.transfer.calibration import AnyPotential, Calibration, fit_calibration
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
    """Return the potential of a task for each of K seeds; none without edges.

    Raises
    ------
    CurriculumError
        When a source's values were not kept, or not in a form that the task can read.
    """
    if not edges:
        return []
    observed = is_observation_task(task)
    each = [_values(edge, results[edge.source], observed=observed) for edge in edges]
    make = ObservationPotential if observed else combined_potential
    return [make(task, edges, values, aggregate) for values in zip(*each, strict=True)]


def _values(edge: Transfer, result: LearningResult, *, observed: bool) -> list[Any]:
    """Return the values of a source for each seed, in the form that its target reads."""
    values: Any = result.values
    if isinstance(values, np.ndarray):
        return [TableValues(table) for table in values] if observed else [*values]
    if observed and values is not None and all(isinstance(one, ValueSource) for one in values):
        return [*values]
    raise CurriculumError(
        f"a source's values must be kept, in dense tables{' or networks' * observed}: those of "
        f"{edge.source!r}, which {edge.target!r} reads, are not (storage)"
    )


def calibrated(
    name: str, potentials: Sequence[AnyPotential], settings: Calibrate, seeds: Sequence[int]
) -> list[Calibration]:
    """Return the calibration of each seed's potential of a task."""
    return [
        fit_calibration(potential, settings, seed=seed, stream=f"{name}/calibration")
        for potential, seed in zip(potentials, seeds, strict=True)
    ]


def warn_of_refusals(name: str, calibrations: Sequence[Calibration]) -> None:
    """Warn where seeds could not be calibrated and take their potential as it is."""
    refused = [one.refusal for one in calibrations if one.refusal]
    if refused:
        warnings.warn(
            f"{len(refused)} of {len(calibrations)} seeds of {name!r} take their potential as it "
            f"is: {refused[0]}",
            stacklevel=3,
        )
