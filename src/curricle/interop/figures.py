"""Figures in the cells of a grid, made of simple shapes and painted at any size.

They differ in shape as well as in colour, and most colours are Okabe and Ito's, so that
colour-blind readers can tell them apart.
"""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from curricle.tasks.spaces import frozen

FINER = 4
"""Figures are drawn this many times larger and then reduced, which smooths their edges."""
FLOOR, DARK, INK = "#f7f5f0", "#4d5366", "#22242c"

Shape = tuple[Callable[..., None], tuple[float, ...], str]
"""The method that draws it, its coordinates in a cell of side 1, and its colour."""
OVAL, BLOCK = ImageDraw.ImageDraw.ellipse, ImageDraw.ImageDraw.rectangle
POLYGON = ImageDraw.ImageDraw.polygon


class Figure(NamedTuple):
    """Shapes, the later ones on top, and a number written over them."""

    shapes: tuple[Shape, ...]
    number: str = ""


def _flame(middle: float, width: float, top: float, bottom: float) -> tuple[float, ...]:
    """Return an outline that is pointed above and round below."""
    t = np.linspace(0, 2 * np.pi, 60)
    x = middle + 0.6 * width * np.sin(t) * np.sin(t / 2) ** 1.6
    y = (top + bottom) / 2 - (bottom - top) / 2 * np.cos(t)
    return tuple(np.stack([x, y], axis=1).ravel().tolist())


WALL = Figure(
    (
        (BLOCK, (0, 0, 1, 1), DARK),
        *((BLOCK, (0, y, 1, y + 0.03), "#6b7288") for y in (0.31, 0.64, 0.97)),
        *((BLOCK, (x, 0.00, x + 0.03, 0.31), "#6b7288") for x in (0.22, 0.72)),
        *((BLOCK, (x, 0.34, x + 0.03, 0.64), "#6b7288") for x in (0.47, 0.97)),
        *((BLOCK, (x, 0.67, x + 0.03, 0.97), "#6b7288") for x in (0.22, 0.72)),
    )
)
START = Figure(
    ((OVAL, (0.18, 0.18, 0.82, 0.82), "#c9c4b4"), (OVAL, (0.24, 0.24, 0.76, 0.76), FLOOR))
)
PIT = Figure(
    (
        (OVAL, (0.06, 0.14, 0.94, 0.90), "#b3ad9a"),
        (OVAL, (0.12, 0.20, 0.88, 0.87), DARK),
        (OVAL, (0.16, 0.32, 0.84, 0.87), "#000000"),
    )
)
FIRE = Figure(
    (
        (POLYGON, _flame(0.32, 0.40, 0.34, 0.90), "#D55E00"),
        (POLYGON, _flame(0.68, 0.40, 0.28, 0.90), "#D55E00"),
        (POLYGON, _flame(0.50, 0.62, 0.06, 0.94), "#D55E00"),
        (POLYGON, _flame(0.50, 0.36, 0.40, 0.92), "#F0E442"),
    )
)
TREASURE = Figure(
    (
        (OVAL, (0.12, 0.18, 0.88, 0.76), "#7a4f00"),
        (BLOCK, (0.12, 0.46, 0.88, 0.84), "#7a4f00"),
        (OVAL, (0.17, 0.23, 0.83, 0.70), "#E69F00"),
        (BLOCK, (0.17, 0.53, 0.83, 0.79), "#E69F00"),
        (BLOCK, (0.12, 0.44, 0.88, 0.52), "#7a4f00"),
        (BLOCK, (0.41, 0.40, 0.59, 0.64), "#F0E442"),
        (BLOCK, (0.47, 0.47, 0.53, 0.58), INK),
    )
)
AGENT = Figure(
    (
        (OVAL, (0.08, 0.08, 0.92, 0.92), "#ffffff"),
        (OVAL, (0.12, 0.12, 0.88, 0.88), "#0072B2"),
        *((OVAL, (x, 0.32, x + 0.20, 0.58), "#ffffff") for x in (0.27, 0.53)),
        *((OVAL, (x, 0.40, x + 0.11, 0.54), INK) for x in (0.33, 0.57)),
    )
)
PREY = Figure(
    (
        *((OVAL, (x, 0.08, x + 0.38, 0.46), "#7a4f00") for x in (0.04, 0.58)),
        *((OVAL, (x, 0.16, x + 0.22, 0.38), "#f3cfa0") for x in (0.12, 0.66)),
        (OVAL, (0.12, 0.20, 0.88, 0.92), "#E69F00"),
        *((OVAL, (x, 0.44, x + 0.11, 0.59), INK) for x in (0.31, 0.58)),
        (OVAL, (0.43, 0.66, 0.57, 0.77), "#7a4f00"),
    )
)
OBJECTS = {"#": WALL, "P": PIT, "F": FIRE, "T": TREASURE}
ASIDE = Figure(
    tuple(
        (method, tuple(0.44 + 0.56 * v for v in at), colour) for method, at, colour in AGENT.shapes
    )
)
"""The agent, drawn small, in a cell with an object."""
COATS = ("#0072B2", "#00785A", "#B34700", "#8E4C7A", "#444444", "#2B6E96")


def predator(number: int) -> Figure:
    """Return a round head with pointed ears, and its number in white."""
    coat = COATS[(number - 1) % len(COATS)]
    ears = (0.08, 0.04, 0.46, 0.24, 0.12, 0.56), (0.92, 0.04, 0.54, 0.24, 0.88, 0.56)
    head = (OVAL, (0.08, 0.16, 0.92, 0.96), coat)
    return Figure((*((POLYGON, ear, coat) for ear in ears), head), str(number))


@cache
def painted(figure: Figure, side: int) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return a figure's colours, (side, side, 3), and its transparency, (side, side, 1)."""
    large = side * FINER
    image = Image.new("RGBA", (large, large))
    draw = ImageDraw.Draw(image)
    for method, coordinates, colour in figure.shapes:
        method(draw, [large * value for value in coordinates], fill=colour)
    if figure.number:
        font = ImageFont.load_default(0.52 * large / max(1, len(figure.number) - 0.5))
        middle = (0.5 * large, 0.57 * large)
        draw.text(middle, figure.number, "#ffffff", font, anchor="mm", stroke_width=0.02 * large)
    pixels = np.asarray(image.resize((side, side), Image.Resampling.LANCZOS), dtype=np.float32)
    opaque = pixels[..., 3:] / np.float32(255)
    return frozen(pixels[..., :3] * opaque), frozen(1 - opaque)
