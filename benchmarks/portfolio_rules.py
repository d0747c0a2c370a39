"""Rules of a portfolio compared in plain loops, beside weights by Bellman errors (QAvatar).

    python -m benchmarks.portfolio_rules --seeds 10

Development pairs only: the constants of the library's portfolio were fitted here. Scores are mean
discounted training returns, as shares of the way from the random policy (0) to the optimum (1).
"""

# ruff: noqa: NPY002 - compiled code draws from the legacy generator

import argparse
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numba import njit

import curricle as cr
from benchmarks.pairs import Pair
from benchmarks.pairs.pair import default
from benchmarks.portfolio import chosen, level
from curricle.learning import value_bounds
from curricle.learning.portfolio import longest_turn
from curricle.tasks.mdp import tables

SCRATCH, SOURCE, OPTIMIST, PESSIMIST, WEIGHTED = range(5)
PARTS, RATE, EPSILON = 20, 0.1, 0.1


class Rule(NamedTuple):
    """How the next learner is drawn; the last member is the source's."""

    first: float = 40.0  # turns of the other members before they are compared
    first_of_source: float = 5.0
    memory: float = 50.0
    rest: float = 100.0
    by_start: bool = True  # whether returns are compared with others from the same state


RULES = {
    "optimist": ((OPTIMIST,), Rule()),
    "source": ((SOURCE,), Rule()),
    "scratch": ((SCRATCH,), Rule()),
    "portfolio": ((OPTIMIST, SOURCE), Rule()),
    "no rest": ((OPTIMIST, SOURCE), Rule(rest=1e12)),
    "20 turns": ((OPTIMIST, SOURCE), Rule(first=20.0)),
    "2 turns": ((OPTIMIST, SOURCE), Rule(first=2.0, first_of_source=2.0)),
    "40 and 40": ((OPTIMIST, SOURCE), Rule(first_of_source=40.0)),
    "plain returns": ((OPTIMIST, SOURCE), Rule(by_start=False)),
    "with scratch": ((SCRATCH, OPTIMIST, SOURCE), Rule()),
    "with pessimist": ((PESSIMIST, OPTIMIST, SOURCE), Rule()),
    "no optimist": ((SCRATCH, SOURCE), Rule()),
    "QAvatar": ((WEIGHTED,), Rule()),
}


@njit(nogil=True)
def best_of(values):
    """Return a best action, ties broken at random."""
    ties = np.flatnonzero(values == values.max())
    return ties[np.random.randint(len(ties))]


@njit(nogil=True)
def mixed(q, phi, off, phi_off):
    """Return Q and phi weighted by each other's Bellman errors."""
    weight = (off + 1e-12) / (off + phi_off + 2e-12)
    return (1 - weight) * q + weight * phi


