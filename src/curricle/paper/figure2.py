"""F2: the maze with its optimal path, and learning it with and without transfer."""

from typing import Any

from curricle import solve
from curricle.paper import maze_runs as runs
from curricle.paper.settings import (
    Claim,
    FigureResult,
    Progress,
    draw_threshold,
    maze,
    over_seeds,
    verdict,
)
from curricle.planning import Solution, Trajectory, rollout
from curricle.plotting import COLOURS, draw_curve, draw_maze, new_figure
from curricle.statistics import Curve, time_to_threshold
from curricle.text_tables import counted

SIZE = 4
OPTIMUM = {-1.0: 114.6014, -5.0: -1.1773}
"""V*(start) by step reward, computed independently."""


def build(seeds: int, workers: int | None, progress: Progress) -> FigureResult:
    """Return figure 2."""
    arena = maze(-5)
    optimal = {step: solve(maze(step)) for step in OPTIMUM}
    path = rollout(arena, optimal[-5.0].policy)
    scratch = runs.scratch(arena, seeds, workers)
    progress("maze, from scratch")
    curve, _ = runs.transferred(arena, runs.corner(arena, SIZE), seeds, workers)
    progress(f"maze, source of size {SIZE}")
    figure, axes = new_figure(1, 2, width=10, height=4.2)
    draw_maze(axes[0, 0], arena, path=path.states)
    axes[0, 0].set_title(f"an optimal path, {len(path)} moves")
    panel = axes[0, 1]
    weak = f"from the top-right {SIZE}x{SIZE} (weak transfer)"
    strong = "the same, source steps counted (strong)"
    smoothed: Any = {"window": runs.WINDOW}
    draw_curve(panel, scratch.curve, label="scratch", colour="black", **smoothed)
    draw_curve(panel, curve, label=weak, colour="blue", **smoothed)
    draw_curve(panel, curve, label=strong, colour="sky", strong=True, dashes="--", **smoothed)
    draw_threshold(panel, scratch.threshold)
    panel.annotate(
        "threshold", (0, scratch.threshold), fontsize=8, color=COLOURS["grey"], va="bottom"
    )
    panel.set(
        xlabel="steps",
        ylabel="greedy return (sum of rewards)",
        title="learning curves",
        ylim=(-1700, 150),
        xlim=(0, None),
    )
    panel.legend(loc="lower right")
    return FigureResult(
        name="figure2",
        title="Figure 2: the maze, with and without transfer",
        caption="Left: the maze (start lower left), step reward -5. Right: mean over "
        f"{counted(seeds, 'seed')} with 95 % bands, moving mean of 10 checkpoints.",
        figure=figure,
        tables={"figure2": runs.curve_table({"scratch": scratch.curve, "transfer": curve})},
        claims=_claims(optimal, path, scratch, curve),
        settings={
            **runs.SETTINGS,
            "step reward": "-5 (as run)",
            "source": f"top-right {SIZE}x{SIZE}",
        },
    )


def _claims(
    optimal: dict[float, Solution], path: Trajectory, scratch: runs.Scratch, curve: Curve
) -> tuple[Claim, ...]:
    times = {
        strong: time_to_threshold(curve, scratch.threshold, window=runs.WINDOW, strong=strong)
        for strong in (False, True)
    }
    saved = {strong: over_seeds(scratch.times.steps - times[strong].steps) for strong in times}
    right = all(abs(optimal[s].start_value - v) < 5e-5 for s, v in OPTIMUM.items())
    return (
        Claim(
            "f2.optimum",
            "The optimal path leads through the maze in 34 moves",
            "exact value iteration; discount 0.99",
            verdict(len(path) == 34 and right),
            {
                "moves": len(path),
                **{f"V*(start) at step reward {s:g}": optimal[s].start_value for s in OPTIMUM},
                "error bound": max(solution.error_bound for solution in optimal.values()),
            },
        ),
        Claim(
            "f2.faster",
            "Transfer from a sub-maze reaches the threshold earlier",
            f"source of size {SIZE}, step reward -5; paired over seeds",
            verdict(saved[False].low > 0),
            {
                "scratch, steps to threshold": over_seeds(scratch.times.steps),
                "steps saved (weak transfer)": saved[False],
                "steps saved (strong transfer)": saved[True],
            },
        ),
    )
