"""A study's plan, the units that are sent to workers, and the results that workers return."""

import json
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from importlib import metadata
from math import nan
from pathlib import Path
from typing import Any, NamedTuple, Self

from curricle.comparison.controls import is_shuffled
from curricle.comparison.opponents import CONSTANTS
from curricle.comparison.plan import (
    Dependencies,
    Plan,
    Trained,
    Unit as Unit,
    train,
)
from curricle.curriculum.curriculum import SETTINGS, Curriculum
from curricle.curriculum.result import SourceValues, source_values
from curricle.errors import ConfigError, ForeignError, SettingError
from curricle.files import short_digest
from curricle.learning.result import arrays_of
from curricle.learning.storage import Storage
from curricle.statistics.curves import SCRATCH
from curricle.study.config import StudyConfig
from curricle.study.store import DecisionRow, UnitContent, differences, shown
from curricle.study_file.own_code import code_of
from curricle.study_file.schema import NameGraph
from curricle.study_file.vary import target_alone, with_settings
from curricle.transfer.transfer import mappings_digest

# -- The dependencies of a unit's result, its key, and the reasons why a stored unit is stale ------

AUTO = "auto"  # the mapping of a transfer table for which a search finds the best
Stored = Mapping[str, Mapping[int, Any]]  # key -> seed -> StoredUnit; every key has a seed


def key_of(dependencies: Dependencies) -> str:
    """Return a short hash of dependencies: units with equal keys have equal results."""
    return short_digest(json.dumps(dependencies, sort_keys=True).encode())


def dependencies_of(
    arm: Mapping[str, Any], curriculum: Curriculum, total: int | None, folder: Path
) -> Iterator[tuple[str, str, Dependencies]]:
    """Yield each task of an arm with its key and its dependencies, sources first."""
    keys: dict[str, str] = {}
    graph, version = NameGraph.of(dict(arm)), metadata.version("curricle")
    for name in curriculum.order:
        task, *wholes = (arm["tasks"][drawing] for drawing in graph.drawings(name))
        into = [edge for edge in arm["transfers"] if edge["target"] == name]
        is_target = name == curriculum.target
        dependencies = {
            "curricle": version,
            "name": name,
            "task": task,
            "parts_of": [{k: v for k, v in of.items() if k not in SETTINGS} for of in wholes],
            "transfers": into,
            "sources": {edge["source"]: keys[edge["source"]] for edge in into},
            "total": total if is_target else None,
        }
        if not is_target:
            dependencies["source_budget"] = str(curriculum.setting("budget", name))
        # Digests of found mappings stand beside those of the user's modules, because another
        # version of the searches may find other mappings, also where candidates tie.
        searched = {
            f"the mapping found for {edge['source']} -> {name}": mappings_digest(
                t for t in curriculum.transfers if (t.source, t.target) == (edge["source"], name)
            )
            for edge in into
            if edge.get("mapping") == AUTO
        }
        dependencies["code"] = {**code_of(dependencies, folder), **searched}
        keys[name] = key_of(dependencies)
        yield name, keys[name], dependencies


def replaced_keys(wanted: Mapping[str, Dependencies], stored: Stored) -> dict[str, str]:
    """Return wanted key -> the stored key of the same task with the fewest changes."""
    pairs = [
        (len(list(changes_of(units, dependencies))), key, old)
        for key, dependencies in wanted.items()
        for old, units in stored.items()
        if key not in stored and old not in wanted and _of(units)["name"] == dependencies["name"]
    ]
    replaced: dict[str, str] = {}
    for _, key, old in sorted(pairs):
        if key not in replaced and old not in replaced.values():
            replaced[key] = old
    return replaced


def _of(units: Mapping[int, Any]) -> Dependencies:
    dependencies: Dependencies = next(iter(units.values())).about.dependencies
    return dependencies


