"""Mappings between pursuits as vectors, of joint predators and of agents."""

import pickle

import gymnasium
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from curricle import Pursuit, Transfer, minimum, project
from curricle.errors import MappingError
from curricle.interop.gymnasium import observation_task
from curricle.interop.pettingzoo import to_pettingzoo
from curricle.interop.vector_pursuit import (
    PursuitVectors,
    observed_pursuit,
    predator_mapping,
)
from curricle.tasks.observation_task import ObservationTask
from curricle.transfer import FunctionValues, TableValues
from curricle.transfer.aggregation import aggregate
from curricle.transfer.mapping import ENDED, UNMAPPED
from curricle.transfer.potentials import ObservationPotential

from .environments import every_cell

CASES = {
    "1->2": (Pursuit(3, 2), Pursuit(3, 1), {"predator": "predator_2"}),
    "1->3": (Pursuit(3, 3), Pursuit(3, 1), {"predator": "predator_3"}),
    "2->3": (Pursuit(3, 3), Pursuit(3, 2), {"predator_1": "predator_3"}),
    "2->3 crossed": (
        Pursuit(2, 3),
        Pursuit(2, 2, capture="any"),
        {"predator_1": "predator_2", "predator_2": "predator_1"},
    ),
    "smaller": (Pursuit(4, 2), Pursuit(3, 1), {"predator": "predator_1"}),
    "larger": (Pursuit(3, 2), Pursuit(5, 1), {"predator": "predator_1"}),
    "torus": (Pursuit(4, 2, torus=True), Pursuit(4, 1, torus=True), {"predator": "predator_2"}),
    "from a walled one": (Pursuit(3, 2, torus=True), Pursuit(3, 1), {"predator": "predator_2"}),
    "4 moves": (Pursuit(3, 2, moves=4), Pursuit(3, 1, moves=4), {"predator": "predator_2"}),
    "4 moves of 5": (Pursuit(3, 2, moves=4), Pursuit(3, 1), {"predator": "predator_1"}),
    "as published": (
        Pursuit(3, 3, capture="as_published"),
        Pursuit(3, 2, capture="as_published"),
        {"predator_2": "predator_3"},
    ),
    "both one": (
        Pursuit(3, 1),
        Pursuit(3, 2),
        {"predator_1": "predator", "predator_2": "predator"},
    ),
}


def random_values(pursuit, seed=0):
    shape = pursuit.states.size, pursuit.actions.size
    return np.random.default_rng(seed).normal(size=shape)


def values_of_vectors(pursuit, q):
    """A table, read as a deep learner is: by vectors and actions."""
    seen = PursuitVectors(pursuit)

    def read(vectors, actions):
        where = zip(pursuit.states.names, seen.cells(vectors).T, strict=True)
        states = pursuit.states.encode(**dict(where))
        return q[states[:, None] if np.ndim(actions) == 2 else states, actions]

    return FunctionValues(action_values=read, actions=pursuit.actions.size)


@pytest.mark.parametrize("source_is", ["a table", "vectors"])
@pytest.mark.parametrize("case", CASES)
def test_potentials_over_vectors_are_those_over_states(case, source_is):
    target, source, renaming = CASES[case]
    q = random_values(source)
    by_index = project(target, source, unmapped_value=-7.0, **renaming)
    if source_is == "a table":
        read_from, values = source, TableValues(q)
    else:
        read_from, values = observed_pursuit(source), values_of_vectors(source, q)
    task = observed_pursuit(target)
    mapping = predator_mapping(task, read_from, unmapped_value=-7.0, **renaming)
    phi = ObservationPotential(task, [Transfer("source", "target", mapping)], [values])
    going_on = ~target.terminal
    vectors = PursuitVectors(target).of(every_cell(target)[going_on])
    assert np.array_equal(phi.pairs(vectors), by_index.read(q)[going_on])
    coverage = by_index.coverage()
    found = mapping.coverage(vectors)
    assert (found.mapped, found.ended, found.unmapped) == pytest.approx(
        (coverage.mapped, coverage.ended, coverage.unmapped)
    )
    if source_is == "vectors":
        assert found.outside == 0


def test_moves_that_the_source_lacks_are_unmapped():
    target, source = Pursuit(3, 2), Pursuit(3, 1, moves=4)
    mapping = predator_mapping(
        observed_pursuit(target), source, predator="predator_2", unmapped_value=-7.0
    )
    assert mapping.actions.tolist() == [UNMAPPED, 0, 1, 2, 3] * 5
    cells = every_cell(target)
    cells = cells[(cells[:, 0] != cells[:, 1]) | (cells[:, 0] != cells[:, 2])]  # not yet over
    found = mapping.pairs(TableValues(random_values(source)), PursuitVectors(target).of(cells))
    by_index = project(target, source, predator="predator_2", unmapped_value=-7.0)
    states = target.states.encode(prey=cells[:, 0], predator_1=cells[:, 1], predator_2=cells[:, 2])
    assert np.array_equal(found, by_index.read(random_values(source))[states])


