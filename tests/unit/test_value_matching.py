"""Components without names: found by how their values move."""

import numpy as np
import pytest

import curricle as cr
from curricle.errors import MappingError
from curricle.transfer import TaskPair, by_component_values, score_mapping
from curricle.transfer.value_matching import injections
from tests.renumbering import nameless, nameless_hunt, renumbered


@pytest.mark.parametrize("seed", range(3))
def test_both_predators_are_found_without_names(seed):
    target, source, truth = nameless_hunt(3, seed)
    found = [one.mapping.index for one in by_component_values(TaskPair(target, source))]
    assert len(found) == 2
    names = {name for index in found for (name, _), f in truth.items() if np.array_equal(f, index)}
    assert names == {"predator_1", "predator_2"}


def test_a_component_that_another_move_steers_is_no_prey():
    """A predator whose moves are not read moves like the prey only on average."""
    hunt, chase = cr.Pursuit(3, 2), cr.Pursuit(3, 1)
    found = list(by_component_values(TaskPair(hunt, chase)))
    assert [one.how for one in found] == [
        f"values of components: prey is prey, predator is {name}; actions: predator is {name}"
        for name in hunt.predator_names
    ]
    assert all(np.isnan(one.bound) for one in found)  # rewards need both predators


def test_a_room_with_keys_and_locks_is_found_without_names():
    room = cr.tasks.KeyLockPit()
    rng = np.random.default_rng(1)
    (target, _, _), (source, _, _) = nameless(room.mdp, rng), nameless(room.mdp, rng)
    tasks = TaskPair(target, source)
    one = next(iter(by_component_values(tasks)))
    scores = score_mapping(one.mapping, tasks=tasks)
    assert scores.regained == pytest.approx(1)
    assert scores.dynamics_error == 0
    assert one.bound < 1e-6


def test_refusals():
    maze = cr.GridWorld("S..T").mdp
    lone = renumbered(maze, np.random.default_rng(0))[0]
    with pytest.raises(MappingError, match="the source's states have only one"):
        list(by_component_values(TaskPair(lone, lone)))
    with pytest.raises(MappingError, match="no assignment of components makes"):
        list(by_component_values(TaskPair(cr.Pursuit(3, 1), cr.Pursuit(2, 1))))
    torus = cr.Pursuit(3, 1, torus=True)
    with pytest.raises(MappingError, match="no assignment of components makes"):
        list(by_component_values(TaskPair(cr.Pursuit(3, 1), torus)))


def test_injections_are_of_equal_size():
    assert list(injections((2, 2), (2, 3, 2))) == [(0, 2), (2, 0)]
    assert list(injections((5,), (2, 3))) == []
