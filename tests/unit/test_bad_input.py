"""Input that makes no sense: which exception, and whether it says rule, value and place."""

import re

import numpy as np
import pytest

import curricle as cr
from curricle import (
    SARSA,
    Component,
    Curriculum,
    DoubleQLearning,
    Episodes,
    FiniteMDP,
    GreedyEvaluation,
    GridWorld,
    Pursuit,
    QLearning,
    Rewards,
    Space,
    StateActionPotential,
    StatePotential,
    Transfer,
    from_function,
    learn,
    project,
    same_position,
    solve,
)
from curricle.errors import CurriculumError, MappingError, PotentialError, SettingError, TaskError
from curricle.planning import rollout
from curricle.transfer import StateActionMapping, compose, identity, relative_objects

NAN, INF = float("nan"), float("inf")
LINE = GridWorld("S.T")
NO_LIMIT = GridWorld("S.T", time_limit=None)
HUNT, CHASE = Pursuit(size=2, predators=2), Pursuit(size=2, predators=1)
FIRST = project(HUNT, CHASE, predator="predator_1")
INDEX = identity(LINE).index
ROW = Space([Component("row", 2), Component("column", 3)])
PHI = StateActionPotential(LINE, np.ones((3, 4)))
ONE_WAY = [[[0.0, 1.0]], [[0.0, 1.0]]]
ROUND = [[[1.0, 0.0]], [[0.0, 1.0]]]
UNIFORM = np.full((3, 4), 0.25)


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


def ask(*args, **settings):
    """Learn briefly on the line."""
    learner = args[0] if args else QLearning()
    return learn(LINE, learner, **({"budget": 100} | settings))


def curriculum(**changes):
    settings = {"tasks": {"chase": CHASE, "hunt": HUNT}, "budget": 50}
    settings["transfers"] = [Transfer("chase", "hunt", FIRST)]
    return Curriculum(**(settings | changes))


