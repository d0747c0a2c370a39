"""Differences of two tasks or of their summaries; the same problem in another form has none."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, strategies as st

from curricle import Component, ComputedMDP, FiniteMDP, GridWorld, Pursuit, Rewards, Space
from curricle.comparison import task_differences
from curricle.comparison.task_differences import differences, summary_differences, task_summary
from curricle.tasks.observation_task import plain_text

MAZE = GridWorld(["S.F", "..T"])
HUNT = Pursuit(3, 2)
COIN = [[[(0.5, 1, 2.0), (0.5, 2, -1.0)], [(1.0, 1, 0.0)]], [[(1.0, 2, 1.0)]] * 2, [[], []]]


def coin(outcomes=COIN, **changes):
    settings = {"terminal": [False, False, True], "start": 0, "discount": 0.9} | changes
    return FiniteMDP.from_outcomes(outcomes, **settings)


def changed(pair, outcomes, **settings):
    """Return the coin task with other outcomes of one pair."""
    lists = [list(state) for state in COIN]
    lists[pair[0]][pair[1]] = outcomes
    return coin(lists, **settings)


def names(task, other):
    """Return what differs, without the values; both ways round it is the same."""
    parts = [line.split(" (")[0] for line in differences(task, other)]
    assert parts == [line.split(" (")[0] for line in differences(other, task)]
    return parts


def permuted(mdp, seed):
    """Return the same MDP with its outcome rows in another order, and each row's outcomes too."""
    rng = np.random.default_rng(seed)
    rows = rng.permutation(len(mdp.probability))
    places = np.stack([rng.permutation(mdp.probability.shape[1]) for _ in rows])
    moved = {
        name: np.take_along_axis(getattr(mdp, name)[rows], places, axis=1)
        for name in ("probability", "next_state", "reward")
    }
    return replace(mdp, outcome_row=np.argsort(rows)[mdp.outcome_row], **moved)


def split(mdp, impossible=99):
    """Return the same MDP with each outcome in two halves, and an impossible one."""
    nothing = np.zeros((len(mdp.probability), 1))
    return replace(
        mdp,
        probability=np.hstack([mdp.probability / 2, nothing, mdp.probability / 2]),
        next_state=np.hstack([mdp.next_state, nothing.astype(int), mdp.next_state]),
        reward=np.hstack([mdp.reward, nothing + impossible, mdp.reward]),
    )


def unshared(mdp):
    """Return the same MDP with an outcome row for each pair, those of terminal states filled."""
    rows = mdp.outcome_row.ravel()
    ends = np.repeat(mdp.terminal, mdp.outcome_row.shape[1])
    return replace(
        mdp,
        outcome_row=np.arange(rows.size).reshape(mdp.outcome_row.shape),
        probability=mdp.probability[rows],
        next_state=mdp.next_state[rows],
        reward=np.where(ends[:, None], np.inf, mdp.reward[rows]),
    )


@pytest.mark.parametrize("task", [MAZE, HUNT, coin()], ids=["maze", "pursuit", "coin"])
def test_the_same_problem_in_another_form(task):
    forms = (task.mdp, permuted(task.mdp, 1), split(task.mdp), unshared(task.mdp), Mine(task.mdp))
    for other in (replace(task), *forms):
        assert differences(task, other) == differences(other, task) == ()
    assert apart(task, task.mdp) == ()
    # Without a pit to fall into, or with two predators, these settings do not matter.
    assert differences(MAZE, GridWorld(["S.F", "..T"], rewards=Rewards(pit=-1))) == ()
    assert differences(HUNT, Pursuit(3, 2, capture=2)) == ()


@given(st.integers(0, 10_000))
def test_random_problems_are_themselves_and_no_other(seed):
    rng = np.random.default_rng(seed)
    p = rng.dirichlet(np.ones(4), size=(4, 2))
    task = FiniteMDP.from_dense(
        p, rng.normal(size=p.shape), terminal=[False] * 3 + [True], start=0, discount=0.5
    )
    assert differences(task, split(permuted(task, seed))) == ()
    other = replace(task, reward=task.reward + np.where(np.arange(8) == seed % 6, 1e-6, 0)[:, None])
    assert names(task, other) == ["reward"]
    swapped = task.next_state.copy()
    swapped[seed % 6, :2] = swapped[seed % 6, 1::-1]
    assert names(task, replace(task, next_state=swapped)) == ["transitions"]


def test_values_are_told():
    """Of the first state that differs, of numbers and of what a user stated."""
    other = GridWorld(["S.F", "..T"], rewards=Rewards(fire=-5), time_limit=9, start="uniform")
    limit, reward, start, rewards = differences(MAZE, other)
    assert limit == "time_limit (200 against 9)"
    assert start == "start (state 0 (row 0, column 0): 1 against 0.2)"
    assert reward == "reward (from state 1 (row 0, column 1): -501 against -6)"
    assert "fire=-500.0" in rewards


