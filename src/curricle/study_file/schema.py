"""The tables of a study file: their common parts, and the tables of settings and transfers.

The library's frozen dataclasses and functions are the schema. :func:`table_of` derives a table from
a class: the keys are its parameters, with their types and defaults, and with their descriptions
from the numpydoc "Parameters" section. The class itself checks the values when the object is built.

A ``TypeAdapter(cls)`` would not do: it holds the object instead of the file's values. Objects
convert their arguments (a map becomes rows, a number a schedule). Records and keys hold the file's
values, and would change whenever a conversion does. Objects also have no key ``type``, and 1e3 is a
whole number in a study file.
"""

import inspect
import re
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, is_dataclass
from functools import cache, cached_property
from pathlib import Path
from types import NoneType, UnionType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Literal,
    NamedTuple,
    Self,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

from pydantic import (
    AfterValidator,
    AllowInfNan,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    JsonValue,
    ModelWrapValidatorHandler,
    Strict,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    create_model,
    model_validator,
)
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from curricle.checks import BEYOND_64_BITS, LONGEST_NAME, unfit_name
from curricle.deep.learner import DeepLearner, PolicyReuse, WeightTransfer
from curricle.errors import ConfigError
from curricle.interop.encoders import MiniGridFullView, MiniGridView
from curricle.learning.learners import LEARNERS_BY_NAME
from curricle.learning.schedules import Schedule, exponential, harmonic, linear
from curricle.learning.seeds import MOST_SEEDS
from curricle.learning.shaping import (
    LookAheadAdvice,
    QInitialisation,
    RewardBonus,
    StateShaping,
)
from curricle.learning.stopping import Episodes, StoppingRule
from curricle.learning.storage import Storage
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.study_file.own_code import load, suggestion, users_code
from curricle.tasks.observation_task import is_observation_task
from curricle.transfer import aggregate, by_components
from curricle.transfer.by_components import check_same_observations, identity
from curricle.transfer.mapping import ObservationMapping, from_function
from curricle.transfer.search import announced
from curricle.transfer.transfer import Transfer

# -- Tables: frozen, without unknown keys, and with messages in plain words ------------------------

KeyPath = tuple[str | int, ...]  # the keys and list indices that lead to a value of a study file
SHOWN = 60  # characters of a value that a message repeats
PHRASES = {
    "float_type": "must be a number",
    "finite_number": "must be finite",
    "bool_type": "must be true or false",
    "string_type": "must be text in quotes",
    "list_type": "must be a list",
    "tuple_type": "must be a list",
    "dict_type": "must be a table",
    "greater_than_equal": "must be at least {ge}",
    "less_than_equal": "must be at most {le:,}",
    "string_too_short": "must not be empty",
    "too_short": "must have {min_length} or more entries",
    "too_long": "must have at most {max_length} entries",
    "literal_error": "must be {expected}",
}
"""Type of a Pydantic error -> its message, as the rest of a sentence."""


