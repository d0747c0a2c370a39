"""Slow, obvious learners in plain Python: they draw and sum in the order of the compiled loops."""

import math
from dataclasses import dataclass, field, replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

import curricle as cr
from curricle.learning import OptimisticQLearning
from curricle.learning.schedules import schedule
from curricle.tasks.kernel import stream_start
from tests.support import tasks

MASK, STRIDE = 2**64 - 1, 0x9E3779B97F4A7C15


def splitmix64(z):
    """Mix 64 bits (SplitMix64)."""
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
    return z ^ (z >> 31)


def random_bits(start):
    """Yield 64 random bits at a time."""
    while True:
        start = (start + STRIDE) & MASK
        yield splitmix64(start)


def uniform(bits):
    return (bits >> 11) / 2**53


def integers(bits, n):
    return ((bits & 0xFFFFFFFF) * n) >> 32


def value_of(schedule, n):
    """Return a schedule's value after n steps, from its four numbers."""
    shape, first, last, span = schedule
    if shape == 0:
        return first
    if shape == 1:
        return first + (last - first) * min(1.0, n / span)
    if shape == 2:
        return last + (first - last) * 0.5 ** (n / span)
    return last + (first - last) / (1.0 + n / span)


def exploring(learner):
    """Return the schedule of epsilon or of the inverse temperature."""
    if learner.inverse_temperature is not None:
        return schedule(learner.inverse_temperature)
    return schedule(0.1 if learner.epsilon is None else learner.epsilon)


def plain_sum(numbers):
    """Add from left to right; the built-in compensates for rounding since Python 3.12."""
    total = 0.0
    for number in numbers:
        total += number
    return total


def pick(probabilities, u):
    """Return the first index whose cumulative probability exceeds u; the last possible has 1."""
    last = max(i for i, p in enumerate(probabilities) if p > 0)
    total = 0.0
    for i, p in enumerate(probabilities):
        total += p
        if i == last or u < total:
            return i
    raise AssertionError


def draw_best(values, bits):
    """Return an action of highest value, each equally likely, and how many there are."""
    best = [a for a, v in enumerate(values) if v == max(values)]
    return best[integers(bits * 0xD1342543DE82EF95, len(best))], len(best)


class Ties:
    """Draws among tied actions as Q-learning does: one visit ahead."""

    def __init__(self, n_states, key):
        self.bits = [splitmix64(key ^ splitmix64(s)) for s in range(n_states)]

    def take(self, state, row):
        return draw_best(row, self.bits[state])[0]

    def update(self, before, after, state, action, bits):
        old, new, best = before[action], after[action], max(before)
        if best in (old, new) if new != old else self.take(state, before) == action:
            self.bits[state] = bits


def pick_action(values, learner, step, draw, take=None):
    """Return an action and the bits that its outcome, or a tie, is drawn with."""
    n = len(values)
    if learner.inverse_temperature is None:
        bits = next(draw)
        if (bits >> 32) / 2**32 < value_of(exploring(learner), step):
            action = integers(bits, n)
            available = [a for a, v in enumerate(values) if v > -math.inf]
            if action not in available:
                action = available[integers(splitmix64(bits ^ (2**64 - 1)), len(available))]
            return action, bits
        return (take(values) if take else draw_best(values, bits)[0]), bits
    beta = value_of(exploring(learner), step)
    weights = [math.exp(beta * (v - max(values))) if v > -math.inf else 0.0 for v in values]
    for _ in range(n):  # rejection first, the full row after n failures
        bits = next(draw)
        action = integers(bits, n)
        if (bits >> 32) / 2**32 < weights[action]:
            return action, next(draw)
    left, chosen = uniform(next(draw)) * plain_sum(weights), None
    for action, weight in enumerate(weights):
        if weight > 0 and (chosen is None or left >= 0):
            chosen, left = action, left - weight
    return chosen, next(draw)


