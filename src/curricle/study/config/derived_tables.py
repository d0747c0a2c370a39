"""Tables made from the library's frozen dataclasses and functions: one declaration for both.

A table has the parameters of what it builds, with their defaults, and their descriptions from the
numpydoc "Parameters" section; the library itself checks the values when the object is built.

Why not ``TypeAdapter(cls)``, which validates a dataclass as it is annotated: in strict mode it
refuses a TOML table (a dict is not an instance), in lax mode it accepts "3" and ``true`` for a
number. A table must also be written back as TOML, with its ``type`` and its schedules.
"""

import inspect
import re
from collections.abc import Callable
from dataclasses import is_dataclass
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Literal, Union, get_args, get_origin, get_type_hints

from pydantic import Field, TypeAdapter, create_model

from curricle.learning.schedules import Schedule, exponential, harmonic, linear
from curricle.study.config.tables import (
    Choice,
    Flag,
    Number,
    Table,
    Whole,
    shown,
    tagged,
    wrong,
)


class ObjectTable(Table):
    """A table that stands for one object of the library."""

    makes: ClassVar[Any]
    """The class or function that makes the object."""
    parameters: ClassVar[tuple[str, ...]] = ()
    """The parameters of `makes` that the table has."""

    def build(self, folder: Path = Path()) -> Any:
        """Return the object; the library's own error if the values make no sense.

        The modules of the study's own functions are in `folder`.
        """
        return type(self).makes(**self.arguments_in(folder))

    def arguments_in(self, folder: Path) -> dict[str, Any]:
        """Return the arguments for what makes the object, inner tables built."""
        return {name: built(getattr(self, name), folder) for name in self.parameters}


def built(value: Any, folder: Path) -> Any:
    """Return the object that a table stands for, and any other value as it is."""
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
    """Return the table of a dataclass or function of the library.

    Parameters
    ----------
    makes : class or function
    base : type
        Of the table; its own keys come on top.
    tag : str, optional
        Value of the key ``type``, for a table that is one of several.
    without : tuple of str
        Parameters that a file cannot give.
    **annotations
        Types of parameters that TOML writes in another way than Python.

    Examples
    --------
    >>> from curricle import GreedyEvaluation
    >>> table = table_of(GreedyEvaluation)
    >>> table.model_validate({"episodes": 10}).build()
    GreedyEvaluation(method='auto', episodes=10, discounted=None, sampled=False)
    """
    hints = get_type_hints(makes)
    texts = descriptions(makes)
    parameters = [
        one for one in inspect.signature(makes).parameters.values() if one.name not in without
    ]
    fields: dict[str, Any] = {}
    if tag is not None:
        fields["type"] = (Literal[tag], tag)
    for one in parameters:
        annotation = annotations.get(one.name) or annotated(hints[one.name])
        default: Any = ... if one.default is inspect.Parameter.empty else one.default
        if _is_dataclass(type(default)):
            kind: Any = type(default)
            default = table_of(kind)()
        elif type(default).__name__ == "_HAS_DEFAULT_FACTORY_CLASS":
            default = {}
        fields[one.name] = (annotation, Field(default, description=texts[one.name]))
    table = create_model(tag or makes.__name__, __base__=base, __doc__=summary(makes), **fields)
    table.makes = makes
    table.parameters = tuple(one.name for one in parameters)
    return table


def annotated(hint: Any) -> Any:
    """Return the type that validates what TOML may say for a parameter of this type."""
    if hint in _PLAIN:
        return _PLAIN[hint]
    members = get_args(hint)
    if get_origin(hint) in (Union, UnionType):
        if Schedule in members:
            return Rate | None if NoneType in members else Rate
        tables = [table_of(one) for one in members if _is_dataclass(one)]
        if tables and (bool in members or NoneType in members):
            return flag_or(tables[0], False if bool in members else None)
        others = [annotated(one) for one in members if not _is_dataclass(one)]
        return Union[*tables, *others]
    if get_origin(hint) is tuple:
        return tuple[*map(annotated, members)]  # type: ignore[misc]
    return table_of(hint) if _is_dataclass(hint) else hint


def _is_dataclass(hint: Any) -> bool:
    return is_dataclass(hint)


def flag_or(table: type[Table], off: Any) -> Any:
    """Return the type of what is false (`off`), true (a table of defaults) or a table."""

    def flag(value: Any) -> Any:
        if not isinstance(value, bool):
            raise wrong(f"must be true, false or a table: got {shown(value)}")
        return table() if value else off

    return Annotated[Any, Choice((table,), lambda _: table, flag, bool)]


def summary(makes: Any) -> str:
    """Return the first paragraph of a docstring, without markup."""
    return _plain((inspect.getdoc(makes) or "").partition("\n\n")[0])


def descriptions(makes: Callable[..., Any]) -> dict[str, str]:
    """Return what the numpydoc says of each parameter; the summary where it says nothing.

    Examples
    --------
    >>> descriptions(harmonic)["half"]
    'Steps (updates) after which the value is halfway.'
    """
    docs = [inspect.getdoc(one) or "" for one in getattr(makes, "__mro__", (makes,))]
    found = dict.fromkeys(inspect.signature(makes).parameters, summary(makes))
    for doc in reversed(docs):
        section = re.search(r"Parameters\n-+\n(.*?)(\n\n\w[\w ]*\n-+\n|\Z)", doc, re.DOTALL)
        for entry in re.finditer(
            r"^(\w[\w, ]*?)(?: : (.*))?\n((?:[ ]+.*\n?|\n)*)",
            f"{section[1]}\n" if section else "",
            re.MULTILINE,
        ):
            text = _plain(entry[3]) or _plain(entry[2] or "")
            found |= dict.fromkeys(re.split(r",\s*", entry[1]), text) if text else {}
    return found


def _plain(text: str) -> str:
    """Return a part of a docstring on one line, without markup."""
    return " ".join(re.sub(r":\w+:`~?([^`]*)`|`+([^`]*)`+", r"\1\2", text).split())


_PLAIN: dict[Any, Any] = {int: Whole, float: Number, bool: Flag, NoneType: None}
_SCHEDULES = tuple(table_of(one, tag=one.__name__) for one in (linear, exponential, harmonic))
Rate = Annotated[
    Any, tagged(*_SCHEDULES, simple=TypeAdapter(Number).validate_python, simple_type=float)
]
"""A number, or a table that says how it changes."""
