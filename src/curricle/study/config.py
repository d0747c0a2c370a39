"""A study's configuration: its tables, reading a file into them, and the curricula they describe.

A file is validated twice: as it is written (:class:`FileTable`), to find unused keys; and with
complete arms (:class:`StudyConfig`), which is what is run, stored and hashed into keys.
"""

import ast
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from copy import deepcopy
from dataclasses import replace
from functools import cache, cached_property, wraps
from graphlib import CycleError, TopologicalSorter
from inspect import getsource, signature
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Concatenate, ParamSpec, Self, TypeVar

from pydantic import (
    BeforeValidator,
    Field,
    PrivateAttr,
    ValidationError,
    WrapValidator,
    model_validator,
)

from curricle.candidates.candidates import candidate_named
from curricle.checks import listed, unfit_name
from curricle.comparison.choice import FIRST_SEED
from curricle.comparison.comparison import compare as compare_curricula
from curricle.comparison.controls import Control
from curricle.comparison.forecasting import forecast as forecast_curriculum
from curricle.comparison.opponents import OPPONENTS, Opponent, from_scratch, scratch_curricula
from curricle.curriculum.curriculum import DEFAULT_STEPS, Curriculum
from curricle.errors import ConfigError, CurricleError, SettingError
from curricle.files import results_folder
from curricle.learning.stopping import limits, spacing
from curricle.statistics.curves import SCRATCH
from curricle.study.record import TunedRecord, VariantRecord
from curricle.study_file.file import (
    SETTINGS,
    Positions,
    Problems,
    assignment,
    complete_curriculum,
    complete_learners,
    merged,
    names_in,
    path_text,
    toml_of,
)
from curricle.study_file.own_code import suggestion, users_code
from curricle.study_file.schema import (
    AnyLearner,
    Count,
    Flag,
    KeyPath,
    Name,
    NameGraph,
    Number,
    Settings,
    Table,
    TransferTable,
    Whole,
    as_table,
    built,
    seeds_of,
    shown,
    table,
    unknown,
    wrong_at,
)
from curricle.study_file.task_tables import TASKS, AnyTask, FamilyTask, started
from curricle.study_file.vary import (
    SWEEP_HOME,
    Messages,
    SweepTable,
    TuneTable,
    varied_arms,
    wrong_sweep,
    wrong_tuning,
)
from curricle.text import counted, printed, shortened
from curricle.transfer.by_components import member_mappings
from curricle.transfer.potential import written_potential

ONLY_ARM = "transfer"  # the name of the arm of a study without arms
Made = TypeVar("Made")

# -- The tables of a study: as written in a file, and with all settings filled in ------------------

Unvalidated = WrapValidator(lambda value, _: as_table(value))
"""Type of a table that is in the JSON Schema, but is validated only when it is complete."""


class RunTable(Table):
    """The top-level keys that are not settings of tasks: how a study is run and compared."""

    name: Name
    """Name of the study."""
    seeds: Annotated[
        tuple[int, ...], BeforeValidator(seeds_of, json_schema_input_type=int | str | list[int])
    ] = tuple(range(30))
    """The number of seeds, a list of seeds, or ranges such as "0-29"."""
    seeds_per_unit: Count = 5
    """Seeds trained together as one unit of work."""
    threshold: Number | None = None
    """Return at which the target counts as learnt."""
    window: Count = 5
    """Checkpoints over which curves are smoothed."""
    snapshots: Whole = Field(24, ge=0)
    """Value tables of the first seed kept during training, for the report."""
    scratch: Flag = True
    """Whether learning the target from scratch is an arm too."""
    compared: Flag = True
    """Whether all arms spend one total of steps, sources included; else each has its own budget."""
    scratch_learners: dict[str, AnyLearner] = Field({})
    """Further learners from scratch by name, each what it changes in the target's."""
    opponents: tuple[Opponent, ...] | None = None
    """The learners from scratch that play beside the target's own; all of them by default."""
    controls: tuple[Control, ...] | None = None
    """Controls of every arm: arms that equal it except for what should help."""
    choose: Flag | None = None
    """Whether the arm is chosen first, by trials of candidate sources of the target and of the arms
    that the file has."""


