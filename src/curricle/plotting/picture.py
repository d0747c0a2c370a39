"""The figure of what was found, and figures as files."""

import io
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from curricle.checks import brief, numbers
from curricle.comparison.comparison import Comparison
from curricle.comparison.forecasting import Forecast
from curricle.curriculum.result import CurriculumResult
from curricle.errors import SettingError
from curricle.files import write_whole
from curricle.learning.result import LearningResult
from curricle.plotting.forecast import draw_forecast
from curricle.plotting.grids import draw_potential
from curricle.plotting.learning_curves import draw_comparison, draw_results
from curricle.plotting.styles import STYLE, new_figure

METADATA: dict[str, dict[str, Any]] = {
    ".png": {},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None},
}
"""Ending -> metadata. Without a date the same results give the same file."""


def plot(subject: Any, path: str | Path | None = None, *, task: Any = None) -> Figure:
    """Return the figure of what was found, and write it to a file if a path is given.

    Parameters
    ----------
    subject : Comparison, Forecast, StudyResults, LearningResult, CurriculumResult or array
        Of a comparison, a study or a trial: curves, profiles and gains of the arms. Of a forecast
        its rows. Of what was learnt its learning curve, of a curriculum those of its last tasks.
        Of values, (S,) or (S, A) float64, the best of each state as a heat map of their `task`.
    path : str or Path, optional
        Ending in .png, .svg or .pdf, in a folder that exists. An existing file is replaced only
        when the new one is complete.
    task : Task, optional
        Of an array of values: one whose states lie on a grid, as in :func:`draw_potential`.

    Raises
    ------
    SettingError
        When the subject or the file's ending is another, a task is given without values or the
        other way round, states do not lie on a grid, or the file cannot be written.
    StoreError, CurricleError
        As of ``StudyResults.comparison``, where a study cannot be compared.

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
    >>> plot(plan.train()["maze"].values[0], task=maze).axes[0].get_title()
    'max Q(s, a)'
    """
    if path is not None:
        check_path(path)
    figure = _drawn(subject) if task is None else _drawn_values(subject, task)
    if path is not None:
        save(figure, path)
    return figure


def _drawn(subject: Any) -> Figure:
    if isinstance(subject, Forecast):
        return draw_forecast(subject)
    if isinstance(subject, LearningResult):
        name = "learning" if subject.task is None else type(subject.task).__name__
        return draw_results({name: subject})
    if isinstance(subject, CurriculumResult) and subject.nodes:
        return draw_results(subject.nodes)
    compared = getattr(subject, "comparison", subject)  # of a study or a trial, or itself
    if isinstance(compared, Comparison):
        return draw_comparison(compared)
    known = "a Comparison, Forecast, StudyResults, LearningResult or CurriculumResult"
    raise SettingError(
        f"what is plotted must be {known}, or an array of values with its task: got "
        f"{brief(subject)}"
    )


@matplotlib.rc_context(STYLE)
def _drawn_values(values: Any, task: Any) -> Figure:
    """Return values of states, or the best of their actions, over a task's grid."""
    array = numbers("the values of a task", values, SettingError)
    figure, axes = new_figure(1, 1, width=5.5, height=4.2)
    label = "max Q(s, a)" if array.ndim == 2 else "V(s)"
    draw_potential(axes[0, 0], task, array, label=label)
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
