"""Settings of a study that vary: which they are, and where in the curriculum of an arm they stand.

A sweep lists their values, a tuning says between which they are searched. Both name a setting by
its key in the file, such as ``learner.learning_rate``.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from curricle.curriculum.defaults import OF_TARGETS
from curricle.study.config.merging import SETTINGS, Raw, complete_curriculum, dotted, merged
from curricle.study.config.positions import path_text
from curricle.study.config.tables import KeyPath, unknown
from curricle.study.config.task_names import NameGraph, table

FREE = ("learner", "storage", *OF_TARGETS)
"""Settings of the target in which arms may differ."""
RANGE = {"low", "high"}
"""Keys that tell a range from a table with further keys."""


class Varied(NamedTuple):
    """A setting that varies."""

    key: tuple[str, ...]
    """Its key in a study file."""
    home: KeyPath
    """Where the file says how it varies."""
    given: Any
    """What it says there."""

    @property
    def name(self) -> str:
        """The key as text."""
        return path_text(self.key)


def varied_in(tables: Any, home: KeyPath) -> Iterator[Varied]:
    """Yield the settings that a table at `home` names, by tables in it or by dotted keys in quotes.

    Examples
    --------
    >>> [one.name for one in varied_in({"a.b": [1], "c": {"d": [2]}, "e": {"low": 0}}, ())]
    ['a.b', 'c.d', 'e']
    """
    for name, value in table(tables).items():
        first = dotted(name) if "." in name else ()
        yield from _inside(first or (name,), (*home, name), value)


def _inside(key: tuple[str, ...], home: KeyPath, value: Any) -> Iterator[Varied]:
    if isinstance(value, dict) and not RANGE & value.keys():
        for name, inner in value.items():
            yield from _inside((*key, name), (*home, name), inner)
    else:
        yield Varied(key, home, value)


def short_names(keys: Sequence[Varied]) -> dict[str, str]:
    """Return the name of each setting as names of arms have it.

    It is the last word of the key where no other setting has that, with the task's name before it.

    Examples
    --------
    >>> both = varied_in({"tasks": {"a": {"budget": []}, "b": {"budget": []}}, "unknown": []}, ())
    >>> short_names([*both])
    {'tasks.a.budget': 'a.budget', 'tasks.b.budget': 'b.budget', 'unknown': 'unknown'}
    """
    shorter = {
        one.name: (*one.key[1:2], one.key[-1]) if one.key[0] == "tasks" else one.key[-1:]
        for one in keys
        if one.key[0] != "transfers"
    }
    taken = [*shorter.values()]
    return {
        one.name: path_text(shorter[one.name])
        if one.name in shorter and taken.count(shorter[one.name]) == 1
        else one.name
        for one in keys
    }


def value_text(value: Any) -> str:
    """Return a value as names of arms and tables have it.

    Examples
    --------
    >>> value_text(True), value_text("mean"), value_text({"type": "SARSA", "epsilon": 0.1})
    ('true', 'mean', '{type=SARSA, epsilon=0.1}')
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}={value_text(one)}' for key, one in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(value_text, value))}]"
    return str(value)


def places_of(study: Raw, patch: Raw, key: Sequence[str]) -> tuple[KeyPath, ...]:
    """Return where a setting stands in the complete curriculum of an arm; none if nowhere.

    A task or an arm that sets it itself keeps its own value, as everywhere in a study file.

    Examples
    --------
    >>> study = {"tasks": {"a": {}, "b": {"learner": {"epsilon": 0.5}}}}
    >>> places_of(study, {}, ("learner", "epsilon"))
    (('tasks', 'a', 'learner', 'epsilon'),)
    """
    mark = object()
    marked: Any = mark
    for part in reversed(key):
        marked = {part: marked}
    return tuple(_paths_to(mark, complete_curriculum(merged(study, marked), patch)))


def _paths_to(mark: object, node: Any, path: KeyPath = ()) -> Iterator[KeyPath]:
    if node is mark:
        yield path
    elif isinstance(node, dict | list):
        for part, inner in node.items() if isinstance(node, dict) else enumerate(node):
            yield from _paths_to(mark, inner, (*path, part))


def with_values(curriculum: Raw, values: Mapping[KeyPath, Any]) -> Raw:
    """Return a complete curriculum with values at some places.

    Examples
    --------
    >>> with_values({"transfers": [{"scale": 1}]}, {("transfers", 0, "scale"): 2})
    {'transfers': [{'scale': 2}]}
    """
    for place, value in values.items():
        patch: Any = value
        for part in reversed(place):
            patch = {str(part): patch}
        curriculum = merged(curriculum, patch)
    return curriculum


def target_alone(curriculum: Raw) -> Raw:
    """Return a complete curriculum without its sources and what applies to targets alone."""
    graph = NameGraph.of(curriculum)
    (target,) = graph.targets
    tasks = {name: dict(curriculum["tasks"][name]) for name in reversed(graph.drawings(target))}
    for which in OF_TARGETS:
        tasks[target].pop(which, None)
    return {"tasks": tasks, "transfers": []}


def wrong_key(study: Raw, complete: Mapping[str, Raw], one: Varied) -> str:
    """Return why a setting cannot vary; empty if it can."""
    first, *others = one.key
    if first not in ("tasks", "transfers", *SETTINGS):
        known = ("tasks", "transfers", *SETTINGS)
        return f"must name a setting of tasks or transfers: {first} {unknown(first, known)}"
    if first in ("tasks", "transfers"):
        there = study.get(first)
        names = list(map(str, range(len(there)))) if isinstance(there, list) else [*table(there)]
        if others and others[0] not in names:
            return f"must name a key of one of the {first}: {others[0]} {unknown(others[0], names)}"
        if len(others) < 2:
            which = others[0] if others else next(iter(names), "NAME")
            key = "budget" if first == "tasks" else "scale"
            return f"must name a key of one of the {first}, such as {first}.{which}.{key}"
    patches = table(study.get("arms"))
    places = [
        (arm, place)
        for arm in complete
        for place in places_of(study, table(patches.get(arm)), one.key)
    ]
    if not places:
        return "changes nothing: each task or arm that it could apply to sets it itself"
    for arm, place in places:
        graph = NameGraph.of(complete[arm])
        drawn = {part for target in graph.targets for part in graph.drawings(target)}
        if place[0] == "tasks" and place[1] in drawn and place[2] not in FREE:
            return (
                f"must leave the target {graph.targets[0]} as it is, since all arms are compared "
                "in it: run the study once for each value, with --set"
            )
    return ""