MOST_TRANSFERS = 1_000  # of a study or an arm, each of which has a mapping
Transfers = Annotated[tuple[TransferTable, ...], Field(max_length=MOST_TRANSFERS)]


class ArmTables(Table):
    """The curriculum of one arm: tasks, each with all its settings, and transfers."""

    tasks: dict[str, AnyTask] = Field(min_length=1)
    transfers: Transfers = ()

    @model_validator(mode="after")
    def _all_fits(self) -> Self:
        """Refuse keys for observations at tasks with tables, and keys for tables at other tasks."""
        messages: list[tuple[KeyPath, str]] = []
        for name, task in self.tasks.items():
            messages += [(("tasks", name, *path), text) for path, text in task.mismatches(name)]
        for index, edge in enumerate(self.transfers):
            if not {edge.source, edge.target} <= self.tasks.keys():
                continue  # wrong names are reported elsewhere
            place, target = ("transfers", index), self.tasks[edge.target]
            if self.tasks[edge.source].deep and not target.deep:
                text = f"must have tables as its target has: {edge.source} is seen through "
                messages.append(((*place, "source"), text + "observations"))
            ends = (edge.source, edge.target)
            strangers = [end for end in ends if not isinstance(self.tasks[end], FamilyTask)]
            if edge.mapping == "family" and strangers:
                text = f"must map members of a family: {strangers[0]} is none"
                messages.append(((*place, "mapping"), text))
            source: Any = self.tasks[edge.source]
            of = source.of if source.type == "candidate" else None
            if edge.mapping == "candidate" and of != edge.target:
                text = f"must map to a candidate of {edge.target}: {edge.source} is none"
                messages.append(((*place, "mapping"), text))
            messages += [((*place, key), text) for key, text in edge.mismatches(deep=target.deep)]
        if messages:
            raise wrong_at(*messages)
        return self

    @classmethod
    def known(cls) -> tuple[str, ...]:
        """Return the keys that an arm may have in a file, settings for all tasks included."""
        return (*cls.model_fields, *SETTINGS)


class ArmPatch(Settings):
    """An arm as written in a file: its changes of the study's curriculum."""

    tasks: dict[str, dict[str, Any]] = Field({})
    """Changes of tasks, by name."""
    transfers: list[int] | list[TransferTable] | dict[str, dict[str, Any]] = Field([])
    """Which of the study's transfers to keep, by number from 0; others instead; or changes of some,
    by number."""


class FileTable(RunTable, Settings):
    """A study as written in a file."""

    tasks: dict[str, Annotated[AnyTask, Unvalidated]] = Field(min_length=1)
    """The tasks by name, each with settings of its own."""
    transfers: Transfers = ()
    """The transfers between tasks."""
    scratch_learners: dict[str, Annotated[AnyLearner, Unvalidated]] = Field({})
    arms: dict[str, Annotated[ArmPatch, Unvalidated]] = Field({})
    """What is compared: by name, what each changes; one arm by default."""
    sweep: SweepTable = SweepTable()
    """Lists of settings, which make arms of every arm."""
    tune: TuneTable | None = None
    """Settings that are tried for every arm before it is run."""


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of study files, for editors that complete and check TOML."""
    schema = FileTable.model_json_schema()
    definitions: dict[str, Any] = {**schema["$defs"], FileTable.__name__: schema}
    titles = {task.__name__ for task in TASKS}
    for kind in _subclasses(Table):
        # Not ``use_attribute_docstrings``, which reads source files for half a second at a start.
        properties = definitions.get(kind.__name__, {}).get("properties", {})
        for base in kind.__mro__ if properties else ():
            for key, text in _docstrings(base):
                if key in properties:
                    properties[key].setdefault("description", " ".join(text.split()))
    for definition in schema["$defs"].values():
        if (title := definition.get("title")) in titles:
            # A task may omit every key but its type, because an arm may state it.
            definition["required"] = ["family" if title == FamilyTask.__name__ else "type"]
    dialect = "https://json-schema.org/draft/2020-12/schema"
    return {"$schema": dialect, **schema, "title": "Curricle study"}


def _subclasses(kind: type) -> Iterator[type]:
    subclasses: list[type] = kind.__subclasses__()
    for subclass in subclasses:
        yield from (subclass, *_subclasses(subclass))


@cache
def _docstrings(kind: type) -> list[tuple[str, str]]:
    """Return the fields of a table's class, and the docstrings below them."""
    if not kind.__module__.startswith("curricle.study") or "makes" in vars(kind):
        return []
    (table,) = ast.parse(getsource(kind)).body
    texts = list[tuple[str, str]]()
    for field, below in pairwise(getattr(table, "body", ())):
        match field, below:
            case ast.AnnAssign(target=ast.Name(id=key)), ast.Expr(ast.Constant(str(text))):
                texts.append((key, text))
    return texts


