"""Two learners under a guard, in plain Python: slow and obvious, draw for draw as compiled."""

import math
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np

import curricle as cr
from curricle.learning.schedules import schedule
from curricle.tasks.kernel import stream_start

from .conftest import (
    draw_best,
    pick,
    pick_action,
    plain_sum,
    policy_mean,
    random_bits,
    splitmix64,
    uniform,
    value_of,
)


@dataclass
class NaiveLearner:
    """One of the two: its tables, and what its shaping adds."""

    task: cr.FiniteMDP
    learner: object
    shaping: object
    tables: list = field(init=False)
    before: float = 0.0  # phi(s, a) of the step before
    choice: tuple = ()

    def __post_init__(self):
        mdp = self.task.mdp
        start = np.zeros(mdp.outcome_row.shape)
        if isinstance(self.shaping, cr.QInitialisation | cr.LookAheadAdvice):
            start += self.shaping.potential.values
        start[~mdp.terminal] += self.learner.initial_value
        n = 2 if isinstance(self.learner, cr.DoubleQLearning) else 1
        self.tables = [start.copy() for _ in range(n)]

    def acting(self, state, step):
        rows = [q[state].tolist() for q in self.tables]
        row = rows[0] if len(rows) == 1 else [0.5 * (x + y) for x, y in zip(*rows, strict=True)]
        if isinstance(self.shaping, cr.DecayingAdvice):
            weight = value_of(self.shaping.weight, step)
            phi = self.shaping.potential.values[state].tolist()
            row = [x + weight * y for x, y in zip(row, phi, strict=True)]
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
            return float(self.shaping.potential.values[state, action])
        if isinstance(self.shaping, cr.LookBackAdvice):
            here, before = float(self.shaping.potential.values[state, action]), self.before
            self.before = here
            return (0.0 if ended else here) - before / gamma
        return 0.0

    def learn(self, state, action, reward, after, ended, step, rate, coin, draw):
        """Update by one step; SARSA draws what this learner would do next."""
        which, gamma = coin & 1, self.task.mdp.discount
        q = self.tables[which]
        target = reward + self.added(state, action, after, ended, step)
        if not ended:
            shown = self.acting(after, step + 1)
            row = q[after].tolist()
            if isinstance(self.learner, cr.SARSA):
                self.choice = pick_action(shown, self.learner, step + 1, draw)
                worth = row[self.choice[0]]
            elif isinstance(self.learner, cr.ExpectedSARSA):
                worth = policy_mean(row, shown, self.learner, step + 1)
            elif isinstance(self.learner, cr.DoubleQLearning):
                worth = float(self.tables[1 - which][after, draw_best(row, coin)[0]])
            else:
                worth = max(row)
            target += gamma * worth
        q[state, action] += rate * (target - q[state, action])


@dataclass
class NaiveGuard:
    """Which of the two acts; 0 has no potential. `log` has a row for each turn that has ended."""

    guard: cr.Guard
    returns: tuple = ((), ())
    credit: list = field(default_factory=lambda: [0.0, 0.0])
    share: float = 0.5
    acting: int = 1
    log: list = field(default_factory=list)

    def mean_and_error(self, earned):
        """Return a weighted mean and the square of its standard error."""
        mean = variance = squares = 0.0
        for n, x in enumerate(earned, start=1):
            part = max(1.0 / self.guard.memory, 1.0 / n)
            deviation = x - mean
            mean += part * deviation
            variance = (1.0 - part) * (variance + part * deviation * deviation)
            squares = (1.0 - part) * (1.0 - part) * squares + part * part
        return mean, variance / (1.0 / squares - 1.0)

    def end_turn(self, length, earned):
        ahead = self.share > 0.5
        self.log.append((self.acting, ahead, length))
        if min(map(len, self.returns)) >= 2:
            self.credit[ahead] += self.share * length
            self.credit[ahead] -= length * (self.acting == 1)
        self.returns = tuple(
            (*r, earned) if i == self.acting else r for i, r in enumerate(self.returns)
        )
        n = [len(r) for r in self.returns]
        if min(n) < 2:
            self.acting = 1 if n[1] <= n[0] else 0
            return
        (plain, error), (shaped, other) = map(self.mean_and_error, self.returns)
        gain, both = shaped - plain, error + other
        chance = 0.5
        if gain > 0:
            chance += 0.5 * gain / math.sqrt(2.0 * both + gain * gain)
        if chance > 0.5:
            self.share = min(chance, self.guard.share_ahead)
        else:
            self.share = self.guard.share_behind
        self.acting = 1 if self.credit[self.share > 0.5] > 0 else 0


def learn_guarded_naively(task, learner, steps, shaping, *, eval_freq, turn=math.inf, seed=0):
    """Return values, curves and turns of one seed; a turn lasts `turn` steps at most."""
    mdp, guard = task.mdp, NaiveGuard(shaping.guard)
    limit, rates = mdp.time_limit or math.inf, schedule(learner.learning_rate)
    both = [NaiveLearner(task, learner, None), NaiveLearner(task, learner, shaping)]
    visits = np.zeros((2, *mdp.outcome_row.shape), int)
    draw = random_bits(stream_start(seed, ""))
    fresh, episodes, returns, used = True, 0, [], 0
    training, shares, counts = [math.nan], [guard.share], [0]
    for step in range(steps):
        if fresh:
            state, length, total = pick(mdp.start.tolist(), uniform(next(draw))), 0, 0.0
            for one in both:
                one.before = 0.0
        if used == 0:
            earned, factor = 0.0, 1.0
        one = both[guard.acting]
        if fresh or not isinstance(learner, cr.SARSA):
            one.choice = pick_action(one.acting(state, step), learner, step, draw)
        action, bits = one.choice
        row = mdp.outcome_row[state, action]
        outcome = pick(mdp.probability[row].tolist(), uniform(splitmix64(bits)))
        after, reward = int(mdp.next_state[row, outcome]), float(mdp.reward[row, outcome])
        ended = bool(mdp.terminal[after])
        coin = next(draw) if isinstance(learner, cr.DoubleQLearning) else 0
        counted = visits[coin & 1, state, action] if rates.shape == 3 else step
        rate = value_of(rates, int(counted))
        visits[coin & 1, state, action] += 1
        for each in both:
            each.learn(state, action, reward, after, ended, step, rate, coin, draw)
        length, total, used, state = length + 1, total + reward, used + 1, after
        earned, factor = earned + factor * reward, factor * mdp.discount
        fresh = ended or length >= limit
        if fresh:
            episodes += 1
            returns.append(total)
        if fresh or used >= turn:
            guard.end_turn(used, earned)
            used = 0
        if (step + 1) % eval_freq == 0:
            training.append(plain_sum(returns) / len(returns) if returns else math.nan)
            shares.append(guard.share)
            counts.append(episodes)
            returns = []
    ahead = both[guard.share > 0.5]
    values = np.mean(ahead.tables, axis=0)
    if isinstance(ahead.shaping, cr.StateShaping):
        values += np.array([ahead.state_potential(s, steps) for s in range(len(values))])[:, None]
    return SimpleNamespace(
        values=values,
        training_return=training,
        guard_share=shares,
        episodes=counts,
        turns=[*guard.log, (guard.acting, guard.share > 0.5, used)],
        ahead=guard.share > 0.5,
    )
