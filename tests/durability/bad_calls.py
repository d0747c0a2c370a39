"""Makes bad calls of the public names, and prints what became of each, a line of JSON a call.

Usage: python bad_calls.py SEED FIRST CALLS. The n-th call depends on SEED and n alone. It takes a
call that works and puts one or two values in the place of its arguments that do not belong there.
"""

import json
import random
import resource
import sys
import time
import warnings
from functools import cache

import numpy as np

import curricle as cr

NAN, INF = float("nan"), float("inf")
MEMORY = 24 * 2**30
MAZE = cr.GridWorld(["S..", ".FT"], time_limit=20)
NEAR = MAZE.crop(rows=(0, 2), columns=(1, 3))
HUNT, CHASE = cr.Pursuit(3, 2, time_limit=20), cr.Pursuit(3, 1, time_limit=20)
RING = cr.Space([cr.Component("place", 8)]), cr.Space([cr.Component("move", 2)])
HUGE = cr.Space([cr.Component(f"c{i}", 10) for i in range(18)])
OFF = cr.GreedyEvaluation("off")


class Ring:
    """An environment by the letter of Gymnasium; the answers to be shown come from outside."""

    def __init__(self, shown=0, reward=0.0):
        self.shown, self.reward = shown, reward

    def reset(self, seed=None):
        return 0, {}

    def step(self, action):
        return self.shown, self.reward, False, False, {}

    def close(self):
        pass


def start(data, bits):
    return 3


def step(data, state, action, bits):
    return data, 0.0, False


def computed(data):
    return cr.ComputedMDP(*RING, start, step, data=data, time_limit=20)


def thawed():
    """Return tables with a successor that does not exist, as far as they can be written to."""
    import copy
    import pickle

    for way in (copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one)), lambda one: one):
        task = way(MAZE.mdp)
        try:
            task.next_state.flags.writeable = True
            task.next_state[:] = 10**9
        except ValueError:
            continue
        break
    return task


LOOP: list = []
LOOP.append(LOOP)
BAD = [
    LOOP,
    *(None, True, False, "", "x", "a" * 300, b"x", -1, 0, 0.5, NAN, INF, -INF, 1e308, 1j),
    *(2**63, 2**64, -(2**63), 10**30, 10**400, np.float32(NAN), np.int64(-1), np.uint64(2**64 - 1)),
    *([], [[]], (), {}, set(), {"x": 1}, [None], ["x"], [NAN], [2**63], range(3), [[1], [1, 2]]),
    *(object(), int, len, lambda *_: None, lambda *_: NAN, lambda *_: 10**30, Ring),
    *(np.zeros(0), np.zeros((2, 3)), np.full((6, 4), NAN), np.array(["x"]), np.array(None)),
    *(np.zeros((6, 4, 2)), np.full((6, 4), 1e308), np.full((6, 4), 10**9), np.ones((6, 4), bool)),
    *(MAZE, NEAR, HUNT, CHASE, MAZE.mdp, MAZE.states, HUGE, cr.Rewards(), cr.QLearning(), OFF),
    *(computed(10), computed(-1), computed(0.5), computed(NAN), computed(2**62), computed("x")),
    *(cr.tasks.LiveMDP(*RING, lambda: Ring(99)), cr.tasks.LiveMDP(*RING, lambda: Ring(0, NAN))),
    *(thawed(), cr.Episodes(1), cr.minimum, cr.errors, sys),
]


@cache
def phi():
    return cr.StateActionPotential(MAZE, np.ones((6, 4)))


@cache
def curriculum():
    edge = cr.Transfer("near", "maze", cr.same_position(MAZE, NEAR))
    return cr.Curriculum({"near": NEAR, "maze": MAZE}, [edge], budget=200)


@cache
def mapped():
    edge = cr.Transfer("chase", "hunt", cr.project(HUNT, CHASE, predator="predator_1"))
    trained = cr.Curriculum({"chase": CHASE, "hunt": HUNT}, [edge], budget=200).train()
    return trained.potentials["hunt"][0]


def walk(action, state=0):
    environment = cr.to_gymnasium(MAZE)
    environment.reset(options={"state": state})
    return environment.step(action)


