"""From one predator to two: a curriculum drawn against two learners from scratch.

Measured over 30 seeds after at most 150,000 steps, the source's included: -4.3 with the source's
values doubled, -12.9 with the values as they are, -62.8 from scratch with Q started at 0; the
optimum is -3.5. Rewards are negative, so 0 is optimistic. Q started at -10 reaches -6.8 from
scratch, with no source. The default shaping has a portfolio, so the hunt begins without the
potential, at the return of scratch, and the learner that has it is ahead by the first checkpoint.
These are ends: in mean return over all steps the optimistic learner is 3.3 ahead of the doubled
values, as the source takes a third of the steps. Tuned, the curriculum pays (tune.toml).

python examples/first_curriculum.py first_curriculum.png
"""

import sys
from dataclasses import replace

import matplotlib

import curricle as cr
from curricle.show import COLOURS, STYLE, draw_curve, new_figure

SEEDS, SOURCE, TARGET = 30, 50_000, 100_000


def main(path, seeds=SEEDS):
    hunt = cr.Pursuit(size=4, predators=2)
    chase = cr.Pursuit(size=4, predators=1)
    learner = cr.QLearning(learning_rate=0.1, epsilon=0.1)
    scratch = {
        initial: cr.learn(
            hunt,
            replace(learner, initial_value=initial),
            SOURCE + TARGET,
            seeds=seeds,
            stream="hunt",
        )
        for initial in (0.0, -10.0)
    }
    curves = {}
    for scale in (1.0, 2.0):
        curriculum = cr.Curriculum(
            tasks={"chase": chase, "hunt": hunt},
            transfers=[
                cr.Transfer("chase", "hunt", cr.project(hunt, chase, predator=name), scale=scale)
                for name in ("predator_1", "predator_2")
            ],
            aggregate=cr.minimum,
            learner=learner,
            budget={"chase": SOURCE, "hunt": TARGET},
        )
        result = curriculum.train(seeds=seeds)
        curves[scale] = cr.statistics.Curve.of(result["hunt"], result.source_steps("hunt"))

    with matplotlib.rc_context(STYLE):
        figure, axes = new_figure(1, 1, width=7, height=3.6)
        panel = axes[0, 0]
        draw_curve(
            panel, curves[2.0], label="curriculum, source values x 2", colour="green", strong=True
        )
        draw_curve(
            panel,
            curves[1.0],
            label="curriculum, source values as they are",
            colour="blue",
            strong=True,
        )
        for initial, colour in ((0.0, "black"), (-10.0, "orange")):
            curve = cr.statistics.Curve.of(scratch[initial])
            draw_curve(panel, curve, label=f"from scratch, Q from {initial:g}", colour=colour)
        panel.axhline(cr.solve(hunt).start_value, color=COLOURS["grey"], ls=":", lw=1)
        panel.annotate("optimum", (0, -3.2), color=COLOURS["grey"], va="bottom")
        panel.set_yscale("symlog", linthresh=10, linscale=1)
        panel.set_yticks(
            [-3.5, -5, -10, -20, -50, -100], ["-3.5", "-5", "-10", "-20", "-50", "-100"]
        )
        panel.set_yticks([], minor=True)
        panel.set_ylim(-100, -2)
        panel.xaxis.set_major_formatter(lambda x, _: f"{x / 1000:g}")
        panel.set(
            xlabel="steps, the source's included (thousands)",
            ylabel="greedy value (discounted return)",
            title=f"two predators that must both catch, 4x4: mean over {seeds} seeds, 95 % bands",
        )
        panel.legend(loc="center left", bbox_to_anchor=(0.52, 0.25), fontsize="small")
        figure.savefig(path)
    for initial, result in scratch.items():
        end = cr.statistics.mean_interval(result.greedy_return[:, -1])
        print(f"from scratch, Q from {initial:<5g}{end}")
    for scale, curve in curves.items():
        print(f"source values x {scale:<9g}{cr.statistics.mean_interval(curve.values[:, -1])}")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "first_curriculum.png")
