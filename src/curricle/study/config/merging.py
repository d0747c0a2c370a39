"""Merging the tables of a study file, and where their keys stand in it."""

import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from pydantic import ValidationError

from curricle.curriculum.node import OF_TARGETS
from curricle.errors import ConfigError, CurricleError
from curricle.study.config.settings import DEEP, LEARNERS, Settings
from curricle.study.config.tables import SHOWN, KeyPath, NameGraph, parsed, shown, table
from curricle.study.config.tasks import of_family

# -- From a file's tables to complete curricula: arms over the study, tasks over settings for all --

SETTINGS = tuple(Settings.model_fields)
LASTING = frozenset(SETTINGS).union(
    frozenset.intersection(*(frozenset(one.model_fields) for one in LEARNERS))
)
"""Keys that mean the same in tables of every type."""
ALTERNATIVES = {
    "map": "file",
    "file": "map",
    "epsilon": "inverse_temperature",
    "inverse_temperature": "epsilon",
}
"""Keys of which a table has only one; the one given last counts."""

Raw = dict[str, Any]


def merged(base: Mapping[str, Any], patch: Mapping[str, Any]) -> Raw:
    """Return a table with another's entries over its own.

    Tables are merged key by key; any other value replaces the old one. A table that becomes another
    type keeps the keys that every type has. Transfers, a list, are given by number.
    """
    changes_type = any(key in patch and patch[key] != base.get(key) for key in ("type", "family"))
    result = {key: value for key, value in base.items() if not changes_type or key in LASTING}
    if changes_type and "family" in patch:  # which says the type
        result.pop("type", None)
    for key, value in patch.items():
        result.pop(ALTERNATIVES.get(key, ""), None)
        result[key] = _over(result.get(key), value, key)
    return result


def _over(old: Any, new: Any, key: str) -> Any:
    """Return the value of a key that has an older one; a table of another kind replaces it."""
    if not isinstance(new, dict):
        return new
    if key == "transfers" and isinstance(old, list):
        return [_over(one, new[str(n)], "") if str(n) in new else one for n, one in enumerate(old)]
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
            old = {name: value for name, value in old.items() if name != "settings"}
    return merged(old, new)


def complete_learners(study: Raw, curriculum: Raw) -> Any:
    """Return a study's further learners from scratch, each over that of a curriculum's target.

    What is malformed stays so.
    """
    given, targets = study["scratch_learners"], NameGraph.of(curriculum).targets
    if not isinstance(given, dict) or len(targets) != 1:
        return given
    own = table(table(curriculum.get("tasks")).get(targets[0])).get("learner")
    own = {"type": LEARNERS[0].model_fields["type"].default} if own is None else own
    return {name: _over(own, learner, "learner") for name, learner in given.items()}


def assignment(text: str) -> tuple[tuple[str, ...], Raw]:
    """Return what ``--set key=value`` assigns: the key's parts, and the value in nested tables.

    The value is read as TOML, or else taken as text. ConfigError says that it is no assignment.
    """
    key, equals, value = text.partition("=") if isinstance(text, str) else ("", "", "")
    keys = dotted(key)
    if not equals or not keys:
        raise ConfigError(f"a setting is given as key=value, with dots in the key: got {text!r}")
    given: Any
    try:
        given = parsed(f"value = {value}")["value"]
    except ValueError:
        given = value.strip()
    for part in reversed(keys):
        given = {part: given}
    return keys, dict(given)


def dotted(key: str) -> tuple[str, ...]:
    """Return the parts of a dotted key of TOML such as ``arms."5x5".shaping``; () if it is none."""
    try:
        node: Any = parsed(f"{key.strip()} = 0")
    except ValueError:
        return ()
    parts = list[str]()
    while isinstance(node, dict):
        (part,) = node
        parts.append(part)
        node = node[part]
    return tuple(parts)


def complete_curriculum(study: Raw, patch: Raw | None = None) -> Raw:
    """Return the curriculum of an arm, or of the study as it is, each task with all its settings.

    Any part may be malformed, and then stays so.
    """
    base = {key: value for key, value in study.items() if key in ("tasks", "transfers", *SETTINGS)}
    changes = table(patch)
    if isinstance(changes.get("tasks"), dict):
        # A change of an unknown task has been reported.
        there = table(base.get("tasks"))
        known = {name: task for name, task in changes["tasks"].items() if name in there}
        changes = {**changes, "tasks": known}
    plan = merged(base, changes)
    chosen = changes.get("transfers")
    if isinstance(chosen, list):
        plan["transfers"] = _chosen(chosen, base.get("transfers"))
        plan["tasks"] = _needed(plan, NameGraph.of(base))
    for_all = {which: plan.pop(which) for which in SETTINGS if which in plan}
    with_sources = {target for _, target in NameGraph.of(plan).edges}
    tasks, families = plan.get("tasks"), table(study.get("families"))
    if isinstance(tasks, dict):
        plan["tasks"] = {
            name: _with_settings(of_family(task, families), for_all, name in with_sources)
            if isinstance(task, dict)
            else task
            for name, task in tasks.items()
        }
    return plan


