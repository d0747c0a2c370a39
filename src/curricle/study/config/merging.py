"""From a file's tables to complete curricula: arms over the study, tasks over settings for all."""

from collections.abc import Mapping
from typing import Any

from curricle.curriculum.defaults import OF_TARGETS
from curricle.errors import ConfigError
from curricle.study.config.families import of_family
from curricle.study.config.parsing import parsed
from curricle.study.config.settings import DEEP, LEARNERS, Settings
from curricle.study.config.task_names import NameGraph, table

SETTINGS = tuple(Settings.model_fields)
LASTING = frozenset(SETTINGS).union(
    frozenset.intersection(*(frozenset(one.model_fields) for one in LEARNERS))
)
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

    Tables are merged key by key; any other value replaces the old one. A table that becomes another
    type keeps the keys that every type has. Transfers, a list, are given by number.

    Examples
    --------
    >>> merged({"a": {"b": 1, "c": 2}, "d": [3]}, {"a": {"b": 4}, "d": [5]})
    {'a': {'b': 4, 'c': 2}, 'd': [5]}
    >>> merged({"transfers": [{"scale": 1}]}, {"transfers": {"0": {"scale": 2}}})
    {'transfers': [{'scale': 2}]}
    >>> merged({"type": "linear", "last": 0, "steps": 9}, {"type": "harmonic"})
    {'type': 'harmonic'}
    """
    changes_type = any(key in patch and patch[key] != base.get(key) for key in ("type", "family"))
    result = {key: value for key, value in base.items() if not changes_type or key in LASTING}
    if changes_type and "family" in patch:  # which says the type
        result.pop("type", None)
    for key, value in patch.items():
        result.pop(ALTERNATIVES.get(key, ""), None)
        result[key] = _over(result.get(key), value, key)
    return result


def _over(old: Any, new: Any, key: str) -> Any:
    """Return the value of a key that has an older one; a table of another kind replaces it."""
    if not isinstance(new, dict):
        return new
    if key == "transfers" and isinstance(old, list):
        return [_over(one, new[str(n)], "") if str(n) in new else one for n, one in enumerate(old)]
    if key == "shaping" and isinstance(old, str):
        old = {"type": old}
    if not isinstance(old, dict):
        return new
    if key == "budget" and ("episodes" in old) is not ("episodes" in new):
        return new
    if key == "learner":
        if "type" in new and (old.get("type") == DEEP) is not (new["type"] == DEEP):
            return new
        if new.get("algorithm", old.get("algorithm")) != old.get("algorithm"):
            # Another algorithm has other settings.
            old = {name: value for name, value in old.items() if name != "settings"}
    return merged(old, new)


def complete_learners(study: Raw, curriculum: Raw) -> Any:
    """Return a study's further learners from scratch, each over that of a curriculum's target.

    What is malformed stays so.
    """
    given, targets = study["scratch_learners"], NameGraph.of(curriculum).targets
    if not isinstance(given, dict) or len(targets) != 1:
        return given
    own = table(table(curriculum.get("tasks")).get(targets[0])).get("learner")
    own = {"type": LEARNERS[0].model_fields["type"].default} if own is None else own
    return {name: _over(own, learner, "learner") for name, learner in given.items()}


def assignment(text: str) -> tuple[tuple[str, ...], Raw]:
    """Return what ``--set key=value`` assigns: the key's parts, and the value in nested tables.

    The value is read as TOML, or else taken as text. ConfigError says that it is no assignment.

    Examples
    --------
    >>> assignment("tasks.chase.budget=1_000")
    (('tasks', 'chase', 'budget'), {'tasks': {'chase': {'budget': 1000}}})
    >>> assignment("aggregate=mean")
    (('aggregate',), {'aggregate': 'mean'})
    """
    key, equals, value = text.partition("=") if isinstance(text, str) else ("", "", "")
    keys = dotted(key)
    if not equals or not keys:
        raise ConfigError(f"a setting is given as key=value, with dots in the key: got {text!r}")
    given: Any
    try:
        given = parsed(f"value = {value}")["value"]
    except ValueError:
        given = value.strip()
    for part in reversed(keys):
        given = {part: given}
    return keys, dict(given)


def dotted(key: str) -> tuple[str, ...]:
    """Return the parts of a dotted key of TOML such as ``arms."5x5".shaping``; () if it is none."""
    try:
        node: Any = parsed(f"{key.strip()} = 0")
    except ValueError:
        return ()
    parts = list[str]()
    while isinstance(node, dict):
        (part,) = node
        parts.append(part)
        node = node[part]
    return tuple(parts)


def complete_curriculum(study: Raw, patch: Raw | None = None) -> Raw:
    """Return the curriculum of an arm, or of the study as it is, each task with all its settings.

    Any part may be malformed, and then stays so.
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
        plan["transfers"] = _chosen(chosen, base.get("transfers"))
        plan["tasks"] = _needed(plan, NameGraph.of(base))
    for_all = {which: plan.pop(which) for which in SETTINGS if which in plan}
    with_sources = {target for _, target in NameGraph.of(plan).edges}
    tasks, families = plan.get("tasks"), table(study.get("families"))
    if isinstance(tasks, dict):
        plan["tasks"] = {
            name: _with_settings(of_family(task, families), for_all, name in with_sources)
            if isinstance(task, dict)
            else task
            for name, task in tasks.items()
        }
    return plan


def _chosen(chosen: list[Any], transfers: Any) -> list[Any]:
    """Return the transfers that an arm names, those given by number taken from the study's."""
    there = dict(enumerate(transfers)) if isinstance(transfers, list) else {}
    named = [there.get(one) if type(one) is int else one for one in chosen]
    return [one for one in named if one is not None]


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
