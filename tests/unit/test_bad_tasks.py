"""Tasks that make no sense: which exception, and whether it gives rule, value and place."""

import numpy as np
import pytest

from curricle import (
    Component,
    FiniteMDP,
    GridWorld,
    Pursuit,
    Rewards,
    Space,
)
from curricle.errors import TaskError
from tests.refusals import cases, check_refusal

NAN, INF = float("nan"), float("inf")
LINE = GridWorld("S.T")
ROW = Space([Component("row", 2), Component("column", 3)])
ONE_WAY = [[[0.0, 1.0]], [[0.0, 1.0]]]
ROUND = [[[1.0, 0.0]], [[0.0, 1.0]]]


def dense(transition=ONE_WAY, reward=(1, 0), **changes):
    settings = {"terminal": [False, True], "start": 0, "discount": 0.9}
    return FiniteMDP.from_dense(transition, reward, **(settings | changes))


def outcomes(lists, **changes):
    return FiniteMDP.from_outcomes(lists, **({"start": 0, "discount": 0.9} | changes))


def tables(**changes):
    m = LINE.mdp
    names = ("states", "actions", "outcome_row", "probability", "next_state", "reward")
    names += ("terminal", "start", "discount")
    return FiniteMDP(**({n: getattr(m, n) for n in names} | changes))


