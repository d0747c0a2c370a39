"""Tasks that make no sense: which exception, and whether it gives rule, value and place."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import curricle as cr
from curricle import Component, FiniteMDP, GridWorld, Pursuit, Space
from curricle.errors import TaskError
from curricle.tasks import (
    CliffWalking,
    DeepSea,
    FourRooms,
    FrozenLake,
    GoalDistance,
    KeyLockPit,
    RiverSwim,
    frozen_lake_family,
    goal_distance,
    random_maze,
    river_swim_family,
    with_start,
)
from tests.support.refusals import check_refusal, check_values
from tests.support.tasks import ring

NAN = float("nan")
LINE, CHASE = GridWorld("S.T"), Pursuit(3, 1)
MAZE = GridWorld(["S..P", ".#.T", "...."])
ROW = Space([Component("row", 2), Component("column", 3)])
ONE_WAY = [[[0.0, 1.0]], [[0.0, 1.0]]]
ROUND = [[[1.0, 0.0]], [[0.0, 1.0]]]


def dense(transition=ONE_WAY, reward=(1, 0), **changes):
    settings = {"terminal": [False, True], "start": 0, "discount": 0.9}
    return FiniteMDP.from_dense(transition, reward, **(settings | changes))


def outcomes(lists, **changes):
    return FiniteMDP.from_outcomes(lists, **({"start": 0, "discount": 0.9} | changes))


def tables(**changes):
    return replace(LINE.mdp, **changes)


WIDE = Pursuit(size=10, predators=6)
TASKS = [
    (lambda: dense([[[0, 0.9]], [[0, 1]]]), "sum to 1: state 0, action 0 sums to 0.9"),
    (lambda: dense([[[0, NAN]], [[0, 1]]]), "sum to 1: state 0, action 0 .*nan"),
    (lambda: dense([[[-0.1, 1.1]], [[0, 1]]]), "not be negative: state 0, .*-0.1"),
    (lambda: dense(reward=[NAN, 0]), "rewards must be finite, .*: state 0, action 0 has .*nan"),
    (lambda: dense(reward=[[1e101], [0]]), r"at most 1e\+30 in size: state 0, action 0 has"),
    (lambda: dense(reward=[1, 2, 3]), r"\(2, 1, 2\), \(2, 1\) or \(2,\): got \(3,\)"),
    (lambda: dense([[0, 1]]), r"shape \(S, A, S\): got \(1, 2\)"),
    (lambda: dense(terminal=[True]), r"terminal must have shape \(2,\): got \(1,\)"),
    (lambda: dense(states=ROW), r"outcome_row .* \(6, 1\): got \(2, 1\)"),
    (lambda: outcomes([[[(1, 1, 0)]], []], terminal=[0, 1]), "state 1 lists 0"),
    (lambda: outcomes([[[(1.0, 1, 0.0)]], [[]]]), "terminated flag.*state 0, action 0 has"),
    (lambda: outcomes([[np.zeros(2)], [[]]]), "terminated flag: state 0, action 0 has"),
    (lambda: outcomes([[[(0.5, 1, 0.0, True), (0.5, 1, 0.0, False)]], [[]]]), "state 1 does both"),
    (
        lambda: outcomes([[[(1.0, 1, 0.0)]], [[(1.0, 2, 0.0, False)]], [[]]], terminal=[0, 0, 1]),
        "as terminal has it .*: state 2 does both, at last from state 1, action 0",
    ),
    (lambda: outcomes([[[(1.0, 1, 0.0, True)]], [[]]], start=2), r"must lie in 0\.\.1: got 2"),
    (lambda: outcomes([[[(1, 2, 0, True)]], [[]]]), r"0\.\.1: state 0, action 0 has \(1, 2, 0"),
    (
        lambda: outcomes([[[(1, 5, 0, False)]]]),
        r"next states must lie in 0\.\.0: state 0, action 0",
    ),
    (lambda: dense(start=["a", "b"]), r"start must be an array of numbers: got \['a', 'b'\]"),
    (lambda: tables(outcome_row=np.full((3, 4), 6)), r"outcome.rows? .* 0\.\.5: got 6"),
    (lambda: dense(start=[0.5, 0.5]), "state 1 has start probability 0.5"),
    (lambda: dense(start=[0.5, 0.4]), "sum to 1: they sum to 0.9"),
    (lambda: dense(start=[NAN, 1]), "start probabilities must be finite"),
    (lambda: dense(start=[2, -1]), "not negative"),
    (lambda: dense(start=[1]), r"shape \(2,\): got \(1,\)"),
    (lambda: dense(discount=1.01), r"\[0, 1\]: got 1.01"),
    (lambda: dense(ROUND, discount=1), "discount 1 needs .*from state 0"),
    (lambda: Component("row", 0), "of component 'row' must be a whole number, at least 1: got 0"),
    (lambda: Component("row", 2, labels=("a",)), "'row' has 2 values and 1 labels"),
    (lambda: Space([Component("a", 1)] * 2), r"different names.*\['a', 'a'\]"),
    (lambda: Space([Component("a", 2)], [[1], [1]]), "2 given, 1 distinct"),
    (lambda: Space([Component("a", 2)], [[0, 1]]), "S at least 1"),
    (lambda: Space([Component("a", 2)], [[0], [2]]), "'a' runs from 0 to 1: point 1 has 2"),
    (lambda: ROW.encode(row=0, x=1), "components row, column: got row, x"),
    (lambda: ROW.decode([0, 6]), r"0\.\.5: got 0\.\.6"),
    (lambda: GridWorld(["S.", "T"]), "line 1 has 1 character, line 0 has 2"),
    (lambda: GridWorld(["S.", "xT"]), "S T F P # .: row 1, column 0 has 'x'"),
    (lambda: GridWorld("S.."), "needs a treasure T"),
    (lambda: GridWorld("..T"), "needs an S on the map"),
    (lambda: GridWorld("PT", start="uniform"), "state that does not end"),
    (lambda: GridWorld("S.T", start="here"), "'map', 'uniform' or cells such as .*: got 'here'"),
    (lambda: GridWorld("S.T", start=[]), r"or cells such as .*: got \[\]"),
    (lambda: GridWorld("S.T", start=[(0, 3)]), r"free cell that does not end it: got \(0, 3\)"),
    (lambda: GridWorld("S.T", combine="max"), "combine must be one of sum, worst: got 'max'"),
    (lambda: GridWorld("S.T", ends=["lava"]), "one of treasure, fire, pit: got 'lava'"),
    (lambda: GridWorld("S.O"), "column 2 has 'O'; legend={'O': 'wall'} makes it a wall"),
    (lambda: GridWorld("S.T", legend={"O": "hole"}), "which of start, .* they are.*: got {'O'"),
    (lambda: GridWorld("S.T", legend={"OO": "pit"}), "single characters"),
    (lambda: GridWorld("S.T", legend="lake"), "or be one of frozen_lake: got 'lake'"),
    (lambda: LINE.crop(rows=(0, 2), columns=(0, 3)), r"rows 0\.\.1: got 0\.\.2"),
    (lambda: LINE.crop(rows=(0, 1), columns=(-1, 3)), r"columns 0\.\.3: got -1"),
    (lambda: LINE.crop(rows=(0, 1), columns=(2, 2)), r"got 2\.\.2"),
    (lambda: Pursuit(capture="some"), "'any', 'as_published' or .* 1 to 2: got 'some'"),
    (lambda: Pursuit(capture=3), "from 1 to 2: got 3"),
    (lambda: Pursuit(size=1e308), "size must be a whole number below 2.63"),
    (lambda: Component(None, 2), "name of a component must be text, not empty"),
    (lambda: Component("a", 2, low=2**63 - 1), "highest value of component 'a' must be"),
    (lambda: Component("a", 2, labels=(1, 2)), "label .* must be text"),
    (lambda: Space(["a"]), "components must be a list of Component"),
    (lambda: Space([Component("a", 2)], np.zeros((0, 1), int)), "S at least 1"),
    (
        lambda: Space([Component(f"c{i}", 10) for i in range(30)]),
        r"fewer than 2\^63 points: c0, c1, c2, c3, c4, c5 and 24 more make 2\^99.7",
    ),
    (lambda: Pursuit(100, predators=12), r"size 100 and 12 predators make 2\^172.7"),
    (WIDE.states.decode, "all points of a space must fit half of the machine's"),
    (lambda: WIDE.terminal, "a flag for each state of a pursuit must fit half"),
    (lambda: cr.GridWorld("S.T", ends=5), "ends must be names of objects: got 5"),
    (lambda: dense(np.zeros((0, 2, 0)), [], terminal=[]), r"shape \(S, A, S\)"),
    (lambda: dense(terminal=[0.5, 1]), "terminal must be flags"),
    # Domains, in the order of their modules.
    (lambda: random_maze(size=1), "size of a maze must be a whole number, at least 2: got 1"),
    (lambda: random_maze(walls=0.9, fires=0.2), "sum to at most 1: got 0.9, 0.05 and 0.2"),
    (lambda: random_maze(corner="north"), "corner of a maze must be one of north-west"),
    (lambda: DeepSea(start="bottom"), "'surface', 'uniform' or cells"),
    (lambda: DeepSea(start=[1, 2]), r"cells such as"),
    (lambda: DeepSea(start=[(2, 3)]), r"free cell .*got \(2, 3\)"),
    (lambda: DeepSea(4).bottom(5), r"part of a sea must lie in \[1, 4\]"),
    (lambda: RiverSwim(forward=0.7, back=0.4), "at most 1 together: got 0.7 and 0.4"),
    (lambda: RiverSwim().crop(positions=(4, 7)), r"positions 0..6: got \(4, 7\)"),
    (lambda: RiverSwim(discount=1, time_limit=None).mdp, "needs a time limit"),
    (lambda: FourRooms(goal="up"), "one of the hallways 'north', .*got 'up'"),
    (lambda: FourRooms(goal=(0, 3)), r"goal needs a free .*got \(0, 3\)"),
    (lambda: FourRooms(goal=(1, 2, 3)), "one of the hallways .*, or a row and a column"),
    (lambda: FourRooms(start=[(1, 1), (6, 6)]), r"free cell that does not end it: got \(6, 6\)"),
    (lambda: FourRooms(start="map"), "'corner', 'uniform' or cells such as .*: got 'map'"),
    (lambda: FourRooms(rows=(0, 1)), "a crop needs a free cell: rows 0..1"),
    (lambda: FourRooms(rows=(3, 9)).crop(rows=(2, 8), columns=(0, 13)), r"rows 3..9: got 2..8"),
    (lambda: FourRooms(columns=(3,)), "a first and an end"),
    (lambda: FourRooms(rows=(7, 8), columns=(9, 10)), "needs a state that does not end"),
    (lambda: KeyLockPit("S.P"), "needs a key K or a lock L: there is none"),
    (lambda: KeyLockPit("KL"), "needs an S on the map"),
    (lambda: KeyLockPit("SK", keys_held=True), r"not end it: got \(0, 0\)"),
    (lambda: KeyLockPit("K", start="uniform", keys_held=True), "needs a state that does not end"),
    (lambda: KeyLockPit("S" + "K" * 30), "at most 5,000,000 states: 31 cells and"),
    (lambda: FrozenLake(["HH", "HG"], start="uniform"), "needs a state that does not end"),
    (lambda: FrozenLake().crop(rows=(0, 2), columns=(0, 2)), "a lake needs a goal G"),
    # Members of their families.
    (lambda: frozen_lake_family(map="4x4", part=4), "than the lake's 4 rows: got frozen_lake"),
    (lambda: frozen_lake_family(map="random", size=5, part=6), "less than the lake's 5 rows"),
    (lambda: frozen_lake_family(size=6), "size of frozen_lake is of random lakes"),
    (lambda: river_swim_family(forward=0.7, back=0.5), "be at most 1 together: got river_swim"),
    # Starts and goals.
    (lambda: with_start(MAZE, GoalDistance(30)), "lies 30..30 steps from the goal: the farthest"),
    (lambda: with_start(MAZE, [0, 0, 1, 0]), r"none twice .*: got \[0, 0, 1, 0\]"),
    (lambda: with_start(MAZE, [3]), "must not start in a terminal state: state 3"),
    (lambda: with_start(ring(), "uniform"), "given by functions or played live has no tables"),
    (lambda: with_start(RiverSwim(), GoalDistance(1)), "none is terminal and can be entered"),
    (lambda: GoalDistance(3, 2), "the highest distance to the goal must be .* at least 3: got 2"),
    (lambda: goal_distance(CHASE, {"prey": "(9,9)"}), r"prey runs from \(0,0\) to .*'\(9,9\)'"),
    (lambda: goal_distance(MAZE, {"row": 9}), "row runs from 0 to 2: got 9"),
]
VALUES = [
    (FrozenLake, {"map": ["5x5", 3, ["SF", "G"]], "origin": [(1, 2, 3)]}),
    (FrozenLake, {"start": ["there", [(1, 1)], [(9, 9)], [], 7]}),
    (CliffWalking, {"start": [[(3, 5)], "goal", 3]}),
    (partial(frozen_lake_family, map="random"), {"size": [1], "frozen_share": [0.2], "seed": [-1]}),
    (RiverSwim, {"start": [[6], (), [[1], [2, 3]], [1.5], 1]}),
    (KeyLockPit, {"map": [3, ["SK", "L"]], "origin": [3]}),
    (partial(KeyLockPit, "KLP#"), {"start": [[(0, 2)], [(0, 3)], [(0, 9)], "corner"]}),
    (KeyLockPit.room, {"size": [3, 2000]}),
    (partial(with_start, MAZE), {"start": ["far", [99], [], np.ones(3) / 3, {"a": 1}]}),
    (partial(goal_distance, MAZE), {"goal": [{"x": 1}]}),
    (partial(goal_distance, MAZE), {"goal": [{"row": 1, "column": 1}, np.ones(3, bool), [99]]}),
    (GoalDistance, {"low": [-1]}),
]


@pytest.mark.parametrize(("call", "says"), TASKS)
def test_bad_input_is_refused_in_one_sentence(call, says):
    check_refusal(TaskError, call, says)


@pytest.mark.parametrize(("call", "wrong"), VALUES)
def test_wrong_values_are_named(call, wrong):
    check_values(TaskError, call, wrong)


def test_values_at_the_edge_of_64_bits_are_numbered_without_overflow():
    edge = Space([Component("a", 3, low=1 - 2**63), Component("b", 2, low=2**63 - 2)])
    low, high = 1 - 2**63, 2**63 - 1
    assert edge.encode(a=[low, low + 2, low + 3, high], b=[high, high, high, low]).tolist() == [
        1, 5, -1, -1
    ]  # fmt: skip
    assert [int(values[0]) for values in edge.decode([5]).values()] == [low + 2, high]
    with pytest.raises(TaskError, match=r"component 'a' must be below 2\^63"):
        edge.encode(a=np.array([2**63], np.uint64), b=0)


def test_a_lookup_of_another_task_is_refused():
    """Loops would read outside of the sources' values."""
    hunt, chase = Pursuit(3, 2), Pursuit(3, 1)
    edge = cr.Transfer("chase", "hunt", cr.project(hunt, chase, predator="predator_1"))
    trained = cr.Curriculum({"chase": chase, "hunt": hunt}, [edge], budget=50).train()
    lookup = trained.potentials["hunt"][0].lookup
    assert cr.learning.MappedPotential(hunt, lookup).values.shape == (729, 25)
    for task, candidate in (
        (Pursuit(4, 2), lookup),
        (hunt, lookup._replace(first=lookup.first + 10**6)),
        (hunt, lookup._replace(strides=lookup.strides * 10**6)),
        (hunt, lookup._replace(strides_at=lookup.strides_at - 1)),
        (hunt, lookup._replace(action=lookup.action + 10**6)),
        (hunt, None),
    ):
        with pytest.raises(cr.errors.PotentialError, match="lookup must be made for its task"):
            cr.learning.MappedPotential(task, candidate)


