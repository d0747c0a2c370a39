"""Beyond the paper: forecast, calibration, controls, guard and a source left out."""

from typing import Any

import numpy as np

from curricle.comparison import Forecast
from curricle.paper import maze_runs as runs
from curricle.paper.settings import (
    FigureResult,
    Progress,
    draw_threshold,
    in_thousands,
    stacked,
    whiskers,
)
from curricle.paper.trust_claims import MOSTLY, claims
from curricle.paper.trust_runs import EXAMINED, HUNTS, LARGE_SEEDS, TrustRuns, run
from curricle.plotting import COLOURS, draw_curve, draw_potential, frame_cells, new_figure
from curricle.statistics import Curve
from curricle.text_tables import counted

STYLES = {
    "min": ("green", "--"),
    "min, calibrated": ("green", "-"),
    "mean": ("blue", "--"),
    "mean, calibrated": ("blue", "-"),
}
MAZES = {"scratch": "black", "from the 3x3 corner": "vermillion", "the same, guarded": "green"}
SHOWN = 60_000
"""Steps in the maze that are drawn."""


def build(seeds: int, workers: int | None, progress: Progress) -> FigureResult:
    """Return the trust figure."""
    found = run(seeds, workers, progress)
    figure, axes = new_figure(2, 3, width=13.5, height=7.6)
    _draw_forecast(axes[0, 0], found.forecast)
    for panel, size in zip(axes[0, 1:], HUNTS, strict=True):
        _draw_hunt(panel, found, size)
    _draw_controls(axes[1, 0], found)
    _draw_guard(axes[1, 1], found)
    _draw_left_out(axes[1, 2], found)
    return FigureResult(
        name="trust",
        title="Beyond the paper: can the transfer be trusted?",
        caption="Top left: where learning will start with each aggregate, predicted from 2 seeds "
        "of the sources before any training in the target, 5x5. Top middle and right: return of "
        f"the training episodes, {counted(seeds, 'seed')} (7x7: {min(seeds, LARGE_SEEDS)}), means "
        "with 95 % bands; the episodes of a calibration come first and count. Bottom left: mean "
        "return above that of scratch at the same number of target and source steps (strong "
        "transfer), with controls; 95 % intervals. Bottom middle: the maze with and without a "
        "guard (weak transfer). Bottom right: states whose greedy choice is wrong in more seeds "
        f"with the source than without it, after {EXAMINED:,} steps.",
        figure=figure,
        tables={"trust": _table(found)},
        claims=claims(found),
        settings={
            "pursuit": "both must catch; discount 0.95, truncated at 100 steps (7x7: 200)",
            "learner": "Q-learning, learning rate 0.1, epsilon 0.1; Q starts as phi",
            "budget": "400,000 source and 400,000 target steps (7x7: 1,000,000)",
            "calibration": "a scale fitted to 200 greedy episodes of phi, counted as target steps",
            "maze": runs.SETTINGS["maze"] + ", step reward -5; source: top-right 3x3",
        },
    )


def _draw_forecast(panel: Any, forecast: Forecast) -> None:
    names, low = forecast.ranking[::-1], forecast.random_return
    for y, name in enumerate(names):
        one = forecast[name]
        panel.barh(y, one.mean("start") - low, 0.55, low, color=COLOURS["sky"])
        words = f"{one.mean('optimistic'):.0%} of pairs above Q*, by {one.mean('excess'):.2g}"
        panel.text(low, y + 0.33, f" {words}; c = {one.scale:.2g}", fontsize=7.5)
    bounds = {"random policy": (low, "left"), "optimum": (forecast.optimum, "right")}
    for word, (value, side) in bounds.items():
        panel.axvline(value, color=COLOURS["grey"], lw=0.8, ls=":")
        panel.annotate(
            f" {word} ", (value, len(names) - 0.3), ha=side, fontsize=8, color=COLOURS["grey"]
        )
    panel.set(
        yticks=range(len(names)),
        yticklabels=names,
        ylim=(-0.5, len(names) - 0.1),
        xlabel="greedy return at step 0",
        title="forecast, 5x5: no training in the target yet",
    )


def _draw_hunt(panel: Any, found: TrustRuns, size: int) -> None:
    for name, (colour, dashes) in STYLES.items():
        result = found.hunts[size, name]
        curve = Curve(result.steps[1:], result.training_return[:, 1:])
        draw_curve(panel, curve, label=name, colour=colour, dashes=dashes)
    in_thousands(panel)
    panel.set(
        xlabel="target steps (thousands)",
        ylabel="training return (sum of rewards)",
        title=f"{size}x{size}: uncalibrated (dashed), calibrated (solid)",
    )
    panel.legend(loc="center right")


def _draw_controls(panel: Any, found: TrustRuns) -> None:
    shown = ("min", "min, calibrated", "mean", "max")
    contrasts = {name: found.compared.contrasts[name] for name in shown} | found.controls.contrasts
    names = list(contrasts)[::-1]
    for y, name in enumerate(names):
        gain, control = contrasts[name].strong_gain, name.startswith("mean, calibrated,")
        style = {"fmt": "o", "ms": 5, "capsize": 2, "color": COLOURS["grey" if control else "blue"]}
        panel.errorbar(gain.estimate, y, xerr=whiskers(gain), **style)
    panel.axvline(0, color=COLOURS["grey"], lw=0.8)
    panel.set(
        yticks=range(len(names)),
        yticklabels=[name.replace("mean, calibrated,", "control:") for name in names],
        xlabel="gain over scratch (mean return, strong transfer)",
        title="5x5: does it pay?",
    )


def _draw_guard(panel: Any, found: TrustRuns) -> None:
    for name, colour in MAZES.items():
        result = found.maze[name]
        keep = result.steps <= SHOWN
        curve = Curve(result.steps[keep], result.greedy_return[:, keep])
        draw_curve(panel, curve, label=name, colour=colour, window=runs.WINDOW)
    draw_threshold(panel, found.scratch.threshold)
    in_thousands(panel)
    panel.set(
        xlabel="target steps (thousands)",
        ylabel="greedy return (sum of rewards)",
        ylim=(-1700, 150),
        title="a harmful source, with and without a guard",
    )
    panel.legend(loc="lower right")


def _draw_left_out(panel: Any, found: TrustRuns) -> None:
    title = f"the 3x3 corner left out, after {EXAMINED:,} steps"
    unit = "wrong choices added by the source (% of seeds)"
    arena, added = found.scratch.maze, found.added_wrong
    draw_potential(panel, arena, 100 * added, label=title, unit=unit, difference=True)
    frame_cells(panel, arena, added >= MOSTLY)


def _table(found: TrustRuns) -> dict[str, Any]:
    """Return the training returns: size, arm, seed, steps, training_return."""
    return stacked(
        {
            "size": size,
            "arm": arm,
            "seed": np.array(result.seeds)[:, None],
            "steps": result.steps[1:],
            "training_return": result.training_return[:, 1:],
        }
        for (size, arm), result in found.hunts.items()
    )
