"""MiniGrid's DoorKey 8x8 from DoorKey 6x6: DQN, all steps charged.

The observation is a vector, of which `door_rooms.py` says what it holds. Two sources in the 6x6
room: the table of errands; and the DQN of the target, whose weights can be carried over, as
observations of both rooms have the same shape.

    pip install "minigrid>=3,<4"
    python -m benchmarks.deep_door [--seeds 5] [--workers 2] [--arms ...] [--out DIR]
"""

from functools import partial

import curricle as cr
from benchmarks.door_rooms import door_room
from benchmarks.evidence import Benchmark
from curricle.transfer import family_mappings

SMALL, LARGE = 6, 8
SOURCE, BUDGET = 40_000, 80_000
EVAL_FREQ = 5_000
THRESHOLD = 16.0
LEARN = cr.QLearning(learning_rate=cr.learning.linear(0.5, 0.05, steps=SOURCE), epsilon=0.2)
EVALUATION = cr.GreedyEvaluation("rollouts", episodes=50, discounted=False)
DQN = {
    "learning_rate": 5e-4, "batch_size": 128, "buffer_size": 50_000, "learning_starts": 1_000,
    "gradient_steps": 2, "train_freq": 1, "target_update_interval": 1_000,
    "exploration_fraction": 0.3, "exploration_final_eps": 0.05,
    "policy_kwargs": {"net_arch": [128, 128]},
}  # fmt: skip
WARM = DQN | {"exploration_initial_eps": 0.2}
GENTLE = DQN | {
    "learning_rate": 3e-5, "batch_size": 512, "gradient_steps": 1,
    "exploration_initial_eps": 0.5, "exploration_final_eps": 0.1,
    "policy_kwargs": {"net_arch": [128, 128], "optimizer_kwargs": {"eps": 1e-2}},
}  # fmt: skip
"""Where phi is nearly right, actions differ by little: small steps keep these differences."""


def from_table(shaping, settings):
    large, small = door_room(size=LARGE), door_room(size=SMALL, seen="errands")
    (mapping,) = family_mappings(large, small)
    edge = cr.Transfer("small", "large", mapping)
    learners = {"small": LEARN, "large": learner(settings)}
    return plan({"small": small.task, "large": large.task}, [edge], learners, shaping)


def from_network(shaping, settings):
    large, small = door_room(size=LARGE).task, door_room(size=SMALL).task
    edge = cr.Transfer("small", "large", cr.transfer.ObservationMapping(large, small))
    learners = {"small": learner(DQN), "large": learner(settings)}
    return plan({"small": small, "large": large}, [edge], learners, shaping)


def plan(tasks, transfers, learners, shaping):
    return cr.Curriculum(
        tasks=tasks, transfers=transfers, learner=learners,
        budget={"small": cr.StoppingRule(SOURCE), "large": BUDGET - SOURCE},
        shaping={"large": shaping},
        eval_freq={"large": EVAL_FREQ}, evaluation={"large": EVALUATION},
    )  # fmt: skip


def from_scratch():
    return cr.Curriculum(
        {"large": door_room(size=LARGE).task},
        learner=learner(DQN),
        budget=BUDGET,
        eval_freq=EVAL_FREQ,
        evaluation=EVALUATION,
    )


def learner(settings):
    return cr.deep.DeepLearner("DQN", envs=8, settings=settings)


BENCHMARK = Benchmark(
    title="MiniGrid DoorKey 8x8 from 6x6 (DQN)",
    arms={
        "from scratch": from_scratch,
        "residual on the table": partial(from_table, cr.QInitialisation(), GENTLE),
        "shaped by the table": partial(from_table, cr.StateShaping(), DQN),
        "table's policy only": partial(from_table, cr.deep.PolicyReuse(), DQN),
        "residual on the network": partial(from_network, cr.QInitialisation(), WARM),
        "shaped by the network": partial(from_network, cr.StateShaping(), DQN),
        "weights carried over": partial(from_network, cr.deep.WeightTransfer(), WARM),
    },
    threshold=THRESHOLD,
)

if __name__ == "__main__":
    BENCHMARK.main("benchmarks.deep_door", __doc__)