@pytest.mark.parametrize("state", [-1, 6, 0.5, None, "x", [[1], [1, 2]], 2**64])
def test_states_that_are_none_of_a_task_are_refused_by_its_potentials(state):
    phi = cr.StateActionPotential(cr.GridWorld("S.T"), np.ones((3, 4)))
    with pytest.raises(cr.errors.PotentialError, match="states must be whole numbers"):
        phi.to_state().shaping_reward(state, 0)


def test_probabilities_of_float32_are_divided_by_their_sums():
    """0.9 + 0.1 of float32 is 1 - 2e-8; what is further off than its rounding is refused."""
    rows = np.array([[[0.9, 0.1]], [[0, 1]]], np.float32)
    rounded = dense(rows, start=np.array([1, 0], np.float32))
    assert rounded.probability[0].sum() == 1
    listed = outcomes([[[(p, s, 0.0) for s, p in enumerate(rows[0, 0])]], [[]]],
                      terminal=[False, True])  # fmt: skip
    np.testing.assert_array_equal(rounded.probability[0], listed.probability[0])
    near = dense([[[0.9, 0.1 - 9e-9]], [[0, 1]]])
    assert near.probability[0].tolist() == [0.9, 0.1 - 9e-9]  # as it always was
    with pytest.raises(TaskError, match=r"state 0, action 0 sums to 0\.999998"):
        dense([[[0.9, 0.1 - 2e-6]], [[0, 1]]])
    assert dense(ONE_WAY, start=[1 - 1e-7, 0]).start.tolist() == [1, 0]
    even = np.full((2, 1), np.float32(1 - 6e-8))
    assert cr.evaluate(rounded, even).values[1] == 0


@pytest.mark.parametrize("drawn", ["\ufeffS.T", "\ufeff\n  S.T", ["\ufeffS.T"]])
def test_a_byte_order_mark_is_no_part_of_a_map(drawn):
    assert GridWorld(drawn).map == GridWorld("S.T").map
