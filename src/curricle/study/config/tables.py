"""What every table of a study file is: frozen, closed to unknown keys, plain about mistakes."""

import math
from collections.abc import Callable, Collection, Iterable
from difflib import get_close_matches
from typing import Annotated, Any, Self

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    Strict,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

SHOWN = 60
"""Characters of a value that a message repeats."""
PHRASES = {
    "float_type": "must be a number",
    "bool_type": "must be true or false",
    "string_type": "must be text in quotes",
    "list_type": "must be a list",
    "tuple_type": "must be a list",
    "dict_type": "must be a table",
    "greater_than_equal": "must be at least {ge}",
    "string_too_short": "must not be empty",
    "too_short": "must have {min_length} or more entries",
    "too_long": "must have {max_length} entries",
    "literal_error": "must be {expected}",
}
"""What pydantic's errors are called in a sentence."""

Place = tuple[str | int, ...]
"""Where something is written: the keys and the list indices that lead to it."""


class Table(BaseModel):
    """A table of a study file.

    Raises
    ------
    pydantic.ValidationError
        Each of whose messages ends a sentence that begins with the place, such as
        "must be a number: got 'x'".
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    @classmethod
    def known(cls) -> tuple[str, ...]:
        """Return the keys that may stand in the table."""
        return tuple(cls.model_fields)

    @model_validator(mode="wrap")
    @classmethod
    def _speak_plainly(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        if not isinstance(data, dict | cls):
            raise wrong(f"must be a table: got {shown(data)}")
        try:
            return handler(data)
        except ValidationError as error:
            raise ValidationError.from_exception_data(
                cls.__name__,
                [
                    _detail(one["loc"], _sentence(one, cls.known()), one["input"])
                    for one in error.errors(include_url=False)
                ],
            ) from None


def wrong(text: str) -> PydanticCustomError:
    """Return the error that says this of the value being validated."""
    return PydanticCustomError("wrong", "{text}", {"text": text})


def wrong_at(place: Place, text: str, value: Any) -> ValidationError:
    """Return the error that says this of a part of the value being validated."""
    return ValidationError.from_exception_data("study", [_detail(place, text, value)])


def all_wrong(found: Iterable[tuple[Place, str]]) -> ValidationError:
    """Return the error that says each text of its place in the value being validated."""
    details = [_detail(place, text, None) for place, text in found]
    return ValidationError.from_exception_data("study", details)


def shown(value: Any) -> str:
    """Return a value as a message repeats it."""
    words = repr(value)
    return words if len(words) <= SHOWN else f"{words[: SHOWN - 3]}..."


def meant(word: Any, known: Iterable[str]) -> str:
    """Return ``, did you mean 'that'?`` for the known word that is closest; empty if none is.

    Examples
    --------
    >>> meant("predatrs", ["size", "predators"])
    ", did you mean 'predators'?"
    """
    plain = {one.lower(): one for one in known}
    close = get_close_matches(str(word).lower(), plain, n=1)
    return f", did you mean {plain[close[0]]!r}?" if close else ""


def unknown(word: Any, known: Collection[str]) -> str:
    """Return that a word is unknown, and which was meant, or else all that are known.

    Examples
    --------
    >>> unknown("predatrs", ["size", "predators"]), unknown("x", ["size", "predators"])
    ("is unknown, did you mean 'predators'?", 'is unknown: known are size, predators')
    """
    others = f": known are {', '.join(known)}" if known else ""
    return f"is unknown{meant(word, known) or others}"


def _detail(place: Place, text: str, value: Any) -> InitErrorDetails:
    return InitErrorDetails(type=wrong(text), loc=place, input=value)


def _sentence(error: Any, keys: Collection[str]) -> str:
    """Return what an error of pydantic says, as the end of a sentence."""
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
    return f"{phrase}: got {shown(error['input'])}{meant(error['input'], words)}"


def whole_number(value: Any) -> int:
    """Return a whole number: 1000, 1_000 or 1e3."""
    whole = isinstance(value, int | float) and math.isfinite(value) and value == int(value)
    if not whole or isinstance(value, bool):
        raise wrong(f"must be a whole number: got {shown(value)}")
    return int(value)


def number(value: Any) -> float:
    """Return a finite number."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise wrong(f"must be a number: got {shown(value)}")
    if not math.isfinite(value):
        raise wrong(f"must be finite: got {value}")
    return float(value)


def flag(value: Any) -> bool:
    """Return true or false, of what may be a table too."""
    if not isinstance(value, bool):
        raise wrong(f"must be true, false or a table: got {shown(value)}")
    return value


def no_table(value: Any) -> Any:
    """Refuse what is no table."""
    raise wrong(f"must be a table: got {shown(value)}")


Whole = Annotated[int, BeforeValidator(whole_number)]
Count = Annotated[Whole, Field(ge=1)]
Number = Annotated[float, BeforeValidator(number)]
Flag = Annotated[bool, Strict()]
Name = Annotated[str, Field(min_length=1)]


def either(
    choose: Callable[[dict[str, Any]], type[Table]], bare: Callable[[Any], Any]
) -> WrapValidator:
    """Return a validator of what may be one of several tables, or something simpler.

    Unlike pydantic's unions it complains about the one table that was meant.

    Parameters
    ----------
    choose : callable
        Says which table a dict is.
    bare : callable
        Validates what is no table.
    """

    def validate(value: Any, _: ValidatorFunctionWrapHandler, info: ValidationInfo) -> Any:
        if isinstance(value, dict):
            return choose(value).model_validate(value, context=info.context)
        return value if isinstance(value, Table) else bare(value)

    return WrapValidator(validate)


def by_type(*tables: type[Table]) -> Callable[[dict[str, Any]], type[Table]]:
    """Return what chooses a table by its key ``type``."""
    kinds = {str(table.model_fields["type"].default): table for table in tables}

    def choose(value: dict[str, Any]) -> type[Table]:
        if "type" not in value:
            raise wrong_at(("type",), f"is missing: one of {', '.join(kinds)}", value)
        kind = value["type"]
        if not isinstance(kind, str) or kind not in kinds:
            valid = f"must be one of {', '.join(kinds)}"
            raise wrong_at(("type",), f"{valid}: got {shown(kind)}{meant(kind, kinds)}", value)
        return kinds[kind]

    return choose
