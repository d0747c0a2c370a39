"""Axes of returns, which may span decades, and of steps; numbers in text."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.ticker import FuncFormatter, NullLocator

from curricle.statistics.intervals import Interval

DECADES, MIXED = 1.2, 1.0
"""Decades between the absolute ends of an axis from which it is ``symlog``: where both ends have
one sign, and where they have two."""
SMALLEST = 1e-3
"""Share of the largest absolute return below which an axis is linear in any case."""


def minus(number: str) -> str:
    """Return a printed number with a minus sign in place of the hyphen."""
    return number.replace("-", "−")


def rounded(number: float) -> str:
    """Return a number in three significant digits, trailing zeros too, or as a whole number."""
    if number == 0:
        return "0"
    return minus(f"{number:,.0f}" if abs(number) >= 99.95 else f"{number:#.3g}")


def without_seeds(interval: Interval) -> str:
    """Return an interval as text, without its number of seeds."""
    return minus(str(interval).rsplit(",", 1)[0])


def return_scale(axis: Axis, low: float, high: float, label: str = "return") -> None:
    """Scale and label an axis of returns, with a ``symlog`` scale where they span decades.

    A ``symlog`` axis is linear up to the smaller absolute end, then logarithmic.
    """
    small, axes = _linear_up_to(low, high), axis.axes
    axis.set_label_text(label + " (symlog scale)" * (not math.isnan(small)))
    name = "x" if axis is axes.xaxis else "y"
    set_scale, set_limits = (getattr(axes, f"set_{name}{what}") for what in ("scale", "lim"))
    if math.isnan(small):
        margin = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
        set_limits(low - margin, high + margin)
        return
    set_scale("symlog", linthresh=small, linscale=0.5 if low < 0 < high else 0.2)
    axis.set_ticks(_round_numbers(low, high, small))
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
    unit, words = next(one for one in units if last >= 5 * one[0] or one[0] == 1)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x / unit:,g}"))
    axes.set(xlim=(0, last), xlabel=label + words)


def _linear_up_to(low: float, high: float) -> float:
    """Return the absolute return up to which an axis is linear; NaN if everywhere."""
    large, small = max(abs(low), abs(high)), min(abs(low), abs(high))
    if large == small:
        return math.nan
    small = max(small, SMALLEST * large)
    logarithmic = math.log10(large / small) > (MIXED if low < 0 < high else DECADES)
    return small if logarithmic else math.nan


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
