"""Units of work: one task of one arm for some seeds, a pure function of the study."""

import json
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.result import CurriculumResult, StoredValues, source_values
from curricle.files import Place
from curricle.learning.saved_result import arrays_of
from curricle.learning.stopping import ended_by
from curricle.learning.storage import Storage
from curricle.study.arms import Arms, arms_from_json
from curricle.study.config import StudyConfig
from curricle.study.dependencies import Dependencies
from curricle.study.schema import seeds_in_ranges
from curricle.study.serialization import DECISION_SCHEMA, UnitResult
from curricle.text import brief_repr


@dataclass(frozen=True)
class Unit:
    """One task of one arm, trained for some seeds at once.

    Attributes
    ----------
    key : str
        A hash of all that the result depends on, except the seeds (:class:`Arms`).
    arm, task : str
        The first arm that needs it, and its task.
    seeds : tuple of int
        Ascending.
    sources : dict of str to str
        The tasks that must have been trained for these seeds before, with their keys.
    dependencies : dict
        What the key is a hash of, as plain data.
    snapshots : int
        Value tables of the first seed that are kept during training.

    Examples
    --------
    >>> Unit("0f", "scratch", "maze", (0, 1, 4), {}, {}, 0).label
    'scratch: maze, seeds 0-1+4'
    """

    key: str
    arm: str
    task: str
    seeds: tuple[int, ...]
    sources: Mapping[str, str] = field(hash=False)
    dependencies: Dependencies = field(hash=False, repr=False)
    snapshots: int

    __repr__ = brief_repr

    @property
    def label(self) -> str:
        """Arm, task and seeds, for messages."""
        return f"{self.arm}: {self.task}, {numbered_seeds(self.seeds)}"


def numbered_seeds(seeds: Collection[int]) -> str:
    """Return seeds with their numbers, in the singular for one."""
    return f"seed{'s' * (len(seeds) != 1)} {seed_ranges(seeds)}"


def seed_ranges(seeds: Iterable[int]) -> str:
    """Return seeds as ranges of numbers, such as ``0-2+7``."""
    runs: list[list[int]] = []
    for seed in seeds:
        if runs and seed == runs[-1][1] + 1:
            runs[-1][1] = seed
        else:
            runs.append([seed, seed])
    return "+".join(f"{a}" if a == b else f"{a}-{b}" for a, b in runs)


def seeds_in(ranges: str) -> tuple[int, ...] | None:
    """Return the seeds of :func:`seed_ranges`; None if a text is none, or of too many."""
    return tuple(seeds_in_ranges(ranges.replace("+", ","))) or None


def units_of(
    study: StudyConfig,
    arms: Arms,
    done: Mapping[str, Collection[int]],
    shard: tuple[int, int] = (1, 1),
) -> list[Unit]:
    """Return the units of a shard (i, n) that are still to be trained, sources first.

    `done` has the seeds that are trained by key.
    """
    seeds = seeds_of(study, shard)
    first = min(study.seeds)  # of all shards: merged, they hold the snapshots of one run
    found: dict[tuple[str, tuple[int, ...]], Unit] = {}
    for arm, curriculum in arms.curricula.items():
        for task in curriculum.order:
            key = arms.keys[arm, task]
            groups: dict[int, list[int]] = {}
            for seed in sorted(set(seeds).difference(done.get(key, ()))):
                groups.setdefault(seed // study.seeds_per_unit, []).append(seed)
            sources = {name: arms.keys[arm, name] for name in curriculum.ancestors(task)}
            for members in groups.values():
                snapshots = study.snapshots if members[0] == first else 0
                depends = arms.dependencies[arm, task]
                unit = Unit(key, arm, task, tuple(members), sources, depends, snapshots)
                found.setdefault((key, unit.seeds), unit)
    return list(found.values())


def seeds_of(study: StudyConfig, shard: tuple[int, int]) -> list[int]:
    """Return the seeds of a shard (i, n), those of every n-th group of `seeds_per_unit`.

    Seed s belongs to group number s // seeds_per_unit.
    """
    part, parts = shard
    return [seed for seed in study.seeds if seed // study.seeds_per_unit % parts == part - 1]


class UnitInput(NamedTuple):
    """All that a unit depends on, as plain data: it can be sent to any machine."""

    config: str
    """JSON of :meth:`StudyConfig.to_data`."""
    folder: str
    """Of the study's own modules."""
    code: str
    """JSON of ``Arms.code``: the modules must be as they were when the run began."""
    unit: Unit
    sources: Mapping[str, StoredValues]
    checkpoints: Place | None = None
    """Where checkpoints are, from which a killed unit goes on, to the same result."""


def given_to_all(study: StudyConfig, arms: Arms) -> tuple[str, str, str]:
    """Return the first fields of :class:`UnitInput`, the same for all units of a study."""
    return json.dumps(study.to_data()), str(study.folder.resolve()), json.dumps(arms.code)


def train_unit(given: UnitInput) -> UnitResult:
    """Return what a unit's seeds learn; it depends on `given` only, not on its `checkpoints`."""
    arms = arms_from_json(given.config, given.folder, given.code)
    unit = given.unit
    curriculum = _with_memory_for_all(arms.curricula[unit.arm], unit)
    found = curriculum.train(
        unit.seeds,
        only=unit.task,
        trained=source_values(curriculum, unit.seeds, given.sources),
        charge=arms.total is not None,
        snapshots=unit.snapshots,
        workers=1,
        saves=given.checkpoints,
    )
    result = found[unit.task]
    arrays = arrays_of(result)
    arrays["source_steps"] = found.source_steps(unit.task)
    if fitted := found.calibrations.get(unit.task):
        parts = ("scale", "refusal")
        arrays |= {part: np.array([getattr(one, part) for one in fitted]) for part in parts}
    decisions = pa.Table.from_pylist(_decisions(found, unit), pa.schema(DECISION_SCHEMA.items()))
    return UnitResult(arrays, decisions)


def _with_memory_for_all(curriculum: Curriculum, unit: Unit) -> Curriculum:
    """Return the curriculum with memory for all seeds of a unit: a study's limit is for one seed.

    So what is learnt does not depend on how many seeds are trained together.
    """
    storage: Storage = curriculum.setting("storage", unit.task)
    if storage.memory_limit is None:
        return curriculum
    for_all = replace(storage, memory_limit=len(unit.seeds) * storage.limit)
    return curriculum.replace(unit.task, storage=for_all)


def _decisions(found: CurriculumResult, unit: Unit) -> list[dict[str, Any]]:
    """Return a row for each decision of the stopping rule, or one for the end of each seed."""
    result, budget = found[unit.task], found.curriculum.setting("budget", unit.task)
    rows = list[dict[str, Any]]()
    for k, decisions in enumerate(found.decisions(unit.task)):
        row = {"task": unit.task, "seed": unit.seeds[k]}
        rows += [
            {
                **row,
                "steps": one.step,
                "ends": one.spent or one.ends,
                "criterion": one.criterion,
                "lowest": one.lowest,
                "level": one.kernel.level,
                "rise": one.rise,
                "plateau": one.kernel.plateau,
                "reason": str(one),
            }
            for one in decisions
        ]
        if not decisions:
            used, nan = int(result.steps_used[k]), float("nan")
            why = ended_by(budget, bool(result.out_of_memory[k]))
            reason = f"ends; {why}: {used:,} steps, {int(result.episodes_used[k]):,} episodes"
            numbers = dict.fromkeys(("lowest", "level", "rise", "plateau"), nan)
            rows.append(
                {**row, "steps": used, "ends": True, "criterion": why, **numbers, "reason": reason}
            )
    return rows
