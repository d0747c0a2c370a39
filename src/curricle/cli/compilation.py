"""Saying that loops are compiled, which happens once for each kind of task and learner."""

import gc
import sys
from functools import cache
from typing import Any

from numba.core import event
from numba.core.caching import NullCache

EVENT = "numba:compile"
ONCE, EACH_TIME = "compiling, once", "compiling what is not kept on disk, at each start"
KEPT = f"curricle: {ONCE}; what is compiled is kept, so that later runs start at once"


class Compilation(event.Listener):
    """Says on standard error what is compiled: each loop in a terminal, elsewhere once that it is.

    Loops that were compiled before are read from the disk, and nothing is said. How many there will
    be is not known beforehand. Garbage is collected afterwards, which saves a tenth of the time.

    Attributes
    ----------
    loops : int
        How many were compiled so far.
    words : str
        What is being compiled; empty if nothing is.
    silent : bool
        Whether the words are shown elsewhere, such as below bars.
    """

    def __init__(self) -> None:
        self.loops, self.words, self.silent = 0, "", False
        self._depth = 0  # Numba compiles in one thread at a time
        self._collects = gc.isenabled()

    def on_start(self, event: Any) -> None:
        """Count a loop, but not the parts that it is made of."""
        self._depth += 1
        if self._depth > 1:
            return
        self.loops += 1
        gc.disable()
        unkept = isinstance(event.data["dispatcher"]._cache, NullCache)
        self.words = f"{EACH_TIME if unkept else ONCE}: {self.loops}"
        if not sys.stderr.isatty():
            if self.loops == 1:
                print(f"curricle: {EACH_TIME}" if unkept else KEPT, file=sys.stderr, flush=True)
        elif not self.silent:
            print(f"\r{self.words}", end="", file=sys.stderr, flush=True)

    def on_end(self, event: Any) -> None:
        """Take the words away when a loop is compiled."""
        self._depth -= 1
        if self._depth:
            return
        if self._collects:
            gc.enable()
        if sys.stderr.isatty() and not self.silent:
            print(f"\r{' ' * len(self.words)}\r", end="", file=sys.stderr, flush=True)
        self.words = ""


@cache
def announce_compilation() -> Compilation:
    """Say what is compiled from now on."""
    listener = Compilation()
    register: Any = event.register
    register(EVENT, listener)
    return listener
