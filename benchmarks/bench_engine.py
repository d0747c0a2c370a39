"""Curricle's learning engine beside a C++ reference and beside Gymnasium, held to bars.

W1 is the paper's 10x10 maze, W2 the hunt of two predators on 7x7, W3 slippery FrozenLake 8x8.
All use Q-learning with learning rate 0.1 and epsilon 0.1.

    python benchmarks/bench_engine.py [--quick]
"""

import json
import platform
import subprocess
import sys
from dataclasses import replace
from statistics import median

import gymnasium_loop
import numpy as np
from cpp import reference
from timing import GLIMPSE, LEARNER, Board, arguments, by_the_wall, in_turns, on_one_thread

import curricle as cr
from curricle.paper.mazes import maze

AGGREGATES = {"minimum": cr.minimum, "mean": cr.mean, "maximum": cr.maximum}
DISCOUNT = 0.95
MEMORY = 4 * 2**30
SCALE = 1.5
"""Of one predator's values for three: at 1 they are too hopeful, and the good start decays."""
SINGLE = cr.Storage(dtype="float32")


def learn(task, steps, eval_freq, **settings):
    settings = {"workers": 1, "evaluation": GLIMPSE, **settings}
    return cr.learn(task, LEARNER, steps, eval_freq=eval_freq, **settings)


# -- W1 ------------------------------------------------------------------------------------------


def one_maze(board, cpp, turns, steps):
    """One thread, learning curve recorded."""
    task = maze(-5)

    mdp = task.mdp  # with masks, moves that lead nowhere are not available
    moves = mdp.next_state[mdp.outcome_row, 0] != np.arange(len(mdp.start))[:, None]
    masked = replace(mdp, available=moves)

    def ours(storage=None, of=task):
        return on_one_thread(lambda: learn(of, steps, 10_000, storage=storage), steps)

    learn(task, 1000, 1000, storage=SINGLE)  # compiles
    learn(task, 1000, 1000)
    learn(masked, 1000, 1000)
    contestants = {
        "float32": lambda: ours(SINGLE),
        "float64": ours,
        "with masks": lambda: ours(of=masked),
    }
    if cpp:
        contestants |= {
            f"{variant} {dtype}": lambda run=(variant, dtype): cpp.rate("W1", *run, steps)
            for variant in ("ties", "cached", "naive")
            for dtype in ("float32", "float64")
        }
    rates = in_turns(contestants, turns)
    board.compare("W1 float32 : C++ cached", rates, "float32", "ties float32", 0.85)
    board.compare("W1 float32 : C++ naive", rates, "float32", "naive float32", 1.6)
    board.compare("W1 float64 with masks : without", rates, "with masks", "float64", 0.8)
    board.compare("W1 float64 : C++ cached", rates, "float64", "ties float64")
    board.compare("W1 float32 : C++ cached, first of ties", rates, "float32", "cached float32")


def many_mazes(board, cpp, turns, steps):
    """Thirty seeds on two threads and on one, beside what two copies of the C++ gain."""
    task, seeds, copy = maze(-5), 30, 100 * steps

    def ours(workers):
        settings = {"seeds": seeds, "workers": workers, "storage": SINGLE}
        return by_the_wall(lambda: learn(task, steps, 10_000, **settings), seeds * steps)

    def theirs(copies):
        return by_the_wall(lambda: cpp.side_by_side(copies, copy), copies * copy)

    contestants = {"two": lambda: ours(2), "one": lambda: ours(1)}
    if cpp:
        contestants |= {"C++ two": lambda: theirs(2), "C++ one": lambda: theirs(1)}
    rates = in_turns(contestants, turns)
    board.compare("W1 30 seeds, two threads : one", rates, "two", "one", 1.85)
    board.compare("  this machine: C++ twice at once : once", rates, "C++ two", "C++ one")


# -- W2 ------------------------------------------------------------------------------------------


