"""The figure of a comparison or a forecast, and figures as files."""

import io
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from curricle.comparison.comparison import Comparison
from curricle.comparison.forecasts import Forecast
from curricle.errors import SettingError
from curricle.files import write_whole
from curricle.plotting.comparison import draw_comparison
from curricle.plotting.forecast import draw_forecast
from curricle.plotting.styles import STYLE

METADATA: dict[str, dict[str, Any]] = {
    ".png": {},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None},
}
"""Ending -> metadata. Without a date the same results give the same file."""


def plot(subject: Comparison | Forecast, path: str | Path | None = None) -> Figure:
    """Return the figure of a comparison or a forecast, and write it to a file if a path is given.

    Parameters
    ----------
    subject : Comparison or Forecast
        From :func:`compare` or :func:`forecast`.
    path : str or Path, optional
        Ending in .png, .svg or .pdf, in a folder that exists. An existing file is replaced only
        when the new one is complete.

    Raises
    ------
    SettingError
        When the subject or the file's ending is another, or the file cannot be written.

    Examples
    --------
    >>> from curricle import Curriculum, GridWorld, Transfer, compare, same_position
    >>> maze = GridWorld(["....T", ".PPP.", "S...."])
    >>> corner = maze.crop(rows=(0, 2), columns=(2, 5))
    >>> plan = Curriculum(
    ...     tasks={"corner": corner, "maze": maze},
    ...     transfers=[Transfer("corner", "maze", same_position(maze, corner))],
    ...     budget={"corner": 500, "maze": 2000})
    >>> figure = plot(compare(plan, seeds=3))
    >>> len(figure.axes)
    3
    """
    if path is not None:
        check_path(path)
    if isinstance(subject, Comparison):
        figure = draw_comparison(subject)
    elif isinstance(subject, Forecast):
        figure = draw_forecast(subject)
    else:
        raise SettingError(f"what is plotted must be a Comparison or a Forecast: got {subject!r}")
    if path is not None:
        save(figure, path)
    return figure


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure to a file, as :func:`plot` does; the same bytes every time.

    Raises
    ------
    SettingError
        When the path is none for a picture, or the file cannot be written.

    Examples
    --------
    >>> save(Figure(), "picture.bmp")
    Traceback (most recent call last):
    curricle.errors.SettingError: a picture's file must end in .png, .svg, .pdf: got picture.bmp
    """
    place = check_path(path)
    try:
        write_whole(place, content_of(figure, place.suffix.lower()))
    except OSError as error:
        raise SettingError(f"a picture cannot be written to {place} ({error.strerror})") from error


def content_of(figure: Figure, ending: str) -> bytes:
    """Return the content of a figure's file that ends in .png, .svg or .pdf, the same every time.

    Examples
    --------
    >>> content_of(Figure(), ".png")[1:4]
    b'PNG'
    """
    content = io.BytesIO()
    with matplotlib.rc_context(STYLE):
        figure.savefig(content, format=ending[1:], metadata=METADATA[ending])
    return content.getvalue()


def check_path(path: str | Path) -> Path:
    """Return the path of a picture, or raise SettingError if none can be written there."""
    if not isinstance(path, str | Path):
        raise SettingError(f"a picture's file must be a path: got {path!r}")
    place = Path(path)
    if place.suffix.lower() not in METADATA:
        raise SettingError(f"a picture's file must end in {', '.join(METADATA)}: got {place}")
    if place.is_dir() or not place.parent.is_dir():
        raise SettingError(f"a picture needs a file in a folder that exists: got {place}")
    return place
