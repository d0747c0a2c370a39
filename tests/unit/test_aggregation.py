"""Aggregates of several potentials."""

import numpy as np
import pytest

from curricle import maximum, mean, minimum, total
from curricle.errors import CurriculumError
from curricle.transfer.aggregation import aggregate

PHI = np.array([[[1.0, 5.0]], [[3.0, -2.0]], [[2.0, 0.0]]])


@pytest.mark.parametrize(
    ("function", "expected"),
    [(maximum, [3, 5]), (mean, [2, 1]), (minimum, [1, -2]), (total, [6, 3])],
)
def test_aggregates_by_hand(function, expected):
    assert aggregate(function, PHI).tolist() == [expected]
    assert aggregate(function, PHI[:1]).tolist() == [[1, 5]]


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
