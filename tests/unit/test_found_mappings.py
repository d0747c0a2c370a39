"""Mappings that searches find: in which order, with which scores, and what each search refuses."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

import curricle as cr
from curricle import Transfer
from curricle.errors import CurriculumError, MappingError, SettingError, TaskError
from curricle.transfer import (
    UNMAPPED,
    Proposal,
    StateActionMapping,
    TaskPair,
    auto_mapping,
    by_alignment,
    by_homomorphism,
    by_name,
    find_mappings,
    fitted_unmapped_value,
    identity,
    score_mapping,
)
from curricle.transfer.bisimulation import levels, model_for_refinement, refined
from curricle.transfer.by_components import at_goal
from curricle.transfer.search import EXPECTILE, fitted_constant, mapping_fault
from curricle.transfer.transfer import transfer_words
from tests.support.refusals import check_refusal
from tests.support.studies import CORNER, again, only
from tests.support.tasks import mdps, ring


@pytest.mark.parametrize("unit", [1.0, 1e-9])
def test_scores_do_not_depend_on_the_unit_of_rewards(unit):
    outcomes = [[[(1.0, (s + 1) % 4, unit * (s == 0))], [(1.0, s - 1, 0.0)]] for s in range(1, 4)]
    outcomes = [[[(1.0, 1, unit)], [(1.0, 3, 0.0)]], *outcomes]
    ends = [False] * 4
    task = cr.FiniteMDP.from_outcomes(outcomes, terminal=ends, start=0, discount=0.9, time_limit=20)
    index = np.arange(8).reshape(4, 2)[[1, 0, 2, 3]]
    scores = score_mapping(StateActionMapping(task, task, index))
    assert scores.dynamics_error == pytest.approx(0.625)
    assert scores.regained == pytest.approx(-10 / 9)
    assert scores.bellman_inconsistency == pytest.approx(0.593 * unit, rel=1e-2)
    small = cr.Rewards(step=0, treasure=1e-8 * unit)
    found = find_mappings(*(cr.GridWorld(m, rewards=small) for m in ("S...T", "T...S")))
    assert found[0].how.startswith("exact homomorphism")


def test_ranges_are_aligned_at_either_end_or_at_the_goal():
    target, source = cr.GridWorld(["S...T", "....."]), cr.GridWorld(["S.T", "..."])
    columns = {
        end: cr.project(target, source, aligned={"column": end}).index[:5, 0] // 4
        for end in ("first", "last", -1)
    }
    assert columns["first"].tolist()[:2] == [0, 1]
    assert columns["last"].tolist()[2:4] == columns[-1].tolist()[1:3] == [0, 1]
    clipped = cr.project(target, source, aligned={"column": "last"}, unequal="clip")
    assert (clipped.index[:5, 0] // 4).tolist()[:4] == [0, 0, 0, 1]
    assert clipped.description == "row and column and move by name, last column aligned; " + (
        "other values clipped"
    )
    searches = by_name, by_alignment, at_goal
    inside = cr.GridWorld(["S..T..", "......"])
    assert "column - 1 aligned" in find_mappings(inside, source, searches=searches)[0].how
    with pytest.raises(MappingError, match="aligned must be first, last or a whole number"):
        cr.project(target, source, aligned={"column": 0.5})


def test_a_mapping_far_below_the_best_that_is_found_is_at_fault():
    target, source = cr.GridWorld("S........T"), cr.GridWorld("S..T")
    sentence = mapping_fault(Transfer("short", "long", cr.project(target, source)))
    assert "the mapping of short -> long is at fault: it regains 11 %" in sentence
    assert "the best that is found 100 %, components by name, last column aligned" in sentence
    assert sentence.endswith('mapping = "auto" uses it')
    aligned = cr.project(target, source, aligned={"column": "last"}, unequal="clip")
    assert mapping_fault(Transfer("short", "long", aligned)) == ""


@pytest.mark.parametrize("more", [0, 6])
def test_actions_that_are_not_available_change_no_score(more):
    def pairs(s):
        on = [(1.0, s + 1, 10.0 if s == 3 else -1.0)]
        return [[(1.0, max(0, s - 1), -1.0)], on, *[[]] * more]

    outcomes, ends = [*map(pairs, range(4)), [[]] * (2 + more)], [False] * 4 + [True]
    task = cr.FiniteMDP.from_outcomes(outcomes, terminal=ends, start=0, discount=0.9)
    index = np.array(identity(task).index)
    index[:4, 0] = 0
    scores = score_mapping(StateActionMapping(task, task, index))
    assert (scores.dynamics_error, scores.unexplained) == pytest.approx((0.25, 0.3025), abs=1e-3)


@pytest.mark.parametrize("reward", [1.0, 1e12])
def test_a_reward_that_no_episode_meets_changes_no_score(reward):
    hub = [[[(1.0, 0, 0.0)], [(1.0, 1, 0.0)]], [[(1.0, 0, 0.0)], [(1.0, 2, 10.0)]], [[], []]]
    outcomes = [*hub, [[(1.0, 2, reward)], [(1.0, 2, 0.0)]]]
    ends = [False, False, True, False]
    task = cr.FiniteMDP.from_outcomes(outcomes, terminal=ends, start=0, discount=0.9)
    assert score_mapping(identity(task)).regained == pytest.approx(1.0)


MAZE = cr.GridWorld(["S..P", ".F..", "...T"], time_limit=50)
MIRRORED = cr.GridWorld([row[::-1] for row in MAZE.map], time_limit=50)
CROP = MAZE.crop(rows=(1, 3), columns=(2, 4))
COSTS = cr.Rewards(step=-1, treasure=0)
LINE = cr.GridWorld("S.......T", rewards=COSTS, time_limit=50)
END = LINE.crop(rows=(0, 1), columns=(5, 9))


def test_the_scores_of_a_task_and_itself():
    scores = score_mapping(identity(MAZE))
    assert (scores.dynamics_error, scores.coverage, scores.optimistic) == (0, 1, 0)
    assert scores.bellman_inconsistency < 1e-9
    assert scores.regained == pytest.approx(1)
    assert scores.start_value == pytest.approx(cr.solve(MAZE).start_value)


def test_scores_by_hand():
    """Two steps to the end at -1; the source takes the first for the last."""
    line = cr.FiniteMDP.from_outcomes(
        [[[(1.0, 1, -1.0)]], [[(1.0, 2, -1.0)]], [[]]],
        terminal=[False, False, True], start=0, discount=0.5,
    )  # fmt: skip
    mapping = StateActionMapping(line, line, np.array([[1], [0], [0]]))
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
    mapped = cr.same_position(MAZE, CROP).index[~MAZE.mdp.terminal] != UNMAPPED
    assert score_mapping(cr.same_position(MAZE, CROP)).coverage == pytest.approx(mapped.mean())
    scores = score_mapping(StateActionMapping(MAZE, CROP, np.full((12, 4), UNMAPPED)))
    assert scores.coverage == 0
    assert np.isnan([scores.dynamics_error, scores.bellman_inconsistency, scores.optimistic]).all()
    assert scores.regained == pytest.approx(0)


def test_a_mirrored_maze_is_found_without_names():
    best = find_mappings(MAZE, MIRRORED)[0]
    assert best.how.startswith("exact homomorphism: 100%")
    assert best.bound < 1e-6
    state, action = np.divmod(best.mapping.index[MAZE.state(1, 3)], 4)
    assert set(state) == {MIRRORED.state(1, 0)}
    assert action.tolist() == [0, 3, 2, 1]  # east for west


def test_what_reads_the_values_alike_is_one_candidate():
    ways = [candidate.how for candidate in find_mappings(MAZE, MAZE)]
    assert ways.count("components by name") == 1
    assert not any("homomorphism" in how for how in ways)


def test_names_with_unmapped_values():
    for candidate in find_mappings(MAZE, CROP, unmapped_value=-3.0):
        assert candidate.mapping.unmapped_value == -3
        assert candidate.scores.coverage == 1


def test_a_search_of_ones_own():
    def upside_down(tasks):
        index = identity(tasks.target).index[::-1]
        yield Proposal(StateActionMapping(tasks.target, tasks.source, index), "mine")

    ring_of_four = cr.FiniteMDP.from_outcomes(
        [[[(1.0, (s + way) % 4, float(s))] for way in (1, 3)] for s in range(4)],
        terminal=[False] * 4, start=0, discount=0.9,
    )  # fmt: skip
    (candidate,) = find_mappings(ring_of_four, ring_of_four, searches=[upside_down])
    assert candidate.how == "mine"


def test_other_symmetries_do_not_count_as_errors():
    """Behind a homomorphism stand images of states; the dynamics agree up to symmetry."""
    room = cr.GridWorld(["...", ".T.", "S.."])
    mapping = next(iter(by_homomorphism(TaskPair(room, room)))).mapping
    assert len(set((mapping.index // 4).ravel().tolist())) < 8
    assert score_mapping(mapping).dynamics_error == 0


def searched(**settings):
    return lambda: find_mappings(MAZE, MAZE, **settings)


@pytest.mark.parametrize(
    ("error", "call", "says"),
    [
        (SettingError, searched(keep=0), "keep .*: got 0$"),
        (SettingError, searched(seed=-1), "seed .*: got -1$"),
        (SettingError, searched(searches=()), "at least one search: got none$"),
        (SettingError, searched(searches=by_homomorphism), "list of functions: got <function by_"),
        (SettingError, searched(searches=[by_homomorphism, "by_name"]), r"of functions: got \["),
        (SettingError, searched(searches=[lambda tasks: None]), "<lambda> returned None"),
        (
            SettingError,
            searched(searches=[lambda tasks: [cr.same_position(MAZE, MAZE)]]),
            "must yield a Proposal: <lambda> yielded",
        ),
        (
            SettingError,
            searched(searches=[lambda tasks: [Proposal(identity(LINE), "another's")]]),
            "mappings of the tasks that it is given: <lambda> proposed the target GridWorld",
        ),
        (MappingError, searched(unmapped_value=float("nan")), "unmapped_value must be"),
        (
            MappingError,
            lambda: [*by_homomorphism(TaskPair(cr.Pursuit(2, 2), cr.Pursuit(3, 1)))],
            "no pair of the target is equivalent",
        ),
        (TaskError, lambda: find_mappings(ring(), MAZE), "functions or played live has no tables"),
        (
            CurriculumError,
            lambda: cr.Curriculum({"maze": MAZE, "ring": ring()}, [Transfer("ring", "maze")]),
            "with tables: the source has none; find it",
        ),
        (CurriculumError, lambda: Transfer("a", "b").potential([[0.0]]), "when a curriculum is"),
    ],
)
def test_searches_are_refused_in_one_sentence(error, call, says):
    check_refusal(error, call, says)


def test_at_discount_1_the_time_limit_is_the_horizon():
    task = cr.GridWorld(["S..T"], discount=1.0, time_limit=20)
    assert TaskPair(task, task).target_mdp.discount == 0.95
    assert find_mappings(task, task)[0].scores.regained == pytest.approx(1)


def test_states_that_behave_alike_are_one_block():
    room = model_for_refinement(cr.GridWorld(["...", ".T.", "S.."]).mdp)
    blocks = refined([room])[0].states.reshape(3, 3)  # corners, sides, and the end
    np.testing.assert_array_equal(blocks, [[2, 1, 2], [1, 0, 1], [2, 1, 2]])
    assert levels(np.array([0.1 + 0.2, 0.3, 5.0]), 5e-9).tolist() == [0, 0, 1]


def test_a_transfer_without_a_mapping_gets_the_best_and_says_so(capsys):
    edge = Transfer("mirrored", "maze", scale=2)
    made = cr.Curriculum({"maze": MAZE, "mirrored": MIRRORED}, [edge], budget=100)
    out = capsys.readouterr().out
    assert out.startswith("mapping found for mirrored -> maze: exact homomorphism: 100%")
    assert "regains 100%" in out
    assert "\n  runner-up: " in out
    (edge,) = made.transfers
    assert edge.scale == 2
    assert "found: exact homomorphism" in transfer_words(edge)
    assert (edge.mapping.index == auto_mapping(MAZE, MIRRORED).mapping.index).all()
    made.train()
    assert made.replace("maze", budget=50).transfers == made.transfers


def test_a_source_with_another_goal_is_refused_in_one_sentence():
    other = cr.GridWorld(["T...", "....", "...S"], rewards=cr.Rewards(treasure=-50, step=1))
    with pytest.raises(MappingError, match=r"the best .*, regains .*%, leaves .* to accept it"):
        auto_mapping(MAZE, other)
    with pytest.raises(CurriculumError, match="no mapping for other -> maze: a mapping is used"):
        cr.Curriculum({"maze": MAZE, "other": other}, [Transfer("other", "maze")])


def without(task, states):
    """Return the identity, these states left out."""
    index = identity(task).index.copy()
    index[states] = UNMAPPED
    return StateActionMapping(task, task, index)


def test_one_state_is_worth_its_step_into_what_is_known():
    line = cr.GridWorld("S.T", rewards=COSTS)
    known = cr.solve(line).values[1]
    value = fitted_unmapped_value(without(line, [0]))
    # u = -1 + gamma V(1) would leave no residual there; only state 1 pulls, and it has none either.
    assert value == pytest.approx(-1 + line.discount * known)


def test_it_lies_among_the_values_and_is_read_through_the_transfer():
    mapping, values = cr.same_position(LINE, END), cr.solve(LINE).values[:5]
    fits = fitted_unmapped_value(mapping)
    assert values.min() < fits < values.max()
    assert fitted_unmapped_value(mapping, scale=2.0) < fits - 1
    assert fitted_unmapped_value(mapping, shift=-5.0) < fits - 3


def test_where_nothing_costs_or_leads_to_what_is_known_there_is_none():
    paid = cr.GridWorld("S.......T", rewards=cr.Rewards(step=0, treasure=1))
    end = paid.crop(rows=(0, 1), columns=(5, 9))
    assert fitted_unmapped_value(cr.same_position(paid, end)) is None
    assert fitted_unmapped_value(identity(LINE)) is None
    parted = cr.FiniteMDP.from_outcomes(
        [[[(1.0, 1, -1.0)]], [[]], [[(1.0, 3, -1.0)]], [[]]],
        terminal=[False, True, False, True], start=[0.5, 0, 0.5, 0], discount=0.9,
    )  # fmt: skip
    assert fitted_unmapped_value(without(parted, [0])) is None


@given(st.lists(st.tuples(st.floats(-9, 9), st.floats(0.01, 1)), min_size=1, max_size=9))
def test_the_expectile_of_the_residuals_is_zero(drawn):
    stated, factor = np.array(drawn).T
    constant = fitted_constant(stated, factor)
    left = stated - factor * constant
    weight = np.where(left > 0, EXPECTILE, 1 - EXPECTILE)
    assert abs((weight * factor * left).sum()) < 1e-6


@given(mdps(max_states=6), st.integers(0, 2**32 - 1))
def test_it_is_within_what_can_be_earned(dense, seed):
    task = dense.task()
    left_out = np.random.default_rng(seed).random(task.states.size) < 0.5
    tasks = TaskPair(task, task)
    value = fitted_unmapped_value(without(task, left_out), tasks=tasks)
    lowest = min(0.0, dense.r.min()) / (1 - tasks.target_mdp.discount)
    assert value is None or lowest - 1e-9 <= value < 0


def test_auto_states_it_unless_it_is_told_not_to():
    fitted, unfitted = (auto_mapping(LINE, END, fit_unmapped=fit) for fit in (True, False))
    assert fitted.mapping.unmapped_value == fitted_unmapped_value(unfitted.mapping)
    assert unfitted.mapping.unmapped_value is None
    assert auto_mapping(LINE, END, unmapped_value=-1.0).mapping.unmapped_value == -1


def curriculum_of(*transfers, **settings):
    return cr.Curriculum({"end": END, "line": LINE}, transfers, budget=100, **settings)


def test_a_curriculum_states_it_where_one_transfer_says_all():
    auto = cr.Transfer("end", "line")
    (edge,) = curriculum_of(auto).transfers
    assert edge.mapping.unmapped_value < -3
    (scaled,) = curriculum_of(cr.Transfer("end", "line", scale=2.0)).transfers
    assert scaled.mapping.unmapped_value < edge.mapping.unmapped_value - 1
    several = curriculum_of(auto, cr.Transfer("end", "line", cr.same_position(LINE, END)))
    assert several.transfers[0].mapping.unmapped_value is None  # which an aggregate skips
    for stated in (-2.0, 0.0, {"line": 0.0}):  # 0 is the default
        (edge,) = curriculum_of(auto, unknown_value=stated).transfers
        assert edge.mapping.unmapped_value is None
    (edge,) = curriculum_of(auto, unknown_value={"end": 0.0}).transfers
    assert edge.mapping.unmapped_value < -3
    assert curriculum_of(auto).setting("unknown_value", "line") == 0


@pytest.mark.parametrize(
    ("more", "stated"),
    [([], True), (["unknown_value=-2.0"], False), (["unknown_value=0.0"], False)],
)
def test_a_study_states_it_as_a_curriculum_does(read, more, stated):
    costs = "tasks.maze.rewards={ step = -1.0, treasure = 0.0 }"
    study = read(CORNER, set=["transfers.0.mapping=auto", costs, *more])
    (edge,) = only(again(study)).transfers
    assert (edge.mapping.unmapped_value is not None) is stated
