"""The search for mappings: what is found, in which order, with which scores, what is refused."""

import numpy as np
import pytest

import curricle as cr
from curricle.errors import MappingError, SettingError, TaskError
from curricle.transfer import (
    Proposal,
    StateActionMapping,
    TaskPair,
    by_homomorphism,
    find_mappings,
    find_projections,
    identity,
    score_mapping,
)
from curricle.transfer.bisimulation import levels, model_for_refinement, refined
from curricle.transfer.observation_mapping import ObservationCoverage
from curricle.transfer.pair import search_steps
from curricle.transfer.scores import total_variation
from curricle.transfer.transfer import mappings_digest, numbered
from tests.refusals import check_refusal
from tests.tasks import ring

MAZE = cr.GridWorld(["S..P", ".F..", "...T"], time_limit=50)


def test_the_scores_of_a_task_and_itself():
    scores = score_mapping(identity(MAZE))
    assert scores.dynamics_error == 0
    assert scores.bellman_inconsistency < 1e-9
    assert scores.coverage == 1
    assert scores.optimistic == 0
    assert scores.regained == pytest.approx(1)
    assert scores.start_value == pytest.approx(cr.solve(MAZE).start_value)


def test_scores_by_hand():
    """Two steps to the end at -1; the source takes the first for the last."""
    line = cr.FiniteMDP.from_outcomes(
        [[[(1.0, 1, -1.0)]], [[(1.0, 2, -1.0)]], [[]]],
        terminal=[False, False, True], start=0, discount=0.5,
    )  # fmt: skip
    mapping = cr.transfer.StateActionMapping(line, line, np.array([[1], [0], [0]]))
    scores = score_mapping(mapping)  # phi = -1, -1.5 where Q* = -1.5, -1
    # T phi = -1 - 0.75, -1: differences of 0.75 and 0.5; a constant in the middle misses 0.375.
    assert scores.bellman_inconsistency == pytest.approx(0.625)
    assert scores.unexplained == pytest.approx(0.625 / 0.375)
    assert scores.optimistic == 0.5
    # From state 0 the source (in its state 1) ends, but the target goes to what stands for 0;
    # from state 1 it is the other way round.
    assert scores.dynamics_error == 1
    assert np.isnan(scores.regained)  # there is one policy


def test_a_pair_without_a_counterpart_is_not_judged():
    crop = MAZE.crop(rows=(1, 3), columns=(2, 4))
    scores = score_mapping(cr.same_position(MAZE, crop))
    live = ~MAZE.mdp.terminal
    mapped = cr.same_position(MAZE, crop).index[live] != cr.transfer.UNMAPPED
    assert scores.coverage == pytest.approx(mapped.mean())
    nothing = cr.transfer.StateActionMapping(MAZE, crop, np.full((12, 4), cr.transfer.UNMAPPED))
    scores = score_mapping(nothing)
    assert scores.coverage == 0
    assert np.isnan([scores.dynamics_error, scores.bellman_inconsistency, scores.optimistic]).all()
    assert scores.regained == pytest.approx(0)


def test_the_projections_of_two_predators_onto_one_are_those_of_the_paper():
    """Only f_1 and f_2 predict the target without error."""
    hunt, chase = cr.Pursuit(3, 2), cr.Pursuit(3, 1)
    projections = find_projections(hunt, chase)
    for projection, name in zip(projections[:2], hunt.predator_names, strict=True):
        by_hand = cr.project(hunt, chase, predator=name)
        np.testing.assert_array_equal(projection.mapping.index, by_hand.index)
        assert projection.error < 1e-9
    assert not any(projection.error < 0.1 for projection in projections[2:])  # NaN: no pair maps


def test_a_mirrored_maze_is_found_without_names():
    mirrored = cr.GridWorld([row[::-1] for row in MAZE.map], time_limit=50)
    best = find_mappings(MAZE, mirrored)[0]
    assert best.how.startswith("exact homomorphism: 100%")
    assert best.bound < 1e-6
    state, action = np.divmod(best.mapping.index[MAZE.state(1, 3)], 4)
    assert set(state) == {mirrored.state(1, 0)}
    assert action.tolist() == [0, 3, 2, 1]  # east for west


def test_what_reads_the_values_alike_is_one_candidate():
    found = find_mappings(MAZE, MAZE)
    assert [one.how for one in found].count("components by name") == 1
    assert not any("homomorphism" in one.how for one in found)


def test_names_with_unmapped_values():
    crop = MAZE.crop(rows=(1, 3), columns=(2, 4))
    for one in find_mappings(MAZE, crop, unmapped_value=-3.0):
        assert one.mapping.unmapped_value == -3
        assert one.scores.coverage == 1


