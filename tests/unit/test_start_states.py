"""Tasks that start elsewhere: of every kind with tables, as values, and refusals."""

import pickle

import numpy as np
import pytest

import curricle as cr
from curricle.errors import TaskError
from curricle.pictures.views import GridView
from curricle.planning import visit_distribution
from curricle.tasks.graph import reachable_states
from curricle.tasks.start_states import TaskWithStart, goal_states

MAZE = cr.GridWorld(["S..P", ".#.T", "...."])
TASKS = {
    "maze": MAZE,
    "pursuit": cr.Pursuit(size=3, predators=1),
    "lake": cr.tasks.FrozenLake(),
    "cliff": cr.tasks.CliffWalking(3, 5),
    "taxi": cr.tasks.Taxi(3),
    "rooms": cr.tasks.FourRooms(9),
    "key": cr.tasks.KeyLockPit.room(5),
    "sea": cr.tasks.DeepSea(4),
    "tables": cr.from_gymnasium("FrozenLake-v1", discount=0.9),
}


@pytest.mark.parametrize("name", TASKS)
def test_every_task_starts_in_a_ring(name):
    task = TASKS[name]
    near = cr.tasks.with_start(task, cr.tasks.GoalDistance(1, 2))
    mdp = task.mdp
    starting = np.flatnonzero(near.mdp.start)
    far = cr.tasks.goal_distance(task)
    met = reachable_states(mdp) & ~mdp.terminal
    assert starting.tolist() == np.flatnonzero((far >= 1) & (far <= 2) & met).tolist()
    assert (near.states, near.actions) == (task.states, task.actions)
    assert np.array_equal(near.mdp.next_state, mdp.next_state)
    assert np.array_equal(near.mdp.reward, mdp.reward)
    assert near.mdp.discount == mdp.discount
    assert near.mdp.time_limit == mdp.time_limit


@pytest.mark.parametrize("name", TASKS)
def test_a_task_that_starts_elsewhere_is_a_value(name):
    task = TASKS[name]
    near, again, other = (cr.tasks.with_start(task, cr.tasks.GoalDistance(n)) for n in (1, 1, 2))
    copied = pickle.loads(pickle.dumps(near))
    assert np.array_equal(copied.mdp.start, near.mdp.start)
    if not isinstance(task, cr.FiniteMDP):  # tables are themselves alone
        assert near == again == copied
        assert hash(near) == hash(copied)
        assert near != other
        assert near != task


def test_kinds_are_kept_where_they_can_say_it():
    assert cr.tasks.with_start(MAZE, cr.tasks.GoalDistance(1)) == MAZE.with_start(
        [(0, 2), (2, 3), (1, 2)][1:]
    )
    assert isinstance(cr.tasks.with_start(TASKS["tables"], "reachable"), cr.FiniteMDP)
    assert isinstance(cr.tasks.with_start(cr.tasks.FrozenLake(), "reachable"), cr.tasks.FrozenLake)
    assert isinstance(
        cr.tasks.with_start(cr.tasks.CliffWalking(), "reachable"), cr.tasks.CliffWalking
    )
    assert isinstance(cr.tasks.with_start(TASKS["pursuit"], "uniform"), TaskWithStart)
    shares = visit_distribution(MAZE)
    visited = cr.tasks.with_start(MAZE, shares)
    assert isinstance(visited, TaskWithStart)
    assert np.array_equal(visited.mdp.start, shares)
    assert cr.tasks.with_start(visited, "uniform") == MAZE.with_start("uniform")
    once = cr.tasks.with_start(TASKS["pursuit"], cr.tasks.GoalDistance(1))
    assert cr.tasks.with_start(once, cr.tasks.GoalDistance(2)) == cr.tasks.with_start(
        TASKS["pursuit"], cr.tasks.GoalDistance(2)
    )


def test_a_relative_maze_starts_by_its_cells():
    relative = cr.GridWorld(["S..T", "...."], representation="relative")
    near = cr.tasks.with_start(relative, cr.tasks.GoalDistance(1))
    assert near.representation == "relative"
    assert near.start == ((0, 2), (1, 3))


