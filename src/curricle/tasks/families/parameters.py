"""Declared parameters of a task family: which values they take, and which are harder."""

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from curricle.checks import BEYOND_64_BITS, instance, number, one_of, text, whole_number
from curricle.errors import TaskError

KINDS: tuple[type, ...] = (bool, int, float, str)
MOST_LISTED = 10_000
"""Values of a parameter that are listed one by one at most."""

Harder = Literal["larger", "smaller", "later"]


@dataclass(frozen=True)
class Parameter:
    """One declared parameter of a :class:`TaskFamily`.

    What is left out is taken from the signature of the family's function: the kind from the
    annotation (``Literal[...]`` gives `values`, ``| None`` makes it optional), and the default.

    Parameters
    ----------
    name : str
        Of the parameter in the function.
    kind : {int, float, bool, str}, optional
    low, high : float, optional
        The smallest and the largest number, both included.
    values : sequence, optional
        The only values; then `kind`, `low` and `high` are left out.
    default : optional
        The value of members that do not give one; without a default it must be given.
    harder : {"larger", "smaller", "later"}, optional
        Which values make harder tasks; "later" is the order of `values`. Without it values are not
        ordered.
    optional : bool
        Whether None is a value too; where values are ordered, it is the hardest.

    Raises
    ------
    TaskError
        When the declaration contradicts itself.

    Examples
    --------
    >>> size = Parameter("size", int, low=2, high=50, harder="larger")
    >>> size.checked(4, "maze")
    4
    >>> size.checked(1, "maze")
    Traceback (most recent call last):
    curricle.errors.TaskError: size of maze must be a whole number, at least 2: got 1
    """

    name: str
    kind: type | None = None
    low: float | None = None
    high: float | None = None
    values: Any = None
    default: Any = ...
    harder: Harder | None = None
    optional: bool = False

    def __post_init__(self) -> None:
        text("the name of a parameter", self.name, TaskError)
        of = f"of parameter {self.name!r}"
        if not self.name.isidentifier():
            raise TaskError(f"the name of a parameter must be one of Python's: got {self.name!r}")
        if self.kind is not None and not any(self.kind is kind for kind in KINDS):
            raise TaskError(f"the kind {of} must be int, float, bool or str: got {self.kind!r}")
        if self.harder is not None:
            one_of(f"harder {of}", self.harder, ("larger", "smaller", "later"), TaskError)
        instance(f"optional {of}", self.optional, bool, TaskError)
        if self.values is not None:
            self._check_values(of)
        elif self.harder == "later" and self.kind is not None:
            raise TaskError(f"harder='later' {of} needs values in that order: there are none")
        for name in ("low", "high"):
            if getattr(self, name) is not None:
                number(f"{name} {of}", getattr(self, name), TaskError)
        if self.low is not None and self.high is not None and self.low > self.high:
            raise TaskError(f"low {of} must be at most high: got {self.low} and {self.high}")

    def _check_values(self, of: str) -> None:
        given = self.values
        if isinstance(given, str) or not hasattr(given, "__iter__"):
            raise TaskError(f"the values {of} must be a list: got {given!r}")
        values = tuple(given)
        plain = [type(value) in KINDS for value in values]
        if not values or not all(plain) or len(set(map(_key, values))) < len(values):
            raise TaskError(
                f"the values {of} must be different numbers, words or flags, at least one: got "
                f"{values!r}"
            )
        if (self.kind, self.low, self.high) != (None, None, None):
            raise TaskError(f"the values {of} say all: leave out kind, low and high")
        numeric = all(type(value) in (int, float, bool) for value in values)
        if self.harder in ("larger", "smaller") and not numeric:
            raise TaskError(
                f"harder {of} must be 'later', the order of its values, which are words"
            )
        object.__setattr__(self, "values", values)

    @property
    def required(self) -> bool:
        """Whether members must give it."""
        return self.default is ...

    def checked(self, value: Any, family: str) -> Any:
        """Return a value as the family's members hold it, or raise TaskError."""
        name = f"{self.name} of {family}"
        if value is None and self.optional:
            return None
        if self.values is not None:
            whole = isinstance(value, float) and value.is_integer()
            for given in (value, int(value)) if whole else (value,):
                for known in self.values:
                    if _key(known) == _key(given):
                        return known
            raise TaskError(f"{name} must be one of {self.listed()}: got {value!r}")
        if self.kind is bool:
            if not isinstance(value, bool):
                raise TaskError(f"{name} must be True or False: got {value!r}")
            return value
        if self.kind is str:
            text(name, value, TaskError)
            return value
        low = -BEYOND_64_BITS + 1 if self.low is None else self.low
        high = BEYOND_64_BITS if self.high is None else self.high
        if self.kind is int:
            if self.low is None and number(name, value, TaskError) % 1:
                raise TaskError(f"{name} must be a whole number: got {value!r}")
            value = whole_number(name, value, int(low), TaskError)
            number(name, value, TaskError, low, high)
            return value
        limits = {key: v for key, v in (("low", self.low), ("high", self.high)) if v is not None}
        return number(name, value, TaskError, **limits)

    def choices(self, family: str) -> tuple[Any, ...]:
        """Return all values in order; TaskError where they are too many to be listed."""
        if self.values is not None:
            found = self.values
        elif self.kind is bool:
            found = (False, True)
        elif (
            self.kind is int
            and self.low is not None
            and self.high is not None
            and self.high - self.low < MOST_LISTED
        ):
            found = tuple(range(int(self.low), int(self.high) + 1))
        else:
            raise TaskError(
                f"{self.name} of {family} has too many values to list, {self.listed()}: give those "
                "that are wanted"
            )
        return (*found, None) if self.optional else found

    def difficulty(self, value: Any) -> float | None:
        """Return a number that is larger for harder values; None where values are not ordered."""
        if self.harder is None:
            return None
        if value is None:
            return math.inf
        if self.harder == "later":
            return float([_key(known) for known in self.values].index(_key(value)))
        return float(value) if self.harder == "larger" else -float(value)

    def easier_than(self, value: Any) -> tuple[Any, ...]:
        """Return the values that are easier, in order; none where they cannot be listed."""
        most = self.difficulty(value)
        if most is None:
            return ()
        if self.values is not None or self.kind is bool:
            known = (False, True) if self.values is None else self.values
            return tuple(one for one in known if (self.difficulty(one) or 0.0) < most)
        up = self.harder == "larger"
        first, last = (self.low, self.high) if up else (self.high, self.low)
        end = value if value is not None else None if last is None else last + (1 if up else -1)
        if self.kind is not int or first is None or end is None or abs(end - first) > MOST_LISTED:
            return ()
        return tuple(range(int(first), int(end), 1 if up else -1))

    def listed(self) -> str:
        """Return the values in words.

        Examples
        --------
        >>> Parameter("size", int, low=2, high=9).listed(), Parameter("wet", bool).listed()
        ('2..9', 'True, False')
        """
        if self.values is not None:
            shown = [str(value) for value in self.values[:12]]
            words = ", ".join([*shown, *(["..."] if len(self.values) > len(shown) else [])])
        elif self.kind is bool:
            words = "True, False"
        elif self.low is None and self.high is None:
            words = {int: "whole numbers", str: "text"}.get(self.kind or float, "numbers")
        elif self.high is None:
            words = f"{self.low} or more"
        else:
            words = f"{'' if self.low is None else self.low}..{self.high}"
        return f"{words}, None" if self.optional else words


