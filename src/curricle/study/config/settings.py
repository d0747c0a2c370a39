"""Settings of learning: learner, budget, how potentials enter, evaluation, storage."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, JsonValue

from curricle.deep.learner import DeepLearner
from curricle.deep.shaping import PolicyReuse, WeightTransfer
from curricle.learning.learners import SARSA, DoubleQLearning, ExpectedSARSA, QLearning
from curricle.learning.optimistic_learning import OptimisticQLearning
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
from curricle.study.config.derived_tables import ObjectTable, Rate, built, table_of
from curricle.study.config.references import load
from curricle.study.config.tables import (
    Choice,
    Number,
    Table,
    Whole,
    not_one_of,
    only,
    tagged,
    whole_number,
    word,
    wrong,
)
from curricle.transfer import aggregation

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


def _shaping(value: Any) -> Any:
    by_name = {one.__name__: one for one in SHAPINGS}
    if not isinstance(value, str) or value not in by_name:
        raise wrong(not_one_of(value, by_name))
    return by_name[value]()


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
    Any, tagged(*SHAPINGS, default="QInitialisation", simple=_shaping, simple_type=str)
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
    unknown_value: Number = Field(
        default=0.0, description="The potential of pairs that all mappings leave unmapped."
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
