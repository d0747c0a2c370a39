"""How realistic a potential is, against plain loops; where an episode can get to."""

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

import curricle as cr
from curricle.planning import target as place
from curricle.tasks.reachable import reachable_states
from curricle.transfer import quality as module
from curricle.transfer.potentials import mapped_potential

LINE = cr.GridWorld("S.T", discount=0.5)  # Q* = 98.5 and 199 to the east
MAZE = cr.GridWorld(["F..T", ".P..", "S..#"], discount=0.9, time_limit=30)


def random_task(seed, *, n_states=8, n_actions=3, discount=0.9, time_limit=20):
    """Return a task with rewards of both signs, the last two states terminal, few successors."""
    rng = np.random.default_rng(seed)
    p = rng.dirichlet(np.full(n_states, 0.3), size=(n_states, n_actions))
    return cr.FiniteMDP.from_dense(
        np.where(p < 0.05, 0.0, p) / np.where(p < 0.05, 0.0, p).sum(axis=2, keepdims=True),
        rng.normal(-0.5, 1.0, size=p.shape),
        terminal=np.arange(n_states) >= n_states - 2,
        start=[0.5, 0.5] + [0.0] * (n_states - 2),
        discount=discount,
        time_limit=time_limit,
    )


def random_potential(task, seed):
    shape = task.mdp.outcome_row.shape
    return cr.StateActionPotential(task, np.random.default_rng([seed, 1]).normal(size=shape))


def optimum(task, shift=0.0):
    return cr.StateActionPotential(task, cr.solve(task, tolerance=1e-6).action_values + shift)


# -- against plain loops -------------------------------------------------------------------------


def outcomes(mdp, s, a):
    """Yield what the pair can lead to: probability, successor, reward."""
    row = mdp.outcome_row[s, a]
    for p, after, r in zip(
        mdp.probability[row].tolist(),
        mdp.next_state[row].tolist(),
        mdp.reward[row].tolist(),
        strict=True,
    ):
        if p > 0:
            yield p, after, r


def naive_optimum(mdp):
    """Return Q* by value iteration; 400 sweeps at discount 0.9 leave 5e-19 of the start."""
    n_states, n_actions = mdp.outcome_row.shape
    q = np.zeros((n_states, n_actions))
    for _ in range(400):
        v = q.max(axis=1)
        for s in range(n_states):
            for a in range(n_actions):
                if not mdp.terminal[s]:
                    each = outcomes(mdp, s, a)
                    q[s, a] = sum(p * (r + mdp.discount * v[after]) for p, after, r in each)
    return q


def naive_reach(mdp, allowed):
    """Return the states that allowed actions can get to, breadth first."""
    seen, waiting = set(), [int(s) for s in np.flatnonzero(mdp.start)]
    while waiting:
        s = waiting.pop(0)
        if s in seen:
            continue
        seen.add(s)
        if not mdp.terminal[s]:
            for a in np.flatnonzero(allowed[s]):
                waiting += [after for _, after, _ in outcomes(mdp, s, a)]
    return seen


def naive_realism(phi, mdp):
    """Return optimistic, excess, size, right, gloom and gloomy state, pair by pair."""
    q = naive_optimum(mdp)
    optimal = q > q.max(axis=1, keepdims=True) - 1e-6
    above, excess, size, right, alive = 0, 0.0, 0.0, 0, 0
    for s in np.flatnonzero(~mdp.terminal):
        alive += 1
        size += abs(q[s].max())
        right += all(optimal[s, a] for a in range(q.shape[1]) if phi[s, a] == phi[s].max())
        for a in range(q.shape[1]):
            above += phi[s, a] > q[s, a] + 1e-6
            excess += phi[s, a] - q[s, a]
    worst = (0.0, -1)
    for s in sorted(naive_reach(mdp, optimal)):
        missing = min(q[s].max(), 0.0) - phi[s].max()
        if not mdp.terminal[s] and missing > worst[0]:
            worst = (missing, s)
    pairs = alive * q.shape[1]
    return above / pairs, excess / pairs, size / alive, right / alive, *worst