MDP = {name: getattr(MAZE.mdp, name) for name in MAZE.mdp.__dataclass_fields__}
DENSE = {"transition": [[[0.0, 1.0]], [[0.0, 1.0]]], "reward": [1, 0], "start": 0}
FUNCTIONS = {"states": RING[0], "actions": RING[1], "start": start, "step": step, "data": 1}
LEARN = {"task": MAZE, "learner": None, "budget": 200, "seeds": 1, "eval_freq": 100}
ARGUMENTS = {  # with which public names work
    "certify": lambda: {"task": MAZE, "shaping": cr.QInitialisation(phi())},
    "compare": lambda: {"arms": curriculum(), "seeds": 2},
    "forecast": lambda: {"curriculum": curriculum(), "seeds": 1},
    "Curriculum": lambda: {"tasks": {"maze": MAZE}, "transfers": [], "budget": 9},
    "to_gymnasium": lambda: {"task": MAZE, "observation": "index"},
    "from_gymnasium": lambda: {"environment": Ring, "discount": 0.9},
    "observation_task": lambda: {"environment": Ring, "discount": 0.9},
    "PotentialShaping": lambda: {"env": cr.to_gymnasium(MAZE), "potential": phi(), "discount": 0.9},
    "Episodes": lambda: {"number": 3},
    "Portfolio": lambda: {"margin": 0.2, "optimist": 0.5},
    "StateActionPotential": lambda: {"task": MAZE, "values": np.ones((6, 4))},
    "StatePotential": lambda: {
        "task": MAZE,
        "values": np.ones(6),
        "frame_steps": [0],
        "weight": 1.0,
    },
    "StateShaping": lambda: {"potential": phi().to_state()},
    "StoppingRule": lambda: {"max_steps": 200, "threshold": 1.0, "patience": 2},
    "Storage": lambda: {"kind": "dense", "dtype": "float64", "memory_limit": "1 GB"},
    "learn": lambda: dict(LEARN),
    "GreedyEvaluation": lambda: {"method": "auto", "episodes": 3},
    "evaluate": lambda: {"task": MAZE, "policy": np.ones(6, int)},
    "solve": lambda: {"task": MAZE, "tolerance": 1e-6},
    "plot": lambda: {"subject": cr.learn(**LEARN), "path": None},
    "read_study": lambda: {"path": "nowhere.toml"},
    "run_study": lambda: {"study": None, "path": "nowhere"},
    "ComputedMDP": lambda: dict(FUNCTIONS),
    "GridWorld": lambda: {"map": "S.T", "ends": ("pit",), "origin": (0, 0)},
    "Rewards": lambda: {"step": -1.0, "pit": -2.0, "treasure": 3.0},
    "FiniteMDP": lambda: dict(MDP),
    "Pursuit": lambda: {"size": 3, "predators": 1, "moves": 5, "torus": False},
    "Component": lambda: {"name": "a", "size": 2, "low": 0, "labels": ("a", "b")},
    "Space": lambda: {"components": [cr.Component("a", 9)], "points": [[0], [2]]},
    "project": lambda: {"target": HUNT, "source": CHASE, "predator": "predator_1"},
    "Transfer": lambda: {"source": "a", "target": "b", "mapping": cr.same_position(MAZE, NEAR)},
    "from_function": lambda: {"target": MAZE, "source": MAZE, "function": lambda s, a: (s, a)},
    "same_position": lambda: {"target": MAZE, "source": NEAR},
    **dict.fromkeys(
        ("QLearning", "SARSA", "ExpectedSARSA", "DoubleQLearning"),
        lambda: {"learning_rate": 0.1, "epsilon": 0.1, "initial_value": 0.0},
    ),
    **dict.fromkeys(
        ("LookAheadAdvice", "QInitialisation", "RewardBonus"), lambda: {"potential": phi()}
    ),
    **dict.fromkeys(
        ("minimum", "maximum", "mean", "total"), lambda: {"potentials": np.ones((2, 6, 4))}
    ),
}
CALLS = {name: (getattr(cr, name), good) for name, good in ARGUMENTS.items()} | {
    "learn shaped": (cr.learn, lambda: {**LEARN, "shaping": cr.QInitialisation(phi())}),
    "learn stored": (cr.learn, lambda: {**LEARN, "storage": cr.Storage(), "snapshots": 1}),
    "learn computed": (
        lambda **f: cr.learn(cr.ComputedMDP(**f), budget=50),
        lambda: dict(FUNCTIONS),
    ),
    "learn maze": (
        lambda **f: cr.learn(cr.GridWorld(**f), budget=50),
        lambda: {"map": "S.T", "start": "map", "time_limit": 9, "discount": 0.9},
    ),
    "learn tables": (lambda **f: cr.learn(cr.FiniteMDP(**f), budget=50), lambda: dict(MDP)),
    "from_dense": (
        cr.FiniteMDP.from_dense,
        lambda: {**DENSE, "terminal": [False, True], "discount": 0.9},
    ),
    "from_outcomes": (
        cr.FiniteMDP.from_outcomes,
        lambda: {"outcomes": [[[(1.0, 1, 2.0, True)]], [[]]], "start": 0, "discount": 1.0},
    ),
    "Pursuit rules": (cr.Pursuit, lambda: {"capture": "all", "discount": 0.9}),
    "learn pursuit": (
        lambda **f: cr.learn(cr.Pursuit(**f), budget=50, evaluation=OFF),
        lambda: {"size": 3, "predators": 1, "step_reward": -1.0, "time_limit": 9},
    ),
    "encode": (MAZE.states.encode, lambda: {"row": 0, "column": [1, 2]}),
    "encode points": (cr.Space([cr.Component("a", 9)], [[3]]).encode, lambda: {"a": [3, 4]}),
    "encode huge": (HUGE.encode, lambda: dict.fromkeys(HUGE.names, 0)),
    "decode": (MAZE.states.decode, lambda: {"index": [0, 1]}),
    "decode huge": (HUGE.decode, lambda: {"index": 0}),
    "label": (MAZE.states.label, lambda: {"index": 1}),
    "component": (MAZE.states.component, lambda: {"name": "row"}),
    "crop": (MAZE.crop, lambda: {"rows": (0, 2), "columns": (1, 3)}),
    "state": (MAZE.state, lambda: {"row": 0, "column": 1}),
    "Phi at": (cr.StatePotential(MAZE, np.ones(6)).at, lambda: {"step": 0}),
    "shaping_reward": (
        cr.StatePotential(MAZE, np.ones(6)).shaping_reward,
        lambda: {"state": 0, "next_state": 1, "step": 0},
    ),
    "rescaled": (lambda **f: phi().rescaled(**f), lambda: {"scale": 2.0, "shift": 1.0}),
    "rescaled mapped": (lambda **f: mapped().rescaled(**f), lambda: {"scale": 2.0, "shift": 1.0}),
    "pairs mapped": (lambda **f: mapped().pairs(**f), lambda: {"states": [0, 1]}),
    "MappedPotential": (
        lambda **f: cr.learning.MappedPotential(**f).values,
        lambda: {"task": HUNT, "lookup": mapped().lookup},
    ),
    "StateActionMapping": (
        cr.transfer.StateActionMapping,
        lambda: {"target": MAZE, "source": MAZE, "index": np.zeros((6, 4), int)},
    ),
    "read": (cr.same_position(MAZE, NEAR).read, lambda: {"source_values": np.ones((4, 4))}),
    "rollout": (cr.planning.rollout, lambda: {"task": MAZE, "policy": np.ones(6, int), "start": 0}),
    "LiveMDP": (
        lambda **f: cr.learn(cr.tasks.LiveMDP(*RING, **f), budget=20, evaluation=OFF),
        lambda: {"make": Ring, "encode": None, "act": int, "time_limit": 9},
    ),
    "live answers": (
        lambda **f: cr.learn(cr.tasks.LiveMDP(*RING, lambda: Ring(**f)), budget=20, evaluation=OFF),
        lambda: {"shown": 1, "reward": 0.0},
    ),
    "step": (walk, lambda: {"action": 1, "state": 0}),
    "uniform": (cr.tasks.uniform, lambda: {"bits": 1}),
    "integers": (cr.tasks.integers, lambda: {"bits": 1, "n": 3}),
    "bernoulli": (cr.tasks.bernoulli, lambda: {"bits": 1, "probability": 0.5}),
    "splitmix64": (cr.tasks.splitmix64, lambda: {"number": 1}),
    "harmonic": (cr.learning.harmonic, lambda: {"half": 5}),
    "linear": (cr.learning.linear, lambda: {"first": 1.0, "last": 0.0, "steps": 9}),
    "exponential": (cr.learning.exponential, lambda: {"first": 1.0, "half_life": 9}),
}


