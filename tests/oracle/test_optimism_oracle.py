"""The optimistic learner agrees with plain Python."""

import pytest

import curricle as cr
from curricle.learning import OptimisticQLearning, harmonic

LEARNERS = {
    "default": OptimisticQLearning(),
    "epsilon": OptimisticQLearning(epsilon=0.2, learning_rate=0.3),
    "harmonic rate": OptimisticQLearning(learning_rate=harmonic(0.8, half=3)),
    "given range": OptimisticQLearning(value_range=(-3, 2), initial_value=1.0),
}


@pytest.mark.parametrize("name", LEARNERS)
@pytest.mark.parametrize("seed", range(3))
def test_values(random_mdp, naive_learn, name, seed):
    task, learner = random_mdp(seed, time_limit=7), LEARNERS[name]
    result = cr.learn(task, learner, 400, seeds=[seed])
    naive = naive_learn(task, learner, 400, seed=seed)
    assert result.values[0] == pytest.approx(naive.values, abs=1e-12, rel=1e-12)
    # Which episode is the present one after the last step, the naive learner does not say.
    assert result.agreement[0, :-1] == pytest.approx(naive.agreement, abs=1e-12)


def test_a_potential_is_added_to_the_start_of_both_tables(random_mdp, random_shaping, naive_learn):
    task, learner = random_mdp(4, time_limit=7), LEARNERS["default"]
    for kind in (cr.QInitialisation, cr.LookAheadAdvice):
        shaping = random_shaping(task, kind)
        result = cr.learn(task, learner, 60, shaping=shaping)
        naive = naive_learn(task, learner, 60, shaping=shaping)
        assert result.values[0] == pytest.approx(naive.values, abs=1e-12, rel=1e-12)
