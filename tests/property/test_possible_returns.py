"""The lowest and the highest return of an episode, against all episodes of small random tasks."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

import curricle as cr
from curricle.planning import target
from curricle.planning.target import possible_returns
from curricle.statistics.intervals import mean_interval
from tests.support.tasks import random_mdp, with_masks


def returns_of_all_episodes(mdp, discount):
    """The return of every episode that can happen, by following every outcome of every action."""

    def going_on(state, left):
        if mdp.terminal[state] or not left:
            return [0.0]
        found = []
        for action in range(mdp.actions.size):
            if mdp.available is None or mdp.available[state, action]:
                row = mdp.outcome_row[state, action]
                for o in np.flatnonzero(mdp.probability[row] > 0):
                    after = going_on(mdp.next_state[row, o], left - 1)
                    found += [mdp.reward[row, o] + discount * value for value in after]
        return [min(found), max(found)]  # the others are extreme in no episode that goes on

    ends = [value for s in np.flatnonzero(mdp.start) for value in going_on(s, mdp.time_limit)]
    return min(ends), max(ends)


@given(
    st.integers(0, 10_000),
    st.sampled_from([0.0, 0.5, 0.9, 1.0]),
    st.integers(1, 5),
    st.sampled_from([1e-6, 1.0, 1e6]),
    st.booleans(),
)
def test_they_are_those_of_all_episodes(seed, discount, limit, size, masked):
    mdp = random_mdp(seed, n_states=4, n_actions=2, width=2, discount=discount, time_limit=limit)
    mdp = with_masks(mdp, seed) if masked else mdp
    mdp = cr.FiniteMDP(**{**vars(mdp), "reward": size * mdp.reward})
    for evaluated in (discount, 1.0):
        ends = returns_of_all_episodes(mdp, evaluated)
        known = possible_returns(mdp, evaluated)
        assert known == pytest.approx(ends, rel=1e-9, abs=1e-12 * size)


def test_where_the_search_takes_too_long_they_are_not_known(monkeypatch):
    maze = cr.GridWorld(["S..", "..T"])
    assert possible_returns(maze, 1.0) == (-200.0, 197.0)
    monkeypatch.setattr(target, "MOST_SWEEPS", 199)
    assert possible_returns(maze, 1.0) is None


def test_what_is_not_known_is_none():
    endless = cr.GridWorld("S.T", discount=1.0, time_limit=None)
    assert possible_returns(endless, 1.0) is None  # each step costs 1, without an end
    assert possible_returns(None, 1.0) is None
    lake = cr.from_gymnasium("FrozenLake-v1", discount=0.9)
    assert possible_returns(lake, 1.0) == (0.0, 1.0)
    assert (
        possible_returns(cr.from_gymnasium("FrozenLake-v1", discount=0.9, live=True), 1.0) is None
    )


@given(st.lists(st.floats(0, 1), min_size=2, max_size=9), st.floats(0.5, 0.99))
def test_an_interval_within_possible_returns_covers_all_that_it_covered_of_them(values, confidence):
    interval = mean_interval(values, confidence=confidence)
    kept = interval.within((0.0, 1.0))
    assert kept.estimate == interval.estimate
    if np.isnan(interval.low):
        assert np.isnan([kept.low, kept.high]).all()
        return
    assert min(0.0, kept.estimate) <= kept.low <= kept.estimate <= kept.high
    assert kept.high <= max(1.0, kept.estimate)
    for mean in np.linspace(0, 1, 21):
        assert (kept.low <= mean <= kept.high) == (interval.low <= mean <= interval.high)
