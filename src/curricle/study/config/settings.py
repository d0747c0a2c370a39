"""Settings of learning as tables: learners, schedules, budgets, guard, evaluation, storage.

The fields of each table are the parameters of what it builds, with the same defaults; a test holds
them equal. Curricle itself, compiled loops and all, is only imported when something is built, so
that a mistake in a file is reported at once.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import AfterValidator, BeforeValidator, Field, JsonValue

from curricle.study.config.references import load
from curricle.study.config.tables import (
    Count,
    Flag,
    Number,
    Table,
    Whole,
    by_type,
    either,
    flag,
    meant,
    no_table,
    number,
    shown,
    whole_number,
    wrong,
    wrong_at,
)

AGGREGATES = ("maximum", "mean", "minimum", "total")


class Setting(Table):
    """A table that stands for one object."""

    def build(self) -> Any:
        """Return the object."""
        raise NotImplementedError


class LinearTable(Setting):
    """A number that goes straight from one value to another, and stays there."""

    type: Literal["linear"] = "linear"
    first: Number = Field(description="Value at first.")
    last: Number = Field(description="Value at last.")
    steps: Whole = Field(description="Steps it takes to get there.")

    def build(self) -> Any:
        """Return the schedule."""
        from curricle.learning.schedules import linear

        return linear(self.first, self.last, steps=self.steps)


class ExponentialTable(Setting):
    """A number whose distance from its last value halves time after time."""

    type: Literal["exponential"] = "exponential"
    first: Number = Field(description="Value at first.")
    last: Number = Field(default=0.0, description="Value it tends to.")
    half_life: Number = Field(description="Steps in which the distance halves.")

    def build(self) -> Any:
        """Return the schedule."""
        from curricle.learning.schedules import exponential

        return exponential(self.first, self.last, half_life=self.half_life)


class HarmonicTable(Setting):
    """A number that falls as 1 / (1 + n / half); n counts steps, or updates of a learning rate."""

    type: Literal["harmonic"] = "harmonic"
    first: Number = Field(default=1.0, description="Value at first.")
    last: Number = Field(default=0.0, description="Value it tends to.")
    half: Number = Field(default=1.0, description="Steps or updates after which it is halfway.")

    def build(self) -> Any:
        """Return the schedule."""
        from curricle.learning.schedules import harmonic

        return harmonic(self.first, self.last, half=self.half)


Rate = Annotated[
    Number | LinearTable | ExponentialTable | HarmonicTable,
    either(by_type(LinearTable, ExponentialTable, HarmonicTable), number),
]


Update = Literal["QLearning", "SARSA", "ExpectedSARSA", "DoubleQLearning"]


class LearnerTable(Setting):
    """A learner in a table: what it updates by, how fast, how it explores."""

    type: Update = Field(default="QLearning", description="The update.")
    learning_rate: Rate = Field(default=0.1, description="alpha in [0, 1], or a schedule.")
    epsilon: Rate | None = Field(
        default=None,
        description="Share of uniform actions, or a schedule; 0.1 unless softmax is used.",
    )
    inverse_temperature: Rate | None = Field(
        default=None,
        description="Softmax exploration instead of epsilon-greedy: beta, or a schedule.",
    )
    initial_value: Number = Field(default=0.0, description="Q before learning.")

    def build(self) -> Any:
        """Return the learner."""
        from curricle.learning import learners

        rates = {"learning_rate", "epsilon", "inverse_temperature"}
        given = {name: _built(getattr(self, name)) for name in rates}
        return getattr(learners, self.type)(**given, initial_value=self.initial_value)


class DeepLearnerTable(Table):
    """A learner with a network: an algorithm of Stable-Baselines3, and its settings."""

    type: Literal["deep"] = "deep"
    algorithm: str = Field(
        default="DQN", description="DQN, QRDQN, PPO, SAC and the like, or one's own, module:Class."
    )
    policy: str = Field(
        default="MlpPolicy", description="MlpPolicy, CnnPolicy or MultiInputPolicy."
    )
    envs: Count = Field(default=1, description="Environments played side by side.")
    settings: dict[str, JsonValue] = Field(
        default={},
        description="All else that the algorithm takes, such as learning_rate or policy_kwargs; "
        "text as module:name stands for what it names.",
    )
    threads: Count = Field(default=1, description="Threads that torch may use.")

    def build(self, folder: Path) -> Any:
        """Return the learner.

        Parameters
        ----------
        folder : Path
            Where the modules of a study's own classes are.
        """
        from curricle.deep.learner import DeepLearner

        algorithm = self.algorithm
        if ":" in algorithm:
            own = load(algorithm, folder)
            algorithm = f"{own.__module__}:{own.__qualname__}"
        settings = {name: _loaded(value, folder) for name, value in self.settings.items()}
        # Lists of TOML are what the algorithms take as tuples, such as train_freq.
        given = {name: tuple(v) if isinstance(v, list) else v for name, v in settings.items()}
        return DeepLearner(
            algorithm, self.policy, envs=self.envs, settings=given, threads=self.threads
        )


def _loaded(value: Any, folder: Path) -> Any:
    """Return a setting with what its texts name in their places."""
    if isinstance(value, dict):
        return {name: _loaded(one, folder) for name, one in value.items()}
    if isinstance(value, list):
        return [_loaded(one, folder) for one in value]
    return load(value, folder) if isinstance(value, str) and ":" in value else value


def _learner_table(value: dict[str, Any]) -> type[Table]:
    kind, kinds = value.get("type", "QLearning"), (*get_args(Update), "deep")
    if kind not in kinds:
        words = f"must be one of {', '.join(kinds)}: got {shown(kind)}{meant(kind, kinds)}"
        raise wrong_at(("type",), words, kind)
    return DeepLearnerTable if kind == "deep" else LearnerTable


class EpisodesTable(Setting):
    """A budget in episodes."""

    episodes: Whole = Field(description="How many.")

    def build(self) -> Any:
        """Return the budget."""
        from curricle.learning.budget import Episodes

        return Episodes(self.episodes)


class StoppingRuleTable(Setting):
    """A budget that ends when the task is learnt."""

    max_steps: Whole = Field(description="Steps at which learning ends in any case.")
    min_steps: Whole = Field(default=0, description="Steps before which it does not end.")
    threshold: Number | None = Field(default=None, description="Greedy return to be reached.")
    fraction: Number | None = Field(
        default=None,
        description="The same, as a part of the way from the random policy's return to the "
        "optimum.",
    )
    plateau: Number | None = Field(
        default=None, description="Gain in return below which learning stands still."
    )
    drop: Number | None = Field(
        default=None, description="Return below the first evaluation at which learning ends, too."
    )
    patience: Whole = Field(default=5, description="Checkpoints that have to agree.")
    when: Literal["any", "all"] = Field(default="any", description="Conditions that have to hold.")

    def build(self) -> Any:
        """Return the budget."""
        from curricle.learning.stopping import StoppingRule

        return StoppingRule(**dict(self))


class GuardTable(Setting):
    """A guard against harmful potentials."""

    share: Number = Field(default=0.5, description="Share of steps phi's learner gets at first.")
    min_share: Number = Field(
        default=0.1, description="Share that either learner keeps, in (0, 0.5]."
    )
    pace: Number = Field(
        default=0.003, description="Part of the way to its share gained an episode."
    )
    standard_errors: Number = Field(
        default=3.0, description="Standard errors by which one has to be better."
    )
    memory: Whole = Field(default=20, description="Episodes over which returns are averaged.")

    def build(self) -> Any:
        """Return the guard."""
        from curricle.learning.guard import Guard

        return Guard(**dict(self))


ShapingName = Literal[
    "QInitialisation",
    "LookAheadAdvice",
    "LookBackAdvice",
    "StateShaping",
    "DecayingAdvice",
    "RewardBonus",
    "WeightTransfer",
    "PolicyReuse",
]
OF_NETWORKS = ("WeightTransfer", "PolicyReuse")
BY_NETWORKS = ("QInitialisation", "LookAheadAdvice", "StateShaping", *OF_NETWORKS)


class ShapingTable(Setting):
    """How a potential, or a network, enters learning."""

    type: ShapingName = Field(description="The class of the shaping.")

    def build(self) -> Any:
        """Return the shaping."""
        from curricle.deep import shaping as deep_shaping
        from curricle.learning import shaping

        module = deep_shaping if self.type in OF_NETWORKS else shaping
        given = {name: _built(value) for name, value in dict(self).items() if name != "type"}
        return getattr(module, self.type)(**given)


class GuardedShapingTable(ShapingTable):
    """A shaping in which Q starts at the potential."""

    type: Literal["QInitialisation", "LookAheadAdvice"] = Field(
        default="QInitialisation", description="The class of the shaping."
    )
    guard: Annotated[bool | GuardTable, either(lambda _: GuardTable, flag)] = Field(
        default=False, description="Whether a second learner watches over the potential, and how."
    )

    def build(self) -> Any:
        """Return the shaping."""
        from curricle.learning import shaping

        guard = GuardTable() if self.guard is True else self.guard or None
        return getattr(shaping, self.type)(guard=_built(guard))


class DecayingAdviceTable(ShapingTable):
    """Advice whose weight may fall."""

    type: Literal["DecayingAdvice"] = Field(
        default="DecayingAdvice", description="The class of the shaping."
    )
    weight: Rate = Field(default=1.0, description="xi(t), or a schedule.")


def _shaping_table(value: dict[str, Any]) -> type[ShapingTable]:
    kind, kinds = value.get("type", "QInitialisation"), get_args(ShapingName)
    if kind not in kinds:
        words = f"must be one of {', '.join(kinds)}: got {shown(kind)}{meant(kind, kinds)}"
        raise wrong_at(("type",), words, kind)
    if kind == "DecayingAdvice":
        return DecayingAdviceTable
    return GuardedShapingTable if kind in ("QInitialisation", "LookAheadAdvice") else ShapingTable


def _shaping_name(value: Any) -> ShapingTable:
    kinds = get_args(ShapingName)
    if value not in kinds:
        raise wrong(f"must be one of {', '.join(kinds)}: got {shown(value)}{meant(value, kinds)}")
    return _shaping_table({"type": value}).model_validate({"type": value})


class RetrainTable(Setting):
    """When the sources of a task are trained further."""

    drop: Number = Field(description="Return below where it started.")
    steps: Whole = Field(description="Further steps of each source.")
    times: Whole = Field(default=3, description="How often at most.")
    patience: Whole = Field(default=5, description="Checkpoints that have to agree.")

    def build(self) -> Any:
        """Return it."""
        from curricle.curriculum.retraining import RetrainSources

        return RetrainSources(**dict(self))


class EvaluationTable(Setting):
    """How the greedy policy is judged at each checkpoint."""

    method: Literal["auto", "exact", "rollouts", "off"] = Field(
        default="auto", description="Exactly, by rollouts, exactly where the task is small, or off."
    )
    episodes: Whole | None = Field(
        default=None, description="Rollouts a checkpoint; 100, or 5 of a task played live."
    )
    discounted: Flag = Field(default=True, description="Whether rewards are discounted or summed.")

    def build(self) -> Any:
        """Return the evaluation."""
        from curricle.planning.policy_evaluation import GreedyEvaluation

        return GreedyEvaluation(**dict(self))


def _memory(value: Any) -> int | str | None:
    return value if value is None or isinstance(value, str) else whole_number(value)


class StorageTable(Setting):
    """How learnt values are held."""

    kind: Literal["auto", "dense", "sparse"] = Field(
        default="auto", description="A row for every state, or for the states met."
    )
    dtype: Literal["float64", "float32"] = Field(default="float64", description="Precision.")
    memory_limit: Annotated[int | str | None, BeforeValidator(_memory)] = Field(
        default=None,
        description="Bytes, or \"4 GiB\", that a seed's tables may take; half the machine's.",
    )
    save_values: Flag = Field(
        default=True, description="Whether values are kept; a source's must be."
    )

    def build(self) -> Any:
        """Return the storage."""
        from curricle.learning.storage import Storage

        return Storage(**dict(self))


def _budget_table(value: dict[str, Any]) -> type[Setting]:
    return EpisodesTable if "episodes" in value else StoppingRuleTable


def _aggregate(value: str) -> str:
    if value not in AGGREGATES and ":" not in value:
        raise wrong(
            f"must be one of {', '.join(AGGREGATES)}, or a function as module:function: got "
            f"{value!r}{meant(value, AGGREGATES)}"
        )
    return value


class Settings(Table):
    """Settings that hold for all tasks, or for one."""

    aggregate: Annotated[str, AfterValidator(_aggregate)] = Field(
        default="mean",
        description="How several potentials into a task become one: maximum, mean, minimum, total, "
        "or a function (N, S, A) -> (S, A) as module:function.",
    )
    learner: Annotated[LearnerTable | DeepLearnerTable, either(_learner_table, no_table)] = Field(
        default=LearnerTable(), description="Who learns."
    )
    budget: Annotated[
        Whole | EpisodesTable | StoppingRuleTable, either(_budget_table, whole_number)
    ] = Field(
        default=100_000,
        description="Steps; { episodes = 800 }; or a stopping rule, { max_steps = 50_000, ... }.",
    )
    shaping: Annotated[ShapingTable, either(_shaping_table, _shaping_name)] = Field(
        default=GuardedShapingTable(), description="How a potential, or a network, enters learning."
    )
    retrain: RetrainTable | None = Field(
        default=None, description="Whether sources are trained further where the return drops."
    )
    eval_freq: Whole | None = Field(
        default=None, description="Steps between checkpoints; a hundredth of the budget by default."
    )
    evaluation: EvaluationTable = Field(
        default=EvaluationTable(), description="How the greedy policy is judged."
    )
    storage: StorageTable = Field(default=StorageTable(), description="How values are held.")

    def setting(self, which: str, folder: Path) -> Any:
        """Return one of the settings as :class:`Curriculum` takes it.

        Parameters
        ----------
        which : str
            Such as ``"learner"``.
        folder : Path
            Where the modules of a study's own functions are.
        """
        value = getattr(self, which)
        if which == "aggregate":
            return _aggregate_function(value, folder)
        if isinstance(value, DeepLearnerTable):
            return value.build(folder)
        return _built(value)


def _aggregate_function(name: str, folder: Path) -> Callable[..., Any]:
    from curricle.transfer import aggregation

    if name in AGGREGATES:
        return getattr(aggregation, name)  # type: ignore[no-any-return]
    return load(name, folder)


def _built(value: Any) -> Any:
    return value.build() if isinstance(value, Setting) else value
