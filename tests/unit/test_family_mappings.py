"""Families that come with the library, and mappings between members: as data or by a function."""

import pickle
from typing import Annotated

import numpy as np
import pytest
from gymnasium.envs.toy_text.frozen_lake import generate_random_map

from curricle import Component, FiniteMDP, Pursuit, Space, project, solve
from curricle.errors import MappingError
from curricle.study_file.task_tables import BUILT_IN
from curricle.tasks import (
    ComponentsByName,
    FrozenLake,
    Rule,
    deep_sea_family,
    four_rooms_family,
    frozen_lake_family,
    key_lock_pit_family,
    maze_family,
    pursuit_family,
    task_family,
    taxi_family,
)
from curricle.tasks.mdp import generative_model
from curricle.transfer import (
    ENDED,
    UNMAPPED,
    ComponentMapping,
    StateActionMapping,
    family_mappings,
    identity,
)
from tests.support.refusals import check_refusal


def line(length: Annotated[int, Rule(low=2, harder="larger")] = 5) -> FiniteMDP:
    """Return places in a row, the last of them the end."""
    outcomes = [
        [[(1.0, max(s - 1, 0), -1.0)], [(1.0, min(s + 1, length - 1), -1.0)]] for s in range(length)
    ]
    return FiniteMDP.from_outcomes(
        outcomes,
        terminal=np.arange(length) == length - 1,
        start=0,
        discount=0.9,
        states=Space([Component("place", length)]),
        actions=Space([Component("move", 2, labels=("left", "right"))]),
    )


PLAIN, CLIPPED, SCALED = (
    task_family(name="line", mapping=ComponentsByName(unequal))(line)
    for unequal in ("unmapped", "clip", "scale")
)