@pytest.mark.parametrize("seed", range(8))
def test_every_measure_is_that_of_a_plain_loop(seed):
    task = random_task(seed) if seed else MAZE
    phi = random_potential(task, seed)
    if seed % 2:
        phi = phi.rescaled(1.0, -2.0)
    found = cr.transfer.potential_quality(phi, cr.planning.Target.of(task))
    optimistic, excess, size, right, gloom, where = naive_realism(phi.values, task.mdp)
    assert found.exact
    assert (found.optimistic, found.right, found.most_underestimated_state) == (
        optimistic,
        right,
        where,
    )
    # Both Q* are within the tolerance that a target is solved to, 1e-6, of the truth.
    assert (found.excess, found.size, found.largest_underestimate) == pytest.approx(
        (excess, size, gloom), abs=2e-6
    )


def test_the_loops_see_gloom_and_states_that_are_wrong():
    """Otherwise the test above would compare noughts."""
    found = [naive_realism(random_potential(t, 1).values - 2, t.mdp) for t in [random_task(1)]]
    assert found[0][4] > 0.5
    assert 0 < found[0][3] < 1


def test_the_gloom_counts_on_the_way_of_optimal_policies_only():
    """A cell aside may be spoken ill of; of two cells on the way the worse one is named."""
    maze = cr.GridWorld(["...", "S.T"], discount=0.5)
    target = cr.planning.Target.of(maze)
    q = target.solution.action_values.copy()
    q[0] = -1000.0
    assert (
        cr.transfer.potential_quality(
            cr.StateActionPotential(maze, q), target
        ).largest_underestimate
        == 0.0
    )
    q[3:5] = [[-40.0], [-50.0]]  # worth 98.5 and 199, but saying nothing promises 0 at least
    found = cr.transfer.potential_quality(cr.StateActionPotential(maze, q), target)
    assert (found.largest_underestimate, found.most_underestimated_state) == (50.0, 4)


def test_gloom_is_more_than_silence():
    """Where the truth is 98.5, promising 10 is no gloom, nor is promising nothing; -10 is."""
    for promise, gloom in ((10.0, 0.0), (0.0, 0.0), (-10.0, 10.0)):
        phi = cr.StateActionPotential(LINE, np.full((3, 4), promise))
        assert (
            cr.transfer.potential_quality(phi, cr.planning.Target.of(LINE)).largest_underestimate
            == gloom
        )


@pytest.mark.parametrize("task", [LINE, MAZE, cr.Pursuit(3, 2), *map(random_task, range(20))])
def test_the_optimum_is_realistic(task):
    target = cr.planning.Target.of(task)
    phi = cr.StateActionPotential(task, target.solution.action_values)
    found = cr.transfer.potential_quality(phi, target)
    assert (found.optimistic, found.excess, found.right, found.largest_underestimate) == (
        0.0,
        0.0,
        1.0,
        0.0,
    )
    assert found.rank == pytest.approx(1.0)
    assert found.most_underestimated_state == -1
    assert found.start == pytest.approx(target.optimum)


def test_what_is_within_the_proven_error_is_not_called_optimistic():
    target = cr.planning.Target.of(MAZE)
    error = target.solution.error_bound
    assert 0 < error <= 1e-6
    values = target.solution.action_values
    for shift, share in ((error / 2, 0.0), (error * 2 + 1e-9, 1.0)):
        found = cr.transfer.potential_quality(cr.StateActionPotential(MAZE, values + shift), target)
        assert found.optimistic == share


def test_the_bounds_of_a_target():
    """Of the line: the first cell is worth 98.5 at best and x at random, the second y."""
    target = cr.planning.Target.of(LINE)
    assert target.optimum == 98.5
    # x = -1 + (3 x + y) / 8, y = (199 - 3) / 4 + (x + 2 y) / 8
    x, _ = np.linalg.solve([[5 / 8, -1 / 8], [-1 / 8, 6 / 8]], [-1.0, 49.0])
    assert target.random_return == pytest.approx(x)
    assert target.typical_reward == 1.0  # cells pay -1, -1 and 199