# -- A complete, checked study, and the curricula that it describes --------------------------------


class Trials(Table):
    """The trials of a tuning: the fields in which the study of the trials differs."""

    seeds: tuple[int, ...]
    final_seeds: tuple[int, ...] = ()
    """Seeds on which the best trials of each arm are played again."""
    arms: dict[str, ArmTables]
    scratches: dict[str, ArmTables]
    variants: dict[str, VariantRecord]
    """The arm and the settings of each trial."""


class StudyConfig(RunTable):
    """A complete study: every arm has all its settings, and every map is there.

    :func:`read_study` makes it from a file, :meth:`from_data` from :meth:`to_data`. Results depend
    only on it and on the user's modules that it names.

    Parameters
    ----------
    name, seeds, seeds_per_unit, threshold, window, snapshots
        Keys of a study file.
    scratch, compared, scratch_learners, opponents, controls, choose
        Further keys of a study file.
    arms : dict of str to ArmTables
        The tasks and transfers of each arm.
    scratches : dict of str to ArmTables, optional
        The arms from scratch that a sweep or a tuning made; by default made from the first arm.
    variants : dict of str to VariantRecord, optional
        The settings that a sweep or a tuning gave each arm, scratch included.
    tune : Trials, optional
        The settings that are tried for every arm before the study is run.
    own_learners : bool, optional
        Whether arms may learn the target with different learners, because each was tuned.
    tuned : TunedRecord, optional
        The results of the trials that chose the arms' settings.
    chosen : str, optional
        The printed choice of the arm.

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
    tune: Trials | None = None
    own_learners: Flag | None = None
    tuned: TunedRecord | None = None
    chosen: str | None = None

    @model_validator(mode="after")
    def _tuned_apart(self) -> Self:
        if self.choose and (self.tune or self.variants or not (self.scratch and self.compared)):
            text = "needs the comparison with scratch, and goes with no sweep and no tuning"
            raise wrong_at((("choose",), text))
        if self.choose and max(self.seeds) >= FIRST_SEED:
            raise wrong_at((("seeds",), f"must be below {FIRST_SEED:,}: those are of trials"))
        of_tune = {*self.tune.seeds, *self.tune.final_seeds} if self.tune else set[int]()
        if both := sorted(of_tune & {*self.seeds}):
            text = f"must be none of the study's seeds: {both[0]} is one"
            raise wrong_at((("tune", "seeds"), text))
        return self

    _folder: Path = PrivateAttr(default=Path())
    _positions: Positions = PrivateAttr(default=Positions(""))
    _made: dict[str, Any] = PrivateAttr(default_factory=dict)
    _once: dict[str, Any] = PrivateAttr(default_factory=dict)
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

        `folder` holds the user's modules, messages use `positions`, and `say` is called with lines
        about found mappings. Raises pydantic.ValidationError.
        """
        config = cls.model_validate(dict(data), context={"folder": folder})
        config._folder, config._say = folder, say
        config._positions = positions or Positions(config.name)
        return config

    @cached_property
    def data(self) -> dict[str, Any]:
        """The configuration as plain data, as :meth:`to_data` returns it; only to be read."""
        return self.model_dump(mode="json", exclude_none=True)

    def to_data(self) -> dict[str, Any]:
        """Return the configuration as plain data for JSON, with maps and every setting."""
        return deepcopy(self.data)

    def once(self, name: str, make: Callable[[], Made]) -> Made:
        """Return what `make` returns, made once for this study."""
        if name not in self._once:
            self._once[name] = make()
        made: Made = self._once[name]
        return made

    def __eq__(self, other: object) -> bool:
        return isinstance(other, StudyConfig) and self.data == other.data

    def __repr__(self) -> str:
        seeds, arms = counted(len(self.seeds), "seed"), listed(self.arms)
        return shortened(f"StudyConfig({self.name!r}, {seeds}; arms: {arms})")

    __str__ = __repr__  # pydantic's own prints every setting
    _repr_html_ = printed

    __hash__ = None  # type: ignore[assignment]

    @property
    def folder(self) -> Path:
        """The folder of the user's modules that the study names."""
        return self._folder

    @property
    def file(self) -> str:
        """The name of its file without the folder; the study's name if it has no file."""
        return Path(self._positions.file).name

    @property
    def results_folder(self) -> str:
        """The name of the default folder of its results, FILE-results."""
        return results_folder(self.file)

    @cached_property
    def curricula(self) -> dict[str, Curriculum]:
        """The curricula of all arms by name; ConfigError lists everything that cannot be built."""
        return self._built(self.arms)

    @property
    def played(self) -> tuple[Opponent, ...]:
        """The opponents of the arms; by default none if arms are not compared with scratch."""
        unasked = OPPONENTS if self.compared else ()
        return () if not self.scratch else unasked if self.opponents is None else self.opponents

    def scratch_curricula(self) -> dict[str, Curriculum]:
        """Return the arms that learn the target from scratch, ``scratch`` first.

        ConfigError names each learner that does not fit the target, or equals the target's learner.
        """
        if self.scratches is not None:
            return self._built(self.scratches)
        first, problems = next(iter(self.curricula.values())), Problems(self._positions)
        made = {SCRATCH: from_scratch(first)}
        for name, learner in self.scratch_learners.items():
            try:
                made |= scratch_curricula({name: built(learner, self.folder)}, first)
            except CurricleError as error:
                problems.add([(("scratch_learners", name), f"cannot be compared: {error}")])
        problems.raise_any()
        return made

    def curriculum(self, arm: str) -> Curriculum:
        """Return the curriculum of one arm; ConfigError as in :attr:`curricula`."""
        if arm not in self.arms:
            raise ConfigError(f"{self._positions.file}: arm {arm!r} {unknown(arm, self.arms)}")
        return self._built({arm: self.arms[arm]})[arm]

    def address(self, arm: str, name: str) -> object:
        """Return a task of an arm; if it is a family's member, its address with the same start."""
        self.curriculum(arm)  # makes the tasks of the arm
        return _Builder(arm, self.arms[arm], self, Problems(self._positions)).address(name)

    def check_networks(self) -> None:
        """Check the learners that are networks with Stable-Baselines3.

        SettingError when it is needed but not installed; ConfigError names each algorithm, setting
        and shaping that it does not support.
        """
        problems = Problems(self._positions)
        for arm, curriculum in self.curricula.items():
            for name in curriculum.order:
                try:
                    with problems.at("arms", arm, "tasks", name, "learner"):
                        curriculum.check_network(name)
                except ImportError as error:  # it names what to install
                    raise SettingError(f"a task is learnt by a network: {error}") from None
        problems.raise_any()

    def varied(self, **fields: Any) -> Self:
        """Return the study with other `fields`, plain data; ConfigError names an invalid field."""
        data = {**self.data, **fields}
        try:
            made = self.from_data(data, self._folder, self._positions, say=self._say)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            place = path_text(first["loc"])
            raise ConfigError(f"{self._positions.file}: {place} {first['msg']}") from None
        made._made = self._made
        return made

    @cached_property
    def trials(self) -> Self:
        """The study whose arms are the trials of this study's tuning."""
        fields = {**self.data["tune"], "controls": None, "tune": None, "own_learners": True}
        del fields["final_seeds"]
        made = self.varied(**fields, opponents=(), snapshots=0)
        trials = {
            (False, name): of for (trial, name), of in self._positions.varied.items() if trial
        }
        made._positions = replace(self._positions, varied=trials)
        return made

    def _built(self, arms: Mapping[str, ArmTables]) -> dict[str, Curriculum]:
        problems = Problems(self._positions)
        curricula = {
            arm: _Builder(arm, tables, self, problems).curriculum() for arm, tables in arms.items()
        }
        problems.raise_any()
        return {arm: made for arm, made in curricula.items() if made is not None}


