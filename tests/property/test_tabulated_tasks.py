"""Whatever an environment does, its table is the part of its MDP that can be reached."""

import numpy as np
from hypothesis import given, settings, strategies as st

import curricle as cr
from curricle.interop import DeepCopy
from curricle.tasks.graph import reachable_states
from tests.support.worlds_to_tabulate import Listed, Written


@st.composite
def written(draw):
    n_states, n_actions = draw(st.integers(2, 12)), draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    after = rng.integers(n_states, size=(n_states, n_actions))
    reward = rng.integers(-2, 3, size=(n_states, n_actions)) / 2
    terminal = rng.random(n_states) < draw(st.sampled_from([0.0, 0.3]))
    terminal[0] = False
    return after, reward, terminal


FUNCTIONS = (lambda env: env.now, lambda env, now: setattr(env, "now", now))


@settings(max_examples=25)
@given(written(), st.sampled_from([None, FUNCTIONS, DeepCopy()]))
def test_a_table_is_the_reachable_part(parts, state):
    after, reward, terminal = parts
    n_states, n_actions = after.shape
    known = cr.FiniteMDP.from_dense(
        np.eye(n_states)[after], reward, terminal=terminal, start=0, discount=0.8
    )
    task = cr.tabulate(lambda: Written(after, reward, terminal), discount=0.8, state=state)
    shown = task.observations.batch()
    assert sorted(shown) == np.flatnonzero(reachable_states(known)).tolist()
    mine, solution = cr.solve(task), cr.solve(known)
    np.testing.assert_allclose(mine.values, solution.values[shown], atol=1e-8)
    np.testing.assert_array_equal(task.mdp.terminal, terminal[shown])
    for s in np.flatnonzero(~task.mdp.terminal):
        for a in range(n_actions):
            row = task.mdp.outcome_row[s, a]
            assert shown[task.mdp.next_state[row, 0]] == after[shown[s], a]
            assert task.mdp.reward[row, 0] == reward[shown[s], a]


def listed(after, reward, terminal):
    """Return the table and the start of an environment of Gymnasium's that is these arrays."""
    rows = [
        [[(1.0, int(to), float(paid), bool(terminal[to]))] for to, paid in zip(*pair, strict=True)]
        for pair in zip(after, reward, strict=True)
    ]
    return rows, np.eye(len(terminal))[0]


@settings(max_examples=25)
@given(written(), st.integers(0, 2), st.sampled_from([0.0, -0.25]))
def test_a_step_of_its_own_is_never_ignored(parts, turned, cost):
    """A subclass turns the actions round and pays: that is solved, not its parent's table."""
    after, reward, terminal = parts
    n_states, n_actions = after.shape
    turn = (np.arange(n_actions) + turned) % n_actions

    class Own(Listed):
        def step(self, action):
            observation, earned, *rest = super().step(int(turn[action]))
            return observation, earned + cost, *rest

    def solved(order, cost):
        moves, paid = np.eye(n_states)[after[:, order]], reward[:, order] + cost
        known = cr.FiniteMDP.from_dense(moves, paid, terminal=terminal, start=0, discount=0.8)
        return cr.solve(known).action_values[0]

    plain = cr.from_gymnasium(lambda: Listed(*listed(*parts)), discount=0.8)
    assert isinstance(plain, cr.FiniteMDP)
    np.testing.assert_allclose(
        cr.solve(plain).action_values[0], solved(np.arange(n_actions), 0), atol=1e-8
    )
    assert isinstance(
        cr.from_gymnasium(lambda: Own(*listed(*parts)), discount=0.8), cr.tasks.LiveMDP
    )
    task = cr.tabulate(lambda: Own(*listed(*parts)), discount=0.8)
    values = cr.solve(task).action_values[np.argmax(task.mdp.start)]
    np.testing.assert_allclose(values, solved(turn, cost), atol=1e-8)