@pytest.mark.parametrize(
    ("task", "other", "expected"),
    [
        (MAZE, replace(MAZE, discount=0.5, time_limit=9), ["discount", "time_limit"]),
        (MAZE, replace(MAZE, ends=["treasure", "fire"]), ["end rule", "ends"]),
        (MAZE, replace(MAZE, start="uniform"), ["start"]),
        (MAZE, replace(MAZE, rewards=Rewards(fire=-5)), ["reward", "rewards"]),
        (MAZE, replace(MAZE, origin=(1, 0)), ["states", "origin"]),
        (MAZE, GridWorld(["S.", ".T"]), ["states", "map"]),
        (HUNT, Pursuit(3, 2, step_reward=-2.0), ["reward", "step_reward"]),
        (HUNT, Pursuit(3, 2, capture="any"), ["end rule", "start", "capture"]),
        (HUNT, Pursuit(3, 2, capture="as_published"), ["end rule", "start", "capture"]),
        (HUNT, Pursuit(3, 2, discount=0.9, time_limit=None), ["discount", "time_limit"]),
        (HUNT, Pursuit(3, 2, moves=4), ["actions", "moves"]),
        (HUNT, Pursuit(3, 1), ["states", "actions", "predators"]),
        (HUNT, MAZE, ["states", "actions"]),
    ],
)
def test_what_differs_is_named(task, other, expected):
    assert names(task, other) == expected
    for first, *_ in (apart(task, other), apart(other, task)):
        assert first.startswith(expected[0].split()[0])


@pytest.mark.parametrize(
    ("other", "line"),
    [
        (
            changed((0, 0), [(0.5, 1, 2.0), (0.5, 2, -3.0)]),
            "reward (from state 0: 0.5 against -0.5)",
        ),
        (changed((1, 1), [(1.0, 0, 1.0)]), "transitions (from state 1)"),
        (changed((0, 0), [(0.5, 2, 2.0), (0.5, 1, -1.0)]), "rewarded outcomes (from state 0)"),
        # the same mean reward for the same successor, but a gamble
        (changed((0, 1), [(0.5, 1, -7.0), (0.5, 1, 7.0)]), "rewarded outcomes (from state 0)"),
        (coin(start=[0.75, 0.25, 0.0]), "start (state 0: 1 against 0.75)"),
        (coin(time_limit=5), "time_limit (None against 5)"),
        (coin(terminal=[False, True, True]), "end rule (state 1 ends one of them only)"),
        (coin(states=Space([Component("place", 3)])), "states (3 against 3)"),
    ],
)
def test_tables(other, line):
    assert differences(coin(), other) == (line,)


def test_an_impossible_outcome_changes_no_comparison():
    gamble = changed((0, 1), [(0.5, 1, -7.0), (0.5, 1, 7.0)])
    for impossible in (1e30, -1e30):
        lottery = split(coin(), impossible)
        assert differences(coin(), lottery) == ()
        assert names(gamble, lottery) == ["rewarded outcomes"]


def test_rounding_is_no_difference():
    thirds = [(1 / 3, 1, 0.1 + 0.2), (1 / 3, 2, 0.0), (1 / 3, 0, 0.0)]
    again = [(1 - 2 / 3, 1, 0.3), (1 / 3, 0, 0.0), (1 / 3, 2, 0.0)]
    assert differences(changed((0, 0), thirds), changed((0, 0), again)) == ()


def begin(data, bits):
    return 1


def walk(data, state, action, bits):
    return (state + 1) % 4, -1.0, state == 3


def stand(data, state, action, bits):
    return state, -1.0, False


class Data(NamedTuple):
    weights: np.ndarray
    size: int


SPACES = Space([Component("place", 4)]), Space([Component("move", 2)])


def computed(step=walk, weights=(1.0, 2.0), **settings):
    return ComputedMDP(*SPACES, begin, step, data=Data(np.array(weights), 4), **settings)


@pytest.mark.parametrize(
    ("other", "name"),
    [
        (computed(stand), "step"),
        (computed(weights=(1.0, 3.0)), "data"),
        (ComputedMDP(*SPACES, begin, walk, data=4), "data"),
        (computed(discount=0.5), "discount"),
        (computed(time_limit=None), "time_limit"),
    ],
)
def test_functions_and_data_are_compared(other, name):
    assert differences(computed(), computed()) == ()
    assert names(computed(), other) == [name]


def test_functions_cannot_be_compared_with_tables():
    tables = FiniteMDP.from_dense(
        np.tile(np.eye(4)[:, None], (1, 2, 1)),
        np.full(4, -1.0),
        terminal=[True, False, False, False],
        start=1,
        discount=0.99,
        time_limit=200,
        states=SPACES[0],
        actions=SPACES[1],
    )
    rules = "rules (ComputedMDP against FiniteMDP, too large or functions)"
    assert differences(computed(), tables) == (rules,)
    assert differences(tables, computed(discount=0.5)) == ("discount (0.99 against 0.5)",)


class Mine:
    """A user's own kind of task."""

    def __init__(self, mdp):
        self.states, self.actions, self._mdp = mdp.states, mdp.actions, mdp

    @property
    def mdp(self):
        return self._mdp


def test_what_is_too_large_for_tables_is_compared_by_parameters(monkeypatch):
    monkeypatch.setattr(task_differences, "LARGEST", 10)
    assert names(HUNT, Pursuit(3, 2, torus=True)) == ["torus"]
    assert differences(HUNT, HUNT.mdp) == (
        "rules (Pursuit against FiniteMDP, too large or functions)",
    )
    monkeypatch.setattr(task_differences, "LARGEST", 1)
    assert differences(coin(), coin()) == ()
    assert names(coin(), changed((0, 0), [(0.5, 1, 2.0), (0.5, 2, -3.0)])) == ["reward"]


def apart(task, other):
    return summary_differences(task_summary(task), task_summary(other))


PENALTY = -1.0


def paid(steps):
    return PENALTY if steps == 0 else paid(steps - 1)


def test_text_of_a_function_tells_the_constants_of_its_module(monkeypatch):
    def step(state):
        return state, paid(state), np.inf

    before = plain_text(step)
    assert before == plain_text(step)
    monkeypatch.setitem(globals(), "PENALTY", -5.0)
    assert before != plain_text(step)