class Table(BaseModel):
    """A table of a study file; its error messages follow a key path in a sentence."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @classmethod
    def known(cls) -> tuple[str, ...]:
        """Return the keys that the table allows."""
        return tuple(cls.model_fields)

    @model_validator(mode="wrap")
    @classmethod
    def _plain_messages(cls, data: object, handler: ModelWrapValidatorHandler[Self]) -> Self:
        try:
            return handler(data if isinstance(data, cls) else as_table(data))
        except ValidationError as error:
            messages = list[tuple[KeyPath, str]]()
            for detail in error.errors():
                kind, context = detail["type"], detail.get("ctx", {})
                text = {"wrong": detail["msg"], "missing": "is missing"}.get(kind, "")
                if kind == "extra_forbidden":
                    text = unknown(detail["loc"][-1], cls.known())
                elif not text:
                    phrase = PHRASES.get(kind, "is not understood").format(**context)
                    words = context["expected"].split("'")[1::2] if kind == "literal_error" else ()
                    text = f"{phrase}: got {shown(detail['input'])}"
                    text += suggestion(detail["input"], words)
                messages.append((detail["loc"], text))
            raise wrong_at(*messages) from None


def wrong(text: str) -> PydanticCustomError:
    """Return an error with this message about the value being validated."""
    return PydanticCustomError("wrong", "{text}", {"text": text})


def wrong_at(*messages: tuple[KeyPath, str]) -> ValidationError:
    """Return an error with messages about parts of the value being validated."""
    details = [InitErrorDetails(type=wrong(text), loc=path, input=None) for path, text in messages]
    return ValidationError.from_exception_data("study", details)


def shown(value: object) -> str:
    """Return a value as short text for messages."""
    text = repr(value)
    return text if len(text) <= SHOWN else f"{text[: SHOWN - 3]}..."


def not_one_of(value: object, words: Collection[str]) -> str:
    """Return the message that a value must be a known word."""
    return f"must be one of {', '.join(words)}: got {shown(value)}{suggestion(value, words)}"


def unknown(word: object, words: Collection[str]) -> str:
    """Return the message that a word is unknown, with the closest known word, else all of them."""
    all_known = f": known are {', '.join(words)}" if words else ""
    return f"is unknown{suggestion(word, words) or all_known}"


# -- Single values: numbers, names, words, seeds, and choices among tables -------------------------


def table(value: object) -> dict[str, Any]:
    """Return a value that is a table, and an empty table for any other value."""
    return value if isinstance(value, dict) else {}


def as_table(value: object) -> dict[str, Any]:
    """Return a value that is a table; refuse any other value."""
    if not isinstance(value, dict):
        raise wrong(f"must be a table: got {shown(value)}")
    return value


def whole_number(value: object) -> int:
    """Return a whole number: 1000, 1_000 or 1e3."""
    if not isinstance(value, int | float) or isinstance(value, bool) or value % 1 != 0:
        raise wrong(f"must be a whole number: got {shown(value)}")
    if abs(value) >= BEYOND_64_BITS:
        raise wrong(f"must fit into 64 bits: got {shown(value)}")
    return int(value)


class Function(str):
    """A user's function, named as ``module:function``; :func:`built` loads it."""

    __slots__ = ()


def word(
    rule: str,
    words: Collection[str] = (),
    *,
    function: bool = False,
    lists: Any = None,
    other: Callable[[object], object] | None = None,
) -> WrapValidator:
    """Return the validator of a known word; `other` validates values that are not text."""
    # With a union of both types, the message about a wrong list would say that it is no word.
    adapter = None if lists is None else TypeAdapter[Any](lists)

    def checked(value: object, _: object) -> object:
        if isinstance(value, str):
            if function and ":" in value:
                return Function(value)
            if value in words:
                return value
        elif other is not None:
            return other(value)
        elif adapter is not None and isinstance(value, list | tuple):
            return adapter.validate_python(value)
        raise wrong(f"must {rule}: got {shown(value)}{suggestion(value, words)}")

    return WrapValidator(checked)


def _fit_name(text: str) -> str:
    if why := unfit_name(text):
        raise wrong(why)
    return text


Whole = Annotated[int, BeforeValidator(whole_number)]
Count = Annotated[Whole, Field(ge=1)]
Number = Annotated[float, Strict(), AllowInfNan(False)]
Flag = Annotated[bool, Strict()]
Name = Annotated[
    str,
    AfterValidator(_fit_name),
    Field(json_schema_extra={"minLength": 1, "maxLength": LONGEST_NAME}),
]
Reference = Annotated[str, word("name a function as module:function", function=True)]
"""A function as ``module:function``."""


def seeds_of(value: object) -> tuple[int, ...]:
    """Return the seeds that a file's value names, such as 30, [0, 1, 7] or "0-9,20-29"."""
    numbers: Any = seeds_in_ranges(value) if isinstance(value, str) else value
    if type(numbers) is int:
        numbers = range(min(numbers, MOST_SEEDS + 1))
    several = isinstance(numbers, list | tuple | range) and 0 < len(numbers) <= MOST_SEEDS
    whole = several and all(type(n) is int and 0 <= n < BEYOND_64_BITS for n in numbers)
    if not whole or len(set(numbers)) < len(numbers):
        raise wrong(
            'must be a number of seeds, a list of different ones, or ranges such as "0-9,20-29", '
            f"{MOST_SEEDS:,} at most: got {shown(value)}"
        )
    return tuple(numbers)