class _Builder:
    """Builds the curriculum of an arm; arms of a study share the tasks and mappings it made."""

    def __init__(self, name: str, arm: ArmTables, study: StudyConfig, problems: Problems):
        self.name, self.arm, self.study, self.problems = name, arm, study, problems
        self.made, self.folder = study._made, study.folder
        self.graph = NameGraph(
            {name: getattr(task, "of", None) for name, task in arm.tasks.items()},
            tuple((edge.source, edge.target) for edge in arm.transfers),
        )

    def curriculum(self) -> Curriculum | None:
        """Return the curriculum; None if any part of it was refused."""
        learnt, before = self.graph.learnt, len(self.problems.messages)
        tasks = self._tasks()
        settings = self._settings(tasks)
        transfers = list[Any]()
        for index, edge in enumerate(self.arm.transfers):
            if edge.source in tasks and edge.target in tasks:
                with self._refused("transfers", index):
                    transfers += [edge.transfer(f) for f in self._mappings(edge, tasks, settings)]
        if len(self.problems.messages) == before:
            with self._refused():
                return Curriculum({name: tasks[name] for name in learnt}, transfers, **settings)
        return None

    def _refused(self, *path: str | int) -> AbstractContextManager[None]:
        return self.problems.at("arms", self.name, *path)

    def _mappings(
        self, edge: TransferTable, tasks: dict[str, Any], settings: dict[str, dict[str, Any]]
    ) -> tuple[object, ...]:
        """Return the mappings of a transfer; arms with equal transfers share them."""
        target, source = tasks[edge.target], tasks[edge.source]
        # As a curriculum does.
        alone = sum(other.target == edge.target for other in self.arm.transfers) == 1
        fit = alone and settings["unknown_value"].get(edge.target) is None
        fitted = edge.mapping == "auto" and fit
        free = set[str]() if fitted else {"scale", "shift"}
        key = f"{fitted} {edge.model_dump_json(exclude=free)}"
        key += self._key(edge.target) + self._key(edge.source)
        if key not in self.made:
            to, of = self._member(edge.target), self._member(edge.source)
            if edge.mapping == "candidate":
                mappings = of.mappings
            elif edge.mapping == "family" and to is not None and of is not None:
                with users_code(f"the mapping of {to.family.name}"):
                    mappings = member_mappings(to, of, target, source, edge.unmapped_value)
            else:
                say = self.study._say
                mappings = (
                    edge.mapping_in(target, source, self.folder, fit_unmapped=fit, say=say),
                )
            self.made[key] = mappings
        return self.made[key]  # type: ignore[no-any-return]

    def _tasks(self) -> dict[str, Any]:
        """Return the tasks that could be made, mazes that are only cropped included."""
        tasks: dict[str, Any] = {}
        for name in sorted(self.arm.tasks, key=lambda name: len(self.graph.drawings(name))):
            key, of, task = self._key(name), self.graph.parts[name], self.arm.tasks[name]
            if of is None or of in tasks:
                with self._refused("tasks", name):
                    if key not in self.made:
                        whole = tasks[of] if of and task.type == "crop" else self._member(name)
                        self.made[key] = started(task.build(self.folder, whole), task.start_states)
                    tasks[name] = self.made[key]
        return tasks

    def _member(self, name: str) -> Any:
        """Return the family member or candidate of a task, if it is either; arms share it."""
        task, key = self.arm.tasks[name], f"member {self._key(name)}"
        if isinstance(task, FamilyTask) and key not in self.made:
            self.made[key] = task.member(self.folder)
        if task.type == "candidate" and key not in self.made:
            of = self.address(task.of)
            self.made[key] = candidate_named(of, task.kind, task.candidate)
        return self.made.get(key)

    def address(self, name: str) -> Any:
        """Return a task that was made; if it is a family's member, its address with its start."""
        task = self.arm.tasks[name]
        by_family = isinstance(task, FamilyTask) and not task.start_states
        return self._member(name) if by_family else self.made[self._key(name)]

    def _key(self, name: str) -> str:
        """Return the data on which a task depends: its keys, and the mazes it is cropped from."""
        drawings = [self.arm.tasks[drawing] for drawing in self.graph.drawings(name)]
        return repr([drawing.model_dump_json(exclude=set(SETTINGS)) for drawing in drawings])

    def _potential(self, name: str, task: Any, function: object, sources: list[str]) -> Any:
        """Return the potential of a task by hand; arms with equal tasks share it."""
        reference = self.arm.tasks[name].potential
        key = f"{reference} {sources} {self._key(name)}"
        if key not in self.made:
            with users_code(reference):
                self.made[key] = written_potential(name, task, function, sources)
        return self.made[key]

    def _settings(self, tasks: dict[str, Any]) -> dict[str, dict[str, Any]]:
        """Return the settings of all learnt tasks, as :class:`Curriculum` takes and checks them."""
        settings: dict[str, dict[str, Any]] = {which: {} for which in SETTINGS}
        are_sources = {source for source, _ in self.graph.edges}
        for name in self.graph.learnt:
            sources = [source for source, target in self.graph.edges if target == name]
            for which in SETTINGS:
                with self._refused("tasks", name, which):
                    value = self.arm.tasks[name].setting(which, self.folder)
                    if which == "budget" and value is None and name not in are_sources:
                        value = DEFAULT_STEPS
                    if which == "budget" and value is not None:
                        limits(value)
                    if which == "eval_freq" and settings["budget"].get(name) is not None:
                        spacing(value, settings["budget"][name])
                    learner = settings["learner"].get(name)
                    informed = sources or settings["potential"].get(name) is not None
                    if which == "shaping" and informed and None not in (value, learner):
                        value.check(learner)
                    if which == "potential" and value is not None and name in tasks:
                        value = self._potential(name, tasks[name], value, sources)
                    settings[which][name] = value
        return settings


