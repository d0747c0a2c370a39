"""What becomes of a study file: read, built and previewed, with an end to waiting."""

import contextlib
import io
import resource
import signal
import traceback
from collections.abc import Callable
from pathlib import Path

import pytest

from curricle.cli import output
from curricle.cli.output import print_preview
from curricle.errors import CurricleError
from curricle.study import read_study

SECONDS = 240
"""Of processor time: a study that takes more hangs, however busy the machine is. Compiling loops
takes up to 20, distilling the miniatures of a network up to 30, trials of three arms up to 120."""
WAITING = 6
"""Seconds on the clock for one of processor time: what waits for something takes none."""
ADDRESSES = 4 << 30
"""Bytes that a study may take beside those that the process has: the examples' own code, told of
2^63 places, takes what there is. Where memory is short, the start of a thread may wait for ever."""
CALL = "made = make(**self.arguments)"
"""Calls own code; what that leaves behind is freed there."""


class Hang(BaseException):
    """Too much time has passed; no handler of exceptions takes it for another."""


@contextlib.contextmanager
def limited(seconds: float):
    """Raise Hang in the block after so many seconds of processor time, or WAITING times as many.

    The block may take ADDRESSES bytes of memory.
    """

    def end(*_):
        raise Hang

    timers = {signal.SIGPROF: signal.ITIMER_PROF, signal.SIGALRM: signal.ITIMER_REAL}
    before = {number: signal.signal(number, end) for number in timers}
    memory, most = resource.getrlimit(resource.RLIMIT_AS)
    try:
        pages = int(Path("/proc/self/statm").read_text("ascii").split()[0])
        taken = pages * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (taken + ADDRESSES, most))
        # Again and again: where a thread gets no memory to start, waiting for it would never end.
        signal.setitimer(signal.ITIMER_PROF, seconds, seconds)
        signal.setitimer(signal.ITIMER_REAL, WAITING * seconds, seconds)
        yield
    finally:
        for number in timers:
            signal.signal(number, signal.SIG_IGN)
        for number, timer in timers.items():
            signal.setitimer(timer, 0)
            signal.signal(number, before[number])
        resource.setrlimit(resource.RLIMIT_AS, (memory, most))


@contextlib.contextmanager
def quick_forecasts():
    """Let a preview take a second or five for what it lets take half a minute or five."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(output, "LONGEST", 1.0)
        patch.setattr(output, "LONGEST_EXAMINING", 5.0)
        yield


def built(path: Path):
    """Build the curricula of a study file."""
    _ = read_study(path).curricula


def previewed(path: Path):
    """Do what `curricle check` does."""
    with quick_forecasts(), contextlib.redirect_stdout(io.StringIO()):
        print_preview(read_study(path))


def outcome(text: str, folder: Path, what: Callable[[Path], None] = previewed) -> tuple[str, str]:
    """Return what becomes of a study file with a text, in a word, and why.

    The words are "fine", "refused", "foreign" (another exception than ours) and "hang"; "own code"
    where that hangs in a module beside the study, or raises what the command says in a sentence.
    """
    path = folder / "study.toml"
    path.write_text(text, "utf-8")
    try:
        with limited(SECONDS):
            what(path)
    except CurricleError as error:
        return "refused", str(error)
    except MemoryError:  # of which the command says a sentence
        return "refused", "not enough memory"
    except Hang as error:
        last = traceback.format_exc()
        own = str(path.parent) in last or traceback.extract_tb(error.__traceback__)[-2].line == CALL
        return ("own code", "") if own else ("hang", last)
    except Exception as error:
        files = [frame.filename for frame in traceback.extract_tb(error.__traceback__)]
        own = any(file.startswith(str(path.parent)) for file in files)
        return ("own code", "") if own else ("foreign", traceback.format_exc())
    return "fine", ""
