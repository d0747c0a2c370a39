"""The referee's pictures: what each designer takes in each domain, and the published claim."""

from collections.abc import Mapping
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from benchmarks.referee.claim import Arm
from benchmarks.referee.players import SCRATCH
from benchmarks.referee.verdicts import Match, Unit, against
from curricle.show import COLOURS, STYLE, new_figure, save
from curricle.statistics import Interval

COLUMNS = 4
RATE_COLOURS = {0.5: "blue", 0.9: "vermillion", 0.95: "green", None: "grey"}


def draw_match(played: Match, path: Path) -> None:
    """Draw, for each domain, the steps of each designer as a share of scratch's."""
    designers = [one for one in played.designers if one != SCRATCH]
    rows = -(-len(played.units) // COLUMNS)
    with matplotlib.rc_context(STYLE):
        figure, axes = new_figure(rows, COLUMNS, width=9.5, height=0.9 + rows * 2.6)
        panels = list(axes.flat)
        for panel, (name, units) in zip(panels, played.units.items(), strict=False):
            _domain(panel, units, designers)
            panel.set_title(name)
            if panel.get_subplotspec().is_first_col():
                panel.set_yticks(range(len(designers)), designers)
            else:
                panel.set_yticks(range(len(designers)), [""] * len(designers))
        for panel in panels[len(played.units) :]:
            panel.set_visible(False)
        shown = panels[: len(played.units)]
        low, high = (
            end(panel.get_xlim()[k] for panel in shown) for k, end in enumerate((min, max))
        )
        for panel in shown:
            panel.set_xlim(low, high)
        figure.supxlabel(
            "steps until learnt, sources charged and searches not, as a share of scratch's "
            "(log scale), with 95 % intervals. Green: fewer than scratch",
            fontsize=8,
        )
        save(figure, path)


def _domain(panel: Axes, units: Mapping[str, Unit], designers: list[str]) -> None:
    panel.axvline(1, color=COLOURS["black"], linewidth=0.8)
    for row, designer in enumerate(designers):
        if designer not in units:
            continue
        unit, base = units[designer], units[SCRATCH]
        own = against(unit, base)
        colour = COLOURS["green" if own.beats else "grey"]
        left, middle, right = _shares(own.share)
        panel.plot([left, right], [row, row], color=colour)
        panel.plot(middle, row, "o", color=colour, markersize=4.5)
    panel.set_xscale("log")
    panel.set_ylim(len(designers) - 0.5, -0.5)
    panel.xaxis.set_major_locator(LogLocator(subs=(1, 3)))
    panel.xaxis.set_minor_locator(NullLocator())
    panel.xaxis.set_major_formatter(FuncFormatter(lambda share, _: f"{share:g}"))


def _shares(saved: Interval) -> tuple[float, float, float]:
    """Return the steps as a share of the other's, from what is saved of them."""
    middle = float(saved.estimate)
    low, high = (float(middle if np.isnan(one) else one) for one in (saved.low, saved.high))
    return 1 - high, 1 - middle, 1 - low


def draw_claim(arms: list[Arm], path: Path) -> None:
    """Draw the quartiles of each arm that arrives."""
    shown = [arm for arm in arms if np.isfinite(arm.quartiles[1])]
    with matplotlib.rc_context(STYLE):
        figure, axes = new_figure(1, 1, width=7, height=0.9 + 0.3 * len(shown))
        panel = axes[0, 0]
        for row, arm in enumerate(shown):
            low, middle, high = arm.quartiles
            colour = COLOURS[RATE_COLOURS[arm.rate]]
            panel.plot([low, high], [row, row], color=colour, linewidth=2)
            panel.plot(middle, row, "D" if arm.ours else "o", color=colour, markersize=6)
        names = [f"{arm.name}, {'?' if arm.rate is None else arm.rate}" for arm in shown]
        panel.set_yticks(range(len(shown)), names)
        panel.invert_yaxis()
        panel.set_xlabel(
            "steps until a lasting return of 18, sources charged: median and quartiles"
        )
        panel.set_title("An arm and its learning rate (colour)")
        save(figure, path)
