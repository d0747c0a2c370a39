"""Task families: a function that makes tasks, the rules of its parameters, and how members relate.

The signature of the function is the declaration: a parameter's type, its :class:`Rule` and its
default say which values it takes and which of them make harder tasks.
"""

import importlib
import inspect
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cached_property
from itertools import product
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

from curricle.arrays import Frozen
from curricle.checks import BEYOND_64_BITS, fit_name, instance, number, one_of, text, whole_number
from curricle.errors import TaskError
from curricle.tasks.mdp import generative_model
from curricle.tasks.observation_task import is_observation_task

KINDS: tuple[type, ...] = (bool, int, float, str)
MOST_LISTED = 10_000  # values of a parameter that are listed one by one at most

Harder = Literal["larger", "smaller", "later"]


# -- parameters ------------------------------------------------------------------------------------


class Rule(NamedTuple):
    """The rule of an annotated value: ``size: Annotated[int, Rule(2, 9, "larger")] = 4``.

    Parameters
    ----------
    low, high : float, optional
        The smallest and the largest number, both included.
    harder : {"larger", "smaller", "later"}, optional
        Which values make harder tasks; "later" is the order of `values`.
    values : tuple, optional
        The only values; ``Literal[...]`` gives them as well.
    varies : bool
        Whether members of a family may differ in it.
    """

    low: float | None = None
    high: float | None = None
    harder: Harder | None = None
    values: tuple[Any, ...] | None = None
    varies: bool = True


ANY = Rule()


def rules_of(function: object) -> dict[str, tuple[Any, Rule, bool]]:
    """Return each annotated type (without None, if that leaves one), its rule, and if None fits."""
    rules = dict[str, tuple[Any, Rule, bool]]()
    for name, hint in get_type_hints(function, include_extras=True).items():
        kind, *extras = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        rule = next((extra for extra in extras if isinstance(extra, Rule)), ANY)
        members = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
        kinds = [member for member in members if member is not NoneType]
        rules[name] = (kinds[0] if len(kinds) == 1 else kind), rule, len(kinds) < len(members)
    return rules


