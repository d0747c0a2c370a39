"""A study's configuration: its tables, and the curricula that they say."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import (
    BeforeValidator,
    Field,
    PrivateAttr,
    ValidationError,
    WrapValidator,
    model_validator,
)

from curricle.checks import listed
from curricle.comparison.controls import Control
from curricle.comparison.plan import from_scratch, scratch_curricula
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.defaults import DEFAULT_STEPS
from curricle.deep.learner import DeepLearner
from curricle.display import block, shortened, table as html_table
from curricle.errors import ConfigError, CurricleError, SettingError
from curricle.learning.stopping import limits, spacing
from curricle.statistics.curves import SCRATCH
from curricle.study.config.merging import Positions, Problems, path_text
from curricle.study.config.settings import AnyLearner, Settings, TransferTable
from curricle.study.config.sweeps import SweepTable, TuneTable, Tuning
from curricle.study.config.tables import (
    Count,
    Flag,
    KeyPath,
    Name,
    NameGraph,
    Number,
    Table,
    Whole,
    as_table,
    built,
    seeds_of,
    table,
    unknown,
    wrong_at,
)
from curricle.study.config.tasks import TASKS, AnyTask, FamilyTable, FamilyTask, started
from curricle.study.record import VariantRecord
from curricle.tasks.families.family import FamilyMember
from curricle.text_tables import counted

# -- The tables of a study: as a file writes them, and as they are with all settings filled in -----

Unvalidated = WrapValidator(lambda value, _: as_table(value))
"""A table that is validated only once it is complete, but is in the JSON Schema."""


class RunTable(Table):
    """How a study is run and read: its top-level keys that are no settings of tasks."""

    name: Name = Field(description="Name of the study.")
    seeds: Annotated[
        tuple[int, ...], BeforeValidator(seeds_of, json_schema_input_type=int | str | list[int])
    ] = Field(default=tuple(range(30)), description='How many, a list, or ranges such as "0-29".')
    seeds_per_unit: Count = Field(
        default=5, description="Seeds trained together as one unit of work."
    )
    threshold: Number | None = Field(
        default=None, description="Return at which the target counts as learnt."
    )
    window: Count = Field(default=5, description="Checkpoints over which curves are smoothed.")
    snapshots: Whole = Field(
        24, ge=0, description="Value tables of the first seed kept during training, for the report."
    )
    scratch: Flag = Field(
        default=True, description="Whether learning the target from scratch is an arm too."
    )
    scratch_learners: dict[Name, AnyLearner] = Field(
        default={},
        description="Further learners from scratch by name, each what it changes in the target's.",
    )
    controls: tuple[Control, ...] | None = Field(
        default=None,
        description="Controls of every arm: arms that equal it except for what should help.",
    )


class ArmTables(Table):
    """The curriculum of one arm: tasks, each with all its settings, and transfers."""

    tasks: dict[str, AnyTask] = Field(min_length=1)
    transfers: tuple[TransferTable, ...] = ()

    @model_validator(mode="after")
    def _all_fits(self) -> Self:
        """Refuse keys for observations in tables' tasks and transfers, and vice versa."""
        found: list[tuple[KeyPath, str]] = []
        for name, task in self.tasks.items():
            found += [(("tasks", name, *path), text) for path, text in task.mismatches(name)]
        for index, transfer in enumerate(self.transfers):
            if not {transfer.source, transfer.target} <= self.tasks.keys():
                continue  # reported with the names
            here, target = ("transfers", index), self.tasks[transfer.target]
            if self.tasks[transfer.source].deep and not target.deep:
                text = f"must have tables as its target has: {transfer.source} is seen through "
                found.append(((*here, "source"), text + "observations"))
            strangers = [
                one
                for one in (transfer.source, transfer.target)
                if not isinstance(self.tasks[one], FamilyTask)
            ]
            if transfer.mapping == "family" and strangers:
                text = f"must map members of a family: {strangers[0]} is none"
                found.append(((*here, "mapping"), text))
            mismatches = transfer.mismatches(deep=target.deep)
            found += [((*here, key), text) for key, text in mismatches]
        if found:
            raise wrong_at(*found)
        return self

    @classmethod
    def known(cls) -> tuple[str, ...]:
        """Return the keys that a file may give an arm, settings for all tasks included."""
        return (*cls.model_fields, *Settings.model_fields)


class ArmPatch(Settings):
    """An arm as written: what it changes in the study's curriculum."""

    tasks: dict[str, dict[str, Any]] = Field(default={}, description="Changes of tasks, by name.")
    transfers: list[int] | list[TransferTable] | dict[str, dict[str, Any]] = Field(
        default=[],
        description="Which of the study's transfers to keep, by number from 0; others instead; or "
        "changes of some, by number.",
    )


