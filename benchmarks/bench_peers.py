"""Curricle beside other ways of doing tabular Q-learning, each through its own API (peers.py).

W1 is the paper's 10x10 maze, W3 slippery FrozenLake 8x8; learning rate 0.1, epsilon 0.1. A peer
that is not installed is skipped: peers.txt says which there are. The last column is the greedy
return of the peer's final table on W1, where the optimum is -1.177: it was learning.

    python benchmarks/bench_peers.py [--quick] [--only NAME ...]
"""

import time
from functools import partial

import gymnasium_loop
import numpy as np
import peers
from timing import GLIMPSE, LEARNER, Board, arguments, in_turns

import curricle as cr
from curricle.paper.mazes import maze

# Peer, steps a turn (enough to learn W1), bar on W1.
ONE_THREAD = (
    ("numba", 5_000_000, 3),
    ("python_lists", 500_000, None),
    ("gymnasium", 50_000, None),
    ("msdm", 50_000, 1000),
    ("simple_rl", 50_000, 1000),
    ("table_rl", 50_000, 1000),
    ("mushroom_rl", 50_000, 1000),
    ("bettermdptools", 80_000, 1000),
)
SEEDS = 30
SINGLE = cr.Storage(dtype="float32")


def curricle(mdp, steps, seeds=1):
    def run():
        result = cr.learn(
            mdp,
            LEARNER,
            steps,
            seeds=seeds,
            eval_freq=10_000,
            evaluation=GLIMPSE,
            workers=1 if seeds == 1 else None,
            storage=SINGLE,
        )
        return result.values[0], steps * seeds

    cr.learn(mdp, LEARNER, 1000, evaluation=GLIMPSE, storage=SINGLE)  # compiles
    return run


def versus(board, what, ours, prepare, turns, bar=None, clock=time.process_time, judge=None):
    """Print the ratio to a peer, or why there is none."""
    try:
        theirs = prepare()
        tables = []

        def rate(run):
            begin = clock()
            q, steps = run()
            seconds = clock() - begin
            tables.append(q)
            return steps / seconds

        rates = in_turns({"ours": lambda: rate(ours), "theirs": lambda: rate(theirs)}, turns)
    except ImportError as error:
        board.skip(what, f"not installed ({error})")
    except Exception as error:  # a peer that does not work here is no reason to stop
        board.skip(what, f"failed ({type(error).__name__}: {error})")
    else:
        note = "" if judge is None else f"{judge(tables[-1]):.3f}"
        board.compare(what, rates, "ours", "theirs", bar, note)


def greedy_return(mdp, q):
    """Return what the first best action earns on a deterministic task."""
    state, total, weight = int(mdp.start_states[0]), 0.0, 1.0
    for _ in range(mdp.time_limit):
        row = mdp.outcome_row[state, np.argmax(q[state])]
        total += weight * mdp.reward[row, 0]
        state, weight = mdp.next_state[row, 0], weight * mdp.discount
        if mdp.terminal[state]:
            break
    return total


def frozen_lake():
    outcomes = gymnasium_loop.frozen_lake().unwrapped.P
    return cr.FiniteMDP.from_outcomes(outcomes, start=0, discount=0.99, time_limit=peers.LIMIT)


def main():
    parser = arguments(__doc__)
    parser.add_argument("--only", nargs="*", metavar="NAME", help="these peers")
    given = parser.parse_args()
    turns = given.turns or (2 if given.quick else 3)
    steps = 1_000_000 if given.quick else 10_000_000
    wanted = given.only or [*(peer for peer, _, _ in ONE_THREAD), "jax"]
    board = Board()
    for name, mdp in {"W1": maze(-5).mdp, "W3": frozen_lake()}.items():
        first = name == "W1"
        judge, share = (partial(greedy_return, mdp), 1) if first else (None, 5)
        ours = curricle(mdp, steps)
        for peer, few, bar in ONE_THREAD:
            if peer in wanted:
                prepare = partial(getattr(peers, peer), mdp, few // share)
                bar = bar if first else None
                versus(board, f"{name} {peer}", ours, prepare, turns, bar, judge=judge)
        for seeds, bar in ((1, None), (SEEDS, 5)) if "jax" in wanted else ():
            versus(
                board,
                f"{name} jax, {seeds} seed{'s' if seeds > 1 else ''}, wall time",
                curricle(mdp, steps // min(seeds, 10), seeds),
                partial(peers.jax, mdp, steps // min(seeds, 10) // 5, seeds),
                turns,
                bar if first else None,
                time.perf_counter,
                judge,
            )
    board.close()


if __name__ == "__main__":
    main()
