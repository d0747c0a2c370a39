"""A source that is the first leg of its target: what is found, and by how much it is shifted."""

from itertools import product

import numpy as np
import pytest

import curricle as cr
from curricle.errors import MappingError
from curricle.transfer import TaskPair, by_legs, compose, find_mappings, identity, score_mapping
from curricle.transfer.descriptions import same_transfer
from curricle.transfer.proposal import SearchedMapping

CELLS, PAID, STOP = 5, 10.0, 2
GAMMA = 0.9
ACTIONS = cr.Space([cr.Component("move", 3)])


def moved(cell, action):
    return min(max(cell + (-1, 1)[action], 0), CELLS - 1)


def errand():
    """Go to one end of a line and stop there."""
    points = [*product(range(CELLS), range(2)), (CELLS, 0)]

    def outcome(cell, place, action):
        if action != STOP:
            return [(1.0, points.index((moved(cell, action), place)), -1.0)]
        there = cell == (0, CELLS - 1)[place]
        return [(1.0, len(points) - 1, PAID) if there else (1.0, points.index((cell, place)), -3.0)]

    return cr.FiniteMDP.from_outcomes(
        [*([outcome(*point, a) for a in range(3)] for point in points[:-1]), [[]] * 3],
        terminal=np.arange(len(points)) == len(points) - 1,
        start=np.append(np.full(len(points) - 1, 1 / (len(points) - 1)), 0.0),
        discount=GAMMA,
        states=cr.Space([cr.Component("cell", CELLS + 1), cr.Component("place", 2)], points),
        actions=ACTIONS,
    )


def fetch_and_bring():
    """Pick something up at the left end and put it down at the right end."""
    points = [*product(range(CELLS), ("waits", "rides")), (CELLS, "rides")]
    numbers = [(cell, int(load == "rides")) for cell, load in points]

    def outcome(cell, load, action):
        if action != STOP:
            return [(1.0, points.index((moved(cell, action), load)), -1.0)]
        if load == "waits" and cell == 0:
            return [(1.0, points.index((0, "rides")), -1.0)]
        if load == "rides" and cell == CELLS - 1:
            return [(1.0, len(points) - 1, PAID)]
        return [(1.0, points.index((cell, load)), -3.0)]

    starts = [float(load == "waits") / CELLS for _, load in points]
    load = cr.Component("load", 2, labels=("waits", "rides"))
    return cr.FiniteMDP.from_outcomes(
        [*([outcome(*point, a) for a in range(3)] for point in points[:-1]), [[]] * 3],
        terminal=np.arange(len(points)) == len(points) - 1, start=starts, discount=GAMMA,
        states=cr.Space([cr.Component("cell", CELLS + 1), load], numbers), actions=ACTIONS,
    )  # fmt: skip


TARGET, SOURCE = fetch_and_bring(), errand()


def test_both_legs_are_read_and_the_first_is_shifted_by_what_comes_after():
    (one,) = by_legs(TaskPair(TARGET, SOURCE))
    assert one.how.startswith("first leg: where load is waits the source shifted by -")
    phi = one.mapping.read(cr.solve(SOURCE).action_values)
    exact = cr.solve(TARGET).action_values
    waits = TARGET.states.decode()["load"] == 0
    cells = TARGET.states.decode()["cell"]
    live = ~TARGET.terminal
    assert phi[~waits & live].max(axis=1) == pytest.approx(exact[~waits & live].max(axis=1))
    # Where the leg ends nothing is off; elsewhere the shift is not discounted, which is too low.
    exit_state = waits & (cells == 0)
    assert phi[exit_state, STOP] == pytest.approx(exact[exit_state, STOP])
    assert (phi[waits].max(axis=1) <= exact[waits].max(axis=1) + 1e-9).all()
    assert score_mapping(one.mapping).regained == pytest.approx(1)


def test_of_those_that_regain_everything_only_a_leg_is_nowhere_too_high():
    found = find_mappings(TARGET, SOURCE)
    whole = [one for one in found if one.scores.regained > 0.99 and one.scores.coverage == 1]
    assert {one.how.partition(":")[0]: one.scores.optimistic > 0 for one in whole} == {
        "first leg": False,
        "components by assignment": True,
    }


@pytest.mark.parametrize(
    ("target", "source", "why"),
    [
        (SOURCE, SOURCE, "it lacks 0 of 2"),
        (cr.Pursuit(2, 2), cr.Pursuit(2, 1), "begins every episode and ends none|surely"),
        (TARGET, cr.tasks.RiverSwim(), "it lacks 2 of 2"),
    ],
)
def test_without_a_first_leg_nothing_is_proposed(target, source, why):
    with pytest.raises(MappingError, match=why):
        list(by_legs(TaskPair(target, source)))


# -- shifts of a mapping -------------------------------------------------------------------------

MAZE = cr.GridWorld("S.T")


def shifted(shifts):
    return SearchedMapping(MAZE, MAZE, [[0, 1, -1, 3], [-2] * 4, [-2] * 4], shifts=shifts)


def test_shifts_are_added_before_a_transfer_scales():
    shifts = np.arange(12.0).reshape(3, 4)
    phi = shifted(shifts).read(np.full((3, 4), 5.0), scale=2.0, shift=1.0)
    assert phi[0].tolist() == pytest.approx([11, 13, np.nan, 17], nan_ok=True)
    assert phi[1].tolist() == [9, 11, 13, 15]  # at the source's end Q is 0
    assert (shifted(None).read(np.full((3, 4), 5.0))[1] == 0).all()


@pytest.mark.parametrize("shifts", [[1.0, 2.0], np.full((3, 4), np.nan)])
def test_shifts_must_be_finite_and_of_the_mapping_s_shape(shifts):
    with pytest.raises(MappingError, match=r"shifts of a mapping must be finite .* \(3, 4\)"):
        shifted(shifts)


def test_shifts_tell_mappings_apart_and_are_not_lost_in_a_composition():
    edges = [cr.Transfer("a", "b", shifted(np.full((3, 4), c))) for c in (1.0, 1.0, 2.0)]
    assert same_transfer(edges[0], edges[1])
    assert not same_transfer(edges[0], edges[2])
    for pair in ((identity(MAZE), edges[0].mapping), (edges[0].mapping, identity(MAZE))):
        with pytest.raises(MappingError, match="one mapping has shifts"):
            compose(*pair)
