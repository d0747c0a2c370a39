"""A slow, obvious learner in plain Python: draws and sums in the order of the compiled loops."""

import math
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

import curricle as cr
from curricle.learning.schedules import schedule
from curricle.tasks.kernel import stream_start
from tests import tasks

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
            return integers(bits, n), bits
        return (take(values) if take else draw_best(values, bits)[0]), bits
    beta = value_of(exploring(learner), step)
    weights = [math.exp(beta * (v - max(values))) for v in values]
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
    if learner.inverse_temperature is None:
        weights = [1.0 if v == best else 0.0 for v in acting]
    else:
        weights = [math.exp(parameter * (v - best)) for v in acting]
    total = plain_sum(w * q for w, q in zip(weights, row, strict=True))
    if learner.inverse_temperature is not None:
        return total / plain_sum(weights)
    mean = plain_sum(q / len(row) for q in row)
    return (1.0 - parameter) * total / plain_sum(weights) + parameter * mean


def learn_naively(task, learner, steps, *, shaping=None, literal=False, eval_freq=None, seed=0,
                  stream="", episodes=math.inf):  # fmt: skip
    """Return what `learn` does for one seed, without the greedy evaluation.

    `literal` look-ahead advice keeps Q apart from phi and adds F = gamma phi(s', a*) - phi(s, a)
    to the reward, a* = argmax Q + phi (for SARSA the action taken, for Expected SARSA the mean).
    """
    mdp = task.mdp
    gamma, terminal, limit = mdp.discount, mdp.terminal.tolist(), mdp.time_limit or math.inf
    starts, row_of = mdp.start.tolist(), mdp.outcome_row.tolist()
    chance, successor = mdp.probability.tolist(), mdp.next_state.tolist()
    pay = mdp.reward.tolist()
    n_states, n_actions = mdp.outcome_row.shape
    kind, rates = type(learner).__name__, schedule(learner.learning_rate)
    potential = None if shaping is None else shaping.potential
    phi = None if potential is None else potential.values.tolist()
    starts_at_phi = not literal and isinstance(shaping, cr.QInitialisation | cr.LookAheadAdvice)
    start = stream_start(seed, stream)
    draw = random_bits(start)
    tables = [
        [[0.0 if terminal[s] else learner.initial_value for _ in range(n_actions)]
         for s in range(n_states)]
        for _ in range(2 if kind == "DoubleQLearning" else 1)
    ]  # fmt: skip
    if starts_at_phi:
        for q in tables:
            for s in range(n_states):
                q[s] = [x + y for x, y in zip(q[s], phi[s], strict=True)]
    visits = [[[0] * n_actions for _ in range(n_states)] for _ in tables]

    def frame_at(state, step):
        held = [i for i, first in enumerate(potential.frame_steps) if first <= step]
        return value_of(potential.weight, step) * phi[held[-1]][state]

    def acting(state, step):
        row = list(tables[0][state])
        if len(tables) == 2:
            row = [0.5 * (x + y) for x, y in zip(row, tables[1][state], strict=True)]
        if isinstance(shaping, cr.DecayingAdvice) or literal:
            weight = 1.0 if literal else value_of(shaping.weight, step)
            row = [x + weight * y for x, y in zip(row, phi[state], strict=True)]
        return row

    ties = Ties(n_states, splitmix64(start)) if kind == "QLearning" else None
    eval_freq = eval_freq or max(1, steps // 100)
    training_return, episode_counts = [math.nan], [0]
    step = episode = 0
    returns, fresh, next_action = [], True, None
    while step < steps and episode < episodes:
        if fresh:
            state, length, total, before = pick(starts, uniform(next(draw))), 0, 0.0, 0.0
        if fresh or kind != "SARSA":
            take = ties and partial(ties.take, state)
            action, bits = pick_action(acting(state, step), learner, step, draw, take)
        else:
            action = next_action
        row = row_of[state][action]
        outcome = pick(chance[row], uniform(splitmix64(bits)))
        after, reward = successor[row][outcome], pay[row][outcome]
        total += reward
        length += 1
        ended = terminal[after]

        if isinstance(shaping, cr.StateShaping):
            there = 0.0 if ended else frame_at(after, step + 1)
            reward += gamma * there - frame_at(state, step)
        elif isinstance(shaping, cr.LookBackAdvice):
            # The end's own term, gamma (0 - phi(s, a) / gamma), takes this step's phi(s, a) off.
            here = phi[state][action]
            reward += (0.0 if ended else here) - before / gamma
            before = here
        elif isinstance(shaping, cr.RewardBonus):
            reward += phi[state][action]

        coin = next(draw) if len(tables) == 2 else 0
        which = coin & 1  # tables 0 and 1 have visits of their own
        q, target = tables[which], reward
        if literal:
            target -= phi[state][action]
        if not ended:
            shown = acting(after, step + 1)
            if kind == "QLearning":
                best = shown.index(max(shown)) if literal else q[after].index(max(q[after]))
                worth = q[after][best] + (phi[after][best] if literal else 0.0)
            elif kind == "SARSA":
                next_action, bits = pick_action(shown, learner, step + 1, draw)
                worth = q[after][next_action] + (phi[after][next_action] if literal else 0.0)
            elif kind == "ExpectedSARSA":
                worth = policy_mean(q[after], shown, learner, step + 1)
                if literal:
                    worth += policy_mean(phi[after], shown, learner, step + 1)
            else:
                worth = tables[1 - which][after][draw_best(q[after], coin)[0]]
            target += gamma * worth
        counts = rates.shape == 3
        rate = value_of(rates, visits[which][state][action] if counts else step)
        visits[which][state][action] += 1
        shown = acting(state, step)
        q[state][action] += rate * (target - q[state][action])
        if ties:
            ties.update(shown, acting(state, step), state, action, bits)

        step += 1
        state = after
        fresh = ended or length >= limit
        if fresh:
            episode += 1
            returns.append(total)
        if step % eval_freq == 0:
            training_return.append(plain_sum(returns) / len(returns) if returns else math.nan)
            episode_counts.append(episode)
            returns = []

    values = np.mean(tables, axis=0)
    if isinstance(shaping, cr.StateShaping):
        values += np.array([frame_at(s, step) for s in range(n_states)])[:, None]
    elif literal:
        values += potential.values
    return SimpleNamespace(
        values=values,
        training_return=np.array(training_return),
        episodes=np.array(episode_counts),
        steps_used=step,
        episodes_used=episode,
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
