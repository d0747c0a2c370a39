"""The product of a task and an automaton, against brute force over random MDPs and automata."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

import curricle as cr
from curricle.errors import TaskError
from curricle.tasks import Automaton, with_automaton
from tests.support.tasks import mdps, random_mdp, with_masks

EVENTS = ("a", "b", "c", "")
discounts = (0.3, 0.75, 0.95, 1.0)


@st.composite
def automata(draw, events):
    """Draw edges, terminal states and the automaton, whose events are a table (S, A, S)."""
    n = draw(st.integers(1, 3))
    names = [f"u{i}" for i in range(n)]
    ends = names[1:][: draw(st.integers(0, max(0, n - 1)))]
    edges = {}
    for state in names:
        for event in EVENTS[:3] if state not in ends else ():
            if draw(st.booleans()):
                reward = float(draw(st.integers(-3, 3)))
                edges[state, event] = draw(st.sampled_from(names)), reward
    edges.setdefault(("u0", "a"), (names[-1], 1.0))
    listed = [(*key, *edge) for key, edge in edges.items()]
    known = {end for edge in listed for end in (edge[0], edge[2])}
    ends = [end for end in ends if end in known]

    def event(before, action, after):
        return events[before["state"], action["action"], after["state"]]

    return edges, ends, Automaton(listed, event, start="u0", terminal=ends)


def tables_of_events(data, shape):
    flat = data.draw(
        st.lists(st.sampled_from(EVENTS), min_size=(n := int(np.prod(shape))), max_size=n)
    )
    events = np.array(flat).reshape(shape)
    events[...] = np.where(np.arange(n).reshape(shape) % 5 == 0, "a", events)
    return events


def brute_force(mdp, events, edges, ends, states, rounds=900):
    """Value iteration over (s, u), one outcome after another; 0.95^900 = 1e-20 is left."""
    value = {(s, u): 0.0 for s in range(len(mdp.terminal)) for u in states}
    live = [(s, u) for s, u in value if not mdp.terminal[s] and u not in ends]
    for _ in range(rounds):
        new = dict(value)
        for s, u in live:
            per_action = []
            for a in range(mdp.p.shape[1]):
                total = 0.0
                for after in np.flatnonzero(mdp.p[s, a]).tolist():
                    next_u, paid = edges.get((u, events[s, a, after]), (u, 0.0))
                    gain = mdp.r[s, a, after] + paid + mdp.discount * value[after, next_u]
                    total += mdp.p[s, a, after] * gain
                per_action.append(total)
            new[s, u] = max(per_action)
        if max((abs(new[key] - value[key]) for key in live), default=0.0) < 1e-13:
            return new
        value = new
    return value


@given(mdps(discounts), st.data())
def test_the_product_has_the_values_of_brute_force(mdp, data):
    events = tables_of_events(data, mdp.p.shape)
    edges, ends, automaton = data.draw(automata(events))
    task = mdp.task()
    if not {event for _, event in edges} & {
        str(event) for event in events[(mdp.p > 0) & ~mdp.terminal[:, None, None]]
    }:
        with pytest.raises(TaskError, match="an event that can happen"):
            with_automaton(task, automaton)
        return
    solution = cr.solve(with_automaton(task, automaton))
    wanted = brute_force(mdp, events, edges, ends, automaton.states)
    of_pairs = [wanted[s, u] for s in range(len(mdp.terminal)) for u in automaton.states]
    assert abs(solution.values - of_pairs).max() <= solution.error_bound + 1e-9


@given(st.integers(0, 10_000), st.booleans())
def test_an_automaton_of_one_state_is_the_task(seed, masked):
    task = random_mdp(seed, discount=0.9, time_limit=20)
    task = with_masks(task, seed) if masked else task
    still = Automaton([], lambda before, action, after: np.full(len(after["state"]), ""), start="u")
    product = with_automaton(task, still).mdp
    row, other = task.outcome_row[~task.terminal], product.outcome_row[~task.terminal]
    for name in ("probability", "next_state", "reward"):
        np.testing.assert_array_equal(getattr(product, name)[other], getattr(task, name)[row])
    for name in ("terminal", "start", "discount", "time_limit"):
        np.testing.assert_array_equal(getattr(product, name), getattr(task, name))
    assert (product.available is None) == (task.available is None)
    assert product.states.names == ("state", "automaton")
    solved = [cr.solve(replace(made, time_limit=None)) for made in (task, product)]
    np.testing.assert_allclose(solved[0].values, solved[1].values, atol=1e-9)
