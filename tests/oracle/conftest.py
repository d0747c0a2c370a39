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


def pick_action(values, learner, step, draw, take=None, *, bold=False):
    """Return an action and the bits that its outcome, or a tie, is drawn with.

    A bold learner is greedy, but draws as the others do.
    """
    n = len(values)
    if bold:
        _, bits = pick_action(values, learner, step, draw, take)
        return take(values) if take else draw_best(values, bits)[0], bits
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
        q[state, action] += rate * (target - q[state, action])
        if isinstance(self.learner, OptimisticQLearning):
            hoped = reward + (0.0 if ended else gamma * min(self.highest, max(shown)))
            self.hoped[state, action] += rate * (hoped - self.hoped[state, action])

    def values(self, step):
        values = np.mean(self.tables, axis=0)
        if isinstance(self.shaping, cr.StateShaping):
            phi = [self.state_potential(state, step) for state in range(len(values))]
            return values + np.array(phi)[:, None]
        return values + self.shaping.potential.values if self.literal else values


@dataclass
class NaivePortfolio:
    """Which of the two acts; 1 is the source's. `log` has a row for each turn that has ended."""

    settings: cr.Portfolio
    turns: list = field(default_factory=list)  # (who acted, first state, length, return, score)
    share: float = 0.5
    acting: int = 1

    @property
    def horizon(self):
        """Return the exponential mean of the turns' lengths."""
        mean = 0.0
        for n, (_, _, length, *_) in enumerate(self.turns, start=1):
            mean += max(1.0 / n, 0.02) * (length - mean)
        return mean

    def mean_and_error(self, member):
        """Return a weighted mean and the square of its standard error."""
        mean = variance = squares = n = 0.0
        for total, (acting, *_, score) in enumerate(self.turns, start=1):
            if acting == member:
                n += 1.0
                part = 1.0 / min(n, max(self.settings.memory, total / 10.0))
                deviation = score - mean
                mean += part * deviation
                variance = (variance + part * deviation * deviation) * (1.0 - part)
                squares = (1.0 - part) * (1.0 - part) * squares + part * part
        return mean, variance / (1.0 / squares - 1.0)

    def typical(self, start):
        """Return the mean return of turns from a state; of all turns from a new state."""
        alike = [t for t in self.turns if t[1] == start] or self.turns
        mean = 0.0
        for n, (_, _, _, earned, _) in enumerate(alike, start=1):
            mean += max(1.0 / n, 0.05) * (earned - mean)
        return mean

    def end_turn(self, start, length, earned, draw):
        chance = uniform(next(draw))
        score = earned - self.typical(start) if self.turns else 0.0
        self.turns.append((self.acting, start, length, earned, score))
        acted = [turn[0] for turn in self.turns]
        n = [acted.count(0), acted.count(1)]
        if min(n) >= 2:
            (other, error), (source, noise) = map(self.mean_and_error, (0, 1))
            gain, both = source - other, error + noise
            self.share = 0.5 if gain == 0 else float(gain > 0)
            if both > 0:
                self.share = 0.5 * math.erfc(-gain / math.sqrt(2.0 * both))
        recent, first = acted[-(self.settings.longest_rest - 1) :], self.settings.first_turns
        if len(acted) >= self.settings.longest_rest - 1 and len({*recent}) == 1:
            self.acting = 1 - recent[0]
        elif n[1] < 5 and (n[1] * first <= n[0] * 5 or n[0] >= first):
            self.acting = 1
        elif n[0] < first:
            self.acting = 0
        else:
            self.acting = int(chance < self.share)


