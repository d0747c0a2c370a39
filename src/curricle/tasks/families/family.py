"""Task families: a function that makes tasks, its declared parameters, and how members relate."""

import importlib
import inspect
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cached_property
from itertools import product, repeat
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from curricle.arrays import Frozen
from curricle.checks import (
    BEYOND_64_BITS,
    fit_name,
    instance,
    number,
    one_of,
    text,
    whole_number,
)
from curricle.errors import TaskError
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.task import generative_model

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

    @property
    def _known(self) -> tuple[Any, ...] | None:
        """All values in order, None where they are a range."""
        known: tuple[Any, ...] | None = (False, True) if self.kind is bool else self.values
        return known

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
        if self._known is not None:
            found = self._known
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
        if self._known is not None:
            return tuple(one for one in self._known if (self.difficulty(one) or 0.0) < most)
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
    return tuple(
        one
        if one.required
        else replace(one, default=one.checked(one.default, f"{family}, its default,"))
        for one in found
    )


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


# -- mappings as data ------------------------------------------------------------------------------

Unequal = Literal["unmapped", "clip", "scale"]


@dataclass(frozen=True)
class ComponentsByName:
    """Components of the source are read off those of the target by name.

    Components with labels correspond label by label, others number by number. :func:`project` is
    this mapping with ``unequal="unmapped"``.

    Parameters
    ----------
    unequal : {"unmapped", "clip", "scale"}
        What becomes of values without labels where the ranges of a component differ. With
        "unmapped" the numbers that the source lacks have no counterpart. With "clip" they become
        its nearest number. With "scale" the target's whole range is spread over the source's:
        low' + floor((v - low) size' / size).
    renaming : dict of str to str
        Source component -> target component, where the names differ.

    Examples
    --------
    >>> ComponentsByName("clip", {"predator": "predator_1"})
    ComponentsByName(unequal='clip', renaming=(('predator', 'predator_1'),))
    """

    unequal: Unequal = "unmapped"
    renaming: Any = ()

    def __post_init__(self) -> None:
        one_of("unequal", self.unequal, ("unmapped", "clip", "scale"), TaskError)
        given = self.renaming.items() if isinstance(self.renaming, Mapping) else self.renaming
        try:
            pairs = tuple(sorted((source, target) for source, target in given))
        except (TypeError, ValueError):
            pairs = ((None, None),)
        if not all(isinstance(name, str) for pair in pairs for name in pair):
            raise TaskError(
                "renaming must be a dict of source components to target components: got "
                f"{self.renaming!r}"
            )
        object.__setattr__(self, "renaming", pairs)


# -- families and members --------------------------------------------------------------------------