def read(mapping):
    """Return the source's state for each of the target's, by the first action."""
    return [int(x) if x < 0 else int(x) // 2 for x in mapping.index[:, 0]]


def test_a_component_that_grows_is_left_unmapped_clipped_or_scaled():
    def states(family, source):
        (mapping,) = family_mappings(family(length=7), family(length=source))
        return read(mapping)

    assert states(PLAIN, 4) == [0, 1, 2, ENDED, UNMAPPED, UNMAPPED, ENDED]
    assert states(CLIPPED, 4) == [0, 1, 2, ENDED, ENDED, ENDED, ENDED]
    assert states(SCALED, 4) == [0, 0, 1, 1, 2, 2, ENDED]
    assert states(SCALED, 14) == [0, 2, 4, 6, 8, 10, ENDED]
    (mapping,) = family_mappings(PLAIN(length=5), PLAIN(length=3), unmapped_value=-7.0)
    assert mapping.read(np.ones((3, 2)))[3, 0] == -7
    for family in (PLAIN, CLIPPED, SCALED):  # lookups read what the index reads
        (mapping,) = family_mappings(family(length=9), family(length=4))
        used = mapping.index[:, 0] >= 0
        assert (mapping.lookups()[0][used] == mapping.index[used, 0] // 2).all()


def test_a_mapping_by_name_is_pickled_with_its_names():
    clipped = family_mappings(CLIPPED(length=6), CLIPPED(length=3))[0]
    named = project(Pursuit(3, 2), Pursuit(3, 1), predator="predator_2")
    for mapping in (clipped, named):
        again = pickle.loads(pickle.dumps(mapping))
        assert repr(again) == repr(mapping)
        assert (again.index == mapping.index).all()
        assert np.array_equal(again.lookups()[0], mapping.lookups()[0])


def test_a_family_may_map_by_a_function_of_states_or_make_the_mapping():
    def halved(target, source):
        return lambda state, action: ({"place": state["place"] // 2}, action)

    by_function = task_family(name="line", mapping=halved)(line)
    (mapping,) = family_mappings(by_function(length=6), by_function(length=3))
    assert read(mapping) == [0, 0, 1, 1, ENDED, ENDED]

    mine = task_family(mapping=lambda target, source: identity(target.task))(line)
    member = mine(length=4)
    (mapping,) = family_mappings(member, member)
    assert isinstance(mapping, StateActionMapping)
    assert read(mapping) == [0, 1, 2, ENDED]

    renamed = task_family(mapping=ComponentsByName(renaming={"place": "where"}))(line)
    with pytest.raises(MappingError, match="must be read from a target component"):
        family_mappings(renamed(length=3), renamed(length=3))


def test_members_that_do_not_fit_are_refused():
    for target, source, said in (
        (PLAIN(length=3), maze_family(), "members of one family map onto each"),
        (PLAIN(length=3), line(3), "source must be a FamilyMember"),
        (pursuit_family(predators=1), pursuit_family(predators=2), "at most its 1 predators: got"),
    ):
        with pytest.raises(MappingError, match=said):
            family_mappings(target, source)


@pytest.mark.parametrize(
    ("returned", "said"),
    [
        ([], "at least one mapping"),
        ("place", "or a list of them: got 'place'"),
        (np.eye(2, dtype=int), r"or a list of them: got array\(\[\[1, 0\], \[0, 1\]\]\)$"),
        ([list(range(500))], r"or a list of them: got \[0, 1, 2, .*, 5\d,? \[\.\.\.\]$"),
        (lambda state, action: (state,), r"two dicts, of states and of actions: got \(\{'place'"),
        (lambda state, action: ({1: 0}, action), "source's state components place: got 1"),
    ],
)
def test_a_function_that_returns_no_mapping_is_refused(returned, said):
    family = task_family(mapping=lambda target, source: returned)(line)
    check_refusal(MappingError, lambda: family_mappings(family(length=3), family(length=3)), said)


def test_two_predators_read_one_as_in_the_paper():
    hunt, chase = pursuit_family(size=3, predators=2), pursuit_family(size=3, predators=1)
    mappings = family_mappings(hunt, chase)
    assert len(mappings) == 2
    for mapping, name in zip(mappings, hunt.task.predator_names, strict=True):
        assert isinstance(mapping, ComponentMapping)
        assert (mapping.index == project(hunt.task, chase.task, predator=name).index).all()


@pytest.mark.parametrize(("ours", "theirs", "groups"), [(2, 2, 1), (3, 1, 3), (3, 2, 3), (4, 3, 4)])
def test_each_predator_is_read_equally_often(ours, theirs, groups):
    hunt, chase = pursuit_family(size=2, predators=ours), pursuit_family(size=2, predators=theirs)
    declared = hunt.family.mapping(hunt, chase)
    assert len(declared) == groups
    read_of = [name for named in declared for source, name in named.renaming if source != "prey"]
    assert {read_of.count(name) for name in hunt.task.predator_names} == {groups * theirs // ours}


def cells(task, state):
    """Return the cells of all bodies in a state, (bodies, 2)."""
    values = task.states.decode(state)
    return np.array([np.divmod(int(values[name]), task.size) for name in task.states.names])


@pytest.mark.parametrize("torus", [False, True])
@pytest.mark.parametrize("size", [4, 5])
def test_distances_that_fit_stay_the_same_on_another_size(size, torus):
    hunt = pursuit_family(size=size, predators=1, torus=torus)
    small = pursuit_family(size=3, predators=1, torus=torus)
    (mapping,) = family_mappings(hunt, small)
    source = np.maximum(mapping.index[:, 0], 0) // 5
    checked = 0
    for state in np.flatnonzero(mapping.index[:, 0] >= 0):
        ours, theirs = cells(hunt.task, state), cells(small.task, int(source[state]))
        apart, read_apart = ours[1] - ours[0], theirs[1] - theirs[0]
        if torus:
            apart = (apart + size // 2) % size - size // 2
            read_apart = (read_apart + 1) % 3 - 1
            fits = (abs(apart) <= 1).all()
        else:
            fits = (abs(apart) <= 2).all()
        if fits:
            checked += 1
            assert (apart == read_apart).all()
        if fits and not torus:  # whoever stands at a wall still does
            for edge, other_edge in ((0, 0), (size - 1, 2)):
                at_edge = (ours == edge).any(axis=0)
                assert (theirs == other_edge).any(axis=0)[at_edge].all()
    assert checked > size**2


def test_moves_keep_their_names_where_staying_is_no_move():
    hunt = pursuit_family(size=4, predators=1)
    small = pursuit_family(size=3, predators=1, moves=4)
    (mapping,) = family_mappings(hunt, small)
    row = mapping.index[hunt.task.states.encode(prey=0, predator=5)]
    assert row[0] == UNMAPPED
    names = [small.task.actions.label(pair % 4) for pair in row[1:]]
    assert names == [hunt.task.actions.label(action) for action in range(1, 5)]


RELATIVES = {
    "maze": [{"size": 5}, {"size": 3, "start": "uniform"}, 0.99, 0.99],
    "pursuit": [{"size": 3}, {"size": 3, "predators": 1}, 0.7, 0.6],
    "frozen_lake": [{"map": "8x8", "slippery": False}, {"map": "8x8", "part": 5, "slippery": False},
                    0.99, 0.99],
    "cliff_walking": [{"columns": 10}, {"columns": 5}, 0.8, 0.95],
    "taxi": [{}, {"size": 3, "stands": 2}, 0.9, 0.8],
    "four_rooms": [{"start": "uniform"}, {"size": 9, "slip": 0.1}, 0.9, 0.8],
    "key_lock_pit": [{"size": 8}, {"size": 6}, 0.95, 0.99],
    "river_swim": [{"size": 10}, {"size": 6}, 0.9, 0.95],
    "deep_sea": [{"size": 10}, {"size": 6}, 0.99, 0.99],
}  # fmt: skip
"""Target and source of each family, and the least correlation and agreement of their values."""


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_member_maps_onto_itself_pair_by_pair(name):
    family = BUILT_IN[name]
    member = family(**RELATIVES[name][1])
    (mapping,) = family_mappings(member, member)
    task = generative_model(member.task)
    pairs = np.arange(task.states.size * task.actions.size).reshape(mapping.index.shape)
    assert (mapping.index == np.where(task.terminal[:, None], ENDED, pairs)).all()


@pytest.mark.parametrize("name", BUILT_IN)
def test_easier_members_are_built_and_read(name):
    target, source = (BUILT_IN[name](**parameters) for parameters in RELATIVES[name][:2])
    easier = list(BUILT_IN[name].easier(source))
    assert all(member.family == target.family and member != source for member in easier)
    for member in easier[-3:]:
        assert generative_model(member.task).states.size >= 2
        for mapping in family_mappings(target, member):
            assert mapping.coverage().mapped > 0


@pytest.mark.parametrize("name", BUILT_IN)
def test_the_values_of_a_relative_are_worth_reading(name):
    """Where the mapping reads something: the order of states, and the share of optimal actions."""
    *pair, correlation, agreement = RELATIVES[name]
    target, source = (BUILT_IN[name](**parameters) for parameters in pair)
    mine, values = solve(target.task).action_values, solve(source.task).action_values
    read = [f.read(values) for f in family_mappings(target, source)]
    phi = np.ma.masked_invalid(read).mean(axis=0).filled(np.nan)
    known = ~np.isnan(phi).all(axis=1) & ~generative_model(target.task).terminal
    assert known.mean() > 0.2
    phi, mine = np.nan_to_num(phi[known], nan=-np.inf), mine[known]
    assert np.corrcoef(phi.max(axis=1), mine.max(axis=1))[0, 1] > correlation
    best = mine[np.arange(len(mine)), phi.argmax(axis=1)] > mine.max(axis=1) - 1e-6
    assert best.mean() > agreement


def test_parts_of_lakes():
    whole, part = frozen_lake_family(map="8x8"), frozen_lake_family(map="8x8", part=4)
    assert part.task == FrozenLake("8x8").crop(rows=(4, 8), columns=(4, 8))
    (mapping,) = family_mappings(whole, part)
    row, column = whole.task.layout.cells.T
    inside = (row >= 4) & (column >= 4)
    assert ((mapping.index != -1).all(axis=1) == inside | whole.task.mdp.terminal).all()
    drawn = frozen_lake_family(map="random", size=6, seed=9, frozen_share=0.7)
    assert list(drawn.task.map) == generate_random_map(6, 0.7, 9)
    easier = frozen_lake_family.easier(frozen_lake_family(slippery=False))
    assert [named["part"] for named in easier] == [2, 3]


def test_a_sea_is_read_from_the_ground():
    (mapping,) = family_mappings(deep_sea_family(size=6), deep_sea_family(size=4))
    assert (mapping.index >= 0).all(axis=1).sum() == 4 * 5 // 2


@pytest.mark.parametrize(("size", "smaller"), [(13, 9), (13, 7), (20, 13), (9, 13)])
def test_hallways_are_read_as_hallways(size, smaller):
    target, source = four_rooms_family(size=size), four_rooms_family(size=smaller)
    (mapping,) = family_mappings(target, source)
    for name, (row, column) in target.task.hallways.items():
        pair = mapping.index[target.task.states.encode(row=row, column=column), 0]
        if name == "east":
            assert pair == ENDED
        else:
            cell = source.task.states.points[pair // 4]
            assert tuple(cell) == source.task.hallways[name]


@pytest.mark.parametrize("size", range(4, 12))
def test_keys_pits_and_locks_are_read_as_such(size):
    target, source = key_lock_pit_family(size=11), key_lock_pit_family(size=size)
    (mapping,) = family_mappings(target, source)
    room, smaller = target.task, source.task
    key = mapping.index[room.states.encode(row=1, column=1, key=0, lock=0), 4]
    assert smaller.states.label(key // 6) == "row=1 column=1 key=lying lock=locked"
    lock = mapping.index[room.states.encode(row=10, column=10, key=1, lock=0), 5]
    assert smaller.mdp.terminal[smaller.mdp.next_state[smaller.mdp.outcome_row.ravel()[lock], 0]]


def test_stands_are_read_as_stands():
    target, source = taxi_family(), taxi_family(size=3)
    (mapping,) = family_mappings(target, source)
    for cell, read_cell in zip(target.task.stand_cells, source.task.stand_cells, strict=True):
        row, column = np.divmod(cell, 5)
        state = target.task.states.encode(row=row, column=column, passenger=4, destination=1)
        read = mapping.index[state, 0]
        if read == ENDED:
            continue
        values = source.task.states.decode(read // 6)
        assert values["row"] * 3 + values["column"] == read_cell
