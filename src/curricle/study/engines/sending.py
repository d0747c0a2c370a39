"""What a worker on another machine does: take the study's own modules, and train a unit."""

import atexit
import hashlib
import json
import pickle
import platform
import shutil
import traceback
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from importlib import metadata
from pathlib import Path
from tempfile import mkdtemp
from threading import Lock
from typing import Any, NamedTuple, TypeVar

from curricle.errors import CurricleError, EngineError, ForeignError, in_words
from curricle.files import remove_folder
from curricle.remote_path import Place
from curricle.study.config.tables import PACKAGES
from curricle.study.folders import lost_errors
from curricle.study.serialization import UnitResult
from curricle.study.store import StoredUnit, arrays_in, written_unit
from curricle.study.stored_values import StoredSource, stored_values
from curricle.study.units import UnitInput, train_unit

FOLDERS = dict[str, Path]()
"""The folders of modules that this process has written, by a digest of their files."""
WRITING, LIVE = Lock(), Lock()
Result = TypeVar("Result")


class SentUnit(NamedTuple):
    """A unit with all that a worker needs which has no folder of the study."""

    given: UnitInput
    files: Mapping[str, bytes]
    """The study's own modules, by path in its folder."""
    versions: Mapping[str, str]
    """Of the run: a worker that came later is compared with them too."""
    live: bool
    """Whether units must not run side by side in one process."""
    stored: Mapping[str, StoredSource] = {}
    """The sources that the worker reads itself."""
    place: Place | None = None
    """The study's folder, where the worker writes the result itself."""


def called(function: Callable[[Any], Result], argument: Any) -> Result:
    """Return what a function returns; what it raises can be read in another process.

    Errors of classes in the study's own modules, and those that do not survive pickling, become a
    ForeignError in the same words. A note has the traceback.

    Examples
    --------
    >>> class Slipped(Exception):
    ...     __module__ = "curricle_study_0f.rules"
    >>> def slip(place):
    ...     raise Slipped(f"off the map at {place}")
    >>> try:
    ...     called(slip, (3, 4))
    ... except ForeignError as error:
    ...     print(error)
    Slipped: off the map at (3, 4)
    """
    try:
        return function(argument)
    except Exception as error:
        found = _sendable(error)
    raise found  # out here it has no context, which some engines send too


def _sendable(error: Exception) -> Exception:
    """Return an error, or one in the same words that can be sent, without the errors before it."""
    told = "".join(traceback.format_exception(error))
    error.__cause__ = error.__context__ = error.__traceback__ = None
    if not _survives(error):
        kind: type[Exception] = ForeignError
        if isinstance(error, CurricleError):  # its class is the user's own, below one of ours
            ours = CurricleError.__module__
            kind = next(each for each in type(error).__mro__ if each.__module__ == ours)
        error = kind(in_words(error))
    error.add_note(told)
    return error


def _survives(error: Exception) -> bool:
    """Return whether a process without the study's own modules reads an error as it is."""
    try:
        content = pickle.dumps(error)
        again = pickle.loads(content)
    except Exception:  # whatever a class's own methods raise
        return False
    same = type(again) is type(error) and str(again) == str(error)
    return same and PACKAGES.encode() not in content


def train_apart(given: UnitInput) -> UnitResult:
    """Return what a unit's seeds learn; what it raises can be sent from this process."""
    return called(train_unit, given)


def train_sent(sent: SentUnit) -> UnitResult | StoredUnit:
    """Return what a unit's seeds learn, or the file that it is written to.

    EngineError where versions differ from those of the run; LostStoreError where sources cannot be
    read at the study's URL, or the result cannot be written there.
    """
    return called(_train_sent, sent)


def _train_sent(sent: SentUnit) -> UnitResult | StoredUnit:
    if differ := difference(sent.versions, versions_here()):
        raise EngineError(f"worker {platform.node()} has {differ}")
    folder = written(sent.files)
    unit = sent.given.unit
    with lost_errors():
        read = {
            name: stored_values(arrays_in, one.units, unit.seeds, read=one.read)
            for name, one in sent.stored.items()
        }
    given = sent.given._replace(folder=str(folder), sources={**sent.given.sources, **read})
    with LIVE if sent.live else nullcontext():
        result = train_unit(given)
    if sent.place is None:
        return result
    with lost_errors():
        stored = written_unit(sent.place, unit, result)
    if given.checkpoints is not None:
        remove_folder(given.checkpoints)
    return stored


def versions_here() -> dict[str, str]:
    """Return the versions that must be equal everywhere.

    Of Python these are the first two numbers: the third changes no result.

    Examples
    --------
    >>> sorted(versions_here())
    ['Python', 'curricle', 'numba']
    """
    found = {name: metadata.version(name) for name in ("curricle", "numba")}
    return {**found, "Python": ".".join(platform.python_version_tuple()[:2])}


def difference(here: Mapping[str, str], there: Mapping[str, str]) -> str:
    """Return how versions differ, in words; nothing if they are equal.

    Examples
    --------
    >>> difference({"numba": "0.68.1"}, {"numba": "0.67.0"})
    'numba 0.67.0 and the run has 0.68.1'
    """
    each = [
        f"{k} {there.get(k)} and the run has {here[k]}" for k in here if there.get(k) != here[k]
    ]
    return ", ".join(each)


def written(files: Mapping[str, bytes]) -> Path:
    """Return a folder with these files, written once in a process and removed when it ends.

    It has a name of its own: in one that others could guess they could put code.

    Examples
    --------
    >>> folder = written({"rules/own.py": b"LONG = 3"})
    >>> (folder / "rules" / "own.py").read_text()
    'LONG = 3'
    >>> written({"rules/own.py": b"LONG = 3"}) == folder
    True
    """
    named = {name: hashlib.sha256(files[name]).hexdigest() for name in sorted(files)}
    digest = hashlib.sha256(json.dumps(named).encode()).hexdigest()
    with WRITING:
        if digest not in FOLDERS:
            folder = Path(mkdtemp(prefix="curricle-"))
            atexit.register(shutil.rmtree, folder, ignore_errors=True)
            for name, content in files.items():
                place = folder / name
                place.parent.mkdir(parents=True, exist_ok=True)
                place.write_bytes(content)
            FOLDERS[digest] = folder
        return FOLDERS[digest]
