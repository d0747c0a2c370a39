"""Axes: of returns, which may reach over decades; of steps; and the words below a figure."""

import math

import numpy as np
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import text_to_path
from matplotlib.ticker import FuncFormatter, NullLocator

DECADES = 1.2
"""Decades between the largest and the smallest size of returns from which an axis is bent."""
MIXED = 1.0
"""The same where returns have both signs."""
SMALLEST = 1e-3
"""Share of the largest size below which an axis is straight in any case."""
CAPTION_SIZE = 8.0


def caption(figure: Figure, text: str) -> None:
    """Write sentences below a figure, broken into lines that fit its width."""
    most = 0.97 * 72 * figure.get_figwidth()
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and _width(longer) > most:
            lines.append(word)
        else:
            lines[-1] = longer
    figure.supxlabel("\n".join(lines), fontsize=CAPTION_SIZE, x=0.01, ha="left")


def minus(number: str) -> str:
    """Return a number that was printed with a sign that is not a hyphen.

    Examples
    --------
    >>> minus("-1.5")
    '−1.5'
    """
    return number.replace("-", "−")


def rounded(number: float) -> str:
    """Return a number in three significant digits, or all before the point.

    Examples
    --------
    >>> rounded(-3215.4), rounded(0.12345)
    ('−3,215', '0.123')
    """
    return minus(f"{number:,.0f}" if abs(number) >= 100 else f"{number:.3g}")


def return_scale(axis: Axis, low: float, high: float) -> None:
    """Scale an axis of returns between `low` and `high`: bent where they span decades.

    A bent axis is linear up to the smaller of the two bounds' sizes, then logarithmic
    (``symlog``). It is chosen from 1.2 decades between these sizes on where both bounds have one
    sign, from one decade on where they do not.

    Parameters
    ----------
    axis : Axis
        As ``axes.xaxis``.
    low, high : float
        Return.

    Examples
    --------
    >>> axes = Figure().subplots()
    >>> return_scale(axes.yaxis, -900.0, -5.0)
    >>> axes.get_yscale(), axes.get_yticks().tolist()
    ('symlog', [-500.0, -200.0, -100.0, -50.0, -20.0, -10.0, -5.0])
    >>> return_scale(axes.xaxis, -60.0, -5.0)
    >>> axes.get_xscale()
    'linear'
    """
    small = _bend(low, high)
    axes = axis.axes
    name = "x" if axis is axes.xaxis else "y"
    set_scale, set_limits = (getattr(axes, f"set_{name}{what}") for what in ("scale", "lim"))
    if math.isnan(small):
        room = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
        set_limits(low - room, high + room)
        return
    set_scale("symlog", linthresh=small, linscale=0.5 if low < 0 < high else 0.2)
    axis.set_ticks(_round_numbers(low, high, small))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda x, _: minus(f"{x:,g}")))
    # Room is a share of what is drawn, not of the numbers.
    bent = axis.get_transform()
    ends = bent.transform(np.array([low, high]))
    room = 0.05 * (ends[1] - ends[0]) * np.array([-1.0, 1.0])
    set_limits(*bent.inverted().transform(ends + room))


def steps_scale(axis: Axis, most: float) -> str:
    """Write an axis of steps in a round unit, and return that unit's name for its label.

    Examples
    --------
    >>> axes = Figure().subplots()
    >>> steps_scale(axes.xaxis, 250_000)
    'thousands'
    """
    unit, name = next(
        (unit, name)
        for unit, name in ((10**6, "millions"), (1000, "thousands"), (1, ""))
        if most >= 5 * unit or unit == 1
    )
    axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x / unit:,g}"))
    return name


def _width(text: str) -> float:
    """Return how wide a line of a caption is, in points."""
    font = FontProperties(size=CAPTION_SIZE)
    return float(text_to_path.get_text_width_height_descent(text, font, ismath=False)[0])


def _bend(low: float, high: float) -> float:
    """Return up to which size an axis is to be linear; NaN if everywhere."""
    large, small = max(abs(low), abs(high)), min(abs(low), abs(high))
    if large == small:
        return math.nan
    small = max(small, SMALLEST * large)
    bent = math.log10(large / small) > (MIXED if low < 0 < high else DECADES)
    return small if bent else math.nan


def _round_numbers(low: float, high: float, small: float) -> list[float]:
    """Return round numbers from `low` to `high`, 0 if it is among them, at most nine."""
    most = math.ceil(math.log10(max(abs(low), abs(high))))
    least = small / 2 if low < 0 < high else small * 0.999
    lowest = math.floor(math.log10(least))
    for leading in ((1, 2, 5), (1, 3), (1,)):
        sizes = [digit * 10.0**power for power in range(lowest, most + 1) for digit in leading]
        both = [sign * size for sign in (-1, 1) for size in sizes if size >= least]
        found = sorted(x for x in [*both, 0.0] if low <= x <= high)
        if len(found) <= 9:
            break
    return found
