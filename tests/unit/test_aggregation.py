"""Aggregates of several potentials."""

import numpy as np
import pytest

from curricle import maximum, mean, minimum, total
from curricle.errors import CurriculumError
from curricle.transfer.aggregate import aggregate

PHI = np.array([[[1.0, 5.0]], [[3.0, -2.0]], [[2.0, 0.0]]])


def test_any_function_of_the_right_shape_is_an_aggregate():
    assert aggregate(lambda phi: np.median(phi, axis=0), PHI).tolist() == [[2, 0]]
    assert aggregate(lambda phi: [[1, 2]], PHI).dtype == np.float64


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_an_aggregate_must_be_finite(value):
    def broken(phi):
        return np.where([[False, True]], value, phi[0])

    with pytest.raises(CurriculumError, match=r"finite.*broken returned .* at state 0, action 1"):
        aggregate(broken, PHI)


def test_an_aggregate_must_have_the_targets_shape():
    with pytest.raises(CurriculumError, match=r"shape \(1, 2\): <lambda> returned \(3, 1, 2\)"):
        aggregate(lambda phi: phi, PHI)


UNKNOWN = np.array([[[np.nan, 5.0, np.nan]], [[3.0, -2.0, np.nan]], [[2.0, np.nan, np.nan]]])


@pytest.mark.parametrize(
    ("function", "expected"),
    [
        (maximum, [3, 5, -9]),
        (mean, [2.5, 1.5, -9]),
        (minimum, [2, -2, -9]),
        (total, [5, 3, -9]),
        (lambda phi: np.nanmedian(phi, axis=0), [2.5, 1.5, -9]),
    ],
)
def test_a_source_that_knows_nothing_is_skipped(function, expected):
    assert aggregate(function, UNKNOWN, -9.0).tolist() == [expected]
    assert aggregate(function, UNKNOWN).tolist() == [[*expected[:2], 0]]


def test_no_aggregate_is_asked_of_pairs_that_no_source_knows():
    """nanargmax raises there, and nanmean warns."""
    chosen = []

    def most_optimistic(phi):
        chosen.append(np.nanargmax(phi, axis=0))
        return np.nanmax(phi, axis=0)

    assert aggregate(most_optimistic, UNKNOWN).tolist() == [[3, 5, 0]]
    assert aggregate(lambda phi: np.nanmean(phi, axis=0), UNKNOWN).tolist() == [[2.5, 1.5, 0]]
    assert chosen[0][0, :2].tolist() == [1, 0]
