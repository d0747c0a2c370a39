"""What the tables of a study file are made of: text, names, references, seeds, library classes."""

import hashlib
import importlib
import importlib.util
import inspect
import logging
import os
import re
import sys
import tomllib
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, is_dataclass
from difflib import get_close_matches
from functools import cache, reduce
from graphlib import CycleError, TopologicalSorter
from operator import or_
from pathlib import Path
from types import ModuleType, NoneType, UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    NamedTuple,
    Self,
    Union,
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
    ModelWrapValidatorHandler,
    Strict,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    create_model,
    model_validator,
)
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from curricle.checks import BEYOND_64_BITS, LONGEST_NAME, listed, unfit_name
from curricle.errors import ConfigError, CurricleError
from curricle.files import read_bounded
from curricle.interop.encoders import FlatDict, MiniGridFullView, MiniGridView, StackedFrames
from curricle.learning.schedules import Schedule, exponential, harmonic, linear
from curricle.learning.seeds import MOST_SEEDS

# -- Text files of a study, and TOML, read without trust: bounded in size and in depth -------------

TEXT = "utf-8-sig"
"""UTF-8, with or without a byte-order mark."""
LARGEST_FILE = 10_000_000
"""Bytes of a study file or a map: the largest example has 3,000."""
DEEPEST = 50
"""Tables and lists inside each other: what has more exhausts the stack of those that read it."""
DEEP_KEY = re.compile(
    r"""(?<![\w.-])(?:(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+)"""
    rf"{{{DEEPEST}}}"
)
"""Keys that so many dots join: the parser's memory grows with the square of their number."""
MOST_DOTS = 100_000
"""Dots between keys in a file: each may be a table, of a kilobyte while a file is parsed."""
LONGEST_NUMBER = 4096
"""Bits of a whole number: Python writes no number of more than 4,300 digits, as in a message."""
TOO_DEEP = f"tables and lists must be at most {DEEPEST} deep"
TOO_LONG = f"whole numbers must have at most {LONGEST_NUMBER:,} bits"


def text_of(path: Path) -> str:
    """Return the content of a text file; ValueError says why it cannot be read."""
    try:
        return read_bounded(path, LARGEST_FILE).decode(TEXT)
    except OSError as error:
        raise ValueError(error.strerror) from None
    except UnicodeDecodeError as error:
        raise ValueError(f"it is not UTF-8: {error}") from None


def parsed(text: str) -> dict[str, Any]:
    """Return what a TOML text says; ValueError says why it is none."""
    found: dict[str, Any]
    if DEEP_KEY.search(text):
        raise ValueError(TOO_DEEP)
    if len(re.findall(r"""[\w"'-][ \t]*\.(?=[ \t]*[\w"'-])""", text)) > MOST_DOTS:
        raise ValueError(f"at most {MOST_DOTS:,} dots may join keys")
    try:
        found = tomllib.loads(text)
    except RecursionError:
        raise ValueError(TOO_DEEP) from None
    except tomllib.TOMLDecodeError:
        raise
    except ValueError:  # of Python's own limit for numbers in decimals
        raise ValueError(TOO_LONG) from None
    layer: list[Any] = [found]
    for _ in range(DEEPEST):
        values = [one for node in layer for one in _values(node)]
        if any(isinstance(one, int) and one.bit_length() > LONGEST_NUMBER for one in values):
            raise ValueError(TOO_LONG)
        layer = [one for one in values if isinstance(one, dict | list)]
    if layer:
        raise ValueError(TOO_DEEP)
    return found


def _values(node: dict[str, Any] | list[Any]) -> Iterable[Any]:
    return node.values() if isinstance(node, dict) else node


# -- The base of all tables of a study file: frozen, without unknown keys, with plain messages -----

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
    """Return ``, did you mean 'that'?`` for the known word that is closest; empty if none is."""
    by_lower_case = {one.lower(): one for one in known}
    close = get_close_matches(str(word).lower(), by_lower_case, n=1)
    return f", did you mean {by_lower_case[close[0]]!r}?" if close else ""


def not_one_of(value: Any, known: Collection[str]) -> str:
    """Return that a value must be one of the known words."""
    return f"must be one of {', '.join(known)}: got {shown(value)}{suggestion(value, known)}"


def unknown(word: Any, known: Collection[str]) -> str:
    """Return that a word is unknown, with the closest known word or else all of them."""
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