def changes_of(units: Mapping[int, Any], wanted: Dependencies) -> Iterator[str]:
    """Yield a clause for each change from the dependencies of stored units to those `wanted`."""
    stored = _of(units)
    if stored["curricle"] != wanted["curricle"]:
        yield f"Curricle was {stored['curricle']} and is {wanted['curricle']}"
    old_code, code = stored["code"], wanted["code"]
    for file in sorted(file for file in {*old_code, *code} if old_code.get(file) != code.get(file)):
        fate = "changed" if file in old_code else "is used now"
        yield f"{file} {fate if file in code else 'is used no longer'}"
    for source in sorted({*stored["sources"], *wanted["sources"]}):
        if stored["sources"].get(source) != wanted["sources"].get(source):
            yield f"its source {source} changed"
    for name in ("task", "parts_of", "transfers", "total", "source_budget"):
        for place, (old, new) in differences(stored.get(name), wanted.get(name), name):
            yield f"{place.removeprefix('task.')} was {shown(old)} and is {shown(new)}"


# -- The plan of a study, and the units that are sent to workers -----------------------------------


class Arms(Plan):
    """The plan of a study; its keys are hashes of plain data."""

    @property
    def code(self) -> dict[str, str]:
        """The digests of the user's modules by file, and of the found mappings that arms use."""
        parts = [depends["code"] for depends in self.dependencies.values()]
        return {file: code[file] for code in parts for file in code}

    @classmethod
    def of(cls, study: StudyConfig) -> Self:
        """Return a study's arms, made once; an error says why they cannot be compared."""
        return study.once("arms", lambda: cls._of(study))

    @classmethod
    def _of(cls, study: StudyConfig) -> Self:
        scratches = study.scratch_curricula() if study.scratch else {}
        controls = study.controls or ()
        if controls and not (scratches and study.compared):
            setting = "compared" if scratches else "scratch"
            raise SettingError(
                f"controls need the comparison with scratch: leave out {setting} = false"
            )
        plain = study.data
        target = next(iter(study.curricula.values())).target
        data = {**scratch_data(plain, target), **plain["arms"]}

        def keys_of(
            name: str, curriculum: Curriculum, change: str
        ) -> tuple[dict[str, str], dict[str, Dependencies]]:
            total = curriculum.setting("budget", target)
            total = total if isinstance(total, int) else None
            keys, dependencies = dict[str, str](), dict[str, Dependencies]()
            parts = dependencies_of(data[name], curriculum, total, study.folder)
            shuffled = is_shuffled(change, curriculum)
            for task, key, depends in parts:
                if change and (shuffled or task == target):
                    depends = {**depends, "control": change}
                    if change in CONSTANTS:  # constants have their own shaping
                        depends["task"] = {
                            k: v for k, v in depends["task"].items() if k != "shaping"
                        }
                    key = key_of(depends)
                keys[task], dependencies[task] = key, depends
            return keys, dependencies

        how: Any = {"controls": controls, "opponents": study.played, "compared": study.compared}
        how["own_learners"] = study.own_learners
        return cls.made(study.curricula, scratches, keys_of, **how)


def units_of(
    study: StudyConfig,
    arms: Plan,
    done: Mapping[str, Collection[int]],
    shard: tuple[int, int] = (1, 1),
) -> list[Unit]:
    """Return the units of a shard (i, n) that are still to be trained, sources first."""
    first = min(study.seeds)  # of all shards, which together hold the snapshots of one run
    how: Any = {"seeds_per_unit": study.seeds_per_unit, "snapshots": study.snapshots}
    return arms.units(seeds_of(study, shard), done, first=first, **how)