def seeds_in_ranges(text: str) -> list[int]:
    """Return the seeds in ranges such as "0-9,20-29"; [] if malformed or too many."""
    numbers = list[int]()
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d{1,19})\s*(?:-\s*(\d{1,19})\s*)?", part, re.ASCII)
        named = range(int(match[1]), int(match[2] or match[1]) + 1) if match else range(0)
        if not named or len(numbers) + named.stop - named.start > MOST_SEEDS:
            return []
        numbers += named
    return numbers


@dataclass(frozen=True)
class Choice:
    """Annotation of a value that is a table of several kinds; messages are about the meant kind."""

    tables: tuple[type[Table], ...]
    default: str | None = None  # the ``type`` of a table without this key
    choose: Callable[[dict[str, Any]], Any] = lambda value: None
    """Returns the kind of table that a dict is meant to be; if None, its key ``type`` tells."""
    simple: Any = None  # the type of values that are not tables, if such values are allowed

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        types = [*self.tables, *([] if self.simple is None else [self.simple])]
        return core_schema.with_info_wrap_validator_function(
            self._validated, handler.generate_schema(Union[*types])
        )

    @cached_property
    def _of_simple(self) -> Callable[[Any], Any]:
        return as_table if self.simple is None else TypeAdapter(self.simple).validate_python

    def _validated(
        self, value: object, _: ValidatorFunctionWrapHandler, info: ValidationInfo
    ) -> object:
        if not isinstance(value, dict):
            return value if isinstance(value, Table) else self._of_simple(value)
        meant = self.tables[0] if len(self.tables) == 1 else self.choose(value)
        if meant is None:
            name, by_name = value.get("type", self.default), tags(self.tables)
            if "type" not in value and self.default is None:
                raise wrong_at((("type",), f"is missing: one of {', '.join(by_name)}"))
            if not isinstance(name, str) or name not in by_name:
                raise wrong_at((("type",), not_one_of(name, by_name)))
            meant = by_name[name]
        return meant.model_validate(value, context=info.context)


def tags(tables: Iterable[type[Table]]) -> dict[str, type[Table]]:
    """Return value of the key ``type`` -> table."""
    return {str(made.model_fields["type"].default): made for made in tables}


# -- Tables from the library's frozen dataclasses and functions ------------------------------------


class ObjectTable(Table):
    """A table that stands for an object of the library."""

    makes: ClassVar[Any]
    """The class or function that makes the object."""
    parameters: ClassVar[tuple[str, ...]] = ()
    """The parameters of `makes` that are keys of the table."""

    def build(self, folder: Path = Path()) -> Any:
        """Return the object; the class or function itself raises an error if values are invalid."""
        return type(self).makes(**self.arguments_in(folder))

    def arguments_in(self, folder: Path) -> dict[str, Any]:
        """Return the arguments of `makes`, with inner tables built and functions loaded."""
        return {name: built(getattr(self, name), folder) for name in self.parameters}


def built(value: object, folder: Path) -> Any:
    """Return the object of a table, or the function of a reference; other values unchanged."""
    if isinstance(value, Function):
        return load(value, folder)
    return value.build(folder) if isinstance(value, ObjectTable) else value


@cache
def table_of(
    makes: Any,
    base: type[ObjectTable] = ObjectTable,
    *,
    tag: str | None = None,
    without: tuple[str, ...] = (),
    **annotations: Any,
) -> Any:
    """Return the table of a dataclass or function; `tag` is the value of its key ``type``.

    `annotations` give the types of parameters in a file, or (type, default in a file).
    """
    hints, texts = get_type_hints(makes), descriptions(makes)
    signature = inspect.signature(makes).parameters
    parameters = {name: of.default for name, of in signature.items() if name not in without}
    fields: dict[str, Any] = {} if tag is None else {"type": (Literal[tag], tag)}
    for name, default in parameters.items():
        annotation = annotations.get(name) or annotated(hints[name])
        if isinstance(annotation, tuple):
            annotation, default = annotation
        kind = cast(Any, type(default))
        if default is inspect.Parameter.empty:
            default = ...
        elif _is_dataclass(kind):
            default = table_of(kind)()
        elif kind.__name__ == "_HAS_DEFAULT_FACTORY_CLASS":
            default = {}
        fields[name] = (annotation, Field(default, description=texts[name]))
    made = create_model(tag or makes.__name__, __base__=base, __doc__=summary(makes), **fields)
    made.makes, made.parameters = makes, tuple(parameters)
    return made


