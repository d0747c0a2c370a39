"""Reading a study file: its configuration, or a sentence for every mistake in it."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from curricle.checks import unfit_name
from curricle.errors import ConfigError
from curricle.statistics.curves import SCRATCH
from curricle.study.config.merging import (
    Positions,
    Problems,
    Raw,
    assignment,
    complete_curriculum,
    complete_learners,
    line_numbers,
    merged,
)
from curricle.study.config.study_config import FileTable, RunTable, StudyConfig
from curricle.study.config.sweeps import varied_arms, wrong_made, wrong_sweep, wrong_tuning
from curricle.study.config.tables import (
    KeyPath,
    NameGraph,
    parsed,
    shown,
    table,
    text_of,
    unknown,
    wrong_names,
)
from curricle.study.config.tasks import FamilyTable

ONLY_ARM = "transfer"
"""The name of the arm of a study without arms."""


def read_study(path: str | PathLike[str], *, set: Sequence[str] = ()) -> StudyConfig:
    r"""Return the study that a TOML file describes.

    Nothing is built yet: tasks and curricula are built when they are asked for.

    Parameters
    ----------
    path : path
    set : sequence of str
        Changes, such as ``"tasks.chase.budget=1000"``: keys as in the file with dots between them,
        values as in TOML, or else text.

    Raises
    ------
    ConfigError
        With a line for each mistake: file, line, key path and what is wrong.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "maze.toml"
    ...     _ = path.write_text('name = "maze"\ntasks.maze = { type = "maze", map = "S..T" }')
    ...     study = read_study(path, set=["seeds=2", "budget=1000"])
    >>> study.curriculum("transfer").train(study.seeds)["maze"].steps_used
    array([1000, 1000])
    """
    if not isinstance(path, str | PathLike):
        raise ConfigError(f"a study file must be a path: got {path!r}")
    if isinstance(set, str):
        raise ConfigError(f"set must be a list of settings, each key=value: got {set!r}")
    path = Path(path)
    text, study = toml_of(path)
    given = list[KeyPath]()
    for change in set:
        keys, value = assignment(change)
        given.append(_existing(study, keys, str(path)))
        study = merged(study, value)
    positions = Positions(str(path), study, line_numbers(text), given)
    return configured(study, path.parent, positions)


def toml_of(path: Path) -> tuple[str, dict[str, Any]]:
    """Return a file's text and what it says; ConfigError where it cannot be read as TOML."""
    if path.is_dir():
        from curricle.study.store import holds_study  # with pyarrow, which a file does not need

        if holds_study(path):
            raise ConfigError(f"{path} is a folder of results, which StudyResults(FOLDER) reads")
    try:
        text = text_of(path)
    except ValueError as error:
        raise ConfigError(f"{path} cannot be read: {error}") from None
    try:
        return text, parsed(text)
    except ValueError as error:
        raise ConfigError(f"{path} is not valid TOML: {error}") from None


def configured(study: Raw, folder: Path, positions: Positions) -> StudyConfig:
    """Return the configuration of a study as read; ConfigError with all that is wrong in it."""
    found = Problems(positions)
    found.add(_wrong_families(study))
    found.raise_any()
    arms = table(study.get("arms")) or {ONLY_ARM: {}}
    complete = {arm: complete_curriculum(study, table(patch)) for arm, patch in arms.items()}
    running = {key: study[key] for key in RunTable.model_fields if key in study}
    if "scratch_learners" in running:
        running["scratch_learners"] = complete_learners(study, next(iter(complete.values())))
    wrong: list[tuple[KeyPath, str]] = []
    with _collected(wrong):
        FileTable.model_validate(study, context={"folder": folder})
    wrong += [*_wrong_arms(study, complete), *_wrong_learners(study)]
    in_arms: list[tuple[KeyPath, str]] = []
    for arm, curriculum in complete.items():
        in_arms += [(("arms", arm, *path), text) for path, text in wrong_names(curriculum)]
    varied = [*wrong_sweep(study, complete), *wrong_tuning(study, complete)]
    fields: dict[str, Any] = {"arms": complete}
    if {"sweep", "tune"} & study.keys() and not (wrong or varied or in_arms):
        made = varied_arms(study, complete)
        fields, positions = made.fields, replace(positions, varied=made.homes)
        varied += wrong_made(fields["arms"])
        with _collected(in_arms):
            if made.probes:
                StudyConfig.from_data({**running, "arms": made.probes}, folder, positions)
    config: StudyConfig | None = None
    with _collected(in_arms):
        config = StudyConfig.from_data({**running, **fields}, folder, positions)
    for path, text in in_arms:
        inside = path[0] in ("arms", "scratches")
        wrong.append((positions.in_file(str(path[1]), path[2:]) if inside else path, text))
    found.positions = positions
    found.add([*wrong, *varied])
    found.raise_any()
    return config


