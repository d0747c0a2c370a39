"""Tasks that start elsewhere: of every kind with tables, as values, and refusals."""

import pickle

import numpy as np
import pytest

from curricle import (
    Curriculum,
    FiniteMDP,
    GridWorld,
    Pursuit,
    Transfer,
    from_gymnasium,
    learn,
    project,
    same_position,
    solve,
)
from curricle.planning import visit_distribution
from curricle.show.views import GridView
from curricle.tasks import (
    CliffWalking,
    DeepSea,
    FourRooms,
    FrozenLake,
    GoalDistance,
    KeyLockPit,
    RiverSwim,
    Taxi,
    goal_distance,
    with_start,
)
from curricle.tasks.mdp import reachable_states
from curricle.tasks.start_states import TaskWithStart, goal_states

MAZE = GridWorld(["S..P", ".#.T", "...."])
TASKS = {
    "maze": MAZE,
    "pursuit": Pursuit(size=3, predators=1),
    "lake": FrozenLake(),
    "cliff": CliffWalking(3, 5),
    "taxi": Taxi(3),
    "rooms": FourRooms(9),
    "key": KeyLockPit.room(5),
    "sea": DeepSea(4),
    "tables": from_gymnasium("FrozenLake-v1", discount=0.9),
}


@pytest.mark.parametrize("name", TASKS)
def test_every_task_starts_in_a_ring(name):
    task = TASKS[name]
    near = with_start(task, GoalDistance(1, 2))
    mdp = task.mdp
    starting = np.flatnonzero(near.mdp.start)
    far = goal_distance(task)
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
    near, again, other = (with_start(task, GoalDistance(n)) for n in (1, 1, 2))
    copied = pickle.loads(pickle.dumps(near))
    assert np.array_equal(copied.mdp.start, near.mdp.start)
    if not isinstance(task, FiniteMDP):  # tables are themselves alone
        assert near == again == copied
        assert hash(near) == hash(copied)
        assert near != other
        assert near != task


def test_kinds_are_kept_where_they_can_say_it():
    assert with_start(MAZE, GoalDistance(1)) == MAZE.with_start([(0, 2), (2, 3), (1, 2)][1:])
    assert isinstance(with_start(TASKS["tables"], "reachable"), FiniteMDP)
    assert isinstance(with_start(FrozenLake(), "reachable"), FrozenLake)
    assert isinstance(with_start(CliffWalking(), "reachable"), CliffWalking)
    assert isinstance(with_start(TASKS["pursuit"], "uniform"), TaskWithStart)
    shares = visit_distribution(MAZE)
    visited = with_start(MAZE, shares)
    assert isinstance(visited, TaskWithStart)
    assert np.array_equal(visited.mdp.start, shares)
    assert with_start(visited, "uniform") == MAZE.with_start("uniform")
    once = with_start(TASKS["pursuit"], GoalDistance(1))
    assert with_start(once, GoalDistance(2)) == with_start(TASKS["pursuit"], GoalDistance(2))


def test_a_relative_maze_starts_by_its_cells():
    relative = GridWorld(["S..T", "...."], representation="relative")
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
    assert goal_distance(Pursuit(3, 1), {"prey": "(0,0)", "predator": ["(0,0)", "(2,2)"]})[0] == 0
    fetched = goal_states(Taxi(3), {"passenger": "taxi"})
    assert fetched.sum() == 9 * 4
    assert with_start(river, GoalDistance(0, goal={"position": 5})).mdp.start[5] == 1
    assert np.flatnonzero(goal_states(MAZE)).tolist() == [MAZE.state(1, 3)]
    lake = FrozenLake()
    assert np.flatnonzero(goal_states(lake)).tolist() == [15]
    assert goal_states(CliffWalking()).tolist() == CliffWalking().goal_states.tolist()
    opened = np.flatnonzero(goal_states(KeyLockPit.room(5)))
    assert [KeyLockPit.room(5).states.label(s) for s in opened] == [
        "row=4 column=4 key=held lock=open"
    ]
    caught = Pursuit(3, 2)
    assert goal_states(caught).tolist() == caught.terminal.tolist()
    corridor = GridWorld("S.P.T", ends=("pit", "treasure"))
    assert goal_distance(corridor).tolist() == [-1, -1, -1, 1, 0]


def test_mappings_fit_a_task_that_starts_elsewhere():
    hunt, chase = Pursuit(3, 2), Pursuit(3, 1)
    near = with_start(chase, GoalDistance(1))
    mapping = project(hunt, near, predator="predator_1")
    curriculum = Curriculum(
        {"near": near, "hunt": hunt}, [Transfer("near", "hunt", mapping)], budget=300
    )
    assert curriculum.train(seeds=[0])["hunt"].steps_used == [300]
    part = with_start(MAZE, GoalDistance(1, 2))
    assert same_position(MAZE, part).coverage().mapped == 1


def test_it_is_learnt_solved_and_drawn():
    near = with_start(TASKS["pursuit"], GoalDistance(1))
    assert solve(near).start_value == pytest.approx(
        solve(near.task).values[np.flatnonzero(near.start)].mean()
    )
    assert learn(near, budget=200).steps_used == [200]
    drawn = with_start(DeepSea(4), visit_distribution(DeepSea(4)))
    assert GridView.of(drawn).shape == (5, 4)
    assert GridView.for_replay(near) is not None