def test_states_and_probabilities_are_taken_as_they_are():
    assert cr.tasks.with_start(MAZE, [0, 1]).start == ((0, 0), (0, 1))
    assert cr.tasks.with_start(MAZE, 4).start == ((1, 0),)
    chances = np.zeros(11)
    chances[[0, 1]] = 0.25, 0.75
    assert cr.tasks.with_start(MAZE, chances).mdp.start[1] == 0.75


def test_goals_are_treasures_or_named_by_components():
    river = cr.tasks.RiverSwim()
    assert cr.tasks.goal_distance(river, {"position": 5}).tolist() == [5, 4, 3, 2, 1, 0]
    assert (
        cr.tasks.goal_distance(cr.Pursuit(3, 1), {"prey": "(0,0)", "predator": ["(0,0)", "(2,2)"]})[
            0
        ]
        == 0
    )
    fetched = goal_states(cr.tasks.Taxi(3), {"passenger": "taxi"})
    assert fetched.sum() == 9 * 4
    assert (
        cr.tasks.with_start(river, cr.tasks.GoalDistance(0, goal={"position": 5})).mdp.start[5] == 1
    )
    assert np.flatnonzero(goal_states(MAZE)).tolist() == [MAZE.state(1, 3)]
    lake = cr.tasks.FrozenLake()
    assert np.flatnonzero(goal_states(lake)).tolist() == [15]
    assert (
        goal_states(cr.tasks.CliffWalking()).tolist()
        == cr.tasks.CliffWalking().grid.holds("G").tolist()
    )
    opened = np.flatnonzero(goal_states(cr.tasks.KeyLockPit.room(5)))
    assert [cr.tasks.KeyLockPit.room(5).states.label(s) for s in opened] == [
        "row=4 column=4 key=held lock=open"
    ]
    caught = cr.Pursuit(3, 2)
    assert goal_states(caught).tolist() == caught.terminal.tolist()
    with pytest.raises(TaskError, match="a goal needs at least one state"):
        goal_states(MAZE, {})
    corridor = cr.GridWorld("S.P.T", ends=("pit", "treasure"))
    assert cr.tasks.goal_distance(corridor).tolist() == [-1, -1, -1, 1, 0]


def test_a_start_that_was_moved_bounds_the_states_that_can_be_reached():
    last = int(np.flatnonzero(~cr.tasks.DeepSea(4).mdp.terminal)[-2])
    moved = cr.tasks.with_start(cr.tasks.DeepSea(4), last)
    again = [cr.tasks.with_start(of, "reachable").mdp for of in (moved, moved.mdp)]
    np.testing.assert_array_equal(*(mdp.start > 0 for mdp in again))
    assert (again[0].start > 0).sum() == 1


def test_it_is_learnt_solved_and_drawn():
    near = cr.tasks.with_start(TASKS["pursuit"], cr.tasks.GoalDistance(1))
    assert cr.solve(near).start_value == pytest.approx(
        cr.solve(near.task).values[np.flatnonzero(near.start)].mean()
    )
    assert cr.learn(near, budget=200).steps_used == [200]
    drawn = cr.tasks.with_start(cr.tasks.DeepSea(4), visit_distribution(cr.tasks.DeepSea(4)))
    assert GridView.of(drawn).shape == (5, 4)
    assert GridView.for_replay(near) is not None


def test_a_task_with_another_start_is_evaluated_and_compared():
    near = cr.tasks.with_start(cr.tasks.DeepSea(4), visit_distribution(cr.tasks.DeepSea(4)))
    assert isinstance(near, TaskWithStart)
    assert cr.planning.GreedyEvaluation().discount(near) == near.mdp.discount
    alone = cr.Curriculum({"near": near}, budget={"near": 200})
    assert cr.compare({"alone": alone}, seeds=2, opponents=()).target == "near"
