"""What becomes of a study file: read, built and previewed, with an end to waiting."""

import contextlib
import io
import signal
import traceback
from pathlib import Path

import pytest

from curricle.cli import forecast_preview
from curricle.cli.study_preview import print_preview
from curricle.errors import CurricleError
from curricle.study import read_study

SECONDS = 10
"""Of processor time: a study that takes more hangs, however busy the machine is."""
WAITING = 60
"""Seconds on the clock: a study that waits for something takes no processor time."""


class Hang(BaseException):
    """Too much time has passed; no handler of exceptions takes it for another."""


@contextlib.contextmanager
def limited():
    """Raise Hang in the block after SECONDS of processor time, or WAITING on the clock."""

    def end(*_):
        raise Hang

    kinds = [(signal.SIGPROF, signal.ITIMER_PROF, SECONDS)]
    kinds += [(signal.SIGALRM, signal.ITIMER_REAL, WAITING)]
    before = [signal.signal(number, end) for number, _, _ in kinds]
    try:
        for _, timer, seconds in kinds:
            signal.setitimer(timer, seconds)
        yield
    finally:
        for (number, timer, _), handler in zip(kinds, before, strict=True):
            signal.setitimer(timer, 0)
            signal.signal(number, handler)


@contextlib.contextmanager
def quick_forecasts():
    """Let a preview take a second or five for what it lets take half a minute or five."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(forecast_preview, "LONGEST", 1.0)
        patch.setattr(forecast_preview, "LONGEST_LOOK", 5.0)
        yield


def outcome(text: str, folder: Path) -> tuple[str, str]:
    """Return what `curricle check` makes of a text, in a word, and why.

    The words are "fine", "refused", "foreign" (another exception than ours) and "hang"; "own code"
    where that hangs in a module beside the study.
    """
    path = folder / "study.toml"
    path.write_text(text, "utf-8")
    try:
        with limited(), quick_forecasts(), contextlib.redirect_stdout(io.StringIO()):
            print_preview(read_study(path))
    except CurricleError as error:
        return "refused", str(error)
    except Hang:
        last = traceback.format_exc()
        return ("own code", "") if str(folder) in last else ("hang", last)
    except Exception:
        return "foreign", traceback.format_exc()
    return "fine", ""