def policy_mean(row, acting, learner, step):
    """Return sum_a pi(a) row[a] for the policy followed on the acting values."""
    parameter, best = value_of(exploring(learner), step), max(acting)
    available = [a for a, v in enumerate(acting) if v > -math.inf]
    row, acting = [row[a] for a in available], [acting[a] for a in available]
    if learner.inverse_temperature is None:
        weights = [1.0 if v == best else 0.0 for v in acting]
    else:
        weights = [math.exp(parameter * (v - best)) for v in acting]
    total = plain_sum(w * q for w, q in zip(weights, row, strict=True))
    if learner.inverse_temperature is not None:
        return total / plain_sum(weights)
    mean = plain_sum(q / len(row) for q in row)
    return (1.0 - parameter) * total / plain_sum(weights) + parameter * mean


@dataclass
class NaiveLearner:
    """A learner: its tables, and what its shaping adds.

    `literal` look-ahead advice keeps Q apart from phi and adds F = gamma phi(s', a*) - phi(s, a)
    to the reward, a* = argmax Q + phi (for SARSA the action taken, for Expected SARSA the mean).
    """

    task: cr.FiniteMDP
    learner: object
    shaping: object = None
    literal: bool = False
    tables: list = field(init=False)
    choice: tuple = ()
    cautious: bool = False  # in its rate of the values that are evaluated beside optimistic ones

    def __post_init__(self):
        mdp = self.task.mdp
        start = np.zeros(mdp.outcome_row.shape)
        at_phi = isinstance(self.shaping, cr.QInitialisation | cr.LookAheadAdvice)
        if at_phi and not self.literal:
            start += self.shaping.potential.values
        n = 2 if isinstance(self.learner, cr.DoubleQLearning) else 1
        values = [self.learner.initial_value] * n
        if isinstance(self.learner, OptimisticQLearning):
            self.highest = self.learner.value_range[1]
            values.append(self.highest)
        self.tables = [np.where(mdp.terminal[:, None], start, start + value) for value in values]
        for q in self.tables:
            q[mdp.random_policy == 0] = -math.inf
        if isinstance(self.learner, OptimisticQLearning):
            self.hoped = self.tables.pop()  # what it acts on

    def phi(self, state):
        return self.shaping.potential.values[state].tolist()

    def acting(self, state, step):
        if isinstance(self.learner, OptimisticQLearning):
            return self.hoped[state].tolist()
        rows = [q[state].tolist() for q in self.tables]
        row = rows[0] if len(rows) == 1 else [0.5 * (x + y) for x, y in zip(*rows, strict=True)]
        if self.literal:
            row = [x + y for x, y in zip(row, self.phi(state), strict=True)]
        return row

    def state_potential(self, state, step):
        phi = self.shaping.potential
        held = [i for i, first in enumerate(phi.frame_steps) if first <= step]
        return value_of(phi.weight, step) * float(phi.values[held[-1], state])

    def added(self, state, action, after, ended, step):
        """Return what shaping adds to the reward of the step number `step` + 1."""
        gamma = self.task.mdp.discount
        if isinstance(self.shaping, cr.StateShaping):
            there = 0.0 if ended else self.state_potential(after, step + 1)
            return gamma * there - self.state_potential(state, step)
        if isinstance(self.shaping, cr.RewardBonus):
            return self.phi(state)[action]
        return -self.phi(state)[action] if self.literal else 0.0

    def learn(self, state, action, reward, after, ended, step, rate, coin, draw):
        """Update by one step; SARSA draws what this learner would do next."""
        which, gamma = coin & 1, self.task.mdp.discount
        q = self.tables[which]
        target = reward + self.added(state, action, after, ended, step)
        if not ended:
            shown, row = self.acting(after, step + 1), q[after].tolist()
            phi = self.phi(after) if self.literal else [0.0] * len(row)
            if isinstance(self.learner, cr.SARSA):
                self.choice = pick_action(shown, self.learner, step + 1, draw)
                worth = row[self.choice[0]] + phi[self.choice[0]]
            elif isinstance(self.learner, cr.ExpectedSARSA):
                worth = policy_mean(row, shown, self.learner, step + 1)
                worth += policy_mean(phi, shown, self.learner, step + 1)
            elif isinstance(self.learner, cr.DoubleQLearning):
                worth = float(self.tables[1 - which][after, draw_best(row, coin)[0]])
            else:
                best = shown.index(max(shown)) if self.literal else row.index(max(row))
                worth = row[best] + phi[best]
            target += gamma * worth
        cautious = min(rate, 0.3) if self.cautious else rate
        q[state, action] += cautious * (target - q[state, action])
        if isinstance(self.learner, OptimisticQLearning):
            hoped = reward + (0.0 if ended else gamma * min(self.highest, max(shown)))
            self.hoped[state, action] += rate * (hoped - self.hoped[state, action])

    def values(self, step):
        values = np.mean(self.tables, axis=0)
        if isinstance(self.shaping, cr.StateShaping):
            phi = [self.state_potential(state, step) for state in range(len(values))]
            return values + np.array(phi)[:, None]
        return values + self.shaping.potential.values if self.literal else values


