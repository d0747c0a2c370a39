"""What is done to a potential, or to trust in it, leaves the optimum alone: on random MDPs.

How close learning has to come: with the rate h / (h + n) after n updates, h = 5, and discount 1/2
the error of a value has a variance of h^2 / (2 h (1 - 1/2) - 1) / n = 6.25 / n times that of a
target r + gamma V*(s'), which is computed here. Each episode, of 4 steps at most, starts in any of
at most 3 live states and takes any of at most 3 actions with probability 1/6 or more, so that a
pair has at least 200,000 / 4 / 3 / 6 = 2,777 updates, less four standard deviations 2,500. Allowed
are 6 standard errors of that: 2e-9 a pair, 1e-6 for all examples of a test. What an initial value
was wrong by shrinks like n^(-h / 2) = 3e-9 in the end, but more slowly while the successors' values
are wrong too, for which 1e-5 of it is allowed; V* itself is known to 1e-8.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import assume, given, strategies as st
from hypothesis.extra.numpy import arrays

import curricle as cr
from curricle.learning.portfolio import SOURCE, Tally, add_turn, next_member
from curricle.tasks.kernel import compiled
from tests.oracle.conftest import play_portfolio_naively

STEPS, VISITS = 200_000, 2500
LEARNER = cr.QLearning(learning_rate=cr.learning.harmonic(half=5), epsilon=0.5)


@dataclass(frozen=True)
class Problem:
    """A small MDP that starts in any live state, and its optimum."""

    task: cr.FiniteMDP
    optimum: np.ndarray  # (S, A)
    noise: float  # the largest standard deviation of r + gamma V*(s') over pairs

    def allowed(self, potential):
        """Return how far learning may end from the optimum."""
        wrong = abs(potential.values - self.optimum).max()
        return 6 * np.sqrt(6.25 / VISITS) * self.noise + 1e-5 * (wrong + 20) + 1e-7


@st.composite
def problems(draw):
    live, actions = draw(st.integers(1, 3)), draw(st.integers(2, 3))
    shape = (live + 1, actions, live + 1)
    weights = draw(arrays(np.int64, shape, elements=st.integers(0, 3)))
    sure = draw(arrays(np.int64, shape[:2], elements=st.integers(0, live)))
    weights[np.arange(live + 1)[:, None], np.arange(actions), sure] += 1
    p = weights / weights.sum(axis=2, keepdims=True)
    # Odd rewards: no discounted sum of some is 0.
    r = draw(arrays(np.int64, shape, elements=st.sampled_from([-5, -3, -1, 1, 3, 5])))
    terminal = np.arange(live + 1) == live
    start = ~terminal / live
    task = cr.FiniteMDP.from_dense(p, r, terminal=terminal, start=start, discount=0.5, time_limit=4)
    optimum = cr.solve(task).action_values
    outcome = r + 0.5 * optimum.max(axis=1)
    mean = (p * outcome).sum(axis=2, keepdims=True)
    variance = (p * (outcome - mean) ** 2).sum(axis=2)[~terminal].max()
    return Problem(task, optimum, float(np.sqrt(variance)))


@st.composite
def potentials(draw, problem):
    """Draw what misleads: the optimum negated, too pessimistic, too optimistic, or anything."""
    kind = draw(st.sampled_from(["negated", "pessimistic", "optimistic", "one state", "any"]))
    q = problem.optimum
    if kind == "any":
        values = draw(arrays(np.int64, q.shape, elements=st.integers(-30, 30)))
    elif kind == "one state":
        values = q.copy()
        values[draw(st.integers(0, len(q) - 2))] -= 100
    else:
        values = {"negated": -10 * q, "pessimistic": q - 100, "optimistic": q + 100}[kind]
    return cr.StateActionPotential(problem.task, values)


def learnt(problem, potential, seed=0):
    return cr.learn(
        problem.task,
        LEARNER,
        STEPS,
        seeds=[seed],
        shaping=cr.QInitialisation(potential),
        eval_freq=STEPS // 50,
        workers=1,
    )


@given(problems(), st.data(), st.integers(0, 1000))
def test_q_initialisation_finds_the_optimum_whatever_the_potential(problem, data, seed):
    phi = data.draw(potentials(problem))
    result = learnt(problem, phi, seed)
    assert abs(result.values[0] - problem.optimum).max() <= problem.allowed(phi)


portfolios = st.builds(cr.Portfolio, margin=st.floats(0, 2), optimist=st.floats(0.1, 0.85))


@st.composite
def sure_tasks(draw):
    """Draw a task without chance but in its start, and rewards of very different size."""
    live, actions = draw(st.integers(1, 5)), draw(st.integers(2, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    shape = live + 1, actions
    p = np.zeros((*shape, live + 1))
    np.put_along_axis(p, rng.integers(0, live + 1, (*shape, 1)), 1.0, axis=2)
    scale = rng.choice([1e-3, 1.0, 1e3])
    r = np.broadcast_to((scale * rng.integers(-5, 6, shape))[..., None], p.shape)
    terminal = np.arange(live + 1) == live
    return cr.FiniteMDP.from_dense(
        p,
        r,
        terminal=terminal,
        start=~terminal / live,
        discount=draw(st.sampled_from([0.0, 0.5, 0.9])),
        time_limit=4,  # so that each start is met again
    )


@given(sure_tasks(), portfolios, st.integers(0, 2**32))
def test_without_chance_a_portfolio_finds_the_optimum_whatever_the_potential(task, portfolio, seed):
    """The optimist's values never fall below Q*, and its rate is 1.

    Unless phi is what is returned, which turns from lucky starts may bring about.
    """
    rng = np.random.default_rng(seed)
    phi = rng.choice([1e-3, 1.0, 1e3]) * rng.normal(size=task.mdp.outcome_row.shape)
    shaping = cr.QInitialisation(phi, portfolio=portfolio)
    result = cr.learn(task, budget=20_000, seeds=[seed % 100], shaping=shaping, eval_freq=20_000)
    solution = cr.solve(task)
    best = float(task.mdp.start @ solution.values)
    size = 1 + abs(solution.action_values).max()
    exact = cr.evaluate(task, greedy_policy(task, result.values[0]))
    if result.source_share[0, -1] == 1:
        np.testing.assert_array_equal(result.values[0, :-1], phi[:-1])
        return
    assert float(task.mdp.start @ exact.values) == pytest.approx(best, abs=1e-6 * size)


def greedy_policy(task, values):
    """Return the greedy policy, (S, A), with ties shared."""
    best = values == values.max(axis=1, keepdims=True)
    return best / best.sum(axis=1, keepdims=True)


@given(sure_tasks(), st.floats(0.0, 2.0), st.integers(0, 2**32))
def test_the_informed_optimist_never_falls_below_the_optimum(task, error, seed):
    """The theorem: without chance, where phi is wrong by at most the margin."""
    rng, optimum = np.random.default_rng(seed), cr.solve(task).action_values
    live = ~task.mdp.terminal
    wrong = error * (1 + abs(optimum).max()) * rng.uniform(-1, 1, optimum.shape)
    phi = np.where(live[:, None], optimum + wrong, 0.0)
    spread = np.ptp(phi[live])
    margin = abs(wrong[live]).max() / spread if spread > 0 else 0.0
    assume(spread > 0 or not wrong[live].any())
    above, rounding = [], 1e-9 * (1 + abs(optimum).max())

    def seen(tables):
        above.append((tables[0] - optimum)[live].min())

    portfolio, bounds = cr.Portfolio(margin=margin * (1 + 1e-12)), cr.learning.value_bounds(task)
    play_portfolio_naively(task, 300, phi, portfolio, bounds=bounds, eval_freq=300, seen=seen)
    assert min(above) >= -rounding


def _turns(shares, tally, turns, acted):
    """Play turns of given lengths and returns, (E, 2); note who acted."""
    acting = SOURCE
    for i in range(len(turns)):
        acted[i] = acting
        add_turn(tally, acting, turns[i, 0], turns[i, 1])
        acting = next_member(shares, tally)


@given(portfolios, st.integers(1, 400), st.sampled_from([1, 10, 200]), st.integers(0, 2**32))
def test_each_member_acts_for_its_share_of_the_steps(portfolio, n, longest, seed):
    """The theorem of :class:`Portfolio`, for any returns and lengths."""
    rng, acted = np.random.default_rng(seed), np.zeros(n, np.uint64)
    lengths = rng.integers(1, longest + 1, n)
    turns = np.column_stack([lengths, rng.choice([0.0, 1.0, -3.0, 1e6], n)])
    compiled(_turns, False)(portfolio.shares, Tally.empty(), turns, acted)
    steps = np.cumsum(lengths)
    for member, share in enumerate(portfolio.shares):
        taken = np.cumsum(lengths * (acted == member))
        assert (taken >= share * (0.8 * steps - 3 * longest) - 1e-9).all()


@given(problems(), st.data(), st.integers(0, 1000))
def test_values_are_in_the_tasks_own_rewards_whatever_shaped_them(problem, data, seed):
    """What is transferred is Q* of the task."""
    phi = data.draw(potentials(problem))
    state = phi.to_state()
    of_states = cr.StateActionPotential(
        problem.task, np.repeat(state.values.T, problem.optimum.shape[1], axis=1)
    )
    result = cr.learn(
        problem.task,
        LEARNER,
        STEPS,
        seeds=[seed],
        shaping=cr.StateShaping(state),
        eval_freq=STEPS,
        workers=1,
    )
    assert abs(result.values[0] - problem.optimum).max() <= problem.allowed(of_states)
    assert result.own_rewards.all()


@given(problems(), st.data())
def test_values_that_contain_what_shaping_added_say_so(problem, data):
    phi = data.draw(potentials(problem))
    assert not cr.learn(problem.task, budget=10, shaping=cr.RewardBonus(phi)).own_rewards.any()
    assert cr.learn(problem.task, budget=10, shaping=cr.RewardBonus()).own_rewards.all()
    state = phi.to_state()
    frames = np.concatenate([state.values, 2 * state.values])
    for changing in (
        replace(state, weight=cr.learning.linear(1.0, 0.5, steps=STEPS)),
        replace(state, values=frames, frame_steps=(0, 5)),
    ):
        assert not cr.learn(problem.task, budget=10, shaping=cr.StateShaping(changing)).own_rewards
