"""Theorems about mappings that are found: equal Q* along homomorphisms, images found again."""

import itertools
import pickle
from copy import copy, deepcopy
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

import curricle as cr
from benchmarks.unrelated_pairs import SEARCHED
from curricle import FiniteMDP, project
from curricle.planning import solve
from curricle.transfer import TaskPair, by_homomorphism, find_mappings, identity
from curricle.transfer.bisimulation import (
    equivalent_pairs,
    joint_models,
    model_for_refinement,
    refined,
)
from curricle.transfer.mapping import ENDED, UNMAPPED
from tests.support.enumeration import exact_action_values, exact_optimum
from tests.support.renumbering import renumbered
from tests.support.tasks import DenseMDP, mdps


def blocks_naively(dense):
    """Return the block of each state by the definition, with sets and dictionaries."""
    n_states, n_actions = dense.shape
    reward = (dense.p * dense.r).sum(axis=2)
    block = {s: int(not dense.terminal[s]) for s in range(n_states)}
    while True:
        signature = {}
        for s in range(n_states):
            classes = set()
            for a in range(n_actions if not dense.terminal[s] else 0):
                chance = {}
                for to in range(n_states):
                    chance[block[to]] = chance.get(block[to], 0.0) + dense.p[s, a, to]
                after = tuple(sorted((b, round(c, 7)) for b, c in chance.items() if c > 1e-9))
                classes.add((round(reward[s, a], 7), after))
            signature[s] = (block[s], frozenset(classes))
        numbers = {kind: i for i, kind in enumerate(dict.fromkeys(signature.values()))}
        refined = {s: numbers[signature[s]] for s in signature}
        if len(set(refined.values())) == len(set(block.values())):
            return refined
        block = refined


@given(mdps(max_states=6))
def test_blocks_are_those_of_the_definition(dense):
    (blocks,) = refined([model_for_refinement(dense.task())])
    naive = blocks_naively(dense)
    for s, u in itertools.combinations(range(dense.shape[0]), 2):
        assert (blocks.states[s] == blocks.states[u]) == (naive[s] == naive[u])


@given(mdps(max_states=6), st.integers(0, 2**32 - 1))
def test_a_renumbered_task_is_found_again(dense, seed):
    task = dense.task()
    copy, new, actions = renumbered(task, np.random.default_rng(seed))
    (proposal,) = by_homomorphism(TaskPair(copy, task))
    live, index = ~copy.terminal, proposal.mapping.index
    assert (index[live] >= 0).all()
    (blocks,) = refined([model_for_refinement(task)])
    truth = np.argsort(new)[:, None] * task.actions.size + actions
    # Each pair reads the very pair that it is, or one that nothing tells from it.
    kinds = blocks.pairs.ravel()
    np.testing.assert_array_equal(kinds[index[live]], kinds[truth[live]])


CANCELLING = DenseMDP(  # its mean rewards are 0 but for rounding
    np.array([[[0.2, 0.8]], [[1.0, 0.0]]]),
    np.array([[[-4, 1]], [[0, 1]]]),
    np.array([False, False]),
    0.3,
)


@example(CANCELLING, 0, 2)
@given(mdps(max_states=4), st.integers(0, 2**32 - 1), st.integers(2, 3))
def test_a_task_that_a_homomorphism_maps_to_another_is_mapped_to_it(dense, seed, copies):
    """Every state in several copies, the chance of one shared among its copies at random."""
    rng = np.random.default_rng(seed)
    n_states, n_actions = dense.shape
    shares = rng.dirichlet(np.ones(copies), size=(n_states * copies, n_actions, n_states))
    of = np.repeat(np.arange(n_states), copies)
    p = (dense.p[of][:, :, :, None] * shares).reshape(len(of), n_actions, len(of))
    r = np.repeat(dense.r[of], copies, axis=2)
    terminal = dense.terminal[of]
    large = FiniteMDP.from_dense(
        p, r, terminal=terminal, start=int(np.flatnonzero(~terminal)[0]), discount=dense.discount
    )
    small = dense.task()
    (proposal,) = by_homomorphism(TaskPair(large, small))
    assert (proposal.mapping.index[~terminal] >= 0).all()
    phi = proposal.mapping.read(solve(small).action_values)
    q = solve(large).action_values
    np.testing.assert_allclose(phi[~terminal], q[~terminal], atol=1e-6)


@given(mdps(max_states=5), mdps(max_states=5) | st.none(), st.sampled_from([0.3, 0.9]))
def test_q_is_equal_wherever_two_tasks_are_equivalent(dense, other, discount):
    """A source rewritten at the target's discount keeps its V*: it may be the same at another."""
    other = dense if other is None else replace(other, discount=dense.discount)
    target, source = replace(dense, discount=discount if other is dense else dense.discount), other
    tasks = TaskPair(target.task(), source.task())
    index = equivalent_pairs(*refined(joint_models(tasks)))
    mapped = index >= 0
    q = solve(tasks.source).action_values.ravel()[index[mapped]]
    np.testing.assert_allclose(solve(tasks.target).action_values[mapped], q, atol=1e-5)


@given(mdps(max_states=4), st.integers(0, 2**32 - 1))
def test_the_copy_comes_first_and_regains_everything(dense, seed):
    task = dense.task()
    copy, _, _ = renumbered(task, np.random.default_rng(seed))
    best = find_mappings(copy, task)[0]
    assert best.scores.regained > 1 - 1e-6 or np.isnan(best.scores.regained)
    assert best.scores.optimistic == 0