@dataclass(frozen=True)
class TaskFamily(Frozen):
    """Tasks that one function makes from declared parameters.

    Calling the family with parameters returns a :class:`FamilyMember`: an address, which builds no
    task before its ``task`` is asked for.

    Parameters
    ----------
    name : str
        What messages and printed members call it.
    factory : callable
        Returns the task; called with every parameter by name.
    parameters : sequence of Parameter
        What the signature of `factory` does not say. Parameters that are left out are taken from
        the signature.
    mapping : ComponentsByName or callable, optional
        How members map onto each other: :class:`ComponentsByName`, the default, or a function of
        target and source (both :class:`FamilyMember`) that returns one of the following, or several
        in a list: a :class:`ComponentsByName`, a function for :func:`from_function`, a mapping. See
        :func:`family_mappings`.
    constraint : callable, optional
        A function of a dict of parameters that returns what is wrong with them as a sentence, None
        where nothing is. For rules that several parameters make together.

    Raises
    ------
    TaskError
        When a declaration does not fit the function, or a default breaks it.

    Examples
    --------
    >>> from curricle import Pursuit
    >>> hunts = TaskFamily("hunt", Pursuit, [
    ...     Parameter("size", low=2, high=10, harder="larger"),
    ...     Parameter("predators", low=1, high=3, harder="larger"),
    ...     Parameter("capture", values=["any", "all"])])
    >>> hunts(size=4, predators=1)
    hunt(predators=1)
    >>> hunts(size=4, predators=1).task == Pursuit(size=4, predators=1)
    True
    >>> [member["size"] for member in hunts.members(size=range(3, 6), predators=2)]
    [3, 4, 5]
    >>> hunts(size=11)
    Traceback (most recent call last):
    curricle.errors.TaskError: size of hunt must lie in [2, 10]: got 11
    """

    name: str
    factory: Callable[..., Any]
    parameters: Any = ()
    mapping: Any = None
    constraint: Callable[[dict[str, Any]], str | None] | None = None

    def __post_init__(self) -> None:
        fit_name("a task family", self.name, TaskError)
        if not callable(self.factory):
            raise TaskError(f"the factory of {self.name} must be a function: got {self.factory!r}")
        if self.mapping is None:
            object.__setattr__(self, "mapping", ComponentsByName())
        if not isinstance(self.mapping, ComponentsByName) and not callable(self.mapping):
            raise TaskError(
                f"the mapping of {self.name} must be a ComponentsByName or a function of target "
                f"and source: got {self.mapping!r}"
            )
        if self.constraint is not None and not callable(self.constraint):
            raise TaskError(
                f"the constraint of {self.name} must be a function: got {self.constraint!r}"
            )
        if not isinstance(self.parameters, list | tuple):
            raise TaskError(
                f"the parameters of {self.name} must be a list of Parameter: got "
                f"{self.parameters!r}"
            )
        declared = tuple(self.parameters)
        for one in declared:
            instance(f"each of the parameters of {self.name}", one, Parameter, TaskError)
        found = complete_parameters(declared, self.factory, self.name)
        object.__setattr__(self, "parameters", found)

    # -- members -------------------------------------------------------------------------------

    def __call__(self, /, **values: Any) -> "FamilyMember":
        """Return the member with these parameters; the others have their defaults."""
        for name in values:
            self.parameter(name)
        for one in self.parameters:
            if one.required and one.name not in values:
                raise TaskError(
                    f"{one.name} of {self.name} must be given: it has no default, and is "
                    f"{one.listed()}"
                )
        given = [values.get(one.name, one.default) for one in self.parameters]
        checked = map(Parameter.checked, self.parameters, given, repeat(self.name))
        member = FamilyMember(self, tuple(checked))
        if refused := member.refusal():
            raise TaskError(f"{refused}: got {member}")
        return member

    def members(self, /, **values: Any) -> Iterator["FamilyMember"]:
        """Yield members, one for each combination of the given values.

        A parameter has one value or several in a list, tuple, range or other iterable. One that is
        left out has its default or, if it has none, each of its values. Combinations that the
        family's constraint refuses are left out.

        Raises
        ------
        TaskError
            On an unknown parameter, a wrong value, or too many values to list.
        """
        for name in values:
            self.parameter(name)
        columns = list[tuple[Any, ...]]()
        for one in self.parameters:
            if one.name in values:
                given = values[one.name]
                several = isinstance(given, Iterable) and not isinstance(given, str)
                listed = tuple(given) if several else (given,)
                columns.append(tuple(one.checked(value, self.name) for value in listed))
            else:
                columns.append(one.choices(self.name) if one.required else (one.default,))
        yield from self._allowed(columns)

    def easier(self, member: "FamilyMember") -> Iterator["FamilyMember"]:
        """Yield the members that are nowhere harder than one, and easier in at least one parameter.

        Parameters that are not ordered, or whose values are too many to list, stay as they are.

        Examples
        --------
        >>> from curricle.tasks import pursuit_family
        >>> list(pursuit_family.easier(pursuit_family(size=3, predators=2)))
        [pursuit(size=2, predators=1), pursuit(size=2), pursuit(size=3, predators=1)]
        """
        instance("the member that others are easier than", member, FamilyMember, TaskError)
        if member.family.factory is not self.factory:
            raise TaskError(f"{self.name} has only members of its own: got {member}")
        columns = list[tuple[Any, ...]]()
        for one, value in zip(self.parameters, member.values, strict=True):
            columns.append((*one.easier_than(value), value))
        yield from (found for found in self._allowed(columns) if found.values != member.values)

    def _allowed(self, columns: list[tuple[Any, ...]]) -> Iterator["FamilyMember"]:
        for values in product(*columns):
            member = FamilyMember(self, values)
            if not member.refusal():
                yield member

    def parameter(self, name: str) -> Parameter:
        """Return the parameter of that name; TaskError lists the names otherwise."""
        known: tuple[Parameter, ...] = self.parameters
        for one in known:
            if one.name == name:
                return one
        names = [one.name for one in known]
        close = get_close_matches(str(name), names, n=1)
        meant = f", did you mean {close[0]!r}?" if close else ""
        raise TaskError(
            f"a parameter of {self.name} must be one of {', '.join(names) or 'none'}: got "
            f"{name!r}{meant}"
        )

    # -- printing and pickling -----------------------------------------------------------------

    def __str__(self) -> str:
        lines = [f"{self.name}, a family of tasks"]
        for one in self.parameters:
            known = "must be given" if one.required else f"{one.default} by default"
            order = "" if one.harder is None else f", {one.harder} is harder"
            lines.append(f"  {one.name}: {one.listed()}; {known}{order}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"TaskFamily({self.name}: {', '.join(one.name for one in self.parameters)})"

    def __reduce__(self) -> Any:
        """Pickle a decorated function by its name, which now leads to the family."""
        place = getattr(self.factory, "__module__", ""), getattr(self.factory, "__qualname__", "")
        if _found(*place) == self:
            return _found, place
        parts = (self.name, self.factory, self.parameters, self.mapping, self.constraint)
        return TaskFamily, parts


@dataclass(frozen=True)
class FamilyMember(Frozen):
    """The address of one task of a family: the family and the value of each of its parameters.

    Made by calling a :class:`TaskFamily`. Members hash, compare, print and pickle by their
    parameters; the task is built when it is first asked for. Printed are the parameters that differ
    from the function's defaults, and those that have none; `parameters` holds all.

    Attributes
    ----------
    family : TaskFamily
    values : tuple
        Of all parameters, in the order of the family's.

    Examples
    --------
    >>> from curricle.tasks import maze_family
    >>> member = maze_family(size=4, seed=7)
    >>> member["size"], member == maze_family(size=4, seed=7), member.replace(size=3)
    (4, True, maze(size=3, seed=7))
    """

    family: TaskFamily
    values: tuple[Any, ...]

    @property
    def parameters(self) -> dict[str, Any]:
        """The value of each parameter, by name."""
        names = [one.name for one in self.family.parameters]
        return dict(zip(names, self.values, strict=True))

    def __getitem__(self, name: str) -> Any:
        """Return the value of the parameter of that name."""
        return self.values[self.family.parameters.index(self.family.parameter(name))]

    def replace(self, /, **values: Any) -> "FamilyMember":
        """Return the member with other values of these parameters."""
        return self.family(**{**self.parameters, **values})

    def refusal(self) -> str | None:
        """Return why the family's constraint refuses these parameters; None if it does not."""
        constraint = self.family.constraint
        refused = None if constraint is None else constraint(self.parameters)
        if not (refused is None or isinstance(refused, str)):
            raise TaskError(
                f"the constraint of {self.family.name} must return None or what is wrong as a "
                f"sentence: got {refused!r} for {self}"
            )
        return refused

    @cached_property
    def task(self) -> Any:
        """The task.

        Raises
        ------
        TaskError
            When the family's function returns no task. What it raises itself is not changed.
        """
        made = self.family.factory(**self.parameters)
        if not is_observation_task(made):
            generative_model(made)
        return made

    def __repr__(self) -> str:
        shown = [
            f"{one.name}={value!r}"
            for one, value in zip(self.family.parameters, self.values, strict=True)
            if one.required or value != one.default
        ]
        return f"{self.family.name}({', '.join(shown)})"


def task_family(
    *parameters: Parameter,
    name: str | None = None,
    mapping: Any = None,
    constraint: Callable[[dict[str, Any]], str | None] | None = None,
) -> Callable[[Callable[..., Any]], TaskFamily]:
    """Return a decorator that makes a :class:`TaskFamily` of the function that makes its tasks.

    Parameters
    ----------
    *parameters : Parameter
        What annotations and defaults of the function do not say.
    name : str, optional
        The function's by default.
    mapping, constraint
        As in :class:`TaskFamily`.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> @task_family(Parameter("length", low=2, harder="larger"))
    ... def corridor(length: int, discount: float = 0.9):
    ...     return GridWorld("S" + "." * (length - 2) + "T", discount=discount)
    >>> corridor
    TaskFamily(corridor: length, discount)
    >>> corridor(length=3).task.states.size
    3
    """
    for one in parameters:
        if not isinstance(one, Parameter):
            raise TaskError(
                f"task_family must be given Parameters, in parentheses, above a function: got "
                f"{one!r}"
            )

    def decorate(factory: Callable[..., Any]) -> TaskFamily:
        called = getattr(factory, "__name__", "family") if name is None else name
        return TaskFamily(called, factory, parameters, mapping, constraint)

    return decorate


def _found(module: str, name: str) -> Any:
    """Return what a module has under a dotted name; None if there is nothing."""
    try:
        found: Any = importlib.import_module(module)
        for part in name.split("."):
            found = getattr(found, part)
    except (ImportError, AttributeError, ValueError):
        return None
    return found
