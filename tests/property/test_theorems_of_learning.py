"""Theorems about learning: every shaping finds the optimum; shaping equals initialisation."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import curricle as cr
from tests.support.enumeration import states_of
from tests.support.tasks import DenseMDP, mdps, tree


@pytest.mark.parametrize("kind", [cr.QLearning, cr.SARSA, cr.DoubleQLearning])
@given(mdp=mdps((0.5, 0.75)), data=st.data())
def test_state_shaping_learns_exactly_what_initialisation_does(kind, mdp, data):
    # Wiewiora 2003. A rate of 1/2 and gamma of 3/4 add 3 bits a step: in 15 steps nothing is
    # rounded, so that both see the same ties along the same random stream, to the last bit.
    task = mdp.task(time_limit=data.draw(st.sampled_from([None, 3])))
    phi = mdp.zero_at_ends(states_of(data, mdp))
    as_pairs = np.repeat(phi[:, None], mdp.shape[1], axis=1)
    learner, settings = kind(learning_rate=0.5, epsilon=0.25), {"seeds": 4, "workers": 1}
    shaped, warm = (
        cr.learn(task, learner, 15, shaping=shaping, **settings)
        for shaping in (cr.StateShaping(phi), cr.QInitialisation(as_pairs))
    )
    np.testing.assert_array_equal(shaped.values, warm.values)
    np.testing.assert_array_equal(shaped.training_return, warm.training_return)


# Few of all combinations, as Numba compiles a loop for each.
ONCE = {"learning_rate": 0.5, "epsilon": 0.3}
LEARNT = [
    *((cr.Storage(), ONCE | {"learning_rate": rate}) for rate in (0.3, 0.5, 1.0)),
    (cr.Storage(), ONCE | {"learning_rate": cr.learning.harmonic(half=3)}),
    (cr.Storage(), {"learning_rate": 0.3, "inverse_temperature": 0.5}),
    (cr.Storage(dtype="float32"), ONCE),
    (cr.Storage(kind="sparse"), ONCE),
]
PLAIN, ODD = LEARNT[:3], LEARNT[3:]
ADDED = [cr.QInitialisation, cr.StateShaping, cr.RewardBonus]
PAIRS = [*product([None, *ADDED], PLAIN), *product([None, cr.StateShaping], ODD)]


@settings(max_examples=200)
@given(
    mdps((0.0, 0.9, 0.75), max_actions=5),
    st.sampled_from(PAIRS),
    st.sampled_from([-1.0, 0.0, 2.0]),
    st.booleans(),
)
def test_nothing_added_changes_nothing(mdp, pair, start, zeros):
    """A shaping without a potential, or with one of zeros, serves the same setting as none.

    Whole rewards and equal first values keep rows full of ties; the fast and the general loop and
    all kinds of tables must draw the same among them.
    """
    task, (added, (storage, setting)) = mdp.task(time_limit=7), pair
    learner = cr.QLearning(initial_value=start, **setting)
    nothing = None if added is None else added()
    if added is not None and zeros and storage.kind != "sparse":
        nothing = added(np.zeros(mdp.shape[:2]))
    common = {"seeds": 2, "workers": 1, "eval_freq": 20, "storage": storage}
    plain = cr.learn(task, learner, 120, **(common | {"storage": cr.Storage(dtype=storage.dtype)}))
    other = cr.learn(task, learner, 120, shaping=nothing, **common)
    for k in range(2):
        ours, theirs = plain.values[k], other.values[k]
        if storage.kind == "sparse":
            ours, theirs = ours[theirs.states], theirs.values
        np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(plain.training_return, other.training_return)
    np.testing.assert_array_equal(plain.greedy_return, other.greedy_return)


@given(mdps(), st.data())
def test_initialisation_at_the_optimum_is_optimal_before_the_first_step(mdp, data):
    task = mdp.task()
    solution = cr.solve(task)
    result = cr.learn(
        task, cr.QLearning(learning_rate=0.0), 1, workers=1,
        shaping=cr.QInitialisation(np.where(solution.optimal, 1.0, 0.0)),
        evaluation=cr.GreedyEvaluation(method="exact"),
    )  # fmt: skip
    assert result.greedy_return[0, 0] == pytest.approx(solution.start_value, abs=1e-6)


def test_a_plain_bonus_can_change_the_optimal_policy():
    # A step ends the episode with 10 (action 0) or stays for nothing (action 1). A bonus of 2 a
    # stay is worth 2 / (1 - 0.9) = 20; the same numbers as a potential change nothing.
    mdp = DenseMDP(
        np.array([[[0.0, 1.0], [1.0, 0.0]], [[0.0, 1.0], [0.0, 1.0]]]),
        np.array([[[0.0, 10.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, 0.0]]]),
        np.array([False, True]),
        0.9,
    )
    bonus = np.array([[0.0, 2.0], [0.0, 0.0]])
    assert cr.solve(mdp.task()).optimal[0].tolist() == [True, False]
    assert cr.solve(mdp.task(bonus[:, :, None])).optimal[0].tolist() == [False, True]
    for shaping, expected in (
        (cr.RewardBonus(bonus), 1),
        (cr.QInitialisation(bonus), 0),
        (cr.LookAheadAdvice(bonus), 0),
    ):
        learnt = cr.learn(mdp.task(), cr.QLearning(epsilon=0.2), 5000, shaping=shaping)
        assert learnt.values[0, 0].argmax() == expected, shaping


# A deterministic tree: chance enters by exploration alone, and seeds are fixed: there is no false
# alarm unless the random stream changes. If it does: while epsilon is
# above 2/3, in 3,300 episodes, each leaf is reached with probability 3^-3 or more, so that it
# goes unseen with less than e^-120; the first visit, at rate 1, wipes out the misleading start.
LEARNERS = [cr.QLearning, cr.SARSA, cr.ExpectedSARSA, cr.DoubleQLearning]


@pytest.mark.parametrize("kind", LEARNERS)
@pytest.mark.parametrize("way", [cr.QInitialisation, cr.LookAheadAdvice, cr.StateShaping])
def test_every_shaping_finds_the_optimal_policy(way, kind):
    task = tree()
    solution = cr.solve(task)
    misleading = -3.0 * solution.action_values
    phi = cr.StateActionPotential(task, misleading)
    assert (phi.values.argmax(axis=1) != solution.action_values.argmax(axis=1))[:7].all()
    result = cr.learn(
        task,
        kind(
            learning_rate=cr.learning.harmonic(half=20),
            epsilon=cr.learning.linear(1.0, 0.01, steps=30_000),
        ),
        40_000, seeds=3, shaping=way(phi),
    )  # fmt: skip
    best = result.values[:, :7].argmax(axis=2)
    np.testing.assert_array_equal(best, np.tile(solution.optimal[:7].argmax(axis=1), (3, 1)))
    assert result.greedy_return[:, -1] == pytest.approx(solution.start_value, abs=1e-6)
    if kind is cr.QLearning:  # off-policy, deterministic: the values themselves
        assert abs(result.values - solution.action_values).max() < 1e-3
