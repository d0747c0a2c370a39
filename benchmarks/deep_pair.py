"""Two predators on 7x7 from one on 7x7: DQN on 25 joint actions, all steps charged.

The source is the table of one predator, 2,401 states, read once for each of the two; the network
starts at the smaller of the two values, and improves on it here.

    python benchmarks/deep_pair.py [--seeds 5] [--workers 2] [--arms ...] [--out DIR]
"""

from functools import partial

from evidence import Benchmark

import curricle as cr

DISCOUNT = 0.95
SOURCE, BUDGET = 200_000, 260_000
EVAL_FREQ = 5_000
HUNT = cr.Pursuit(7, predators=2, discount=DISCOUNT)
CHASE = cr.Pursuit(7, predators=1, discount=DISCOUNT)
LEARN = cr.QLearning(learning_rate=cr.learning.linear(0.9, 0.05, steps=SOURCE), epsilon=0.2)
EVALUATION = cr.GreedyEvaluation("rollouts", episodes=200, discounted=False)
DQN = {
    "learning_rate": 3e-4, "batch_size": 512, "buffer_size": 100_000, "learning_starts": 1_000,
    "train_freq": 1, "gradient_steps": 1, "target_update_interval": 1_000,
    "exploration_fraction": 0.5, "exploration_final_eps": 0.05,
    "policy_kwargs": {"net_arch": [128, 128], "optimizer_kwargs": {"eps": 1e-2}},
}  # fmt: skip
WARM = DQN | {"exploration_initial_eps": 0.1}


def learner(settings):
    return cr.deep.DeepLearner("DQN", envs=8, settings=settings)


def curriculum(shaping, settings):
    """Return the plan of learning from one predator, within the budget."""
    hunt = cr.interop.observed_pursuit(HUNT)
    return cr.Curriculum(
        tasks={"chase": CHASE, "hunt": hunt},
        transfers=[
            cr.Transfer("chase", "hunt", cr.interop.predator_mapping(hunt, CHASE, predator=name))
            for name in HUNT.predator_names
        ],
        aggregate=cr.minimum,
        learner={"chase": LEARN, "hunt": learner(settings)},
        budget={"chase": cr.StoppingRule(SOURCE), "hunt": BUDGET - SOURCE},
        shaping={"hunt": shaping}, eval_freq={"hunt": EVAL_FREQ}, evaluation={"hunt": EVALUATION},
    )  # fmt: skip


def from_scratch():
    return cr.Curriculum(
        {"hunt": cr.interop.observed_pursuit(HUNT)}, learner=learner(DQN), budget=BUDGET,
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
