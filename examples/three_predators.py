"""From one predator to three on 10x10: a task of 10^8 states without a dense table.

All three must be on the prey's cell. The joint task has 10^8 states and 125 joint actions: a dense
table would take 50 GB in single precision. One predator's chase has 10^4 states and 5 actions. Its
values, mapped once for each of the three predators, are the potential of the hunt. The hunt's table
gets a row when its state is first visited, made from the potential.

With the settings below it takes a minute on two cores and 5 GB of memory, which two seeds at a time
share. Without transfer nothing is learnt in this time.

python examples/three_predators.py --out docs/three_predators.png
python examples/three_predators.py --steps 20_000_000 --memory "10 GiB" --out longer.png
python examples/three_predators.py --size 7 --steps 20_000_000 --seeds 2 --out seven.png
"""

import argparse
import time

import matplotlib

import curricle as cr
from curricle.show import STYLE, draw_curve, new_figure

SCALES = {1.5: "green", 1.0: "blue"}
EVALUATION = cr.GreedyEvaluation(method="rollouts", episodes=200, discounted=False)
LEARNER = cr.QLearning(learning_rate=0.1, epsilon=0.1)


def main(path, seeds=4, steps=8_000_000, size=10, memory="4.5 GiB", source_steps=10_000_000):
    sparse = cr.Storage(kind="sparse", dtype="float32", memory_limit=memory, save_values=False)
    hunt = cr.Pursuit(size, predators=3, discount=0.95)
    chase = cr.Pursuit(size, predators=1, discount=0.95)
    print(f"{hunt.states.size:,} states x {hunt.actions.size} actions from {chase.states.size:,}")

    # The source's values should be accurate: a falling learning rate, and much exploration.
    falling = cr.learning.linear(0.5, 0.01, steps=source_steps * 4 // 5)
    sources, results = {}, {}
    for scale in SCALES:
        curriculum = cr.Curriculum(
            tasks={"chase": chase, "hunt": hunt},
            transfers=[
                cr.Transfer("chase", "hunt", cr.project(hunt, chase, predator=name), scale=scale)
                for name in hunt.predator_names
            ],
            aggregate=cr.minimum,
            shaping=cr.LookAheadAdvice(),
            learner={"chase": cr.QLearning(learning_rate=falling, epsilon=0.5), "hunt": LEARNER},
            budget={"chase": cr.StoppingRule(source_steps), "hunt": steps},
            eval_freq={"hunt": steps // 16},
            evaluation={"hunt": EVALUATION},
            storage={"hunt": sparse},
        )
        begin = time.perf_counter()
        trained = curriculum.train(seeds, trained=sources, workers=2)
        sources = {"chase": trained["chase"]}  # the same for every scale
        results[f"one predator's values x {scale:g}"] = trained["hunt"], SCALES[scale]
        print(f"scale {scale:g} took {time.perf_counter() - begin:.0f} s")
    scratch = cr.learn(
        hunt,
        LEARNER,
        steps // 8,
        seeds=seeds,
        eval_freq=steps // 16,
        evaluation=EVALUATION,
        storage=sparse,
        workers=2,
    )
    results["no transfer"] = scratch, "black"

    print("Return of an episode, mean over seeds and 95 % interval:")
    for name, (result, _) in results.items():
        print(f"{name}, after {result.steps[-1]:,} steps")
        for label, returns in (
            ("while learning, first part", result.training_return[:, 1]),
            ("while learning, last part", result.training_return[:, -1]),
            ("greedy policy, before", result.greedy_return[:, 0]),
            ("greedy policy, at the end", result.greedy_return[:, -1]),
        ):
            print(f"  {label:<28} {cr.statistics.mean_interval(returns)}")
        if result.out_of_memory.any():
            print(f"  the memory was full after {result.steps_used.min():,} steps")
    draw(path, results, seeds, size, sources["chase"].steps_used[0])


def draw(path, results, seeds, size, source_steps):
    with matplotlib.rc_context(STYLE):
        figure, axes = new_figure(1, 1, width=7, height=3.6)
        panel = axes[0, 0]
        for name, (result, colour) in results.items():
            draw_curve(panel, cr.statistics.Curve.of(result), label=name, colour=colour)
        panel.set_yscale("symlog", linthresh=10, linscale=0.5)
        panel.set_yticks([-10, -12, -15, -20, -30, -50, -100, -200])
        panel.yaxis.set_major_formatter(lambda y, _: f"{y:g}")
        panel.set_yticks([], minor=True)
        panel.set_ylim(-250, -9)
        panel.xaxis.set_major_formatter(lambda x, _: f"{x / 1e6:g}")
        panel.set(
            xlabel=f"target steps (millions), after {source_steps / 1e6:g} million of the source",
            ylabel="greedy policy's return (-1 a step)",
            title=f"three predators that must all catch, {size}x{size}: mean over {seeds} seeds, "
            "95 % bands",
        )
        panel.legend(loc="center right")
        figure.savefig(path)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", default="three_predators.png")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--steps", type=int, default=8_000_000, help="of the hunt, each seed")
    parser.add_argument("--size", type=int, default=10, help="cells a side")
    parser.add_argument("--memory", default="4.5 GiB", help="of the tables of two seeds")
    given = parser.parse_args()
    main(given.out, given.seeds, given.steps, given.size, given.memory)