def annotated(hint: object) -> object:
    """Return the type of the TOML values for a parameter of this type."""
    if hint in _PLAIN:
        return _PLAIN[hint]
    members = get_args(hint)
    if get_origin(hint) in (Union, UnionType):
        if Schedule in members:
            return Rate | None if NoneType in members else Rate
        tables = [table_of(member) for member in members if _is_dataclass(member)]
        if tables and (bool in members or NoneType in members):
            made, off = tables[0], False if bool in members else None

            def flag(value: object, _: object) -> object:  # true stands for a table of defaults
                if not isinstance(value, bool):
                    raise wrong(f"must be true, false or a table: got {shown(value)}")
                return made() if value else off

            return Annotated[Any, Choice((made,), simple=Annotated[bool, WrapValidator(flag)])]
        return Union[*tables, *(annotated(other) for other in members if not _is_dataclass(other))]
    if get_origin(hint) is Callable:
        return Reference
    if get_origin(hint) is tuple:
        return tuple[*map(annotated, members)]  # type: ignore[misc]
    return table_of(hint) if _is_dataclass(hint) else hint


def _is_dataclass(hint: object) -> bool:  # no TypeGuard: a narrowed class would not be hashable
    return is_dataclass(hint)


def summary(makes: object) -> str:
    """Return the first paragraph of a docstring, without markup."""
    return _plain((inspect.getdoc(makes) or "").partition("\n\n")[0])


def descriptions(makes: Callable[..., Any]) -> dict[str, str]:
    """Return parameter -> its description in the numpydoc, by default the summary."""
    docs = [inspect.getdoc(kind) or "" for kind in getattr(makes, "__mro__", (makes,))]
    texts = dict.fromkeys(inspect.signature(makes).parameters, summary(makes))
    for doc in reversed(docs):
        section = re.search(r"Parameters\n-+\n(.*?)(\n\n\w[\w ]*\n-+\n|\Z)", doc, re.DOTALL)
        for entry in re.finditer(
            r"^(\w[\w, ]*?)(?: : (.*))?\n((?:[ ]+.*\n?|\n)*)",
            f"{section[1]}\n" if section else "",
            re.MULTILINE,
        ):
            text = _plain(entry[3]) or _plain(entry[2] or "")
            texts |= dict.fromkeys(re.split(r",\s*", entry[1]), text) if text else {}
    return texts


def _plain(text: str) -> str:
    """Return a part of a docstring on one line, without markup."""
    return " ".join(re.sub(r":\w+:`~?([^`]*)`|`+([^`]*)`+", r"\1\2", text).split())


_PLAIN: dict[Any, Any] = {int: Whole, float: Number, bool: Flag, NoneType: None}
_SCHEDULES = tuple(table_of(makes, tag=makes.__name__) for makes in (linear, exponential, harmonic))
Rate = Annotated[Any, Choice(_SCHEDULES, simple=Number)]
"""A number, or the table of a schedule."""


def named(*tables: type[Table], function: bool = False) -> Any:
    """Return the type of a table for which its name, or ``module:function``, may stand."""
    by_name = tags(tables)

    def simple(value: object, _: object) -> object:
        if function and isinstance(value, str) and ":" in value:
            return Function(value)
        if not isinstance(value, str) or value not in by_name:
            raise wrong(not_one_of(value, by_name) + " (or module:function)" * function)
        needed = [key for key, field in by_name[value].model_fields.items() if field.is_required()]
        if needed:
            raise wrong(f"must be a table, as {value} needs {' and '.join(needed)}: got {value!r}")
        return by_name[value]()

    return Annotated[str, WrapValidator(simple)]


# -- Encoders of observations: a name, a table, or a user's function -------------------------------


