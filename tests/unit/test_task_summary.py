"""Two stored studies have one target exactly if their tasks are the same problem."""

from dataclasses import replace

import numpy as np
import pytest

import curricle as cr
from curricle.comparison.task_differences import (
    differences,
    plain_text,
    summary_differences,
    task_summary,
)
from curricle.show.views import GridView
from curricle.study.record import ViewRecord, plain, read_record
from tests.tasks import random_mdp

MAZE = cr.GridWorld(["S..P", ".#..", "..FT"], time_limit=40)
OTHERS = {
    "discount": replace(MAZE, discount=0.9),
    "time_limit": replace(MAZE, time_limit=41),
    "reward": replace(MAZE, rewards=cr.tasks.Rewards(step=-1.001)),
    "states": cr.GridWorld(["S..P", "....", "..FT"], time_limit=40),
    "end": replace(MAZE, ends=("treasure",)),
    "start": replace(MAZE, start="uniform"),
}


def apart(one, other):
    return summary_differences(task_summary(one), task_summary(other))


@pytest.mark.parametrize("what", OTHERS)
def test_what_differs_is_named(what):
    assert differences(MAZE, OTHERS[what])
    first, *_ = apart(MAZE, OTHERS[what])
    assert first.startswith(what)
    assert apart(OTHERS[what], MAZE)


def test_the_same_problem_from_other_parameters_is_the_same():
    assert apart(MAZE, cr.GridWorld(MAZE.map, time_limit=40)) == ()
    assert apart(MAZE, MAZE.mdp) == differences(MAZE, MAZE.mdp) == ()
    hunt = cr.Pursuit(3, 2, time_limit=30)
    assert apart(hunt, hunt.mdp) == differences(hunt, hunt.mdp) == ()


@pytest.mark.parametrize("seed", range(8))
def test_one_changed_outcome_of_many_is_found(seed):
    mdp, draws = random_mdp(seed), np.random.default_rng(seed)
    row = int(mdp.outcome_row[~mdp.terminal].flat[0])
    column = int(mdp.probability[row].argmax())
    assert apart(mdp, random_mdp(seed)) == ()
    rewards = mdp.reward.copy()
    rewards[row, column] += draws.choice([1e-3, -1.0, 50.0])
    assert apart(mdp, replace(mdp, reward=rewards))[0] == "reward"


def test_text_of_a_parameter_is_the_same_in_every_process():
    def slip(state):
        return state + 1

    named = plain_text(slip)
    assert named.startswith("slip (")
    assert "0x" not in plain_text(slip) + plain_text((slip, object()))
    assert plain_text(lambda state: state) != plain_text(lambda state: state + 2)


@pytest.mark.parametrize("task", [MAZE, cr.Pursuit(3, 2), random_mdp(0)])
def test_a_view_is_the_same_when_it_is_read_again(task):
    view = GridView.for_replay(task)
    again = read_record(ViewRecord, plain(ViewRecord.of(view))).view
    for name in ("states", "cells", "ended"):
        np.testing.assert_array_equal(getattr(again, name), getattr(view, name))
    for name in ("origin", "shape", "letters", "words", "directions", "actions", "objects"):
        assert getattr(again, name) == getattr(view, name), name
    assert [m.letter for m in again.markers] == [m.letter for m in view.markers]