def hunts(board, cpp, turns, steps):
    """Two predators, alone and advised by one predator's chase."""
    hunt = cr.Pursuit(7, 2, discount=DISCOUNT)
    chase = learn(cr.Pursuit(7, 1, discount=DISCOUNT), steps // 10, steps // 10)

    def alone(steps):
        return learn(hunt, steps, steps // 100, stream="hunt", storage=SINGLE)

    contestants = {"alone": lambda: on_one_thread(lambda: alone(steps), steps)}
    alone(1000)
    for name, aggregate in AGGREGATES.items():
        advise(hunt, chase, aggregate, 1000, SINGLE)()
        advised = advise(hunt, chase, aggregate, steps, SINGLE)
        contestants[name] = lambda run=advised: on_one_thread(run, steps)
    if cpp:
        for variant in ("ties", "cached", "naive"):
            contestants[variant] = lambda run=variant: cpp.rate("W2", run, "float32", steps)
    rates = in_turns(contestants, turns)
    board.compare("W2 float32 : C++ cached", rates, "alone", "ties", 0.7)
    board.compare("W2 float32 : C++ naive", rates, "alone", "naive")
    board.compare("W2 float32 : C++ cached, first of ties", rates, "alone", "cached")
    for name in AGGREGATES:
        board.compare(f"W2 advised, {name} : C++ cached, alone", rates, name, "ties", 0.45)


def advise(hunt, chase, aggregate, steps, storage, evaluation=GLIMPSE, scale=1.0, portfolio=None):
    """Return the training of a hunt on look-ahead advice from a learnt chase, ready to run."""
    mappings = [cr.project(hunt, chase.task, predator=name) for name in hunt.predator_names]
    curriculum = cr.Curriculum(
        tasks={"chase": chase.task, "hunt": hunt},
        transfers=[cr.Transfer("chase", "hunt", mapping, scale) for mapping in mappings],
        aggregate=aggregate,
        learner=LEARNER,
        budget={"hunt": steps},
        shaping=cr.QInitialisation(portfolio=portfolio) if portfolio else cr.LookAheadAdvice(),
        eval_freq={"hunt": steps // 100 if evaluation is GLIMPSE else steps},
        evaluation=evaluation,
        storage={"hunt": storage},
    )
    return lambda: curriculum.train(trained={"chase": chase}, workers=1)["hunt"]


# -- three predators -----------------------------------------------------------------------------


def three_predators(board, steps, turns):
    """A table of 12.5 thousand million pairs, of which only the visited ones are kept."""
    what = "three predators, 10x10, sparse: million steps"
    command = [sys.executable, __file__, "--three-predators", str(steps), "--turns", str(turns)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        board.skip(what, (done.stderr.strip() or "no message").splitlines()[-1])
        board.missed.append(what)
        return
    found = json.loads(done.stdout)
    board.row(what, found["rate"], None, found["rate"] / 1e6, 1.5)
    share = MEMORY / found["bytes"]
    board.row("  its memory in bytes : 4 GiB", found["bytes"], MEMORY, share, 1)


def three_predators_alone(steps, turns):
    """Print what `three_predators` asks for, measured in this process of its own.

    The median of turns: where memory is a virtual machine's, its first use costs several times
    what any later use does.
    """
    import resource  # not on every system

    hunt = cr.Pursuit(10, 3, discount=DISCOUNT)
    careful = cr.QLearning(
        learning_rate=cr.learning.linear(0.5, 0.01, steps=8_000_000), epsilon=0.5
    )
    chase = cr.learn(cr.Pursuit(10, 1, discount=DISCOUNT), careful, 10_000_000, evaluation=GLIMPSE)
    storage = cr.Storage(kind="sparse", dtype="float32", memory_limit=MEMORY, save_values=False)
    advise(hunt, chase, cr.minimum, 1000, storage, scale=SCALE)()
    work = advise(hunt, chase, cr.minimum, steps, storage, scale=SCALE)
    rate = median(on_one_thread(work, steps) for _ in range(turns))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    print(json.dumps({"rate": rate, "bytes": peak}))


# -- W3 ------------------------------------------------------------------------------------------


def frozen_lake(board, turns, steps):
    env = gymnasium_loop.frozen_lake()
    outcomes = env.unwrapped.P
    lake = cr.FiniteMDP.from_outcomes(outcomes, start=0, discount=0.99, time_limit=200)
    learn(lake, 1000, 1000, storage=SINGLE)
    few = steps // 200

    def ours(steps):
        learn(lake, steps, 10_000, storage=SINGLE)

    rates = in_turns(
        {
            "ours": lambda: on_one_thread(lambda: ours(steps), steps),
            "Gymnasium": lambda: on_one_thread(
                lambda: gymnasium_loop.q_learning(env, 0.99, few), few
            ),
        },
        turns,
    )
    board.compare("W3 float32 : Gymnasium and NumPy", rates, "ours", "Gymnasium", 300)


# -- a portfolio of two --------------------------------------------------------------------------


def portfolios(board, turns, steps):
    """Two learners of the same steps, from the same potential as the fast loop's single learner."""
    hunt = cr.Pursuit(7, 2, discount=DISCOUNT)
    chase = learn(cr.Pursuit(7, 1, discount=DISCOUNT), steps // 10, steps // 10)
    outcomes = gymnasium_loop.frozen_lake().unwrapped.P
    lake = cr.FiniteMDP.from_outcomes(outcomes, start=0, discount=0.99, time_limit=200)

    def from_zero(task):
        phi = cr.StateActionPotential(task, np.zeros((task.states.size, task.actions.size)))

        def ready(steps, portfolio):
            shaping = cr.QInitialisation(phi, portfolio=portfolio)
            return lambda: learn(task, steps, steps // 10, storage=SINGLE, shaping=shaping)

        return ready

    def hunting(steps, portfolio):
        return advise(hunt, chase, cr.mean, steps, SINGLE, portfolio=portfolio)

    cases = {
        "W1": from_zero(maze(-5)),
        "W2 advised, mean": hunting,
        "W3": from_zero(lake),
        "two predators on 4x4": from_zero(cr.Pursuit(4, 2, discount=DISCOUNT)),
    }
    for name, ready in cases.items():
        contestants = {}
        for side, portfolio in (("portfolio", cr.Portfolio()), ("fast loop", None)):
            ready(1000, portfolio)()
            work = ready(steps, portfolio)
            contestants[side] = lambda run=work: on_one_thread(run, steps)
        rates = in_turns(contestants, turns)
        board.compare(f"{name}: portfolio of two : fast loop", rates, *contestants, 1 / 2.2)


# -- what was learnt -----------------------------------------------------------------------------


def what_was_learnt(cpp, steps):
    """Print the greedy returns, so that it is seen to be learning that was timed."""
    many = cr.GreedyEvaluation(method="rollouts", episodes=10_000)
    hunt = cr.Pursuit(7, 2, discount=DISCOUNT)
    chase = learn(cr.Pursuit(7, 1, discount=DISCOUNT), steps // 10, steps // 10)
    results = {
        "W1 (optimum -1.177)": learn(maze(-5), steps, steps, evaluation=many, storage=SINGLE),
        "W2": learn(hunt, steps, steps, evaluation=many, stream="hunt", storage=SINGLE),
    }
    for name, aggregate in AGGREGATES.items():
        results[f"W2 advised, {name}"] = advise(hunt, chase, aggregate, steps, SINGLE, many)()
    print("\ndiscounted greedy return in the end")
    for name, result in results.items():
        other = ""
        if cpp and "advised" not in name:
            other = f"   C++ {cpp.run(name[:2], 'ties', 'float32', steps)['greedy_return']:.3f}"
        print(f"  {name:<22}{result.greedy_return[0, -1]:9.3f}{other}")


def main():
    parser = arguments(__doc__)
    parser.add_argument("--three-predators", type=int, metavar="STEPS", help="only that, as JSON")
    given = parser.parse_args()
    if given.three_predators:
        three_predators_alone(given.three_predators, given.turns or 3)
        return
    steps = 1_000_000 if given.quick else 10_000_000
    turns = given.turns or (3 if given.quick else 5)
    print(f"{platform.processor() or platform.machine()}, Python {platform.python_version()}")
    with reference() as cpp:
        board = Board()
        if cpp is None:
            board.skip("C++ reference", "no compiler")
        one_maze(board, cpp, turns, steps)
        many_mazes(board, cpp, turns, steps // 10)
        hunts(board, cpp, turns, steps)
        three_predators(board, steps // 2, turns)
        frozen_lake(board, turns, steps)
        portfolios(board, turns, steps)
        board.close()
        what_was_learnt(cpp, steps)


if __name__ == "__main__":
    main()
