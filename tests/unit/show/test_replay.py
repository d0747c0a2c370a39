"""Replays of training: grid views, values over time, episodes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

import curricle as cr
from curricle.learning.record import Snapshots
from curricle.pictures.views import GridView
from curricle.planning.greedy import Values
from curricle.planning.rollouts import greedy_rollout
from curricle.planning.solution import greedy_policy
from curricle.show import replay as replay_module
from curricle.show.replay import LEVELS, greedy_choices, grid_drawing, mark_of, replays
from curricle.study.analysis import before_and_after
from curricle.study.record import ViewRecord
from tests.support.tasks import ring

from .studies import chain, of_cells, shown


def replays_of(shot, task):
    """The replays of a task's snapshots, and the tasks that are left out."""
    result = cr.Curriculum({"task": task}, budget=10).train()
    node = replace(result["task"], snapshots=shot)
    return replays(*shown({"scratch": replace(result, nodes={"task": node})}))


def test_ties_are_shown_as_ties_of_the_agent_that_is_drawn():
    task = cr.Pursuit(3, 2)
    hunt = GridView.for_replay(task)
    values = np.zeros(25)
    values[task.actions.encode(predator_1=2, predator_2=0)] = 1  # east, stay
    assert np.flatnonzero(greedy_choices(hunt, values)).tolist() == [2]
    assert grid_drawing(hunt)["letters"] == [("P", 1, 1), ("2", 0, 0)]
    maze = GridView.for_replay(cr.GridWorld(["S.", ".T"]))
    east = mark_of(maze, greedy_choices(maze, np.array([0.0, 1.0, 0.0, 0.0])))
    both = mark_of(maze, greedy_choices(maze, np.array([0.0, 1.0, 1.0, 0.0])))
    assert mark_of(maze, greedy_choices(maze, np.ones(4))) == ""
    assert east.count("z") == 1
    assert both.count("z") == 2


def test_a_task_without_geometry_is_a_strip_with_words():
    strip = GridView.for_replay(chain(80))
    assert not strip.is_map
    assert len(strip.states) == 60
    assert strip.words == "cells: states by number, the first 60 of 80"
    assert mark_of(strip, greedy_choices(strip, np.array([0.0, 1.0]))) == "1"
    assert strip.markers[0].cells[[0, 59, 60]].tolist() == [0, 59, -1]


def test_a_map_of_too_many_cells_is_not_shown():
    wide = cr.GridWorld(["S" + "." * 59 + "T"] + ["." * 61] * 50)
    assert GridView.for_replay(wide) is None
    for large in (cr.Pursuit(10, predators=4), ring(10**10)):  # no array of all states fits
        assert GridView.for_replay(large) is None
    shape = (2, wide.states.size, 4)
    short = Snapshots(seed=0, steps=np.array([0, 9]), values=np.zeros(shape, np.float32))
    assert replays_of(short, wide) == ((), ("task",))


def test_walls_and_ends_cover_what_is_no_state(maze):
    films = grid_drawing(GridView.for_replay(maze.results["2x2"].curriculum.tasks["maze"]))
    assert films["walls"] == "M2 3h1v1h-1z"
    assert films["ended"].count("M") == 3  # two pits and the treasure
    objects = [(letter, ends) for letter, *_, ends in films["objects"]]
    assert objects == [("T", True), ("P", True), ("P", True), ("F", False)]


@given(st.integers(0, 2**32 - 1), st.floats(1e-3, 1e4))
def test_a_replay_keeps_values_to_a_sixty_five_thousandth(seed, size):
    maze = cr.GridWorld(["S..", "..T"])
    values = np.random.default_rng(seed).normal(0, size, (4, 6, 4)).astype(np.float32)
    shot = Snapshots(seed=0, steps=np.arange(4) * 10, values=values)
    ((film,), _) = replays_of(shot, maze)
    read = film.low + (film.high - film.low) * film.levels / (LEVELS - 1)
    best = values[:, :5].max(axis=-1)
    assert np.abs(read - best).max() <= 0.6 * (film.high - film.low) / (LEVELS - 1)
    policy = greedy_policy(values[2, :5]) > 0
    for number, row in zip(film.choices[2], policy, strict=True):
        assert film.marks[number] == mark_of(film.view, row)


def test_moments_are_thinned_and_a_page_holds_a_number_of_cells(maze, monkeypatch):
    hall = cr.GridWorld("S.T")
    shot = Snapshots(seed=0, steps=np.arange(200), values=np.zeros((200, 3, 4), np.float32))
    monkeypatch.setattr(replay_module, "MOST_MOMENTS", 7)
    ((film,), _) = replays_of(shot, hall)
    assert len(film.steps) == 7
    assert film.steps[[0, -1]].tolist() == [0, 199]  # the ends are kept, and targets come first
    monkeypatch.setattr(replay_module, "MOST_CELLS", 3 * 15)  # three arms in the target
    films, left_out = replays(*shown(maze.results))
    assert {replay.task for replay in films} == {"maze"}
    assert left_out == ("corner",)


def test_arms_that_learnt_alike_share_a_replay(pursuit, maze):
    films, left_out = replays(*shown(pursuit.results))
    assert [replay.task for replay in films] == ["hunt"] * 3 + ["chase"]
    arms = [replay.arms for replay in films]
    assert arms == [("scratch",), ("min",), ("mean",), ("min", "mean")]
    assert left_out == ()
    films, _ = replays(*shown(maze.results))
    assert [replay.arms for replay in films if replay.task == "corner"] == [("3x3",), ("2x2",)]


def test_both_episodes_start_alike_and_sum_the_rewards(pursuit):
    hunt = pursuit.results["min"].curriculum.tasks["hunt"]
    shot = pursuit.results["min"]["hunt"].snapshots
    pair = before_and_after(shot, hunt, 0.9)
    before, after = pair.before, pair.after
    assert (before.cells[0] == after.cells[0]).all()
    followed = greedy_rollout(hunt, Values(shot.values[-1].astype(np.float64)), seed=0)
    assert after.returns[-1] == pytest.approx(followed.discounted_return(0.9))
    assert (after.rewards == followed.rewards).all()
    decoded = hunt.states.decode(followed.states)
    assert (after.cells[:, 1] == decoded["predator_1"]).all()
    assert after.terminated == followed.terminated


def test_tasks_without_tables_and_states_off_the_strip_have_no_episodes(pursuit, monkeypatch):
    values = np.zeros((2, 80, 2), np.float32)
    values[:, :, 1] = 1
    far = replace(chain(80), start=np.eye(80)[70])
    shot = Snapshots(seed=0, steps=np.array([0, 9]), values=values)
    assert before_and_after(shot, far, 0.9) is None
    hunt = pursuit.results["min"].curriculum.tasks["hunt"]
    monkeypatch.setattr("curricle.study.analysis.LARGEST_TABLE", 10)
    shot = pursuit.results["min"]["hunt"].snapshots
    assert before_and_after(shot, hunt, 0.9) is None


def test_thin_walls_are_drawn_between_cells():
    wall = of_cells((1, 2), range(2), "east", "west")
    assert grid_drawing(GridView.for_replay(wall))["bars"] == "M1 0v1"
    record = ViewRecord.of(GridView.for_replay(wall))
    assert grid_drawing(record.view)["bars"] == "M1 0v1"
    with pytest.raises(ValueError, match="bars must lie within"):
        ViewRecord(**{**dict(record), "bars": np.array([4])})
