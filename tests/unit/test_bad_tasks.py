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
from tests.refusals import check_refusal

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


TASKS = [
    (lambda: dense([[[0, 0.9]], [[0, 1]]]), "sum to 1: state 0, action 0 sums to 0.9"),
    (lambda: dense([[[0, 1], [0.2, 0.9]], [[0, 1], [0, 1]]]), "state 0, action 1 sums to 1.1"),
    (lambda: dense([[[0, NAN]], [[0, 1]]]), "sum to 1: state 0, action 0 .*nan"),
    (lambda: dense([[[-0.1, 1.1]], [[0, 1]]]), "not be negative: state 0, .*-0.1"),
    (lambda: outcomes([[[]], [[]]], terminal=[False, True]), "state 0, action 0 sums to 0"),
    (lambda: dense(reward=[NAN, 0]), "rewards must be finite, .*: state 0, action 0 has .*nan"),
    (lambda: dense(reward=[[1e101], [0]]), r"at most 1e\+100 in size: state 0, action 0 has"),
    (lambda: dense(reward=[1, 2, 3]), r"\(2, 1, 2\), \(2, 1\) or \(2,\): got \(3,\)"),
    (lambda: dense([[0, 1]]), r"shape \(S, A, S\): got \(1, 2\)"),
    (lambda: dense(terminal=[True]), r"terminal must have shape \(2,\): got \(1,\)"),
    (lambda: dense(states=ROW), r"outcome_row .* \(6, 1\): got \(2, 1\)"),
    (lambda: outcomes([[[(1, 1, 0)]], []], terminal=[0, 1]), "state 1 lists 0"),
    (lambda: outcomes([[[(1.0, 1, 0.0)]], [[]]]), "terminated flag.*state 0, action 0 has"),
    (lambda: outcomes([[[(0.5, 1, 0.0, True), (0.5, 1, 0.0, False)]], [[]]]), "state 1 does both"),
    (lambda: outcomes([[[(1.0, 1, 0.0, True)]], [[]]], start=2), r"must lie in 0\.\.1: got 2"),
    (lambda: outcomes([[[(1, 2, 0, True)]], [[]]]), r"0\.\.1: got 0\.\.2"),
    (lambda: tables(outcome_row=np.full((3, 4), 6)), r"outcome.rows? .* 0\.\.5: got 6"),
    (lambda: tables(reward=np.zeros((5, 1))), r"reward .* \(6, 1\): got \(5, 1\)"),
    (lambda: dense(start=1), "start in a terminal state: state 1"),
    (lambda: dense(start=[0.5, 0.5]), "state 1 has start probability 0.5"),
    (lambda: dense(start=[0.5, 0.4]), "sum to 1: they sum to 0.9"),
    (lambda: dense(start=[NAN, 1]), "start probabilities must be finite"),
    (lambda: dense(start=[2, -1]), "not negative"),
    (lambda: dense(start=[1]), r"shape \(2,\): got \(1,\)"),
    (lambda: dense(start=None), "start must be a state"),
    (lambda: dense(discount=1.01), r"\[0, 1\]: got 1.01"),
    (lambda: dense(discount=NAN), "discount must be finite: got nan"),
    (lambda: dense(ROUND, discount=1), "discount 1 needs .*from state 0"),
    (lambda: Pursuit(size=2, discount=1, time_limit=None).mdp, "discount 1 needs .*from state 1"),
    (lambda: dense(time_limit=0), "time_limit in steps must be a whole number, at least 1: got 0"),
    (lambda: Component("row", 0), "of component 'row' must be a whole number, at least 1: got 0"),
    (lambda: Component("row", 2, labels=("a",)), "'row' has 2 values and 1 labels"),
    (lambda: Space([]), r"at least one: got \[\]"),
    (lambda: Space([Component("a", 1)] * 2), r"different names.*\['a', 'a'\]"),
    (lambda: Space([Component("a", 2)], [[1], [1]]), "2 given, 1 distinct"),
    (lambda: Space([Component("a", 2)], [[0], [2]]), "'a' runs from 0 to 1: point 1 has 2"),
    (lambda: ROW.component("x"), "one of row, column: got 'x'"),
    (lambda: ROW.encode(row=0, x=1), "components row, column: got row, x"),
    (lambda: ROW.decode([0, 6]), r"0\.\.5: got 0\.\.6"),
    (lambda: GridWorld(["S.", "T"]), "line 1 has 1 character, line 0 has 2"),
    (lambda: GridWorld(["S.", "xT"]), "S T F P # .: row 1, column 0 has 'x'"),
    (lambda: GridWorld("S.."), "needs a treasure T"),
    (lambda: GridWorld("..T"), "needs an S on the map"),
    (lambda: GridWorld("PT", start="uniform"), "cell that does not end"),
    (lambda: GridWorld("S.T", start="here"), "'map', 'uniform' or cells: got 'here'"),
    (lambda: GridWorld("S.T", start=[]), r"or cells such as .*: got \[\]"),
    (lambda: GridWorld("S.T", start=[(0, 3)]), r"free cell of the map: got \(0, 3\)"),
    (lambda: GridWorld("S.T", start=[(0, 2)]).mdp, "start in a terminal state: state 2"),
    (lambda: GridWorld("S#T").state(0, 1), r"free cell of the map: got \(0, 1\)"),
    (lambda: GridWorld("S.T", combine="max"), "combine must be one of sum, worst: got 'max'"),
    (lambda: GridWorld("S.T", ends=["lava"]), "one of treasure, fire, pit: got 'lava'"),
    (lambda: GridWorld("S.T", representation="polar"), "absolute, relative: got 'polar'"),
    (lambda: Rewards(pit=NAN), "reward pit must be finite: got nan"),
    (lambda: LINE.crop(rows=(0, 2), columns=(0, 3)), r"rows 0\.\.1: got 0\.\.2"),
    (lambda: LINE.crop(rows=(0, 1), columns=(-1, 3)), r"columns 0\.\.3: got -1"),
    (lambda: LINE.crop(rows=(0, 1), columns=(2, 2)), r"got 2\.\.2"),
    (lambda: LINE.crop(rows=(0, 1), columns=(0, 2)), "treasure T"),
    (
        lambda: LINE.crop(rows=(0, 1), columns=(1, 3)).crop(rows=(0, 1), columns=(0, 3)),
        r"columns 1\.\.3: got 0\.\.3",
    ),
    (lambda: LINE.crop(rows=(0, 1), columns=(1, 3), start="map"), "needs an S"),
    (lambda: Pursuit(size=1), "size must be a whole number, at least 2: got 1"),
    (lambda: Pursuit(predators=0), "predators must be a whole number, at least 1: got 0"),
    (lambda: Pursuit(moves=6), "moves must be one of 4, 5: got 6"),
    (lambda: Pursuit(capture="some"), "'any', 'as_published' or .* 1 to 2: got 'some'"),
    (lambda: Pursuit(capture=3), "from 1 to 2: got 3"),
    (lambda: Pursuit(prey="lazy").mdp, "'uniform', an array or a function: got 'lazy'"),
    (lambda: Pursuit(size=2, prey=np.full((3, 5), 0.2)).mdp, r"5\) or \(64, 5\): got \(3, 5\)"),
    (lambda: Pursuit(size=2, prey=np.full((4, 5), 0.1)).mdp, "sum to 1: row 0 is .0.1"),
    (lambda: Pursuit(size=2, prey=np.full((4, 5), NAN)).mdp, "row 0 is .nan"),
    (lambda: Pursuit(size=2, prey=[[2, -1, 0, 0, 0]] * 4).mdp, "row 0 is .2.0, -1.0"),
    (lambda: Pursuit(size=2, prey=lambda where: np.ones((2, 5))).mdp, r"\(64, 5\): got \(2, 5\)"),
    (lambda: Pursuit(size=2, step_reward=NAN).mdp, "step_reward must be finite: got nan"),
    (lambda: Pursuit(size=10, predators=3).mdp, "at most 500,000,000 .*100,000,000 states"),
]


@pytest.mark.parametrize(("call", "says"), TASKS)
def test_bad_input_is_refused_in_one_sentence(call, says):
    check_refusal(TaskError, call, says)


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
