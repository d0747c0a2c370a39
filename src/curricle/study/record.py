"""Records in a study's folder: plain data, written by a run and read without the study's code."""

import json
from collections.abc import Collection
from typing import Annotated, Any, Literal, Self, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PlainSerializer,
    PlainValidator,
    ValidationError,
    model_validator,
)

from curricle.arrays import FloatArray, IntArray
from curricle.checks import LONGEST_NAME, listed, unfit_name
from curricle.comparison.measures import Reference
from curricle.comparison.plan import numbered_seeds
from curricle.comparison.task_differences import TaskSummary
from curricle.pictures.views import MOST_CELLS, GridView, Marker
from curricle.statistics.curves import SCRATCH
from curricle.text import counted

# -- Parts of records: plain data of fixed types, with arrays as lists of numbers ------------------


def _array(dtype: type, kinds: str) -> PlainValidator:
    def read(value: object) -> npt.NDArray[Any]:
        try:
            array = np.asarray(value)
        except ValueError:
            raise ValueError("must be an array: its rows have different lengths") from None
        if array.size and array.dtype.kind not in kinds:
            raise ValueError(f"must be an array of {dtype.__name__}: got {array.dtype}")
        return array.astype(dtype)

    return PlainValidator(read)


Ints = Annotated[IntArray, _array(np.int64, "i"), PlainSerializer(np.ndarray.tolist)]
Floats = Annotated[FloatArray, _array(np.float64, "if"), PlainSerializer(np.ndarray.tolist)]
Count = Annotated[int, Field(ge=0)]


