"""Reading a study file: TOML into a document, or every mistake in it named in a sentence."""

import tomllib
from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, cast

from pydantic import ValidationError

from curricle.errors import ConfigError
from curricle.statistics.curves import SCRATCH
from curricle.study.config.document import Document, Running, Written
from curricle.study.config.graph import Graph, problems, table
from curricle.study.config.merging import Raw, assignment, complete, merged
from curricle.study.config.positions import Places, Problems, line_numbers
from curricle.study.config.study_file import StudyFile
from curricle.study.config.tables import Place, Table, unknown

ONLY_ARM = "transfer"
"""What the arm of a study without arms is called."""
TEXT = "utf-8-sig"
"""UTF-8, with or without a byte-order mark."""


def read_study(path: str | PathLike[str], *, set: Sequence[str] = ()) -> StudyFile:
    r"""Return the study that a TOML file describes.

    Nothing is built yet: tasks and curricula are when they are asked for.

    Parameters
    ----------
    path : path
    set : sequence of str
        Changes, such as ``"tasks.chase.budget=1000"``: keys as in the file with dots between them,
        values as in TOML (what is no TOML is text).

    Raises
    ------
    ConfigError
        Naming all that is wrong, a line each, with file, line, table and key.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "maze.toml"
    ...     _ = path.write_text('name = "maze"\ntasks.maze = { type = "maze", map = "S..T" }')
    ...     study = read_study(path, set=["seeds=2", "budget=1000"])
    >>> study.curriculum("transfer").train(study.document.seeds)["maze"].steps_used
    array([1000, 1000])
    """
    path = Path(path)
    try:
        text = path.read_text(encoding=TEXT)
        study = tomllib.loads(text)
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path} cannot be read: it is not UTF-8: {error}") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path} is not valid TOML: {error}") from None
    given = list[Place]()
    for change in set:
        keys, value = assignment(change)
        given.append(_existing(study, keys, str(path)))
        study = merged(study, value)
    places = Places(str(path), study, line_numbers(text), given)
    return StudyFile(resolved(study, path.parent, places), path.parent, places)


def resolved(study: Raw, folder: Path, places: Places) -> Document:
    """Return the document of a study as read; ConfigError where there is none."""
    arms = table(study.get("arms")) or {ONLY_ARM: {}}
    plans = {arm: complete(study, table(patch)) for arm, patch in arms.items()}
    running = {key: study[key] for key in Running.model_fields if key in study}
    _, wrong = _validated(Written, study, folder)
    document, more = _validated(Document, {**running, "arms": plans}, folder)
    wrong += _wrong_arms(study, plans)
    for place, text in more:
        in_arm = place[0] == "arms"
        wrong.append((places.written(str(place[1]), place[2:]) if in_arm else place, text))
    for arm, plan in plans.items():
        wrong += [(places.written(arm, place), text) for place, text in problems(plan)]
    wrong.sort(key=lambda one: places.line(one[0]))
    found = Problems()
    found.add(places.sentence(place, text) for place, text in wrong)
    found.tell()
    return cast(Document, document)


def _validated(
    model: type[Table], data: Raw, folder: Path
) -> tuple[Table | None, list[tuple[Place, str]]]:
    """Return data as a model, or what is wrong with it, each with its place."""
    try:
        return model.model_validate(data, context={"folder": folder}), []
    except ValidationError as error:
        return None, [(one["loc"], one["msg"]) for one in error.errors(include_url=False)]


def _wrong_arms(study: Raw, plans: dict[str, Raw]) -> Iterator[tuple[Place, str]]:
    """Yield what is wrong with arms, each with its place, before they are curricula."""
    tasks, transfers = table(study.get("tasks")), study.get("transfers")
    transfers = transfers if isinstance(transfers, list) else []
    targets: dict[str, str] = {}
    for arm, written in table(study.get("arms")).items():
        patch = table(written)
        if arm == SCRATCH:
            yield ("arms", arm), "must have another name: it is the arm without sources"
        strange = [name for name in table(patch.get("tasks")) if name not in tasks]
        yield from ((("arms", arm, "tasks", name), unknown(name, tasks)) for name in strange)
        numbers = list(_wrong_numbers(arm, patch.get("transfers"), len(transfers)))
        yield from numbers
        if patch and plans[arm] == complete(study) and not strange and not numbers:
            yield ("arms", arm), "changes nothing: what it says is so already, or a task's own"
        if len(last := Graph.of(plans[arm]).targets) == 1:
            targets[arm] = last[0]
    if len(set(targets.values())) > 1:
        words = ", ".join(f"{arm} has {target}" for arm, target in targets.items())
        yield ("arms",), f"must have one target to be compared in: {words}"


def _wrong_numbers(arm: str, chosen: Any, there: int) -> Iterator[tuple[Place, str]]:
    numbers = chosen if isinstance(chosen, list | dict) else []
    for index, one in enumerate(numbers):
        wanted = int(one) if isinstance(one, str) and one.isdecimal() else one
        if isinstance(one, dict) or (type(wanted) is int and 0 <= wanted < there):
            continue
        place: Place = ("arms", arm, "transfers", *([index] if isinstance(chosen, list) else []))
        yield place, f"must name transfers of the study by number, below {there}: got {one!r}"


def _existing(study: Raw, keys: tuple[str, ...], file: str) -> Place:
    """Return the place that is to be set; ConfigError for an unknown task, arm or transfer."""
    if len(keys) < 2 or keys[0] not in ("tasks", "arms", "transfers"):
        return keys
    there = study.get(keys[0])
    listed = keys[0] == "transfers"
    known = [str(n) for n in range(len(there))] if isinstance(there, list) else list(table(there))
    place = (keys[0], int(keys[1]) if listed and keys[1].isdecimal() else keys[1], *keys[2:])
    if keys[1] not in known:
        places = Places(file, {}, given=[place[:2]])
        raise ConfigError(places.sentence(place[:2], unknown(keys[1], known)))
    return place