# -- From a file to its configuration, or to a sentence for every mistake --------------------------


def read_study(
    path: str | PathLike[str], *, set: Sequence[str] = (), arms: Sequence[str] = ()
) -> StudyConfig:
    r"""Return the study that a TOML file describes.

    Tasks and curricula are built at first use.

    Parameters
    ----------
    path : path
    set : sequence of str
        Changes such as ``"tasks.chase.budget=1000"``: a dotted key and a value, TOML or else text.
    arms : sequence of str
        The arms of the file to keep; by default all arms.

    Raises
    ------
    ConfigError
        With a line for each mistake: file, line, key path and what is wrong.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "maze.toml"
    ...     _ = path.write_text('name = "maze"\ntasks.maze = { type = "maze", map = "S..T" }')
    ...     study = read_study(path, set=["seeds=2", "budget=1000"])
    >>> study.curriculum("transfer").train(study.seeds)["maze"].steps_used
    array([1000, 1000])
    """
    if not isinstance(path, str | PathLike):
        raise ConfigError(f"a study file must be a path: got {path!r}")
    if isinstance(set, str):
        raise ConfigError(f"set must be a list of settings, each key=value: got {set!r}")
    file = Path(path)
    text, study = toml_of(file)
    changed = list[KeyPath]()
    for change in set:
        keys, value = assignment(change)
        place: KeyPath = keys
        if len(keys) > 1 and keys[0] in ("tasks", "arms", "transfers"):
            number, names = keys[0] == "transfers" and keys[1].isdecimal(), names_in(study, keys[0])
            place = (keys[0], int(keys[1]) if number else keys[1], *keys[2:])
            if keys[1] not in names:
                positions = Positions(str(file), changed=(place[:2],))
                raise ConfigError(positions.sentence(place[:2], unknown(keys[1], names)))
        changed.append(place)
        study = merged(study, value)
    known_arms = table(study.get("arms")) or {ONLY_ARM: {}}
    for arm in arms:
        if arm not in known_arms:
            raise ConfigError(f"{file}: arm {arm!r} {unknown(arm, known_arms)}")
    if arms:
        study["arms"] = {arm: patch for arm, patch in known_arms.items() if arm in arms}
    return configured(study, file.parent, Positions(str(file), text, tuple(changed)))