def test_the_typical_reward_is_the_median_of_those_that_are_paid():
    outcomes = [[[(0.5, 0, 0.0), (0.5, 0, -2.0)], [(0.5, 0, 4.0), (0.5, 0, 7.0)]]]
    task = cr.FiniteMDP.from_outcomes(outcomes, start=0, discount=0.5, terminal=[False])
    assert cr.planning.Target.of(task).typical_reward == 4.0


def test_a_target_with_rewards_of_nothing_is_measured_in_ones():
    idle = cr.FiniteMDP.from_outcomes([[[(1.0, 0, 0.0)]]], start=0, discount=0.5, terminal=[False])
    assert cr.planning.Target.of(idle).typical_reward == 1.0


# -- ranks ---------------------------------------------------------------------------------------


def scipy_rank(phi, target):
    alive = ~target.task.mdp.terminal
    q = target.solution.action_values[alive]
    return scipy.stats.spearmanr(phi.values[alive].ravel(), q.ravel()).statistic


@pytest.mark.parametrize("levels", [2, 5, 1000])
@pytest.mark.parametrize("task", [MAZE, random_task(3)])
def test_ranks_correlate_as_scipy_has_it(task, levels):
    """With 2 levels nearly all of phi is tied; in the maze Q* has ties of its own."""
    target = cr.planning.Target.of(task)
    rng = np.random.default_rng(levels)
    noisy = target.solution.action_values + rng.normal(size=target.solution.action_values.shape)
    edges = np.quantile(noisy, np.linspace(0, 1, levels + 1)[1:-1])
    phi = cr.StateActionPotential(task, np.searchsorted(edges, noisy).astype(float))
    found = cr.transfer.potential_quality(phi, target).rank
    assert found == pytest.approx(scipy_rank(phi, target), abs=1e-12)
    assert 0.2 < abs(found) < 0.9999


def test_what_does_not_vary_has_no_rank_and_is_nowhere_right():
    phi = cr.StateActionPotential(MAZE, np.full((11, 4), -3.0))
    found = cr.transfer.potential_quality(phi, cr.planning.Target.of(MAZE))
    assert np.isnan(found.rank)
    assert found.right == 0.0  # it prefers what is wrong as much as what is right


def test_many_pairs_are_ranked_by_some_of_them(monkeypatch):
    hunt = cr.Pursuit(3, 2, discount=0.9)
    target, phi = cr.planning.Target.of(hunt), random_potential(hunt, 0)
    phi = cr.StateActionPotential(hunt, target.solution.action_values + phi.values)
    full = cr.transfer.potential_quality(phi, target).rank
    assert full == pytest.approx(scipy_rank(phi, target), abs=1e-12)
    monkeypatch.setattr(module, "MAX_RANKED", 2000)
    one, same, other = (
        cr.transfer.potential_quality(phi, target, seed=seed).rank for seed in (0, 0, 1)
    )
    assert one == same != other
    # The standard error of a correlation of 2,000 pairs is below 1 / sqrt(2000) = 0.022.
    assert one == pytest.approx(full, abs=0.09)


# -- where learning starts -----------------------------------------------------------------------


@pytest.mark.parametrize("discounted", [True, False])
@pytest.mark.parametrize("largest", [place.LARGEST_FOLLOWED, 0], ids=["exact", "rollouts"])
@pytest.mark.parametrize("task", [MAZE, random_task(5)])
def test_the_start_is_the_first_checkpoint_of_learning(task, largest, discounted, monkeypatch):
    monkeypatch.setattr(place, "LARGEST_FOLLOWED", largest)
    target = cr.planning.Target.of(task, cr.GreedyEvaluation(discounted=discounted), episodes=50)
    assert target.evaluation.method == ("exact" if largest else "rollouts")
    for seed in (0, 3):
        phi = random_potential(task, seed)
        learnt = cr.learn(task, budget=1, seeds=[seed], potential=phi, evaluation=target.evaluation)
        assert (
            cr.transfer.potential_quality(phi, target, seed=seed).start
            == learnt.greedy_return[0, 0]
        )