def around(*names):
    """A curriculum of one task under several names, each the source of the next, in a ring."""
    here = identity(LINE)
    edges = [Transfer(s, t, here) for s, t in zip(names, names[1:] + names[:1], strict=True)]
    return Curriculum(dict.fromkeys(names, LINE), edges)


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
        "rewards must be finite: state 0, action 0 has .*nan",
    ),
    "infinite reward": (
        lambda: dense(reward=[[-INF], [0]]),
        "finite: state 0, action 0 has .*-inf",
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
    "ragged map": (lambda: GridWorld(["S.", "T"]), "line 1 has 1 characters, line 0 has 2"),
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

SETTINGS = {
    "budget 0": (
        lambda: ask(budget=0),
        "a budget in steps must be a whole number, at least 1: got 0",
    ),
    "budget -1": (lambda: ask(budget=-1), "got -1"),
    "budget 1.5": (lambda: ask(budget=1.5), "whole number.*got 1.5"),
    "budget yes": (lambda: ask(budget=True), "got True"),
    "no episodes": (
        lambda: ask(budget=Episodes(0)),
        "a budget in episodes must be a whole number, at least 1: got 0",
    ),
    "half an episode": (lambda: ask(budget=Episodes(0.5)), "whole number"),
    "episodes for ever": (
        lambda: learn(NO_LIMIT, budget=Episodes(5)),
        "needs a task with a time limit",
    ),
    "no seeds": (lambda: ask(seeds=0), "seeds must be a whole number, at least 1: got 0"),
    "empty seeds": (lambda: ask(seeds=[]), r"at least one: got \[\]"),
    "seeds twice": (lambda: ask(seeds=[3, 3]), r"different, .*got \[3, 3\]"),
    "negative seed": (
        lambda: ask(seeds=[0, -1]),
        "each of seeds must be a whole number, at least 0: got -1",
    ),
    "every 0": (
        lambda: ask(eval_freq=0),
        "eval_freq, the steps between checkpoints, must be a whole number, at least 1: got 0",
    ),
    "every -5": (lambda: ask(eval_freq=-5), "got -5"),
    "every 2.5": (lambda: ask(eval_freq=2.5), "whole number.*got 2.5"),
    "every too far": (lambda: ask(eval_freq=101), "exceed the budget of 100 steps: got 101"),
    "workers": (lambda: ask(workers=0), "workers must be a whole number, at least 1: got 0"),
    "evaluation": (
        lambda: GreedyEvaluation("best"),
        "method must be one of auto, exact, rollouts, off: got 'best'",
    ),
    "no rollouts": (lambda: GreedyEvaluation(episodes=0), "at least 1: got 0"),
    "undiscounted for ever": (
        lambda: learn(NO_LIMIT, budget=9, evaluation=GreedyEvaluation(discounted=False)),
        "needs a task with a time limit",
    ),
    "rate above 1": (lambda: QLearning(learning_rate=1.5), r"learning_rate .*\[0, 1\]: got 1.5"),
    "rate below 0": (lambda: SARSA(learning_rate=-0.1), r"learning_rate .*\[0, 1\]: got -0.1"),
    "rate NaN": (lambda: DoubleQLearning(learning_rate=NAN), "finite: got nan"),
    "rate ends badly": (
        lambda: QLearning(learning_rate=cr.learning.linear(0.5, 2, steps=9)),
        r"learning_rate .*got 2",
    ),
    "epsilon above 1": (lambda: QLearning(epsilon=1.1), r"epsilon must lie in \[0, 1\]: got 1.1"),
    "epsilon below 0": (lambda: QLearning(epsilon=-0.1), r"epsilon .*got -0.1"),
    "negative inverse temperature": (
        lambda: QLearning(inverse_temperature=-1),
        "inverse_temp.*got -1",
    ),
    "both explorations": (
        lambda: QLearning(epsilon=0.1, inverse_temperature=2.0),
        "either .*epsilon=0.1 and inverse_temperature=2.0",
    ),
    "initial value": (lambda: QLearning(initial_value=INF), "finite: got inf"),
    "constant": (lambda: cr.learning.constant(NAN), "finite: got nan"),
    "linear in no steps": (
        lambda: cr.learning.linear(1, 0, steps=0),
        "steps must be positive: got 0",
    ),
    "linear to infinity": (
        lambda: cr.learning.linear(1, INF, steps=9),
        "last must be finite: got inf",
    ),
    "half_life": (
        lambda: cr.learning.exponential(1, half_life=-1),
        "half_life must be positive: got -1",
    ),
    "half": (lambda: cr.learning.harmonic(half=0), "half must be positive: got 0"),
    "no shaping": (lambda: ask(shaping=PHI), "shaping must be a Shaping, .* got a StateActionPot"),
    "look-back with Q-learning": (
        lambda: ask(shaping=cr.LookBackAdvice(PHI)),
        "on-policy SARSA .*got QLearning",
    ),
    "look-back without discount": (
        lambda: learn(GridWorld("S.T", discount=0), SARSA(), 10, shaping=cr.LookBackAdvice()),
        "the task's discount, which must be positive: got 0",
    ),
    "states for pairs": (
        lambda: ask(shaping=cr.QInitialisation(PHI.to_state())),
        r"QInitialisation takes a potential phi\(s, a\): got a StatePotential",
    ),
    "too many potentials": (
        lambda: ask(shaping=[cr.QInitialisation(PHI)] * 2, seeds=3),
        "means 3 of them: got 2",
    ),
    "another task's potential": (
        lambda: ask(
            shaping=cr.QInitialisation(StateActionPotential(GridWorld("T.S"), np.ones((3, 4))))
        ),
        "made for the task it shapes",
    ),
    "a guard without a potential": (
        lambda: ask(shaping=cr.QInitialisation(guard=cr.Guard())),
        "a guard needs a potential to watch",
    ),
    "a guard of SARSA": (
        lambda: learn(LINE, SARSA(), 10, shaping=cr.QInitialisation(PHI, guard=cr.Guard())),
        "a guard needs the learner QLearning: got SARSA",
    ),
    "no tolerance": (lambda: solve(LINE, tolerance=0), "tolerance must be positive: got 0"),
    "tolerance below rounding": (lambda: solve(LINE, tolerance=1e-30), "at least .*got 1e-30"),
    "endless planning": (lambda: solve(GridWorld("S.T", discount=1)), "from state 0"),
    "endless policy": (
        lambda: cr.evaluate(GridWorld("S.T", discount=1), [3, 1, 0]),
        "discount 1 needs .*from state 0",
    ),
    "policy shape": (lambda: rollout(LINE, [1, 1]), r"\(3,\) or \(3, 4\): got \(2,\)"),
    "policy action": (lambda: rollout(LINE, [1, 4, 0]), r"0\.\.3: state 1 has 4"),
    "policy of fractions": (lambda: rollout(LINE, [1.0, 1.0, 0.0]), "integers: got float64"),
    "policy sum": (lambda: rollout(LINE, 2 * UNIFORM), r"sum to 1: state 0 has \[0.5"),
    "policy NaN": (lambda: cr.evaluate(LINE, NAN * UNIFORM), "sum to 1: state 0 has .nan"),
    "rollout from the end": (lambda: rollout(LINE, UNIFORM, start=2), "not terminal: got 2"),
    "rollout from nowhere": (lambda: rollout(LINE, UNIFORM, start=-1), "got -1"),
    "rollout of no steps": (
        lambda: rollout(LINE, UNIFORM, steps=0),
        "the limit of a rollout in steps must be a whole number, at least 1: got 0",
    ),
    "rollout for ever": (lambda: rollout(NO_LIMIT, UNIFORM), "limit .*got None"),
}

POTENTIALS = {
    "pair shape": (lambda: StateActionPotential(LINE, np.ones((4, 3))), r"\(3, 4\): got \(4, 3\)"),
    "state shape": (lambda: StatePotential(LINE, [1, 2]), r"\(3,\) or \(M, 3\): got \(2,\)"),
    "number": (lambda: StatePotential(LINE, 1.0), r"got \(\)"),
    "pair NaN": (
        lambda: StateActionPotential(LINE, np.where(np.arange(12) == 6, NAN, 0).reshape(3, 4)),
        r"phi must be finite: entry \(1, 2\) is nan",
    ),
    "state infinite": (lambda: StatePotential(LINE, [0, -INF, 0]), r"Phi .*entry \(1,\) is -inf"),
    "frames without steps": (lambda: StatePotential(LINE, np.ones((2, 3))), r"2 frames: got \[0\]"),
    "frames late": (
        lambda: StatePotential(LINE, np.ones(3), frame_steps=[1]),
        r"from 0.*got \[1\]",
    ),
    "frames falling": (
        lambda: StatePotential(LINE, np.ones((3, 3)), frame_steps=[0, 5, 5]),
        r"rise from 0.*got \[0, 5, 5\]",
    ),
}

MAPPINGS = {
    "shape": (
        lambda: StateActionMapping(LINE, LINE, INDEX[:2]),
        r"\(3, 4\): got int64 of shape \(2, 4\)",
    ),
    "floats": (lambda: StateActionMapping(LINE, LINE, INDEX * 1.0), "integer array .*got float64"),
    "booleans": (lambda: StateActionMapping(LINE, LINE, INDEX > 0), "got bool"),
    "too high": (
        lambda: StateActionMapping(LINE, LINE, np.where(INDEX == 5, 12, INDEX)),
        r"0\.\.11.*state 1, action 1 has 12",
    ),
    "too low": (
        lambda: StateActionMapping(LINE, LINE, np.where(INDEX == 2, -3, INDEX)),
        "state 0, action 2 has -3",
    ),
    "onto a terminal": (
        lambda: StateActionMapping(LINE, LINE, np.where(INDEX == 4, 8, INDEX)),
        "terminal source state.*state 1, action 0 points at source state 2",
    ),
    "unmapped_value": (lambda: same_position(LINE, LINE, unmapped_value=NAN), "finite: got nan"),
    "values of another shape": (
        lambda: identity(LINE).read(np.ones((4, 3))),
        r"\(3, 4\): got \(4, 3\)",
    ),
    "edge values": (
        lambda: Transfer("chase", "hunt", FIRST).potential(np.ones((3, 3))),
        r"\(16, 5\): got \(3, 3\)",
    ),
    "position of pursuit": (lambda: same_position(LINE, CHASE), "GridWorld: the source is Pursuit"),
    "objects of pursuit": (
        lambda: relative_objects(CHASE, LINE),
        "GridWorld: the target is Pursuit",
    ),
    "component needs a name": (
        lambda: project(HUNT, CHASE),
        "'predator' must be read .*prey, predator_1, predator_2.*got 'predator'",
    ),
    "unknown target component": (
        lambda: project(HUNT, CHASE, predator="wolf"),
        r"\(prey, predator_1, predator_2\): got 'wolf'",
    ),
    "unknown source component": (
        lambda: project(HUNT, CHASE, wolf="prey"),
        r"\(predator, prey\): got 'wolf'",
    ),
    "function without components": (
        lambda: from_function(LINE, LINE, lambda s, a: ({"row": s["row"]}, a)),
        "state components row, column: got row",
    ),
    "function of other actions": (
        lambda: from_function(LINE, LINE, lambda s, a: (s, {"jump": a["move"]})),
        "action components move: got jump",
    ),
    "function of another shape": (
        lambda: from_function(LINE, LINE, lambda s, a: ({"row": 0, "column": 0}, {"move": 0})),
        r"shape \(3, 4\): got int64 of shape \(\)",
    ),
    "no way from one to the next": (
        lambda: compose(identity(LINE), FIRST),
        "source to be the second's",
    ),
}

CURRICULA = {
    "no tasks": (lambda: Curriculum({}), "at least one task"),
    "unknown source": (
        lambda: curriculum(transfers=[Transfer("x", "hunt", FIRST)]),
        "a transfer's source must be one of chase, hunt: got 'x'",
    ),
    "unknown target": (
        lambda: curriculum(transfers=[Transfer("chase", "x", FIRST)]),
        "a transfer's target must be one of chase, hunt: got 'x'",
    ),
    "mapping of other tasks": (
        lambda: curriculum(transfers=[Transfer("hunt", "chase", FIRST)]),
        "source is not the task 'hunt' in hunt -> chase",
    ),
    "cycle of one": (lambda: around("a"), "no cycle: a -> a"),
    "cycle of three": (
        lambda: around("a", "b", "c"),
        "no cycle: (a -> b -> c -> a|b -> c -> a -> b|c -> a -> b -> c)$",
    ),
    "settings of unknown tasks": (
        lambda: curriculum(budget={"x": 9}),
        "budget .*chase, hunt: got 'x'",
    ),
    "learner of unknown tasks": (lambda: curriculum(learner={"x": SARSA()}), "learner .*got 'x'"),
    "scale": (
        lambda: Transfer("chase", "hunt", FIRST, scale=NAN),
        "scale of chase -> hunt must be finite: got nan",
    ),
    "shift": (
        lambda: Transfer("chase", "hunt", FIRST, shift=INF),
        "shift of chase -> hunt must be finite: got inf",
    ),
    "aggregate of another shape": (
        lambda: curriculum(aggregate=lambda phi: phi).train(),
        r"shape \(64, 25\): <lambda> returned \(1, 64, 25\)",
    ),
    "aggregate of NaN": (
        lambda: curriculum(aggregate=lambda phi: phi[0] * NAN).train(),
        "finite values: <lambda> returned nan at state 0, action 0",
    ),
    "result of an unknown task": (
        lambda: curriculum().train(trained={"x": learn(CHASE, budget=9)}),
        "belong to a task of the curriculum: 'x'",
    ),
    "result of another task": (
        lambda: curriculum().train(trained={"hunt": learn(CHASE, budget=9)}),
        "'hunt' does not",
    ),
    "result of other seeds": (
        lambda: curriculum().train(2, trained={"chase": learn(CHASE, budget=9)}),
        r"seeds asked for, \(0, 1\): 'chase' has \(0,\)",
    ),
    "unknown node": (lambda: curriculum().train()["x"], "one of chase, hunt: got 'x'"),
}

TABLES = {
    TaskError: TASKS,
    SettingError: SETTINGS,
    PotentialError: POTENTIALS,
    MappingError: MAPPINGS,
    CurriculumError: CURRICULA,
}


@pytest.mark.parametrize(
    ("error", "call", "says"),
    [
        pytest.param(e, *case, id=f"{e.__name__}-{n}")
        for e, t in TABLES.items()
        for n, case in t.items()
    ],
)
def test_bad_input_is_refused_in_one_sentence(error, call, says):
    with pytest.raises(error) as caught:
        call()
    assert type(caught.value) is error
    assert isinstance(caught.value, ValueError)
    message = str(caught.value)
    assert re.search(says, message), message
    assert "\n" not in message
    assert not re.search(r"\. |\.$", message.replace("# .:", "")), "one sentence, no full stop"


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
        lambda: QLearning(learning_rate=0, epsilon=1),
        lambda: ask(eval_freq=100),
        lambda: ask(budget=np.int32(100), seeds=np.int64(1)),
    ],
)
def test_what_is_just_within_the_rules_is_allowed(allowed):
    assert allowed() is not None


