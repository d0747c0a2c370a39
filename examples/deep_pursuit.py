"""Two predators on 5x5, learnt by a network, from one predator, learnt as a table.

DQN observes the positions of all agents as numbers in [-1, 1] and chooses among 25 joint actions.
The values of one predator are read once for each of the two and summed, which is too low rather
than too high. The network adds a residual to this potential, 0 at first. Learning from scratch gets
as many steps as the transfer with its source.

Needs `pip install "curricle[deep]"`; a minute or two on two cores.

python examples/deep_pursuit.py
"""

import curricle as cr

SOURCE, TARGET, SEEDS = 40_000, 10_000, 3
HUNT = cr.Pursuit(size=5, predators=2, discount=0.95)
CHASE = cr.Pursuit(size=5, predators=1, discount=0.95)
EVALUATION = cr.GreedyEvaluation("rollouts", episodes=30, discounted=False)
# A large eps of Adam keeps steps small where errors are small.
DQN = cr.deep.DeepLearner("DQN", envs=8, settings={
    "learning_rate": 1e-4, "batch_size": 256, "learning_starts": 500, "gradient_steps": 1,
    "train_freq": 1, "target_update_interval": 500, "exploration_fraction": 0.5,
    "exploration_initial_eps": 0.2, "exploration_final_eps": 0.05,
    "policy_kwargs": {"net_arch": [128, 128], "optimizer_kwargs": {"eps": 1e-2}},
})  # fmt: skip


def main():
    hunt = cr.interop.observed_pursuit(HUNT)
    plan = cr.Curriculum(
        tasks={"chase": CHASE, "hunt": hunt},
        transfers=[
            cr.Transfer("chase", "hunt", cr.interop.predator_mapping(hunt, CHASE, predator=name))
            for name in HUNT.predator_names
        ],
        aggregate=cr.total,
        learner={
            "chase": cr.QLearning(
                learning_rate=cr.learning.linear(0.9, 0.1, steps=SOURCE), epsilon=0.2
            ),
            "hunt": DQN,
        },
        budget={"chase": cr.StoppingRule(SOURCE), "hunt": TARGET},
        eval_freq={"hunt": TARGET // 5},
        evaluation={"hunt": EVALUATION},
    )
    transfer = plan.train(seeds=SEEDS)
    scratch = cr.deep.learn_deep(
        hunt, DQN, SOURCE + TARGET, seeds=SEEDS,
        eval_freq=(SOURCE + TARGET) // 5, evaluation=EVALUATION,
    )  # fmt: skip
    for name, result, spent in (
        ("from one predator", transfer["hunt"], SOURCE),
        ("from scratch", scratch, 0),
    ):
        returns = result.greedy_return
        print(f"{name}: {returns[:, 0].mean():.1f} after {spent:,} steps")
        end = cr.statistics.mean_interval(returns[:, -1])
        print(f"  then {end} after {spent + result.steps[-1]:,}")


if __name__ == "__main__":
    main()
