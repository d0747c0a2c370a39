"""Theorems about mappings that are found: equal Q* along homomorphisms, images found again."""

import itertools

import numpy as np
from hypothesis import given, strategies as st

from curricle import FiniteMDP
from curricle.planning import solve
from curricle.tasks.mdp import reachable_states
from curricle.transfer import (
    TaskPair,
    by_homomorphism,
    by_lax_bisimulation,
    find_mappings,
    lax_bisimulation,
)
from curricle.transfer.bisimulation import equivalent_pairs
from curricle.transfer.partition_refinement import model_for_refinement, refined
from tests.renumbering import renumbered
from tests.tasks import mdps


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
        numbers = {one: i for i, one in enumerate(dict.fromkeys(signature.values()))}
        refined = {s: numbers[signature[s]] for s in signature}
        if len(set(refined.values())) == len(set(block.values())):
            return refined
        block = refined


@given(mdps(max_states=6))
def test_blocks_are_those_of_the_definition(dense):
    (found,) = refined([model_for_refinement(dense.task())])
    naive = blocks_naively(dense)
    for s, u in itertools.combinations(range(dense.shape[0]), 2):
        assert (found.states[s] == found.states[u]) == (naive[s] == naive[u])


@given(mdps(max_states=6), st.integers(0, 2**32 - 1))
def test_a_renumbered_task_is_found_again(dense, seed):
    task = dense.task()
    copy, new, actions = renumbered(task, np.random.default_rng(seed))
    (proposal,) = by_homomorphism(TaskPair(copy, task))
    live, index = ~copy.terminal, proposal.mapping.index
    assert (index[live] >= 0).all()
    (own,) = refined([model_for_refinement(task)])
    truth = np.argsort(new)[:, None] * task.actions.size + actions
    # Each pair reads the very pair that it is, or one that nothing tells from it.
    np.testing.assert_array_equal(own.pairs.ravel()[index[live]], own.pairs.ravel()[truth[live]])


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


@given(mdps(max_states=5), mdps(max_states=5))
def test_q_is_equal_wherever_two_tasks_are_equivalent(one, other):
    other = type(other)(other.p, other.r, other.terminal, one.discount)
    target, source = one.task(), other.task()
    tasks = TaskPair(target, source)
    index = equivalent_pairs(*refined(tasks.models))
    mapped = index >= 0
    q = solve(source).action_values.ravel()[index[mapped]]
    np.testing.assert_allclose(solve(target).action_values[mapped], q, atol=1e-6)


@given(mdps(max_states=4), st.sampled_from([0.3, 0.9]), st.integers(0, 2**32 - 1))
def test_q_is_equal_along_equivalence_at_another_discount(dense, discount, seed):
    """A source rewritten at the target's discount keeps its V*, so the same theorem holds."""
    source = dense.task()
    other = type(dense)(dense.p, dense.r, dense.terminal, discount).task()
    tasks = TaskPair(renumbered(other, np.random.default_rng(seed))[0], source)
    index = equivalent_pairs(*refined(tasks.models))
    mapped = index >= 0
    q = solve(source).action_values.ravel()[index[mapped]]
    np.testing.assert_allclose(solve(tasks.target).action_values[mapped], q, atol=1e-5)


@given(mdps(max_states=4), st.integers(0, 2**32 - 1))
def test_the_copy_comes_first_and_regains_everything(dense, seed):
    task = dense.task()
    copy, _, _ = renumbered(task, np.random.default_rng(seed))
    best = find_mappings(copy, task)[0]
    assert best.scores.regained > 1 - 1e-6 or np.isnan(best.scores.regained)
    assert best.scores.optimistic == 0


@given(mdps(max_states=5), mdps(max_states=5))
def test_lax_bisimulation_bounds_the_difference_of_values(one, other):
    """Also at discounts that differ."""
    target, source = one.task(), other.task()
    found = lax_bisimulation(target, source)
    here, there = solve(target), solve(source)
    slack = 1e-9 * (1 + abs(there.values).max())
    apart = abs(here.values[:, None] - there.values)
    assert (apart <= found.states + slack).all()
    phi = np.where(
        found.nearest >= 0, there.action_values.ravel()[np.maximum(found.nearest, 0)], 0.0
    )
    assert (abs(here.action_values - phi) <= found.pairs + slack)[~target.terminal].all()
    for proposal in by_lax_bisimulation(TaskPair(target, source)):
        read = proposal.mapping.read(there.action_values)[reachable_states(target)]
        off = abs(here.action_values[reachable_states(target)] - read)
        assert off.max() <= proposal.bound + slack


@given(mdps(max_states=5), st.integers(0, 2**32 - 1))
def test_lax_bisimulation_of_a_renumbered_task_is_zero_where_it_is_the_same(dense, seed):
    task = dense.task()
    copy, new, _ = renumbered(task, np.random.default_rng(seed))
    found = lax_bisimulation(copy, task)
    largest = 1 + abs(found.states).max()
    assert found.states[new, np.arange(len(new))].max() <= 2e-3 * largest
    assert found.pairs.max() <= 2e-3 * largest
