"""The machine code of loops, kept on disk until any compiled code of Curricle changes.

Numba by itself asks only whether the loop's own file has changed. It would go on with machine code
into which an older function of another file was compiled.
"""

import hashlib
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

from numba import njit
from numba.core.caching import FunctionCache, IndexDataCacheFile

PACKAGES = ("learning", "planning", "tasks", "teaching", "transfer")
"""Those that have compiled code."""
MARKS = (b"numba", b"overloads", b"loop_cache", b".body(")
"""One of which is in each file with compiled code: what it imports, or a decorator."""


ENTRY: Any = {"nogil": True, "no_cfunc_wrapper": True}  # no C code calls one
entered_from_python: Any = njit(**ENTRY)
"""Compiles a function that Python calls, in each process anew."""


def compiled_once(function: Callable[..., Any]) -> Any:
    """Return a function that is compiled when it is first called, and then kept on disk.

    Without a folder to keep it in, it is compiled in each process.
    """
    compiled = entered_from_python(function)
    with suppress(RuntimeError):  # no folder can be written to
        compiled._cache = LoopCache(function)
    return compiled


@cache
def code_digest() -> str:
    """Return a digest of Curricle's version and of each of its files with compiled code."""
    root = Path(__file__).parents[1]
    found = hashlib.sha256((root / "__init__.py").read_bytes())
    for file in chain.from_iterable(sorted((root / one).rglob("*.py")) for one in PACKAGES):
        content = file.read_bytes()
        if any(mark in content for mark in MARKS):
            found.update(content)
    return found.hexdigest()


class LoopCache(FunctionCache):
    """Numba's cache of a function; a file that cannot be written or read is no error."""

    def __init__(self, function: Callable[..., Any]):
        numbas: Any = super()
        numbas.__init__(function)
        index: Any = LoopIndex
        self._cache_file = index(self._cache_path, self._impl.filename_base, code_digest())

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write what was compiled for a signature."""
        numbas: Any = super()
        with suppress(OSError):  # a full disk: it is compiled again in the next process
            numbas.save_overload(sig, data)


class LoopIndex(IndexDataCacheFile):
    """The file that says which signatures are kept."""

    def _load_index(self) -> dict[Any, str]:
        """Return the file of each signature; none where the index is of another version.

        Then it may name types that are gone, which Numba finds out before it looks at the version.
        """
        numbas: Any = super()
        try:
            return dict(numbas._load_index())
        except Exception:  # of any kind: of whatever it holds
            return {}
