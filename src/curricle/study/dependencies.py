"""What a unit's result depends on, code of the user's own included, and the key made of it."""

import ast
import hashlib
import importlib.util
import json
import re
import sysconfig
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import metadata
from importlib.machinery import all_suffixes
from pathlib import Path
from typing import Any

from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.node import SETTINGS
from curricle.study.config.tables import NameGraph
from curricle.transfer.edges import mappings_digest

# -- In what two descriptions of results differ, so that their results may too ---------------------

MAY_CHANGE = ("name", "seeds", "seeds_per_unit", "threshold", "window")
"""Keys of a study on which no stored result depends."""


def differences(mine: Any, yours: Any, name: str = "") -> Iterator[tuple[str, tuple[Any, Any]]]:
    """Yield the keys, with both values, in which two descriptions differ and results may too."""
    if isinstance(mine, list) and isinstance(yours, list) and len(mine) == len(yours):
        mine, yours = (dict(enumerate(each)) for each in (mine, yours))
    if not (isinstance(mine, dict) and isinstance(yours, dict)):
        if mine != yours:
            yield name, (mine, yours)
        return
    for key in sorted({*mine, *yours}):
        place = f"{name}.{key}" if name and name != "configuration" else key
        # The record follows from the configuration and the study's own functions.
        if not (name == "configuration" and key in MAY_CHANGE) and place != "record":
            yield from differences(mine.get(key), yours.get(key), place)


def shown(value: Any) -> str:
    """Return a value in a sentence, cut where it is long."""
    text = json.dumps(value)
    return "absent" if value is None else text if len(text) < 60 else text[:56] + " ..."


# -- The user's own modules behind the functions that a study names, as digests of their files -----
#
# A module is the user's own if it is in the study's folder, or on Python's path without being
# installed (in ``site-packages``) or part of Python. What it imports from its own folder belongs to
# it: every ``import`` in its text counts, wherever it stands. Not found are modules imported by a
# computed name, and files that a module reads.

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

    Any text in the data may be a ``module:function``; `folder` is the study's.
    """
    found = dict[str, str]()
    for name, file in own_files(data, folder).items():
        content = file.read_bytes().replace(b"\r\n", b"\n")
        found[name] = hashlib.blake2b(content, digest_size=16).hexdigest()
    return found


def own_files(data: Any, folder: Path) -> dict[str, Path]:
    """Return the files of the own modules that plain data name, as in :func:`code_of`."""
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


# -- What a unit's result depends on, its key, and why a stored unit does not fit a study any more

KEY_BYTES = 8
AUTO = "auto"
"""The mapping of a transfer table for which one is found."""
OF_CODE = ("curricle", "code")
"""The dependencies that ``--keep-stale`` ignores."""
Dependencies = Mapping[str, Any]
"""Plain data: all that the result of one task of one arm depends on, but the seed."""
Stored = Mapping[str, Mapping[int, Any]]
"""Key -> seed -> :class:`StoredUnit`, at least one."""


def key_of(dependencies: Dependencies) -> str:
    """Return a short hash of dependencies: units of one key have one result."""
    data = json.dumps(dependencies, sort_keys=True)
    return hashlib.blake2b(data.encode(), digest_size=KEY_BYTES).hexdigest()


def settings_key_of(dependencies: Dependencies) -> str:
    """Return :func:`key_of` all but code and Curricle's version, which takes its place."""
    return key_of(_without_code(dependencies))