# -- The names of tasks in a curriculum, checked before anything is built --------------------------

DRAWN = ("maze", "crop", "four_rooms", "key_lock_pit", "family")
"""Types of tasks that a crop may be a part of."""


class NameGraph(NamedTuple):
    """The tasks of a curriculum by name, its crops and its transfers."""

    parts: dict[str, str | None]
    """The task of which each task is a crop, if it is one."""
    edges: tuple[tuple[str, str], ...]
    """Source and target of each transfer."""

    @classmethod
    def of(cls, plan: dict[str, Any]) -> "NameGraph":
        """Return the graph of a curriculum as data, of which any part may be malformed."""
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
        """The tasks that are learnt: all but those that are there only to be cropped."""
        named = {name for edge in self.edges for name in edge}
        cropped = set(self.parts.values())
        return [name for name in self.parts if name in named or name not in cropped]

    @property
    def targets(self) -> list[str]:
        """The tasks that are learnt and that no other builds on; a curriculum has one."""
        sources = {source for source, _ in self.edges}
        return [name for name in self.learnt if name not in sources]

    def drawings(self, name: str) -> list[str]:
        """Return the tasks that one is a crop of, itself first."""
        found = list[str]()
        part: str | None = name
        while part is not None and part not in found:
            found.append(part)
            part = self.parts.get(part)
        return found


def table(value: Any) -> dict[str, Any]:
    """Return a table as it is, and an empty one for anything else."""
    return value if isinstance(value, dict) else {}


def wrong_names(plan: dict[str, Any]) -> Iterator[tuple[KeyPath, str]]:
    """Yield what is wrong with the names in a curriculum, each with its key path.

    Malformed parts are skipped, since they are reported elsewhere.
    """
    graph = NameGraph.of(plan)
    tasks, transfers = table(plan.get("tasks")), plan.get("transfers")
    for name, task in tasks.items():
        if why := unfit_name(name):
            yield ("tasks", name), f"has a name that {why}"
        of = table(task).get("of")
        if table(task).get("type") == "crop" and isinstance(of, str):
            path = ("tasks", name, "of")
            if of not in graph.parts:
                yield path, _no_task(of, graph)
            elif table(tasks[of]).get("type") not in DRAWN:
                yield path, f"must name a task of type {', '.join(DRAWN)}: got {shown(of)}"
            elif graph.parts.get(graph.drawings(name)[-1]) is not None:
                yield (
                    path,
                    f"must lead to a whole task: got {' of '.join(graph.drawings(name))} and so on",
                )
    whole = True
    for index, edge in enumerate(transfers if isinstance(transfers, list) else []):
        for role in ("source", "target"):
            wanted = table(edge).get(role)
            known = isinstance(wanted, str) and wanted in graph.parts
            whole = whole and known
            if isinstance(wanted, str) and not known:
                yield ("transfers", index, role), _no_task(wanted, graph)
    if whole:
        yield from _whole(graph)


def _whole(graph: NameGraph) -> Iterator[tuple[KeyPath, str]]:
    """Yield what is wrong with a graph all of whose names are known."""
    before: dict[str, list[str]] = {}
    for source, target in graph.edges:
        before.setdefault(target, []).append(source)
    try:
        TopologicalSorter(before).prepare()
    except CycleError as error:
        yield ("transfers",), f"must have no cycle: got {' -> '.join(error.args[1])}"
        return
    if graph.parts and len(graph.targets) != 1:
        yield (
            ("tasks",),
            f"must have one that no other builds on: got {', '.join(graph.targets) or 'none'}",
        )


def _no_task(name: str, graph: NameGraph) -> str:
    return f"must name a task: got {shown(name)}{suggestion(name, graph.parts)}"


# -- Functions that a study file names as ``module:function`` --------------------------------------

ALLOW = "CURRICLE_ALLOW"
"""The environment variable with the installed packages whose functions study files may name."""
SAFE = {"curricle.deep", "torch.nn", "torch.optim"}
"""Modules that they may name anyway: what networks are made of runs no commands."""

IMPORTED = dict[str, tuple[int, int] | None]()
"""The time and size of each module's file when it was imported."""
PACKAGES = "curricle_study_"
"""What the names of packages of studies' own modules begin with."""
LOGGER = logging.getLogger(__name__)
"""It names each module of a study before the module is imported."""


