"""Tasks as nodes and transfers as edges: a directed acyclic graph."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from graphlib import CycleError, TopologicalSorter

from curricle.checks import fit_name, instance, one_of
from curricle.curriculum.curriculum_table import graph_in_brief
from curricle.deep.miniature import Miniatures
from curricle.errors import CurriculumError
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.task import Task, generative_model, same_task
from curricle.transfer.chosen_mapping import with_mapping
from curricle.transfer.edges import Calibrate, Transfer


@dataclass(frozen=True, eq=False, repr=False)
class TaskGraph:
    """A directed acyclic graph of tasks; what a :class:`Curriculum` is without its settings.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.transfer import identity
    >>> maze = GridWorld("S.T")
    >>> graph = TaskGraph({"b": maze, "a": maze}, [Transfer("a", "b", identity(maze))])
    >>> graph.order, graph.target, graph.ancestors("b")
    (('a', 'b'), 'b', ('a',))
    """

    tasks: Mapping[str, Task]
    transfers: Sequence[Transfer] = ()

    def __post_init__(self) -> None:
        instance("tasks", self.tasks, Mapping, CurriculumError)
        instance("transfers", self.transfers, Sequence, CurriculumError)
        object.__setattr__(self, "tasks", dict(self.tasks))
        object.__setattr__(self, "transfers", tuple(self.transfers))
        if not self.tasks:
            raise CurriculumError("a curriculum needs at least one task: got none")
        for name, task in self.tasks.items():
            fit_name("a task", name, CurriculumError)
            if not is_observation_task(task):
                generative_model(task)
        for transfer in self.transfers:
            instance("each of transfers", transfer, Transfer, CurriculumError)
            for role in ("source", "target"):
                one_of(f"a transfer's {role}", getattr(transfer, role), self.tasks, CurriculumError)
        found = (
            with_mapping(
                one,
                self.tasks[one.target],
                self.tasks[one.source],
                fit_unmapped=self.unmapped_is_free(one.target),
            )
            for one in self.transfers
        )
        object.__setattr__(self, "transfers", tuple(found))
        for transfer in self.transfers:
            for role in ("source", "target"):
                name = getattr(transfer, role)
                if not same_task(self.tasks[name], getattr(transfer.mapping, role)):
                    raise CurriculumError(
                        f"a transfer's mapping must be made for its tasks: the mapping's {role} is "
                        f"not the task {name!r} in {transfer.source} -> {transfer.target}"
                    )
        _ = self.order

    @property
    def target(self) -> str:
        """The task that all others lead to; CurriculumError unless there is exactly one."""
        last = self.last_tasks
        if len(last) != 1:
            raise CurriculumError(
                f"a curriculum must have one task that no other builds on: got {', '.join(last)}"
            )
        return last[0]

    @property
    def last_tasks(self) -> tuple[str, ...]:
        """The tasks that no other builds on."""
        sources = {transfer.source for transfer in self.transfers}
        return tuple(name for name in self.tasks if name not in sources)

    def __repr__(self) -> str:
        return graph_in_brief(self)

    @cached_property
    def order(self) -> tuple[str, ...]:
        """The tasks' names, every source before its targets."""
        graph: dict[str, list[str]] = {name: [] for name in self.tasks}
        for transfer in self.transfers:
            graph[transfer.target].append(transfer.source)
        try:
            return tuple(TopologicalSorter(graph).static_order())
        except CycleError as error:
            cycle = " -> ".join(error.args[1])
            raise CurriculumError(f"a curriculum must have no cycle: {cycle}") from None

    def in_edges(self, name: str) -> tuple[Transfer, ...]:
        """Return the transfers into a task."""
        one_of("a task", name, self.tasks, CurriculumError)
        return tuple(t for t in self.transfers if t.target == name)

    def calibration(self, name: str) -> Calibrate | None:
        """Return how the potential of a task is calibrated; None if it is not."""
        settings = {transfer.calibration for transfer in self.in_edges(name)}
        if len(settings) > 1:
            raise CurriculumError(
                "all transfers into a task are calibrated together and must agree on it: those "
                f"into {name!r} do not"
            )
        calibration = settings.pop() if settings else None
        if calibration is not None and isinstance(self.tasks[name], Miniatures):
            raise CurriculumError(
                f"a calibration takes steps in a task, and miniatures take none: a transfer into "
                f"{name!r} has calibrate={calibration}"
            )
        return calibration

    def unmapped_is_free(self, name: str) -> bool:
        """Return whether a mapping that is found may state a value where it knows nothing.

        Not where several transfers lead into a task: each is to be skipped where it knows nothing.
        """
        return len(self.in_edges(name)) == 1

    def ancestors(self, name: str) -> tuple[str, ...]:
        """Return the tasks that have to be trained before `name`, in training order."""
        one_of("a task", name, self.tasks, CurriculumError)
        wanted = {name}
        for node in reversed(self.order):
            if node in wanted:
                wanted.update(t.source for t in self.in_edges(node))
        return tuple(node for node in self.order if node in wanted and node != name)