def _wrong_families(study: Raw) -> list[tuple[KeyPath, str]]:
    """Return what is wrong with a study's families, on which its tasks depend."""
    wrong: list[tuple[KeyPath, str]] = []
    for name, family in table(study.get("families")).items():
        found: list[tuple[KeyPath, str]] = []
        if ":" in name:
            found.append(((), "must have a name without a colon, which functions have"))
        with _collected(found):
            FamilyTable.model_validate(family)
        wrong += [(("families", name, *path), text) for path, text in found]
    return wrong


@contextmanager
def _collected(wrong: list[tuple[KeyPath, str]]) -> Iterator[None]:
    """Add what Pydantic finds wrong in this context to a list, each with its key path."""
    try:
        yield
    except ValidationError as error:
        wrong += [(one["loc"], one["msg"]) for one in error.errors(include_url=False)]


def _wrong_arms(study: Raw, complete: dict[str, Raw]) -> Iterator[tuple[KeyPath, str]]:
    """Yield what is wrong with arms as they are written, each with its key path."""
    tasks, transfers = table(study.get("tasks")), study.get("transfers")
    transfers = transfers if isinstance(transfers, list) else []
    targets: dict[str, str] = {}
    for arm, written in table(study.get("arms")).items():
        patch = table(written)
        if why := unfit_name(arm):
            yield ("arms", arm), f"has a name that {why}"
        if arm == SCRATCH:
            yield ("arms", arm), "must have another name: it is the arm without sources"
        strange = [name for name in table(patch.get("tasks")) if name not in tasks]
        yield from ((("arms", arm, "tasks", name), unknown(name, tasks)) for name in strange)
        numbers = list(_wrong_numbers(arm, patch.get("transfers"), len(transfers)))
        yield from numbers
        if patch and complete[arm] == complete_curriculum(study) and not strange and not numbers:
            yield (
                ("arms", arm),
                "changes nothing: its settings are the study's, or a task has its own",
            )
        if len(last := NameGraph.of(complete[arm]).targets) == 1:
            targets[arm] = last[0]
    if len(set(targets.values())) > 1:
        each = ", ".join(f"{arm} has {target}" for arm, target in targets.items())
        yield ("arms",), f"must all have the same target: {each}"


def _wrong_learners(study: Raw) -> Iterator[tuple[KeyPath, str]]:
    """Yield what is wrong with the names of further learners from scratch."""
    given, arms = table(study.get("scratch_learners")), table(study.get("arms"))
    if given and study.get("scratch") is False:
        yield ("scratch_learners",), "are compared with the target's own: leave out scratch = false"
    for name in given:
        if why := unfit_name(name):
            yield ("scratch_learners", name), f"has a name that {why}"
        if f"{SCRATCH}, {name}" in arms:
            yield ("arms", f"{SCRATCH}, {name}"), "must have another name: a learner has it"


def _wrong_numbers(arm: str, chosen: Any, there: int) -> Iterator[tuple[KeyPath, str]]:
    numbers = chosen if isinstance(chosen, list | dict) else []
    for index, one in enumerate(numbers):
        wanted = int(one) if isinstance(one, str) and one.isdecimal() else one
        if isinstance(one, dict) or (type(wanted) is int and 0 <= wanted < there):
            continue
        path: KeyPath = ("arms", arm, "transfers", *([index] if isinstance(chosen, list) else []))
        yield path, f"must name transfers of the study by number, below {there}: got {shown(one)}"


def _existing(study: Raw, keys: tuple[str, ...], file: str) -> KeyPath:
    """Return the key path that is to be set; ConfigError for an unknown task, arm or transfer."""
    if len(keys) < 2 or keys[0] not in ("tasks", "arms", "transfers"):
        return keys
    there = study.get(keys[0])
    listed = keys[0] == "transfers"
    known = [str(n) for n in range(len(there))] if isinstance(there, list) else list(table(there))
    path = (keys[0], int(keys[1]) if listed and keys[1].isdecimal() else keys[1], *keys[2:])
    if keys[1] not in known:
        positions = Positions(file, {}, given=[path[:2]])
        raise ConfigError(positions.sentence(path[:2], unknown(keys[1], known)))
    return path
