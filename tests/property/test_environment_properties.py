"""Environments move as their tasks' tables say."""

import numpy as np
from hypothesis import given, settings, strategies as st

from curricle import GridWorld, Pursuit
from curricle.interop import register
from curricle.interop.gymnasium import to_gymnasium
from curricle.tasks.mdp import tables
from tests.support.tasks import mdps

register()
STEPS = 4_000
FALSE_ALARM = 1e-9
"""The chance that one frequency lies outside its bound by accident; each test has some thousand."""


TASKS = st.one_of(
    st.builds(lambda mdp, n: mdp.task(time_limit=n), mdps(max_states=5), st.integers(1, 30)),
    st.sampled_from(
        [
            Pursuit(2, 1),
            Pursuit(2, 1, torus=True, moves=4),
            GridWorld(["S.#", "FPT"], start="uniform"),
        ]
    ),
)


def within_chance(counts, probability):
    """Whether frequencies agree with probabilities, by Hoeffding's bound."""
    total = counts.sum(axis=-1, keepdims=True)
    bound = np.sqrt(np.log(2 / FALSE_ALARM) / (2 * np.maximum(total, 1)))
    return bool((abs(counts - total * probability) <= total * bound).all())


def dense(mdp):
    """Probabilities and rewards of next states, (S, A, S) each."""
    shape = (mdp.states.size, mdp.actions.size, mdp.states.size)
    p, r = np.zeros(shape), np.zeros(shape)
    for s, a in np.ndindex(shape[:2]):
        row = mdp.outcome_row[s, a]
        np.add.at(p[s, a], mdp.next_state[row], mdp.probability[row])
        happens = mdp.probability[row] > 0  # rows are padded with outcomes that never do
        r[s, a, mdp.next_state[row][happens]] = mdp.reward[row][happens]
    return p, r


@settings(max_examples=25)
@given(task=TASKS, seed=st.integers(0, 2**32 - 1))
def test_moves_have_the_tables_probabilities(task, seed):
    mdp = tables(task)
    p, r = dense(mdp)
    begun, met = np.zeros(mdp.states.size), np.zeros(p.shape)
    environment, rng = to_gymnasium(task), np.random.default_rng(seed)
    state, _ = environment.reset(seed=seed)
    begun[state] += 1
    steps = 0
    for action in rng.integers(mdp.actions.size, size=STEPS):
        reached, reward, terminated, truncated, _ = environment.step(action)
        met[state, action, reached] += 1
        steps += 1
        assert p[state, action, reached] > 0
        assert reward == r[state, action, reached]
        assert terminated == mdp.terminal[reached]
        assert truncated == (steps == mdp.time_limit and not terminated)
        state = reached
        if terminated or truncated:
            state, _ = environment.reset()
            begun[state] += 1
            steps = 0
    assert (begun[mdp.start == 0] == 0).all()
    assert within_chance(begun, mdp.start)
    assert within_chance(met, p)


@given(task=TASKS, seed=st.integers(0, 2**32 - 1))
def test_a_seed_fixes_all_episodes_that_follow(task, seed):
    def played(environment):
        outcomes = [environment.reset(seed=seed)]
        for step in range(100):
            outcomes.append(environment.step(step % environment.action_space.n))
            if outcomes[-1][2] or outcomes[-1][3]:
                outcomes.append(environment.reset())
        return outcomes

    used = to_gymnasium(task)
    used.reset()
    used.step(0)
    assert played(used) == played(to_gymnasium(task))