def test_a_potential_read_on_the_fly_is_judged_like_its_array():
    hunt, chase = cr.Pursuit(3, 2), cr.Pursuit(3, 1)
    edges = [
        cr.Transfer("chase", "hunt", cr.project(hunt, chase, predator=name))
        for name in hunt.predator_names
    ]
    values = cr.solve(chase).action_values
    lazy = mapped_potential(hunt, edges, [values, values], cr.minimum)
    target = cr.planning.Target.of(hunt)
    array = cr.StateActionPotential(hunt, lazy.values)
    assert cr.transfer.potential_quality(lazy, target) == cr.transfer.potential_quality(
        array, target
    )


# -- without Q* ----------------------------------------------------------------------------------


@pytest.fixture
def unsolved(monkeypatch):
    monkeypatch.setattr(place, "LARGEST_SOLVED", 0)


@pytest.mark.usefixtures("unsolved")
@pytest.mark.parametrize("shift", [0.0, 2.0, -2.0])
def test_the_estimate_of_a_deterministic_optimum_is_exact(shift):
    """What its own policy earns is Q* then; a shift is seen as what it is."""
    target = cr.planning.Target.of(MAZE)
    assert target.solution is None
    assert target.evaluation.method == "rollouts"
    found = cr.transfer.potential_quality(optimum(MAZE, shift), target)
    assert not found.exact
    assert found.excess == pytest.approx(shift, abs=1e-5)
    assert found.rank == pytest.approx(1.0, abs=0.01)  # equal but for rounding, it may be swapped
    if shift:
        assert found.optimistic == (shift > 0)
    best = cr.solve(MAZE, tolerance=1e-6)
    assert found.start == pytest.approx(best.start_value, abs=1e-5)
    assert np.isnan([found.right, found.largest_underestimate, target.optimum]).all()
    assert found.most_underestimated_state == -1


@pytest.mark.usefixtures("unsolved")
def test_the_estimate_counts_what_lies_beyond_a_cut():
    """A ring that pays -1 for ever is worth -10 at discount 0.9, though it is cut off at 5."""
    ring = cr.FiniteMDP.from_outcomes(
        [[[(1.0, 1, -1.0)]], [[(1.0, 0, -1.0)]]],
        terminal=[False, False],
        start=0,
        discount=0.9,
        time_limit=5,
    )
    phi = cr.StateActionPotential(ring, np.full((2, 1), -10.0))
    found = cr.transfer.potential_quality(phi, cr.planning.Target.of(ring))
    assert (found.excess, found.size) == pytest.approx((0.0, 10.0))


def test_a_discount_of_one_with_a_time_limit_is_estimated_too():
    """Not every policy ends, so there is no Q* without the limit."""
    maze = cr.GridWorld("S.T", discount=1.0, time_limit=10)
    target = cr.planning.Target.of(maze)
    assert target.solution is None
    phi = cr.StateActionPotential(maze, np.tile([0.0, 198.0, 0.0, 0.0], (3, 1)))
    found = cr.transfer.potential_quality(phi, target)
    assert (found.start, found.excess, found.size) == pytest.approx((198.0, -0.5, 198.5))


def test_a_large_pursuit_is_judged_along_its_way():
    """6.6 million pairs. The minimum bounds Q* from above, the maximum misses the other one."""
    hunt, chase = cr.Pursuit(8, 2, discount=0.9), cr.Pursuit(8, 1, discount=0.9)
    edges = [
        cr.Transfer("chase", "hunt", cr.project(hunt, chase, predator=name))
        for name in hunt.predator_names
    ]
    values, target = cr.solve(chase).action_values, cr.planning.Target.of(hunt, episodes=200)
    assert target.solution is None
    found = {
        g.__name__: cr.transfer.potential_quality(
            mapped_potential(hunt, edges, [values, values], g), target
        )
        for g in (cr.minimum, cr.mean, cr.maximum)
    }
    least, middle, most = found.values()
    assert not least.exact
    # -1 a step and a discount of 0.9 lose less than 10 in all.
    for one in (least, middle, most):
        assert -10 < one.start < -1
        assert 0 < one.size < 10
        assert 0.5 < one.optimistic <= 1
    assert 0 < least.excess < middle.excess < most.excess
    assert least.rank > most.rank
    assert min(least.start, middle.start) > most.start > target.random_return