def load(reference: str, folder: Path) -> Callable[..., Any]:
    """Return the function that ``module:function`` names.

    A module beside the study file comes before one on ``sys.path``. It belongs to its folder:
    modules of the same name in two folders stay apart. It imports its neighbours relatively
    (``from .rules import slip``). One on ``sys.path`` must be of a package that the user allows:
    a file alone, from whomever, then runs nothing that nobody chose to run. ConfigError says that
    there is no such module or function, that it may not be named, or that importing it failed.
    """
    module_name, colon, name = reference.partition(":")
    words = [*module_name.split("."), name]
    if not colon or not all(word.isidentifier() for word in words):
        raise ConfigError(f"a function is named as module:function: got {reference!r}")
    with users_code(reference):
        module = _module(module_name, folder)
    if module is None:
        raise ConfigError(
            f"{reference} names no module: {module_name} is neither beside the study file nor on "
            "Python's path"
        )
    function = getattr(module, name, None)
    if not callable(function):
        raise ConfigError(
            f"{reference} names no function: {module_name} has no {name} to call"
            f"{_others(module, name)}"
        )
    return function  # type: ignore[no-any-return]


def _others(module: ModuleType, name: str) -> str:
    """Return what else of a module can be called: the closest name, or all that it defines."""
    there = {one: of for one, of in vars(module).items() if one[0] != "_" and callable(of)}
    own = [one for one, of in there.items() if getattr(of, "__module__", "") == module.__name__]
    return suggestion(name, there) or (f": it has {listed(own)}" if own else "")


@contextmanager
def users_code(reference: str) -> Iterator[None]:
    """Turn a failure of a user's function into a ConfigError that names it."""
    try:
        yield
    except CurricleError:
        raise
    except Exception as error:
        raise ConfigError(f"{reference} failed: {type(error).__name__}: {error}") from error


def _check_allowed(name: str) -> None:
    """Raise ConfigError unless a module that is not beside the study file may be named in it."""
    first, allowed = name.partition(".")[0], os.environ.get(ALLOW, "").split(",")
    if first in sys.stdlib_module_names:
        raise ConfigError(
            f"a study file names functions of modules beside it: {first} is not there, and "
            "Python's own library, which can run any command, is refused"
        )
    if name not in SAFE and not any(f"{name}.".startswith(f"{one.strip()}.") for one in allowed):
        raise ConfigError(
            "a study file names functions of modules beside it, and of installed packages that you "
            f"allow: {first} is not beside it; set {ALLOW}={first} if you trust the file with it"
        )


def _module(name: str, folder: Path) -> ModuleType | None:
    """Return a module beside the study file or on ``sys.path``; None if there is none."""
    package, first = _package(folder), name.partition(".")[0]
    found = None
    if _exists(f"{package}.{first}"):
        found = _imported(f"{package}.{name}", "beside the study file")
    if found is None and (first in sys.modules or _exists(first)):
        _check_allowed(name)
        found = _imported(name, "from Python's path")
    for module in _modules_in(package):
        IMPORTED.setdefault(module, _stamp(module))
    return found


def _imported(path: str, place: str) -> ModuleType | None:
    if path not in sys.modules:
        name = path.partition(".")[2] if path.startswith(PACKAGES) else path
        LOGGER.info("importing the study's module %s, %s", name, place)
    return importlib.import_module(path) if _exists(path) else None


def _exists(path: str) -> bool:
    package = path.rpartition(".")[0]
    there = not package or package in sys.modules or _exists(package)
    return there and importlib.util.find_spec(path) is not None


def _package(folder: Path) -> str:
    """Return the name of a package whose modules are those in a folder.

    As its submodules they are found without changing ``sys.path``, and keep apart from others. When
    a file of them has changed since it was imported, they are imported again.
    """
    path = str(folder.resolve())
    name = f"{PACKAGES}{hashlib.sha256(path.encode()).hexdigest()[:16]}"
    imported = _modules_in(name)
    if any(module in IMPORTED and IMPORTED[module] != _stamp(module) for module in imported):
        for module in imported:  # all, since they import each other
            del sys.modules[module]
            IMPORTED.pop(module, None)
        importlib.invalidate_caches()
    package = ModuleType(name, f"The modules in {path}.")
    package.__path__ = [path]
    sys.modules.setdefault(name, package)
    return name


def _modules_in(package: str) -> list[str]:
    return [name for name in list(sys.modules) if name.startswith(f"{package}.")]


