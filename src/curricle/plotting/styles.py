"""One style for all figures: colours, Matplotlib's settings, styles of arms, text around axes."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure

from curricle.comparison.comparison import Comparison
from curricle.display import COLOURS as PALETTE, OWN_COLOURS as OWN_COLOURS
from curricle.statistics.curves import SCRATCH

COLOURS = PALETTE
"""The palette of Okabe and Ito, which colour-blind readers can tell apart: name -> colour."""
STYLE: Any = {
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "savefig.dpi": 150,
    # Names are the user's text: a dollar in one begins no formula.
    "text.parse_math": False,
    # Without it an SVG differs from run to run.
    "svg.hashsalt": "curricle",
}
"""Matplotlib's settings for these pictures, for ``matplotlib.rc_context``."""
DIVERGING, SEQUENTIAL = "PuOr", "cividis"
"""Colour maps that colour-blind readers can read."""
SHADES = 64
"""Colours of a map on a page."""
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
SCREEN = 72
"""Pixels of an inch in a notebook."""
GREY, GREYNESS = "#999999", 0.6
"""The grey in a control's colour, and its share."""


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
    """Return how each arm is drawn; a control has the colour of the curriculum before it, greyer.

    Learners from scratch are black, those beside the target's own dashed.
    """
    styles = {SCRATCH: ArmStyle(SCRATCH, COLOURS["black"], "-", False)}
    parent, place, own, controls = "", -1, COLOURS["grey"], 0
    for number, name in enumerate(comparison.scratches[1:]):
        dashes = CONTROL_DASHES[number % len(CONTROL_DASHES)]
        styles[name] = ArmStyle(name, COLOURS["black"], dashes, False)
    for name, arm in comparison.arms.items():
        if name in comparison.scratches:
            continue
        if arm.control:
            dashes = CONTROL_DASHES[controls % len(CONTROL_DASHES)]
            short = name.removeprefix(f"{parent}, ")
            styles[name] = ArmStyle(short, _greyed(own), dashes, True)
            controls += 1
        else:
            parent, place, controls = name, place + 1, 0
            again, colour = divmod(place, len(OWN_COLOURS))
            own = COLOURS[OWN_COLOURS[colour]]
            styles[name] = ArmStyle(name, own, MORE_DASHES[again % len(MORE_DASHES)], False)
    return styles


def shades_of(palette: str) -> list[str]:
    """Return a colour map as `SHADES` colours, ``#rrggbb``, from low to high."""
    return [to_hex(one) for one in matplotlib.colormaps[palette](np.linspace(0, 1, SHADES))]


class ShownFigure(Figure):
    """A figure that a notebook shows by itself, once, whether pyplot is imported or not.

    pyplot knows nothing of it, so that nothing has to be closed.
    """

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
    left = 6.0
    for head, *rows in columns:
        axes.annotate(head, (1, 1), (left, 8), xycoords="axes fraction", color="#555555", **place)
        for row, text in enumerate(rows):
            axes.annotate(text, (1, row), (left, 0), xycoords=("axes fraction", "data"), **place)
        left += 4.0 * max(len(text) for text in (head, *rows)) + 8


def _greyed(colour: str) -> str:
    mixed = np.average([to_rgb(GREY), to_rgb(colour)], axis=0, weights=[GREYNESS, 1 - GREYNESS])
    return to_hex(tuple(mixed.tolist()))
