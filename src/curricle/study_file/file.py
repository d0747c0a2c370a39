"""A study file as data: its TOML, its arms as complete curricula, and the lines of its keys."""

import json
import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, cast

from pydantic import ValidationError

from curricle.curriculum.curriculum import OF_TARGETS
from curricle.errors import ConfigError, CurricleError
from curricle.learning.learners import Learner
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

# -- Reading TOML ----------------------------------------------------------------------------------

DEEPEST = 50  # tables and lists inside each other: deeper ones exhaust the stack
LONGEST_NUMBER = 4096  # bits: Python refuses to write more than 4,300 digits in a message


def toml_of(path: Path) -> tuple[str, dict[str, Any]]:
    """Return a file's text and its tables; ConfigError if it cannot be read as TOML."""
    try:
        text = text_of(path)
    except ValueError as error:
        with suppress(OSError):  # the path may be too long
            if (path / "study.json").is_file():  # every store has this file
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
    too_deep = f"tables and lists must be at most {DEEPEST} deep"
    try:
        tables = tomllib.loads(text)
    except RecursionError:
        raise ValueError(too_deep) from None
    layer: list[Any] = [tables]
    for _ in range(DEEPEST):
        inner = [node.values() if isinstance(node, dict) else node for node in layer]
        values = [value for values in inner for value in values]
        if any(isinstance(value, int) and value.bit_length() > LONGEST_NUMBER for value in values):
            raise ValueError(f"whole numbers must have at most {LONGEST_NUMBER:,} bits")
        layer = [value for value in values if isinstance(value, dict | list)]
    if layer:
        raise ValueError(too_deep)
    return tables


def assignment(text: str) -> tuple[tuple[str, ...], dict[str, Any]]:
    """Return the keys of ``key=value``, and nested tables with the value, TOML or else text."""
    key, equals, value = text.partition("=") if isinstance(text, str) else ("", "", "")
    keys = dotted(key)
    if not equals or not keys:
        raise ConfigError(f"a setting must be key=value, with dots in the key: got {text!r}")
    try:
        return keys, nested(keys, parsed(f"value = {value}")["value"])
    except ValueError:
        return keys, nested(keys, value.strip())


def nested(keys: Sequence[str], value: object) -> dict[str, Any]:
    """Return nested tables that have the value at these keys, one or more."""
    first, *later = keys
    return {first: nested(later, value) if later else value}


def names_in(study: Mapping[str, Any], key: str) -> list[str]:
    """Return the names of a study's tasks or arms, or the numbers of its transfers."""
    named = study.get(key)
    return [*map(str, range(len(named)))] if isinstance(named, list) else [*table(named)]


def dotted(key: str) -> tuple[str, ...]:
    """Return the parts of a dotted key of TOML, such as ``arms."5x5".shaping``; () if not a key."""
    try:
        node: Any = parsed(f"{key.strip()} = 0")
    except ValueError:
        return ()
    parts = list[str]()
    while isinstance(node, dict):
        ((part, node),) = node.items()
        parts.append(part)
    return tuple(parts)


# -- From a file's tables to complete curricula: arms override the study, tasks the common settings

SETTINGS = tuple(Settings.model_fields)
LASTING = frozenset(SETTINGS) | frozenset(Learner.__dataclass_fields__)
"""Keys that mean the same in tables of every type, but for learners that lack one."""
OF_LEARNERS = {kind.__name__: LASTING & {*SETTINGS, *kind.model_fields} for kind in LEARNERS}
ALTERNATIVES = {
    "map": "file",
    "file": "map",
    "epsilon": "inverse_temperature",
    "inverse_temperature": "epsilon",
}
"""Keys that exclude each other in a table; the last one that is set counts."""


