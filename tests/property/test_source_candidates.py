"""Candidates: mappings fit, all can be learnt, none is another; kinds against naive oracles."""

from collections import defaultdict
from itertools import combinations

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from curricle import evaluate, solve
from curricle.candidates import source_candidates
from curricle.candidates.kinds import coarser_tables, design_target, likeliest_outcomes, spread
from curricle.errors import CurriculumError, TaskError
from curricle.planning import visit_distribution
from curricle.tasks import frozen_lake_family, maze_family, random_maze
from curricle.tasks.graph import reachable_states
from curricle.tasks.mdp import same_task
from curricle.transfer.bisimulation import model_for_refinement, refined
from tests.support.tasks import mdps

MAZES = st.builds(
    maze_family,
    size=st.integers(3, 6),
    pits=st.sampled_from([0.0, 0.2]),
    fires=st.sampled_from([0.0, 0.1]),
    seed=st.integers(0, 2**32 - 1),
)
LAKES = st.builds(
    frozen_lake_family,
    map=st.just("random"),
    size=st.integers(3, 5),
    seed=st.integers(0, 2**32 - 1),
    slippery=st.booleans(),
)


def all_of(target):
    """Return the candidates of a target; reject the example if it has none."""
    try:
        return source_candidates(target, most=30)
    except CurriculumError:
        assume(False)


@settings(max_examples=15)
@given(MAZES | LAKES)
def test_each_mapping_fits_and_each_candidate_can_be_learnt(target):
    for candidate in all_of(target):
        for mapping in candidate.mappings:
            assert same_task(mapping.target, target.task)
            assert mapping.source is candidate.task
            assert mapping.index.shape == (target.task.states.size, target.task.actions.size)
        mdp = candidate.task.mdp
        random = np.full(mdp.outcome_row.shape, 1 / mdp.outcome_row.shape[1])
        best = solve(mdp)
        assert best.start_value > evaluate(mdp, random).start_value
        # The best policy ends where something can be had: it visits a state before an end.
        before = visit_distribution(mdp, best.policy) > 0
        row = mdp.outcome_row[before & ~mdp.terminal].ravel()
        after = mdp.next_state[row][mdp.probability[row] > 0]
        assert mdp.terminal[after].any()


@settings(max_examples=15)
@given(MAZES | LAKES)
def test_no_two_candidates_are_one_task(target):
    candidates = all_of(target)
    tasks = [
        ("the target", target.task.mdp),
        *((candidate.name, candidate.task.mdp) for candidate in candidates),
    ]
    for (name, task), (other_name, other) in combinations(tasks, 2):
        if (task.discount, task.time_limit) != (other.discount, other.time_limit):
            continue
        # By refinement alone, without the fingerprints by which most are told apart.
        blocks, others = refined([model_for_refinement(task), model_for_refinement(other)])
        n = 1 + max(blocks.states.max(), others.states.max())
        starts = (
            np.bincount(blocks.states, task.start, n),
            np.bincount(others.states, other.start, n),
        )
        assert not np.allclose(*starts), (name, other_name)


@settings(max_examples=15)
@given(MAZES)
def test_most_cuts_the_same_list(target):
    candidates = all_of(target)
    for most in (1, 3):
        few = source_candidates(target, most=most)
        assert [candidate.name for candidate in few] == [
            candidate.name for candidate in candidates
        ][:most]


@given(st.integers(0, 60))
def test_spread_keeps_every_item(n):
    assert sorted(spread(range(n))) == list(range(n))


@given(mdps(max_states=6))
def test_the_likeliest_outcome_is_the_likeliest(dense):
    target = design_target(dense.task())
    drafts = list(likeliest_outcomes(target))
    if not drafts:
        live = ~dense.terminal
        assert (dense.p[live].max(axis=2) == 1).all()
        return
    met = reachable_states(target.mdp) & ~dense.terminal
    ordered = np.sort(dense.p[met], axis=2)
    tie = np.isclose(ordered[..., -1], ordered[..., -2]).any()
    if tie:
        with pytest.raises(TaskError, match="a likeliest outcome must be the only one"):
            drafts[0].build()
        return
    source, _ = drafts[0].build()
    for state in np.flatnonzero(met):
        for action, row in enumerate(source.outcome_row[state]):
            (after,) = source.next_state[row]
            assert after == dense.p[state, action].argmax()
            assert source.reward[row, 0] == pytest.approx(dense.r[state, action, after])


@settings(max_examples=15)
@given(st.integers(0, 10_000), st.integers(4, 7))
def test_a_coarser_table_is_the_mean_of_what_it_merges(seed, size):
    maze = random_maze(size=size, pits=0.2, seed=seed)
    mdp, target = maze.mdp, design_target(maze)
    source, mapping = next(iter(coarser_tables(target))).build()
    n_actions = mdp.outcome_row.shape[1]
    clusters = defaultdict(list)
    for state in range(len(mdp.terminal)):
        values = mdp.states.decode(state)
        low = [component.low for component in mdp.states.components]
        key = tuple((int(v) - b) // 2 for v, b in zip(values.values(), low, strict=True))
        clusters[key, bool(mdp.terminal[state])].append(state)
    assert source.states.size == len(clusters)
    for (_, ended), members in clusters.items():
        if ended:
            continue
        (cluster,) = {int(mapping.index[state, 0]) // n_actions for state in members}
        assert source.start[cluster] == pytest.approx(mdp.start[members].sum())
        for action in range(n_actions):
            row, rows = source.outcome_row[cluster, action], mdp.outcome_row[members, action]
            mean = (mdp.probability[rows] * mdp.reward[rows]).sum(axis=1).mean()
            assert (source.probability[row] * source.reward[row]).sum() == pytest.approx(mean)
            ends = (mdp.probability[rows] * mdp.terminal[mdp.next_state[rows]]).sum(axis=1).mean()
            after = source.terminal[source.next_state[row]]
            assert (source.probability[row] * after).sum() == pytest.approx(ends)