_ENCODERS = (
    table_of(MiniGridView, tag="MiniGridView"),
    table_of(MiniGridFullView, tag="MiniGridFullView"),
)
AnyEncoder: Any = Annotated[Any, Choice(_ENCODERS, simple=named(*_ENCODERS, function=True))]
"""An encoder: ``"MiniGridView"``, a table of its settings or ``"module:function"``."""


# -- Settings of learning: learner, budget, how potentials enter, evaluation, storage --------------

AGGREGATES = tuple(sorted(aggregate.BUILT_IN))
DEEP = "deep"  # the `type` of a learner that is a network


class _DeepLearnerTable(ObjectTable):
    def arguments_in(self, folder: Path) -> dict[str, Any]:
        """Return the arguments, the study's own classes and functions loaded."""
        arguments = super().arguments_in(folder)
        if ":" in arguments["algorithm"]:
            algorithm = load(arguments["algorithm"], folder)
            arguments["algorithm"] = f"{algorithm.__module__}:{algorithm.__qualname__}"
        settings = table(_loaded(arguments["settings"], folder))
        if settings.get("tensorboard_log") is not None:
            raise ConfigError(
                "a study writes into its results alone, and settings.tensorboard_log names "
                f"{settings['tensorboard_log']!r}: leave it out, and follow a run by a tracker"
            )
        # The algorithms take tuples, such as train_freq, where TOML has lists.
        arguments["settings"] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in settings.items()
        }
        return arguments


def _loaded(value: object, folder: Path) -> object:
    """Return a setting with its texts ``module:name`` replaced by the named objects."""
    if isinstance(value, dict):
        return {name: _loaded(inner, folder) for name, inner in value.items()}
    if isinstance(value, list):
        return [_loaded(inner, folder) for inner in value]
    if isinstance(value, str) and re.fullmatch(r"[\w.]+:[\w.]+", value):
        return load(value, folder)
    return value


class EpisodesTable(ObjectTable):
    """A budget in episodes."""  # written by hand: the parameter `number` has the key `episodes`

    episodes: Whole
    """How many."""

    def build(self, folder: Path = Path()) -> Episodes:
        """Return the budget."""
        return Episodes(self.episodes)


LEARNERS = tuple(table_of(kind, tag=name) for name, kind in LEARNERS_BY_NAME.items())  # type: ignore[arg-type]
DeepLearnerTable = table_of(
    DeepLearner,
    _DeepLearnerTable,
    tag=DEEP,
    without=("callbacks", "progress_bar"),
    settings=dict[str, JsonValue],
)
StoppingTable = table_of(StoppingRule)
SHAPINGS = tuple(
    table_of(kind, tag=kind.__name__, without=("potential", "source"))
    for kind in (
        *(QInitialisation, LookAheadAdvice, StateShaping, RewardBonus),
        *(WeightTransfer, PolicyReuse),
    )
)
"""The ways a potential or a network enters learning; the potential comes from elsewhere."""
EvaluationTable = table_of(GreedyEvaluation)
StorageTable = table_of(
    Storage,
    memory_limit=Annotated[
        int | str | None,
        BeforeValidator(lambda limit: limit if isinstance(limit, str) else whole_number(limit)),
    ],
)
AnyLearner = Annotated[Any, Choice((*LEARNERS, DeepLearnerTable), "QLearning")]
AnyBudget = Annotated[
    Any,
    Choice(
        (EpisodesTable, StoppingTable),
        choose=lambda value: EpisodesTable if "episodes" in value else StoppingTable,
        simple=Whole,
    ),
]
AnyShaping = Annotated[Any, Choice(SHAPINGS, "QInitialisation", simple=named(*SHAPINGS))]
_AGGREGATE = f"be one of {', '.join(AGGREGATES)}, or a function as module:function"