def merged(base: Mapping[str, Any], patch: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` with the entries of `patch` over it, key by key; transfers by their number."""
    changes_type = any(key in patch and patch[key] != base.get(key) for key in ("type", "family"))
    lasting = OF_LEARNERS.get(str(patch.get("type")), LASTING)
    result = {key: value for key, value in base.items() if not changes_type or key in lasting}
    if changes_type and "family" in patch:  # a family determines the type
        result.pop("type", None)
    for key, value in patch.items():
        result.pop(ALTERNATIVES.get(key, ""), None)
        result[key] = _over(result.get(key), value, key)
    return result


def _over(old: object, new: object, key: str) -> object:
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
    if key == "arguments":  # its keys are the maker's own: none of them means a type
        return {**old, **{name: _over(old.get(name), value, key) for name, value in new.items()}}
    if key == "budget" and ("episodes" in old) is not ("episodes" in new):
        return new
    if key == "learner":
        if "type" in new and (old.get("type") == DEEP) is not (new["type"] == DEEP):
            return new
        if new.get("algorithm", old.get("algorithm")) != old.get("algorithm"):
            # Settings of one algorithm do not apply to another.
            old = {k: value for k, value in old.items() if k != "settings"}
    return merged(old, new)


def complete_learners(study: Mapping[str, Any], curriculum: dict[str, Any]) -> object:
    """Return a study's further learners from scratch, each merged over the target's learner."""
    learners, targets = study["scratch_learners"], NameGraph.of(curriculum).targets
    if not isinstance(learners, dict) or len(targets) != 1:
        return learners
    of_target = table(table(curriculum.get("tasks")).get(targets[0])).get("learner")
    if of_target is None:
        of_target = {"type": LEARNERS[0].model_fields["type"].default}
    return {name: _over(of_target, learner, "learner") for name, learner in learners.items()}


def complete_curriculum(study: Mapping[str, Any], patch: object = None) -> dict[str, Any]:
    """Return the curriculum of an arm, or of the study, each task with all its settings."""
    keys = ("tasks", "transfers", *SETTINGS)
    base, changes = {key: study[key] for key in keys if key in study}, dict(table(patch))
    if isinstance(changes.get("tasks"), dict):
        # That a patch names an unknown task is reported elsewhere.
        names = table(base.get("tasks"))
        changes["tasks"] = {name: of for name, of in changes["tasks"].items() if name in names}
    plan, chosen = merged(base, changes), changes.get("transfers")
    if isinstance(chosen, list):
        transfers = base.get("transfers")
        numbered = dict(enumerate(transfers)) if isinstance(transfers, list) else {}
        edges = [numbered.get(edge) if type(edge) is int else edge for edge in chosen]
        plan["transfers"] = [edge for edge in edges if edge is not None]
        plan["tasks"] = _needed(plan, NameGraph.of(base))
    for_all = {which: plan.pop(which) for which in SETTINGS if which in plan}
    with_sources = {target for _, target in NameGraph.of(plan).edges}
    tasks = plan.get("tasks")
    if isinstance(tasks, dict):
        plan["tasks"] = {
            name: _complete_task(task, for_all, has_sources=name in with_sources)
            if isinstance(task, dict)
            else task
            for name, task in tasks.items()
        }
    return plan


def _needed(plan: dict[str, Any], base: NameGraph) -> object:
    """Return the tasks that an arm's transfers need, and the study's target."""
    graph, tasks = NameGraph.of(plan), plan.get("tasks")
    names = {name for edge in graph.edges for name in edge}
    names |= set(base.targets) if len(base.targets) == 1 else set()
    if not isinstance(tasks, dict) or not names <= tasks.keys():
        return tasks  # the mistake is reported elsewhere
    needed = {drawing for name in names for drawing in graph.drawings(name)}
    return {name: task for name, task in tasks.items() if name in needed}


def _complete_task(
    task: dict[str, Any], for_all: Mapping[str, Any], *, has_sources: bool
) -> dict[str, Any]:
    """Return a task with the settings for all tasks filled in."""
    if "family" in task:
        task = {"type": "family", **task}
    informed = has_sources or "potential" in {*for_all, *task}
    fitting = {w: value for w, value in for_all.items() if informed or w not in OF_TARGETS}
    return {**task, **merged(fitting, {which: task[which] for which in SETTINGS if which in task})}


def toml_text(study: Mapping[str, Any]) -> str:
    """Return a study as the text of a file, a line for each key and each task."""
    lines = {key: value for key, value in study.items() if key != "tasks"}
    lines |= {f"tasks.{json.dumps(name)}": task for name, task in study["tasks"].items()}
    return "".join(f"{key} = {toml_value(value)}\n" for key, value in lines.items())


def toml_value(value: object) -> str:
    """Return a value as TOML, in one line."""
    if isinstance(value, Mapping):
        keys = (key if re.fullmatch(r"[\w-]+", key, re.ASCII) else json.dumps(key) for key in value)
        pairs = map("{} = {}".format, keys, map(toml_value, value.values()))
        return f"{{ {', '.join(pairs)} }}" if value else "{}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_value, value))}]"
    return str(value) if isinstance(value, float) else json.dumps(value, ensure_ascii=False)


# -- The positions of keys in a study file, and the mistakes at these positions --------------------


@dataclass(frozen=True)
class Positions:
    """Where the keys of a study file are."""

    file: str  # its name in messages
    text: str = ""  # its content
    changed: tuple[KeyPath, ...] = ()  # keys that were set from outside the file
    study: Mapping[str, Any] = field(default_factory=dict)  # its tables, changed from outside
    varied: Mapping[tuple[bool, str], Any] = field(default_factory=dict)
    """What varies in each arm, as returned by `varied_arms`."""

    @cached_property
    def lines(self) -> dict[KeyPath, int]:
        """The line of each key."""
        return line_numbers(self.text)

    def line(self, path: KeyPath) -> int:
        """Return the line of a key path, or of the table it is in; 0 if it is not in the file."""
        begins = [path[:n] for n in range(len(path), 0, -1)]
        if any(begin in self.changed for begin in begins):
            return 0
        return next((self.lines[begin] for begin in begins if begin in self.lines), 0)

    def sentence(self, path: KeyPath, text: str) -> str:
        """Return a mistake as a sentence on one line: file, line, key path and text."""
        line = self.line(path)
        # A key counts as set from outside if it, its table, or a key below it was set.
        changed = path and any(
            path[: len(key)] == key or key[: len(path)] == path for key in self.changed
        )
        where = (f", line {line}" if line else "") + (", as set" if changed else "")
        return f"{self.file}{where}: {path_text(path) or 'the study'} {' '.join(text.split())}"

    def in_file(self, path: KeyPath) -> KeyPath:
        """Return the file's path for a path in the configuration, such as in an arm."""
        # A key is looked up in this order, and the first hit counts: the arm's changes of the task,
        # the task, the arm's settings for all tasks, the study's.
        trial = path[:1] == ("tune",)
        if path[trial : trial + 1] not in (("arms",), ("scratches",)) or not self.study:
            return path
        name, *rest = path[trial + 1 :]
        arm, settings = self.varied.get((trial, str(name)), (name, ()))
        in_arm: KeyPath = ("arms", arm)
        tables, inner = [in_arm, cast(KeyPath, ())], rest
        if rest[:1] == ["tasks"] and len(rest) > 1:
            of, inner = ("tasks", rest[1]), rest[2:]
            tables = [(*in_arm, *of), of, *tables]
        elif rest[:1] == ["transfers"] and len(rest) > 1:
            chosen, number, inner = self._at((*in_arm, "transfers")), rest[1], rest[2:]
            if isinstance(chosen, list):
                entry = chosen[int(number)]
                tables = [("transfers", entry) if type(entry) is int else (*in_arm, *rest[:2])]
            else:
                tables = [(*in_arm, "transfers", str(number)), ("transfers", number)]
        for depth in range(len(inner), -1, -1):
            for base in tables:
                place = (*base, *inner[:depth])
                for setting in settings:  # a setting's table counts too, a whole task does not
                    key, names = setting.key, tuple(map(str, place))
                    least = 1 if key[0] in SETTINGS else 3 if key[2] in SETTINGS else 2
                    if len(names) >= least and key[: len(names)] == names[: len(key)]:
                        return (*setting.home, *place[len(key) :], *inner[depth:])
                if (depth or base not in (in_arm, ())) and self._at(place) is not None:
                    return (*place, *inner[depth:])
        return tuple(rest) or in_arm if self._at(in_arm) is not None else tuple(rest)

    def _at(self, path: KeyPath) -> object:
        """Return the value at a path of the file; None if there is none."""
        node: Any = self.study
        for part in path:
            entries = node if isinstance(node, dict) else {}
            entries = dict(enumerate(node)) if isinstance(node, list) else entries
            node = entries.get(part)
        return node


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
            once = dict[KeyPath, str]()  # trials may share a mistake, with different values
            kept = (of for of in ordered if of[0][:1] != ("tune",) or once.setdefault(*of) is of[1])
            sentences = dict.fromkeys(self.positions.sentence(*message) for message in kept)
            raise ConfigError("\n".join(sentences)) from self.cause


# -- The line of each key --------------------------------------------------------------------------


def line_numbers(text: str) -> dict[KeyPath, int]:
    """Return the line on which the statement of each key of valid TOML begins, from 1."""
    lines, header_path, last = dict[KeyPath, int](), cast(KeyPath, ()), Counter[KeyPath]()

    def note(path: KeyPath, value: object) -> None:
        lines.setdefault(path, begin)
        inner = value.items() if isinstance(value, dict) else ()
        for part, below in enumerate(value) if isinstance(value, list) else inner:
            note((*path, part), below)

    # A statement is the fewest lines that are valid TOML: texts and lists may span several lines.
    statement, begin = "", 1
    for number, line in enumerate(text.split("\n"), 1):
        begin = begin if statement else number
        statement += line + "\n"
        try:
            node: Any = tomllib.loads(statement)
        except ValueError:
            continue
        header, statement = statement.lstrip().startswith("["), ""
        if not header:
            for key, value in node.items():
                note((*header_path, key), value)
            continue
        header_path = ()
        while node:
            ((key, node),) = node.items()
            header_path = (*header_path, key)
            lines.setdefault(header_path, begin)
            if isinstance(node, list):
                last[header_path] += 1
                node = node[0]
            if header_path in last:
                header_path = (*header_path, last[header_path] - 1)
                lines.setdefault(header_path, begin)
    return lines
