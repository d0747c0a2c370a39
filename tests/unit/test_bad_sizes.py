"""Sizes and types that no task has are refused before anything of their size is made."""

import numpy as np
import pytest

import curricle as cr
from curricle import Component, Pursuit, Space
from curricle.errors import CurricleError, TaskError
from tests.refusals import check_refusal

HUGE = Space([Component(f"c{i}", 10) for i in range(30)])
WIDE = Pursuit(size=10, predators=6)
ORIGIN = dict.fromkeys(HUGE.names, 0)
REFUSED = [
    (lambda: Pursuit(predators=2_000_000), r"predators must lie in \[1, 100\]"),
    (lambda: Pursuit(10**9), r"size must lie in \[2, 1000\]"),
    (lambda: Pursuit(size=1e308), "size must be a whole number below 2.63"),
    (lambda: Pursuit(torus="yes"), "torus must be a bool: got 'yes'"),
    (lambda: Pursuit(torus=1), "torus must be a bool: got 1"),
    (lambda: Pursuit(capture=True), "got True"),
    (lambda: Pursuit(capture=[1]), r"got \[1\]"),
    (lambda: Component(None, 2), "name of a component must be text, not empty"),
    (lambda: Component("a", 2, low=2**63), "lowest value of component 'a' must be"),
    (lambda: Component("a", 2, low=2**63 - 1), "highest value of component 'a' must be"),
    (lambda: Component("a", 2, labels=(1, 2)), "label .* must be text"),
    (lambda: Component("a", 2, labels="ab"), "must be a list of text: got 'ab'"),
    (lambda: Space(["a"]), "components must be a list of Component"),
    (lambda: Space([Component("a", 2)], np.zeros((0, 1), int)), "S at least 1"),
    (lambda: HUGE.encode(**ORIGIN), r"fewer than 2\^63: this one has 2\^100"),
    (lambda: HUGE.decode(3), r"fewer than 2\^63"),
    (lambda: len(HUGE), r"fewer than 2\^63"),
    (WIDE.states.decode, "all points of a space must fit half of the machine's"),
    (lambda: WIDE.terminal, "a flag for each state of a pursuit must fit half"),
    (lambda: cr.GridWorld("S.T", ends=5), "ends must be names of objects: got 5"),
    (
        lambda: cr.FiniteMDP.from_dense(
            np.zeros((0, 2, 0)), [], terminal=[], start=0, discount=0.9
        ),
        r"shape \(S, A, S\)",
    ),
    (
        lambda: cr.FiniteMDP.from_dense(
            [[[0.0, 1.0]], [[0.0, 1.0]]], [1, 0], terminal=[0.5, 1], start=0, discount=0.9
        ),
        "terminal must be flags",
    ),
]


@pytest.mark.parametrize(("call", "says"), REFUSED)
def test_what_no_task_has_is_refused_at_once(call, says):
    check_refusal(TaskError, call, says)


@pytest.mark.parametrize("episodes", [10**30, 10**18, 1_000_001])
def test_evaluations_that_would_never_end_are_refused(episodes):
    with pytest.raises(CurricleError, match="episodes of an evaluation"):
        cr.GreedyEvaluation("rollouts", episodes=episodes)


def test_snapshots_beyond_64_bits_are_refused():
    with pytest.raises(CurricleError, match="snapshots must be a whole number below"):
        cr.learn(cr.GridWorld("S.T"), budget=100, snapshots=10**40)


def test_values_at_the_edge_of_64_bits_are_numbered_without_overflow():
    edge = Space([Component("a", 3, low=1 - 2**63), Component("b", 2, low=2**63 - 2)])
    low, high = 1 - 2**63, 2**63 - 1
    assert edge.encode(a=[low, low + 2, low + 3, high], b=[high, high, high, low]).tolist() == [
        1, 5, -1, -1
    ]  # fmt: skip
    assert [int(values[0]) for values in edge.decode([5]).values()] == [low + 2, high]
    with pytest.raises(TaskError, match=r"component 'a' must be below 2\^63"):
        edge.encode(a=np.array([2**63], np.uint64), b=0)


def test_a_lookup_of_another_task_is_refused():
    """Loops would read outside of the sources' values."""
    hunt, chase = Pursuit(3, 2), Pursuit(3, 1)
    edge = cr.Transfer("chase", "hunt", cr.project(hunt, chase, predator="predator_1"))
    trained = cr.Curriculum({"chase": chase, "hunt": hunt}, [edge], budget=50).train()
    lookup = trained.potentials["hunt"][0].lookup
    assert cr.learning.MappedPotential(hunt, lookup).values.shape == (729, 25)
    for task, given in (
        (Pursuit(4, 2), lookup),
        (hunt, lookup._replace(first=lookup.first + 10**6)),
        (hunt, lookup._replace(strides=lookup.strides * 10**6)),
        (hunt, lookup._replace(strides_at=lookup.strides_at - 1)),
        (hunt, lookup._replace(action=lookup.action + 10**6)),
        (hunt, None),
    ):
        with pytest.raises(cr.errors.PotentialError, match="lookup must be one for its task"):
            cr.learning.MappedPotential(task, given)


@pytest.mark.parametrize("state", [-1, 6, 0.5, None, "x", [[1], [1, 2]], 2**64])
def test_states_that_are_none_of_a_task_are_refused_by_its_potentials(state):
    phi = cr.StateActionPotential(cr.GridWorld("S.T"), np.ones((3, 4)))
    with pytest.raises(cr.errors.PotentialError, match="states must be whole numbers"):
        phi.to_state().shaping_reward(state, 0)
