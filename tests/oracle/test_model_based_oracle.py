"""R-max agrees with plain Python, bit for bit: its model, its plans and its draws."""

from collections import defaultdict

import numpy as np
import pytest

import curricle as cr
from curricle.learning import RMax
from curricle.learning.learners import value_bounds
from curricle.tasks.kernel import integers, splitmix64, stream_start, uniform
from tests.support.tasks import random_mdp

MASK, STRIDE = 2**64 - 1, 0x9E3779B97F4A7C15


def tie(row, bits):
    """Return one of the highest actions of a row."""
    best = [action for action, value in enumerate(row) if value == max(row)]
    return best[integers(bits * 0xD1342543DE82EF95 & MASK, len(best))]


class NaivePlan:
    """A table planned in a model; a change of a state waits until its turn to be propagated."""

    def __init__(self, q, model, learner, discount, key, backups):
        self.q, self.model, self.learner, self.discount = q.tolist(), model, learner, discount
        self.backups = backups
        low, self.highest = learner.value_range
        self.least = (self.highest - low) * max(1e-6, 1e-3 * (1 - discount))
        self.greedy = [tie(row, splitmix64(key ^ splitmix64(s))) for s, row in enumerate(self.q)]
        self.propagated = [self.value(state) for state in range(len(q))]
        self.queue = []

    def value(self, state):
        return min(self.highest, max(self.q[state]))

    def set(self, state, action, target, bits):
        row = self.q[state]
        old, best = row[action], max(row)
        row[action] = new = old + (target - old)
        if new > best:
            self.greedy[state] = action
        elif best in (old, new) if new != old else self.greedy[state] == action:
            self.greedy[state] = tie(row, bits)
        if abs(self.value(state) - self.propagated[state]) > self.least:
            self.queue += [state] if state not in self.queue else []

    def back_up(self, state, action, bits):
        visits, reward, counts = self.model[state, action]
        following = 0.0
        for after in reversed(counts):  # the newest outcome first
            following += counts[after] * self.propagated[after]
        self.set(state, action, reward + self.discount * (following / visits), bits)

    def sweep(self, bits):
        done = 0
        while done < self.backups and self.queue:
            after = self.queue.pop(0)
            change = self.value(after) - self.propagated[after]
            self.propagated[after] = self.value(after)
            for state, action in self.model["to", after]:
                done += 1
                visits, _, counts = self.model[state, action]
                if visits >= self.learner.min_visits:
                    share = self.discount * counts[after] / visits
                    bits_of = splitmix64(bits ^ splitmix64(state))
                    self.set(state, action, self.q[state][action] + share * change, bits_of)


def r_max(task, learner, steps, seed, phi=None, backups=20):
    """Return what `learn` returns, and how often each pair was tried."""
    mdp, learner = task.mdp, learner.for_task(task)
    low, high = learner.value_range
    hoped, q = np.full((2, *mdp.outcome_row.shape), [[[high]], [[learner.initial_value]]])
    if phi is not None:
        margin = 0.1 * np.ptp(phi[~mdp.terminal])
        hoped = np.clip(phi + margin, low, high)
    hoped[mdp.terminal] = q[mdp.terminal] = 0.0
    counter = stream_start(seed, "")
    model = defaultdict(list)
    settings = model, learner, mdp.discount, splitmix64(counter), backups
    plans = acting, sober = NaivePlan(hoped, *settings), NaivePlan(q, *settings)
    state, length = None, 0
    for _ in range(steps):
        if state is None:
            counter, length = (counter + STRIDE) & MASK, 0
            chance = uniform(splitmix64(counter))
            state = int((np.cumsum(mdp.start) > chance).argmax())
        counter = (counter + STRIDE) & MASK
        bits, action = splitmix64(counter), acting.greedy[state]
        if (bits >> 32) / 2**32 < (0.1 if learner.epsilon is None else learner.epsilon):
            action = integers(bits, len(acting.q[state]))
        row = mdp.outcome_row[state, action]
        total = np.cumsum(mdp.probability[row])
        total[np.flatnonzero(mdp.probability[row])[-1] :] = 1.0
        outcome = int((total > uniform(splitmix64(bits))).argmax())
        after, reward = int(mdp.next_state[row, outcome]), float(mdp.reward[row, outcome])
        visits, mean, counts = model[state, action] or (0, 0.0, {})
        model[state, action] = visits + 1, mean + (reward - mean) / (visits + 1), counts
        if not mdp.terminal[after]:
            if after not in counts:
                model["to", after].insert(0, (state, action))
            counts[after] = counts.get(after, 0) + 1
        if visits + 1 >= learner.min_visits:
            for plan in plans:
                plan.back_up(state, action, bits)
                plan.sweep(bits)
        length += 1
        ends = mdp.terminal[after] or length == mdp.time_limit
        state = None if ends else after
    return np.array(sober.q), np.array(acting.q), model


