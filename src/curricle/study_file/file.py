"""A study file as data: its TOML, arms merged into complete curricula, and places of all keys."""

import json
import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from pydantic import ValidationError

from curricle.curriculum.node import OF_TARGETS
from curricle.errors import ConfigError, CurricleError
from curricle.study_file.schema import (
    DEEP,
    LEARNERS,
    SHOWN,
    KeyPath,
    NameGraph,
    Settings,
    shown,
    table,
)
from curricle.study_file.task_tables import text_of
from curricle.text import shortened

# -- TOML, read without trust: bounded in size and in depth ----------------------------------------

DEEPEST = 50  # tables and lists inside each other: more exhaust their readers' stack
DEEP_KEY = re.compile(
    r"""(?<![\w.-])(?:(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+)"""
    rf"{{{DEEPEST}}}"
)
"""Keys that so many dots join: the parser's memory grows with the square of their number."""
MOST_DOTS = 100_000  # between keys of a file: each may be a table, of a kilobyte while parsed
LONGEST_NUMBER = 4096  # bits: Python writes no number of more than 4,300 digits
TOO_DEEP = f"tables and lists must be at most {DEEPEST} deep"
TOO_LONG = f"whole numbers must have at most {LONGEST_NUMBER:,} bits"


def toml_of(path: Path) -> tuple[str, dict[str, Any]]:
    """Return a file's text and its tables; ConfigError if it cannot be read as TOML."""
    try:
        text = text_of(path)
    except ValueError as error:
        with suppress(OSError):  # of a path that is too long
            if (path / "study.json").is_file():  # a store's first file
                raise ConfigError(
                    f"{path} is a folder of results, which StudyResults(FOLDER) reads"
                ) from None
        raise ConfigError(f"{shortened(str(path))} cannot be read: {error}") from None
    try:
        return text, parsed(text)
    except ValueError as error:
        raise ConfigError(f"{path} is not valid TOML: {error}") from None


