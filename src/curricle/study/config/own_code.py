"""The user's own modules behind the functions that a study names, as digests of their files.

A module is the user's own if it is in the study's folder, or on Python's path without being
installed (in ``site-packages``) or part of Python. What it imports from its own folder belongs to
it: every ``import`` in its text counts, wherever it stands. Not found are modules imported by a
computed name, and files that a module reads.
"""

import ast
import hashlib
import importlib.util
import re
import sysconfig
from collections.abc import Iterator
from importlib.machinery import all_suffixes
from pathlib import Path
from typing import Any

REFERENCE = re.compile(r"((?:[^\W\d]\w*\.)*[^\W\d]\w*):\S+")
"""``module:function``, or an environment of Gymnasium, ``module:Name-v0``."""
NOT_OWN = {
    Path(sysconfig.get_path(each)).resolve()
    for each in ("stdlib", "platstdlib", "purelib", "platlib")
}


def code_of(data: Any, folder: Path) -> dict[str, str]:
    """Return digests of the own modules that plain data name, by file.

    Files are named from the folder that holds them, and line ends do not count, so that equal code
    has equal digests on any machine.

    Parameters
    ----------
    data
        Any text in it may be a ``module:function``.
    folder : Path
        The study's.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> folder = Path(mkdtemp())
    >>> _ = (folder / "own.py").write_text("from .rules import LONG")
    >>> _ = (folder / "rules.py").write_text("LONG = 3")
    >>> sorted(code_of({"factory": "own:line", "others": ["json:dumps"]}, folder))
    ['own.py', 'rules.py']
    """
    found = dict[str, str]()
    for name, file in own_files(data, folder).items():
        content = file.read_bytes().replace(b"\r\n", b"\n")
        found[name] = hashlib.blake2b(content, digest_size=16).hexdigest()
    return found


def own_files(data: Any, folder: Path) -> dict[str, Path]:
    """Return the files of the own modules that plain data name, as in :func:`code_of`.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> folder = Path(mkdtemp())
    >>> _ = (folder / "own.py").write_text("LONG = 3")
    >>> own_files({"factory": "own:line"}, folder) == {"own.py": folder / "own.py"}
    True
    """
    found = dict[str, Path]()
    modules = {match[1] for text in _texts(data) if (match := REFERENCE.fullmatch(text))}
    for words in (tuple(module.split(".")) for module in sorted(modules)):
        root = folder if any(_files(folder, words)) else _other_folder(words)
        if root is not None:
            for file in sorted(_closure(root, words)):
                found[file.relative_to(root).as_posix()] = file
    return found


def _texts(data: Any) -> Iterator[str]:
    """Yield every text in plain data."""
    if isinstance(data, str):
        yield data
    elif isinstance(data, dict | list | tuple):
        for one in data.values() if isinstance(data, dict) else data:
            yield from _texts(one)


def _other_folder(words: tuple[str, ...]) -> Path | None:
    """Return the folder on Python's path that holds a module; None if it is not the user's own."""
    try:
        spec = importlib.util.find_spec(words[0])
    except ValueError:  # __main__
        return None
    if spec is None or words[0] == __name__.partition(".")[0]:  # Curricle has a version instead
        return None
    place, *_ = [*(spec.submodule_search_locations or []), spec.origin or ""]
    root = Path(place).resolve().parent
    own = any(_files(root, words)) and not any(root.is_relative_to(path) for path in NOT_OWN)
    return root if own else None


def _closure(root: Path, words: tuple[str, ...]) -> set[Path]:
    """Return the files of a module in a folder, and of all that it imports from there."""
    found, waiting = set[Path](), [words]
    while waiting:
        for file in _files(root, waiting.pop()):
            if file not in found:
                found.add(file)
                waiting += _imports(file, file.relative_to(root).parent.parts)
    return found


def _files(root: Path, words: tuple[str, ...]) -> Iterator[Path]:
    """Yield the files of a module and of the packages that it is in."""
    for n in range(1, len(words) + 1):
        stem = root.joinpath(*words[:n])
        for suffix in all_suffixes():
            files = (stem / f"__init__{suffix}", stem.with_name(stem.name + suffix))
            yield from (file for file in files if file.is_file())


def _imports(file: Path, package: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """Yield what a file of a package imports, as words; some name functions in modules."""
    try:
        tree = ast.parse(file.read_bytes() if file.suffix == ".py" else b"")
    except (SyntaxError, ValueError):  # importing it is an error, which is reported there
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (tuple(alias.name.split(".")) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            around = package[: len(package) + 1 - node.level] if node.level else ()
            module = (*around, *(node.module.split(".") if node.module else ()))
            yield from ((*module, alias.name) for alias in node.names)