LEARNERS = {
    "default": RMax(),
    "once": RMax(min_visits=1),
    "greedy": RMax(epsilon=0.0, min_visits=3),
    "given range": RMax(value_range=(-30, 20), initial_value=1.0),
}


@pytest.mark.parametrize("name", LEARNERS)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("width", [1, 3])
def test_values(name, seed, width):
    task = random_mdp(seed, width=width, n_states=8, time_limit=7)
    result = cr.learn(task, LEARNERS[name], 400, seeds=[seed])
    np.testing.assert_array_equal(result.values[0], r_max(task, LEARNERS[name], 400, seed)[0])


@pytest.mark.parametrize("seed", range(3))
def test_untried_pairs_of_the_table_that_is_acted_on_start_above_phi(seed):
    task = random_mdp(seed, n_states=8, time_limit=7)
    phi = cr.StateActionPotential(task, np.random.default_rng(seed).normal(size=(8, 3)) * 9)
    result = cr.learn(task, RMax(), 90, seeds=[seed], shaping=cr.QInitialisation(phi))
    naive = r_max(task, RMax(), 90, seed, phi.values)[0]
    np.testing.assert_array_equal(result.values[0], naive)
    assert (naive != r_max(task, RMax(), 90, seed)[0]).any()


@pytest.mark.parametrize("seed", range(4))
def test_without_chance_the_tables_are_bounds_of_the_optimal_values(seed):
    """A pair's model is exact after one visit; untried pairs have bounds; backups are monotone."""
    task = random_mdp(seed, width=1, n_states=8, time_limit=20)
    best, slack = cr.solve(task), 1e-9 * np.ptp(value_bounds(task))
    for steps in (10, 50, 400):
        sober, hoped, _ = r_max(task, RMax(), steps, seed)
        assert (sober <= best.action_values + best.error_bound + slack).all()
        assert (hoped >= best.action_values - best.error_bound - slack).all()


@pytest.mark.parametrize("seed", range(4))
def test_both_tables_solve_the_learnt_model(seed):
    """Each is within its error of the fixed point of its Bellman equation."""
    task = random_mdp(seed, n_states=8, discount=0.9)
    low, high = value_bounds(task)
    learner = RMax()
    sober, hoped, model = r_max(task, learner, 2000, seed, backups=1000)
    for q, untried in ((sober, low), (hoped, high)):
        solved = np.where(task.mdp.terminal[:, None], 0.0, np.full(q.shape, untried))
        for _ in range(400):
            values = np.minimum(solved.max(axis=1), high)
            for state, action in np.ndindex(q.shape):
                visits, reward, counts = model[state, action] or (0, 0.0, {})
                if visits >= learner.min_visits:
                    after = sum(n * values[s] for s, n in counts.items()) / visits
                    solved[state, action] = reward + 0.9 * after
        # What is not propagated of a state is 1e-4 of the range, hence 1e-3 of it in all.
        assert np.abs(q - solved).max() <= 1e-3 * (high - low)
