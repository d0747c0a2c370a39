"""The value of unmapped pairs: what it is, where there is none, and who gets it."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

import curricle as cr
from curricle.study.config import StudyConfig
from curricle.transfer import (
    UNMAPPED,
    StateActionMapping,
    TaskPair,
    auto_mapping,
    fitted_unmapped_value,
    identity,
)
from curricle.transfer.mapping_scores import EXPECTILE, fitted_constant
from tests.studies import CORNER
from tests.tasks import mdps

COSTS = cr.Rewards(step=-1, treasure=0)
LINE = cr.GridWorld("S.......T", rewards=COSTS, time_limit=50)
END = LINE.crop(rows=(0, 1), columns=(5, 9))


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
    mapping = cr.same_position(LINE, END)
    values = cr.solve(LINE).values[:5]
    assert values.min() < fitted_unmapped_value(mapping) < values.max()
    mapping = cr.same_position(LINE, END)
    doubled = fitted_unmapped_value(mapping, scale=2.0)
    assert doubled < fitted_unmapped_value(mapping) - 1
    assert fitted_unmapped_value(mapping, shift=-5.0) < fitted_unmapped_value(mapping) - 3


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
    found = auto_mapping(LINE, END)
    unfitted = auto_mapping(LINE, END, fit_unmapped=False)
    assert found.mapping.unmapped_value == fitted_unmapped_value(unfitted.mapping)
    assert auto_mapping(LINE, END, fit_unmapped=False).mapping.unmapped_value is None
    assert auto_mapping(LINE, END, unmapped_value=-1.0).mapping.unmapped_value == -1


def made(*transfers, **settings):
    return cr.Curriculum({"end": END, "line": LINE}, transfers, budget=100, **settings)


def test_a_curriculum_states_it_where_one_transfer_says_all():
    auto = cr.Transfer("end", "line")
    (edge,) = made(auto).transfers
    assert edge.mapping.unmapped_value < -3
    (scaled,) = made(cr.Transfer("end", "line", scale=2.0)).transfers
    assert scaled.mapping.unmapped_value < edge.mapping.unmapped_value - 1
    one, _ = made(auto, cr.Transfer("end", "line", cr.same_position(LINE, END))).transfers
    assert one.mapping.unmapped_value is None  # which an aggregate skips
    for stated in (-2.0, 0.0, {"line": 0.0}):  # 0 is the default
        (edge,) = made(auto, unknown_value=stated).transfers
        assert edge.mapping.unmapped_value is None
    (edge,) = made(auto, unknown_value={"end": 0.0}).transfers
    assert edge.mapping.unmapped_value < -3
    assert made(auto).setting("unknown_value", "line") == 0


@pytest.mark.parametrize(
    ("more", "stated"),
    [([], True), (["unknown_value=-2.0"], False), (["unknown_value=0.0"], False)],
)
def test_a_study_states_it_as_a_curriculum_does(read, tmp_path, more, stated):
    costs = "tasks.maze.rewards={ step = -1.0, treasure = 0.0 }"
    study = read(CORNER, set=["transfers.0.mapping=auto", costs, *more])
    (edge,) = StudyConfig.from_data(study.to_data(), tmp_path).curriculum("transfer").transfers
    assert (edge.mapping.unmapped_value is not None) is stated