class Plain(BaseModel):
    """A part of a record: its keys and their types are fixed."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


# -- The record of a study in its folder, from which its results can be read -----------------------

LONGEST_EPISODE = 200  # first steps of an episode that are kept
MOST_DRAWINGS = 40  # different states of an episode that are kept as their class shows them
Model = TypeVar("Model", bound=BaseModel)


Thing = Literal["treasure", "fire", "pit", "goal", "key", "lock", "exit"]  # objects on a grid


class ViewRecord(Plain):
    """A :class:`GridView` without the positions of markers in each state."""

    states: Ints
    cells: Ints  # the cell of each state, numbered by rows from the top left
    ended: Ints  # indices into `states` of states that end an episode
    origin: tuple[int, int]
    shape: tuple[int, int]
    actions: tuple[str, ...]
    directions: tuple[int, ...] | None
    letters: tuple[tuple[str, int, int], ...]
    words: str
    is_map: bool
    objects: tuple[tuple[Thing, int, int, bool], ...]
    markers: tuple[tuple[str, Literal["blue", "vermillion", "green", "purple", "black"]], ...]
    air: Ints = Field(default_factory=lambda: np.empty(0, np.int64))  # no states, no walls
    bars: Ints = Field(default_factory=lambda: np.empty(0, np.int64))  # walls between cells

    @classmethod
    def of(cls, view: GridView) -> Self:
        """Return the record of a view."""
        fields = {name: getattr(view, name) for name in cls.model_fields}
        fields["cells"] = (view.cells - view.origin) @ np.array([view.shape[1], 1])
        fields["ended"] = np.flatnonzero(view.ended)
        fields["markers"] = tuple((marker.letter, marker.colour) for marker in view.markers)
        return cls(**fields)

    @property
    def view(self) -> GridView:
        """The view, whose markers have no positions."""
        fields = dict(self)
        fields["cells"] = np.stack(np.divmod(self.cells, self.shape[1]), axis=1) + self.origin
        fields["ended"] = np.isin(np.arange(len(self.states)), self.ended)
        fields["markers"] = tuple(Marker(*letter, np.empty(0, np.int64)) for letter in self.markers)
        return GridView(**fields)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        (rows, columns), n, moves = self.shape, self.states.size, self.directions
        if not (0 < rows <= MOST_CELLS and 0 < columns <= MOST_CELLS // rows):
            raise ValueError(f"shape must have at most {MOST_CELLS:,} cells: got {self.shape}")
        if {self.states.ndim, self.cells.ndim, self.ended.ndim} != {1} or self.cells.size != n:
            raise ValueError("states and cells must have as many entries")
        places, cells = (self.cells, self.air, self.bars // 2), rows * columns
        if not (all(_below(part, cells) for part in places) and _below(self.ended, n)):
            raise ValueError("cells, air and bars must lie within the shape, ended within states")
        if moves is not None and (len(moves) != len(self.actions) or not set(moves) <= {*range(5)}):
            raise ValueError("directions must be one of 0 to 4 for each action")
        return self


def _below(numbers: IntArray, most: int) -> bool:
    return bool(((numbers >= 0) & (numbers < most)).all())


class TaskRecord(Plain):
    """A task of a study."""

    kind: str  # its type and size as text
    text: str  # its parameters as text
    states: Count
    actions: Count  # 0 where it is seen through observations
    view: ViewRecord | None

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.view is not None and not _below(self.view.states, self.states):
            raise ValueError(f"view.states must be below {self.states}")
        if self.view is not None and len(self.view.actions) != self.actions:
            raise ValueError(f"view.actions must have {self.actions} names")
        return self


class NodeRecord(Plain):
    """A task of an arm and the settings of its training."""

    task: Count  # its index among the study's tasks; same tasks have equal indices
    key: str  # the key of its units; empty if they are not stored
    settings: dict[str, str]  # the settings of its training as text
    aggregate: str | None  # the aggregate of its transfers, if there are several


class TransferRecord(Plain):
    """A transfer of an arm."""

    source: str
    target: str
    words: str
    number: Count  # its index; same transfers have equal indices


class VariantRecord(Plain, strict=False):  # not strict: a configuration makes it from a dict
    """The settings that a sweep or a tuning gave to an arm."""

    arm: str  # the arm's name in the file; "scratch" for learning from scratch
    values: dict[str, Any]  # by their keys in the file


class TunedArm(Plain, strict=False):
    """The best trial of an arm."""

    trials: Count  # number of its trials
    finalists: Count = 0  # that were played again on the final seeds
    score: float | None
    """Mean return over all steps, sources charged, averaged over the tuning's seeds; None if not
    finite."""
    values: dict[str, Any]  # by their keys in the file
    settings: tuple[str, ...] = ()  # that its trials varied

    @property
    def words(self) -> str:
        """What was tuned, over how many trials, as text."""
        return f"{counted(self.trials, 'trial')} of {listed(self.settings) or 'nothing'}"


class TunedRecord(Plain, strict=False):
    """A complete tuning, whose trials are stored as a separate study."""

    seeds: tuple[Count, ...] = Field(min_length=1)
    final_seeds: tuple[Count, ...] = ()
    total: Count  # steps a trial and seed, sources included
    arms: dict[str, TunedArm]

    @property
    def on_seeds(self) -> str:
        """The seeds of its trials, as text."""
        further = f", the best of each arm on {numbered_seeds(self.final_seeds)} too"
        return numbered_seeds(self.seeds) + further * bool(self.final_seeds)

    def steps(self, arm: str) -> int:
        """Return the steps of an arm's trials, summed over seeds."""
        of = self.arms[arm]
        return (of.trials * len(self.seeds) + of.finalists * len(self.final_seeds)) * self.total


class ArmRecord(Plain):
    """An arm: its tasks, sources first, and its transfers."""

    nodes: dict[str, NodeRecord] = Field(min_length=1)
    transfers: tuple[TransferRecord, ...]
    scratch: bool = False  # whether it learns the target without sources, for all steps
    depends_on_total: str | None = None
    """Why learning up to a step depends on the total of steps, as text; empty if it does not; None
    if another version wrote the record."""
    control_of: str = ""  # the arm that it changes, as a control or as a constant of it
    knows_target: bool  # whether a mapping was found in the target's model

    @property
    def has_potential(self) -> bool:
        """Whether a task has a potential, from a transfer or written by hand."""
        by_hand = any("potential" in node.settings for node in self.nodes.values())
        return by_hand or bool(self.transfers)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        place = {name: number for number, name in enumerate(self.nodes)}
        for edge in self.transfers:
            if not place.get(edge.source, len(place)) < place.get(edge.target, -1):
                ends = f"{edge.source}, {edge.target}"
                raise ValueError(f"a transfer must lead to a later task: {ends}")
        return self


