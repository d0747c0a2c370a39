"""Tasks that start elsewhere: of every kind with tables, as values, and refusals."""

import pickle

import numpy as np
import pytest

import curricle as cr
from curricle.errors import TaskError
from curricle.pictures.views import GridView
from curricle.planning import visit_distribution
from curricle.tasks import (
    CliffWalking,
    DeepSea,
    FrozenLake,
    GoalDistance,
    KeyLockPit,
    RiverSwim,
    goal_distance,
    with_start,
)
from curricle.tasks.start_states import TaskWithStart, goal_states

MAZE = cr.GridWorld(["S..P", ".#.T", "...."])
TASKS = {
    "maze": MAZE,
    "pursuit": cr.Pursuit(size=3, predators=1),
    "lake": FrozenLake(),
    "cliff": CliffWalking(3, 5),
    "taxi": cr.tasks.Taxi(3),
    "rooms": cr.tasks.FourRooms(9),
    "key": KeyLockPit.room(5),
    "sea": DeepSea(4),
    "tables": cr.from_gymnasium("FrozenLake-v1", discount=0.9),
}


@pytest.mark.parametrize("name", TASKS)
def test_a_task_that_starts_elsewhere_is_a_value_with_the_tables_of_the_task(name):
    task = TASKS[name]
    near, again, other = (with_start(task, GoalDistance(n)) for n in (1, 1, 2))
    far = goal_distance(task)
    assert (far[near.mdp.start > 0] == 1).all()
    assert (near.states, near.actions) == (task.states, task.actions)
    for part in ("next_state", "reward", "discount", "time_limit"):
        assert np.array_equal(getattr(near.mdp, part), getattr(task.mdp, part))
    copied = pickle.loads(pickle.dumps(near))
    assert np.array_equal(copied.mdp.start, near.mdp.start)
    if not isinstance(task, cr.FiniteMDP):  # tables are themselves alone
        assert near == again == copied
        assert hash(near) == hash(copied)
        assert near != other
        assert near != task


def test_kinds_are_kept_where_they_can_say_it():
    assert with_start(MAZE, GoalDistance(1)) == MAZE.with_start([(2, 3), (1, 2)])
    assert isinstance(with_start(TASKS["tables"], "reachable"), cr.FiniteMDP)
    for task in (FrozenLake(), CliffWalking()):
        assert isinstance(with_start(task, "reachable"), type(task))
    assert isinstance(with_start(TASKS["pursuit"], "uniform"), TaskWithStart)
    # CliffWalking starts no episode in the cliff, which ends none.
    assert with_start(CliffWalking(columns=4), [13]).mdp.start_states.tolist() == [13]
    shares = visit_distribution(MAZE)
    visited = with_start(MAZE, shares)
    assert isinstance(visited, TaskWithStart)
    assert np.array_equal(visited.mdp.start, shares)
    assert with_start(visited, "uniform") == MAZE.with_start("uniform")
    once = with_start(TASKS["pursuit"], GoalDistance(1))
    assert with_start(once, GoalDistance(2)) == with_start(TASKS["pursuit"], GoalDistance(2))


def test_a_relative_maze_starts_by_its_cells():
    relative = cr.GridWorld(["S..T", "...."], representation="relative")
    near = with_start(relative, GoalDistance(1))
    assert near.representation == "relative"
    assert near.start == ((0, 2), (1, 3))


def test_states_and_probabilities_are_taken_as_they_are():
    assert with_start(MAZE, [0, 1]).start == ((0, 0), (0, 1))
    assert with_start(MAZE, 4).start == ((1, 0),)
    chances = np.zeros(11)
    chances[[0, 1]] = 0.25, 0.75
    assert with_start(MAZE, chances).mdp.start[1] == 0.75


def test_goals_are_treasures_or_named_by_components():
    river = RiverSwim()
    assert goal_distance(river, {"position": 5}).tolist() == [5, 4, 3, 2, 1, 0]
    met = {"prey": "(0,0)", "predator": ["(0,0)", "(2,2)"]}
    assert goal_distance(cr.Pursuit(3, 1), met)[0] == 0
    fetched = goal_states(cr.tasks.Taxi(3), {"passenger": "taxi"})
    assert fetched.sum() == 9 * 4
    assert with_start(river, GoalDistance(0, goal={"position": 5})).mdp.start[5] == 1
    assert np.flatnonzero(goal_states(MAZE)).tolist() == [MAZE.state(1, 3)]
    lake = FrozenLake()
    assert np.flatnonzero(goal_states(lake)).tolist() == [15]
    cliff, room = CliffWalking(), KeyLockPit.room(5)
    assert goal_states(cliff).tolist() == cliff.grid.holds("G").tolist()
    (opened,) = np.flatnonzero(goal_states(room))
    assert room.states.label(opened) == "row=4 column=4 key=held lock=open"
    caught = cr.Pursuit(3, 2)
    assert goal_states(caught).tolist() == caught.terminal.tolist()
    with pytest.raises(TaskError, match="a goal needs at least one state"):
        goal_states(MAZE, {})
    corridor = cr.GridWorld("S.P.T", ends=("pit", "treasure"))
    assert goal_distance(corridor).tolist() == [-1, -1, -1, 1, 0]


def test_a_start_that_was_moved_bounds_the_states_that_can_be_reached():
    last = int(np.flatnonzero(~DeepSea(4).mdp.terminal)[-2])
    moved = with_start(DeepSea(4), last)
    again = [with_start(of, "reachable").mdp for of in (moved, moved.mdp)]
    np.testing.assert_array_equal(*(mdp.start > 0 for mdp in again))
    assert (again[0].start > 0).sum() == 1


def test_it_is_learnt_solved_and_drawn():
    near = with_start(TASKS["pursuit"], GoalDistance(1))
    assert cr.solve(near).start_value == pytest.approx(
        cr.solve(near.task).values[np.flatnonzero(near.start)].mean()
    )
    assert cr.learn(near, budget=200).steps_used == [200]
    drawn = with_start(DeepSea(4), visit_distribution(DeepSea(4)))
    assert GridView.of(drawn).shape == (5, 4)
    assert GridView.for_replay(near) is not None
