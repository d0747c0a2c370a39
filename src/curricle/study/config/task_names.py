"""The names of tasks in a curriculum, checked before anything is built."""

from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from typing import Any, NamedTuple

from curricle.checks import unfit_name
from curricle.study.config.tables import KeyPath, shown, suggestion

DRAWN = ("maze", "crop", "four_rooms", "key_lock_pit", "family")
"""Types of tasks that a crop may be a part of."""


class NameGraph(NamedTuple):
    """The tasks of a curriculum by name, its crops and its transfers."""

    parts: dict[str, str | None]
    """The task of which each task is a crop, if it is one."""
    edges: tuple[tuple[str, str], ...]
    """Source and target of each transfer."""

    @classmethod
    def of(cls, plan: dict[str, Any]) -> "NameGraph":
        """Return the graph of a curriculum as data, of which any part may be malformed."""
        tasks = {name: table(task).get("of") for name, task in table(plan.get("tasks")).items()}
        transfers = plan.get("transfers")
        rows = map(table, transfers if isinstance(transfers, list) else [])
        edges = [(edge.get("source"), edge.get("target")) for edge in rows]
        return cls(
            {name: of if isinstance(of, str) else None for name, of in tasks.items()},
            tuple((s, t) for s, t in edges if isinstance(s, str) and isinstance(t, str)),
        )

    @property
    def learnt(self) -> list[str]:
        """The tasks that are learnt: all but those that are there only to be cropped."""
        named = {name for edge in self.edges for name in edge}
        cropped = set(self.parts.values())
        return [name for name in self.parts if name in named or name not in cropped]

    @property
    def targets(self) -> list[str]:
        """The tasks that are learnt and that no other builds on; a curriculum has one."""
        sources = {source for source, _ in self.edges}
        return [name for name in self.learnt if name not in sources]

    def drawings(self, name: str) -> list[str]:
        """Return the tasks that one is a crop of, itself first."""
        found = list[str]()
        part: str | None = name
        while part is not None and part not in found:
            found.append(part)
            part = self.parts.get(part)
        return found


def table(value: Any) -> dict[str, Any]:
    """Return a table as it is, and an empty one for anything else."""
    return value if isinstance(value, dict) else {}


def wrong_names(plan: dict[str, Any]) -> Iterator[tuple[KeyPath, str]]:
    """Yield what is wrong with the names in a curriculum, each with its key path.

    Malformed parts are skipped, since they are reported elsewhere.
    """
    graph = NameGraph.of(plan)
    tasks, transfers = table(plan.get("tasks")), plan.get("transfers")
    for name, task in tasks.items():
        if why := unfit_name(name):
            yield ("tasks", name), f"has a name that {why}"
        of = table(task).get("of")
        if table(task).get("type") == "crop" and isinstance(of, str):
            path = ("tasks", name, "of")
            if of not in graph.parts:
                yield path, _no_task(of, graph)
            elif table(tasks[of]).get("type") not in DRAWN:
                yield path, f"must name a task of type {', '.join(DRAWN)}: got {shown(of)}"
            elif graph.parts.get(graph.drawings(name)[-1]) is not None:
                yield (
                    path,
                    f"must lead to a whole task: got {' of '.join(graph.drawings(name))} and so on",
                )
    whole = True
    for index, edge in enumerate(transfers if isinstance(transfers, list) else []):
        for role in ("source", "target"):
            wanted = table(edge).get(role)
            known = isinstance(wanted, str) and wanted in graph.parts
            whole = whole and known
            if isinstance(wanted, str) and not known:
                yield ("transfers", index, role), _no_task(wanted, graph)
    if whole:
        yield from _whole(graph)


def _whole(graph: NameGraph) -> Iterator[tuple[KeyPath, str]]:
    """Yield what is wrong with a graph all of whose names are known."""
    before: dict[str, list[str]] = {}
    for source, target in graph.edges:
        before.setdefault(target, []).append(source)
    try:
        TopologicalSorter(before).prepare()
    except CycleError as error:
        yield ("transfers",), f"must have no cycle: got {' -> '.join(error.args[1])}"
        return
    if graph.parts and len(graph.targets) != 1:
        yield (
            ("tasks",),
            f"must have one that no other builds on: got {', '.join(graph.targets) or 'none'}",
        )


def _no_task(name: str, graph: NameGraph) -> str:
    return f"must name a task: got {shown(name)}{suggestion(name, graph.parts)}"
