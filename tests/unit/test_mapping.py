"""Mappings between tasks, by hand: source pairs, unmapped pairs, coverage, and the edge."""

import numpy as np
import pytest

from curricle import (
    Component,
    CurricleError,
    FiniteMDP,
    GridWorld,
    Pursuit,
    Space,
    Transfer,
    from_function,
    project,
    same_position,
)
from curricle.errors import MappingError
from curricle.transfer import (
    ENDED,
    UNMAPPED,
    StateActionMapping,
    compose,
    identity,
    relative_objects,
)
from curricle.transfer.mapping import Coverage

LINE = GridWorld("S..T")
END = LINE.crop(rows=(0, 1), columns=(2, 4))


def source_states(mapping):
    """The source state each target state reads its first action from, or UNMAPPED or ENDED."""
    first = mapping.index[:, 0]
    return np.where(first >= 0, first // mapping.source.actions.size, first).tolist()


# -- identity and same_position ------------------------------------------------------------------


def test_same_position_by_hand():
    mapping = same_position(LINE, END)
    assert source_states(mapping) == [UNMAPPED, UNMAPPED, 0, ENDED]
    assert mapping.index[2].tolist() == [0, 1, 2, 3]
    open_field, walled = GridWorld(["S.", ".T"]), GridWorld(["S#", ".T"])
    assert source_states(same_position(open_field, walled)) == [0, UNMAPPED, 1, ENDED]
    assert source_states(same_position(walled, open_field)) == [0, 2, ENDED]
    deadly, mild = GridWorld("SPT"), GridWorld("SPT", ends=("treasure",))
    assert source_states(same_position(mild, deadly)) == [0, ENDED, ENDED]
    assert source_states(same_position(deadly, mild)) == [0, ENDED, ENDED]


# -- project -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["predator_1", "predator_2"])
def test_project_reads_one_predator_of_two(name):
    hunt, chase = Pursuit(size=2, predators=2), Pursuit(size=2, predators=1)
    mapping = project(hunt, chase, predator=name)
    where, move = hunt.states.decode(), hunt.actions.decode()
    for s in range(hunt.states.size):
        for a in range(hunt.actions.size):
            pair = chase.states.encode(prey=where["prey"][s], predator=where[name][s]) * 5
            pair += move[name][a]
            touching = where[name][s] == where["prey"][s]
            assert mapping.index[s, a] == (ENDED if touching else pair)


def test_project_matches_cells_by_their_labels_across_grid_sizes():
    big, small = Pursuit(size=3, predators=1), Pursuit(size=2, predators=1)
    mapping = project(big, small)
    inside = big.states.encode(prey=4, predator=1)  # (1,1) and (0,1)
    outside = big.states.encode(prey=4, predator=2)  # (0,2) is not on the small grid
    assert mapping.index[inside, 0] == small.states.encode(prey=3, predator=1) * 5
    assert (mapping.index[outside] == UNMAPPED).all()


def test_project_without_labels_or_with_other_moves():
    five, four = Pursuit(size=2, predators=1), Pursuit(size=2, predators=1, moves=4)
    state = five.states.encode(prey=0, predator=1)
    assert project(five, four).index[state].tolist() == [UNMAPPED, *range(4 * state, 4 * state + 4)]
    assert project(four, five).index[state].tolist() == list(range(5 * state + 1, 5 * state + 5))
    assert project(plain(4), plain(2, low=1)).index[:, 0].tolist() == [UNMAPPED, 0, 1, UNMAPPED]
    assert project(plain(2), plain(2, "other"), other="state").index[:, 0].tolist() == [0, 1]


def plain(n, name="state", low=0):
    moves = Space([Component("action", 1)])
    return FiniteMDP.from_dense(
        np.eye(n)[:, None, :], np.zeros(n), terminal=np.zeros(n, bool), start=0, discount=0.5,
        states=Space([Component(name, n, low=low)]), actions=moves,
    )  # fmt: skip


# -- relative_objects ----------------------------------------------------------------------------


def test_relative_objects_by_hand():
    target = GridWorld(["S....", "..F.T"])
    source = GridWorld(["F.T", "S.."])  # fits with its top row on the target's bottom row
    assert np.array(source_states(relative_objects(target, source))).reshape(2, 5).tolist() == [
        [UNMAPPED] * 5,
        [UNMAPPED, UNMAPPED, 0, 1, ENDED],
    ]
    mapping = relative_objects(GridWorld("SF..T"), GridWorld("SF.T"))
    assert source_states(mapping)[:4] == [UNMAPPED] * 4
    assert mapping.coverage().mapped == 0
    assert mapping.coverage().mean_readers == 0
    assert relative_objects(GridWorld("SF.PT"), GridWorld("SP.T")).coverage().mapped == 0


def test_relative_objects_takes_the_smallest_shift_that_maps_a_cell():
    target, source = GridWorld("T.S.T", ends=()), GridWorld("S.T", ends=())
    # Shift -2 (treasure at 0) reaches only column 0; shift 2 (treasure at 4) columns 2, 3, 4.
    assert source_states(relative_objects(target, source)) == [2, UNMAPPED, 0, 1, 2]
    both = GridWorld("T.T.S", ends=())
    wide = GridWorld("S.T..", ends=())
    # Shift -2 maps columns 0, 1, 2 and comes first; shift 0 adds 3 and 4.
    assert source_states(relative_objects(both, wide)) == [2, 3, 4, 3, 4]


# -- from_function -------------------------------------------------------------------------------


def test_from_function_gets_broadcastable_components():
    shapes = {}

    def coarse(state, action):
        shapes.update(column=state["column"].shape, move=action["move"].shape)
        return {"row": state["row"], "column": state["column"] + 2}, action

    mapping = from_function(END, LINE, coarse)
    assert shapes == {"column": (2, 1), "move": (1, 4)}
    assert source_states(mapping) == [UNMAPPED, ENDED]


def test_from_function_may_map_actions_by_state_and_does_not_round():
    def mirrored(state, action):
        east_is_west = np.array([0, 3, 2, 1])[action["move"]]
        return state, {"move": np.where(state["column"] == 0, east_is_west, action["move"])}

    mapping = from_function(LINE, LINE, mirrored)
    assert mapping.index[:2].tolist() == [[0, 3, 2, 1], [4, 5, 6, 7]]

    def half(state, action):
        return {**state, "column": state["column"] / 2}, action

    with pytest.raises(CurricleError):
        from_function(LINE, LINE, half)


def test_a_function_that_asks_for_an_unknown_component_is_told_those_there_are():
    with pytest.raises(MappingError, match="of the target's states, row, column: got 'colunm'"):
        from_function(LINE, END, lambda state, action: ({"row": state["colunm"]}, action))
    with pytest.raises(MappingError, match="of the target's actions, move: got 'step'"):
        from_function(LINE, END, lambda state, action: (state, {"move": action["step"]}))
    with pytest.raises(MappingError, match="components of the source, column, move, row: got 'x'"):
        project(LINE, END, x="row")


# -- compose -------------------------------------------------------------------------------------


def test_compose_maps_through_the_middle_task():
    middle = GridWorld("S..T").crop(rows=(0, 1), columns=(1, 4))
    both = compose(same_position(LINE, middle), same_position(middle, END))
    assert source_states(both) == [UNMAPPED, UNMAPPED, 0, ENDED]
    assert (both.target, both.source) == (LINE, END)
    first = same_position(LINE, END, unmapped_value=-3)
    assert compose(first, identity(END)).read(np.ones((2, 4)))[0].tolist() == [-3] * 4


# -- reading and coverage ------------------------------------------------------------------------


def test_reading_by_hand():
    q = np.arange(8.0).reshape(2, 4) + 10
    read = same_position(LINE, END, unmapped_value=-7).read(q)
    assert read.tolist() == [[-7] * 4, [-7] * 4, [10, 11, 12, 13], [0] * 4]
    q = np.arange(24.0).reshape(3, 2, 4)
    assert same_position(LINE, END).read(q).shape == (3, 4, 4)
    assert same_position(LINE, END).read(q)[2, 2].tolist() == [16, 17, 18, 19]
    assert same_position(LINE, END).mapped_states().tolist() == [False, False, True, False]


def test_rows_of_terminal_target_states_do_not_count():
    index = np.array([[0] * 4, [1] * 4, [2] * 4, [999] * 4])
    mapping = StateActionMapping(LINE, END, index)
    assert mapping.index[3].tolist() == [ENDED] * 4
    assert index[3].tolist() == [999] * 4


def test_coverage_counts_by_hand():
    index = np.full((4, 4), UNMAPPED)
    index[0] = [0, 0, 1, ENDED]
    index[3] = ENDED  # terminal: not counted
    assert StateActionMapping(LINE, END, index).coverage() == Coverage(
        target_pairs=12, mapped=3 / 12, ended=1 / 12, unmapped=8 / 12,
        source_pairs=4, never_used=2, most_readers=2, mean_readers=1.5,
    )  # fmt: skip


# -- the edge ------------------------------------------------------------------------------------


def test_scale_and_shift_apply_to_mapped_pairs_only():
    mapping = same_position(LINE, END, unmapped_value=-7)
    phi = Transfer("end", "line", mapping, scale=2, shift=-1).potential(np.full((2, 4), 5.0))
    assert phi[:3, 0].tolist() == [-7, -7, 9]
    deadly, mild = GridWorld("SPT"), GridWorld("SPT", ends=("treasure",))
    edge = Transfer("deadly", "mild", same_position(mild, deadly), scale=2, shift=3)
    assert edge.potential(np.full((3, 4), 5.0))[:2, 0].tolist() == [13, 3]