@dataclass(frozen=True)
class Parameter:
    """A parameter of a family, as the signature of the family's function declares it.

    Parameters
    ----------
    name : str
        The name of the function's parameter.
    kind : {int, float, bool, str}, optional
        Of its values; None if the rule lists them.
    rule : Rule
        The rule of its annotation.
    default : optional
        The value of members that give none; without a default they must give one.
    optional : bool
        Whether None is a value too; it is the hardest of ordered values.

    Examples
    --------
    >>> size = Parameter("size", int, Rule(2, 50, "larger"))
    >>> size.checked(4, "maze"), size.listed()
    (4, '2..50')
    """

    name: str
    kind: type | None = None
    rule: Rule = ANY
    default: Any = ...
    optional: bool = False

    def __post_init__(self) -> None:
        low, high, harder, values, _ = self.rule
        of = f"of parameter {self.name!r}"
        if harder is not None:
            one_of(f"harder {of}", harder, get_args(Harder), TaskError)
        if low is not None and high is not None and low > high:
            raise TaskError(f"low {of} must be at most high: got {low} and {high}")
        if harder == "later" and values is None:
            raise TaskError(f"harder='later' {of} needs values in that order: there are none")
        if harder in ("larger", "smaller") and any(isinstance(v, str) for v in values or ()):
            raise TaskError(f"harder {of} must be 'later', the order of its values, some words")

    @property
    def required(self) -> bool:
        """Whether members must give it."""
        return self.default is ...

    def checked(self, value: Any, family: str = "") -> Any:
        """Return a value as members of a family hold it, or raise TaskError."""
        name = f"{self.name} of {family}" if family else self.name
        low, high, _, values, _ = self.rule
        if value is None and self.optional:
            return None
        if values is not None:
            is_whole = isinstance(value, float) and value.is_integer()
            keys = [_key(form) for form in ((value, int(value)) if is_whole else (value,))]
            matching = [valid for key in keys for valid in values if _key(valid) == key]
            if not matching:
                raise TaskError(f"{name} must be one of {self.listed()}: got {value!r}")
            return matching[0]
        if self.kind is bool:
            if not isinstance(value, bool):
                raise TaskError(f"{name} must be True or False: got {value!r}")
        elif self.kind is str:
            text(name, value, TaskError)
        else:
            farthest = BEYOND_64_BITS if self.kind is int else math.inf
            least, most = 1 - farthest if low is None else low, farthest if high is None else high
            if self.kind is not int:
                return number(name, value, TaskError, least, most)
            if low is None and number(name, value, TaskError) % 1:
                raise TaskError(f"{name} must be a whole number: got {value!r}")
            value = whole_number(name, value, int(least), TaskError)
            number(name, value, TaskError, least, most)
        return value

    def difficulty(self, value: Any) -> float | None:
        """Return a number that is larger for harder values; None where values are not ordered."""
        if self.rule.harder is None:
            return None
        if value is None:
            return math.inf
        if self.rule.harder == "later":
            return float([*map(_key, self.rule.values or ())].index(_key(value)))
        return float(value) if self.rule.harder == "larger" else -float(value)

    def easier_than(self, value: Any) -> tuple[Any, ...]:
        """Return the values that are easier, in order; none where they cannot be listed."""
        hardest, (low, high, harder, values, _) = self.difficulty(value), self.rule
        if hardest is None:
            return ()
        if values is None and self.kind is bool:
            values = (False, True)
        elif values is None:
            first, last = (high, low) if harder == "smaller" else (low, high)
            last = last if value is None else value
            if self.kind is not int or first is None or last is None:
                return ()
            if abs(last - first) > MOST_LISTED:
                return ()
            step = 1 if first <= last else -1
            values = tuple(range(int(first), int(last) + step, step))
        return tuple(easier for easier in values if (self.difficulty(easier) or 0.0) < hardest)

    def listed(self) -> str:
        """Return the values in words, such as "2..9" or "True, False"."""
        low, high, _, values, _ = self.rule
        if values is not None:
            listed = ", ".join([*map(str, values[:12]), *(["..."] if len(values) > 12 else [])])
        elif self.kind is bool:
            listed = "True, False"
        elif low is None and high is None:
            listed = {int: "whole numbers", str: "text"}.get(self.kind or float, "numbers")
        elif high is None:
            listed = f"{low} or more"
        else:
            listed = f"{'' if low is None else low}..{high}"
        return f"{listed}, None" if self.optional else listed


def _key(value: object) -> tuple[type, Any]:
    """Return a key that differs for different values: True is not 1."""
    return type(value), value


def parameters_of(function: Callable[..., Any], family: str) -> tuple[Parameter, ...]:
    """Return the parameters of a family's function, without those that members share."""
    rules, parameters = rules_of(function), list[Parameter]()
    for name, entry in inspect.signature(function).parameters.items():
        if entry.kind in (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL):
            continue
        default = ... if entry.default is inspect.Parameter.empty else entry.default
        unannotated: tuple[Any, Rule, bool] = type(default), ANY, False
        kind, rule, optional = rules.get(name, unannotated)
        if get_origin(kind) is Literal:
            rule = rule._replace(values=get_args(kind))
        elif rule.values is None and kind not in KINDS:
            if default is ...:
                raise TaskError(
                    f"parameter {name!r} of {family} must have a kind: annotate it as int, float, "
                    "bool, str or Literal[...]"
                )
            continue  # it keeps its default
        if rule.varies:
            kind = None if rule.values is not None else kind
            parameter = Parameter(name, kind, rule, optional=optional or default is None)
            if default is not ...:
                default = parameter.checked(default, f"{family}, its default,")
            parameters.append(replace(parameter, default=default))
    return tuple(parameters)


# -- mappings as data ------------------------------------------------------------------------------

Unequal = Literal["unmapped", "clip", "scale"]