class Settings(Table):
    """Settings for all tasks, or for one."""

    aggregate: Annotated[str, word(_AGGREGATE, AGGREGATES, function=True)] = Field(
        "mean",
        description="How the potentials of several transfers are combined: "
        f"{', '.join(AGGREGATES)}, or a function (N, S, A) -> (S, A) as module:function.",
    )
    unknown_value: Number | None = None
    """The potential of pairs that all mappings leave unmapped; 0 by default."""
    potential: Reference | None = None
    """A potential written by hand, for tasks without transfers into them: a function of the task,
    module:function, that returns phi as an (S, A) array, or state values as an (S,) array."""
    learner: AnyLearner = None
    """The learning algorithm; by default QLearning, for a source with tables and without sources of
    its own OptimisticQLearning."""
    budget: AnyBudget = None
    """Steps; { episodes = 800 }; or a stopping rule, { max_steps = 50_000, ... }. By default
    100_000 for the target. A source ends when its return has settled, when its optimistic values
    agree with the learnt ones, or after its steps: by default a tenth of the target's, which all
    such sources share, or 3 % and 10 for each pair where an optimistic learner learns."""
    shaping: AnyShaping = None
    """How a potential, or a network, enters learning: its name, or { type = "QInitialisation",
    portfolio = true }, which is the default where it is possible."""
    eval_freq: Whole | None = None
    """Steps between checkpoints; a hundredth of the budget by default."""
    evaluation: Annotated[Any, Choice((EvaluationTable,))] = EvaluationTable()
    """How the greedy policy is evaluated."""
    storage: Annotated[Any, Choice((StorageTable,))] = StorageTable()
    """How values are stored."""

    def setting(self, which: str, folder: Path) -> Any:
        """Return a setting, such as ``"learner"``, as :class:`Curriculum` takes it."""
        value = getattr(self, which)
        if which == "aggregate" and value in AGGREGATES:
            return aggregate.BUILT_IN[value].function
        return built(value, folder)


# -- Transfers: their mapping, scale and shift -----------------------------------------------------

MAPPINGS = ("project", "mapping", "function", "factory", "observations")  # a transfer has one
OF_OBSERVATIONS = ("observations", "actions", "status")  # keys for targets that networks learn
ACTIONS = (
    "be a list of the source's actions, -1 where there is none, or a function as module:function"
)


End = Annotated[
    Literal["first", "last"] | int,
    word("be 'first', 'last' or a whole number", ("first", "last"), other=whole_number),
]


