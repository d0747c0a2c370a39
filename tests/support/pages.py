"""What a Markdown page has its reader do: files to write, commands to type, and their outputs.

A fenced block that begins with ``# name.ext`` is a file. In a block of ``console`` lines after
``$`` are commands and the others what they print; in one of ``sh`` all lines are commands. A block
of TOML that begins with ``[a.table]`` is put in the place of that table in the file that has it. A
time in a command's comment, ``# 30 s``, is the most that the page grants it.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FILE = re.compile(r"# ([\w-]+\.\w+)\n")
TABLE = re.compile(r"(\[[\w.-]+\])[^\n]*\n")
TIME = re.compile(r"#.*?\b(\d+) (s|seconds|minutes?)\b")
SECONDS = {"s": 1, "seconds": 1, "minute": 60, "minutes": 60}
MOST = 20.0
"""Seconds granted where the page states none."""


@dataclass(frozen=True)
class File:
    """A file that the page shows."""

    name: str
    text: str


@dataclass(frozen=True)
class Table:
    """A table of TOML that the reader puts in the place of the one of that header."""

    header: str
    text: str


@dataclass(frozen=True)
class Command:
    """A command of the shell, and what the page says it prints; nothing if it does not say."""

    line: str
    output: str = ""

    @property
    def seconds(self) -> float:
        """The most that it may take."""
        return stated_seconds(self.line)


def stated_seconds(code: str) -> float:
    """Return the seconds that a comment grants, or those granted where none does.

    >>> stated_seconds("make paper  # into paper-results/, at most 3 minutes"), stated_seconds("ls")
    (180.0, 20.0)
    """
    found = TIME.search(code)
    return float(found[1]) * SECONDS[found[2]] if found else MOST


def blocks(text: str) -> list[tuple[str, str]]:
    """Return the language and the text of each fenced block."""
    return FENCE.findall(text)


def steps(text: str) -> Iterator[File | Table | Command]:
    """Yield what a page has its reader do in a shell, in order."""
    for language, block in blocks(text):
        if named := FILE.match(block):
            yield File(named[1], block)
        elif language == "toml" and (table := TABLE.match(block)):
            yield Table(table[1], block)
        elif language == "sh":
            yield from map(Command, filter(None, block.splitlines()))
        elif language == "console":
            yield from commands_of(block)


def commands_of(block: str) -> Iterator[Command]:
    """Yield the commands of a console with what each prints."""
    for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
        line, _, output = part.partition("\n")
        yield Command(line, output)


def put(step: File | Table, folder: Path) -> None:
    """Write a file of a page into a folder, or a table into the file there that has it."""
    if isinstance(step, File):
        (folder / step.name).write_text(step.text, "utf-8")
        return
    pattern = re.compile(rf"^{re.escape(step.header)}.*?\n(?=\[|\Z)", re.MULTILINE | re.DOTALL)
    holders = [path for path in folder.glob("*.toml") if pattern.search(path.read_text("utf-8"))]
    if len(holders) != 1:
        raise LookupError(f"one file must have {step.header}: {[path.name for path in holders]}")
    text = pattern.sub(lambda _: f"{step.text}\n", holders[0].read_text("utf-8"), count=1)
    holders[0].write_text(text, "utf-8")
