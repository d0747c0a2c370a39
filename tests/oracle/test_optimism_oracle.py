"""The optimistic learner agrees with plain Python."""

import math

import numpy as np
import pytest

import curricle as cr
from curricle.learning import OptimisticQLearning, harmonic
from curricle.tasks.kernel import stream_start
from tests.oracle.conftest import Ties, pick, random_bits, splitmix64, uniform

LEARNERS = {
    "default": OptimisticQLearning(),
    "epsilon": OptimisticQLearning(epsilon=0.2, learning_rate=0.3),
    "harmonic rate": OptimisticQLearning(learning_rate=harmonic(0.8, half=3)),
    "given range": OptimisticQLearning(value_range=(-3, 2), initial_value=1.0),
}


def bounds(mdp):
    """Return the lowest and highest value of an MDP with discount below 1, pair by pair."""
    on, last = [], []
    for s, a in np.ndindex(*mdp.outcome_row.shape):
        row = mdp.outcome_row[s, a]
        for p, after, r in zip(
            mdp.probability[row], mdp.next_state[row], mdp.reward[row], strict=True
        ):
            if p > 0 and not mdp.terminal[s]:
                (last if mdp.terminal[after] else on).append(float(r))
    steps = 1 / (1 - mdp.discount)
    low = min(steps * min(on), (steps - 1) * min(0, *on) + min(last))
    return low, max(steps * max(on), (steps - 1) * max(0, *on) + max(last))


def explored_naively(task, learner, steps, phi, seed=0):
    """Return Q after so many steps, by the equations of its docstring."""
    mdp = task.mdp
    gamma, limit = mdp.discount, mdp.time_limit or math.inf
    horizon = min(limit, 1 / (1 - gamma))
    low, high = learner.value_range or bounds(mdp)
    shape = mdp.outcome_row.shape
    initial = low if learner.initial_value is None else learner.initial_value
    visits = np.zeros(shape, int)

    def rate(before):
        rate = learner.learning_rate
        if rate is None:
            return 1.0 / (1.0 + before / (horizon + 1.0))
        return rate if isinstance(rate, float) else rate(before)

    q = np.where(mdp.terminal[:, None], 0.0, initial + phi + np.zeros(shape))
    u = q.copy()
    for s, a in np.ndindex(*shape):
        if not mdp.terminal[s] and visits[s, a] == 0:
            u[s, a] += high - initial
    draw = random_bits(stream_start(seed, ""))
    ties = Ties(len(u), splitmix64(stream_start(seed, "")))
    fresh = True
    for _ in range(steps):
        if fresh:
            state, length = pick(mdp.start.tolist(), uniform(next(draw))), 0
        bits = next(draw)
        if (bits >> 32) / 2**32 < (learner.epsilon or 0.0):
            action = ((bits & 0xFFFFFFFF) * shape[1]) >> 32
        else:
            action = ties.take(state, u[state].tolist())
        row = mdp.outcome_row[state, action]
        outcome = pick(mdp.probability[row].tolist(), uniform(splitmix64(bits)))
        after, reward = int(mdp.next_state[row, outcome]), float(mdp.reward[row, outcome])
        ended = bool(mdp.terminal[after])
        alpha = rate(int(visits[state, action]))
        visits[state, action] += 1
        target = reward + (0.0 if ended else gamma * q[after].max())
        hoped = reward + (0.0 if ended else gamma * min(high, u[after].max()))
        q[state, action] += alpha * (target - q[state, action])
        before = u[state].tolist()
        u[state, action] += alpha * (hoped - u[state, action])
        ties.update(before, u[state].tolist(), state, action, bits)
        length, state = length + 1, after
        fresh = ended or length >= limit
    return q


@pytest.mark.parametrize("name", LEARNERS)
@pytest.mark.parametrize("seed", range(3))
def test_values(random_mdp, name, seed):
    task, learner = random_mdp(seed, time_limit=7), LEARNERS[name]
    result = cr.learn(task, learner, 400, seeds=[seed])
    q = explored_naively(task, learner, 400, 0.0, seed)
    assert result.values[0] == pytest.approx(q, abs=1e-12, rel=1e-12)


def test_a_potential_is_added_to_the_start_of_both_tables(random_mdp, random_shaping):
    task, learner = random_mdp(4, time_limit=7), LEARNERS["default"]
    shaping = random_shaping(task, cr.QInitialisation)
    phi = shaping.potential.values
    for entering in (shaping, cr.LookAheadAdvice(shaping.potential)):
        result = cr.learn(task, learner, 60, shaping=entering)
        q = explored_naively(task, learner, 60, phi)
        assert result.values[0] == pytest.approx(q, abs=1e-12, rel=1e-12)