def learn_naively(task, learner, steps, *, shaping=None, literal=False, eval_freq=None, seed=0,
                  stream="", episodes=math.inf):  # fmt: skip
    """Return what `learn` does for one seed, without the greedy evaluation."""
    mdp, optimist = task.mdp, isinstance(learner, OptimisticQLearning)
    if optimist:
        learner = replace(learner.for_task(task), epsilon=learner.epsilon or 0.0)
    limit, rates = mdp.time_limit or math.inf, schedule(learner.learning_rate or 0.0)
    naive = NaiveLearner(task, learner, shaping, literal)
    visits = np.zeros((2, *mdp.outcome_row.shape), int)  # of tables 0 and 1
    horizon, outcomes = naive_horizon(mdp), {}
    start = stream_start(seed, stream)
    draw, ties = random_bits(start), None
    if optimist or isinstance(learner, cr.QLearning):
        ties = Ties(len(mdp.start), splitmix64(start))
    eval_freq = eval_freq or max(1, steps // 100)
    curves, agreement = NaiveCurves(), []
    fresh, step = True, 0
    while step < steps and curves.all_episodes < episodes:
        if fresh:
            state, length, total = pick(mdp.start.tolist(), uniform(next(draw))), 0, 0.0
            first = state
        if optimist and step % eval_freq == 0:
            low, high = learner.value_range
            apart = max(naive.hoped[first]) - max(naive.tables[0][first])
            agreement.append(1.0 - apart / (high - low))
        shown = naive.acting(state, step)
        if fresh or not isinstance(learner, cr.SARSA):
            naive.choice = pick_action(
                shown, learner, step, draw, ties and partial(ties.take, state)
            )
        action, bits = naive.choice
        reward, after, ended = played(mdp, state, action, bits)
        coin = next(draw) if isinstance(learner, cr.DoubleQLearning) else 0
        counted = visits[coin & 1, state, action] if rates.shape == 3 else step
        visits[coin & 1, state, action] += 1
        if learner.learning_rate is None:
            if outcomes.setdefault((state, action), (after, reward)) != (after, reward):
                naive.cautious = True
            n = visits[0, state, action]
            rate = (horizon + 1) / (horizon + n) if naive.cautious else 1.0
        else:
            rate = value_of(schedule(learner.learning_rate), int(counted))
        before = naive.acting(state, step)
        naive.learn(state, action, reward, after, ended, step, rate, coin, draw)
        if ties:
            ties.update(before, naive.acting(state, step), state, action, bits)
        step, length, total, state = step + 1, length + 1, total + reward, after
        fresh = ended or length >= limit
        if fresh:
            curves.returns.append(total)
        if step % eval_freq == 0:
            curves.note()
    measured = {"agreement": np.array(agreement), "steps_used": step}
    return curves.result(values=naive.values(step), **measured)


def naive_horizon(mdp):
    discounted = 1 / (1 - mdp.discount) if mdp.discount < 1 else math.inf
    return max(1.0, min(mdp.time_limit or math.inf, discounted))


def played(mdp, state, action, bits):
    """Return a step's reward, its next state, and whether that is terminal."""
    row = mdp.outcome_row[state, action]
    outcome = pick(mdp.probability[row].tolist(), uniform(splitmix64(bits)))
    after = int(mdp.next_state[row, outcome])
    return float(mdp.reward[row, outcome]), after, bool(mdp.terminal[after])


@dataclass
class NaiveCurves:
    """Returns of episodes by checkpoint."""

    training: list = field(default_factory=lambda: [math.nan])
    counts: list = field(default_factory=lambda: [0])
    returns: list = field(default_factory=list)

    @property
    def all_episodes(self):
        return self.counts[-1] + len(self.returns)

    def note(self):
        returns = self.returns
        self.training.append(plain_sum(returns) / len(returns) if returns else math.nan)
        self.counts.append(self.all_episodes)
        self.returns = []

    def result(self, **more):
        episodes = {"episodes": np.array(self.counts), "episodes_used": self.all_episodes}
        return SimpleNamespace(training_return=np.array(self.training), **episodes, **more)


INFORMED, OPTIMIST, SOBER, SOURCE = range(4)


@dataclass
class NaiveTurns:
    """The turns of a portfolio, by member: (length, discounted return)."""

    shares: tuple
    turns: list = field(default_factory=lambda: [[], [], [], []])

    def steps(self, member):
        return sum(length for length, _ in self.turns[member])

    def mean_and_error(self, member):
        """Return a weighted mean and the square of its standard error."""
        mean = variance = squares = 0.0
        for n, (_, earned) in enumerate(self.turns[member], start=1):
            part = 1.0 / min(n, 10.0)
            deviation = earned - mean
            mean += part * deviation
            variance = (variance + part * deviation * deviation) * (1.0 - part)
            squares = (1.0 - part) * (1.0 - part) * squares + part * part
        return mean, variance / (1.0 / squares - 1.0)

    @property
    def ahead(self):
        """Return whether the source's policy is ahead."""
        if min(len(self.turns[SOURCE]), len(self.turns[SOBER])) < 5:
            return False
        (sober, error), (source, noise) = map(self.mean_and_error, (SOBER, SOURCE))
        return source - sober > math.sqrt(error + noise)

    @property
    def next(self):
        """Return who acts the next turn."""
        total = sum(map(self.steps, range(4)))
        for member in (SOURCE, SOBER):
            if len(self.turns[member]) < 5 and self.steps(member) <= 0.1 * total:
                return member
        return min(range(4), key=lambda member: self.steps(member) / self.shares[member])


def play_portfolio_naively(
    task, steps, phi, portfolio, *, bounds, eval_freq, seed=0, seen=lambda tables: None
):
    """Return what `learn` does with a portfolio for one seed, without the greedy evaluation.

    `phi`, (S, A), is NaN where unknown. Without `bounds` the lowest rewards so far lower the sober
    learner's values, by `floor`. `seen` gets the members' values after each step.
    """
    mdp, least, floor = task.mdp, [0.0, 0.0], 0.0
    gamma, limit = mdp.discount, mdp.time_limit or math.inf
    horizon = naive_horizon(mdp)
    longest = limit if gamma == 1 or limit * (1 - gamma) <= 10 else round(3 / (1 - gamma))
    values, known = np.nan_to_num(phi), phi[~mdp.terminal]
    spread = np.nanmax(known) - np.nanmin(known)
    lowest, highest = bounds or (-math.inf, np.nanmax(known) + 3.0 * spread)
    cut = highest if bounds else math.inf
    informed = np.clip(phi + portfolio.margin * spread, lowest, highest)
    sober = lowest if bounds else 0.0
    tables = [np.where(np.isnan(phi), highest, informed), highest, sober, values]
    tables = [np.where(mdp.terminal[:, None], 0.0 * values, table) for table in tables]
    for table in tables:
        table[mdp.random_policy == 0] = -math.inf
    shares = (1.0 - portfolio.optimist - 2 * 0.05, portfolio.optimist, 0.05, 0.05)
    turns, curves, shown = NaiveTurns(shares), NaiveCurves(), [0.0]
    visits, outcomes = np.zeros(phi.shape, int), {}
    start, n = stream_start(seed, ""), len(mdp.start)
    draw, bits = random_bits(start), Ties(4 * n, splitmix64(start)).bits
    ties = [Ties(0, 0), Ties(0, 0)]
    ties[0].bits, ties[1].bits = bits[:n], bits[n : 2 * n]
    fresh, step, acting, noisy, used, earned, factor = True, 0, SOURCE, False, 0, 0.0, 1.0
    while step < steps:
        if fresh:
            state, length, total = pick(mdp.start.tolist(), uniform(next(draw))), 0, 0.0
        bits, row = next(draw), tables[acting][state].tolist()
        action = ties[acting].take(state, row) if acting < SOBER else draw_best(row, bits)[0]
        reward, after, ended = played(mdp, state, action, bits)
        visits[state, action] += 1
        noisy |= outcomes.setdefault((state, action), (after, reward)) != (after, reward)
        rate = (horizon + 1) / (horizon + visits[state, action]) if noisy else 1.0
        if not bounds and reward < least[ended]:
            least[ended] = reward
            floor = (horizon - 1) * least[False] + min(least)
        targets = []
        for member, most in ((INFORMED, cut), (OPTIMIST, cut), (SOBER, math.inf)):
            below = floor if member == SOBER else 0.0
            worth = 0.0 if ended else gamma * (min(most, tables[member][after].max()) + below)
            targets.append(reward - below + worth)
        for member in (INFORMED, OPTIMIST):
            before, old = tables[member][state].tolist(), tables[member][state, action]
            tables[member][state, action] = old + rate * (targets[member] - old)
            ties[member].update(before, tables[member][state].tolist(), state, action, bits)
        if acting < SOBER:
            old, cautious = tables[SOBER][state, action], min(rate, 0.3) if noisy else 1.0
            tables[SOBER][state, action] = old + cautious * (targets[SOBER] - old)
        seen(tables)
        step, length, total, used = step + 1, length + 1, total + reward, used + 1
        earned, factor, state = earned + factor * reward, factor * gamma, after
        fresh = ended or length >= limit
        if fresh or used >= longest:
            turns.turns[acting].append((used, earned))
            acting, used, earned, factor = turns.next, 0, 0.0, 1.0
        if fresh:
            curves.returns.append(total)
        if step % eval_freq == 0:
            curves.note()
            shown.append(float(turns.ahead))
    live = ~mdp.terminal[:, None]
    learnt = tables[SOURCE] if turns.ahead else tables[SOBER] + np.where(live, floor, 0.0)
    return curves.result(values=learnt, source_share=np.array(shown), turns=turns, floor=floor)


@pytest.fixture(scope="session")
def random_mdp():
    return tasks.random_mdp


@pytest.fixture(scope="session")
def naive_learn():
    return learn_naively


@pytest.fixture(scope="session")
def random_shaping():
    """Return a shaping of a kind, its potential with real values."""

    def make(task, kind, seed=0, **extra):
        rng = np.random.default_rng([seed, 1])
        n_states, n_actions = task.mdp.outcome_row.shape
        if kind is cr.StateShaping:
            frames = len(extra.get("frame_steps", (0,)))
            return kind(cr.StatePotential(task, rng.normal(size=(frames, n_states)), **extra))
        return kind(cr.StateActionPotential(task, rng.normal(size=(n_states, n_actions))), **extra)

    return make
