"""Pairs that a mapping leaves unmapped: skipped by aggregates, or with a value stated."""

import numpy as np
import pytest

import curricle as cr
from curricle.errors import CurriculumError, MappingError
from curricle.interop.gymnasium import observation_task
from curricle.transfer import FunctionValues, ObservationMapping, ObservationPotential
from tests.studies import CORNER, only

LINE = cr.GridWorld("S...T")
END = LINE.crop(rows=(0, 1), columns=(2, 5))
VALUES = {"end": np.full((1, 3, 4), -4.0), "line": np.full((1, 5, 4), -2.0)}


def curriculum(unmapped_value=None, **settings):
    """Return two sources of `far`: one knows its end, the other all of it."""
    mapping = cr.same_position(LINE, END, unmapped_value=unmapped_value)
    return cr.Curriculum(
        {"end": END, "line": LINE, "far": LINE},
        [
            cr.Transfer("end", "far", mapping),
            cr.Transfer("line", "far", cr.transfer.identity(LINE)),
        ],
        **settings,
    )


def potential(plan, sources=("end", "line")):
    learnt = {
        name: cr.curriculum.SourceValues(plan.tasks[name], (0,), VALUES[name], np.array([0]))
        for name in sources
    }
    edges = [edge for edge in plan.in_edges("far") if edge.source in sources]
    (phi,) = plan.potentials("far", learnt, transfers=edges)
    return phi.values[:, 0].tolist()


@pytest.mark.parametrize(
    ("aggregate", "skipped", "as_published"),
    [
        (cr.mean, [-2, -2, -3, -3, 0], [-1, -1, -3, -3, 0]),
        (cr.minimum, [-2, -2, -4, -4, 0], [-2, -2, -4, -4, 0]),
        (cr.maximum, [-2, -2, -2, -2, 0], [0, 0, -2, -2, 0]),
        (cr.total, [-2, -2, -6, -6, 0], [-2, -2, -6, -6, 0]),
    ],
)
def test_an_unmapped_pair_is_skipped_or_a_vote_for_the_value_stated(
    aggregate, skipped, as_published
):
    assert potential(curriculum(aggregate=aggregate)) == skipped
    assert potential(curriculum(0.0, aggregate=aggregate)) == as_published


def test_one_value_stands_where_no_source_knows_anything():
    assert potential(curriculum(), ["end"]) == [0, 0, -4, -4, 0]
    for value in (-9.0, {"far": -9}):
        plan = curriculum(unknown_value=value)
        assert potential(plan, ["end"]) == [-9, -9, -4, -4, 0]  # and 0 where the episode has ended
        assert potential(plan) == [-2, -2, -3, -3, 0]
    with pytest.raises(CurriculumError, match="unknown_value of far must be finite: got nan"):
        curriculum(unknown_value={"far": np.nan})
    with pytest.raises(MappingError, match="unmapped_value must be finite: got inf"):
        curriculum(np.inf)


def test_a_users_aggregate_skips_or_has_the_values_stated():
    def median(potentials):
        return np.median(potentials, axis=0)

    with pytest.raises(CurriculumError, match=r"must skip NaN.*median returned nan at state 0"):
        potential(curriculum(aggregate=median))
    assert potential(curriculum(0.0, aggregate=median)) == [-1, -1, -3, -3, 0]


def test_a_study_file_states_either(read):
    plan = only(read(CORNER))
    assert plan.transfers[0].mapping.unmapped_value is None
    assert plan.setting("unknown_value", "maze") == 0
    as_published = only(read(CORNER + "unmapped_value = 0\n"))
    assert as_published.transfers[0].mapping.unmapped_value == 0
    plan = only(read(CORNER, set=["tasks.maze.unknown_value=-9"]))
    assert plan.setting("unknown_value", "maze") == -9


def test_observations_without_counterpart_are_skipped_too():
    car = observation_task("MountainCar-v0")
    speed = FunctionValues(state_values=lambda cars: cars[:, 1])
    everywhere = ObservationMapping(car, car)
    to_the_left = ObservationMapping(car, car, status=lambda cars: cars[:, 0] < 0)
    to_the_right = ObservationMapping(car, car, status=lambda cars: cars[:, 0] > 0.25)

    def phi(*mappings, **settings):
        edges = [
            cr.Transfer("source", "car", mapping, scale=10.0**i)
            for i, mapping in enumerate(mappings)
        ]
        potential = ObservationPotential(car, edges, [speed] * len(edges), **settings)
        return potential.v(np.array([[-1.0, 1.0], [0.125, 1.0], [0.5, 1.0]])).tolist()

    assert phi(everywhere, to_the_left) == [5.5, 1, 1]
    assert phi(to_the_left, to_the_right, function=cr.maximum) == [1, 0, 10]
    assert phi(to_the_left, unknown_value=-3.0) == [1, -3, -3]
    assert phi(to_the_left, unknown_value=-3.0, scale=2.0, shift=1.0) == [3, -5, -5]