@dataclass(frozen=True)
class ComponentsByName:
    """Reads components of the source off the target's by name, by label or else by number.

    Parameters
    ----------
    unequal : {"unmapped", "clip", "scale"}
        Numbers that the source lacks have no counterpart, as in :func:`project`, or become the
        nearest number; or the target's range is scaled: low' + floor((v - low) size' / size).
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
        one_of("unequal", self.unequal, get_args(Unequal), TaskError)
        named = self.renaming.items() if isinstance(self.renaming, Mapping) else self.renaming
        try:
            pairs = tuple(sorted((source, target) for source, target in named))
            fit = all(isinstance(name, str) for pair in pairs for name in pair)
        except (TypeError, ValueError):
            fit = False
        if not fit:
            raise TaskError(
                "renaming must be a dict of source components to target components: got "
                f"{self.renaming!r}"
            )
        object.__setattr__(self, "renaming", pairs)


# -- families and members --------------------------------------------------------------------------


@dataclass(frozen=True)
class TaskFamily(Frozen):
    """Tasks that one function makes of parameters; a call returns a FamilyMember.

    Parameters
    ----------
    name : str
        The family's name in messages and printed members.
    factory : callable
        Returns the task; called with every parameter by name. Its annotations declare them.
    mapping : ComponentsByName or callable
        How members map onto each other (:func:`family_mappings`); a function of target and source,
        both :class:`FamilyMember`, returns a :class:`ComponentsByName`, a function for
        :func:`from_function` or a mapping, or several in a list.
    constraint : callable, optional
        Takes a dict of parameters and returns why they do not fit together, a sentence, or None.
    parameters : tuple of Parameter, optional
        Instead of those of `factory`, if it passes some on that its signature does not name.

    Raises
    ------
    TaskError
        When a parameter has no kind, or its default breaks its rule.

    Examples
    --------
    >>> from curricle import Pursuit
    >>> hunts = TaskFamily("hunt", Pursuit)
    >>> hunts(size=4, predators=1)
    hunt(predators=1)
    >>> list(hunts.easier(hunts(size=3, predators=1)))
    [hunt(size=2, predators=1)]
    """

    name: str
    factory: Callable[..., Any]
    mapping: Any = None
    constraint: Callable[[dict[str, Any]], str | None] | None = None
    parameters: Any = None

    def __post_init__(self) -> None:
        fit_name("a task family", self.name, TaskError)
        if self.mapping is None:
            object.__setattr__(self, "mapping", ComponentsByName())
        rules = {
            "factory": ("a function", callable(self.factory)),
            "mapping": (
                "a ComponentsByName or a function of target and source",
                isinstance(self.mapping, ComponentsByName) or callable(self.mapping),
            ),
            "constraint": ("a function", self.constraint is None or callable(self.constraint)),
        }
        for part, (rule, fits) in rules.items():
            if not fits:
                value = getattr(self, part)
                raise TaskError(f"the {part} of {self.name} must be {rule}: got {value!r}")
        if self.parameters is None:
            object.__setattr__(self, "parameters", parameters_of(self.factory, self.name))

    def __call__(self, /, **values: Any) -> "FamilyMember":
        """Return the member with these parameters; the others have their defaults."""
        for name in values:
            self.parameter(name)
        for parameter in self.parameters:
            if parameter.required and parameter.name not in values:
                raise TaskError(
                    f"{parameter.name} of {self.name} must be given: it has no default, and is "
                    f"{parameter.listed()}"
                )
        values = {p.name: p.default for p in self.parameters} | values
        checked = [p.checked(values[p.name], self.name) for p in self.parameters]
        member = FamilyMember(self, tuple(checked))
        if refused := member.refusal():
            raise TaskError(f"{refused}: got {member}")
        return member

    def easier(self, member: "FamilyMember") -> Iterator["FamilyMember"]:
        """Yield the members that are easier in at least one parameter and harder in none.

        Parameters that are not ordered, or whose values are too many to list, stay as they are.
        """
        instance("the member that others are easier than", member, FamilyMember, TaskError)
        if member.family.factory is not self.factory:
            raise TaskError(f"{self.name}.easier needs a member of {self.name}: got {member}")
        pairs = zip(self.parameters, member.values, strict=True)
        columns = [(*parameter.easier_than(value), value) for parameter, value in pairs]
        for values in product(*columns):
            easier = FamilyMember(self, values)
            if values != member.values and not easier.refusal():
                yield easier

    def parameter(self, name: str) -> Parameter:
        """Return the parameter of that name; TaskError lists the names otherwise."""
        parameters: dict[str, Parameter] = {p.name: p for p in self.parameters}
        if name in parameters:
            return parameters[name]
        close = get_close_matches(str(name), parameters, n=1)
        meant = f", did you mean {close[0]!r}?" if close else ""
        raise TaskError(
            f"a parameter of {self.name} must be one of {', '.join(parameters) or 'none'}: got "
            f"{name!r}{meant}"
        )

    def __str__(self) -> str:
        lines = [f"{self.name}, a family of tasks"]
        for parameter in self.parameters:
            default = "must be given" if parameter.required else f"{parameter.default} by default"
            harder = parameter.rule.harder
            order = "" if harder is None else f", {harder} is harder"
            lines.append(f"  {parameter.name}: {parameter.listed()}; {default}{order}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"TaskFamily({self.name}: {', '.join(p.name for p in self.parameters)})"

    def __reduce__(self) -> Any:
        """Pickle a decorated function by its name, which now leads to the family."""
        place = getattr(self.factory, "__module__", ""), getattr(self.factory, "__qualname__", "")
        if _named(*place) == self:
            return _named, place
        parts = (self.name, self.factory, self.mapping, self.constraint, self.parameters)
        return TaskFamily, parts


@dataclass(frozen=True)
class FamilyMember(Frozen):
    """The address of one task of a family: the family and the value of each of its parameters.

    The task is built on first access. A member prints the parameters that have no default or differ
    from it.

    Examples
    --------
    >>> from curricle.tasks import maze_family
    >>> member = maze_family(size=4, seed=7)
    >>> member["size"], member == maze_family(size=4, seed=7), member.replace(size=3)
    (4, True, maze(size=3, seed=7))
    """

    family: TaskFamily
    values: tuple[Any, ...]  # of all parameters, in the order of the family's

    @property
    def parameters(self) -> dict[str, Any]:
        """The value of each parameter, by name."""
        names = [parameter.name for parameter in self.family.parameters]
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
                f"the constraint of {self.family.name} must return None or, as a sentence, "
                f"the mistake: got {refused!r} for {self}"
            )
        return refused

    @cached_property
    def task(self) -> Any:
        """The task; TaskError if the family's function returns none."""
        task = self.family.factory(**self.parameters)
        if not is_observation_task(task):
            generative_model(task)
        return task

    def __repr__(self) -> str:
        shown = [
            f"{parameter.name}={value!r}"
            for parameter, value in zip(self.family.parameters, self.values, strict=True)
            if parameter.required or value != parameter.default
        ]
        return f"{self.family.name}({', '.join(shown)})"


def task_family(
    *,
    name: str | None = None,
    mapping: object = None,
    constraint: Callable[[dict[str, Any]], str | None] | None = None,
) -> Callable[[Callable[..., Any]], TaskFamily]:
    """Return a decorator that makes a :class:`TaskFamily` of the function that makes its tasks.

    Parameters
    ----------
    name, mapping, constraint
        As in :class:`TaskFamily`; by default it has the function's name.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> @task_family()
    ... def corridor(length: Annotated[int, Rule(low=2, harder="larger")], discount: float = 0.9):
    ...     return GridWorld("S" + "." * (length - 2) + "T", discount=discount)
    >>> corridor
    TaskFamily(corridor: length, discount)
    >>> corridor(length=3).task.states.size
    3
    """

    def decorate(factory: Callable[..., Any]) -> TaskFamily:
        called = getattr(factory, "__name__", "family") if name is None else name
        return TaskFamily(called, factory, mapping, constraint)

    return decorate


def _named(module: str, name: str) -> Any:
    """Return the object of a module under a dotted name; None if there is none."""
    try:
        value: Any = importlib.import_module(module)
        for part in name.split("."):
            value = getattr(value, part)
    except (ImportError, AttributeError, ValueError):
        return None
    return value
