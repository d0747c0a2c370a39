"""The guarded loop against two learners in plain Python, draw for draw."""

import math

import numpy as np
import pytest

import curricle as cr
from curricle.learning.guard import FADING, MIN_EPISODES, Guard
from curricle.tasks.draws import stream_start

from .conftest import draw_best, integers, pick, plain_sum, random_bits, splitmix64, uniform


def guarded_naively(task, learner, steps, potential, guard, *, eval_freq, seed=0):
    """Return both tables, who is ahead, and what is written down at the checkpoints."""
    mdp = task.mdp
    gamma, limit, rate = mdp.discount, mdp.time_limit or math.inf, learner.learning_rate
    n_states, n_actions = mdp.outcome_row.shape
    tables = [np.zeros((n_states, n_actions)), potential.values.copy()]
    tables[0][~mdp.terminal] += learner.initial_value
    tables[1][~mdp.terminal] += learner.initial_value
    draw = random_bits(stream_start(seed, ""))
    mean, variance, seen, acted = [0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]
    squares = [0.0, 0.0]
    ahead = acting = 1
    share, fresh, episodes, returns = guard.share, True, 0, []
    training, guard_share, counts = [math.nan], [share], [0]
    for step in range(1, steps + 1):
        if fresh:
            state, length, total = pick(mdp.start.tolist(), uniform(next(draw))), 0, 0.0
            discounted, weight = 0.0, 1.0
        bits = next(draw)
        if (bits >> 32) / 2**32 < learner.epsilon:
            action = integers(bits, n_actions)
        else:
            action = draw_best(tables[acting][state].tolist(), bits)[0]
        row = mdp.outcome_row[state, action]
        outcome = pick(mdp.probability[row].tolist(), uniform(splitmix64(bits)))
        after, reward = int(mdp.next_state[row, outcome]), float(mdp.reward[row, outcome])
        ended = bool(mdp.terminal[after])
        for q in tables:
            target = reward + (0.0 if ended else gamma * q[after].max())
            q[state, action] += rate * (target - q[state, action])
        length, total, state = length + 1, total + reward, after
        discounted, weight = discounted + weight * reward, weight * gamma
        fresh = ended or length >= limit
        if fresh:
            episodes += 1
            returns.append(total)
            part = max(1.0 / guard.memory, 1.0 / (seen[acting] + 1.0))
            surprise = discounted - mean[acting]
            mean[acting] += part * surprise
            variance[acting] = (1.0 - part) * (variance[acting] + part * surprise * surprise)
            squares[acting] = (1.0 - part) * (1.0 - part) * squares[acting] + part * part
            seen[acting] += 1.0
            if min(seen) >= MIN_EPISODES:
                gap = mean[1] - mean[0]
                ahead = 1 if gap >= 0.0 else 0
                freedoms = [1.0 / one - 1.0 for one in squares]
                first, second = (v / n for v, n in zip(variance, freedoms, strict=True))
                both, z = first + second, guard.standard_errors
                freedom = 1.0
                if both > 0.0:
                    of = first / both
                    freedom = 1.0 / (of * of / freedoms[0] + (1 - of) * (1 - of) / freedoms[1])
                z = z * (8.0 * freedom + 3.0) / (8.0 * freedom + 1.0)
                if gap * gap > both * freedom * math.expm1(z * z / freedom):
                    share += guard.pace * (
                        (1.0 - guard.min_share if ahead else guard.min_share) - share
                    )
            acted[acting] += length
            acting = 1 if acted[1] <= share * (acted[0] + acted[1]) else 0
            acted = [FADING * x for x in acted]
        if step % eval_freq == 0:
            training.append(plain_sum(returns) / len(returns) if returns else math.nan)
            guard_share.append(share)
            counts.append(episodes)
            returns = []
    return tables, ahead, training, guard_share, counts


@pytest.mark.parametrize("seed", range(5))
def test_guarded_learning_equals_the_naive_one(seed, random_mdp, random_shaping):
    task = random_mdp(seed, time_limit=[None, 6][seed % 2])
    guard = Guard(share=0.6, min_share=0.2, pace=0.3, standard_errors=0.5, memory=7)
    learner = cr.QLearning(learning_rate=0.3, epsilon=0.3, initial_value=0.5)
    shaping = random_shaping(task, cr.QInitialisation, seed, guard=guard)
    result = cr.learn(task, learner, 3000, shaping=shaping, eval_freq=100, seeds=[seed])
    tables, ahead, training, guard_share, counts = guarded_naively(
        task, learner, 3000, shaping.potential, guard, eval_freq=100, seed=seed
    )
    np.testing.assert_array_equal(result.values[0], tables[ahead])
    np.testing.assert_array_equal(result.training_return[0], training)
    np.testing.assert_array_equal(result.guard_share[0], guard_share)
    np.testing.assert_array_equal(result.episodes[0], counts)
    assert len(set(guard_share)) > 5  # the comparison moved


def test_guard_share_is_not_a_number_without_a_guard():
    assert np.isnan(cr.learn(cr.GridWorld("S.T"), budget=100).guard_share).all()


def test_the_table_handed_on_is_the_one_evaluated_last(random_mdp, random_shaping):
    task = random_mdp(3, time_limit=10)
    result = cr.learn(
        task,
        budget=2000,
        eval_freq=100,
        seeds=4,
        shaping=random_shaping(task, cr.QInitialisation, guard=Guard()),
    )
    for values, last in zip(result.values, result.greedy_return[:, -1], strict=True):
        phi = cr.StateActionPotential(task, values)
        again = cr.learn(task, cr.QLearning(learning_rate=0.0), 1, shaping=cr.QInitialisation(phi))
        assert again.greedy_return[0, 0] == pytest.approx(last, abs=1e-12)
