"""How the arms of a comparison look: one colour and one dash pattern each, in every picture."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.colors import to_hex, to_rgb

from curricle.comparison.comparison import Comparison
from curricle.plotting.figures import COLOURS
from curricle.statistics.curves import SCRATCH

OWN_COLOURS = ("blue", "vermillion", "green", "orange", "purple", "sky")
"""Of the curricula, in order; then again with other dashes. The direct learner is black."""
MORE_DASHES: tuple[Any, ...] = ("-", (0, (4, 1.5)), (0, (1.4, 0.8)))
CONTROL_DASHES: tuple[Any, ...] = (
    (0, (3, 1.5)),
    (0, (5, 1.2, 1, 1.2)),
    (0, (7, 2)),
    (0, (1.6, 1)),
    (0, (5, 1.2, 1, 1.2, 1, 1.2)),
    (0, (8, 1.5, 3, 1.5)),
)
GREYNESS = 0.6
"""How much of a control's colour is grey."""


@dataclass(frozen=True)
class Look:
    """How an arm is drawn.

    Attributes
    ----------
    short : str
        Its name below that of the curriculum it belongs to.
    colour : str
        As ``#rrggbb``.
    dashes : str or tuple
        Line style, as Matplotlib's.
    control : bool
    """

    short: str
    colour: str
    dashes: Any
    control: bool


def arm_looks(comparison: Comparison) -> dict[str, Look]:
    """Return how each arm looks; a control has the colour of the curriculum before it, greyer.

    Examples
    --------
    >>> from curricle.comparison.arms import Arm
    >>> from curricle.statistics.curves import Curve
    >>> flat = np.zeros((2, 2))
    >>> arm = Arm(Curve(np.array([0, 9]), flat), flat, flat, False)
    >>> looks = arm_looks(Comparison("hunt", {"scratch": arm, "taught": arm}, 9, 9, 0.0, 1))
    >>> looks["scratch"].colour, looks["taught"].colour
    ('#000000', '#0072B2')
    """
    looks = {SCRATCH: Look(SCRATCH, COLOURS["black"], "-", False)}
    parent, place, own, controls = "", -1, COLOURS["grey"], 0
    for name, arm in comparison.arms.items():
        if name == SCRATCH:
            continue
        if arm.control:
            dashes = CONTROL_DASHES[controls % len(CONTROL_DASHES)]
            short = name.removeprefix(f"{parent}, ")
            looks[name] = Look(short, _greyed(own), dashes, True)
            controls += 1
        else:
            parent, place, controls = name, place + 1, 0
            again, colour = divmod(place, len(OWN_COLOURS))
            own = COLOURS[OWN_COLOURS[colour]]
            looks[name] = Look(name, own, MORE_DASHES[again % len(MORE_DASHES)], False)
    return looks


def _greyed(colour: str) -> str:
    grey, own = np.array(to_rgb("#999999")), np.array(to_rgb(colour))
    mixed = GREYNESS * grey + (1 - GREYNESS) * own
    return to_hex((mixed[0], mixed[1], mixed[2]))
