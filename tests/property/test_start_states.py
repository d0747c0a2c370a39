"""Start states: rings by exact distance, reachable states, visits of a policy."""

from collections import deque

import numpy as np
import pytest
from hypothesis import given, strategies as st

from curricle import evaluate
from curricle.errors import TaskError
from curricle.planning import visit_distribution
from curricle.tasks import GoalDistance, goal_distance, with_start
from curricle.tasks.graph import reachable_states
from curricle.tasks.start_states import goal_states
from tests.support.tasks import mdps

SEEDS = st.integers(0, 2**32 - 1)


def breadth_first(dense, goal):
    """Return the fewest steps to the goal, -1 where there is no way: one state at a time."""
    n_states = len(dense.terminal)
    before = {
        after: [
            state
            for state in range(n_states)
            if not dense.terminal[state] and (dense.p[state, :, after] > 0).any()
        ]
        for after in range(n_states)
    }
    distance, waiting = np.full(n_states, -1), deque(np.flatnonzero(goal).tolist())
    distance[goal] = 0
    while waiting:
        state = waiting.popleft()
        for previous in before[state]:
            if distance[previous] < 0:
                distance[previous] = distance[state] + 1
                waiting.append(previous)
    return distance


@given(mdps(max_states=7), st.data())
def test_distances_are_those_of_breadth_first_search(dense, data):
    flags = data.draw(
        st.lists(st.booleans(), min_size=len(dense.terminal), max_size=len(dense.terminal))
    )
    goal = np.array(flags)
    if not goal.any():
        goal[data.draw(st.integers(0, len(goal) - 1))] = True
    expected = breadth_first(dense, goal)
    task = dense.task()
    assert (goal_distance(task, goal) == expected).all()
    assert (goal_distance(task, np.flatnonzero(goal)) == expected).all()


@given(mdps(max_states=7))
def test_the_goal_is_where_the_largest_reward_ends_an_episode(dense):
    task, best, expected = dense.task(), -np.inf, set()
    for state, action, after in np.ndindex(dense.p.shape):
        if dense.terminal[state] or not dense.terminal[after] or dense.p[state, action, after] == 0:
            continue
        reward = dense.r[state, action, after]
        if reward > best:
            best, expected = reward, set()
        if reward == best:
            expected.add(after)
    if not expected:
        with pytest.raises(TaskError, match="a goal needs at least one state"):
            goal_states(task)
    else:
        assert set(np.flatnonzero(goal_states(task)).tolist()) == expected


@given(mdps(max_states=7), st.integers(0, 4), st.integers(0, 4))
def test_a_ring_has_the_states_at_its_distances_equally_likely(dense, low, more):
    task = dense.task()
    goal = np.arange(len(dense.terminal)) == len(dense.terminal) - 1
    far = breadth_first(dense, goal)
    met = reachable_states(task)
    inside = (far >= low) & (far <= low + more) & ~dense.terminal & met
    ring = GoalDistance(low, low + more, goal)
    if not inside.any():
        with pytest.raises(TaskError, match=f"no state to start in lies {low}..{low + more} steps"):
            with_start(task, ring)
        return
    start = with_start(task, ring).start
    assert ((start > 0) == inside).all()
    assert start[inside] == pytest.approx(1 / inside.sum())
    assert start.sum() == pytest.approx(1)


@given(mdps(max_states=6), st.sampled_from(["uniform", "reachable"]))
def test_episodes_start_in_states_that_go_on(dense, words):
    task = dense.task()
    start = with_start(task, words).start
    assert start.sum() == pytest.approx(1)
    assert not start[dense.terminal].any()
    expected = ~dense.terminal
    if words == "reachable":
        expected &= reachable_states(task)
    assert ((start > 0) == expected).all()
    assert len(set(start[expected])) == 1


def drawn_policy(dense, seed):
    return np.random.default_rng(seed).dirichlet(np.ones(dense.shape[1]), size=dense.shape[0])


@given(mdps(max_states=5), SEEDS, st.sampled_from([1, 2, 7, 40]))
def test_visits_are_those_of_every_step_added_up(dense, seed, limit):
    """By dense matrices, a step at a time."""
    task, policy = dense.task(time_limit=limit), drawn_policy(dense, seed)
    moves = np.einsum("sa,sat->st", policy, dense.p)
    now, visits = task.start.copy(), np.zeros(len(task.start))
    for step in range(limit):
        visits += dense.discount**step * now
        now = np.where(dense.terminal, 0.0, now @ np.where(dense.terminal[:, None], 0.0, moves))
    found = visit_distribution(task, policy)
    assert found == pytest.approx(visits / visits.sum(), abs=1e-9)
    assert found.sum() == pytest.approx(1)
    assert not found[dense.terminal].any()
    assert with_start(task, found).start == pytest.approx(found)


@given(mdps(max_states=5), SEEDS)
def test_the_return_is_the_mean_reward_of_the_visits(dense, seed):
    """V(start) = sum_s eta(s) r_pi(s): what the visits are worth is what evaluation says."""
    task, policy = dense.task(), drawn_policy(dense, seed)
    rewards = np.einsum("sa,sat,sat->s", policy, dense.p, dense.r)
    alive = np.where(dense.terminal, 0.0, 1.0)
    moves = np.einsum("sa,sat->st", policy, dense.p) * alive[:, None] * alive
    eta = np.linalg.solve(np.eye(len(alive)) - dense.discount * moves.T, task.start)
    assert visit_distribution(task, policy) == pytest.approx(eta / eta.sum(), abs=1e-9)
    value = visit_distribution(task, policy) @ rewards * eta.sum()
    assert value == pytest.approx(evaluate(task, policy).start_value, abs=1e-6)