def configured(study: dict[str, Any], folder: Path, positions: Positions) -> StudyConfig:
    """Return the configuration of a study as it was read; ConfigError lists all its mistakes."""
    problems = Problems(replace(positions, study=study))
    arms = table(study.get("arms")) or {ONLY_ARM: {}}
    complete = {arm: complete_curriculum(study, patch) for arm, patch in arms.items()}
    fields: dict[str, Any] = {key: study[key] for key in RunTable.model_fields if key in study}
    if "scratch_learners" in fields:
        fields["scratch_learners"] = complete_learners(study, next(iter(complete.values())))
    with problems.at():
        FileTable.model_validate(study, context={"folder": folder})
    problems.add(_wrong_arms(study, complete))
    for arm, curriculum in complete.items():
        problems.add(_wrong_names(curriculum), "arms", arm)
    problems.add([*wrong_sweep(study, complete), *wrong_tuning(study, complete)])
    fields["arms"] = complete
    if {"sweep", "tune"} & study.keys() and not problems.messages:
        varied, settings = varied_arms(study, complete)
        problems.positions = replace(problems.positions, varied=settings)
        unfit = {name: why for _, name in settings if (why := unfit_name(name))}
        problems.add((SWEEP_HOME, f"makes an arm with a name that {why}") for why in unfit.values())
        fields |= varied
    config: StudyConfig | None = None
    with problems.at(mapped=True):
        config = StudyConfig.from_data(fields, folder, problems.positions)
    problems.raise_any()
    assert config is not None, "a configuration without mistakes is complete"
    return config