class CurriculaRecord(Plain):
    """Tasks and arms of a study, or of curricula that were trained without a study."""

    tasks: tuple[TaskRecord, ...]
    arms: dict[str, ArmRecord]

    def task(self, arm: str, name: str) -> TaskRecord:
        """Return a task of an arm."""
        return self.tasks[self.arms[arm].nodes[name].task]

    def only(self, arms: Collection[str]) -> Self:
        """Return the record of some of the arms."""
        kept = {name: arm for name, arm in self.arms.items() if name in arms}
        return self.model_copy(update={"arms": kept})

    def groups(self) -> list[tuple[str, ...]]:
        """Return groups of arms with equal tasks and transfers; no scratch arms, no controls."""
        groups: dict[Any, list[str]] = {}
        for name, arm in self.arms.items():
            if name != SCRATCH and not (arm.scratch or arm.control_of):
                nodes = tuple((task, node.task) for task, node in arm.nodes.items())
                same = nodes, tuple(edge.number for edge in arm.transfers)
                groups.setdefault(same, []).append(name)
        return [tuple(arms) for arms in groups.values()]

    @model_validator(mode="after")
    def _known(self) -> Self:
        for name, arm in self.arms.items():
            for text in (name, *arm.nodes):  # an arm's may be longer than those in a file
                if why := unfit_name(text[:LONGEST_NAME]):
                    raise ValueError(f"a name {why}")
            for task, node in arm.nodes.items():
                if node.task >= len(self.tasks):
                    raise ValueError(f"arms.{name}.nodes.{task}.task must be one of the tasks")
        return self


def _fit_name(name: str) -> str:
    if why := unfit_name(name):
        raise ValueError(f"it {why}")
    return name


OF_CONFIGURATION = ("name", "seeds", "window", "snapshots", "variants", "tuned", "chosen")


class StudyRecord(CurriculaRecord):
    """A study as its folder describes it: what its plan tells, and some of its configuration."""

    # the configuration's:
    name: Annotated[str, AfterValidator(_fit_name)]
    seeds: tuple[Count, ...]
    window: Annotated[int, Field(ge=1)]
    snapshots: Count
    variants: dict[str, VariantRecord] = Field(default={})
    tuned: TunedRecord | None = None
    chosen: str | None = None  # the printed choice of its arm
    # the plan's, besides tasks and arms:
    reference: Reference  # before training
    target: str
    problem: TaskSummary  # the target, to tell whether two studies have the same target
    budget: Count | None  # this, `total` and `eval_freq` are as in :class:`Arms`
    total: Count | None
    eval_freq: Annotated[int, Field(ge=1)]

    @classmethod
    def of(cls, configuration: object, plan: object) -> Self:
        """Return the record in the two parts of a description; ValueError names a mistake."""
        if not (isinstance(configuration, dict) and isinstance(plan, dict)):
            raise ValueError("its configuration and its plan must be tables")
        shared = {key: configuration[key] for key in OF_CONFIGURATION if key in configuration}
        return read_record(cls, {**plan, **shared})

    @property
    def plan(self) -> dict[str, Any]:
        """What the plan tells, as plain data, of which :meth:`of` makes the record again."""
        return self.model_dump(mode="json", exclude={*OF_CONFIGURATION})

    @property
    def evaluated(self) -> str:
        """How the target is evaluated, as text; empty if it is not learnt from scratch."""
        node = self.arms[SCRATCH].nodes[self.target] if SCRATCH in self.arms else None
        return "" if node is None or self.total is None else node.settings["evaluation"]

    @property
    def keys(self) -> dict[tuple[str, str], str]:
        """The key of each task of each arm."""
        return {
            (name, task): node.key
            for name, arm in self.arms.items()
            for task, node in arm.nodes.items()
        }

    @model_validator(mode="after")
    def _has_target(self) -> Self:
        last = ""
        for name, arm in self.arms.items():
            if next(reversed(arm.nodes)) != self.target:
                raise ValueError(f"arms.{name}.nodes must end with the target, {self.target}")
            if arm.control_of not in ("", last):
                raise ValueError(f"arms.{name}.control_of must be the arm before its controls")
            last = arm.control_of or name
        if (self.budget is None) is not (self.total is None):
            raise ValueError("budget and total must both be numbers, or neither")
        return self