class _TransferTable(ObjectTable):
    if TYPE_CHECKING:
        source: str  # derived from Transfer, as are target, scale and shift
        target: str
        scale: float
        shift: float

    # The keys for the mapping f are written by hand: five functions make mappings of them.
    project: dict[str, str] | None = None
    """f by name: source component = target component where the names differ; may be empty."""
    aligned: dict[str, End] | None = None
    """With project: components of states whose ranges are aligned at the 'first' or 'last' value,
    or the number that is added to the target's value."""
    unequal: Literal["clip", "scale"] | None = None
    """With project: values that the source lacks are clipped or scaled, not unmapped."""
    mapping: (
        Literal["identity", "same_position", "relative_objects", "family", "candidate", "auto"]
        | None
    ) = None
    """f, one of Curricle's other mappings; 'family' and 'candidate' are what the family of both
    tasks or the candidate has, a transfer for each; 'auto' is the best that is found."""
    function: Reference | None = None
    """f as a function from the target's decoded states and actions to the source's,
    module:function."""
    factory: Reference | None = None
    """A function that makes f from the tasks, (target, source) -> mapping."""
    observations: Reference | None = None
    """f as a function from a target's stacked observations to the source's, or to the numbers of
    its states, module:function."""
    actions: Annotated[
        tuple[int, ...] | str | None, word(ACTIONS, function=True, lists=tuple[Whole, ...])
    ] = None
    """With observations: the source's action for each of the target's, -1 where there is none, or a
    function of observations, module:function."""
    status: Reference | None = None
    """With observations: a function from them to whether there is a counterpart,
    module:function."""
    unmapped_value: Number | None = None
    """A value for pairs without a source pair; by default aggregates skip them, and a mapping that
    is found has the value that fits."""

    @model_validator(mode="after")
    def _one_mapping(self) -> Self:
        ways = [name for name in MAPPINGS if getattr(self, name) is not None]
        if len(ways) != 1:
            raise wrong(f"must have one of {', '.join(MAPPINGS)}: got {', '.join(ways) or 'none'}")
        if self.project is None and (self.aligned or self.unequal):
            raise wrong("has aligned or unequal, which go with project")
        of_observations = self.actions is not None or self.status is not None
        if of_observations and self.observations is None and self.mapping != "identity":
            raise wrong("has actions or status, which go with observations or mapping = 'identity'")
        whole = self.mapping == "identity" and not of_observations
        if self.unmapped_value is not None and (self.factory is not None or whole):
            raise wrong(
                "has an unmapped_value that is not used: a factory sets its own, and identity "
                "leaves nothing unmapped"
            )
        return self

    def mismatches(self, *, deep: bool) -> Iterator[tuple[str, str]]:
        """Yield keys that do not suit a target, with messages; `deep`: a network learns it."""
        rule = (
            f"{self.target} is seen through observations, which observations, mapping = 'identity' "
            "or factory map"
        )
        if deep and self.mapping not in (None, "identity"):
            yield "mapping", f"must be left out, or 'identity': {rule}"
            return
        rest = rule if deep else f"{self.target} is not seen through observations"
        for key in ("project", "function") if deep else OF_OBSERVATIONS:
            if getattr(self, key) is not None:
                yield key, f"must be left out: {rest}"

    def transfer(self, f: object) -> Transfer:
        """Return the transfer with the mapping `f`."""
        return Transfer(mapping=f, **self.arguments_in(Path()))

    def mapping_in(
        self,
        target: Any,
        source: Any,
        folder: Path,
        *,
        fit_unmapped: bool,
        say: Callable[[str], object],
    ) -> object:
        """Return the mapping f of a transfer for which no family or candidate makes it."""
        value = self.unmapped_value
        if self.mapping == "auto":
            edge = self.transfer(None)
            best = announced(edge, target, source, value, fit_unmapped=fit_unmapped, say=say)
            return best.mapping
        if is_observation_task(target) and self.factory is None:
            functions = {key: built(getattr(self, key), folder) for key in OF_OBSERVATIONS}
            if self.mapping == "identity":
                check_same_observations(target, source)
            return ObservationMapping(target, source, **functions, unmapped_value=value)
        if self.project is not None:
            how: Any = {"unequal": self.unequal or "unmapped", "aligned": self.aligned}
            how |= {"unmapped_value": value, **self.project}
            return by_components.project(target, source, **how)
        if self.mapping == "identity":
            return identity(target, source)
        if self.mapping is not None:
            return getattr(by_components, self.mapping)(target, source, unmapped_value=value)
        reference = str(self.factory or self.function)
        function = load(reference, folder)
        with users_code(reference):
            if self.factory is not None:
                return function(target, source)
            return from_function(target, source, function, unmapped_value=value)


if TYPE_CHECKING:
    TransferTable = _TransferTable
else:
    TransferTable = table_of(
        Transfer, _TransferTable, without=("mapping",), source=Name, target=Name
    )


# -- The names of a curriculum's tasks, before tasks are built -------------------------------------


class NameGraph(NamedTuple):
    """The tasks of a curriculum by name, its crops and its transfers."""

    parts: dict[str, str | None]  # task -> the task of which it is a crop, or None
    edges: tuple[tuple[str, str], ...]  # source and target of each transfer

    @classmethod
    def of(cls, plan: dict[str, Any]) -> "NameGraph":
        """Return the graph of a curriculum in plain data, which may be malformed in any part."""
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
        """The tasks that are learnt: all except tasks that are only cropped."""
        linked = {name for edge in self.edges for name in edge}
        cropped = set(self.parts.values())
        return [name for name in self.parts if name in linked or name not in cropped]

    @property
    def targets(self) -> list[str]:
        """The learnt tasks on which no other task builds; a curriculum has one."""
        sources = {source for source, _ in self.edges}
        return [name for name in self.learnt if name not in sources]

    def drawings(self, name: str) -> list[str]:
        """Return a task, the task of which it is a crop, and so on."""
        names, part = list[str](), name
        while part is not None and part not in names:
            names.append(part)
            part = self.parts.get(part)  # type: ignore[assignment]
        return names