def _wrong_arms(study: dict[str, Any], complete: dict[str, Any]) -> Messages:
    """Yield the mistakes in arms and further learners from scratch as written in a file."""
    tasks, transfers = table(study.get("tasks")), study.get("transfers")
    transfers = transfers if isinstance(transfers, list) else []
    learners = table(study.get("scratch_learners"))
    targets = {arm: NameGraph.of(curriculum).targets for arm, curriculum in complete.items()}
    for arm, written in table(study.get("arms")).items():
        place, patch, silent = ("arms", arm), table(written), True
        if why := unfit_name(arm):
            yield place, f"has a name that {why}"
        if arm == SCRATCH:
            yield place, "must have another name: it is the arm without sources"
        if arm in {f"{SCRATCH}, {name}" for name in learners}:
            yield place, "must have another name: a learner has it"
        for name in table(patch.get("tasks")):
            if name not in tasks:
                silent = False
                yield (*place, "tasks", name), unknown(name, tasks)
        chosen = patch.get("transfers")
        for index, entry in enumerate(chosen if isinstance(chosen, list | dict) else []):
            number = int(entry) if isinstance(entry, str) and entry.isdecimal() else entry
            if isinstance(entry, dict) or (type(number) is int and 0 <= number < len(transfers)):
                continue
            silent, path = False, (*place, "transfers")
            text = f"must name transfers of the study by number, below {len(transfers)}: got "
            yield (*path, index) if isinstance(chosen, list) else path, text + shown(entry)
        if patch and silent and complete[arm] == complete_curriculum(study):
            yield place, "changes nothing: its settings are the study's, or a task has its own"
    single = {arm: last[0] for arm, last in targets.items() if len(last) == 1}
    if len({*single.values()}) > 1:
        by_arm = ", ".join(f"{arm} has {target}" for arm, target in single.items())
        yield ("arms",), f"must all have the same target: {by_arm}"
    if learners and study.get("scratch") is False:
        yield ("scratch_learners",), "are compared with the target's own: leave out scratch = false"
    for name in learners:
        if why := unfit_name(name):
            yield ("scratch_learners", name), f"has a name that {why}"


DRAWN = ("maze", "crop", "four_rooms", "key_lock_pit", "family")  # types that a crop can have


