"""Beyond the paper: foreseen before training, calibrated, controlled, guarded, accounted for."""

from typing import Any

import numpy as np

from curricle.comparison import Forecast
from curricle.paper import transferred_maze as runs
from curricle.paper.settings import FigureResult, Tick
from curricle.paper.trust_claims import claims
from curricle.paper.trusted import HUNTS, LARGE, LOOK, Trust, run
from curricle.plotting.figures import COLOURS, draw_curve, draw_maze, new_figure
from curricle.statistics import Curve

LOOKS = {
    "min": ("green", "--"),
    "min, calibrated": ("green", "-"),
    "mean": ("blue", "--"),
    "mean, calibrated": ("blue", "-"),
}
MAZES = {"scratch": "black", "from the 3x3 corner": "vermillion", "the same, guarded": "green"}
SHOWN = 60_000
"""Steps of the maze that are drawn."""


def build(seeds: int, workers: int | None, tick: Tick) -> FigureResult:
    """Return the figure on trust."""
    found = run(seeds, workers, tick)
    figure, axes = new_figure(2, 3, width=13.5, height=7.6)
    _draw_forecast(axes[0, 0], found.rows)
    for panel, size in zip(axes[0, 1:], HUNTS, strict=True):
        _draw_hunt(panel, found, size)
    _draw_controls(axes[1, 0], found)
    _draw_guard(axes[1, 1], found)
    _draw_blame(axes[1, 2], found)
    return FigureResult(
        name="trust",
        title="Beyond the paper: can the transfer be trusted?",
        caption="Top left: where learning starts on each aggregate, foreseen from 2 seeds of the "
        "sources before any training in the target, 5x5. Top middle and right: return of the "
        f"training episodes, {seeds} seeds (7x7: {min(seeds, LARGE)}), means with 95 % bootstrap "
        "bands; a calibration's own episodes come first and count. Bottom left: mean return above "
        "the direct learner's at the same total of steps, sources charged, with controls; 95 % "
        "intervals. Bottom middle: the maze with and without a guard, source steps not charged. "
        f"Bottom right: states whose greedy choice is wrong in more seeds with the source than "
        f"without it, after {LOOK:,} steps.",
        figure=figure,
        tables={"trust": _table(found)},
        claims=tuple(claims(found)),
        settings={
            "pursuit": "both must catch; discount 0.95, cut at 100 steps (7x7: 200)",
            "learner": "Q-learning, learning rate 0.1, epsilon 0.1; Q starts as phi",
            "budget": "400,000 source and 400,000 target steps (7x7: 1,000,000)",
            "calibration": "a scale fitted to 200 greedy episodes of phi, charged to the target",
            "maze": runs.SETTINGS["maze"] + ", step reward -5; source: top-right 3x3",
        },
    )


def _draw_forecast(panel: Any, rows: Forecast) -> None:
    names = rows.ranking[::-1]
    for y, name in enumerate(names):
        one = rows[name]
        panel.barh(y, one.mean("start") - rows.random_return, 0.55, rows.random_return)
        words = f"{one.mean('optimistic'):.0%} of pairs above Q*, by {one.mean('excess'):.2g}"
        panel.text(rows.random_return, y + 0.33, f" {words}; c = {one.scale:.2g}", fontsize=7.5)
    for bar in panel.patches:
        bar.set_color(COLOURS["sky"])
    bounds = {
        "random_return": (rows.random_return, "left"),
        "optimum": (rows.optimum, "right"),
    }
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
        title="forecast, 5x5: nothing trained in the target yet",
    )


def _draw_hunt(panel: Any, found: Trust, size: int) -> None:
    for name, (colour, dashes) in LOOKS.items():
        result = found.hunts[size, name]
        curve = Curve(result.steps[1:], result.training_return[:, 1:])
        draw_curve(panel, curve, label=name, colour=colour, dashes=dashes)
    panel.xaxis.set_major_formatter(lambda x, _: f"{x / 1000:g}")
    panel.set(
        xlabel="target steps (thousands)",
        ylabel="training return (sum of rewards)",
        title=f"{size}x{size}: as it is (dashed), calibrated (solid)",
    )
    panel.legend(loc="center right")


def _draw_controls(panel: Any, found: Trust) -> None:
    contrasts = {
        **{
            name: found.compared.contrasts[name]
            for name in ("min", "min, calibrated", "mean", "max")
        },
        **found.controls.contrasts,
    }
    names = list(contrasts)[::-1]
    for y, name in enumerate(names):
        gain, control = contrasts[name].strong_gain, name.startswith("mean, calibrated,")
        panel.errorbar(
            gain.estimate,
            y,
            xerr=[[gain.estimate - gain.low], [gain.high - gain.estimate]],
            fmt="o",
            ms=5,
            capsize=2,
            color=COLOURS["grey" if control else "blue"],
        )
    panel.axvline(0, color=COLOURS["grey"], lw=0.8)
    panel.set(
        yticks=range(len(names)),
        yticklabels=[name.replace("mean, calibrated,", "control:") for name in names],
        xlabel="gain over direct learning (mean return, sources charged)",
        title="5x5: does it pay?",
    )


def _draw_guard(panel: Any, found: Trust) -> None:
    for name, colour in MAZES.items():
        result = found.maze[name]
        keep = result.steps <= SHOWN
        curve = Curve(result.steps[keep], result.greedy_return[:, keep])
        draw_curve(panel, curve, label=name, colour=colour, window=runs.WINDOW)
    panel.axhline(found.scratch.threshold, color=COLOURS["grey"], lw=0.8, ls=":")
    panel.xaxis.set_major_formatter(lambda x, _: f"{x / 1000:g}")
    panel.set(
        xlabel="target steps (thousands)",
        ylabel="greedy return (sum of rewards)",
        ylim=(-1700, 150),
        title="a source that does harm, and a guard",
    )
    panel.legend(loc="lower right")


def _draw_blame(panel: Any, found: Trust) -> None:
    blamed = found.blamed
    arena = found.scratch.maze
    draw_maze(
        panel,
        arena,
        values=100 * blamed.wrong[0],
        value_label="wrong choices added by the source (% of seeds)",
        marked=blamed.replace(blamed.names[0]),
    )
    panel.set_title(f"whose doing: the 3x3 corner, after {LOOK:,} steps")


def _table(found: Trust) -> dict[str, Any]:
    """Return the training returns: size, arm, seed, steps, training_return."""
    parts: dict[str, list[Any]] = {
        name: [] for name in ("size", "arm", "seed", "steps", "training_return")
    }
    for (size, arm), result in found.hunts.items():
        values = result.training_return[:, 1:]
        n_seeds, n = values.shape
        parts["size"].append(np.full(values.size, size))
        parts["arm"].append(np.full(values.size, arm))
        parts["seed"].append(np.repeat(result.seeds, n))
        parts["steps"].append(np.tile(result.steps[1:], n_seeds))
        parts["training_return"].append(values.ravel())
    return {name: np.concatenate(columns) for name, columns in parts.items()}