@settings(max_examples=30, deadline=None)
@given(
    sizes=st.tuples(st.integers(2, 3), st.integers(2, 4)),
    predators=st.sampled_from([(2, 1), (2, 2), (3, 1)]),
    torus=st.booleans(),
    moves=st.sampled_from([4, 5]),
    seed=st.integers(0, 100),
)
def test_several_sources_together_are_those_over_states(sizes, predators, torus, moves, seed):
    target = Pursuit(sizes[0], predators[0], torus=torus, moves=moves)
    source = Pursuit(sizes[1], predators[1], torus=torus, moves=moves)
    rng = np.random.default_rng(seed)
    names = {name: str(rng.choice(target.predator_names)) for name in source.predator_names}
    settings_of_edges = [dict(names), dict.fromkeys(source.predator_names, "predator_1")]
    task, q = observed_pursuit(target), random_values(source, seed)
    edges = [
        Transfer("source", "target", predator_mapping(task, source, **each), scale=2.0, shift=0.5)
        for each in settings_of_edges
    ]
    phi = ObservationPotential(task, edges, [TableValues(q)] * 2, minimum)
    read = [
        Transfer("source", "target", project(target, source, **each), scale=2.0, shift=0.5)
        for each in settings_of_edges
    ]
    expected = aggregate(minimum, np.stack([edge.potential(q) for edge in read]))
    states = rng.choice(np.flatnonzero(~target.terminal), 40)
    vectors = PursuitVectors(target).of(every_cell(target)[states])
    assert np.array_equal(phi.pairs(vectors), expected[states])


def test_states_of_targets_too_large_for_numbers_are_read():
    target, source = Pursuit(10, 4), Pursuit(10, 1)
    q = random_values(source)
    mapping = predator_mapping(observed_pursuit(target), source, predator="predator_4")
    rng = np.random.default_rng(0)
    cells = rng.integers(100, size=(200, 5))
    cells[:20, 4] = cells[:20, 0]
    found = mapping.pairs(TableValues(q), PursuitVectors(target).of(cells))
    alone = q[source.states.encode(prey=cells[:, 0], predator=cells[:, 4])]
    over = cells[:, 0] == cells[:, 4]
    assert np.array_equal(found, np.where(over[:, None], 0, alone)[:, np.arange(625) % 5])


def test_sources_over_vectors_may_be_too_large_for_numbers_too():
    target, source = observed_pursuit(Pursuit(10, 4)), observed_pursuit(Pursuit(9, 3))
    mapping = predator_mapping(target, source, predator_3="predator_4")
    cells = np.array(
        [[0, 12, 99, 1], [11, 11, 5, 11], [11, 11, 5, 12], [88, 0, 5, 9], [99, 0, 5, 0]]
    )
    vectors = PursuitVectors(Pursuit(10, 4)).of(np.insert(cells, 3, 7, axis=1))
    # Rows and columns stay; the tenth of either is not there. All three must touch to end it.
    assert mapping.status(vectors).tolist() == [UNMAPPED, 0, 0, UNMAPPED, UNMAPPED]
    there = PursuitVectors(Pursuit(9, 3)).cells(mapping.observations(vectors))
    assert there[1:3].tolist() == [[10, 10, 5, 10], [10, 10, 5, 11]]
    caught = PursuitVectors(Pursuit(10, 4)).of(np.array([[11, 11, 11, 7, 11]]))
    assert mapping.status(caught).tolist() == [ENDED]


def test_mappings_travel_between_processes():
    target, source = Pursuit(3, 2), Pursuit(3, 1)
    vectors = PursuitVectors(target).of(every_cell(target)[100:200])
    values = TableValues(random_values(source))
    for read_from, of in (
        (source, values),
        (observed_pursuit(source), FunctionValues(np_value, actions=5)),
    ):
        mapping = predator_mapping(observed_pursuit(target), read_from, predator="predator_1")
        again = pickle.loads(pickle.dumps(mapping))
        assert np.array_equal(again.pairs(of, vectors), mapping.pairs(of, vectors))


def np_value(vectors, actions):
    return vectors[:, 2:3] + 0.1 * actions


