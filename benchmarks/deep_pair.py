"""Two predators on 7x7 from one on 7x7: DQN on 25 joint actions, all steps charged.

The source is the table of one predator, 2,401 states, read once for each of the two; the network
starts at the smaller of the two values, and improves on it here.

    python benchmarks/deep_pair.py [--seeds 5] [--workers 2] [--arms ...] [--out DIR]
"""

from functools import partial

import numpy as np
from evidence import Benchmark
from gymnasium.spaces import Box

import curricle as cr

SIZE = 7
DISCOUNT = 0.95
SOURCE, BUDGET = 200_000, 260_000
EVAL_FREQ = 5_000
CHASE = cr.Pursuit(SIZE, predators=1, discount=DISCOUNT)
LEARN = cr.QLearning(learning_rate=cr.learning.linear(0.9, 0.05, steps=SOURCE), epsilon=0.2)
EVALUATION = cr.GreedyEvaluation("rollouts", episodes=200, discounted=False)
DQN = {
    "learning_rate": 3e-4, "batch_size": 512, "buffer_size": 100_000, "learning_starts": 1_000,
    "train_freq": 1, "gradient_steps": 1, "target_update_interval": 1_000,
    "exploration_fraction": 0.5, "exploration_final_eps": 0.05,
    "policy_kwargs": {"net_arch": [128, 128], "optimizer_kwargs": {"eps": 1e-2}},
}  # fmt: skip
WARM = DQN | {"exploration_initial_eps": 0.1}


def seen(cells):
    """Return the prey's row and column in [-1, 1], then each predator's and its way to the prey."""
    places = np.stack(np.divmod(cells, SIZE), axis=1)
    ways = places[:1] - places[1:]
    places = 2 * places / (SIZE - 1) - 1
    parts = np.hstack([places[1:], ways / (SIZE - 1)])
    return np.append(places[0], parts).astype(np.float32)


def observed(predators):
    """Return the pursuit of some predators as a task seen through these numbers."""
    encode = cr.interop.FunctionEncoder(seen, Box(-1.0, 1.0, (2 + 4 * predators,), np.float32))
    return cr.observation_task(
        "Curricle/Pursuit-v0", discount=DISCOUNT, encode=encode,
        size=SIZE, predators=predators, observation="components",
    )  # fmt: skip


def alone(which, observations):
    """Return the states of the table that one of the predators is in."""
    first = 4 * which - 2
    places = observations[:, [0, 1, first, first + 1]].astype(np.float64)
    rows_and_columns = np.rint((places + 1) * (SIZE - 1) / 2).astype(np.int64)
    return rows_and_columns @ SIZE ** np.arange(3, -1, -1)


def transfers(hunt, predators):
    """Return the transfers by which each predator reads the table of one."""
    moves = np.unravel_index(np.arange(5**predators), (5,) * predators)
    return [
        cr.Transfer("chase", "hunt", cr.transfer.ObservationMapping(
            hunt, CHASE, partial(alone, which + 1), actions=moves[which]))
        for which in range(predators)
    ]  # fmt: skip


def learner(settings):
    return cr.deep.DeepLearner("DQN", envs=8, settings=settings)


def curriculum(shaping, settings):
    """Return the plan of learning from one predator, within the budget."""
    hunt = observed(2)
    return cr.Curriculum(
        tasks={"chase": CHASE, "hunt": hunt},
        transfers=transfers(hunt, 2),
        aggregate=cr.minimum,
        learner={"chase": LEARN, "hunt": learner(settings)},
        budget={"chase": cr.StoppingRule(SOURCE), "hunt": BUDGET - SOURCE},
        shaping={"hunt": shaping}, eval_freq={"hunt": EVAL_FREQ}, evaluation={"hunt": EVALUATION},
    )  # fmt: skip


def from_scratch():
    return cr.Curriculum(
        {"hunt": observed(2)}, learner=learner(DQN), budget=BUDGET,
        eval_freq=EVAL_FREQ, evaluation=EVALUATION,
    )  # fmt: skip


BENCHMARK = Benchmark(
    title="Pursuit, 2 predators on 7x7, from 1 (DQN)",
    arms={
        "from scratch": from_scratch,
        "residual on phi": partial(curriculum, cr.QInitialisation(), WARM),
        "shaped by Phi": partial(curriculum, cr.StateShaping(), DQN),
        "policy only": partial(curriculum, cr.deep.PolicyReuse(), DQN),
    },
    threshold=-10.0,
)

if __name__ == "__main__":
    BENCHMARK.main("deep_pair", __doc__)
