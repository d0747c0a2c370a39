"""Where in a study file something is written, to say so in a message."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from curricle.errors import ConfigError, CurricleError
from curricle.study.config.graph import table
from curricle.study.config.merging import SETTINGS, dotted
from curricle.study.config.tables import Place

HEADER = re.compile(r"\s*(\[\[?)([^\[\]]+)\]")
KEY = re.compile(r"""\s*([\w\-."' ]+?)\s*=""")
QUOTES = re.compile(r'"{3}|\'{3}')


@dataclass(frozen=True)
class Places:
    """The places of a study file.

    Parameters
    ----------
    file : str
        What messages call it.
    study : dict
        What it says, with what was set.
    lines : dict of tuple to int
        Line of each place.
    given : sequence of tuple
        Places that were set from outside.
    """

    file: str
    study: Mapping[str, Any]
    lines: Mapping[Place, int] = field(default_factory=dict)
    given: Sequence[Place] = ()

    def line(self, place: Place) -> int:
        """Return the line of a place, or of what it is in; 0 where that is not in the file."""
        begins = [place[:n] for n in range(len(place), 0, -1)]
        if any(begin in self.given for begin in begins):
            return 0
        return next((self.lines[begin] for begin in begins if begin in self.lines), 0)

    def sentence(self, place: Place, text: str) -> str:
        """Return what is wrong as a sentence, on one line, that begins with the place."""
        line = self.line(place)
        given = any(place[: len(one)] == one for one in self.given)
        where = f", line {line}" if line else ", as set" if given else ""
        return f"{self.file}{where}: {spelt(place) or 'the study'} {' '.join(text.split())}"

    def written(self, arm: str, place: Place) -> Place:
        """Return where a part of an arm's curriculum is written in the file.

        Parameters
        ----------
        arm : str
        place : tuple
            In the complete curriculum, such as ``("tasks", "chase", "budget")``.
        """
        patch = table(table(self.study.get("arms")).get(arm))
        chosen = patch.get("transfers")
        if place[:1] == ("transfers",) and len(place) > 1 and isinstance(chosen, list):
            one = chosen[int(place[1])]
            return ("transfers", one, *place[2:]) if type(one) is int else ("arms", arm, *place)
        if not place or (len(place) == 1 and place[0] not in patch):
            return place or (("arms", arm) if patch else ())
        # Transfers are a list, but an arm that changes some of them has a table of numbers.
        keys = map(str, place) if place[0] == "transfers" else place
        homes = [("arms", arm, *keys), place]
        if len(place) > 2 and place[0] == "tasks" and place[2] in SETTINGS:
            homes += [("arms", arm, *place[2:]), place[2:]]  # a setting for all tasks
        return min(homes, key=lambda home: len(home) - _reach(self.study, home))


def spelt(place: Place) -> str:
    """Return a place as messages name it.

    Examples
    --------
    >>> spelt(("transfers", 0, "scale")), spelt(("tasks", "5 by 5", "size"))
    ('transfers[0].scale', 'tasks."5 by 5".size')
    """
    text = ""
    for part in place:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            word = part if re.fullmatch(r"[\w-]+", part) else f'"{part}"'
            text += f".{word}" if text else word
    return text


def line_numbers(text: str) -> dict[Place, int]:
    r"""Return the line on which each table and key of a TOML text begins, counted from 1.

    Examples
    --------
    >>> line_numbers("[tasks.chase]\nsize = 5")[("tasks", "chase", "size")]
    2
    """
    found: dict[Place, int] = {}
    arrays = Counter[Place]()
    here: Place = ()
    inside = ""
    for number, line in enumerate(text.splitlines(), 1):
        if not inside:
            if header := HEADER.match(line):
                here = dotted(header[2])
                if header[1] == "[[":
                    arrays[here] += 1
                    here = (*here, arrays[here] - 1)
                for end in range(1, len(here) + 1):
                    found.setdefault(here[:end], number)
            elif key := KEY.match(line):
                keys = dotted(key[1])
                for end in range(1, len(keys) + 1):
                    found.setdefault((*here, *keys[:end]), number)
        for quotes in QUOTES.findall(line):
            inside = "" if inside == quotes else inside or quotes
    return found


def _reach(node: Any, place: Place) -> int:
    """Return how much of a place there is."""
    for done, part in enumerate(place):
        try:
            node = node[part]
        except (KeyError, IndexError, TypeError):
            return done
    return len(place)


class Problems:
    """What is wrong with a study, collected on the way and told together."""

    def __init__(self) -> None:
        self.found: dict[str, None] = {}
        self.cause: Exception | None = None

    def add(self, sentences: Iterable[str]) -> None:
        """Take more sentences; what has been said is not said again."""
        self.found.update(dict.fromkeys(sentences))

    @contextmanager
    def at(self, places: Places, place: Place) -> Iterator[None]:
        """Take what Curricle itself refuses, said of a place."""
        try:
            yield
        except CurricleError as error:
            self.cause = self.cause or error
            self.found[places.sentence(place, f"is refused: {error}")] = None

    def tell(self) -> None:
        """Raise ConfigError if anything was wrong."""
        if self.found:
            raise ConfigError("\n".join(self.found)) from self.cause
