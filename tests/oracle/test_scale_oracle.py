"""The evidence of a cautious calibration, beside loops over steps and dense algebra."""

import numpy as np
import pytest

import curricle as cr
from curricle.learning.potential_rollouts import greedy_rollouts
from curricle.transfer.scale_fit import scale_evidence

HUNT = cr.Pursuit(3, 2, time_limit=12, discount=0.9)


def clustered(x, y, episode):
    """Return the slope of y on x and its standard error over episodes, by the book."""
    slope = np.linalg.lstsq(x[:, None], y, rcond=None)[0][0]
    names = np.unique(episode)
    meat = sum(float(x[episode == e] @ (y - slope * x)[episode == e]) ** 2 for e in names)
    n = len(names)
    return slope, np.sqrt(n / (n - 1) * meat) / (x @ x)


@pytest.mark.parametrize("seed", range(4))
def test_the_evidence_is_that_of_loops(seed):
    rng = np.random.default_rng(seed)
    q = cr.solve(HUNT).action_values
    phi = cr.StateActionPotential(HUNT, 0.5 * q - 0.3 * rng.random(q.shape))
    rollouts = greedy_rollouts(phi, episodes=30, seed=seed)
    x, y, target, episode, t = [], [], [], [], 0
    for e, length in enumerate(rollouts.lengths):
        for i in range(t, t + length):
            last = i == t + length - 1
            beyond = rollouts.bootstrapped_value[i] if last else rollouts.predicted[i + 1]
            later = 0.0 if last else rollouts.return_to_go[i + 1]
            reward = rollouts.return_to_go[i] - HUNT.discount * later
            x.append(
                rollouts.predicted[i]
                - rollouts.bootstrap_discount[i] * rollouts.bootstrapped_value[i]
            )
            y.append(rollouts.return_to_go[i])
            target.append(reward + HUNT.discount * beyond)
            episode.append(e)
        t += length
    x, y, target, episode = map(np.array, (x, y, target, episode))
    found = scale_evidence(rollouts, HUNT.discount)
    assert (found.scale, found.scale_error) == pytest.approx(clustered(x, y, episode))
    centred = rollouts.predicted - rollouts.predicted.mean()
    assert (found.slope, found.slope_error) == pytest.approx(
        clustered(centred, target - target.mean(), episode)
    )
    assert found.episodes == 30
    assert not found.stuck


def test_the_standard_error_is_that_of_repetitions():
    """Of 200 repetitions; the standard deviation of a standard deviation is 5 % of it."""
    phi = cr.StateActionPotential(HUNT, 0.5 * cr.solve(HUNT).action_values)
    each = [
        scale_evidence(greedy_rollouts(phi, episodes=40, seed=seed), HUNT.discount)
        for seed in range(200)
    ]
    for name in ("scale", "slope"):
        spread = np.std([getattr(one, name) for one in each], ddof=1)
        claimed = np.mean([getattr(one, f"{name}_error") for one in each])
        assert 0.8 < claimed / spread < 1.2
