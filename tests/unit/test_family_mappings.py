"""Mappings between members of a family: declared as data or by a function, checked as any other."""

import pickle

import numpy as np
import pytest

from curricle import Component, FiniteMDP, Pursuit, Space, project
from curricle.errors import MappingError
from curricle.tasks import ComponentsByName, Parameter, maze_family, pursuit_family, task_family
from curricle.transfer import (
    ENDED,
    UNMAPPED,
    ComponentMapping,
    StateActionMapping,
    family_mappings,
    identity,
)
from tests.refusals import check_refusal


def line(length: int = 5) -> FiniteMDP:
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


SIZES = Parameter("length", low=2, harder="larger")
PLAIN, CLIPPED, SCALED = (
    task_family(SIZES, name="line", mapping=ComponentsByName(unequal))(line)
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


def test_lookups_read_what_the_index_reads():
    for family in (PLAIN, CLIPPED, SCALED):
        target, source = family(length=9), family(length=4)
        (mapping,) = family_mappings(target, source)
        (table,) = mapping.lookups()
        whole = np.where(target.task.terminal, -1, table)
        expected = mapping.index[:, 0] // 2
        used = mapping.index[:, 0] >= 0
        assert (whole[used] == expected[used]).all()


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

    by_function = task_family(SIZES, name="line", mapping=halved)(line)
    (mapping,) = family_mappings(by_function(length=6), by_function(length=3))
    assert read(mapping) == [0, 0, 1, 1, ENDED, ENDED]

    own = task_family(SIZES, mapping=lambda target, source: identity(target.task))(line)
    member = own(length=4)
    (mapping,) = family_mappings(member, member)
    assert isinstance(mapping, StateActionMapping)
    assert read(mapping) == [0, 1, 2, ENDED]

    renamed = task_family(SIZES, mapping=ComponentsByName(renaming={"place": "where"}))(line)
    with pytest.raises(MappingError, match="must be read from a target component"):
        family_mappings(renamed(length=3), renamed(length=3))


def test_values_for_unmapped_pairs_are_passed_on():
    (mapping,) = family_mappings(PLAIN(length=5), PLAIN(length=3), unmapped_value=-7.0)
    assert mapping.read(np.ones((3, 2)))[3, 0] == -7


@pytest.mark.parametrize(
    ("target", "source", "said"),
    [
        (lambda: PLAIN(length=3), lambda: maze_family(), "members of one family map onto each"),
        (lambda: PLAIN(length=3), lambda: line(3), "source must be a FamilyMember"),
        (
            lambda: pursuit_family(predators=1),
            lambda: pursuit_family(predators=2),
            "at most its 1 predators: got pursuit",
        ),
    ],
)
def test_members_that_do_not_fit_are_refused(target, source, said):
    with pytest.raises(MappingError, match=said):
        family_mappings(target(), source())


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
    family = task_family(SIZES, mapping=lambda target, source: returned)(line)
    check_refusal(MappingError, lambda: family_mappings(family(length=3), family(length=3)), said)


# -- pursuit ---------------------------------------------------------------------------------------


def test_two_predators_read_one_as_in_the_paper():
    hunt, chase = pursuit_family(size=3, predators=2), pursuit_family(size=3, predators=1)
    found = family_mappings(hunt, chase)
    assert len(found) == 2
    for mapping, name in zip(found, hunt.task.predator_names, strict=True):
        assert isinstance(mapping, ComponentMapping)
        assert (mapping.index == project(hunt.task, chase.task, predator=name).index).all()


@pytest.mark.parametrize(("own", "others", "groups"), [(2, 2, 1), (3, 1, 3), (3, 2, 3), (4, 3, 4)])
def test_each_predator_is_read_equally_often(own, others, groups):
    hunt, chase = pursuit_family(size=2, predators=own), pursuit_family(size=2, predators=others)
    declared = hunt.family.mapping(hunt, chase)
    assert len(declared) == groups
    read_of = [name for one in declared for source, name in one.renaming if source != "prey"]
    assert {read_of.count(name) for name in hunt.task.predator_names} == {groups * others // own}


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
        own, other = cells(hunt.task, state), cells(small.task, int(source[state]))
        apart, read_apart = own[1] - own[0], other[1] - other[0]
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
                at_edge = (own == edge).any(axis=0)
                assert (other == other_edge).any(axis=0)[at_edge].all()
    assert checked > size**2


def test_moves_keep_their_names_where_staying_is_no_move():
    hunt = pursuit_family(size=4, predators=1)
    small = pursuit_family(size=3, predators=1, moves=4)
    (mapping,) = family_mappings(hunt, small)
    row = mapping.index[hunt.task.states.encode(prey=0, predator=5)]
    assert row[0] == UNMAPPED
    names = [small.task.actions.label(pair % 4) for pair in row[1:]]
    assert names == [hunt.task.actions.label(action) for action in range(1, 5)]