def dependencies_of(
    arm: Mapping[str, Any],
    curriculum: Curriculum,
    total: int | None,
    folder: Path,
    choose: Callable[[Dependencies], str] = key_of,
) -> Iterator[tuple[str, str, Dependencies]]:
    """Yield each task of an arm with its key and its dependencies, sources first.

    The arm is given as data and as a curriculum; `total` are the steps of its target with those of
    its sources, `folder` has the study's own modules, and `choose` gives dependencies their key.
    """
    keys: dict[str, str] = {}
    graph = NameGraph.of(dict(arm))
    version = metadata.version("curricle")
    for name in curriculum.order:
        task, *others = (arm["tasks"][drawing] for drawing in graph.drawings(name))
        into = [one for one in arm["transfers"] if one["target"] == name]
        found = {
            "curricle": version,
            "name": name,
            "task": task,
            "parts_of": [{k: v for k, v in one.items() if k not in SETTINGS} for one in others],
            "transfers": into,
            "sources": {one["source"]: keys[one["source"]] for one in into},
            "total": total if name == curriculum.target else None,
        }
        if name != curriculum.target:
            found["source_budget"] = str(curriculum.setting("budget", name))
        found["code"] = {**code_of(found, folder), **_found_mappings(into, curriculum)}
        keys[name] = choose(found)
        yield name, keys[name], found


def _found_mappings(tables: Sequence[Mapping[str, Any]], curriculum: Curriculum) -> dict[str, str]:
    """Return a digest of the mappings of each edge where one is found, by words for it.

    They stand beside the user's modules: what is found depends on the searches of this version, and
    they may find something else with another one, or where candidates tie.
    """
    edges = [(one["source"], one["target"]) for one in tables if one.get("mapping") == AUTO]
    return {
        f"the mapping found for {source} -> {target}": mappings_digest(
            one for one in curriculum.transfers if (one.source, one.target) == (source, target)
        )
        for source, target in edges
    }


def key_in(stored: Stored) -> Callable[[Dependencies], str]:
    """Return a function that takes :func:`key_of`'s place: stored units of other code are as good.

    Among those that differ in nothing else, the key is that of most seeds.
    """

    def choose(dependencies: Dependencies) -> str:
        own = key_of(dependencies)
        wanted = _without_code(dependencies)
        as_good = {own: len(stored.get(own, ()))}
        for key, units in stored.items():
            if _without_code(_of(units)) == wanted:
                as_good[key] = len(units)
        return max(as_good, key=as_good.__getitem__)

    return choose


def replaced_keys(wanted: Mapping[str, Dependencies], stored: Stored) -> dict[str, str]:
    """Return which stored units of no wanted key each wanted key replaces: key -> stored key.

    They are of the same task, and those that differ least; no two keys replace the same units.
    """
    pairs = [
        (len(list(changes_of(units, dependencies))), key, old)
        for key, dependencies in wanted.items()
        for old, units in stored.items()
        if key not in stored and old not in wanted and _of(units)["name"] == dependencies["name"]
    ]
    found: dict[str, str] = {}
    for _, key, old in sorted(pairs):
        if key not in found and old not in found.values():
            found[key] = old
    return found


def _of(units: Mapping[int, Any]) -> Dependencies:
    found: Dependencies = next(iter(units.values())).about.dependencies
    return found


def _without_code(dependencies: Dependencies) -> dict[str, Any]:
    return {name: value for name, value in dependencies.items() if name not in OF_CODE}


def changes_of(units: Mapping[int, Any], here: Dependencies) -> Iterator[str]:
    """Yield how what stored units depended on differs from something, a clause each."""
    there = _of(units)
    if there["curricle"] != here["curricle"]:
        yield f"Curricle was {there['curricle']} and is {here['curricle']}"
    for file in sorted({*there["code"], *here["code"]}):
        if file not in here["code"]:
            yield f"{file} is used no longer"
        elif file not in there["code"]:
            yield f"{file} is used now"
        elif there["code"][file] != here["code"][file]:
            yield f"{file} changed"
    for source in sorted({*there["sources"], *here["sources"]}):
        if there["sources"].get(source) != here["sources"].get(source):
            yield f"its source {source} changed"
    for name in ("task", "parts_of", "transfers", "total", "source_budget"):
        for place, (old, new) in differences(there.get(name), here.get(name), name):
            yield f"{place.removeprefix('task.')} was {shown(old)} and is {shown(new)}"