def _stamp(module: str) -> tuple[int, int] | None:
    """Return the time and size of a module's file now; None if it has none."""
    file = getattr(sys.modules[module], "__file__", None)
    try:
        found = Path(file or "").stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size


# -- Seeds as a study file writes them -------------------------------------------------------------


def seeds_of(value: Any) -> tuple[int, ...]:
    """Return what a file says of seeds, such as 30, [0, 1, 7] or "0-9,20-29"."""
    numbers: Any = seeds_in_ranges(value) if isinstance(value, str) else value
    if type(numbers) is int:
        numbers = range(min(numbers, MOST_SEEDS + 1))
    listed = isinstance(numbers, list | tuple | range) and 0 < len(numbers) <= MOST_SEEDS
    whole = listed and all(type(n) is int and 0 <= n < BEYOND_64_BITS for n in numbers)
    if not whole or len(set(numbers)) < len(numbers):
        raise wrong(
            'must be a number of seeds, a list of different ones, or ranges such as "0-9,20-29", '
            f"{MOST_SEEDS:,} at most: got {shown(value)}"
        )
    return tuple(numbers)


def seeds_in_ranges(text: str) -> list[int]:
    """Return the seeds in ranges such as "0-9,20-29"; none if malformed or far too many."""
    numbers = list[int]()
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d{1,19})\s*(?:-\s*(\d{1,19})\s*)?", part, re.ASCII)
        named = range(int(match[1]), int(match[2] or match[1]) + 1) if match else range(0)
        if not named or len(numbers) + named.stop - named.start > MOST_SEEDS:
            return []
        numbers += named
    return numbers


# -- Tables made from the library's frozen dataclasses and functions: one declaration for both -----
#
# A table has the parameters of what it builds, with their defaults, and their descriptions from the
# numpydoc "Parameters" section; the library itself checks the values when the object is built.
#
# Why not ``TypeAdapter(cls)``, which validates a dataclass as it is annotated: in strict mode it
# refuses a TOML table (a dict is not an instance), in lax mode it accepts "3" and ``true`` for a
# number. A table must also be written back as TOML, with its ``type`` and its schedules.


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

    Keys of the table `base` come on top; `tag` is the value of its key ``type``, where it is one of
    several; parameters `without` cannot be given; `annotations` are types of parameters that TOML
    writes in another way than Python.
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
    """Return what the numpydoc says of each parameter; the summary where it says nothing."""
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


# -- Encoders of observations in study files: by name, as a table, or a function of the user's -----

_SIMPLE = (
    table_of(MiniGridView, tag="MiniGridView"),
    table_of(MiniGridFullView, tag="MiniGridFullView"),
    table_of(FlatDict, tag="FlatDict", leave_out=tuple[str, ...]),
)


def named(*tables: Any, function: bool = False) -> Callable[[Any], Any]:
    """Return the validator of a table's name in its place, or of ``module:function``."""
    known = {str(table.model_fields["type"].default): table for table in tables}

    def simple(value: Any) -> Any:
        if function and isinstance(value, str) and ":" in value:
            return value
        if not isinstance(value, str) or value not in known:
            raise wrong(not_one_of(value, known) + " (or module:function)" * function)
        needed = [key for key, one in known[value].model_fields.items() if one.is_required()]
        if needed:
            raise wrong(f"must be a table, as {value} needs {' and '.join(needed)}: got {value!r}")
        return known[value]()

    return simple


def _encoder_of(*tables: Any) -> Any:
    return Annotated[Any, tagged(*tables, simple=named(*tables, function=True), simple_type=str)]


class _StackedFramesTable(ObjectTable):
    def arguments_in(self, folder: Path) -> dict[str, Any]:
        """Return the arguments, the encoder of each frame made."""
        given = super().arguments_in(folder)
        return {**given, "of": encoder(given["of"], folder)}


AnyEncoder: Any = _encoder_of(
    *_SIMPLE,
    table_of(
        StackedFrames, _StackedFramesTable, tag="StackedFrames", of=_encoder_of(*_SIMPLE) | None
    ),
)
"""An encoder: ``"MiniGridView"``, ``{ type = "FlatDict", ... }`` or ``"module:function"``."""


def encoder(value: Any, folder: Path) -> Any:
    """Return the encoder that a value of a study file stands for; None where there is none."""
    return load(value, folder) if isinstance(value, str) else built(value, folder)
