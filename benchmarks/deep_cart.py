"""CartPole from a coarse table, or from a cart with a longer pole: DQN, all steps charged.

The observation is four numbers. Two sources: tabular Q-learning of the same cart, each number cut
into a few bins; and the DQN of the target on a cart whose pole is twice as long and falls more
slowly, whose weights can be carried over. The DQN's settings are those of RL Baselines3 Zoo, tuned
for learning from scratch; arms that start from a source explore less.

    python benchmarks/deep_cart.py [--seeds 5] [--workers 2] [--arms ...] [--out DIR]
"""

from functools import partial

import gymnasium as gym
from evidence import Benchmark

import curricle as cr

DISCOUNT = 0.99
SOURCE, BUDGET = 20_000, 50_000
EVAL_FREQ = 2_500
LEARN = cr.QLearning(learning_rate=cr.learning.linear(0.5, 0.05, steps=SOURCE), epsilon=0.1)
EVALUATION = cr.GreedyEvaluation("rollouts", episodes=20, discounted=False)
DQN = {
    "learning_rate": 2.3e-3, "batch_size": 64, "buffer_size": 100_000, "learning_starts": 1_000,
    "target_update_interval": 10, "train_freq": 256, "gradient_steps": 128,
    "exploration_fraction": 0.16, "exploration_final_eps": 0.04,
    "policy_kwargs": {"net_arch": [256, 256]},
}  # fmt: skip
WARM = DQN | {"exploration_initial_eps": 0.2}
BLIND = WARM | {"policy_kwargs": {"net_arch": [256, 256], "reads": "nothing"}}
BINS = cr.interop.Bins({
    "place": [-2.4, -0.8, 0.8, 2.4], "speed": [-3, -0.5, 0.5, 3],
    "angle": [-0.21, -0.1, -0.02, 0, 0.02, 0.1, 0.21], "spin": [-3, -0.87, -0.2, 0.2, 0.87, 3],
})  # fmt: skip


def long_pole():
    cart = gym.make("CartPole-v1")
    pole = cart.unwrapped
    pole.length *= 2
    pole.polemass_length *= 2
    return cart


def target():
    return cr.observation_task("CartPole-v1", discount=DISCOUNT)


def from_table(shaping, settings):
    cart = target()
    coarse = cr.from_gymnasium("CartPole-v1", encode=BINS, discount=DISCOUNT)
    return plan(
        coarse, LEARN, cr.transfer.ObservationMapping(cart, coarse, BINS.many), shaping, settings
    )


def from_network(shaping, settings):
    cart, easier = target(), cr.tasks.ObservationTask(long_pole, DISCOUNT)
    return plan(
        easier, learner(DQN), cr.transfer.ObservationMapping(cart, easier), shaping, settings
    )


def plan(source, source_learner, mapping, shaping, settings):
    return cr.Curriculum(
        tasks={"source": source, "cart": mapping.target},
        transfers=[cr.Transfer("source", "cart", mapping)],
        learner={"source": source_learner, "cart": learner(settings)},
        budget={"source": cr.StoppingRule(SOURCE), "cart": BUDGET - SOURCE},
        shaping={"cart": shaping},
        eval_freq={"cart": EVAL_FREQ}, evaluation={"cart": EVALUATION},
    )  # fmt: skip


def from_scratch():
    return cr.Curriculum(
        {"cart": target()},
        learner=learner(DQN),
        budget=BUDGET,
        eval_freq=EVAL_FREQ,
        evaluation=EVALUATION,
    )


def learner(settings):
    return cr.deep.DeepLearner("DQN", settings=settings)


BENCHMARK = Benchmark(
    title="CartPole from a coarse table or a longer pole (DQN)",
    arms={
        "from scratch": from_scratch,
        "residual on the table": partial(from_table, cr.QInitialisation(), WARM),
        "residual without phi as input": partial(from_table, cr.QInitialisation(), BLIND),
        "shaped by the table": partial(from_table, cr.StateShaping(), DQN),
        "table's policy only": partial(from_table, cr.deep.PolicyReuse(), DQN),
        "residual on the network": partial(from_network, cr.QInitialisation(), WARM),
        "shaped by the network": partial(from_network, cr.StateShaping(), DQN),
        "weights carried over": partial(from_network, cr.deep.WeightTransfer(), WARM),
    },
    threshold=475.0,
)

if __name__ == "__main__":
    BENCHMARK.main("deep_cart", __doc__)