def _wrong_names(plan: dict[str, Any]) -> Messages:
    """Yield mistakes in the names of a curriculum, which may be malformed elsewhere."""
    graph, whole = NameGraph.of(plan), True
    tasks, transfers = table(plan.get("tasks")), plan.get("transfers")

    def no_task(name: str) -> str:
        return f"must name a task: got {shown(name)}{suggestion(name, graph.parts)}"

    for name, task in tasks.items():
        if why := unfit_name(name):
            yield ("tasks", name), f"has a name that {why}"
        of, path = table(task).get("of"), ("tasks", name, "of")
        if table(task).get("type") in ("crop", "candidate") and isinstance(of, str):
            drawings = graph.drawings(name)
            if of not in graph.parts:
                yield path, no_task(of)
            elif table(task)["type"] == "crop" and table(tasks[of]).get("type") not in DRAWN:
                yield path, f"must name a task of type {', '.join(DRAWN)}: got {shown(of)}"
            elif graph.parts.get(drawings[-1]) is not None:
                yield path, f"must lead to a whole task: got {' of '.join(drawings)} and so on"
    for index, edge in enumerate(transfers if isinstance(transfers, list) else []):
        for role in ("source", "target"):
            wanted = table(edge).get(role)
            if isinstance(wanted, str) and wanted not in graph.parts:
                yield ("transfers", index, role), no_task(wanted)
            whole = whole and isinstance(wanted, str) and wanted in graph.parts
    if not whole:
        return
    sources = {name: [s for s, target in graph.edges if target == name] for name in graph.parts}
    try:
        TopologicalSorter(sources).prepare()
    except CycleError as error:
        yield ("transfers",), f"must have no cycle: got {' -> '.join(error.args[1])}"
        return
    if graph.parts and len(graph.targets) != 1:
        several = ", ".join(graph.targets) or "none"
        missing = "a transfer to the next task may be missing"
        yield ("tasks",), f"must have one that no other builds on: got {several}; {missing}"


# -- Functions of curricula that also take a study or the path of its file -------------------------

Study = StudyConfig | str | PathLike[str]  # a study, or the path of its file
FORECAST_SEEDS = 3  # first seeds of a study to forecast with, as many as by default
Subject = TypeVar("Subject")
Rest = ParamSpec("Rest")
Result = TypeVar("Result")


def study_of(study: Study) -> StudyConfig:
    """Return a study as it is, or the study that a file describes; ConfigError lists mistakes."""
    if isinstance(study, StudyConfig):
        return study
    if not isinstance(study, str | PathLike):
        raise SettingError(f"study must be a StudyConfig or the path of a file: got {study!r}")
    return read_study(study)


def of_studies(
    function: Callable[Concatenate[Subject, Rest], Result],
    arguments: Callable[[StudyConfig], tuple[Subject, dict[str, Any]]],
) -> Callable[Concatenate[Subject | Study, Rest], Result]:
    """Return a function that also takes a study; `arguments` turns a study into arguments."""
    first = next(iter(signature(function).parameters))

    @wraps(function)
    def of_either(*args: Any, **settings: Any) -> Any:
        if first in settings:
            args = (settings.pop(first), *args)
        if args and isinstance(args[0], StudyConfig | str | PathLike):
            subject, said = arguments(study_of(args[0]))
            args, settings = (subject, *args[1:]), {**said, **settings}
        return function(*args, **settings)

    return of_either


def rivals(study: StudyConfig) -> dict[str, Any]:
    """Return a study's opponents and scratch learners as arguments of compare and forecast."""
    scratch = {name: built(table, study.folder) for name, table in study.scratch_learners.items()}
    return {"scratch": scratch, "opponents": study.played}


def _compared(study: StudyConfig) -> tuple[Any, dict[str, Any]]:
    settings = {"[tune]": study.tune, "choose = true": study.choose}
    settings |= {"scratch = false": not study.scratch, "compared = false": not study.compared}
    settings |= {"a sweep of learners": len(study.scratches or ()) > 1}
    if left_out := [setting for setting, stated in settings.items() if stated]:
        raise ConfigError(
            f"compare would leave out {listed(left_out)} of {study.name!r}: "
            "run_study(study, FOLDER) plays a study as its file says"
        )
    said = {"seeds": study.seeds, "threshold": study.threshold, "window": study.window}
    return study.curricula, {**said, **rivals(study), "controls": study.controls or ()}


def _foreseen(study: StudyConfig) -> tuple[Any, dict[str, Any]]:
    arm, *further_arms = study.arms
    if further_arms:
        raise ConfigError(
            "a forecast is of one arm: call forecast(study.curriculum(ARM)), where study is "
            f"read_study(FILE) and ARM one of {listed(study.arms)}"
        )
    said = {"seeds": study.seeds[:FORECAST_SEEDS], "threshold": study.threshold}
    return study.curriculum(arm), {**said, **rivals(study)}


compare = of_studies(compare_curricula, _compared)
forecast = of_studies(forecast_curriculum, _foreseen)
