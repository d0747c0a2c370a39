"""What a unit's result depends on, its key, and why a stored unit does not fit a study any more."""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.defaults import SETTINGS
from curricle.study.config.own_code import code_of
from curricle.study.config.tables import NameGraph
from curricle.study.description import differences, shown
from curricle.transfer.descriptions import mappings_digest

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

    Parameters
    ----------
    arm : dict
        As data.
    curriculum : Curriculum
        The arm.
    total : int or None
        Steps of the target with those of its sources.
    folder : Path
        Of the modules with the study's own functions.
    choose : callable
        Dependencies -> key.
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
    found: Dependencies = next(iter(units.values())).dependencies
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