def learn_naively(task, learner, steps, *, shaping=None, literal=False, eval_freq=None, seed=0,
                  stream="", episodes=math.inf, turn=math.inf, bounds=None):  # fmt: skip
    """Return what `learn` does for one seed, without the greedy evaluation.

    In a portfolio, whose turns last `turn` steps at most, a second learner is beside: an optimist
    with these bounds of its values, or the learner without the shaping.
    """
    mdp, several = task.mdp, shaping is not None and shaping.portfolio is not None
    optimist = isinstance(learner, OptimisticQLearning)
    if optimist:
        learner = replace(learner.for_task(task), epsilon=learner.epsilon or 0.0)
    limit, rates = mdp.time_limit or math.inf, schedule(learner.learning_rate)
    portfolio = NaivePortfolio(shaping.portfolio) if several else None
    beside = learner
    if bounds:
        beside = OptimisticQLearning(value_range=bounds, initial_value=bounds[0])
    other = NaiveLearner(task, beside)
    learners = [*[other] * several, NaiveLearner(task, learner, shaping, literal)]
    visits = np.zeros((2, *mdp.outcome_row.shape), int)  # of tables 0 and 1
    start = stream_start(seed, stream)
    draw, ties = random_bits(start), [None, None]
    plain = shaping is None or isinstance(shaping, cr.QInitialisation | cr.LookAheadAdvice)
    if optimist or (isinstance(learner, cr.QLearning) and (not several or (bounds and plain))):
        n = len(mdp.start)
        bits = Ties(2 * n, splitmix64(start)).bits
        ties = [Ties(0, 0), Ties(0, 0)]
        ties[-1].bits, ties[0].bits = bits[:n], bits[n:]
        ties = ties if several else ties[-1:]
    eval_freq = eval_freq or max(1, steps // 100)
    training, shares, counts = [math.nan], [portfolio.share if several else math.nan], [0]
    fresh, step, ended_episodes, returns, used = True, 0, 0, [], 0
    while step < steps and ended_episodes < episodes:
        if fresh:
            state, length, total = pick(mdp.start.tolist(), uniform(next(draw))), 0, 0.0
        if used == 0:
            earned, factor, begin = 0.0, 1.0, state
        acting = portfolio.acting if several else 0
        actor = learners[acting]
        bold = several and isinstance(actor.learner, OptimisticQLearning)
        shown = actor.acting(state, step)
        if fresh or bold or not isinstance(learner, cr.SARSA):
            take = ties[acting] and partial(ties[acting].take, state)
            actor.choice = pick_action(shown, learner, step, draw, take, bold=bold)
        action, bits = actor.choice
        row = mdp.outcome_row[state, action]
        outcome = pick(mdp.probability[row].tolist(), uniform(splitmix64(bits)))
        after, reward = int(mdp.next_state[row, outcome]), float(mdp.reward[row, outcome])
        ended = bool(mdp.terminal[after])
        coin = next(draw) if isinstance(learner, cr.DoubleQLearning) else 0
        counted = visits[coin & 1, state, action] if rates.shape == 3 else step
        rate = value_of(rates, int(counted))
        visits[coin & 1, state, action] += 1
        for naive, tied in zip(learners, ties, strict=False):
            before = naive.acting(state, step)
            how = rate, coin
            if several and isinstance(naive.learner, OptimisticQLearning):
                horizon = portfolio.horizon or float(used + 1)
                met = int(visits[:, state, action].sum())
                how = (horizon + 1.0) / (horizon + met), 0
            naive.learn(state, action, reward, after, ended, step, *how, draw)
            if tied:
                tied.update(before, naive.acting(state, step), state, action, bits)
        step, length, total, used = step + 1, length + 1, total + reward, used + 1
        earned, factor, state = earned + factor * reward, factor * mdp.discount, after
        fresh = ended or length >= limit
        if fresh:
            ended_episodes += 1
            returns.append(total)
        if several and (fresh or used >= turn):
            portfolio.end_turn(begin, used, earned, draw)
            used = 0
        if step % eval_freq == 0:
            training.append(plain_sum(returns) / len(returns) if returns else math.nan)
            shares.append(portfolio.share if several else math.nan)
            counts.append(ended_episodes)
            returns = []
    ahead = several and portfolio.share > 0.5
    return SimpleNamespace(
        values=learners[ahead if several else 0].values(step),
        training_return=np.array(training),
        source_share=np.array(shares),
        episodes=np.array(counts),
        steps_used=step,
        episodes_used=ended_episodes,
        turns=portfolio.turns if several else [],
        ahead=ahead,
    )


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