def _chosen(chosen: list[Any], transfers: Any) -> list[Any]:
    """Return the transfers that an arm names, those given by number taken from the study's."""
    there = dict(enumerate(transfers)) if isinstance(transfers, list) else {}
    named = [there.get(one) if type(one) is int else one for one in chosen]
    return [one for one in named if one is not None]


def _needed(plan: Raw, base: NameGraph) -> Any:
    """Return the tasks that an arm's own transfers need, and the study's target."""
    graph = NameGraph.of(plan)
    named = {name for edge in graph.edges for name in edge}
    named |= set(base.targets) if len(base.targets) == 1 else set()
    needed = {drawing for name in named for drawing in graph.drawings(name)}
    tasks = plan.get("tasks")
    if not isinstance(tasks, dict) or not named <= tasks.keys():
        return tasks  # something is wrong, and is reported elsewhere
    return {name: task for name, task in tasks.items() if name in needed}


def _with_settings(task: Raw, for_all: Raw, has_sources: bool) -> Raw:
    """Return a task with the settings for all under its own."""
    settings = {w: value for w, value in for_all.items() if has_sources or w not in OF_TARGETS}
    own = {which: task[which] for which in SETTINGS if which in task}
    return {**task, **merged(settings, own)}


# -- Where in a study file each key is, for messages -----------------------------------------------


@dataclass(frozen=True)
class Positions:
    """Where the keys of a study file are."""

    file: str
    """What messages call it."""
    study: Mapping[str, Any]
    """Its content, with what was set from outside."""
    lines: Mapping[KeyPath, int] = field(default_factory=dict)
    """The line of each key."""
    given: Sequence[KeyPath] = ()
    """What was set from outside."""
    varied: Mapping[str, tuple[str, Mapping[KeyPath, KeyPath]]] = field(default_factory=dict)
    """Arm that a sweep or a tuning makes -> the arm in the file, and place in its curriculum ->
    where the file says how that varies."""

    def line(self, path: KeyPath) -> int:
        """Return the line of a key path, or of the table it is in; 0 if it is not in the file."""
        begins = [path[:n] for n in range(len(path), 0, -1)]
        if any(begin in self.given for begin in begins):
            return 0
        return next((self.lines[begin] for begin in begins if begin in self.lines), 0)

    def sentence(self, path: KeyPath, text: str) -> str:
        """Return what is wrong as a sentence on one line: file, line, key path and text."""
        line = self.line(path)
        # Set from outside: the key, the table it is in, or a key in the table that it names.
        given = path and any(
            path[: len(one)] == one or one[: len(path)] == path for one in self.given
        )
        where = (f", line {line}" if line else "") + (", as set" if given else "")
        return f"{self.file}{where}: {path_text(path) or 'the study'} {' '.join(text.split())}"

    def in_file(self, arm: str, path: KeyPath) -> KeyPath:
        """Return where the file has a part of an arm's complete curriculum, given by its path."""
        arm, varied = self.varied.get(arm, (arm, {}))
        for place, home in varied.items():
            n = min(len(place), len(path))
            setting = place[0] == "tasks" and place[2] in SETTINGS
            if place[:n] == path[:n] and n > 1 + setting:  # not only the task that has it
                return home
        patch = table(table(self.study.get("arms")).get(arm))
        chosen = patch.get("transfers")
        if path[:1] == ("transfers",) and len(path) > 1 and isinstance(chosen, list):
            one = chosen[int(path[1])]
            return ("transfers", one, *path[2:]) if type(one) is int else ("arms", arm, *path)
        if not path or (len(path) == 1 and path[0] not in patch):
            return path or (("arms", arm) if patch else ())
        # Transfers are a list, but an arm that changes some of them has a table of numbers.
        keys = map(str, path) if path[0] == "transfers" else path
        homes = [("arms", arm, *keys), path]
        if len(path) > 2 and path[0] == "tasks" and path[2] in SETTINGS:
            homes += [("arms", arm, *path[2:]), path[2:]]  # a setting for all tasks
        elif len(path) > 2 and path[0] == "tasks":
            written = [table(one.get("tasks")).get(str(path[1])) for one in (patch, self.study)]
            named = [table(one).get("family") for one in written]
            homes += [("families", name, *path[2:]) for name in named if isinstance(name, str)]
        return min(homes, key=lambda home: len(home) - _reach(self.study, home))


