"""One style for all figures: colours, how arms look, axes."""

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, cycle, product
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullLocator

from curricle.comparison.comparison import Comparison
from curricle.pictures.scenes import COLOURS as PALETTE
from curricle.text import minus

COLOURS = PALETTE
"""The palette of Okabe and Ito, which colour-blind readers can tell apart: name -> colour."""
OWN_COLOURS = ("blue", "vermillion", "green", "orange", "purple", "sky")  # of curricula
STYLE: Any = {
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "savefig.dpi": 150,
    # Names are the user's text: a dollar in a name begins no formula.
    "text.parse_math": False,
    # Without it an SVG differs from run to run.
    "svg.hashsalt": "curricle",
}
"""Matplotlib's settings for these pictures, for ``matplotlib.rc_context``."""
TINTS = {"treasure": "#f2c14e", "fire": "#ee6c4d", "pit": "#3d405b", "goal": "#f2c14e"}
TINTS |= {"key": "#8ecae6", "lock": "#c9a0dc", "exit": "#90be6d"}
"""Of the objects on a grid."""
DIVERGING, SEQUENTIAL = "PuOr", "cividis"  # colour maps that colour-blind readers can read
MOST_NUMBERS = 36  # cells of a grid up to which their values are written
SHADES = 64  # colours of a map on a page
SCREEN = 72  # pixels of an inch in a notebook


def value_scale(low: float, high: float, *, difference: bool = False) -> tuple[float, float, str]:
    """Return the ends and the map of value colours; 0 is the middle if values have both signs."""
    if difference or low < 0 < high:
        high = max(abs(low), abs(high)) or 1.0
        return -high, high, DIVERGING
    return low, high, SEQUENTIAL


def digits_of(low: float, high: float) -> int:
    """Return the decimals of values that are written into cells."""
    size = max(abs(low), abs(high))
    if 0 < size < 1:
        return min(9, 1 - math.floor(math.log10(size)))
    return 0 if size >= 100 else 1


def shades_of(palette: str) -> list[str]:
    """Return a colour map as `SHADES` colours, ``#rrggbb``, from low to high."""
    return [to_hex(colour) for colour in matplotlib.colormaps[palette](np.linspace(0, 1, SHADES))]


# -- how arms look ---------------------------------------------------------------------------------

MORE_DASHES: tuple[Any, ...] = ("-", (0, (4, 1.5)), (0, (1.4, 0.8)))
"""Of the curricula, when all of `OWN_COLOURS` are used up; scratch is black."""
CONTROL_DASHES: tuple[Any, ...] = (
    (0, (3, 1.5)),
    (0, (5, 1.2, 1, 1.2)),
    (0, (7, 2)),
    (0, (1.6, 1)),
    (0, (5, 1.2, 1, 1.2, 1, 1.2)),
    (0, (8, 1.5, 3, 1.5)),
)
GREY, GREYNESS = "#999999", 0.6  # the grey in a control's colour, and its share


@dataclass(frozen=True)
class ArmStyle:
    """How an arm is drawn."""

    short: str  # its name, of a control without that of its curriculum
    colour: str  # as #rrggbb
    dashes: Any  # line style of Matplotlib
    control: bool

    @property
    def svg_dashes(self) -> str:
        """The dashes as the ``stroke-dasharray`` of a line three wide; empty for a solid line."""
        return "" if self.dashes == "-" else " ".join(f"{2 * part:g}" for part in self.dashes[1])


def arm_styles(comparison: Comparison) -> dict[str, ArmStyle]:
    """Return how each arm is drawn; a control has the colour of its curriculum, greyer."""
    dashes_of_scratch = chain(["-"], cycle(CONTROL_DASHES))
    drawn = [name for name in comparison.drawn if name in comparison.scratches]
    styles = {
        name: ArmStyle(name, COLOURS["black"], dashes, False)
        for name, dashes in zip(drawn, dashes_of_scratch, strict=False)
    }
    parent, colour, controls = "", COLOURS["grey"], cycle(CONTROL_DASHES)
    looks = cycle(product(MORE_DASHES, OWN_COLOURS))
    for name, arm in comparison.arms.items():
        if arm.control:
            rgb = [to_rgb(GREY), to_rgb(colour)]
            greyer = to_hex(np.average(rgb, axis=0, weights=[GREYNESS, 1 - GREYNESS]).tolist())
            short = name.removeprefix(f"{parent}, ")
            styles[name] = ArmStyle(short, greyer, next(controls), True)
        elif name not in comparison.scratches:
            parent, controls, (dashes, key) = name, cycle(CONTROL_DASHES), next(looks)
            colour = COLOURS[key]
            styles[name] = ArmStyle(name, colour, dashes, False)
    return styles