TASKS = {
    # -- probabilities, rewards, shapes
    "sum below 1": (
        lambda: dense([[[0, 0.9]], [[0, 1]]]),
        "sum to 1: state 0, action 0 sums to 0.9",
    ),
    "sum in place": (
        lambda: dense([[[0, 1], [0.2, 0.9]], [[0, 1], [0, 1]]]),
        "state 0, action 1 sums to 1.1",
    ),
    "NaN probability": (lambda: dense([[[0, NAN]], [[0, 1]]]), "sum to 1: state 0, action 0 .*nan"),
    "negative": (lambda: dense([[[-0.1, 1.1]], [[0, 1]]]), "not be negative: state 0, .*-0.1"),
    "no outcome": (
        lambda: outcomes([[[]], [[]]], terminal=[False, True]),
        "state 0, action 0 sums to 0",
    ),
    "NaN reward": (
        lambda: dense(reward=[NAN, 0]),
        "rewards must be finite, .*: state 0, action 0 has .*nan",
    ),
    "infinite reward": (
        lambda: dense(reward=[[-INF], [0]]),
        "finite, .*: state 0, action 0 has .*-inf",
    ),
    "reward that overflows": (
        lambda: dense(reward=[[1e101], [0]]),
        r"at most 1e\+100 in size: state 0, action 0 has",
    ),
    "reward shape": (
        lambda: dense(reward=[1, 2, 3]),
        r"\(2, 1, 2\), \(2, 1\) or \(2,\): got \(3,\)",
    ),
    "transition shape": (lambda: dense([[0, 1]]), r"shape \(S, A, S\): got \(1, 2\)"),
    "terminal shape": (
        lambda: dense(terminal=[True]),
        r"terminal must have shape \(2,\): got \(1,\)",
    ),
    "states of another size": (lambda: dense(states=ROW), r"outcome_row .* \(6, 1\): got \(2, 1\)"),
    "ragged actions": (lambda: outcomes([[[(1, 1, 0)]], []], terminal=[0, 1]), "state 1 lists 0"),
    "no flag": (
        lambda: outcomes([[[(1.0, 1, 0.0)]], [[]]]),
        "terminated flag.*state 0, action 0 has",
    ),
    "flags disagree": (
        lambda: outcomes([[[(0.5, 1, 0.0, True), (0.5, 1, 0.0, False)]], [[]]]),
        "always or never: state 1 does both",
    ),
    "start out of range": (
        lambda: outcomes([[[(1.0, 1, 0.0, True)]], [[]]], start=2),
        r"start state must lie in 0\.\.1: got 2",
    ),
    "next state": (lambda: outcomes([[[(1, 2, 0, True)]], [[]]]), r"0\.\.1: got 0\.\.2"),
    "negative next state": (lambda: outcomes([[[(1, -1, 0, True)]], [[]]]), r"0\.\.1: got -1"),
    "outcome row": (
        lambda: tables(outcome_row=np.full((3, 4), 6)),
        r"outcome.rows? .* 0\.\.5: got 6",
    ),
    "table shape": (lambda: tables(reward=np.zeros((5, 1))), r"reward .* \(6, 1\): got \(5, 1\)"),
    # -- start
    "start on a terminal": (lambda: dense(start=1), "start in a terminal state: state 1"),
    "start partly there": (lambda: dense(start=[0.5, 0.5]), "state 1 has start probability 0.5"),
    "no such start": (lambda: dense(start=2), r"0\.\.1: got 2"),
    "start sum": (lambda: dense(start=[0.5, 0.4]), "sum to 1: they sum to 0.9"),
    "NaN start": (lambda: dense(start=[NAN, 1]), "start probabilities must be finite"),
    "negative start": (lambda: dense(start=[2, -1]), "not negative"),
    "start shape": (lambda: dense(start=[1]), r"shape \(2,\): got \(1,\)"),
    "no start": (lambda: dense(start=None), "start must be a state"),
    # -- discount and time limit
    "discount above 1": (lambda: dense(discount=1.01), r"\[0, 1\]: got 1.01"),
    "discount below 0": (lambda: dense(discount=-0.1), r"\[0, 1\]: got -0.1"),
    "discount NaN": (lambda: dense(discount=NAN), "discount must be finite: got nan"),
    "discount 1 for ever": (lambda: dense(ROUND, discount=1), "discount 1 needs .*from state 0"),
    "maze for ever": (
        lambda: GridWorld("S.T", discount=1, time_limit=None).mdp,
        "discount 1 needs",
    ),
    "pursuit for ever": (
        lambda: Pursuit(size=2, discount=1, time_limit=None).mdp,
        "discount 1 needs .*from state 1",
    ),
    "no time": (
        lambda: dense(time_limit=0),
        "time_limit in steps must be a whole number, at least 1: got 0",
    ),
    "negative time": (
        lambda: dense(time_limit=-5),
        "time_limit in steps must be a whole number, at least 1: got -5",
    ),
    # -- spaces
    "empty component": (
        lambda: Component("row", 0),
        "number of values of component 'row' must be a whole number, at least 1: got 0",
    ),
    "labels": (lambda: Component("row", 2, labels=("a",)), "'row' has 2 values and 1 labels"),
    "no components": (lambda: Space([]), r"at least one: got \[\]"),
    "names twice": (lambda: Space([Component("a", 1)] * 2), r"different names.*\['a', 'a'\]"),
    "points twice": (lambda: Space([Component("a", 2)], [[1], [1]]), "2 given, 1 distinct"),
    "point outside": (
        lambda: Space([Component("a", 2)], [[0], [2]]),
        "'a' runs from 0 to 1: point 1 has 2",
    ),
    "unknown component": (lambda: ROW.component("x"), "one of row, column: got 'x'"),
    "encode unknown": (lambda: ROW.encode(row=0, x=1), "components row, column: got row, x"),
    "encode nothing": (ROW.encode, "components row, column: got none"),
    "decode outside": (lambda: ROW.decode([0, 6]), r"0\.\.5: got 0\.\.6"),
    "label outside": (lambda: ROW.label(-1), r"0\.\.5: got -1"),
    # -- mazes
    "ragged map": (lambda: GridWorld(["S.", "T"]), "line 1 has 1 character, line 0 has 2"),
    "unknown character": (lambda: GridWorld(["S.", "xT"]), "S T F P # .: row 1, column 0 has 'x'"),
    "lower case": (lambda: GridWorld("s.t"), "row 0, column 0 has 's'"),
    "no treasure": (lambda: GridWorld("S.."), "needs a treasure T"),
    "empty map": (lambda: GridWorld(""), "needs a treasure T"),
    "no lines": (lambda: GridWorld([]), "needs a treasure T"),
    "no S": (lambda: GridWorld("..T"), "needs an S on the map"),
    "nowhere to start": (lambda: GridWorld("PT", start="uniform"), "cell that does not end"),
    "unknown start": (
        lambda: GridWorld("S.T", start="here"),
        "'map', 'uniform' or cells: got 'here'",
    ),
    "no start cells": (lambda: GridWorld("S.T", start=[]), r"or cells such as .*: got \[\]"),
    "start off the map": (
        lambda: GridWorld("S.T", start=[(0, 3)]),
        r"free cell of the map: got \(0, 3\)",
    ),
    "start in a wall": (lambda: GridWorld("S#T", start=[(0, 1)]), r"got \(0, 1\)"),
    "start on the treasure": (
        lambda: GridWorld("S.T", start=[(0, 2)]).mdp,
        "start in a terminal state: state 2",
    ),
    "state in a wall": (
        lambda: GridWorld("S#T").state(0, 1),
        r"free cell of the map: got \(0, 1\)",
    ),
    "combine": (
        lambda: GridWorld("S.T", combine="max"),
        "combine must be one of sum, worst: got 'max'",
    ),
    "ends": (lambda: GridWorld("S.T", ends=["lava"]), "one of treasure, fire, pit: got 'lava'"),
    "representation": (
        lambda: GridWorld("S.T", representation="polar"),
        "absolute, relative: got 'polar'",
    ),
    "NaN in rewards": (lambda: Rewards(pit=NAN), "reward pit must be finite: got nan"),
    "infinity in rewards": (lambda: Rewards(step=-INF), "reward step must be finite: got -inf"),
    "crop outside rows": (
        lambda: LINE.crop(rows=(0, 2), columns=(0, 3)),
        r"rows 0\.\.1: got 0\.\.2",
    ),
    "crop outside columns": (
        lambda: LINE.crop(rows=(0, 1), columns=(-1, 3)),
        r"columns 0\.\.3: got -1",
    ),
    "crop of nothing": (lambda: LINE.crop(rows=(0, 1), columns=(2, 2)), r"got 2\.\.2"),
    "crop turned round": (lambda: LINE.crop(rows=(0, 1), columns=(3, 1)), r"got 3\.\.1"),
    "crop without treasure": (lambda: LINE.crop(rows=(0, 1), columns=(0, 2)), "treasure T"),
    "crop of a crop": (
        lambda: LINE.crop(rows=(0, 1), columns=(1, 3)).crop(rows=(0, 1), columns=(0, 3)),
        r"columns 1\.\.3: got 0\.\.3",
    ),
    "crop without S": (lambda: LINE.crop(rows=(0, 1), columns=(1, 3), start="map"), "needs an S"),
    # -- pursuit
    "size": (lambda: Pursuit(size=1), "size must be a whole number, at least 2: got 1"),
    "no predators": (
        lambda: Pursuit(predators=0),
        "predators must be a whole number, at least 1: got 0",
    ),
    "moves": (lambda: Pursuit(moves=6), "moves must be one of 4, 5: got 6"),
    "capture": (lambda: Pursuit(capture="some"), "'any', 'as_published' or .* 1 to 2: got 'some'"),
    "capture by too many": (lambda: Pursuit(capture=3), "from 1 to 2: got 3"),
    "capture by none": (lambda: Pursuit(capture=0), "from 1 to 2: got 0"),
    "prey": (lambda: Pursuit(prey="lazy").mdp, "'uniform', an array or a function: got 'lazy'"),
    "prey shape": (
        lambda: Pursuit(size=2, prey=np.full((3, 5), 0.2)).mdp,
        r"\(4, 5\) or \(64, 5\): got \(3, 5\)",
    ),
    "prey sum": (lambda: Pursuit(size=2, prey=np.full((4, 5), 0.1)).mdp, "sum to 1: row 0 is .0.1"),
    "prey NaN": (lambda: Pursuit(size=2, prey=np.full((4, 5), NAN)).mdp, "row 0 is .nan"),
    "prey negative": (
        lambda: Pursuit(size=2, prey=[[2, -1, 0, 0, 0]] * 4).mdp,
        "row 0 is .2.0, -1.0",
    ),
    "prey function": (
        lambda: Pursuit(size=2, prey=lambda where: np.ones((2, 5))).mdp,
        r"\(64, 5\): got \(2, 5\)",
    ),
    "NaN pay": (
        lambda: Pursuit(size=2, step_reward=NAN).mdp,
        "step_reward must be finite: got nan",
    ),
    "too large": (
        lambda: Pursuit(size=10, predators=3).mdp,
        "at most 500,000,000 .*100,000,000 states",
    ),
}


@pytest.mark.parametrize(("error", "call", "says"), cases({TaskError: TASKS}))
def test_bad_input_is_refused_in_one_sentence(error, call, says):
    check_refusal(error, call, says)


@pytest.mark.parametrize(
    "allowed",
    [
        lambda: dense(discount=1),
        lambda: dense(ROUND, discount=1, time_limit=5),
        lambda: dense(discount=0),
        lambda: dense([[[0, 1]], [[0, 0.5]]]),  # rows of terminal states are never used
        lambda: dense(reward=[1, NAN]),
        lambda: GridWorld("S.T", discount=1, time_limit=5).mdp,
        lambda: GridWorld("S.T", ends=()).mdp,
    ],
)
def test_what_is_just_within_the_rules_is_allowed(allowed):
    assert allowed() is not None


def test_a_refused_table_can_be_asked_for_again():
    game = Pursuit(size=10, predators=3)
    for _ in range(2):
        with pytest.raises(TaskError):
            _ = game.mdp
