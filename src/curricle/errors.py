"""The exceptions Curricle raises.

::

    CurricleError
    ├── TaskError        a task that is not a valid MDP, map or game     (also ValueError)
    ├── SettingError     a learner, budget or metric asked for nonsense  (also ValueError)
    ├── PotentialError   a potential of the wrong shape or not finite    (also ValueError)
    ├── MappingError     a mapping between tasks that does not fit them  (also ValueError)
    ├── CalibrationError rollouts that cannot tell what a potential is worth
    ├── CurriculumError  a graph with a cycle or an unknown task         (also ValueError)
    ├── ConfigError      a study file that cannot be understood          (also ValueError)
    ├── StoreError       a results folder that cannot be used
    │   └── LostStoreError  one that could be used when the run began
    └── StudyError       a study's own code, or an executor, that failed
        └── EngineError  a cluster that was lost, or has other versions (also BrokenExecutor)

Every message is one sentence: the rule, the value that broke it, and the place. ForeignError stands
apart: it is what a study's own code raised in another process, where its own class cannot be sent.
"""

import re
from concurrent.futures import BrokenExecutor

LONGEST, SHOWN_END = 1500, 400
"""Characters of a sentence, and how many of them are its end, which says the way out."""
MOST_LINES = 100
"""Mistakes in a study file that are listed."""
PASSWORD = re.compile(r"(?<=:)/+[^/\s@]+@")
"""What comes before a URL's host."""


def _sentence(text: str) -> str:
    """Return a text on one line, cut in the middle where it is long, without passwords."""
    line = PASSWORD.sub("//...@", " ".join(text.splitlines()))
    cut = f"{line[: LONGEST - SHOWN_END - 7]} [...] {line[-SHOWN_END:]}"
    return line if len(line) <= LONGEST else cut


class CurricleError(Exception):
    """Base of everything Curricle raises on purpose; its message is one sentence."""

    def __init__(self, *args: object):
        super().__init__(*(_sentence(one) if isinstance(one, str) else one for one in args))


class TaskError(CurricleError, ValueError):
    """A task is not a valid MDP, map or game."""


class SettingError(CurricleError, ValueError):
    """A learner, a budget, seeds, checkpoints or a metric make no sense."""


class PotentialError(CurricleError, ValueError):
    """A potential has the wrong shape or a value that is not finite."""


class MappingError(CurricleError, ValueError):
    """A mapping between two tasks does not fit them."""


class CalibrationError(CurricleError):
    """A potential cannot be calibrated: what its policy met carries no information."""


class CurriculumError(CurricleError, ValueError):
    """A curriculum graph has a cycle, an unknown task or a malformed transfer."""


class ConfigError(CurricleError, ValueError):
    """A study file cannot be understood; a line for each thing that is wrong with it."""

    def __init__(self, *args: object):
        lines = str(args[0]).splitlines() if args else []
        if (more := len(lines) - MOST_LINES) > 0:
            lines[MOST_LINES:] = [f"and {more:,} more"]
        Exception.__init__(self, "\n".join(map(_sentence, lines)), *args[1:])


class StoreError(CurricleError):
    """A results folder cannot be used for this run."""


class LostStoreError(StoreError):
    """The place of a run's results cannot be read or written any more, as it could at first."""


class StudyError(CurricleError):
    """A unit of a study failed; its cause is the exception that the study's own code raised.

    It is a ForeignError where another process raised one that cannot be sent.
    """


class EngineError(StudyError, BrokenExecutor):
    """A cluster that trains a study's units was lost, or a worker of it has other versions."""


class ForeignError(RuntimeError):
    """What a study's own code raised in another process, in words; a note has the traceback."""


def reason(error: OSError) -> str:
    """Return why a file cannot be used, in a line."""
    return error.strerror or " ".join(str(error).split())


def in_words(error: BaseException) -> str:
    """Return an error as words, with its type unless it is the library's own."""
    if isinstance(error, CurricleError | ForeignError):
        return str(error)
    return f"{type(error).__name__}: {error}"
