"""States matched by structure alone; needs the extra `match`."""

import sys

import numpy as np
import pytest

import curricle as cr
from curricle.errors import MappingError
from curricle.transfer import TaskPair, by_structure, find_mappings
from curricle.transfer.structure_matching import distances
from tests.renumbering import renumbered

LANE = cr.GridWorld("S.....T")


def test_distances_are_steps():
    apart = distances(cr.GridWorld(["S#.", "..T"]).mdp)
    np.testing.assert_array_equal(apart, apart.T)
    assert apart[0].tolist() == [0, 4, 1, 2, 3]  # north-east only past the end: none gets there


def test_a_lane_is_found_by_its_structure():
    pytest.importorskip("ot")
    copy, new, _ = renumbered(LANE.mdp, np.random.default_rng(0))
    found = find_mappings(copy, LANE, searches=[by_structure])
    assert found[0].how.startswith("structure of states")
    assert found[0].scores.regained > 0.9
    live = ~copy.terminal
    truth = np.argsort(new)
    assert ((found[0].mapping.index // 4)[live] == truth[live, None]).mean() > 0.9


def test_without_the_extra_it_is_refused(monkeypatch):
    monkeypatch.setitem(sys.modules, "ot.gromov", None)
    with pytest.raises(MappingError, match=r'needs POT: pip install "curricle\[match\]"'):
        list(by_structure(TaskPair(LANE, LANE)))
