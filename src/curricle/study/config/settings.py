"""The tables of a study file for learning and for transfers."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, JsonValue, model_validator

from curricle.deep.learner import DeepLearner
from curricle.deep.shaping import PolicyReuse, WeightTransfer
from curricle.learning.learners import (
    SARSA,
    DoubleQLearning,
    ExpectedSARSA,
    OptimisticQLearning,
    QLearning,
)
from curricle.learning.shaping import (
    DecayingAdvice,
    LookAheadAdvice,
    LookBackAdvice,
    QInitialisation,
    RewardBonus,
    StateShaping,
)
from curricle.learning.stopping import Episodes, StoppingRule
from curricle.learning.storage import Storage
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.study.config.tables import (
    Choice,
    Name,
    Number,
    ObjectTable,
    Rate,
    Reference,
    Table,
    Whole,
    built,
    load,
    named,
    only,
    shown,
    table_of,
    tagged,
    users_code,
    whole_number,
    word,
    wrong,
)
from curricle.tasks.families.family import FamilyMember
from curricle.tasks.observation_task import is_observation_task
from curricle.transfer import aggregation, component_mapping, mapping
from curricle.transfer.component_mapping import member_mappings
from curricle.transfer.edges import Transfer
from curricle.transfer.found_mappings import announced
from curricle.transfer.identity_mapping import check_same_observations, identity
from curricle.transfer.observation_mapping import ObservationMapping

# -- Settings of learning: learner, budget, how potentials enter, evaluation, storage --------------

AGGREGATES = ("maximum", "mean", "minimum", "total")
DEEP = "deep"
"""The `type` of a learner that is a network."""


class _DeepLearnerTable(ObjectTable):
    def arguments_in(self, folder: Path) -> dict[str, Any]:
        """Return the arguments, the study's own classes and functions loaded."""
        given = super().arguments_in(folder)
        if ":" in given["algorithm"]:
            own = load(given["algorithm"], folder)
            given["algorithm"] = f"{own.__module__}:{own.__qualname__}"
        settings = _loaded(given["settings"], folder)
        # Lists of TOML are what the algorithms take as tuples, such as train_freq.
        given["settings"] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in settings.items()
        }
        return given


def _loaded(value: Any, folder: Path) -> Any:
    """Return a setting with its texts ``module:name`` replaced by what they name."""
    if isinstance(value, dict):
        return {name: _loaded(one, folder) for name, one in value.items()}
    if isinstance(value, list):
        return [_loaded(one, folder) for one in value]
    return load(value, folder) if isinstance(value, str) and ":" in value else value


class EpisodesTable(ObjectTable):
    """A budget in episodes."""  # by hand: the parameter is called `number`, the key `episodes`

    episodes: Whole = Field(description="How many.")

    def build(self, folder: Path = Path()) -> Episodes:
        """Return the budget."""
        return Episodes(self.episodes)


LEARNERS = tuple(
    table_of(one, tag=one.__name__)
    for one in (QLearning, SARSA, ExpectedSARSA, DoubleQLearning, OptimisticQLearning)
)
DeepLearnerTable = table_of(
    DeepLearner,
    _DeepLearnerTable,
    tag=DEEP,
    without=("callbacks", "progress_bar"),
    settings=dict[str, JsonValue],
)
StoppingTable = table_of(StoppingRule)
SHAPINGS = tuple(
    table_of(one, tag=one.__name__, without=("potential", "source"), weight=Rate)
    for one in (
        QInitialisation,
        LookAheadAdvice,
        LookBackAdvice,
        StateShaping,
        DecayingAdvice,
        RewardBonus,
        WeightTransfer,
        PolicyReuse,
    )
)
"""The ways a potential or a network enters learning; the sources give the potential."""
EvaluationTable = table_of(GreedyEvaluation)
StorageTable = table_of(
    Storage,
    memory_limit=Annotated[
        int | str | None, BeforeValidator(lambda v: v if isinstance(v, str) else whole_number(v))
    ],
)


AnyLearner = Annotated[Any, tagged(*LEARNERS, DeepLearnerTable, default="QLearning")]
AnyBudget = Annotated[
    Any,
    Choice(
        (EpisodesTable, StoppingTable),
        lambda value: EpisodesTable if "episodes" in value else StoppingTable,
        whole_number,
        int,
    ),
]
AnyShaping = Annotated[
    Any, tagged(*SHAPINGS, default="QInitialisation", simple=named(*SHAPINGS), simple_type=str)
]
AnyAggregate = Annotated[
    str,
    word(
        f"be one of {', '.join(AGGREGATES)}, or a function as module:function",
        AGGREGATES,
        function=True,
    ),
]