def seeds_of(study: StudyConfig, shard: tuple[int, int]) -> list[int]:
    """Return the seeds of a shard (i, n): every n-th group of `seeds_per_unit` seeds."""
    part, parts = shard
    return [seed for seed in study.seeds if seed // study.seeds_per_unit % parts == part - 1]


def scratch_data(study: dict[str, Any], target: str) -> dict[str, Any]:
    """Return the arms that learn the target from scratch, as data."""
    scratches = study.get("scratches")
    if scratches is None:
        alone = target_alone(next(iter(study["arms"].values())))
        scratches = {SCRATCH: alone}
        for name, learner in study["scratch_learners"].items():
            scratches[f"{SCRATCH}, {name}"] = with_settings(alone, target, learner=learner)
    return {name: target_alone(arm) for name, arm in scratches.items()}


@lru_cache(maxsize=4)
def arms_from_json(config: str, folder: str, code: str) -> Arms:
    """Return the arms of the study in a JSON text; cached, because many units need them."""
    # Found mappings are not printed again: the process that began the run printed them.
    study = StudyConfig.from_data(json.loads(config), Path(folder), say=lambda _: None)
    arms = Arms.of(study)
    digests, expected = arms.code, json.loads(code)
    for file in sorted({*digests, *expected}):
        if digests.get(file) != expected.get(file):
            raise ConfigError(
                f"{file} must not change during a run: run the study again with --resume"
            )
    return arms


class UnitInput(NamedTuple):
    """Everything on which a unit depends, as plain data that can be sent to any machine."""

    config: str  # JSON of `StudyConfig.data`
    folder: str  # of the study's own modules
    code: str  # JSON of Arms.code, since modules must not change during a run
    unit: Unit
    sources: Mapping[str, SourceValues]  # without their tasks
    arms: Arms | None = None  # the plan itself, which only threads get
    files: Mapping[str, bytes] = {}  # the user's modules by path, for machines without `folder`
    versions: Mapping[str, str] = {}  # the run's versions, which every worker must have
    serial: bool = False  # whether a process must train one unit at a time


def train_unit(sent: UnitInput) -> UnitContent:
    """Train a unit and return its results."""
    arms = sent.arms or arms_from_json(sent.config, sent.folder, sent.code)
    unit = sent.unit
    arm = arms.arms[unit.arm]
    storage: Storage = arm.curriculum.setting("storage", unit.task)
    if storage.memory_limit is not None:
        # The memory limit is for one seed, so that results do not depend on the number of seeds
        # that are trained together.
        for_all = replace(storage, memory_limit=len(unit.seeds) * storage.limit)
        arm = replace(arm, curriculum=arm.curriculum.replace(unit.task, storage=for_all))
    sources = source_values(arm.curriculum, sent.sources)
    charge = arms.total is not None
    try:
        trained = train(arm, unit, sources, charge=charge, workers=1)
    except SystemExit as error:  # would end the run, with exit code 0, instead of this unit
        raise ForeignError(f"the study's own code called sys.exit({error.code})") from error
    arrays = arrays_of(trained.result)
    arrays["source_steps"] = trained.source_steps
    if trained.initial_values is not None:
        arrays["initial_values"] = trained.initial_values
    return UnitContent(arrays, _decisions(trained, arm.curriculum, unit))


def _decisions(trained: Trained, curriculum: Curriculum, unit: Unit) -> list[DecisionRow]:
    """Return a row for each decision of the stopping rule; without a rule a row for each seed."""
    result = trained.result
    rows = list[DecisionRow]()
    for k, decisions in enumerate(curriculum.node(unit.task).decisions(result)):
        place = unit.task, unit.seeds[k]
        for decision in decisions:
            kernel, why = decision.kernel, decision.criterion
            numbers = decision.lowest, kernel.level, decision.share, kernel.settled
            step, ended = decision.step, decision.ended
            rows.append(DecisionRow(*place, step, ended, why, *numbers, str(decision)))
        if not decisions:
            used = int(result.steps_used[k])
            why = str(result.ended_by[k])
            reason = f"ends; {why}: {used:,} steps, {int(result.episodes_used[k]):,} episodes"
            rows.append(DecisionRow(*place, used, True, why, nan, nan, nan, nan, reason))
    return rows
