"""The data and code on which a unit's result depends, and the key made of them."""

import json
from collections.abc import Iterator, Mapping
from hashlib import blake2b
from importlib import metadata
from pathlib import Path
from typing import Any

from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.node import SETTINGS
from curricle.study_file.own_code import code_of
from curricle.study_file.schema import NameGraph
from curricle.transfer.transfer import mappings_digest

# -- In what two descriptions of results differ, so that their results may too ---------------------

MAY_CHANGE = ("name", "seeds", "seeds_per_unit", "threshold", "window")  # no result depends on it


def differences(first: Any, second: Any, name: str = "") -> Iterator[tuple[str, tuple[Any, Any]]]:
    """Yield the keys, with both values, by which two descriptions and so results may differ."""
    if isinstance(first, list) and isinstance(second, list) and len(first) == len(second):
        first, second = dict(enumerate(first)), dict(enumerate(second))
    if not (isinstance(first, dict) and isinstance(second, dict)):
        if first != second:
            yield name, (first, second)
        return
    for key in sorted({*first, *second}):
        place = f"{name}.{key}" if name and name != "configuration" else key
        # The record follows from the configuration and the study's own functions.
        if not (name == "configuration" and key in MAY_CHANGE) and place != "record":
            yield from differences(first.get(key), second.get(key), place)


def shown(value: Any) -> str:
    """Return a value as text for a sentence, shortened if it is long."""
    text = json.dumps(value)
    return "absent" if value is None else text if len(text) < 60 else text[:56] + " ..."


# -- What a unit's result depends on, its key, and why a stored unit does not fit a study any more -

KEY_BYTES = 8
AUTO = "auto"  # the mapping of a transfer table for which the best is searched
Dependencies = Mapping[str, Any]  # all that a task's result in an arm depends on, but the seed
Stored = Mapping[str, Mapping[int, Any]]  # key -> seed -> :class:`StoredUnit`, at least one


def key_of(dependencies: Dependencies) -> str:
    """Return a short hash of dependencies: units of one key have one result."""
    data = json.dumps(dependencies, sort_keys=True)
    return blake2b(data.encode(), digest_size=KEY_BYTES).hexdigest()


def dependencies_of(
    arm: Mapping[str, Any],
    curriculum: Curriculum,
    total: int | None,
    folder: Path,
) -> Iterator[tuple[str, str, Dependencies]]:
    """Yield each task of an arm with its key and its dependencies, sources first."""
    keys: dict[str, str] = {}
    graph, version = NameGraph.of(dict(arm)), metadata.version("curricle")
    for name in curriculum.order:
        task, *wholes = (arm["tasks"][drawing] for drawing in graph.drawings(name))
        into = [edge for edge in arm["transfers"] if edge["target"] == name]
        is_target = name == curriculum.target
        dependencies = {
            "curricle": version,
            "name": name,
            "task": task,
            "parts_of": [{k: v for k, v in of.items() if k not in SETTINGS} for of in wholes],
            "transfers": into,
            "sources": {edge["source"]: keys[edge["source"]] for edge in into},
            "total": total if is_target else None,
        }
        if not is_target:
            dependencies["source_budget"] = str(curriculum.setting("budget", name))
        # Mappings that were searched stand beside the user's modules: another version of the
        # searches may choose others, also where candidates tie.
        searched = {
            f"the mapping found for {edge['source']} -> {name}": mappings_digest(
                t for t in curriculum.transfers if (t.source, t.target) == (edge["source"], name)
            )
            for edge in into
            if edge.get("mapping") == AUTO
        }
        dependencies["code"] = {**code_of(dependencies, folder), **searched}
        keys[name] = key_of(dependencies)
        yield name, keys[name], dependencies


def replaced_keys(wanted: Mapping[str, Dependencies], stored: Stored) -> dict[str, str]:
    """Return for each wanted key the stored key that it replaces: of its task, fewest changes."""
    pairs = [
        (len(list(changes_of(units, dependencies))), key, old)
        for key, dependencies in wanted.items()
        for old, units in stored.items()
        if key not in stored and old not in wanted and _of(units)["name"] == dependencies["name"]
    ]
    replaced: dict[str, str] = {}
    for _, key, old in sorted(pairs):
        if key not in replaced and old not in replaced.values():
            replaced[key] = old
    return replaced


def _of(units: Mapping[int, Any]) -> Dependencies:
    dependencies: Dependencies = next(iter(units.values())).about.dependencies
    return dependencies


def changes_of(units: Mapping[int, Any], here: Dependencies) -> Iterator[str]:
    """Yield a clause for each change between the dependencies of stored units and `here`."""
    there = _of(units)
    if there["curricle"] != here["curricle"]:
        yield f"Curricle was {there['curricle']} and is {here['curricle']}"
    old_code, code = there["code"], here["code"]
    for file in sorted(file for file in {*old_code, *code} if old_code.get(file) != code.get(file)):
        fate = "changed" if file in old_code else "is used now"
        yield f"{file} {fate if file in code else 'is used no longer'}"
    for source in sorted({*there["sources"], *here["sources"]}):
        if there["sources"].get(source) != here["sources"].get(source):
            yield f"its source {source} changed"
    for name in ("task", "parts_of", "transfers", "total", "source_budget"):
        for place, (old, new) in differences(there.get(name), here.get(name), name):
            yield f"{place.removeprefix('task.')} was {shown(old)} and is {shown(new)}"