def made(seed, n):
    """Return the n-th call: its name, what is called, the arguments, and which of them are bad."""
    draw = random.Random(f"{seed}/{n}")
    name = draw.choice(sorted(CALLS))
    function, good = CALLS[name]
    given = good()
    bad = draw.sample(sorted(given), k=min(len(given), draw.choice((1, 1, 2))))
    values = {argument: draw.choice(BAD) for argument in bad}
    return name, function, given | values, values


def outcome(function, given):
    """Call it; return the error's class and text, and whether it is one that may be raised."""
    try:
        function(**given)
    except cr.CurricleError as error:
        return type(error).__name__, str(error), bool(str(error))
    except (TypeError, ValueError) as error:
        return type(error).__name__, str(error), bool(str(error))
    except Exception as error:
        return type(error).__name__, str(error), False
    return "", "", True


def main():
    seed, first, calls = map(int, sys.argv[1:])
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    warnings.simplefilter("ignore")
    for n in range(first, first + calls):
        name, function, given, bad = made(seed, n)
        print(json.dumps({"call": n, "name": name, "bad": repr(bad)[:300]}), flush=True)
        before = time.process_time()
        error, said, allowed = outcome(function, given)
        seconds = time.process_time() - before
        done = {"call": n, "error": error, "said": said[:300], "allowed": allowed}
        print(json.dumps({**done, "seconds": round(seconds, 2)}), flush=True)


if __name__ == "__main__":
    main()