def _key(value: Any) -> tuple[type, Any]:
    """Return what tells a value from others: True is not 1."""
    return type(value), value


def complete_parameters(
    declared: tuple[Parameter, ...], function: Callable[..., Any], family: str
) -> tuple[Parameter, ...]:
    """Return the parameters of a family's function, in its order, declared ones first of all.

    A parameter that is not declared has the kind and default of the signature; without an
    annotation the default's kind. One whose annotation or default is no kind that a family has
    keeps its default and is no parameter of the family.
    """
    signature, hints = inspect.signature(function).parameters, get_type_hints(function)
    by_name = {one.name: one for one in declared}
    free = any(one.kind is inspect.Parameter.VAR_KEYWORD for one in signature.values())
    strange = [name for name in by_name if name not in signature and not free]
    if strange or len(by_name) < len(declared):
        raise TaskError(
            f"the parameters of {family} must be different ones of its function, "
            f"{', '.join(signature)}: got {', '.join(one.name for one in declared)}"
        )
    found = list[Parameter]()
    for name, one in signature.items():
        if one.kind in (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL):
            continue
        default = ... if one.default is inspect.Parameter.empty else one.default
        parameter = _complete(by_name.get(name), name, hints.get(name), default)
        if parameter is not None:
            found.append(parameter)
        elif default is ... or name in by_name:
            raise TaskError(
                f"parameter {name!r} of {family} must have a kind: declare it, or annotate it as "
                "int, float, bool, str or Literal[...]"
            )
    found += [one for name, one in by_name.items() if name not in signature]
    return tuple(one if one.required else _with_checked_default(one, family) for one in found)


def _complete(declared: Parameter | None, name: str, hint: Any, default: Any) -> Parameter | None:
    """Return a parameter with what its signature says; None where it has no kind."""
    given = declared or Parameter(name)
    if given.default is ...:
        given = replace(given, default=default)
    if given.default is None and not given.optional:
        given = replace(given, optional=True)
    if given.kind is not None or given.values is not None:
        return given
    members = [type(default) if hint is None else hint]
    if get_origin(hint) in (Union, UnionType):
        members = [one for one in get_args(hint) if one is not NoneType]
        if NoneType in get_args(hint):
            given = replace(given, optional=True)
    if len(members) == 1 and members[0] in KINDS:  # bool, int, float or str
        return replace(given, kind=members[0])
    if len(members) == 1 and get_origin(members[0]) is Literal:
        return replace(given, values=get_args(members[0]))
    return None


def _with_checked_default(parameter: Parameter, family: str) -> Parameter:
    """Return the parameter with its default as members hold it."""
    default = parameter.checked(parameter.default, f"{family}, its default,")
    return replace(parameter, default=default)
