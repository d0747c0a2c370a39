"""States that an episode can reach, against a search in plain Python."""

import numpy as np
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

import curricle as cr
from curricle.tasks.graph import reachable_states


def naive_reach(mdp, allowed):
    """Return the states that allowed actions can reach, breadth first."""
    seen, waiting = set(), [int(s) for s in np.flatnonzero(mdp.start)]
    while waiting:
        s = waiting.pop(0)
        if s in seen:
            continue
        seen.add(s)
        for a in np.flatnonzero(allowed[s]) if not mdp.terminal[s] else ():
            row = mdp.outcome_row[s, a]
            waiting += mdp.next_state[row][mdp.probability[row] > 0].tolist()
    return seen


@st.composite
def graphs(draw):
    """Draw the tables of an MDP, outcomes of probability 0 and shared rows included."""
    n, a = draw(st.integers(1, 7)), draw(st.integers(1, 3))
    rows, width = draw(st.integers(1, 6)), draw(st.integers(1, 3))
    weight = draw(arrays(np.int64, (rows, width), elements=st.integers(0, 2)))
    weight[weight.sum(axis=1) == 0, 0] = 1
    terminal = draw(arrays(np.bool_, n))
    terminal[0] = False
    begins = draw(arrays(np.bool_, n)) & ~terminal
    begins[0] |= not begins.any()
    return cr.FiniteMDP(
        states=cr.Space([cr.Component("state", n)]),
        actions=cr.Space([cr.Component("action", a)]),
        outcome_row=draw(arrays(np.int64, (n, a), elements=st.integers(0, rows - 1))),
        probability=weight / weight.sum(axis=1, keepdims=True),
        next_state=draw(arrays(np.int64, (rows, width), elements=st.integers(0, n - 1))),
        reward=np.zeros((rows, width)),
        terminal=terminal,
        start=begins / begins.sum(),
        discount=0.5,
    )


@given(graphs(), st.data())
def test_reachable_states_are_those_of_a_search(mdp, data):
    shape = mdp.outcome_row.shape
    allowed = data.draw(st.none() | arrays(np.bool_, shape))
    reached = reachable_states(mdp, allowed)
    expected = naive_reach(mdp, np.ones(shape, bool) if allowed is None else allowed)
    assert set(np.flatnonzero(reached).tolist()) == expected