class Settings(Table):
    """Settings for all tasks, or for one."""

    aggregate: AnyAggregate = Field(
        default="mean",
        description="How several potentials into a task become one: maximum, mean, minimum, total, "
        "or a function (N, S, A) -> (S, A) as module:function.",
    )
    unknown_value: Number | None = Field(
        default=None,
        description="The potential of pairs that all mappings leave unmapped; 0 by default.",
    )
    learner: AnyLearner = Field(default=LEARNERS[0](), description="The learning algorithm.")
    budget: AnyBudget = Field(
        default=None,
        description="Steps; { episodes = 800 }; or a stopping rule, { max_steps = 50_000, ... }. "
        "By default 100_000 for the target. A source ends when its return has settled, or after "
        "its steps: by default a tenth of the target's, which all such sources share.",
    )
    shaping: AnyShaping = Field(
        default=None,
        description="How a potential, or a network, enters learning: its name, or "
        '{ type = "QInitialisation", guard = true }, which is the default where it is possible.',
    )
    eval_freq: Whole | None = Field(
        default=None, description="Steps between checkpoints; a hundredth of the budget by default."
    )
    evaluation: Annotated[Any, only(EvaluationTable)] = Field(
        default=EvaluationTable(), description="How the greedy policy is evaluated."
    )
    storage: Annotated[Any, only(StorageTable)] = Field(
        default=StorageTable(), description="How values are stored."
    )

    def setting(self, which: str, folder: Path) -> Any:
        """Return a setting, such as ``"learner"``, as :class:`Curriculum` takes it."""
        value = getattr(self, which)
        if which == "aggregate":
            named = value in AGGREGATES
            return getattr(aggregation, value) if named else load(value, folder)
        return built(value, folder)

    @property
    def deep_learner(self) -> bool:
        """Whether the learner is a network."""
        return isinstance(self.learner, DeepLearnerTable)


# -- Transfers as tables: which mapping, how much of the source's values, calibrated or not --------

MAPPINGS = ("project", "mapping", "function", "factory", "observations")
"""Ways to say which source pair a target pair reads; a transfer has one of them."""
OF_OBSERVATIONS = ("observations", "actions", "status")
"""Keys of transfers into tasks that are seen through observations."""
ACTIONS = (
    "be a list of the source's actions, -1 where there is none, or a function as module:function"
)


def _whole_numbers(value: Any) -> tuple[int, ...]:
    if not isinstance(value, list | tuple):
        raise wrong(f"must {ACTIONS}: got {shown(value)}")
    return tuple(whole_number(one) for one in value)


