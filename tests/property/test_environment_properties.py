"""Environments move as their tasks' tables say, and what is learnt in them by hand is the truth."""

import gymnasium
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from curricle import FiniteMDP, GridWorld, Pursuit, evaluate, solve
from curricle.interop import register
from curricle.interop.gymnasium import maze_environment, to_gymnasium
from curricle.tasks.mdp import tables

register()
STEPS = 4_000
FALSE_ALARM = 1e-9
"""The chance that one frequency lies outside its bound by accident; each test has some thousand."""


@st.composite
def small_mdps(draw):
    """MDPs of 2 to 5 states, of which the last is terminal, with many probabilities of 0."""
    n_states, n_actions = draw(st.integers(2, 5)), draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    shape = (n_states, n_actions, n_states)
    weight = rng.exponential(size=shape) * (rng.random(shape) < draw(st.sampled_from([0.3, 1.0])))
    weight[weight.sum(axis=2) == 0, 0] = 1
    start = rng.random(n_states) * (np.arange(n_states) < n_states - 1)
    return FiniteMDP.from_dense(
        weight / weight.sum(axis=2, keepdims=True),
        rng.normal(size=shape),
        terminal=np.arange(n_states) == n_states - 1,
        start=start / start.sum(),
        discount=0.9,
        time_limit=draw(st.integers(1, 30)),
    )


TASKS = st.one_of(
    small_mdps(),
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
        r[s, a, mdp.next_state[row]] = mdp.reward[row]
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


@pytest.mark.parametrize(
    "make",
    [
        lambda: gymnasium.make("Curricle/Maze-v0"),
        lambda: maze_environment(["..F.", "S.#T"], rewards={"step": -5}),
    ],
)
def test_a_learner_by_hand_finds_the_planned_value(make):
    environment = make()
    task = environment.unwrapped.task
    q = np.zeros((environment.observation_space.n, environment.action_space.n))
    rng = np.random.default_rng(0)
    for _ in range(500):
        state, _ = environment.reset()
        over = False
        while not over:
            action = rng.integers(4) if rng.random() < 0.3 else q[state].argmax()
            reached, reward, terminated, truncated, _ = environment.step(action)
            # The maze leaves nothing to chance, so that there is nothing to average.
            q[state, action] = reward + task.discount * q[reached].max() * (not terminated)
            state, over = reached, terminated or truncated
    learnt = evaluate(task, q.argmax(axis=1)).start_value
    assert learnt == pytest.approx(solve(task).start_value, abs=1e-6)
