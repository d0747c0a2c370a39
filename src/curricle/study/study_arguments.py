"""Functions of curricula that take a study too, or the path of its file."""

from collections.abc import Callable
from functools import wraps
from inspect import signature
from os import PathLike
from typing import Any, Concatenate, ParamSpec, TypeVar

from curricle.checks import listed
from curricle.comparison.comparing import compare as compare_curricula
from curricle.comparison.forecasting import forecast as forecast_curriculum
from curricle.errors import ConfigError, SettingError
from curricle.study.config.reading import read_study
from curricle.study.config.study_config import StudyConfig
from curricle.study.config.tables import built

Study = StudyConfig | str | PathLike[str]
"""A study, or the path of its file."""
FORECAST_SEEDS = 3
"""Seeds of a study that a forecast takes, as many as it takes of a curriculum."""
Subject = TypeVar("Subject")
Rest = ParamSpec("Rest")
Result = TypeVar("Result")


def study_of(given: Study) -> StudyConfig:
    """Return a study as it is, or the one that a file describes.

    ConfigError says all that is wrong in the file; SettingError that it is neither a study nor a
    path.
    """
    if isinstance(given, StudyConfig):
        return given
    if not isinstance(given, str | PathLike):
        raise SettingError(f"study must be a StudyConfig or the path of a file: got {given!r}")
    return read_study(given)


def _of_studies(
    function: Callable[Concatenate[Subject, Rest], Result],
    arguments: Callable[[StudyConfig], tuple[Subject, dict[str, Any]]],
) -> Callable[Concatenate[Subject | Study, Rest], Result]:
    """Return a function that takes a study in the place of curricula.

    `arguments` returns a study's curricula, and what it says of other arguments.
    """
    first = next(iter(signature(function).parameters))

    @wraps(function)
    def of_either(*args: Any, **settings: Any) -> Any:
        if first in settings:
            args = (settings.pop(first), *args)
        if args and isinstance(args[0], StudyConfig | str | PathLike):
            subject, said = arguments(study_of(args[0]))
            args, settings = (subject, *args[1:]), {**said, **settings}
        return function(*args, **settings)

    return of_either


def _compared(study: StudyConfig) -> tuple[Any, dict[str, Any]]:
    scratch = {name: built(one, study.folder) for name, one in study.scratch_learners.items()}
    settings = {"seeds": study.seeds, "threshold": study.threshold, "window": study.window}
    return study.curricula, {**settings, "scratch": scratch, "controls": study.controls or ()}


def _foreseen(study: StudyConfig) -> tuple[Any, dict[str, Any]]:
    arm, *others = study.arms
    if others:
        raise ConfigError(
            "a forecast is of one arm: give forecast(study.curriculum(ARM)), where study is "
            f"read_study(FILE) and ARM one of {listed(study.arms)}"
        )
    said = {"seeds": study.seeds[:FORECAST_SEEDS], "threshold": study.threshold}
    return study.curriculum(arm), said


compare = _of_studies(compare_curricula, _compared)
forecast = _of_studies(forecast_curriculum, _foreseen)
