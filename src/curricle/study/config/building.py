"""From the tables of an arm to its :class:`Curriculum`."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.defaults import DEFAULT_STEPS, SETTINGS
from curricle.learning.stopping import limits, spacing
from curricle.study.config.families import FamilyTask
from curricle.study.config.settings import Settings
from curricle.study.config.start_states import started
from curricle.study.config.study_tables import ArmTables
from curricle.study.config.tables import KeyPath
from curricle.study.config.task_names import NameGraph
from curricle.tasks.families.family import FamilyMember

Refuse = Callable[[KeyPath], AbstractContextManager[None]]
"""A key path in the arm -> a context that collects what the library refuses there."""


class CurriculumBuilder:
    """Builds the curriculum of an arm.

    `folder` has the modules with the study's own functions; `made` the tasks and mappings so far,
    which arms share. `say` takes each line about a mapping that is found.
    """

    def __init__(
        self,
        arm: ArmTables,
        folder: Path,
        made: dict[str, Any],
        refuse: Refuse,
        say: Callable[[str], Any],
    ):
        self.arm, self.folder, self.made, self.refuse, self.say = arm, folder, made, refuse, say
        self.graph = NameGraph(
            {name: getattr(task, "of", None) for name, task in arm.tasks.items()},
            tuple((transfer.source, transfer.target) for transfer in arm.transfers),
        )

    def curriculum(self) -> Curriculum | None:
        """Return the curriculum; None where something was refused."""
        arm, learnt = self.arm, self.graph.learnt
        tasks, settings = self._tasks(), self._settings()
        transfers, made = [], 0
        for index, transfer in enumerate(arm.transfers):
            if transfer.source in tasks and transfer.target in tasks:
                with self.refuse(("transfers", index)):
                    target, source = tasks[transfer.target], tasks[transfer.source]
                    fit = self._unmapped_is_free(transfer.target, settings)
                    fitted = transfer.mapping == "auto" and fit
                    free = {"calibrate"} if fitted else {"scale", "shift", "calibrate"}
                    key = f"{fitted} {transfer.model_dump_json(exclude=free)}"
                    key += self._key(transfer.target) + self._key(transfer.source)
                    if key not in self.made:
                        members = [self._member(transfer.target), self._member(transfer.source)]
                        found = transfer.mappings_in(
                            target, source, self.folder, members, fit_unmapped=fit, say=self.say
                        )
                        self.made[key] = found
                    transfers += [transfer.transfer(f) for f in self.made[key]]
                    made += 1
        complete = len(tasks) == len(arm.tasks) and made == len(arm.transfers)
        if complete and all(len(each) == len(learnt) for each in settings.values()):
            with self.refuse(()):
                return Curriculum({name: tasks[name] for name in learnt}, transfers, **settings)
        return None

    def _unmapped_is_free(self, target: str, settings: dict[str, dict[str, Any]]) -> bool:
        """Return the same as the curriculum's ``unmapped_is_free`` will."""
        given = settings["unknown_value"].get(target, SETTINGS["unknown_value"])
        alone = sum(transfer.target == target for transfer in self.arm.transfers) == 1
        return alone and given == SETTINGS["unknown_value"]

    def _tasks(self) -> dict[str, Any]:
        """Return the tasks that could be made, with the mazes that only crops are made of."""
        tasks: dict[str, Any] = {}
        for name in sorted(self.arm.tasks, key=lambda name: len(self.graph.drawings(name))):
            key, of = self._key(name), self.graph.parts[name]
            if of is None or of in tasks:
                with self.refuse(("tasks", name)):
                    if key not in self.made:
                        whole = self._member(name) if of is None else tasks[of]
                        table = self.arm.tasks[name]
                        self.made[key] = started(
                            table.build(self.folder, whole), table.start_states
                        )
                    tasks[name] = self.made[key]
        return tasks

    def _member(self, name: str) -> FamilyMember | None:
        """Return the address of a task in its family, one for all arms; None if it has none."""
        one, key = self.arm.tasks[name], f"member {self._key(name)}"
        if isinstance(one, FamilyTask) and key not in self.made:
            self.made[key] = one.member(self.folder)
        return self.made.get(key)

    def _key(self, name: str) -> str:
        """Return all that a task depends on: its own keys, and the mazes that it is a part of."""
        drawings = [self.arm.tasks[drawing] for drawing in self.graph.drawings(name)]
        return repr([one.model_dump_json(exclude=set(Settings.model_fields)) for one in drawings])

    def _settings(self) -> dict[str, dict[str, Any]]:
        """Return each setting of each task that is learnt, as far as it could be made."""
        settings: dict[str, dict[str, Any]] = {which: {} for which in Settings.model_fields}
        are_sources, with_sources = ({edge[i] for edge in self.graph.edges} for i in (0, 1))
        for name in self.graph.learnt:
            found: dict[str, Any] = {}
            for which in settings:
                with self.refuse(("tasks", name, which)):
                    value = self.arm.tasks[name].setting(which, self.folder)
                    if which == "budget" and value is None and name not in are_sources:
                        value = DEFAULT_STEPS
                    _check(which, value, found, name in with_sources)
                    found[which] = settings[which][name] = value
        return settings


def _check(which: str, value: Any, found: dict[str, Any], has_sources: bool) -> None:
    """Check a setting with those before it, as :class:`Curriculum` will, to report its key."""
    if which == "budget" and value is not None:
        limits(value)
    if which == "eval_freq" and found.get("budget") is not None:
        spacing(value, found["budget"])
    if which == "shaping" and has_sources and value is not None and "learner" in found:
        value.check(found["learner"])