def start(n, bits):
    return 1 + cr.tasks.integers(bits, n - 1)


def step(n, state, action, bits):
    place = (state + (1 if action == 1 else n - 1)) % n
    return place, -1.0, place == 0


def test_a_task_given_by_functions_is_judged_along_its_way():
    """A ring of 9 places, home is 0: a way of d steps is worth -(1 - 0.5^d) / 0.5."""
    n = 9
    space, moves = cr.Space([cr.Component("place", n)]), cr.Space([cr.Component("move", 2)])
    ring = cr.ComputedMDP(space, moves, start, step, data=n, discount=0.5)
    away = np.stack([np.arange(n), (n - np.arange(n)) % n], axis=1)
    q = -2 * (1 - 0.5**away)
    found = cr.transfer.potential_quality(
        cr.StateActionPotential(ring, q), cr.planning.Target.of(ring, episodes=100)
    )
    assert not found.exact
    assert (found.excess, found.rank) == pytest.approx((0.0, 1.0), abs=1e-9)
    found = cr.transfer.potential_quality(
        cr.StateActionPotential(ring, q - 1), cr.planning.Target.of(ring, episodes=100)
    )
    assert (found.excess, found.optimistic) == (pytest.approx(-1.0), 0.0)
    assert -2 < found.start < -1


# -- where an episode can get to -----------------------------------------------------------------


@st.composite
def graphs(draw):
    """Draw the tables of an MDP, outcomes of probability 0 and shared rows included."""
    n, a = draw(st.integers(1, 7)), draw(st.integers(1, 3))
    rows, width = draw(st.integers(1, 6)), draw(st.integers(1, 3))
    weight = draw(arrays(np.int64, (rows, width), elements=st.integers(0, 2)))
    weight[weight.sum(axis=1) == 0, 0] = 1
    terminal = draw(arrays(np.bool_, n))
    terminal[0] = False
    begins = draw(arrays(np.bool_, n)) & ~terminal
    begins[0] |= not begins.any()
    return cr.FiniteMDP(
        states=cr.Space([cr.Component("state", n)]),
        actions=cr.Space([cr.Component("action", a)]),
        outcome_row=draw(arrays(np.int64, (n, a), elements=st.integers(0, rows - 1))),
        probability=weight / weight.sum(axis=1, keepdims=True),
        next_state=draw(arrays(np.int64, (rows, width), elements=st.integers(0, n - 1))),
        reward=np.zeros((rows, width)),
        terminal=terminal,
        start=begins / begins.sum(),
        discount=0.5,
    )


@given(graphs(), st.data())
def test_what_can_be_reached_is_what_a_search_finds(mdp, data):
    shape = mdp.outcome_row.shape
    allowed = data.draw(st.none() | arrays(np.bool_, shape))
    found = reachable_states(
        mdp.start, mdp.terminal, mdp.outcome_row, mdp.probability, mdp.next_state, allowed
    )
    expected = naive_reach(mdp, np.ones(shape, bool) if allowed is None else allowed)
    assert set(np.flatnonzero(found).tolist()) == expected


def test_nothing_is_behind_an_end():
    """The pit in the middle ends the episode, so its far side is out of reach."""
    maze = cr.GridWorld(["SP.", "##T"])
    mdp = maze.mdp
    tables = mdp.start, mdp.terminal, mdp.outcome_row, mdp.probability, mdp.next_state
    assert np.flatnonzero(reachable_states(*tables)).tolist() == [0, 1]
