"""Do what pages tell their readers to do, word for word, and compare what is printed.

    python tests/support/walk.py PAGE [PAGE ...] --folder FOLDER

Commands are taken from the pages (pages.py). Each step's time is printed beside the most that
the page states. The walk fails where a command fails, prints something else, or takes longer. Times
and progress bars are not compared. What a page says ends with "interrupted" is interrupted.
"""

import argparse
import doctest
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

sys.path.append(str(Path(__file__).parents[2]))

from tests.support.pages import Command, put, steps

ERROR, INTERRUPTED = "curricle: ", "curricle: interrupted"
BAR, A_TIME = "━", re.compile(r"\b\d+ (s|min|h)\b")
PATIENCE = 3
"""A command that takes so many times what is stated is ended."""
POLL = 0.02
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


class Ended(NamedTuple):
    """How a command ended."""

    status: int
    printed: str
    complained: str
    seconds: float


class Shell:
    """A shell whose folder and variables stay from command to command."""

    def __init__(self, folder: Path, variables: Mapping[str, str]):
        self.folder, self.variables = folder, dict(variables)

    def run(self, command: Command) -> Ended:
        """Run a command, and interrupt it where the page does."""
        kept = self.folder / ".walk-variables"
        script = f"{command.line}\nstatus=$?; env -0 > '{kept}'; exit $status"
        outputs = [self.folder / ".walk-out", self.folder / ".walk-err"]
        began = time.perf_counter()
        with outputs[0].open("w") as out, outputs[1].open("w") as err:
            running = subprocess.Popen(
                ["bash", "-c", script], cwd=self.folder, env=self.variables, stdout=out, stderr=err,
                stdin=subprocess.DEVNULL, start_new_session=True, preexec_fn=_interruptible,
            )  # fmt: skip
            if INTERRUPTED in command.output:
                self._wait_for_a_unit(running)
                os.killpg(running.pid, signal.SIGINT)
            try:
                running.wait(PATIENCE * command.seconds)
            except subprocess.TimeoutExpired:
                os.killpg(running.pid, signal.SIGKILL)
                running.wait()
        took = time.perf_counter() - began
        if kept.exists():
            pairs = (one.partition("=") for one in kept.read_text("utf-8").split("\0") if one)
            self.variables = {name: value for name, _, value in pairs}
        return Ended(running.returncode, *(one.read_text("utf-8") for one in outputs), took)

    def _wait_for_a_unit(self, running: subprocess.Popen) -> None:
        """Return when a file of results is stored, or the command has ended."""
        before = set(self.folder.glob("*-results/**/*.npz"))
        while running.poll() is None and set(self.folder.glob("*-results/**/*.npz")) <= before:
            time.sleep(POLL)


def _interruptible() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def faults(command: Command, ended: Ended) -> Iterator[str]:
    """Yield what is wrong with how a command ended, in words."""
    lines = command.output.splitlines()
    complaints = [line for line in lines if line.startswith(ERROR)]
    if (ended.status != 0) != bool(complaints):
        yield f"ended with {ended.status}"
    for line in complaints:
        if not _alike(f"...{line}...", ended.complained):
            yield f"did not say: {line}"
    told = "\n".join("..." if BAR in one else one for one in lines if one not in complaints)
    if told.strip() and INTERRUPTED not in command.output and not _alike(told, ended.printed):
        yield f"printed:\n{ended.printed}where the page has:\n{told}\n"


def _alike(told: str, printed: str) -> bool:
    """Return whether an output is as told; times are not compared."""
    told, printed = (A_TIME.sub("N s", one).strip() + "\n" for one in (told, printed))
    told = re.sub(r"^\.\.\.\s+", "...", told)  # what is left out at the beginning may be nothing
    return doctest.OutputChecker().check_output(told, printed, OPTIONS)


def walk(
    page: Path,
    folder: Path,
    variables: Mapping[str, str],
    *,
    timed: bool = True,
    taken: Callable[[str], bool] = lambda line: True,
) -> list[str]:
    """Do the steps of a page in a folder; return what went wrong.

    Commands that `taken` does not want are left out. Python examples come last, as a command.
    """
    shell, wrong = Shell(folder, variables), []
    text = page.read_text("utf-8")
    found = [*steps(text)]
    if ">>> " in text:
        runner = Path(__file__).with_name("page_examples.py")
        late = "" if timed else " --untimed"
        line = f"python '{runner}' '{page.resolve()}'{late}  # its own times, in 30 minutes"
        found.append(Command(line))
    for step in found:
        if not isinstance(step, Command):
            put(step, folder)
        elif taken(step.line):
            ended = shell.run(step)
            bad = list(faults(step, ended))
            if timed and ended.seconds > step.seconds:
                bad.append("took longer than the page states")
            if bad:
                bad.append(ended.complained[-2000:])
            shown = f"{ended.seconds:7.1f} s of {step.seconds:5.0f} s  $ {step.line}"
            print(*[shown, *bad], sep="\n  FAULT: ", flush=True)
            if "page_examples" in step.line:
                print(ended.printed, end="")
            wrong += [f"{page.name}: $ {step.line}: {one}" for one in bad]
    return wrong


def main() -> int:
    """Return 1 if a step of a page went wrong, else 0."""
    given = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    given.add_argument("pages", nargs="+", type=Path)
    given.add_argument("--folder", type=Path, default=Path(), help="where commands are typed")
    options = given.parse_args()
    wrong = []
    for page in options.pages:
        print(page, flush=True)
        wrong += walk(page, options.folder.resolve(), os.environ)
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
