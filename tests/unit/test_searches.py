"""Searches without names: paths laid beside shorter ones."""

from itertools import combinations_with_replacement

import numpy as np
import pytest
from hypothesis import given, strategies as st

import curricle as cr
from curricle.errors import MappingError
from curricle.planning.solution import solve
from curricle.transfer import (
    TaskPair,
    by_component_warping,
    find_mappings,
)
from curricle.transfer.warping import path_order, paths, warp
from tests.renumbering import nameless

ROOM, SMALLER = cr.tasks.KeyLockPit.room(8), cr.tasks.KeyLockPit.room(6)


@pytest.mark.parametrize(
    ("search", "tasks", "says"),
    [
        (
            by_component_warping,
            lambda: (cr.GridWorld("S..T"), cr.Pursuit(3, 1)),
            "those of the source's 'prey' do not",
        ),
        (
            by_component_warping,
            lambda: (cr.GridWorld("S..T"), SMALLER),
            "the source has 4 and 1 of actions, the target 2",
        ),
        (
            by_component_warping,
            lambda: (cr.tasks.KeyLockPit.room(69), SMALLER),
            "tasks of up to 50,000 pairs: one has 57,138",
        ),
    ],
)
def test_a_search_that_does_not_apply_says_why(search, tasks, says):
    with pytest.raises(MappingError, match=says):
        list(search(TaskPair(*tasks())))


@given(st.integers(0, 2**32 - 1), st.integers(1, 9))
def test_the_order_of_a_path_is_found_despite_lighter_falls(seed, size):
    rng = np.random.default_rng(seed)
    place = rng.permutation(size)
    apart = abs(place[:, None] - place)
    falls = rng.random((size, size))
    weight = np.where(apart == 1, 2 + falls, falls)
    order = path_order(weight + weight.T)
    assert np.array_equal(order, place) or np.array_equal(order, size - 1 - place)


def test_cells_of_a_grid_and_values_that_never_change_have_no_order():
    ring = np.roll(np.eye(4), 1, axis=1)
    assert path_order(ring + ring.T) is None
    assert path_order(np.zeros((2, 2))) is None
    assert paths(cr.Pursuit(3, 1).mdp) == []


def test_values_without_states_are_left_out_of_a_path():
    """The outer walls of four rooms are rows and columns of the component, and of no state."""
    assert [len(path.values) for path in paths(cr.tasks.FourRooms(9).mdp)] == [7, 7]


@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.integers(1, 4))
def test_no_way_that_never_turns_back_is_cheaper_than_the_warp(seed, n, m):
    costs, step = np.random.default_rng(seed).random((n, m)), 0.3

    def cost(way):
        return costs[np.arange(n), way].sum() + step * abs(np.diff(way) - 1).sum()

    ways = combinations_with_replacement(range(m), n)
    assert cost(warp(costs, step)) == pytest.approx(min(cost(np.array(way)) for way in ways))


@pytest.mark.parametrize("seed", range(3))
def test_a_nameless_room_reads_a_smaller_one_by_its_key_lock_and_pits(seed):
    rng = np.random.default_rng(seed)
    (target, new, moved), (source, there, moves) = (
        nameless(task.mdp, rng) for task in (ROOM, SMALLER)
    )
    best = find_mappings(target, source)[0]
    assert best.how.startswith("components in order, warped")
    # In the numbering of the named tasks.
    index = best.mapping.index[np.ix_(new, moved)]
    state, action = np.divmod(index, 6)
    cells = SMALLER.states.decode()
    read = {name: cells[name][np.argsort(there)[state]] for name in cells}
    action = np.argsort(moves)[action]
    live, decoded = ~ROOM.mdp.terminal, ROOM.states.decode()
    assert (index[live] >= 0).all()
    assert (action[live] == np.arange(6)).all()
    for name in ("key", "lock"):
        assert (read[name] == decoded[name][:, None])[live].all()
    for (row, column), key, cell in (((1, 1), 0, (1, 1)), ((7, 7), 1, (5, 5))):
        at = ROOM.states.encode(row=row, column=column, key=key, lock=0)
        assert (read["row"][at, 0], read["column"][at, 0]) == cell
    beside = live & np.isin(decoded["column"], (3, 5)) & (decoded["row"] >= 2)
    assert set(read["column"][beside].ravel()) == {2, 4}  # of the pits' column, 4 and there 3


@pytest.mark.parametrize("seed", range(3))
def test_a_nameless_part_of_a_random_task_is_found(seed):
    lake = cr.tasks.FrozenLake("8x8")
    part = lake.crop(rows=(3, 8), columns=(3, 8))
    rng = np.random.default_rng(seed)
    (target, new, moved), (source, _, _) = (
        nameless(tables, rng) for tables in (lake.mdp, part.mdp)
    )
    by_hand = same_cells(lake, part).read(solve(part.mdp).action_values)
    truth = np.empty_like(by_hand)
    truth[np.ix_(new, moved)] = by_hand
    q = solve(source).action_values
    proposals = list(by_component_warping(TaskPair(target, source)))
    assert all(proposal.how.startswith("components in order, window") for proposal in proposals)
    read = [proposal.mapping.read(q) for proposal in proposals]
    assert any(np.allclose(phi, truth, equal_nan=True) for phi in read)


def same_cells(target, source):
    """Return the mapping of a lake to its part that has the cell, unmapped where it ends."""
    cells = target.states.decode()
    state = source.states.encode(row=cells["row"], column=cells["column"])
    ends = source.mdp.terminal[state] & ~target.mdp.terminal
    state = np.where(ends, -1, state)
    return cr.transfer.mapping.pair_mapping(target, source, state[:, None], np.arange(4))