class CertificateRecord(Plain):
    """The certificate of the potential that the first seeds of some arms share."""

    arms: tuple[str, ...]
    holds: bool | None
    text: str


class SectionRecord(Plain):
    """The certificates of arms with the same tasks and transfers."""

    arms: tuple[str, ...]
    certificates: tuple[CertificateRecord, ...]
    left_out: tuple[str, ...]  # sentences on omitted parts, the reason, and how to get them

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if not {arm for record in self.certificates for arm in record.arms} <= {*self.arms}:
            raise ValueError("certificates must be of the section's arms")
        return self


class EpisodeRecord(Plain):
    """One greedy episode of n steps on a grid."""

    cells: Ints  # (n + 1, markers): positions of markers, as row * columns + column
    returns: Floats  # (n + 1,): the return so far, with the discount of evaluations
    terminated: bool
    rewards: Floats  # (n,), as the task gave them
    drawings: tuple[tuple[str, str], ...] = Field((), max_length=MOST_DRAWINGS)
    """What the class shows of states: text, and a PNG in base64; each is "" where it has none."""
    drawn: Ints = Field(default_factory=lambda: np.empty(0, np.int64))
    """(n + 1,): the drawing of each moment, -1 for none; empty if there are no drawings."""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        n = self.returns.size
        alike = self.cells.ndim == 2 and self.returns.shape == self.cells.shape[:1]
        alike &= self.rewards.shape == (n - 1,)
        if not alike or not 0 < n <= LONGEST_EPISODE + 1:
            raise ValueError(f"cells and returns must be of at most {LONGEST_EPISODE} steps")
        if not _below(self.cells, MOST_CELLS):
            raise ValueError(f"cells must be below {MOST_CELLS}")
        if self.drawn.size not in (0, n) or not _below(self.drawn + 1, len(self.drawings) + 1):
            raise ValueError("drawn must be -1, or the number of a drawing, for each moment")
        return self


class EpisodePair(Plain):
    """Episodes of the greedy policies of the first and of the last snapshot."""

    before: EpisodeRecord
    after: EpisodeRecord


class Analysis(Plain):
    """Results that need the tasks themselves, written at the end of a run."""

    of: str = ""  # a digest of the analysed results; empty if there are none in a folder
    sections: tuple[SectionRecord, ...] = ()
    episodes: dict[str, dict[str, EpisodePair]] = Field(default={})  # arm -> task -> episodes


class UnitRecord(Plain):
    """A unit of work and its dependencies."""

    key: str
    dependencies: dict[str, Any]
    task: str
    seeds: tuple[Count, ...] = Field(min_length=1)


class FailureRecord(Plain):
    """A unit that failed in the last run."""

    key: str
    seeds: tuple[Count, ...]
    error: str


class FailuresRecord(Plain):
    """The units that failed in the last run; the folder has no such file if none did."""

    failures: tuple[FailureRecord, ...] = ()


class RunRecord(Plain):
    """One run of a study."""

    started: str
    file: str
    seeds: tuple[Count, ...]
    commit: str | None
    python: str
    machine: str
    versions: dict[str, str]
    finished_before: Count = 0
    """Number of all seeds planned before, if they were finished with these settings; else 0."""


class RunsRecord(Plain):
    """All runs of a study into its folder."""

    runs: tuple[RunRecord, ...] = ()


def read_record(model: type[Model], value: object) -> Model:
    """Return the record of plain data; ValueError names the first mistake."""
    return record_in(model, json.dumps(value).encode())


def record_in(model: type[Model], content: bytes) -> Model:
    """Return the record in the content of a JSON file; ValueError names the first mistake."""
    try:
        return model.model_validate_json(content)
    except ValidationError as error:
        raise ValueError(first_mistake(error)) from None


def first_mistake(error: ValidationError) -> str:
    """Return the first mistake in the content of a file, with its key path."""
    first = error.errors(include_url=False)[0]
    place = ".".join(map(str, first["loc"])) or "it"
    text = first["msg"].removeprefix("Value error, ")
    return " ".join(f"{place}: {text[0].lower()}{text[1:]}".split())
