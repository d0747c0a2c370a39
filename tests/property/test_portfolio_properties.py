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
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

import curricle as cr
from curricle.learning.portfolio import SOURCE, Tally, Turn, next_turn
from curricle.tasks.kernel import compiled, splitmix64

STEPS, VISITS = 200_000, 2500
LEARNER = cr.QLearning(learning_rate=cr.learning.harmonic(half=5), epsilon=0.5)


@dataclass(frozen=True)
class Problem:
    """A small MDP that starts in any live state, and its optimum."""

    task: cr.FiniteMDP
    optimum: np.ndarray  # (S, A)
    noise: float  # the largest standard deviation of r + gamma V*(s') over pairs

    def allowed(self, potential, portfolio=None):
        """Return how far learning may end from the optimum.

        In a portfolio the learner that explores acts in one of `longest_rest` turns at least, and
        an optimist's rate forgets more slowly how far its start was wrong, by 20 at most.
        """
        wrong = abs(potential.values - self.optimum).max()
        rest, forgot = (1, 1e-5) if portfolio is None else (portfolio.longest_rest, 1e-2)
        return 6 * np.sqrt(6.25 * rest / VISITS) * self.noise + forgot * (wrong + 20) + 1e-7


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


portfolios = st.builds(
    cr.Portfolio,
    first_turns=st.integers(2, 50),
    memory=st.integers(2, 50),
    longest_rest=st.integers(2, 9),
)


def learnt(problem, potential, portfolio=None, seed=0):
    return cr.learn(
        problem.task,
        LEARNER,
        STEPS,
        seeds=[seed],
        shaping=cr.QInitialisation(potential, portfolio=portfolio),
        eval_freq=STEPS // 50,
        workers=1,
    )


@given(problems(), portfolios, st.data(), st.integers(0, 1000))
def test_a_portfolio_finds_the_optimum_whatever_the_potential(problem, portfolio, data, seed):
    phi = data.draw(potentials(problem))
    result = learnt(problem, phi, portfolio, seed)
    share = result.source_share[0]
    assert share[0] == 0.5
    assert ((share >= 0) & (share <= 1)).all()
    # The optimist's rate, (H + 1) / (H + n) with H + 1 <= 5, is at most that of the learner.
    assert abs(result.values[0] - problem.optimum).max() <= problem.allowed(phi, portfolio)


def _turns(portfolio, tally, turns, acted):
    """Play turns of given first states, lengths and returns, (E, 5); note who acted."""
    acting = SOURCE
    for i in range(len(turns)):
        acted[i] = acting
        turn = Turn(acting, np.uint64(turns[i, 0]), turns[i, 1], turns[i, 2 + acting])
        acting = next_turn(portfolio, tally, turn, splitmix64(np.uint64(turns[i, 4])))


@st.composite
def adversaries(draw):
    """Draw lengths and returns that follow no task: what each learner gets in its turns."""
    n = draw(st.integers(1, 400))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    lengths = rng.integers(1, draw(st.sampled_from([2, 10, 200])), n)
    returns = rng.choice([0.0, 1.0, -3.0, 1e6], (n, 2)) if draw(st.booleans()) else None
    if returns is None:
        drift = draw(st.sampled_from([-1.0, 0.0, 1.0])) * np.linspace(-1, 1, n)
        returns = rng.normal(size=(n, 2)) + np.stack([drift, -drift], axis=1)
    return np.column_stack([lengths, returns])


@given(portfolios, adversaries())
def test_each_learner_acts_in_any_turns_of_the_longest_rest(portfolio, turns):
    """The theorem of :class:`Portfolio`, for any returns and lengths."""
    acted = np.zeros(len(turns), np.uint64)
    rng = np.random.default_rng(len(turns))
    turns = np.column_stack(
        [rng.integers(0, 3, len(turns)), turns, rng.integers(0, 99, len(turns))]
    )
    compiled(_turns, False)(portfolio.kernel, Tally.empty(3), turns, acted)
    rest = portfolio.longest_rest
    for first in range(len(acted) - rest + 1):
        assert 0 < acted[first : first + rest].sum() < rest
    before = acted[: portfolio.first_turns] if portfolio.first_turns < rest else acted[:0]
    assert (acted[: len(before)] == SOURCE).sum() <= 5  # its first turns, while others have theirs


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
