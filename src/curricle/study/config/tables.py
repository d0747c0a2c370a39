"""The base of all tables of a study file: frozen, without unknown keys, with plain messages."""

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from functools import reduce
from operator import or_
from typing import Annotated, Any, Self

from pydantic import (
    AfterValidator,
    AllowInfNan,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    ModelWrapValidatorHandler,
    Strict,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    model_validator,
)
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from curricle.checks import BEYOND_64_BITS, LONGEST_NAME, unfit_name

SHOWN = 60
"""Characters of a value that a message repeats."""
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
    "too_long": "must have {max_length} entries",
    "literal_error": "must be {expected}",
}
"""The types of Pydantic's errors, as parts of a sentence."""

KeyPath = tuple[str | int, ...]
"""The keys and list indices that lead to a value of a study file."""


class Table(BaseModel):
    """A table of a study file.

    Each message of its ValidationErrors ends a sentence that begins with the key path, such as
    "must be a number: got 'x'".
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    @classmethod
    def known(cls) -> tuple[str, ...]:
        """Return the keys that the table may have."""
        return tuple(cls.model_fields)

    @model_validator(mode="wrap")
    @classmethod
    def _plain_messages(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        try:
            return handler(data if isinstance(data, cls) else as_table(data))
        except ValidationError as error:
            raise wrong_at(
                *((one["loc"], _message(one, cls.known())) for one in error.errors())
            ) from None


def wrong(text: str) -> PydanticCustomError:
    """Return an error with this message about the value being validated."""
    return PydanticCustomError("wrong", "{text}", {"text": text})


def wrong_at(*found: tuple[KeyPath, str]) -> ValidationError:
    """Return one error with messages about parts of the value being validated."""
    details = [InitErrorDetails(type=wrong(text), loc=path, input=None) for path, text in found]
    return ValidationError.from_exception_data("study", details)


def shown(value: Any) -> str:
    """Return a value as messages repeat it."""
    text = repr(value)
    return text if len(text) <= SHOWN else f"{text[: SHOWN - 3]}..."


def suggestion(word: Any, known: Iterable[str]) -> str:
    """Return ``, did you mean 'that'?`` for the known word that is closest; empty if none is.

    Examples
    --------
    >>> suggestion("predatrs", ["size", "predators"])
    ", did you mean 'predators'?"
    """
    by_lower_case = {one.lower(): one for one in known}
    close = get_close_matches(str(word).lower(), by_lower_case, n=1)
    return f", did you mean {by_lower_case[close[0]]!r}?" if close else ""


def not_one_of(value: Any, known: Collection[str]) -> str:
    """Return that a value must be one of the known words."""
    return f"must be one of {', '.join(known)}: got {shown(value)}{suggestion(value, known)}"


def unknown(word: Any, known: Collection[str]) -> str:
    """Return that a word is unknown, with the closest known word or else all of them.

    Examples
    --------
    >>> unknown("predatrs", ["size", "predators"]), unknown("x", ["size", "predators"])
    ("is unknown, did you mean 'predators'?", 'is unknown: known are size, predators')
    """
    others = f": known are {', '.join(known)}" if known else ""
    return f"is unknown{suggestion(word, known) or others}"


def _message(error: Any, keys: Collection[str]) -> str:
    """Return one of Pydantic's errors as the end of a sentence."""
    kind, key = error["type"], error["loc"][-1] if error["loc"] else ""
    if kind == "wrong":
        return str(error["msg"])
    if kind == "missing":
        return "is missing"
    if kind == "extra_forbidden":
        return unknown(key, keys)
    context = error.get("ctx", {})
    phrase = PHRASES.get(kind, "is not understood").format(**context)
    words = context["expected"].split("'")[1::2] if kind == "literal_error" else ()
    return f"{phrase}: got {shown(error['input'])}{suggestion(error['input'], words)}"


def as_table(value: Any) -> dict[str, Any]:
    """Return a table as it is; refuse anything else."""
    if not isinstance(value, dict):
        raise wrong(f"must be a table: got {shown(value)}")
    return value


def whole_number(value: Any) -> int:
    """Return a whole number: 1000, 1_000 or 1e3."""
    whole = isinstance(value, int) or (isinstance(value, float) and value.is_integer())
    if not whole or isinstance(value, bool):
        raise wrong(f"must be a whole number: got {shown(value)}")
    if abs(value) >= BEYOND_64_BITS:
        raise wrong(f"must fit into 64 bits: got {shown(value)}")
    return int(value)


def word(
    rule: str,
    words: Collection[str] = (),
    *,
    function: bool = False,
    lists: Any = None,
    other: Callable[[Any], Any] = lambda value: value,
) -> BeforeValidator:
    """Return the validator of a value that is one of some words, or is no text.

    `rule` is what the value must be, for messages; `function` allows ``module:function`` too.
    `lists` is the type of a list in a word's place, and `other` validates whatever is no text.
    """
    if lists is not None:
        # Not left to the union of both types, which would complain about a list that it is no word.
        adapter = TypeAdapter[Any](lists)

        def other(value: Any) -> Any:
            if not isinstance(value, list | tuple):
                raise wrong(f"must {rule}: got {shown(value)}")
            return adapter.validate_python(value)

    def checked(value: Any) -> Any:
        if not isinstance(value, str):
            return other(value)
        if value in words or (function and ":" in value):
            return value
        raise wrong(f"must {rule}: got {shown(value)}{suggestion(value, words)}")

    return BeforeValidator(checked)


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


@dataclass(frozen=True)
class Choice:
    """Annotation of a value that is one of several tables, or something simpler.

    Unlike Pydantic's unions it reports only what is wrong with the one table that was meant.
    """

    tables: tuple[type[Table], ...]
    choose: Callable[[dict[str, Any]], type[Table]]
    """Returns the table that a dict is meant to be."""
    simple: Callable[[Any], Any] = as_table
    """Validates what is not a table."""
    simple_type: Any = None
    """The type of what `simple` accepts, for the JSON Schema."""

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        types = [*self.tables, *([] if self.simple_type is None else [self.simple_type])]
        return core_schema.with_info_wrap_validator_function(
            self._validated, handler.generate_schema(reduce(or_, types))
        )

    def _validated(self, value: Any, _: ValidatorFunctionWrapHandler, info: ValidationInfo) -> Any:
        if isinstance(value, dict):
            return self.choose(value).model_validate(value, context=info.context)
        return value if isinstance(value, Table) else self.simple(value)


def only(table: type[Table]) -> Choice:
    """Return the annotation of a value that is one table."""
    return Choice((table,), lambda _: table)


def tagged(
    *tables: type[Table],
    default: str | None = None,
    simple: Callable[[Any], Any] = as_table,
    simple_type: Any = None,
) -> Choice:
    """Return the choice among tables by their key ``type``, which may be left out for a default."""
    by_name = {str(table.model_fields["type"].default): table for table in tables}

    def choose(value: dict[str, Any]) -> type[Table]:
        if "type" not in value and default is None:
            raise wrong_at((("type",), f"is missing: one of {', '.join(by_name)}"))
        name = value.get("type", default)
        if not isinstance(name, str) or name not in by_name:
            raise wrong_at((("type",), not_one_of(name, by_name)))
        return by_name[name]

    return Choice(tables, choose, simple, simple_type)
