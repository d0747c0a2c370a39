"""A unit of work, one task of one arm for some seeds: a pure function of the study."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.curriculum.curriculum import Curriculum, CurriculumResult
from curricle.learning.storage import Storage
from curricle.study.runner.arms import Arms, rebuilt
from curricle.study.runner.serialization import arrays_of
from curricle.study.runner.source_values import Knowledge, recalled


@dataclass(frozen=True)
class Unit:
    """What is trained at once.

    Attributes
    ----------
    key : str
        What the result depends on but the seeds (:class:`Arms`).
    arm, node : str
        The first arm that needs it, and its task.
    seeds : tuple of int
        Rising.
    sources : dict of str to str
        The tasks that must have been trained for these seeds before, with their keys.
    frames : int
        Tables of the first seed that are kept on the way.

    Examples
    --------
    >>> Unit("0f", "scratch", "maze", (0, 1, 4), {}, 0).words
    'scratch: maze, seeds 0-1+4'
    """

    key: str
    arm: str
    node: str
    seeds: tuple[int, ...]
    sources: Mapping[str, str] = field(hash=False)
    snapshots: int

    @property
    def words(self) -> str:
        """The unit for people."""
        return f"{self.arm}: {self.node}, seeds {seed_words(self.seeds)}"


def seed_words(seeds: Iterable[int]) -> str:
    """Return seeds as runs of numbers.

    Examples
    --------
    >>> seed_words([0, 1, 2, 7, 9, 10])
    '0-2+7+9-10'
    """
    runs: list[list[int]] = []
    for seed in seeds:
        if runs and seed == runs[-1][1] + 1:
            runs[-1][1] = seed
        else:
            runs.append([seed, seed])
    return "+".join(f"{a}" if a == b else f"{a}-{b}" for a, b in runs)


def units_of(
    arms: Arms,
    seeds: Iterable[int],
    seeds_per_unit: int,
    done: Mapping[str, Collection[int]],
    snapshots: int = 0,
) -> list[Unit]:
    """Return what is left to do, sources first.

    Parameters
    ----------
    arms : Arms
    seeds : iterable of int
    block : int
        Seeds of a unit at most; seed s belongs to block s // block.
    done : dict of str to collection of int
        Key -> the seeds that are trained.
    frames : int
        Tables of the first seed to keep on the way, in each task.
    """
    seeds = sorted(seeds)
    found: dict[tuple[str, tuple[int, ...]], Unit] = {}
    for arm, curriculum in arms.curricula.items():
        for node in curriculum.order:
            key = arms.keys[arm, node]
            blocks: dict[int, list[int]] = {}
            for seed in seeds:
                if seed not in done.get(key, ()):
                    blocks.setdefault(seed // seeds_per_unit, []).append(seed)
            sources = {name: arms.keys[arm, name] for name in curriculum.ancestors(node)}
            for members in blocks.values():
                shown = snapshots if members[0] == seeds[0] else 0
                unit = Unit(key, arm, node, tuple(members), sources, shown)
                found.setdefault((key, unit.seeds), unit)
    return list(found.values())


class Work(NamedTuple):
    """All that a unit depends on, as plain data: it can be sent to any machine."""

    study: str
    """JSON, as ``StudyFile.resolved`` says it."""
    folder: str
    """Of the study's own modules."""
    unit: Unit
    sources: Mapping[str, Knowledge]
    saves: str | None = None
    """A folder for checkpoints, from which a unit that was killed goes on, to the same result."""


class Trained(NamedTuple):
    """What a unit leaves."""

    arrays: dict[str, npt.NDArray[Any]]
    """The :class:`LearningResult`, array by array (:func:`arrays_of`)."""
    decisions: list[dict[str, Any]]
    """Why each seed went on and ended, a row a checkpoint."""
    calibrations: list[dict[str, Any]]
    """What was fitted for each seed; empty unless transfers are calibrated."""


def train_unit(work: Work) -> Trained:
    """Return what a unit's seeds learn; depends on nothing but `work`, and not on its `saves`."""
    arms = rebuilt(work.study, work.folder)
    unit = work.unit
    curriculum = _with_room(arms.curricula[unit.arm], unit)
    found = curriculum.train(
        unit.seeds,
        only=unit.node,
        trained=recalled(curriculum, unit.seeds, work.sources),
        charge=arms.total is not None,
        snapshots=unit.snapshots,
        workers=1,
        saves=work.saves,
    )
    course = found.retrained.get(unit.node)
    returned = np.zeros(len(unit.seeds), np.int64) if course is None else course.extra
    return Trained(
        arrays_of(found[unit.node], found.source_steps(unit.node), returned),
        _decisions(found, unit),
        [
            {"scale": one.scale, "shift": one.shift, "refusal": one.refusal}
            for one in found.calibrations.get(unit.node, ())
        ],
    )


def _with_room(curriculum: Curriculum, unit: Unit) -> Curriculum:
    """Return the curriculum with room for each of a unit's seeds, as a study's limit is a seed's.

    So that what is learnt does not depend on how many seeds are trained together.
    """
    storage: Storage = curriculum.setting("storage", unit.node)
    if storage.memory_limit is None:
        return curriculum
    room = replace(storage, memory_limit=len(unit.seeds) * storage.limit)
    return curriculum.replace(unit.node, storage=room)


def _decisions(found: CurriculumResult, unit: Unit) -> list[dict[str, Any]]:
    """Return a row for each decision of the node's gate, or one for the end of each seed."""
    result = found[unit.node]
    rows = list[dict[str, Any]]()
    for k, decisions in enumerate(found.decisions(unit.node)):
        place = {"node": unit.node, "seed": unit.seeds[k]}
        rows += [
            {
                **place,
                "steps": one.step,
                "ends": one.spent or one.ends,
                "lowest": one.lowest,
                "level": one.kernel.level,
                "rise": one.rise,
                "plateau": one.kernel.plateau,
                "words": str(one),
            }
            for one in decisions
        ]
        if not decisions:
            used, nan = int(result.steps_used[k]), float("nan")
            why = "memory is full" if result.out_of_memory[k] else "its budget is spent"
            words = f"ends; {why}: {used:,} steps, {int(result.episodes_used[k]):,} episodes"
            numbers = dict.fromkeys(("lowest", "level", "rise", "plateau"), nan)
            rows.append({**place, "steps": used, "ends": True, **numbers, "words": words})
    return rows
