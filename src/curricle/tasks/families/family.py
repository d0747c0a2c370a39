"""Task families: a function that makes tasks, its declared parameters, and how members relate."""

import importlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cached_property
from itertools import product
from typing import Any, Self

from curricle.checks import fit_name, instance
from curricle.errors import TaskError
from curricle.frozen_arrays import Frozen
from curricle.tasks.families.components_by_name import ComponentsByName
from curricle.tasks.families.parameters import Parameter, complete_parameters
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.task import generative_model


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
    settings : dict or pairs
        Other defaults of parameters; see :meth:`with_defaults`.

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
    settings: Any = ()

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
        try:
            given = dict(self.settings)
        except (TypeError, ValueError):
            raise TaskError(
                f"the settings of {self.name} must be a dict of parameters: got {self.settings!r}"
            ) from None
        settings = {
            name: self.parameter(name).checked(value, self.name) for name, value in given.items()
        }
        object.__setattr__(self, "settings", tuple(sorted(settings.items())))

    # -- members -------------------------------------------------------------------------------

    def __call__(self, /, **values: Any) -> "FamilyMember":
        """Return the member with these parameters; the others have their defaults."""
        member = self._member(values)
        refused = member.refusal()
        if refused:
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
        defaults, columns = dict(self.settings), list[tuple[Any, ...]]()
        for one in self.parameters:
            default = defaults.get(one.name, one.default)
            if one.name in values:
                given = values[one.name]
                several = isinstance(given, Iterable) and not isinstance(given, str)
                listed = tuple(given) if several else (given,)
                columns.append(tuple(one.checked(value, self.name) for value in listed))
            else:
                columns.append(one.choices(self.name) if default is ... else (default,))
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
        base = self._base
        for values in product(*columns):
            member = FamilyMember(base, values)
            if not member.refusal():
                yield member

    def _member(self, values: dict[str, Any]) -> "FamilyMember":
        """Return the member with these parameters, each of them checked."""
        for name in values:
            self.parameter(name)
        defaults = {one.name: one.default for one in self.parameters}
        given = {**defaults, **dict(self.settings), **values}
        missing = [name for name, value in given.items() if value is ...]
        if missing:
            raise TaskError(
                f"{missing[0]} of {self.name} must be given: it has no default, and is "
                f"{self.parameter(missing[0]).listed()}"
            )
        checked = [one.checked(given[one.name], self.name) for one in self.parameters]
        return FamilyMember(self._base, tuple(checked))

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

    def with_defaults(self, /, **values: Any) -> Self:
        """Return the family with other defaults.

        Its members equal those of this family with the same parameters.

        Examples
        --------
        >>> from curricle.tasks import pursuit_family
        >>> rings = pursuit_family.with_defaults(torus=True)
        >>> rings(size=3), rings(size=3) == pursuit_family(size=3, torus=True)
        (pursuit(size=3, torus=True), True)
        """
        return replace(self, settings={**dict(self.settings), **values})

    @cached_property
    def _base(self) -> "TaskFamily":
        """The family without defaults of its own, which all its members name."""
        return replace(self, settings=()) if self.settings else self

    # -- printing and pickling -----------------------------------------------------------------

    def __str__(self) -> str:
        lines = [f"{self.name}, a family of tasks"]
        for one in self.parameters:
            default = dict(self.settings).get(one.name, one.default)
            known = "must be given" if default is ... else f"{default} by default"
            order = "" if one.harder is None else f", {one.harder} is harder"
            lines.append(f"  {one.name}: {one.listed()}; {known}{order}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        changed = "".join(f", {name}={value!r}" for name, value in self.settings)
        return f"TaskFamily({self.name}: {', '.join(one.name for one in self.parameters)}{changed})"

    def __reduce__(self) -> Any:
        """Pickle a decorated function by its name, which now leads to the family."""
        if self.settings:
            return _with_settings, (self._base, self.settings)
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


def _with_settings(family: TaskFamily, settings: tuple[tuple[str, Any], ...]) -> TaskFamily:
    return family.with_defaults(**dict(settings))
