"""Three predators on 7x7 from one on 4x4: DQN on 125 joint actions, all steps charged.

The source is a table over the distance of the prey from one predator on a 4x4 grid. Each of the
three reads it as if it were alone, larger distances clipped; the three values are summed, which
underestimates; one arm has their mean, which overestimates. Weights cannot be carried over: the
source has neither a network nor 125 actions.

    python benchmarks/deep_pursuit.py [--seeds 5] [--workers 2] [--arms ...] [--out DIR]
"""

from functools import partial

import numpy as np
from evidence import Benchmark

import curricle as cr

DISCOUNT = 0.95
SMALL, SOURCE = 4, 8_000
BUDGET = 24_000  # including the source; from scratch ten times as many
EVAL_FREQ = 1_000
HUNT = cr.Pursuit(7, predators=3, discount=DISCOUNT)
LEARN = cr.QLearning(learning_rate=cr.learning.linear(0.9, 0.05, steps=SOURCE), epsilon=0.2)
EVALUATION = cr.GreedyEvaluation("rollouts", episodes=200, discounted=False)
DQN = {
    "batch_size": 128, "buffer_size": 100_000, "learning_starts": 1_000, "gradient_steps": 2,
    "train_freq": 1, "target_update_interval": 1_000, "policy_kwargs": {"net_arch": [128, 128]},
}  # fmt: skip
BOLD = {"learning_rate": 5e-4, "exploration_fraction": 0.2, "exploration_final_eps": 0.05}
GENTLE = {
    "learning_rate": 1e-4, "batch_size": 512, "gradient_steps": 1, "exploration_fraction": 0.5,
    "exploration_initial_eps": 0.1, "exploration_final_eps": 0.05,
    "policy_kwargs": {"net_arch": [128, 128], "optimizer_kwargs": {"eps": 1e-2}},
}  # fmt: skip
"""Less exploration and smaller steps, to keep a good start: where errors are still tiny, Adam would
make as large a step of a tiny gradient."""

ALL = {"policy_kwargs": GENTLE["policy_kwargs"] | {"reads": "actions"}}


def offset(cells, size):
    """Return the offset of the prey from a predator, down and right, (2, n)."""
    prey, predator = (np.divmod(np.asarray(each), size) for each in cells)
    return np.array([prey[0] - predator[0], prey[1] - predator[1]])


def distance(observation):
    down, right = offset(observation, SMALL) + SMALL - 1
    return int(down), int(right)


def lone_predator():
    chase = cr.Pursuit(SMALL, predators=1, discount=DISCOUNT)
    sides = [cr.Component(name, 2 * SMALL - 1, low=0) for name in ("down", "right")]
    return cr.from_gymnasium(
        lambda: cr.interop.TaskEnvironment(chase, observation="components"),
        encode=distance, states=cr.Space(sides), discount=DISCOUNT, time_limit=200,
    )  # fmt: skip


def as_if_alone(which, vectors, observations):
    """Return the source's states of one of the three predators."""
    cells = vectors.cells(observations)
    down, right = np.clip(offset((cells[:, 0], cells[:, which]), 7), 1 - SMALL, SMALL - 1)
    return (down + SMALL - 1) * (2 * SMALL - 1) + right + SMALL - 1


def curriculum(shaping, settings, aggregate=cr.total):
    """Return the curriculum from one predator, within the budget."""
    hunt, chase = cr.interop.observed_pursuit(HUNT), lone_predator()
    vectors, moves = cr.interop.PursuitVectors(HUNT), HUNT.actions.decode()
    return cr.Curriculum(
        tasks={"chase": chase, "hunt": hunt},
        transfers=[
            cr.Transfer("chase", "hunt", cr.transfer.ObservationMapping(
                hunt, chase, partial(as_if_alone, which, vectors),
                actions=moves[f"predator_{which}"]))
            for which in (1, 2, 3)
        ],
        aggregate=aggregate,
        learner={"chase": LEARN, "hunt": learner(settings)},
        budget={"chase": cr.StoppingRule(SOURCE), "hunt": BUDGET - SOURCE},
        shaping={"hunt": shaping}, eval_freq={"hunt": EVAL_FREQ}, evaluation={"hunt": EVALUATION},
    )  # fmt: skip


def from_scratch(settings):
    return cr.Curriculum(
        tasks={"hunt": cr.interop.observed_pursuit(HUNT)}, learner=learner(settings),
        budget=10 * BUDGET, eval_freq=10 * EVAL_FREQ, evaluation=EVALUATION,
    )  # fmt: skip


def learner(settings):
    return cr.deep.DeepLearner("DQN", envs=8, settings=DQN | settings)


BENCHMARK = Benchmark(
    title="Pursuit, 3 predators on 7x7, from 1 on 4x4 (DQN)",
    arms={
        "from scratch": partial(from_scratch, GENTLE | {"exploration_initial_eps": 1.0}),
        "from scratch, bold steps": partial(from_scratch, BOLD),
        "residual on phi": partial(curriculum, cr.QInitialisation(), GENTLE),
        "residual reading all of phi": partial(curriculum, cr.QInitialisation(), GENTLE | ALL),
        "residual on the mean": partial(curriculum, cr.QInitialisation(), GENTLE, cr.mean),
        "on the mean, reading all": partial(
            curriculum, cr.QInitialisation(), GENTLE | ALL, cr.mean
        ),
        "shaped by Phi": partial(curriculum, cr.StateShaping(), BOLD),
        "policy only": partial(curriculum, cr.deep.PolicyReuse(), BOLD),
    },
    threshold=-20.0,
)

if __name__ == "__main__":
    BENCHMARK.main("deep_pursuit", __doc__)