def test_other_tasks_and_unknown_predators_are_refused():
    hunt, chase = observed_pursuit(Pursuit(3, 2)), Pursuit(3, 1)
    for target, source in (
        (observation_task("CartPole-v1"), chase),
        (Pursuit(3, 2), chase),
        (hunt, "it"),
    ):
        with pytest.raises(MappingError, match="pursuits observed as vectors"):
            predator_mapping(target, source, predator="predator_1")
    rescaled = ObservationTask(lambda: gymnasium.wrappers.RescaleObservation(hunt.make(), 0, 1))
    with pytest.raises(MappingError, match="pursuits observed as vectors"):
        predator_mapping(rescaled, chase, predator="predator_1")
    with pytest.raises(MappingError, match="'predator' must be read from a target component"):
        predator_mapping(hunt, chase)
    with pytest.raises(MappingError, match="prey, predator_1, predator_2"):
        predator_mapping(hunt, chase, predator="predator_3")
    with pytest.raises(MappingError, match="project names components of the source"):
        predator_mapping(hunt, chase, predator_2="predator_1")


# -- agents ------------------------------------------------------------------------------------


def test_an_agent_sees_the_pursuit_whose_first_predator_it_is():
    pytest.importorskip("pettingzoo")
    pursuit = Pursuit(4, 3)
    hunt = to_pettingzoo(pursuit, observation="vector")
    cells = {"prey": 2, "predator_1": 11, "predator_2": 12, "predator_3": 13}
    seen, _ = hunt.reset(options={"state": cells})
    expected = {
        "predator_1": [2, 11, 12, 13],
        "predator_2": [2, 12, 11, 13],
        "predator_3": [2, 13, 11, 12],
    }
    vectors = PursuitVectors(pursuit)
    assert {a: vectors.cells(view[None])[0].tolist() for a, view in seen.items()} == expected
    for agent, view in seen.items():
        assert hunt.observation_space(agent).contains(view)
        assert hunt.observation_space(agent) == observed_pursuit(pursuit).observations
    seen["predator_1"][:] = 9  # what one agent is given is its own
    assert vectors.cells(seen["predator_2"][None])[0].tolist() == expected["predator_2"]


# PettingZoo's tests import a game of its own in a way that it deprecates itself.
@pytest.mark.filterwarnings("ignore::DeprecationWarning:pettingzoo")
@pytest.mark.parametrize("predators", [1, 2, 3, 4])
def test_agents_that_see_vectors_pass_pettingzoos_checks(predators):
    pytest.importorskip("pettingzoo")
    from pettingzoo.test import parallel_api_test, parallel_seed_test

    hunt = Pursuit(3, predators)
    parallel_api_test(to_pettingzoo(hunt, observation="vector"))
    parallel_seed_test(lambda: to_pettingzoo(hunt, observation="vector"))


def test_each_agent_reads_the_source_as_if_it_were_alone():
    pytest.importorskip("pettingzoo")
    pursuit, chase = Pursuit(4, 3), Pursuit(4, 1)
    q = random_values(chase)
    task = observed_pursuit(pursuit, acting="first")
    mapping = predator_mapping(task, chase, predator="predator_1", unmapped_value=-7)
    hunt = to_pettingzoo(pursuit, observation="vector")
    for seed in range(20):
        seen, infos = hunt.reset(seed=seed)
        cells = pursuit.states.decode(infos["predator_1"]["state"])
        found = mapping.pairs(TableValues(q), np.stack(list(seen.values())))
        for agent, read in zip(hunt.agents, found, strict=True):
            alone = q[chase.states.encode(prey=cells["prey"], predator=cells[agent])]
            over = cells["prey"] == cells[agent]
            assert np.array_equal(read, np.zeros(5) if over else alone)


def test_an_agent_among_three_reads_one_among_two():
    target, source = Pursuit(3, 3), Pursuit(3, 2)
    task, smaller = (observed_pursuit(each, acting="first") for each in (target, source))
    mapping = predator_mapping(task, smaller, predator_2="predator_3")
    assert mapping.actions.tolist() == [0, 1, 2, 3, 4]
    there = PursuitVectors(source).cells(
        mapping.observations(PursuitVectors(target).of(np.array([[1, 2, 3, 4]])))
    )
    assert there.tolist() == [[1, 2, 4]]


def test_together_predators_may_read_what_one_agent_valued():
    target, source = Pursuit(3, 3), Pursuit(3, 2)
    agent = observed_pursuit(source, acting="first")
    renaming = {"predator_1": "predator_2", "predator_2": "predator_1"}
    mapping = predator_mapping(observed_pursuit(target), agent, **renaming)
    own = target.actions.decode()["predator_2"]
    assert np.array_equal(mapping.actions, own)


def test_an_agent_chooses_no_moves_but_its_own():
    agent = observed_pursuit(Pursuit(3, 2), acting="first")
    with pytest.raises(MappingError, match=r"read from a target component \(predator_1\)"):
        predator_mapping(agent, Pursuit(3, 1), predator="predator_2")
    with pytest.raises(MappingError, match="'predator_2' must be read from a target component"):
        predator_mapping(agent, Pursuit(3, 2))
