"""The exceptions Curricle raises.

::

    CurricleError
    ├── TaskError        a task that is no valid MDP, map or game        (also ValueError)
    ├── SettingError     an invalid setting of a learner, budget, metric (also ValueError)
    ├── PotentialError   a potential of the wrong shape or not finite    (also ValueError)
    ├── MappingError     a mapping between tasks that does not fit them  (also ValueError)
    ├── CurriculumError  a graph with a cycle or an unknown task         (also ValueError)
    ├── ConfigError      a study file that cannot be understood          (also ValueError)
    ├── StoreError       a results folder that cannot be used
    │   └── LostStoreError  a results folder that was lost during the run
    └── StudyError       a study's own code, or an executor, that failed
        └── EngineError  a cluster that was lost, or has other versions (also BrokenExecutor)

Every message is one sentence: the rule, the value that broke it, and the place. ForeignError is no
CurricleError: it describes an exception of a user's code that cannot be raised or sent as it is.
"""

import re
import sysconfig
from concurrent.futures import BrokenExecutor
from os import sep
from pathlib import Path
from traceback import walk_tb

LONGEST, SHOWN_END = 1500, 400  # characters of a sentence, and of its end: the way out
RAISED = "raised in "  # begins the note on where a user's code raised an error
MOST_LINES = 20  # mistakes in a study file that are listed
OWN_MODULE = re.compile(r"\bcurricle_study_[0-9a-f]{16}\.")  # the package of a study's modules
PASSWORD = re.compile(r"(?<=:)/+[^/\s@]+@")  # user and password, which stand before a URL's host


def _sentence(text: str) -> str:
    """Return a text on one line, cut in the middle where it is long, without passwords."""
    line = OWN_MODULE.sub("", PASSWORD.sub("//...@", " ".join(text.splitlines())))
    if len(line) <= LONGEST:
        return line
    return f"{line[: LONGEST - SHOWN_END - 7]} [...] {line[-SHOWN_END:]}"


class CurricleError(Exception):
    """Base of everything Curricle raises on purpose; its message is one sentence."""

    def __init__(self, *args: object):
        super().__init__(*(_sentence(arg) if isinstance(arg, str) else arg for arg in args))


class TaskError(CurricleError, ValueError):
    """A task is not a valid MDP, map or game."""


class SettingError(CurricleError, ValueError):
    """A setting of a learner, a budget, seeds, checkpoints or a metric is invalid."""


class PotentialError(CurricleError, ValueError):
    """A potential has the wrong shape or a value that is not finite."""


class MappingError(CurricleError, ValueError):
    """A mapping between two tasks does not fit them."""


class CurriculumError(CurricleError, ValueError):
    """A curriculum graph has a cycle, an unknown task or a malformed transfer."""


class ConfigError(CurricleError, ValueError):
    """A study file has mistakes; the message has a line for each of them."""

    def __init__(self, *args: object):
        lines = str(args[0]).splitlines() if args else []
        if (more := len(lines) - MOST_LINES) > 0:
            lines[MOST_LINES:] = [f"and {more:,} more"]
        Exception.__init__(self, "\n".join(map(_sentence, lines)), *args[1:])


class StoreError(CurricleError):
    """A results folder cannot be used for this run."""


class LostStoreError(StoreError):
    """A run's results folder can no longer be read or written."""


class StudyError(CurricleError):
    """A unit of a study failed; its cause is the exception, or a ForeignError that describes it."""


class EngineError(StudyError, BrokenExecutor):
    """A cluster that trains a study's units was lost, or a worker has other versions."""


class ForeignError(RuntimeError):
    """An error of a user's code, in words; its cause, or a note, has the traceback."""


def reason(error: Exception) -> str:
    """Return why a file cannot be used, on one line."""
    return getattr(error, "strerror", None) or " ".join(str(error).split())


def in_words(error: BaseException) -> str:
    """Return an error's message; of one of foreign code its type, and where it was raised."""
    if isinstance(error, CurricleError | ForeignError):
        return str(error)
    try:
        text = OWN_MODULE.sub("", f": {error}") if str(error) else ""
    except Exception:  # of the user's class
        text = ", which has no text"
    notes = getattr(error, "__notes__", ())
    place = next((note for note in notes if note.startswith(RAISED)), "") or place_of(error)
    return f"{type(error).__name__}{text}" + f" ({place})" * bool(place)


def place_of(error: BaseException) -> str:
    """Return the file, line and function of a user's code that raised an error; "" if none did."""
    not_users = str(Path(__file__).parent) + sep, sysconfig.get_path("stdlib") + sep, "<"
    place = ""
    for frame, line in walk_tb(error.__traceback__):
        code, path = frame.f_code, Path(frame.f_code.co_filename)
        installed = {"site-packages", "dist-packages"} & {*path.parts}
        compiled = code.co_filename.endswith(".pyx")  # a path without its site-packages
        if not (installed or compiled or code.co_filename.startswith(not_users)):
            place = f"{RAISED}{code.co_name} of {path.name}, line {line}"
    return place


def note_place(error: BaseException, doing: str = "") -> None:
    """Note where a user's code raised an error, and what for, for :func:`in_words`."""
    if (place := place_of(error)) and not isinstance(error, CurricleError):
        error.add_note(place + doing)
