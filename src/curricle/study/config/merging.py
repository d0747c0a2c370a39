"""From a file's tables to complete curricula: arms over the study, tasks over settings for all."""

import tomllib
from collections.abc import Mapping
from typing import Any

from curricle.curriculum.curriculum import OF_TARGETS
from curricle.errors import ConfigError
from curricle.study.config.settings import DEEP, LEARNERS, EpisodesTable, Settings
from curricle.study.config.task_names import NameGraph, table

SETTINGS = tuple(Settings.model_fields)
LASTING = frozenset({*SETTINGS, *(key for one in LEARNERS for key in one.model_fields)})
"""Keys that mean the same in tables of every type."""
ALTERNATIVES = {
    "map": "file",
    "file": "map",
    "epsilon": "inverse_temperature",
    "inverse_temperature": "epsilon",
}
"""Keys of which a table has only one; the one given last counts."""

Raw = dict[str, Any]


def merged(base: Mapping[str, Any], patch: Mapping[str, Any]) -> Raw:
    """Return a table with another's entries over its own.

    Tables go into tables key by key and anything else takes the place of what was there. A table
    that becomes another type keeps what every type has. Transfers, a list, are reached by number.

    Examples
    --------
    >>> merged({"a": {"b": 1, "c": 2}, "d": [3]}, {"a": {"b": 4}, "d": [5]})
    {'a': {'b': 4, 'c': 2}, 'd': [5]}
    >>> merged({"transfers": [{"scale": 1}]}, {"transfers": {"0": {"scale": 2}}})
    {'transfers': [{'scale': 2}]}
    >>> merged({"type": "linear", "last": 0, "steps": 9}, {"type": "harmonic"})
    {'type': 'harmonic'}
    """
    changes_type = "type" in patch and patch["type"] != base.get("type")
    result = {key: value for key, value in base.items() if not changes_type or key in LASTING}
    for key, value in patch.items():
        result.pop(ALTERNATIVES.get(key, ""), None)
        result[key] = _over(result.get(key), value, key)
    return result


def _over(old: Any, new: Any, key: str) -> Any:
    if not isinstance(new, dict):
        return new
    if key == "transfers" and isinstance(old, list):
        return [_over(one, new[str(n)], "") if str(n) in new else one for n, one in enumerate(old)]
    if key == "shaping" and isinstance(old, str):
        old = {"type": old}
    if not isinstance(old, dict) or _another(key, old, new):
        return new
    return merged(_kept(key, old, new), new)


def _kept(key: str, old: Raw, new: Raw) -> Raw:
    """Return what stays of a table: of a learner no settings of another algorithm."""
    if key == "learner" and new.get("algorithm", old.get("algorithm")) != old.get("algorithm"):
        return {name: value for name, value in old.items() if name != "settings"}
    return old


def _another(key: str, old: Raw, new: Raw) -> bool:
    """Return whether a budget or a learner is of another kind, of which nothing can stay."""
    if key == "budget":
        return _episodes(old) is not _episodes(new)
    return key == "learner" and "type" in new and _deep(old) is not _deep(new)


def _episodes(budget: Raw) -> bool:
    return any(key in budget for key in EpisodesTable.model_fields)


def _deep(learner: Raw) -> bool:
    return bool(learner.get("type") == DEEP)


def assignment(text: str) -> tuple[tuple[str, ...], Raw]:
    """Return what ``--set key=value`` assigns: the key's parts, and the value in nested tables.

    The value is read as TOML, or else taken as text.

    Raises
    ------
    ConfigError
        When it is no assignment.

    Examples
    --------
    >>> assignment("tasks.chase.budget=1_000")
    (('tasks', 'chase', 'budget'), {'tasks': {'chase': {'budget': 1000}}})
    >>> assignment("aggregate=mean")
    (('aggregate',), {'aggregate': 'mean'})
    """
    key, equals, value = text.partition("=")
    keys = dotted(key)
    if not equals or not keys:
        raise ConfigError(f"a setting is given as key=value, with dots in the key: got {text!r}")
    given: Any
    try:
        given = tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        given = value.strip()
    for part in reversed(keys):
        given = {part: given}
    return keys, dict(given)


def dotted(key: str) -> tuple[str, ...]:
    """Return the parts of a dotted key of TOML; nothing if it is none.

    Examples
    --------
    >>> dotted('arms."5x5".shaping')
    ('arms', '5x5', 'shaping')
    """
    try:
        node: Any = tomllib.loads(f"{key.strip()} = 0")
    except tomllib.TOMLDecodeError:
        return ()
    parts = list[str]()
    while isinstance(node, dict):
        (part,) = node
        parts.append(part)
        node = node[part]
    return tuple(parts)


def complete_curriculum(study: Raw, patch: Raw | None = None) -> Raw:
    """Return a curriculum in which each task has all its settings.

    Parameters
    ----------
    study : dict
        As read; any part may be malformed, and then stays so.
    patch : dict, optional
        The arm, if it is not the study as it is.
    """
    base = {key: value for key, value in study.items() if key in ("tasks", "transfers", *SETTINGS)}
    changes = table(patch)
    if isinstance(changes.get("tasks"), dict):
        # A change of an unknown task has been reported.
        there = table(base.get("tasks"))
        known = {name: task for name, task in changes["tasks"].items() if name in there}
        changes = {**changes, "tasks": known}
    plan = merged(base, changes)
    chosen = changes.get("transfers")
    if isinstance(chosen, list):
        plan["transfers"] = chosen_transfers(chosen, base.get("transfers"))
        plan["tasks"] = _needed(plan, NameGraph.of(base))
    for_all = {which: plan.pop(which) for which in SETTINGS if which in plan}
    with_sources = {target for _, target in NameGraph.of(plan).edges}
    tasks = plan.get("tasks")
    if isinstance(tasks, dict):
        plan["tasks"] = {
            name: _with_settings(task, for_all, name in with_sources)
            if isinstance(task, dict)
            else task
            for name, task in tasks.items()
        }
    return plan


def chosen_transfers(chosen: list[Any], transfers: Any) -> list[Any]:
    """Return the transfers that an arm names, those given by number taken from the study's."""
    there = dict(enumerate(transfers)) if isinstance(transfers, list) else {}
    numbers = [one for one in chosen if type(one) is not int or one in there]
    return [there[one] if type(one) is int else one for one in numbers]


def _needed(plan: Raw, base: NameGraph) -> Any:
    """Return the tasks that an arm's own transfers need, and the study's target."""
    graph = NameGraph.of(plan)
    named = {name for edge in graph.edges for name in edge}
    named |= set(base.targets) if len(base.targets) == 1 else set()
    needed = {drawing for name in named for drawing in graph.drawings(name)}
    tasks = plan.get("tasks")
    if not isinstance(tasks, dict) or not named <= tasks.keys():
        return tasks  # something is wrong, and is reported elsewhere
    return {name: task for name, task in tasks.items() if name in needed}


def _with_settings(task: Raw, for_all: Raw, has_sources: bool) -> Raw:
    """Return a task with the settings for all under its own."""
    settings = {w: value for w, value in for_all.items() if has_sources or w not in OF_TARGETS}
    own = {which: task[which] for which in SETTINGS if which in task}
    return {**task, **merged(settings, own)}