@njit(nogil=True)
def play(task, phi, bounds, kinds, rule, turn, seed, steps):
    """Return the mean discounted return of the episodes in each part of the steps."""
    row, probability, after, rewards, terminal, start, discount, limit = task
    np.random.seed(seed)
    n, (n_states, n_actions) = len(kinds), phi.shape
    q = np.zeros((n, n_states, n_actions))
    for k in range(n):
        if kinds[k] == SOURCE:
            q[k] = phi
        elif kinds[k] in (OPTIMIST, PESSIMIST):
            q[k] = bounds[1] if kinds[k] == OPTIMIST else bounds[0]
        for s in range(n_states):
            if terminal[s]:
                q[k, s] = 0.0
    visits, off = np.zeros((n_states, n_actions)), np.ones((n_states, n_actions))
    phi_off, typical, starts = np.zeros_like(off), np.zeros(n_states + 1), np.zeros(n_states + 1)
    turns, last, mean, variance, squares = np.zeros((5, n))
    training, number = np.zeros(PARTS), np.zeros(PARTS)
    horizon, acting, total, fresh = 0.0, n - 1, 0, True
    state, first_state, length, used = 0, 0, 0, 0
    returned, factor, earned, turn_factor = 0.0, 1.0, 0.0, 1.0
    for step in range(steps):
        if fresh:
            state = min(
                np.searchsorted(np.cumsum(start), np.random.random(), side="right"), n_states - 1
            )
            length, returned, factor = 0, 0.0, 1.0
        first_state = state if used == 0 else first_state
        kind = kinds[acting]
        values = q[acting, state]
        if kind == WEIGHTED:
            values = mixed(values, phi[state], off[state], phi_off[state])
        action = best_of(values)
        if kind != OPTIMIST and np.random.random() < EPSILON:
            action = np.random.randint(n_actions)
        place = row[state, action]
        chance = np.cumsum(probability[place])
        outcome = min(np.searchsorted(chance, np.random.random(), side="right"), len(chance) - 1)
        there, reward = after[place, outcome], rewards[place, outcome]
        ended = terminal[there]
        visits[state, action] += 1
        length, used = length + 1, used + 1
        returned, factor = returned + factor * reward, factor * discount
        earned, turn_factor = earned + turn_factor * reward, turn_factor * discount
        mean_length = horizon if total > 0 else float(used)
        for k in range(n):
            best = q[k, there].max()
            if kinds[k] == OPTIMIST:
                best = min(best, bounds[1])
            change = reward + (0.0 if ended else discount * best) - q[k, state, action]
            rate = RATE
            if kinds[k] == OPTIMIST:
                rate = (mean_length + 1) / (mean_length + visits[state, action])
            if kinds[k] == WEIGHTED:
                hoped = reward + (0.0 if ended else discount * phi[there].max())
                part = max(RATE, 1 / visits[state, action])
                gap = abs(hoped - phi[state, action])
                phi_off[state, action] += part * (gap - phi_off[state, action])
                off[state, action] += part * (abs(change) - off[state, action])
            q[k, state, action] += rate * change
        state, fresh = there, ended or length >= limit
        if fresh:
            training[step * PARTS // steps] += returned
            number[step * PARTS // steps] += 1
        if not fresh and used < turn:
            continue
        score, total = earned, total + 1
        if rule.by_start:
            known = first_state if starts[first_state] > 0 else n_states
            score = earned - typical[known] if starts[known] > 0 else 0.0
            for s in (first_state, n_states):
                starts[s] += 1
                typical[s] += max(1 / starts[s], 0.05) * (earned - typical[s])
        horizon += max(1 / total, 0.02) * (used - horizon)
        turns[acting], last[acting] = turns[acting] + 1, total
        part = 1 / min(turns[acting], max(rule.memory, total / 10))
        gap = score - mean[acting]
        mean[acting] += part * gap
        variance[acting] = (1 - part) * (variance[acting] + part * gap * gap)
        squares[acting] = (1 - part) ** 2 * squares[acting] + part * part
        used, earned, turn_factor = 0, 0.0, 1.0
        due = np.full(n, rule.first)
        due[n - 1] = rule.first_of_source
        if n == 1:
            continue
        if (last <= total - rule.rest + 1).any():
            acting = last.argmin()
        elif (turns < due).any():
            acting = n - 1 - (turns / due)[::-1].argmin()
        else:
            error = np.sqrt(variance / (1 / squares - 1))
            acting = (mean + error * np.random.normal(0.0, 1.0, n)).argmax()
    return training, number


def played(pair: Pair, seeds: int) -> dict[str, float]:
    """Return the score of each rule in a pair."""
    curriculum, mdp = default(pair), tables(pair.target)
    source = curriculum.train(seeds, only="source", workers=1)["source"]
    potentials = curriculum.potentials("target", {"source": source})
    random, optimum = level(pair.target)
    limit = int(mdp.time_limit or 10**9)
    task = (mdp.outcome_row, mdp.probability, mdp.next_state, mdp.reward, mdp.terminal)
    task += (mdp.start, mdp.discount, limit)
    turn, bounds = longest_turn(mdp.discount, limit), value_bounds(pair.target)
    scores = {}
    for name, (kinds, rule) in RULES.items():
        curves = []
        for seed, phi in enumerate(potentials):
            values = np.array(cr.StateActionPotential(pair.target, phi.values).values)
            how = bounds, np.array(kinds), rule, turn, seed, pair.target_budget
            total, number = play(task, values, *how)
            last = random
            for k in range(PARTS):
                last = total[k] / number[k] if number[k] else last
                curves.append(last)
        scores[name] = float((np.mean(curves) - random) / (optimum - random))
    return scores


def main() -> None:
    """Print what each rule gains over scratch, and loses to the best of its members alone."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    settings = parser.parse_args()
    with ProcessPoolExecutor(2) as pool:
        work: Any = pool.map(partial(played, seeds=settings.seeds), chosen("development"))
        rows = list(work)
    table = {name: np.array([row[name] for row in rows]) for name in RULES}
    best = np.max([table[name] for name in ("scratch", "source", "optimist")], axis=0)
    print(f"{'':16}{'gain':>8}{'kept':>8}{'worst loss':>12}{'> .1':>10}")
    for name, scores in table.items():
        gain, loss = (scores - table["scratch"]).mean(), best - scores
        kept = gain / (best - table["scratch"]).mean()
        print(f"{name:16}{gain:8.2f}{kept:8.0%}{loss.max():12.2f}{(loss > 0.1).sum():10d}")


if __name__ == "__main__":
    main()