# -- nothing is touched, nothing half-built -------------------------------------------------------


def test_refused_arrays_are_as_they_were_and_still_writable():
    arrays = {
        "transition": np.array([[[0.0, 0.9]], [[0.0, 1.0]]]),
        "terminal": np.array([False, True]),
        "start": np.array([1.0, 0.0]),
        "index": np.where(INDEX == 4, 8, INDEX),
        "phi": np.full((3, 4), NAN),
    }
    before = {name: array.copy() for name, array in arrays.items()}
    for error, call in [
        (TaskError, lambda a: dense(a["transition"], terminal=a["terminal"], start=a["start"])),
        (MappingError, lambda a: StateActionMapping(LINE, LINE, a["index"])),
        (PotentialError, lambda a: StateActionPotential(LINE, a["phi"])),
    ]:
        with pytest.raises(error):
            call(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(array, before[name])
        assert array.flags.writeable


def test_a_refused_learning_runs_nothing_and_leaves_the_potential():
    before = PHI.values.copy()
    for wrong in ({"eval_freq": 0}, {"seeds": []}, {"shaping": "magic"}, {"workers": 0}):
        with pytest.raises(SettingError):
            ask(
                **({"shaping": cr.QInitialisation(PHI), "budget": 2**40} | wrong)
            )  # would take weeks if it ran
    assert (PHI.values == before).all()


@pytest.mark.parametrize("wrong", [{"seeds": []}, {"seeds": 2, "trained": "other seeds"}])
def test_a_refused_curriculum_trains_nothing(wrong):
    seen, kept = [], {"chase": learn(CHASE, budget=9)}
    if "trained" in wrong:
        wrong = wrong | {"trained": kept}
    with pytest.raises(cr.CurricleError):
        curriculum().train(**wrong, progress=seen.append)
    assert seen == []
    assert set(kept) == {"chase"}


def test_a_refused_table_can_be_asked_for_again():
    game = Pursuit(size=10, predators=3)
    for _ in range(2):
        with pytest.raises(TaskError):
            _ = game.mdp