def test_a_search_of_ones_own():
    def upside_down(tasks):
        index = identity(tasks.target).index[::-1]
        yield Proposal(cr.transfer.StateActionMapping(tasks.target, tasks.source, index), "mine")

    task = ring_of_four()
    (one,) = find_mappings(task, task, searches=[upside_down])
    assert one.how == "mine"


def ring_of_four():
    """Four places in a ring, each of which pays something else."""
    return cr.FiniteMDP.from_outcomes(
        [[[(1.0, (s + way) % 4, float(s))] for way in (1, 3)] for s in range(4)],
        terminal=[False] * 4, start=0, discount=0.9,
    )  # fmt: skip


def test_other_symmetries_do_not_count_as_errors():
    """Behind a homomorphism stand images of states; the dynamics agree up to symmetry."""
    room = cr.GridWorld(["...", ".T.", "S.."])
    mapping = next(iter(by_homomorphism(TaskPair(room, room)))).mapping
    assert len(set((mapping.index // 4).ravel().tolist())) < 8
    assert score_mapping(mapping).dynamics_error == 0


def test_refusals():
    for setting, value in {"keep": 0, "searches": (), "seed": -1, "samples": 0}.items():
        with pytest.raises(SettingError, match=f"^.*{setting[:6]}.*: got (0|-1|none)$"):
            find_mappings(MAZE, MAZE, **{setting: value})
    with pytest.raises(TaskError, match=r"the target has no tables, which .*samples=.* estimates"):
        find_mappings(ring(), MAZE)
    with pytest.raises(MappingError, match="unmapped_value must be"):
        find_mappings(MAZE, MAZE, unmapped_value=float("nan"))
    with pytest.raises(MappingError, match="no pair of the target is equivalent"):
        list(by_homomorphism(TaskPair(cr.Pursuit(2, 2), cr.Pursuit(3, 1))))


@pytest.mark.parametrize(
    ("searches", "says"),
    [
        (by_homomorphism, "searches must be a list of functions: got <function by_homomorphism"),
        ([by_homomorphism, "by_name"], r"must be a list of functions: got \["),
        ([lambda tasks: [cr.same_position(MAZE, MAZE)]], "must yield a Proposal: <lambda> yielded"),
        (
            [lambda tasks: [Proposal(identity(cr.GridWorld("S.T")), "another's")]],
            "mappings of the tasks that it is given: <lambda> proposed the target GridWorld",
        ),
    ],
)
def test_searches_that_are_none_are_refused(searches, says):
    check_refusal(SettingError, lambda: find_mappings(MAZE, MAZE, searches=searches), says)


def test_at_discount_1_the_time_limit_is_the_horizon():
    task = cr.GridWorld(["S..T"], discount=1.0, time_limit=20)
    assert TaskPair(task, task).target_mdp.discount == 0.95
    assert find_mappings(task, task)[0].scores.regained == pytest.approx(1)


def test_states_that_behave_alike_are_one_block():
    room = model_for_refinement(cr.GridWorld(["...", ".T.", "S.."]).mdp)
    blocks = refined([room])[0].states.reshape(3, 3)  # corners, sides, and the end
    np.testing.assert_array_equal(blocks, [[2, 1, 2], [1, 0, 1], [2, 1, 2]])
    assert levels(np.array([0.1 + 0.2, 0.3, 5.0])).tolist() == [0, 0, 1]


def test_equal_outcomes_count_once_in_a_distance():
    rows = [[1, 2]], [[0.5, 0.5]], [[2]], [[1.0]]
    assert total_variation(*map(np.array, rows)).tolist() == [0.5]


def test_a_search_of_two_tasks_is_charged_once():
    line = cr.GridWorld("ST")
    index = [[0, 1, 2, 3], [-2, -2, -2, -2]]
    edge = cr.Transfer(
        "a", "b", StateActionMapping(line, line, index, how="nearest pair", steps=50)
    )
    assert search_steps([edge] * 2) == 50
    assert edge.mapping.words == "found: nearest pair"


def test_mappings_in_words_and_digests():
    chase = cr.project(cr.Pursuit(3, 2), cr.Pursuit(3, 1), predator="predator_2")
    words = chase.words
    assert words == "predator is predator_2, prey by name"
    assert numbered(["a", "b", "a"]) == ["a [1]", "b", "a [2]"]
    line = cr.GridWorld("S.T")
    mappings = identity(line), cr.same_position(line, line)
    one, other = (mappings_digest([cr.Transfer("a", "b", mapping)]) for mapping in mappings)
    assert one == other
    covered = str(ObservationCoverage(200, 0.75, 0.0, 0.25, 0.5))
    assert covered.startswith("75.0% of the pairs of 200 observations mapped, 0.0% at the source's")
    assert covered.endswith("25.0% unmapped; 50.0% of the counterparts outside the source's space")