class _TransferTable(ObjectTable):
    if TYPE_CHECKING:
        source: str  # derived, as are target, scale, shift and calibrate
        target: str
        scale: float
        shift: float

    # The keys that say f are by hand: they are arguments of five functions that make a mapping.
    project: dict[str, str] | None = Field(
        default=None,
        description="f by name: source component = target component where the names differ; may be "
        "empty.",
    )
    mapping: Literal["identity", "same_position", "relative_objects", "family", "auto"] | None = (
        Field(
            default=None,
            description="f, one of Curricle's other mappings; 'family' is what the family of both "
            "tasks says, one transfer for each mapping that it names; 'auto' is the best that is "
            "found between the tasks.",
        )
    )
    function: Reference | None = Field(
        default=None,
        description="f as a function from the target's decoded states and actions to the source's, "
        "module:function.",
    )
    factory: Reference | None = Field(
        default=None,
        description="A function that makes f from the tasks, (target, source) -> mapping.",
    )
    observations: Reference | None = Field(
        default=None,
        description="f as a function from a target's stacked observations to the source's, or to "
        "the numbers of its states, module:function.",
    )
    actions: Annotated[
        tuple[int, ...] | str | None, word(ACTIONS, function=True, other=_whole_numbers)
    ] = Field(
        default=None,
        description="With observations: the source's action for each of the target's, -1 where "
        "there is none, or a function of observations, module:function.",
    )
    status: Reference | None = Field(
        default=None,
        description="With observations: a function from them to whether there is a counterpart, "
        "module:function.",
    )
    unmapped_value: Number | None = Field(
        default=None,
        description="A value for pairs without a source pair; by default aggregates skip them, and "
        "a mapping that is found has the value that fits.",
    )

    @model_validator(mode="after")
    def _one_mapping(self) -> Self:
        given = [name for name in MAPPINGS if getattr(self, name) is not None]
        if len(given) != 1:
            found = ", ".join(given) or "none"
            raise wrong(f"must have one of {', '.join(MAPPINGS)}: got {found}")
        others = self.actions is not None or self.status is not None
        if others and self.observations is None and self.mapping != "identity":
            raise wrong("has actions or status, which go with observations or mapping = 'identity'")
        whole = self.mapping == "identity" and not others
        if self.unmapped_value is not None and (self.factory is not None or whole):
            raise wrong(
                "has an unmapped_value that is not used: a factory sets its own, and identity "
                "leaves nothing unmapped"
            )
        return self

    def mismatches(self, *, deep: bool) -> Iterator[tuple[str, str]]:
        """Yield the keys that do not suit the target, each with what is wrong about it.

        A target that is `deep` is seen through observations.
        """
        seen = (
            f"{self.target} is seen through observations, which observations, mapping = 'identity' "
            "or factory map"
        )
        if not deep:
            for key in OF_OBSERVATIONS:
                if getattr(self, key) is not None:
                    yield key, f"must be left out: {self.target} is not seen through observations"
        elif self.mapping not in (None, "identity"):
            yield "mapping", f"must be left out, or 'identity': {seen}"
        else:
            for key in ("project", "function"):
                if getattr(self, key) is not None:
                    yield key, f"must be left out: {seen}"

    def transfer(self, f: Any) -> Transfer:
        """Return the transfer, with a mapping that :meth:`mappings_in` returned."""
        return Transfer(mapping=f, **self.arguments_in(Path()))

    def mappings_in(
        self,
        target: Any,
        source: Any,
        folder: Path,
        members: Sequence[FamilyMember | None],
        *,
        fit_unmapped: bool,
        say: Callable[[str], Any],
    ) -> tuple[Any, ...]:
        """Return the mapping f, or several where a family says so.

        `folder` has the modules of the user's own functions; `members` are the addresses of target
        and source in their families, None for a task that has none. `fit_unmapped` is for a mapping
        that is found: whether it may state a value where it knows nothing. `say` takes each line
        about it.
        """
        to, of = members
        if self.mapping == "auto":
            edge = f"{self.source} -> {self.target}"
            found = announced(
                edge,
                target,
                source,
                self.unmapped_value,
                fit_unmapped=fit_unmapped,
                scale=self.scale,
                shift=self.shift,
                say=say,
            )
            return (found.mapping,)
        if self.mapping != "family" or to is None or of is None:
            return (self.mapping_in(target, source, folder),)
        with users_code(f"the mapping of {to.family.name}"):
            return member_mappings(to, of, target, source, self.unmapped_value)

    def mapping_in(self, target: Any, source: Any, folder: Path) -> Any:
        """Return the mapping f of any other kind."""
        value = self.unmapped_value
        if is_observation_task(target) and self.factory is None:
            return self._of_observations(target, source, folder)
        if self.project is not None:
            return component_mapping.project(target, source, unmapped_value=value, **self.project)
        if self.mapping == "identity":
            return identity(target, source)
        if self.mapping is not None:
            return getattr(mapping, self.mapping)(target, source, unmapped_value=value)
        if self.factory is not None:
            make = load(self.factory, folder)
            with users_code(self.factory):
                return make(target, source)
        own = str(self.function)
        function = load(own, folder)
        with users_code(own):
            return mapping.from_function(target, source, function, unmapped_value=value)

    def _of_observations(self, target: Any, source: Any, folder: Path) -> Any:
        value = self.unmapped_value
        functions: dict[str, Any] = {
            key: load(given, folder) if isinstance(given, str) else given
            for key in OF_OBSERVATIONS
            for given in [getattr(self, key)]
        }
        if self.mapping == "identity":
            check_same_observations(target, source)
        return ObservationMapping(target, source, **functions, unmapped_value=value)


if TYPE_CHECKING:
    TransferTable = _TransferTable
else:
    TransferTable = table_of(
        Transfer, _TransferTable, without=("mapping",), source=Name, target=Name
    )