def any_mdp(rng):
    """Return a small MDP: rewards of 1e-9 to 1e9, ties, any discount up to 1, rare ends."""
    n, n_actions = int(rng.integers(2, 5)), int(rng.integers(1, 3))
    p = rng.integers(0, 3, (n, n_actions, n)) * rng.choice([1.0, 1e-3], (n, n_actions, n))
    p[np.arange(n)[:, None], np.arange(n_actions), rng.integers(0, n, (n, n_actions))] += 1
    reward = rng.integers(-3, 4, p.shape) * rng.choice(10.0 ** np.arange(-9, 10, 3), (n, 1, 1))
    if rng.random() < 0.3:  # rewards that differ by less than refinement tells apart
        reward = rng.choice([1.0, 1.0 + 5e-10], p.shape) * rng.choice([1e-6, 1.0, 1e6])
    terminal = rng.random(n) < 0.3
    terminal[0], terminal[-1] = False, True
    p[:, :, -1] += 0.01
    return FiniteMDP.from_dense(
        p / p.sum(axis=2, keepdims=True),
        reward,
        terminal=terminal,
        start=0,
        discount=float(rng.choice([0.3, 0.9, 0.999, 1.0])),
    )


def exact_differences(target, source):
    """Return abs(Q*(s, a) - Q*(u, b)) of all pairs, (S A, S' A' + 1), the last of the end, to 0."""
    action_values = []
    for task in (target, source):
        q = exact_action_values(task, exact_optimum(task))
        action_values.append([q.get(p, Fraction(0)) for p in np.ndindex(*task.outcome_row.shape)])
    action_values[1].append(Fraction(0))
    return abs(np.subtract.outer(*map(np.array, action_values)))


@pytest.mark.parametrize("pairs", [60, pytest.param(500, marks=pytest.mark.slow)])
def test_no_bound_is_exceeded_by_the_exact_values_of_two_tasks(pairs):
    """Every bound that is stated of a mapping, in random tasks with any discounts."""
    stated = 0
    for seed in range(pairs):
        rng = np.random.default_rng(seed)
        target = any_mdp(rng)
        if rng.random() < 0.4:  # the same task, renumbered, at another discount or nearly the same
            source = renumbered(target, rng)[0]
            reward = source.reward * rng.choice([1.0, 1 + 3e-10, 1.1])
            discount = float(rng.choice([target.discount, 0.5, 0.99]))
            source = replace(source, reward=reward, discount=discount)
        else:
            source = any_mdp(rng)
        apart = exact_differences(target, source)
        live = np.repeat(~target.terminal, target.actions.size)
        rows = np.arange(live.size)
        for candidate in find_mappings(target, source, searches=SEARCHED, keep=100):
            index = candidate.mapping.index.ravel()
            mapped = live & (index != UNMAPPED)
            true = apart[rows, np.where(index == ENDED, -1, index)][mapped].max(initial=Fraction(0))
            assert np.isnan(candidate.bound) == (not mapped.any())
            if mapped.any():
                assert true <= Fraction(candidate.bound), (seed, candidate.how)
            stated += mapped.any()
    assert stated > 2 * pairs


def test_a_homomorphism_maps_no_pairs_whose_values_differ():
    """Refinement takes rewards that agree to 1e-9 of the largest as equal: Q* are .9 apart here."""

    def loop(cost):
        outcomes = [[[(1.0, 0, -cost)]], [[(1.0, 2, 1e6)]], [[]]]
        return FiniteMDP.from_outcomes(
            outcomes, terminal=[False, False, True], start=[0.5, 0.5, 0], discount=0.999
        )

    tasks = TaskPair(loop(0.0), loop(0.0009))
    (proposal,) = by_homomorphism(tasks)
    assert proposal.mapping.index[:2].tolist() == [[UNMAPPED], [1]]
    assert tasks.bound(proposal.mapping.index) < 1e-3
    assert 0.9 <= tasks.bound(np.array([[0], [1], [UNMAPPED]])) < 0.901


OPERATIONS = {
    "another value": lambda mapping: mapping.with_unmapped_value(-2.0),
    "a copy": copy,
    "a deep copy": deepcopy,
    "pickled": lambda mapping: pickle.loads(pickle.dumps(mapping)),
    "in a transfer": lambda mapping: (
        cr.Curriculum(
            {"a": mapping.source, "b": mapping.target},
            [cr.Transfer("a", "b", mapping, scale=2.0, shift=-1.0)],
            budget=10,
        )
        .replace("b", budget=20)
        .transfers[0]
        .mapping
    ),
}


@given(mdps(), st.lists(st.sampled_from(sorted(OPERATIONS)), max_size=4), st.booleans())
def test_what_a_mapping_knows_survives_whatever_is_done_with_it(dense, operations, knows):
    task = dense.task()
    by_name, by_index = project(task, task), identity(task)
    for mapping in (by_name, by_index, replace(by_index, how="found")):
        mapping = mapping.knowing_target() if knows else mapping
        assert all(operation(mapping).knows_target is knows for operation in OPERATIONS.values())
        for operation in operations:
            mapping = OPERATIONS[operation](mapping)
            assert mapping.knows_target is knows
