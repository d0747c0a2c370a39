"""Milliseconds and memory of exact planning on the 7x7 hunt of two, beside other solvers.

W4: the optimal values of 117,649 states x 25 joint actions at discount 0.95 to within 1e-6. Each
case runs in a process of its own; memory is what its first turn adds to the largest resident size
after imports and compilation, time the best of its turns.

    python benchmarks/bench_planning.py [case ...]

QuantEcon's DiscreteDP takes part where it can be imported; Curricle does not need it.
"""

import importlib.util
import json
import resource
import subprocess
import sys
import time

import numpy as np
from scipy import sparse

import curricle as cr

DISCOUNT, TOLERANCE = 0.95, 1e-6


def game(size=7):
    return cr.Pursuit(size=size, predators=2, discount=DISCOUNT)


def factored(task):
    return cr.solve(task, tolerance=TOLERANCE).values


def staying(task):
    """Return a policy that costs nothing to know: every predator stays where it is."""
    return task, np.zeros(task.states.size, dtype=np.int64)


def uniform(task):
    return task, np.full((task.states.size, task.actions.size), 1 / task.actions.size)


def evaluated(given):
    return cr.evaluate(*given, tolerance=TOLERANCE).values


def tables(task):
    return task.mdp


def joint_matrix(task):
    """Return P (S A, S) as CSR, absorbing where it is over, and the mean reward (S A,)."""
    mdp = task.mdp
    rows = mdp.outcome_row.ravel()
    over = np.repeat(mdp.terminal, mdp.actions.size)
    chance = np.where(over[:, None], 1 / mdp.probability.shape[1], mdp.probability[rows])
    here = np.repeat(np.arange(mdp.states.size, dtype=np.int32), mdp.actions.size)
    after = np.where(over[:, None], here[:, None], mdp.next_state[rows])
    starts = np.arange(len(rows) + 1) * chance.shape[1]
    matrix = sparse.csr_matrix(
        (chance.ravel(), after.ravel(), starts), shape=(len(rows), mdp.states.size)
    )
    reward = np.where(over, 0.0, (mdp.probability * mdp.reward).sum(axis=1)[rows])
    return matrix, reward


def value_iteration(given):
    matrix, reward = given
    values = np.zeros(matrix.shape[1])
    while True:
        new = (reward + DISCOUNT * (matrix @ values)).reshape(len(values), -1).max(axis=1)
        change = abs(new - values).max()
        values = new
        if DISCOUNT / (1 - DISCOUNT) * change <= TOLERANCE:
            return values


def quantecon_model(task):
    from quantecon.markov import DiscreteDP

    matrix, reward = joint_matrix(task)
    state, action = np.divmod(np.arange(len(reward)), task.actions.size)
    return DiscreteDP(reward, matrix, DISCOUNT, state, action)


def modified_policy_iteration(model):
    return model.solve(method="modified_policy_iteration", epsilon=TOLERANCE).v


# name: (what is printed, what is made ready, what is solved, turns)
CASES = {
    "factored": ("solve(pursuit), no tables", lambda task: task, factored, 30),
    "generic": ("solve(pursuit.mdp)", tables, factored, 20),
    "stay": ("evaluate(pursuit, staying)", staying, evaluated, 10),
    "uniform": ("evaluate(pursuit, uniform policy)", uniform, evaluated, 5),
    "scipy": ("SciPy sparse value iteration", joint_matrix, value_iteration, 2),
    "quantecon": ("QuantEcon DiscreteDP", quantecon_model, modified_policy_iteration, 3),
}


def resident():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def measure(name):
    """Return the milliseconds to make ready and to solve, and the memory of each and both, MB."""
    _, ready, solved, turns = CASES[name]
    solved(ready(game(size=3)))
    before, making, solving = resident(), [], []
    for turn in range(turns):
        start = time.perf_counter()
        given = ready(game())
        made = time.perf_counter()
        if turn == 0:
            after_making = resident()
        solved(given)
        done = time.perf_counter()
        making.append(1e3 * (made - start))
        solving.append(1e3 * (done - made))
        if turn == 0:
            memory = after_making - before, resident() - before
    return min(making), min(solving), *memory


def main():
    if len(sys.argv) == 3 and sys.argv[1] == "--measure":
        print(json.dumps(measure(sys.argv[2])))
        return
    base = None
    print(f"{'':36}{'ready':>9}{'solve':>9}{'both':>9}{'ratio':>7}{'memory':>10}{'both':>9}")
    for name in sys.argv[1:] or CASES:
        if name == "quantecon" and importlib.util.find_spec("quantecon") is None:
            print(f"{CASES[name][0]:36}  skipped: QuantEcon is not installed")
            continue
        command = [sys.executable, __file__, "--measure", name]
        out = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        making, solving, memory_making, memory = json.loads(out)
        base = base or solving
        print(
            f"{CASES[name][0]:36}{making:6.1f} ms{solving:6.1f} ms{making + solving:6.1f} ms"
            f"{solving / base:6.1f}x{memory - memory_making:7.1f} MB{memory:6.1f} MB"
        )


if __name__ == "__main__":
    main()