# -- figures and the text around them --------------------------------------------------------------


class ShownFigure(Figure):
    """A figure that a notebook shows once by itself; it is not known to pyplot."""

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        """Return the picture, at twice the size that it is shown at."""
        content = io.BytesIO()
        with matplotlib.rc_context(STYLE):
            self.savefig(content, format="png", dpi=2 * SCREEN)
        width, height = self.get_size_inches() * SCREEN
        return content.getvalue(), {"width": round(width), "height": round(height)}


def new_figure(rows: int, columns: int, *, width: float, height: float) -> tuple[Figure, Any]:
    """Return a figure of `width` x `height` inches and its (rows, columns) array of axes.

    Examples
    --------
    >>> figure, axes = new_figure(1, 2, width=6, height=3)
    >>> axes.shape
    (1, 2)
    """
    figure = ShownFigure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def caption(figure: Figure, text: str) -> None:
    """Write sentences below a figure, in lines that fit its width."""
    figure.supxlabel(text, fontsize=8, x=0.01, ha="left", wrap=True)


def write_columns(axes: Axes, columns: Sequence[Sequence[str]]) -> None:
    """Write columns of text to the right of a panel: the head above it, entry r at y = r."""
    place: Any = {"textcoords": "offset points", "va": "center", "fontsize": 7.5}
    x = 6.0
    for head, *rows in columns:
        axes.annotate(head, (1, 1), (x, 8), xycoords="axes fraction", color="#555555", **place)
        for row, text in enumerate(rows):
            axes.annotate(text, (1, row), (x, 0), xycoords=("axes fraction", "data"), **place)
        x += 4.0 * max(len(text) for text in (head, *rows)) + 8


# -- axes of returns, which may span decades, and of steps -----------------------------------------

DECADES, MIXED = 1.2, 1.0
"""Decades between the absolute ends of an axis from which it is ``symlog``: where both ends have
the same sign, and where they have two."""
SMALLEST = 1e-3  # share of the largest absolute return below which an axis is linear in any case


def spell_out(axis: Axis, largest: float) -> None:
    """Write powers of ten at the ticks, where Matplotlib would print one over the label."""
    if largest and not 1e-4 <= largest < 1e6:
        axis.set_major_formatter(lambda x, _: minus(f"{x:,g}"))


def return_scale(axis: Axis, low: float, high: float, label: str = "return") -> None:
    """Scale and label an axis of returns, with a ``symlog`` scale where they span decades."""
    (small, large), axes = sorted([abs(low), abs(high)]), axis.axes
    small = max(small, SMALLEST * large)
    decades = math.log10(large / small) if large else 0.0
    # From an end that is 0, such as the lowest possible return, decades cannot be counted.
    logarithmic = bool(low * high != 0 and decades > (MIXED if low < 0 < high else DECADES))
    axis.set_label_text(label + "\n(symlog scale)" * logarithmic)
    name = "x" if axis is axes.xaxis else "y"
    set_scale, set_limits = (getattr(axes, f"set_{name}{part}") for part in ("scale", "lim"))
    if not logarithmic:
        margin = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
        set_limits(low - margin, high + margin)
        spell_out(axis, large)
        return
    set_scale("symlog", linthresh=small, linscale=0.5 if low < 0 < high else 0.2)
    # Round numbers, 0 if it is among them, at most nine.
    most = math.ceil(math.log10(max(abs(low), abs(high))))
    least = small / 2 if low < 0 < high else small * 0.999
    lowest = math.floor(math.log10(least))
    for leading in ((1, 2, 5), (1, 3), (1,)):
        sizes = [digit * 10.0**power for power in range(lowest, most + 1) for digit in leading]
        both = [sign * size for sign in (-1, 1) for size in sizes if size >= least]
        ticks = sorted(x for x in [*both, 0.0] if low <= x <= high)
        if len(ticks) <= 9:
            break
    axis.set_ticks(ticks)
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda x, _: minus(f"{x:,g}")))
    # The margin is a share of the drawn length, not of the numbers.
    transform = axis.get_transform()
    ends = transform.transform(np.array([low, high]))
    margin = 0.05 * (ends[1] - ends[0]) * np.array([-1.0, 1.0])
    set_limits(*transform.inverted().transform(ends + margin))


def steps_scale(axes: Axes, last: int, label: str = "steps") -> None:
    """Scale and label the horizontal axis from step 0 to the `last`, in a round unit."""
    units = ((10**6, " (millions)"), (1000, " (thousands)"), (1, ""))
    unit, name = next(pair for pair in units if last >= 5 * pair[0] or pair[0] == 1)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x / unit:,g}"))
    axes.set(xlim=(0, last), xlabel=label + name)