class FileTable(RunTable, Settings):
    """A study as it is written in a file."""

    families: dict[str, FamilyTable] = Field(
        default={}, description="Families of tasks by name, each with defaults of its own."
    )
    tasks: dict[str, Annotated[AnyTask, Unvalidated]] = Field(
        description="The tasks by name, each with settings of its own.", min_length=1
    )
    transfers: tuple[TransferTable, ...] = Field(
        default=(), description="The transfers between tasks."
    )
    scratch_learners: dict[Name, Annotated[AnyLearner, Unvalidated]] = Field(
        default={},
        description="Further learners from scratch by name, each what it changes in the target's.",
    )
    arms: dict[str, Annotated[ArmPatch, Unvalidated]] = Field(
        default={}, description="What is compared: by name, what each changes; one arm by default."
    )
    sweep: SweepTable = Field(
        default=SweepTable(), description="Lists of settings, which make arms of every arm."
    )
    tune: TuneTable | None = Field(
        default=None, description="Settings that are searched for every arm before it is run."
    )


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of study files, for editors that complete and check TOML."""
    schema = FileTable.model_json_schema()
    for definition in schema["$defs"].values():
        if (title := definition.get("title")) in _TASK_TITLES:
            # An arm may give what a task leaves open, but for its type.
            definition["required"] = ["family" if title == FamilyTask.__name__ else "type"]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "Curricle study",
    }


_TASK_TITLES = {task.__name__ for task in TASKS}


# -- From the tables of an arm to its :class:`Curriculum` ------------------------------------------

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
        alone = sum(transfer.target == target for transfer in self.arm.transfers) == 1
        return alone and settings["unknown_value"].get(target) is None

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


# -- What a study file says, complete and checked, and the curricula that it describes -------------


class StudyConfig(RunTable):
    """A study of which nothing is left to fill in: every arm is complete, every map is there.

    :func:`read_study` makes it from a file, :meth:`from_data` from :meth:`to_data`. Two files with
    one meaning give equal configurations, and a study's results depend on nothing else but the
    modules of its own functions.

    Parameters
    ----------
    name, seeds, seeds_per_unit, threshold, window, snapshots, scratch, scratch_learners, controls
        The keys of a study file.
    arms : dict of str to ArmTables
        The tasks and transfers of each arm.
    scratches : dict of str to ArmTables, optional
        The arms that learn the target from scratch, where a sweep or a tuning gives them settings;
        else they follow from the first arm.
    variants : dict of str to VariantRecord, optional
        The settings of each arm that a sweep or a tuning gave it, scratch included.
    tune : Tuning, optional
        What is to be searched for every arm before the study is run.
    own_learners : bool, optional
        Whether each arm may learn the target in its own way, as it was tuned.
    total : int, optional
        Steps that every arm spends at least, sources included.

    Examples
    --------
    >>> study = StudyConfig.from_data(
    ...     {"name": "line", "arms": {"transfer": {
    ...         "tasks": {"line": {"type": "maze", "map": "S..T"}}}}}, Path())
    >>> study.curriculum("transfer").target
    'line'
    """

    arms: dict[str, ArmTables]
    scratches: dict[str, ArmTables] | None = None
    variants: dict[str, VariantRecord] | None = None
    tune: Tuning | None = None
    own_learners: Flag | None = None
    total: Count | None = None

    @model_validator(mode="after")
    def _tuned_apart(self) -> Self:
        if self.tune and (both := sorted({*self.tune.seeds} & {*self.seeds})):
            text = f"must be none of the study's seeds: {both[0]} is one"
            raise wrong_at((("tune", "seeds"), text))
        return self

    _folder: Path = PrivateAttr(default=Path())
    _positions: Positions = PrivateAttr(default=Positions("", {}))
    _made: dict[str, Any] = PrivateAttr(default_factory=dict)
    _say: Callable[[str], Any] = PrivateAttr(default=print)

    @classmethod
    def from_data(
        cls,
        data: Mapping[str, Any],
        folder: Path,
        positions: Positions | None = None,
        *,
        say: Callable[[str], Any] = print,
    ) -> Self:
        """Return the configuration that plain data describe, as :meth:`to_data` returns them.

        Parameters
        ----------
        data : dict
        folder : Path
            Of the modules with the study's own functions.
        positions : Positions, optional
            Where in a file things are, for messages.
        say : callable
            Takes each line about a mapping that is found.

        Raises
        ------
        pydantic.ValidationError
        """
        families = table(positions.study.get("families")) if positions else {}
        context = {"folder": folder, "families": tuple(families)}
        config = cls.model_validate(dict(data), context=context)
        config._folder, config._say = folder, say
        config._positions = positions or Positions(config.name, data)
        return config

    def to_data(self) -> dict[str, Any]:
        """Return the configuration as plain data, which JSON can hold.

        Maps are in it, every arm is complete and every setting is given, so that equal data mean
        equal results as long as the study's own functions stay the same.
        """
        return self.model_dump(mode="json", exclude_none=True)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, StudyConfig) and self.to_data() == other.to_data()

    def __repr__(self) -> str:
        seeds, arms = counted(len(self.seeds), "seed"), listed(self.arms)
        return shortened(f"StudyConfig({self.name!r}, {seeds}; arms: {arms})")

    def _repr_html_(self) -> str:
        tasks = [
            (arm, name, one.type, "" if one.budget is None else str(one.budget))
            for arm, tables in self.arms.items()
            for name, one in tables.tasks.items()
        ]
        transfers = [
            (arm, one.source, one.target, str(one.mapping))
            for arm, tables in self.arms.items()
            for one in tables.transfers
        ]
        return block(
            f"Study {self.name!r}, {counted(len(self.seeds), 'seed')}",
            html_table(["arm", "task", "type", "budget"], tasks, wide=["budget"]),
            transfers
            and html_table(["arm", "source", "target", "mapping"], transfers, wide=["mapping"]),
        )

    __hash__ = None  # type: ignore[assignment]

    @property
    def folder(self) -> Path:
        """The folder of the modules with the study's own functions."""
        return self._folder

    @property
    def file(self) -> str:
        """The name of the file that it was read from, without its folder; else the study's name."""
        return Path(self._positions.file).name

    @property
    def results_folder(self) -> str:
        """The name of the folder that results go to by default, FILE-results."""
        return f"{Path(self.file).stem}-results"

    @cached_property
    def curricula(self) -> dict[str, Curriculum]:
        """The curricula of all arms, by name.

        Raises
        ------
        ConfigError
            Naming all that cannot be built.
        """
        return self._built(self.arms)

    def scratch_curricula(self) -> dict[str, Curriculum]:
        """Return the arms that learn the target from scratch, ``scratch`` first.

        Raises
        ------
        ConfigError
            Naming each learner that does not fit the target, or is its own.
        """
        if self.scratches is not None:
            return self._built(self.scratches)
        first, found = next(iter(self.curricula.values())), Problems(self._positions)
        made = {SCRATCH: from_scratch(first)}
        for name, learner in self.scratch_learners.items():
            try:
                made |= scratch_curricula({name: built(learner, self.folder)}, first)
            except CurricleError as error:
                found.add([(("scratch_learners", name), f"cannot be compared: {error}")])
        found.raise_any()
        return made

    def curriculum(self, arm: str) -> Curriculum:
        """Return the curriculum of one arm; ConfigError as in :attr:`curricula`."""
        if arm not in self.arms:
            raise ConfigError(f"{self._positions.file}: arm {arm!r} {unknown(arm, self.arms)}")
        return self._built({arm: self.arms[arm]})[arm]

    def check_networks(self) -> None:
        """Check the learners that are networks with Stable-Baselines3.

        Raises
        ------
        SettingError
            When there is such a learner, and Stable-Baselines3 is not installed.
        ConfigError
            Naming each algorithm, setting and kind of shaping that it does not support.
        """
        found = Problems(self._positions)
        for arm, curriculum in self.curricula.items():
            for name in curriculum.order:
                learner, shaping = (curriculum.setting(s, name) for s in ("learner", "shaping"))
                if not isinstance(learner, DeepLearner):
                    continue
                try:
                    with found.at(arm, ("tasks", name, "learner")):
                        learner.algorithm_class()
                        from curricle.deep.models import check_learner

                        edges = curriculum.in_edges(name)
                        sources = dict.fromkeys(edge.source for edge in edges)
                        tables = [one for one in sources if not curriculum.node(one).deep]
                        check_learner(learner, shaping if edges else None, tables)
                except ImportError as error:  # it names what to install
                    raise SettingError(f"a task is learnt by a network: {error}") from None
        found.raise_any()

    def varied(self, **fields: Any) -> Self:
        """Return the study with some fields in plain data in the place of its own.

        Raises
        ------
        ConfigError
            Naming the first field that does not fit.
        """
        data = {**self.to_data(), **fields}
        try:
            made = self.from_data(data, self._folder, self._positions, say=self._say)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            place = path_text(first["loc"])
            raise ConfigError(f"{self._positions.file}: {place} {first['msg']}") from None
        made._made = self._made
        return made

    def _built(self, arms: Mapping[str, ArmTables]) -> dict[str, Curriculum]:
        found, curricula = Problems(self._positions), {}
        for arm, tables in arms.items():
            refuse = partial(found.at, arm)
            builder = CurriculumBuilder(tables, self.folder, self._made, refuse, self._say)
            curricula[arm] = builder.curriculum()
        found.raise_any()
        return {arm: made for arm, made in curricula.items() if made is not None}
