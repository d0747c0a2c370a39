"""Interrupt what trains from Python at random moments, and measure how soon it answers.

Usage: python interrupted.py TIMES SEED. A process trains in one way after the other and is sent
SIGINT each time. Prints the slowest answer in seconds and of what it was, then how long threads
went on computing after an answer, at most.
"""

import random
import signal
import subprocess
import sys
import threading
import time

import numpy as np

import curricle as cr

LONG = 10**10
"""Steps that take minutes."""
MAZE = cr.GridWorld(["S....", ".#.#.", ".....", ".#.#.", "....T"], discount=0.95)
SMALL = cr.GridWorld(["S..", ".#.", "..T"], discount=0.95)
OFF = cr.GreedyEvaluation(method="off")
PHI = np.ones((MAZE.states.size, MAZE.actions.size))


def learning(learner=None, **settings):
    freq = settings.pop("eval_freq", LONG)
    return lambda: cr.learn(MAZE, learner, LONG, eval_freq=freq, **{"evaluation": OFF, **settings})


def curriculum():
    mapping = cr.same_position(MAZE, SMALL)
    return cr.Curriculum(
        {"small": SMALL, "maze": MAZE},
        [cr.Transfer("small", "maze", mapping)],
        budget={"small": 1000, "maze": LONG},
        eval_freq={"small": 100, "maze": LONG // 100},
    )


def compared():
    cr.compare({"small first": curriculum()}, seeds=5)


WAYS = {
    "one seed": learning(),
    "several seeds": learning(seeds=5),
    "one thread": learning(seeds=2, workers=1),
    "SARSA": learning(cr.SARSA()),
    "guarded": learning(shaping=cr.QInitialisation(PHI, guard=cr.Guard())),
    "optimistic": learning(cr.learning.OptimisticQLearning()),
    "exact evaluation": learning(evaluation=None, eval_freq=10**6),
    "rollouts": learning(
        evaluation=cr.GreedyEvaluation(method="rollouts", episodes=10**6), eval_freq=10**4
    ),
    "train": lambda: curriculum().train(2),
    "compare": compared,
}


def child(names):
    signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in a shell's background
    for name in names:
        print("begins", flush=True)
        try:
            WAYS[name]()
        except KeyboardInterrupt:
            print("answers", flush=True)
        while threading.active_count() > 1:
            time.sleep(0.001)
        print("idle", flush=True)


def main(times, seed):
    draws = random.Random(seed)
    names = [draws.choice(list(WAYS)) for _ in range(times)]
    command = [sys.executable, __file__, "child", *WAYS, *names]  # the first of each compiles
    answers, idle = [], []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        for number, name in enumerate([*WAYS, *names]):
            warm = number < len(WAYS)
            assert process.stdout.readline() == "begins\n"
            time.sleep(5.0 if warm else draws.uniform(0.0, 0.5))
            sent = time.perf_counter()
            process.send_signal(signal.SIGINT)
            assert process.stdout.readline() == "answers\n", name
            answered = time.perf_counter()
            assert process.stdout.readline() == "idle\n"
            if not warm:
                answers.append((answered - sent, name))
                idle.append((time.perf_counter() - answered, name))
                print(len(answers), *max(answers), *max(idle), file=sys.stderr, flush=True)
    for slowest in (max(answers), max(idle)):
        print(f"{slowest[0]:.3f} {slowest[1]}")


if __name__ == "__main__":
    if sys.argv[1] == "child":
        child(sys.argv[2:])
    else:
        main(*map(int, sys.argv[1:3]))