def parsed(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text; ValueError says why it is not valid."""
    if DEEP_KEY.search(text):
        raise ValueError(TOO_DEEP)
    if len(re.findall(r"""[\w"'-][ \t]*\.(?=[ \t]*[\w"'-])""", text)) > MOST_DOTS:
        raise ValueError(f"at most {MOST_DOTS:,} dots may join keys")
    try:
        tables = tomllib.loads(text)
    except RecursionError:
        raise ValueError(TOO_DEEP) from None
    except tomllib.TOMLDecodeError:
        raise
    except ValueError:  # of Python's own limit for numbers in decimals
        raise ValueError(TOO_LONG) from None
    layer: list[Any] = [tables]
    for _ in range(DEEPEST):
        values = [
            value for node in layer for value in (node.values() if isinstance(node, dict) else node)
        ]
        if any(isinstance(n, int) and n.bit_length() > LONGEST_NUMBER for n in values):
            raise ValueError(TOO_LONG)
        layer = [value for value in values if isinstance(value, dict | list)]
    if layer:
        raise ValueError(TOO_DEEP)
    return tables


def assignment(text: str) -> tuple[tuple[str, ...], dict[str, Any]]:
    """Return the keys of ``key=value``, and the value, TOML or else text, in nested tables."""
    key, equals, value = text.partition("=") if isinstance(text, str) else ("", "", "")
    keys = dotted(key)
    if not equals or not keys:
        raise ConfigError(f"a setting must be key=value, with dots in the key: got {text!r}")
    try:
        return keys, nested(keys, parsed(f"value = {value}")["value"])
    except ValueError:
        return keys, nested(keys, value.strip())


def nested(keys: Iterable[Any], value: Any) -> Any:
    """Return nested tables with a value below these keys."""
    for part in reversed(tuple(keys)):
        value = {part: value}
    return value


def dotted(key: str) -> tuple[str, ...]:
    """Return the parts of a dotted key of TOML such as ``arms."5x5".shaping``; () if it is none."""
    try:
        node: Any = parsed(f"{key.strip()} = 0")
    except ValueError:
        return ()
    parts = list[str]()
    while isinstance(node, dict):
        ((part, node),) = node.items()
        parts.append(part)
    return tuple(parts)


# -- From a file's tables to complete curricula: arms over the study, tasks over settings for all --

SETTINGS = tuple(Settings.model_fields)
LASTING = frozenset(SETTINGS).union(
    frozenset.intersection(*(frozenset(kind.model_fields) for kind in LEARNERS))
)
"""Keys that mean the same in tables of every type."""
ALTERNATIVES = {
    "map": "file",
    "file": "map",
    "epsilon": "inverse_temperature",
    "inverse_temperature": "epsilon",
}
"""Keys that exclude each other in a table; the last one that is set counts."""


class Located(dict[str, Any]):
    """A table with its place in the file and those of its entries, also after merging."""

    def __init__(self, entries: Mapping[str, Any], of: Any = None):
        super().__init__(entries)
        self.home: KeyPath = getattr(of, "home", ())
        self.homes: dict[Any, KeyPath] = dict(getattr(of, "homes", {}))


def located(value: Any, home: KeyPath = ()) -> Any:
    """Return a value of a file with its tables as :class:`Located`."""
    if isinstance(value, list):
        return [located(entry, (*home, n)) for n, entry in enumerate(value)]
    if not isinstance(value, dict):
        return value
    made = Located({key: located(entry, (*home, key)) for key, entry in value.items()})
    made.home, made.homes = home, {key: (*home, key) for key in value}
    return made


def merged(base: Mapping[str, Any], patch: Mapping[str, Any]) -> Located:
    """Return a table with another's entries over its own, key by key; transfers go by number."""
    changes_type = any(key in patch and patch[key] != base.get(key) for key in ("type", "family"))
    kept = {key: value for key, value in base.items() if not changes_type or key in LASTING}
    result, homes = Located(kept, base), getattr(patch, "homes", {})
    result.home = getattr(patch, "home", ()) or result.home
    if changes_type and "family" in patch:  # which says the type
        result.pop("type", None)
    for key, value in patch.items():
        result.pop(ALTERNATIVES.get(key, ""), None)
        result[key] = _over(result.get(key), value, key)
        result.homes[key] = homes.get(key) or result.homes.get(key, (*result.home, key))
    return result


def _over(old: Any, new: Any, key: str) -> Any:
    """Return the new value of a key over its old value; tables of the same kind are merged."""
    if not isinstance(new, dict):
        return new
    if key == "transfers" and isinstance(old, list):
        return [
            _over(edge, new[str(n)], "") if str(n) in new else edge for n, edge in enumerate(old)
        ]
    if key == "shaping" and isinstance(old, str):
        old = {"type": old}
    if not isinstance(old, dict):
        return new
    if key == "budget" and ("episodes" in old) is not ("episodes" in new):
        return new
    if key == "learner":
        if "type" in new and (old.get("type") == DEEP) is not (new["type"] == DEEP):
            return new
        if new.get("algorithm", old.get("algorithm")) != old.get("algorithm"):
            # Another algorithm has other settings.
            old = Located({k: value for k, value in old.items() if k != "settings"}, old)
    return merged(old, new)


def complete_learners(study: Mapping[str, Any], curriculum: dict[str, Any]) -> Any:
    """Return a study's further learners from scratch, each merged over the target's learner."""
    learners, targets = study["scratch_learners"], NameGraph.of(curriculum).targets
    if not isinstance(learners, dict) or len(targets) != 1:
        return learners
    of_target = table(table(curriculum.get("tasks")).get(targets[0])).get("learner")
    if of_target is None:
        of_target = {"type": LEARNERS[0].model_fields["type"].default}
    return {name: _over(of_target, learner, "learner") for name, learner in learners.items()}


def complete_curriculum(study: Mapping[str, Any], patch: Any = None) -> Located:
    """Return the curriculum of an arm, or of the study, each task with all its settings."""
    keys = ("tasks", "transfers", *SETTINGS)
    base = Located({key: value for key, value in study.items() if key in keys}, study)
    changes = Located(table(patch), patch)
    if isinstance(changes.get("tasks"), dict):
        # A change of an unknown task has been reported.
        tasks = changes["tasks"]
        known = {name: tasks[name] for name in tasks if name in table(base.get("tasks"))}
        changes["tasks"] = Located(known, tasks)
    plan, chosen = merged(base, changes), changes.get("transfers")
    if isinstance(chosen, list):
        transfers = base.get("transfers")
        there = dict(enumerate(transfers)) if isinstance(transfers, list) else {}
        edges = [there.get(edge) if type(edge) is int else edge for edge in chosen]
        plan["transfers"] = [edge for edge in edges if edge is not None]
        plan["tasks"] = _needed(plan, NameGraph.of(base))
    for_all = Located({which: plan.pop(which) for which in SETTINGS if which in plan}, plan)
    with_sources = {target for _, target in NameGraph.of(plan).edges}
    tasks, families = plan.get("tasks"), table(study.get("families"))
    if isinstance(tasks, dict):
        complete = {
            name: _complete_task(task, families, for_all, has_sources=name in with_sources)
            if isinstance(task, dict)
            else task
            for name, task in tasks.items()
        }
        plan["tasks"] = Located(complete, tasks)
    return plan


def _needed(plan: Located, base: NameGraph) -> Any:
    """Return the tasks that an arm's transfers need, and the study's target."""
    graph, tasks = NameGraph.of(plan), plan.get("tasks")
    names = {name for edge in graph.edges for name in edge}
    names |= set(base.targets) if len(base.targets) == 1 else set()
    if not isinstance(tasks, dict) or not names <= tasks.keys():
        return tasks  # something is wrong, and is reported elsewhere
    needed = {drawing for name in names for drawing in graph.drawings(name)}
    return Located({name: task for name, task in tasks.items() if name in needed}, tasks)


def _complete_task(
    task: Mapping[str, Any], families: Mapping[str, Any], for_all: Located, *, has_sources: bool
) -> Located:
    """Return a task over the family that it names, its settings over those for all tasks."""
    name, result = task.get("family"), Located(task, task)
    if isinstance(name, str) and task.get("type", "family") == "family":
        family = table(families.get(name))
        of_both = {**family, **task, "family": family.get("family", name), "type": "family"}
        result = Located(of_both, task)
        result.homes = {**getattr(family, "homes", {}), **result.homes}
    fitting = {w: value for w, value in for_all.items() if has_sources or w not in OF_TARGETS}
    settings = {which: result[which] for which in SETTINGS if which in result}
    both = merged(Located(fitting, for_all), Located(settings, result))
    complete = Located({**result, **both}, result)
    complete.homes |= {which: both.homes[which] for which in both if which in both.homes}
    return complete


def toml_text(study: Mapping[str, Any]) -> str:
    """Return a study as the text of a file: its keys, then its tasks, then its transfers."""
    keys = {key: value for key, value in study.items() if key not in ("tasks", "transfers")}
    tables = [("", keys)]
    tables += [(f"[tasks.{_key(name)}]", task) for name, task in study["tasks"].items()]
    tables += [("[[transfers]]", edge) for edge in study["transfers"]]
    lines = [[head, *(f"{_key(k)} = {_toml(v)}" for k, v in part.items())] for head, part in tables]
    return "\n\n".join("\n".join(part).lstrip("\n") for part in lines) + "\n"


def _key(name: str) -> str:
    return name if re.fullmatch(r"[\w-]+", name, re.ASCII) else json.dumps(name, ensure_ascii=False)


def _toml(value: Any) -> str:
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{_key(k)} = {_toml(inner)}' for k, inner in value.items())} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, str) and "\n" in value:
        lines = (json.dumps(line, ensure_ascii=False)[1:-1] for line in value.split("\n"))
        return '"""\n' + "\n".join(lines) + '"""'
    return str(value) if isinstance(value, float) else json.dumps(value, ensure_ascii=False)


# -- Where in a study file each key is, and what is wrong there ------------------------------------


@dataclass(frozen=True)
class Positions:
    """Where the keys of a study file are."""

    file: str  # what messages call it
    lines: Mapping[KeyPath, int] = field(default_factory=dict)  # the line of each key
    changed: tuple[KeyPath, ...] = ()  # what was set from outside
    arms: Mapping[str, Any] = field(default_factory=dict)
    """Arm -> its complete curriculum, with :class:`Located` tables."""
    families: tuple[str, ...] = ()  # names of the study's own families

    def line(self, path: KeyPath) -> int:
        """Return the line of a key path, or of the table it is in; 0 if it is not in the file."""
        begins = [path[:n] for n in range(len(path), 0, -1)]
        if any(begin in self.changed for begin in begins):
            return 0
        return next((self.lines[begin] for begin in begins if begin in self.lines), 0)

    def sentence(self, path: KeyPath, text: str) -> str:
        """Return a mistake as a sentence on one line: file, line, key path and text."""
        line = self.line(path)
        # Set from outside: the key, the table it is in, or a key in the table that it names.
        changed = path and any(
            path[: len(key)] == key or key[: len(path)] == path for key in self.changed
        )
        where = (f", line {line}" if line else "") + (", as set" if changed else "")
        return f"{self.file}{where}: {path_text(path) or 'the study'} {' '.join(text.split())}"

    def in_file(self, path: KeyPath) -> KeyPath:
        """Return the file's path for a path in the configuration, such as in an arm."""
        if path[:1] not in (("arms",), ("scratches",)) or len(path) < 2 or not self.arms:
            return path
        # A trial of a tuning, which no file has, stands where the first arm does.
        node: Any = self.arms.get(str(path[1]), next(iter(self.arms.values())))
        home: KeyPath = getattr(node, "home", ()) if len(path) == 2 else ()
        for done, part in enumerate(path[2:], 2):
            if isinstance(node, dict) and part in node:
                node, home = node[part], getattr(node, "homes", {}).get(part, (*home, part))
            elif isinstance(node, list) and isinstance(part, int) and part < len(node):
                node, home = node[part], (*home, part)
                home = getattr(node, "home", ()) or home
            else:
                return (*home, *path[done:])
        return home


def path_text(path: KeyPath) -> str:
    """Return a key path as messages name it, such as ``transfers[0].scale``."""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            plain = re.fullmatch(r"[\w-]+", part) and len(part) <= SHOWN
            name = part if plain else f'"{shown(part)[1:-1]}"'
            text += f".{name}" if text else name
    return text


class Problems:
    """The mistakes in a study, collected to be reported together."""

    def __init__(self, positions: Positions):
        self.positions = positions
        self.messages: list[tuple[KeyPath, str]] = []
        self.cause: Exception | None = None

    def add(self, messages: Iterable[tuple[KeyPath, str]], *path: str) -> None:
        """Add messages with their key paths, below a path of the configuration."""
        for key, text in messages:
            self.messages.append((self.positions.in_file((*path, *key)) if path else key, text))

    @contextmanager
    def at(self, *path: str | int, mapped: bool = False) -> Iterator[None]:
        """Add errors raised in this context, about a path of the configuration or of the file."""
        try:
            yield
        except ValidationError as error:
            place: Any = self.positions.in_file if path or mapped else tuple
            for detail in error.errors(include_url=False):
                self.add([(place((*path, *detail["loc"])), detail["msg"])])
        except CurricleError as error:
            self.cause = self.cause or error
            self.add([(self.positions.in_file(path), f"is refused: {error}")])

    def raise_any(self) -> None:
        """Raise ConfigError if there are mistakes: a sentence for each, in the file's order."""
        if self.messages:
            ordered = sorted(self.messages, key=lambda message: self.positions.line(message[0]))
            sentences = dict.fromkeys(self.positions.sentence(*message) for message in ordered)
            raise ConfigError("\n".join(sentences)) from self.cause


# -- The line of each key --------------------------------------------------------------------------

TOKEN = re.compile(
    r"""
      (?P<blank>[ \t\r]+|\#[^\n]*)
    | (?P<text>\"{3}(?:\\.|[^\\])*?\"{3,5} | '{3}.*?'{3,5} | "(?:\\.|[^"\\\n])*" | '[^'\n]*')
    | (?P<sign>[\[\]{},=.\n])
    | (?P<bare>[^\s\[\]{},=.\#"']+)
    """,
    re.VERBOSE | re.DOTALL,
)


def line_numbers(text: str) -> dict[KeyPath, int]:
    """Return the line on which each table, key and list entry of valid TOML begins, from 1."""
    scanner, here = _Scanner(text), cast(KeyPath, ())
    while scanner.sign != "end":
        if scanner.sign == "\n":
            scanner.tokens.pop()
        elif scanner.sign == "[":
            here = scanner.header()
        else:
            scanner.pair(here)
    return scanner.lines


class _Scanner:
    """Reads the tokens of a text once, and can look at the next token before taking it."""

    def __init__(self, text: str):
        line, self.tokens = 1, list[tuple[str, str, int]]()  # text, sign or "", line
        for match in TOKEN.finditer(text):
            if match.lastgroup != "blank":
                sign = match[0] if match.lastgroup == "sign" else ""
                self.tokens.append((match[0], sign, line))
            line += match[0].count("\n")
        self.tokens = [("", "end", line), *reversed(self.tokens)]
        self.lines: dict[KeyPath, int] = {}
        self.arrays = Counter[KeyPath]()

    @property
    def sign(self) -> str:
        """The next token if it is a sign, such as ``=``; "end" after the last."""
        return self.tokens[-1][1]

    def skip(self, *signs: str) -> None:
        while self.sign in signs:
            self.tokens.pop()

    def header(self) -> KeyPath:
        """Return the path of the table that a ``[header]`` or ``[[header]]`` begins."""
        line = self.tokens.pop()[2]
        listed, path = self.sign == "[", cast(KeyPath, ())
        self.skip("[")
        keys = self.keys()
        for n, key in enumerate(keys):
            path = (*path, key)
            self.lines.setdefault(path, line)
            if listed and n == len(keys) - 1:
                self.arrays[path] += 1
            if path in self.arrays:
                path = (*path, self.arrays[path] - 1)
                self.lines.setdefault(path, line)
        self.skip("]")
        return path

    def keys(self) -> list[str]:
        """Take a dotted key."""
        keys = list[str]()
        while not keys or self.sign == ".":
            self.skip(".")
            text = self.tokens.pop()[0]
            keys.append(tomllib.loads(f"key = {text}")["key"] if text[0] in "'\"" else text)
        return keys

    def pair(self, here: KeyPath) -> None:
        """Take ``key = value``."""
        line = self.tokens[-1][2]
        for key in self.keys():
            here = (*here, key)
            self.lines.setdefault(here, line)
        self.skip("=")
        self.value(here)

    def value(self, here: KeyPath) -> None:
        """Take a value, with the keys and entries inside it."""
        begin, entry = self.tokens.pop()[1], 0
        if begin in ("[", "{"):
            self.skip("\n")
            while self.sign not in ("]", "}"):
                if begin == "{":
                    self.pair(here)
                else:
                    self.lines.setdefault((*here, entry), self.tokens[-1][2])
                    self.value((*here, entry))
                    entry += 1
                self.skip(",", "\n")
            self.tokens.pop()
        while self.sign in ("", "."):  # the rest of a number or a date
            self.tokens.pop()