def path_text(path: KeyPath) -> str:
    """Return a key path as messages name it, such as ``transfers[0].scale``."""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            plain = re.fullmatch(r"[\w-]+", part) and len(part) <= SHOWN
            word = part if plain else f'"{shown(part)[1:-1]}"'
            text += f".{word}" if text else word
    return text


def _reach(node: Any, path: KeyPath) -> int:
    """Return how many keys of a path there are."""
    for done, part in enumerate(path):
        try:
            node = node[part]
        except (KeyError, IndexError, TypeError):
            return done
    return len(path)


class Problems:
    """What is wrong with a study, collected to be reported at once."""

    def __init__(self, positions: Positions):
        self.positions = positions
        self.found: dict[str, None] = {}
        self.cause: Exception | None = None

    def add(self, wrong: Iterable[tuple[KeyPath, str]]) -> None:
        """Add key paths with what is wrong there, in the order of the file, each once."""
        for path, text in sorted(wrong, key=lambda one: self.positions.line(one[0])):
            self.found[self.positions.sentence(path, text)] = None

    @contextmanager
    def at(self, arm: str, path: KeyPath) -> Iterator[None]:
        """Add what the library refuses in this context, about a part of an arm's curriculum."""
        try:
            yield
        except ValidationError as error:
            wrong = [((*path, *one["loc"]), one["msg"]) for one in error.errors(include_url=False)]
            self.add([(self.positions.in_file(arm, place), text) for place, text in wrong])
        except CurricleError as error:
            self.cause = self.cause or error
            self.add([(self.positions.in_file(arm, path), f"is refused: {error}")])

    def raise_any(self) -> None:
        """Raise ConfigError if anything is wrong."""
        if self.found:
            raise ConfigError("\n".join(self.found)) from self.cause


# -- the line of each key ----------------------------------------------------------------------

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
    r"""Return the line on which each table, key and list entry of a TOML text begins, from 1.

    The standard library's parser does not report them. It has accepted the text before.
    """
    return _Scanner(text).lines


class _Token(NamedTuple):
    text: str
    sign: str
    """The text if it is a sign, such as ``=``; "end" after the last token."""
    line: int


class _Scanner:
    """Reads the tokens of a text once, one ahead."""

    def __init__(self, text: str):
        self.tokens = _tokens(text)
        self.next = next(self.tokens)
        self.lines: dict[KeyPath, int] = {}
        self.arrays = Counter[KeyPath]()
        here: KeyPath = ()
        while self.next.sign != "end":
            if self.next.sign == "\n":
                self.take()
            elif self.next.sign == "[":
                here = self.header()
            else:
                self.pair(here)

    def take(self) -> _Token:
        taken, self.next = self.next, next(self.tokens, self.next)
        return taken

    def skip(self, *signs: str) -> None:
        while self.next.sign in signs:
            self.take()

    def header(self) -> KeyPath:
        """Return the path of the table that a ``[header]`` or ``[[header]]`` begins."""
        line = self.take().line
        listed = self.next.sign == "["
        self.skip("[")
        path: KeyPath = ()
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
        found = [_unquoted(self.take().text)]
        while self.next.sign == ".":
            self.take()
            found.append(_unquoted(self.take().text))
        return found

    def pair(self, here: KeyPath) -> None:
        """Take ``key = value``."""
        line = self.next.line
        for key in self.keys():
            here = (*here, key)
            self.lines.setdefault(here, line)
        self.take()  # =
        self.value(here)

    def value(self, here: KeyPath) -> None:
        """Take a value, with the keys and entries inside it."""
        begin = self.take().sign
        if begin in ("[", "{"):
            end, entry = "]" if begin == "[" else "}", 0
            self.skip("\n")
            while self.next.sign != end:
                if end == "}":
                    self.pair(here)
                else:
                    self.lines.setdefault((*here, entry), self.next.line)
                    self.value((*here, entry))
                    entry += 1
                self.skip(",", "\n")
            self.take()
        while self.next.sign in ("", "."):  # the rest of a number or a date
            self.take()


def _tokens(text: str) -> Iterator[_Token]:
    line = 1
    for match in TOKEN.finditer(text):
        if match.lastgroup != "blank":
            yield _Token(match[0], match[0] if match.lastgroup == "sign" else "", line)
        line += match[0].count("\n")
    yield _Token("", "end", line)


def _unquoted(key: str) -> str:
    return str(tomllib.loads(f"key = {key}")["key"]) if key[0] in "'\"" else key
