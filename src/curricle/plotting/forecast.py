"""The figure of a forecast: the return from which learning would start with each potential."""

import math
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from curricle.comparison.forecasting import Forecast
from curricle.plotting.scales import minus, rounded
from curricle.plotting.styles import COLOURS, STYLE, caption, new_figure, write_columns

ROW_HEIGHT = 0.28


@matplotlib.rc_context(STYLE)
def draw_forecast(forecast: Forecast) -> Figure:
    """Return the figure of a forecast: bars from the random policy's return to predicted starts.

    A start is the return before anything is learnt in the target, not what learning then gains.

    A row for each aggregate, the best start first, then one for each transfer alone; dots are
    seeds. Beside the bars: the share of pairs that the potential overestimates, and the scale that
    a calibration would find.
    """
    rows = forecast.rows
    figure, grid = new_figure(1, 1, width=7.5, height=1.6 + ROW_HEIGHT * max(len(rows), 3))
    axes = grid[0, 0]
    _draw_bars(axes, forecast)
    _draw_bounds(axes, forecast)
    over = "φ > Q*" if forecast.solved else "φ > return"
    shares = [f"{one.mean('optimistic'):.0%}" for one in rows]
    scales = ["none" if math.isnan(one.scale) else f"× {one.scale:.2g}" for one in rows]
    write_columns(axes, [(over, *shares), ("scale", *scales)])
    axes.set_xlabel("expected return of the greedy policy")
    # The sources' names are not in the caption: lines that are wrapped read dollars as formulas.
    figure.suptitle(
        f"{forecast.target}: where learning would start, not what it gains\n"
        f"a forecast {forecast.computed_from}"
    )
    caption(figure, _words(forecast))
    return figure


def _draw_bars(axes: Axes, forecast: Forecast) -> None:
    """Draw a bar and the dots of its seeds in each row, from the top."""
    names, low = [], forecast.random_return
    for row, one in enumerate(forecast.rows):
        colour = COLOURS["blue" if one.aggregate else "grey"]
        alpha = 0.9 if one.used else 0.45
        axes.barh(row, one.mean("start") - low, 0.62, low, color=colour, alpha=alpha)
        starts = [seed.start for seed in one.seeds]
        # Seeds lie side by side, so that equal ones can be seen.
        places = row + 0.2 * np.linspace(-1, 1, len(starts)) * (len(starts) > 1)
        axes.plot(starts, places, "o", color="k", ms=2.5)
        names.append(one.name + " (used)" * one.used)
    axes.set_yticks(range(len(names)), names)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.set_ylim(len(names) - 0.4, -0.6)


def _draw_bounds(axes: Axes, forecast: Forecast) -> None:
    """Draw the random policy's return and the optimum as labelled lines."""
    for name, bound, dashes, side in (
        ("random policy", forecast.random_return, ":", "left"),
        ("optimum", forecast.optimum, "-", "right"),
    ):
        if math.isnan(bound):
            continue
        axes.axvline(bound, color=COLOURS["black"], lw=1, linestyle=dashes)
        above: Any = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
        words = f"{name} {rounded(bound)}"
        axes.annotate(words, (bound, 1), (0, 3), ha=side, fontsize=7.5, **above)
    axes.use_sticky_edges = False
    axes.margins(x=0.04)
    axes.xaxis.set_major_formatter(lambda x, _: minus(f"{x:,g}"))


def _words(forecast: Forecast) -> str:
    """Return the caption."""
    seeds = len(forecast.rows[0].seeds)
    bars = "Bars: mean over seeds; dots: seeds" if seeds > 1 else "One seed"
    returns = "exact" if forecast.exact else "by rollouts"
    over = (
        "φ > Q*: share of state-action pairs whose potential φ is above their optimal value"
        if forecast.solved
        else "φ > return: share of the steps of φ's greedy policy on which φ is above the return "
        "to go"
    )
    alone = any(not one.aggregate for one in forecast.rows)
    colours = " Blue: all transfers together; grey: one alone." * alone
    return (
        f"{bars}; no intervals. Returns are {returns}; nothing is learnt in the target yet. "
        f"{over}. Scale: what a calibration would multiply φ by.{colours}"
    )
