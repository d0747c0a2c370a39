"""FrozenLake, CliffWalking and Taxi by own rules: equal to Gymnasium's, and their relatives."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.toy_text.frozen_lake import generate_random_map
from hypothesis import given, settings, strategies as st
from scipy.sparse.csgraph import floyd_warshall

import curricle as cr
from curricle import from_gymnasium, solve
from curricle.tasks.graph import reachable_states


def dense(mdp):
    """Return P and R as (S, A, S) arrays."""
    p = np.zeros((mdp.states.size, mdp.actions.size, mdp.states.size))
    r = np.zeros_like(p)
    for s, a in np.ndindex(p.shape[:2]):
        row = mdp.outcome_row[s, a]
        np.add.at(p[s, a], mdp.next_state[row], mdp.probability[row])
        np.add.at(r[s, a], mdp.next_state[row], mdp.probability[row] * mdp.reward[row])
    return p, r


def assert_equal_to_gymnasium(task, name, **arguments):
    """Compare with Gymnasium's own P, in every state that goes on; with names and start too."""
    theirs = from_gymnasium(name, discount=task.discount, **arguments)
    mdp = task.mdp
    met = reachable_states(theirs)  # of other ends theirs say nothing
    assert (mdp.terminal == theirs.terminal)[met].all()
    assert np.array_equal(mdp.start, theirs.start)
    assert (mdp.states, mdp.actions) == (theirs.states, theirs.actions)
    alive = ~mdp.terminal
    for ours, other in zip(dense(mdp), dense(theirs), strict=True):
        assert np.array_equal(ours[alive], other[alive])


@pytest.mark.parametrize("name", ["4x4", "8x8"])
@pytest.mark.parametrize("slippery", [False, True])
def test_lakes_are_those_of_gymnasium(name, slippery):
    lake = cr.tasks.FrozenLake(name, slippery=slippery)
    assert_equal_to_gymnasium(lake, "FrozenLake-v1", map_name=name, is_slippery=slippery)
    assert lake.time_limit == gym.spec("FrozenLake-v1").max_episode_steps


@given(
    st.integers(2, 7),
    st.floats(0.6, 1),
    st.integers(0, 2**32),
    st.floats(0.05, 0.95),
    st.tuples(*[st.integers(-5, 5)] * 3),
)
@settings(max_examples=15, deadline=None)
def test_random_lakes_are_those_of_gymnasium(size, share, seed, success_rate, rewards):
    lines = generate_random_map(size=size, p=share, seed=seed)
    goal, hole, frozen = rewards
    lake = cr.tasks.frozen_lake_family(
        map="random",
        size=size,
        frozen_share=share,
        seed=seed,
        success_rate=success_rate,
        goal_reward=goal,
        hole_reward=hole,
        step_reward=frozen,
    ).task
    settings = {"success_rate": success_rate, "reward_schedule": rewards}
    assert list(lake.map) == lines
    assert_equal_to_gymnasium(lake, "FrozenLake-v1", desc=lines, **settings)


@pytest.mark.parametrize("slippery", [False, True])
def test_the_cliff_is_that_of_gymnasium(slippery):
    walk = cr.tasks.CliffWalking(slippery=slippery)
    assert_equal_to_gymnasium(walk, "CliffWalking-v1", is_slippery=slippery)
    assert walk.time_limit == gym.spec("CliffWalking-v1").max_episode_steps


@pytest.mark.parametrize(
    ("taxi", "theirs"),
    [
        (cr.tasks.Taxi(), {"is_rainy": False}),
        (cr.tasks.Taxi(rainy=True), {"is_rainy": True}),
        (cr.tasks.Taxi(rainy=True, success_rate=0.5), {"is_rainy": True, "rainy_probability": 0.5}),
    ],
)
def test_the_taxi_is_that_of_gymnasium(taxi, theirs):
    assert_equal_to_gymnasium(taxi, "Taxi-v4", **theirs)
    assert taxi.time_limit == gym.spec("Taxi-v4").max_episode_steps


def test_a_part_of_a_lake_is_the_lake_there():
    whole = cr.tasks.FrozenLake("8x8", slippery=False)
    part = whole.crop(rows=(3, 8), columns=(2, 8))
    assert part.map == tuple(line[2:] for line in whole.map[3:])
    row, column = part.layout.cells.T
    ours = whole.states.encode(row=row, column=column)
    assert (whole.grid.holds("G")[ours] == part.grid.holds("G")).all()
    # Inside the part a move leads to the same cell as in the whole lake.
    inner = part.mdp.next_state[part.mdp.outcome_row, 0]
    outer = whole.mdp.next_state[whole.mdp.outcome_row[ours], 0]
    stays = np.isin(outer, ours)
    assert (ours[inner] == outer)[stays].all()
    assert (inner == np.arange(len(ours))[:, None])[~stays].all()
    assert part.mdp.start[part.mdp.terminal].sum() == 0


@pytest.mark.parametrize(("rows", "columns"), [(2, 3), (3, 6), (4, 12), (5, 20)])
def test_a_walk_of_any_size_takes_the_way_past_the_cliff(rows, columns):
    walk = cr.tasks.CliffWalking(rows, columns, discount=0.9)
    assert cr.tasks.goal_distance(walk)[walk.mdp.start_states].tolist() == [columns + 1]
    best = -(1 - 0.9 ** (columns + 1)) / (1 - 0.9)
    assert solve(walk).start_value == pytest.approx(best)
    assert walk.states.label(walk.states.size - 1) == "row=3 column=11"


@pytest.mark.parametrize("size", [3, 4, 5, 6])
@pytest.mark.parametrize("stands", [2, 3, 4])
@pytest.mark.parametrize("walls", [False, True])
def test_every_ride_in_every_town_is_possible(size, stands, walls):
    """The best value of each start is that of the shortest ride, found on the map of the town."""
    town = cr.tasks.Taxi(size, stands, walls=walls)
    n = town.size**2
    beside = np.zeros((n, n))
    for cell, (row, column) in enumerate(np.ndindex(size, size)):
        if row + 1 < size:
            beside[cell, cell + size] = 1
        if column + 1 < size and not town.wall_cells[row, column]:
            beside[cell, cell + 1] = 1
    far = floyd_warshall(beside, directed=False)
    places, values = town.stand_cells, town.states.decode()
    best = solve(town).values
    for state in np.flatnonzero(town.mdp.start):
        cell = values["row"][state] * size + values["column"][state]
        fetch, ride = places[values["passenger"][state]], places[values["destination"][state]]
        steps = far[cell, fetch] + 1 + far[fetch, ride]
        gamma = town.discount
        expected = -(1 - gamma**steps) / (1 - gamma) + 20 * gamma**steps
        assert best[state] == pytest.approx(expected)


LAKE, WALK = cr.tasks.FrozenLake(["SFHF", "FHHG"], origin=(3, 8)), cr.tasks.CliffWalking(3, 4)


@pytest.mark.parametrize(
    ("task", "start", "expected"),
    [
        (LAKE, [(4, 8), (3, 8)], [0, 4]),
        (WALK, "map", [8]),
        (WALK, "uniform", [*range(9)]),
        (WALK, [(2, 11)], [7]),
    ],
)
def test_episodes_start_where_they_should(task, start, expected):
    begins = task.with_start(start).mdp.start
    assert np.flatnonzero(begins).tolist() == expected
    assert len(set(begins[expected])) == 1
