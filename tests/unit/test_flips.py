"""Flips and visits, by hand."""

import numpy as np
import pytest

import curricle as cr
from curricle.comparison.choice_flips import expected_visits, flips, right_states
from curricle.errors import SettingError

OPTIMAL = np.array([[True, False], [True, False], [True, False], [True, True], [False, True]])


def test_a_choice_is_right_if_all_that_are_greedy_are_optimal():
    values = [[2.0, 1.0], [1.0, 2.0], [3.0, 3.0], [3.0, 3.0], [-1.0, 0.0]]
    assert right_states(values, OPTIMAL).tolist() == [True, False, False, True, True]


def test_a_flip_is_right_now_minus_right_before():
    before = [[2.0, 1.0], [1.0, 2.0], [3.0, 3.0], [0.0, 9.0], [0.0, 1.0]]
    after = [[1.0, 2.0], [2.0, 1.0], [4.0, 3.0], [9.0, 0.0], [1.0, 1.0]]
    found = flips(before, after, OPTIMAL)
    assert found.tolist() == [-1, 1, 1, 0, -1]
    assert found.dtype == np.int64
    assert flips(after, before, OPTIMAL).tolist() == [1, -1, -1, 0, 1]


@pytest.mark.parametrize(
    ("before", "after", "optimal", "said"),
    [
        (np.zeros((4, 2)), np.zeros((5, 2)), OPTIMAL, r"\(4, 2\) and \(5, 2\)"),
        (np.zeros((5, 2)), np.zeros(5), OPTIMAL, r"\(5,\) and \(5, 2\)"),
        (np.zeros((5, 2)), np.zeros((5, 2)), OPTIMAL.astype(int), "booleans: got int"),
        (np.zeros((5, 2)), np.full((5, 2), np.nan), OPTIMAL, "state 0"),
        (np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 2), bool), "shape"),
    ],
)
def test_tables_that_do_not_match_are_refused(before, after, optimal, said):
    with pytest.raises(SettingError, match=said):
        flips(before, after, optimal)


@pytest.mark.parametrize("seeds", [1, 3])
def test_a_smaller_budget_gives_the_table_that_a_longer_learning_had_then(seeds):
    # Two trainings of t steps agree, however each is evaluated, and the longer
    # one's curve goes through what the shorter one ends with.
    hunt = cr.Pursuit(3, 2, discount=0.9, time_limit=30)
    evaluation = cr.GreedyEvaluation(method="exact")
    learning = {"seeds": seeds, "stream": "hunt", "evaluation": evaluation}
    longer = cr.learn(hunt, budget=3_000, eval_freq=100, **learning)
    for place, time in enumerate(longer.steps[1:], 1):
        if time % 700:
            continue
        shorter = cr.learn(hunt, budget=int(time), eval_freq=int(time), **learning)
        assert (shorter.greedy_return[:, -1] == longer.greedy_return[:, place]).all()
        rough = {**learning, "evaluation": cr.GreedyEvaluation(method="rollouts", episodes=3)}
        again = cr.learn(hunt, budget=int(time), eval_freq=10, **rough)
        assert (shorter.values == again.values).all()


def test_visits_of_a_deterministic_way():
    maze = cr.GridWorld(["S.T"])
    assert expected_visits(maze, [1, 1, 0]).tolist() == [1, 1, 0]


def test_visits_are_cut_at_the_time_limit():
    maze = cr.GridWorld(["S.T"], time_limit=5)
    assert expected_visits(maze, [3, 3, 0]).tolist() == [5, 0, 0]  # west, into the edge


def test_visits_sum_to_the_length_of_an_episode():
    task = cr.FiniteMDP.from_outcomes(
        [[[(0.5, 0, 0.0), (0.5, 1, 0.0)]], [[]]], terminal=[False, True], start=0, discount=0.99
    )
    assert expected_visits(task, [[1.0], [1.0]]).tolist() == pytest.approx([2.0, 0.0])


def test_visits_without_any_bound_are_counted_to_the_end():
    task = cr.FiniteMDP.from_outcomes(
        [[[(0.5, 0, 0.0), (0.5, 1, 0.0)]], [[]]], terminal=[False, True], start=0, discount=1
    )
    assert expected_visits(task, [[1.0], [1.0]]).tolist() == pytest.approx([2.0, 0.0])
