"""A study that has been run, read from its folder."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from curricle.checks import one_of
from curricle.comparison.arms import Arm
from curricle.comparison.comparing import check_comparable, default_threshold
from curricle.comparison.comparison import Comparison
from curricle.curriculum.curriculum import CurriculumResult
from curricle.errors import CurriculumError, StoreError
from curricle.files import write_whole
from curricle.learning.result import LearningResult, joined_results
from curricle.statistics.curves import SCRATCH
from curricle.study.config.study_file import StudyFile
from curricle.study.runner.arms import Arms
from curricle.study.runner.folder import (
    CURVES,
    DECISIONS,
    FILM,
    RUN,
    VALUES,
    Stored,
    StudyFolder,
    explained,
)
from curricle.study.runner.serialization import result_of
from curricle.study.runner.source_values import read_by, recalled
from curricle.study.runner.stored_sources import finished, stored_knowledge
from curricle.study.store import as_parquet
from curricle.transfer.observation_target import target_of

RESULTS, ALL_DECISIONS = "results.parquet", "decisions.parquet"


class Study:
    """The results in a study's folder, as far as they are there.

    Parameters
    ----------
    path : path

    Raises
    ------
    StoreError
        When the folder is none of a study, or a file in it is damaged.
    """

    def __init__(self, path: str | Path):
        self.folder = StudyFolder(path)
        given = self.folder.study
        self.file = StudyFile.rebuilt(given["configuration"], Path(given["folder"]))

    @cached_property
    def arms(self) -> Arms:
        """What the study trains."""
        return Arms.of(self.file)

    @cached_property
    def stored(self) -> dict[str, list[Stored]]:
        """The units that are there, by key."""
        found: dict[str, list[Stored]] = {}
        for stored in self.folder.units():
            found.setdefault(stored.key, []).append(stored)
        return found

    @cached_property
    def seeds(self) -> tuple[int, ...]:
        """The seeds for which every arm is complete."""
        wanted = set(self.file.document.seeds)
        for key in set(self.arms.keys.values()):
            wanted &= {seed for stored in self.stored.get(key, ()) for seed in stored.seeds}
        return tuple(sorted(wanted))

    def result(self, arm: str, node: str, *, values: bool = False) -> LearningResult:
        """Return what an arm learnt in one of its tasks.

        Parameters
        ----------
        arm, node : str
        values : bool
            Whether the values learnt are read too; they may be large. Networks are made anew, for
            which Stable-Baselines3 has to be installed.

        Raises
        ------
        StoreError
            When nothing of it is there yet, or a file is damaged.
        """
        units = self._units(arm, node)
        curriculum = self.arms.curricula[arm]
        if not units:
            raise StoreError(f"{self.folder.path} holds no result of {node!r} in arm {arm!r} yet")
        names = (RUN, FILM, *[VALUES] * values)
        found = joined_results(
            [
                result_of(
                    curriculum.node(node),
                    {k: v for name in names for k, v in self.folder.read(unit, name).items()},
                )
                for unit in units
            ]
        )
        if values and curriculum.node(node).deep:
            found = replace(found, values=self._networks(arm, node, found.seeds))
        return found

    def _networks(self, arm: str, node: str, seeds: tuple[int, ...]) -> Any:
        """Return what each seed's network values, with all that it learnt on."""
        curriculum, done = self.arms.curricula[arm], finished(self.folder.units())
        read = {node} | read_by(curriculum, node)
        known = {
            name: stored_knowledge(
                self.folder, done[self.arms.keys[arm, name]], seeds, read=name in read
            )
            for name in (*curriculum.ancestors(node), node)
        }
        return recalled(curriculum, seeds, known)[node].values

    def _units(self, arm: str, node: str) -> list[Stored]:
        """Return what is there of a task; StoreError if there is no such arm, or task in it."""
        one_of("an arm", arm, self.arms.curricula, StoreError)
        one_of(f"a task of arm {arm!r}", node, self.arms.curricula[arm].tasks, StoreError)
        return self.stored.get(self.arms.keys[arm, node], [])

    @cached_property
    def results(self) -> dict[str, CurriculumResult]:
        """Every arm as far as it is trained, without the values learnt."""
        found = {}
        for arm, curriculum in self.arms.curricula.items():
            nodes = {
                node: self.result(arm, node)
                for node in curriculum.order
                if self.arms.keys[arm, node] in self.stored
            }
            found[arm] = CurriculumResult(curriculum, nodes, {})
        return found

    @property
    def comparison(self) -> Comparison:
        """The arms compared with learning directly, over the seeds that all have finished.

        StoreError comes from a study without a direct learner, or without such a seed.
        """
        return compared([self])

    def source_steps(self, arm: str) -> npt.NDArray[np.int64]:
        """Return the steps each seed of an arm spent before its target, (K,), seeds rising."""
        units = self.stored[self.arms.keys[arm, self.arms.target]]
        runs = [self.folder.read(unit, RUN) for unit in units]
        seeds = np.concatenate([run["seeds"] for run in runs])
        steps: npt.NDArray[np.int64] = np.concatenate([run["source_steps"] for run in runs])
        return steps[np.argsort(seeds)]

    # -- tables --------------------------------------------------------------------------------

    def table(self, name: str) -> pa.Table:
        """Return ``curves.parquet`` or ``decisions.parquet`` of all units, with their arms."""
        one_of("a table of a study", name, (CURVES, DECISIONS), StoreError)
        tables = list(self._tables(name))
        if not tables:
            raise StoreError(f"{self.folder.path} holds no results yet")
        return pa.concat_tables(tables)

    def _tables(self, name: str) -> Iterator[pa.Table]:
        for arm, curriculum in self.arms.curricula.items():
            for node in curriculum.order:
                units = self.stored.get(self.arms.keys[arm, node], [])
                parts = [self.folder.table(unit, name) for unit in units]
                if parts:
                    whole = pa.concat_tables(parts)
                    whole = whole.sort_by([("seed", "ascending"), ("steps", "ascending")])
                    yield whole.add_column(0, "arm", pa.array([arm] * len(whole)))

    def write_tables(self) -> None:
        """Write ``results.parquet`` and ``decisions.parquet`` of all that is there."""
        if not self.stored:
            return
        for name, part in ((RESULTS, CURVES), (ALL_DECISIONS, DECISIONS)):
            with explained(self.folder.path):
                write_whole(self.folder.path / name, as_parquet(self.table(part)))

    def decisions(self, arm: str, node: str) -> dict[int, list[str]]:
        """Return why each seed of a task went on and ended, in words, by seed."""
        found: dict[int, list[str]] = {}
        for unit in self._units(arm, node):
            rows: list[Mapping[str, Any]] = self.folder.table(unit, DECISIONS).to_pylist()
            for row in rows:
                found.setdefault(row["seed"], []).append(row["words"])
        return dict(sorted(found.items()))


def compared(studies: Sequence[Study]) -> Comparison:
    """Return the arms of all studies against the first's direct learner.

    Seeds are those that every arm has finished. Where studies gave their arms different totals,
    all are compared at the smallest: what was learnt by then does not depend on what came after.

    Parameters
    ----------
    studies : sequence of Study
        Arms of several are named ``study: arm``.

    Raises
    ------
    StoreError
        When a study has no direct learner, or there is no seed that all have finished.
    CurriculumError
        When the targets are not one problem, learnt alike; the message names what differs.
    """
    for study in studies:
        if study.arms.total is None or SCRATCH not in study.arms.curricula:
            raise StoreError(
                "a comparison needs the target learnt directly, for a number of steps: "
                f"{study.folder.path} is a study without it"
            )
    first = studies[0]
    arms, several = first.arms, len(studies) > 1
    totals = [study.arms.total or 0 for study in studies]
    _check(studies, min(totals))
    seeds = sorted(set.intersection(*(set(study.seeds) for study in studies)))
    if not seeds:
        raise StoreError(
            "a comparison needs a seed that every arm has finished: "
            f"{' and '.join(str(study.folder.path) for study in studies)} have none yet"
        )
    found = {SCRATCH: _arm(first, SCRATCH, min(totals), seeds)}
    for study in studies:
        for name in study.arms.curricula:
            if name != SCRATCH:
                called = f"{study.file.document.name}: {name}" if several else name
                found[called] = _arm(study, name, min(totals), seeds)
    document = first.file.document
    threshold = document.threshold
    if threshold is None:
        node = arms.curricula[SCRATCH].node(arms.target)
        threshold = default_threshold(target_of(node.task, node.evaluation), found[SCRATCH])
    budget = min(study.arms.budget or 0 for study in studies)
    window = min(document.window, budget // arms.eval_freq + 1)
    return Comparison(arms.target, found, budget, min(totals), threshold, window)


def _check(studies: Sequence[Study], total: int) -> None:
    """Raise CurriculumError unless the targets are one problem, learnt and judged alike."""
    names = [study.file.document.name for study in studies]
    if len(set(names)) < len(names):
        raise CurriculumError(f"studies that are compared need different names: got {names}")
    first = {
        name: study.arms.curricula[SCRATCH].replace(study.arms.target, budget=total)
        for name, study in zip(names, studies, strict=True)
    }
    check_comparable(first)


def _arm(study: Study, name: str, total: int, seeds: Sequence[int]) -> Arm:
    result = study.results[name][study.arms.target]
    arm = Arm.of(result, study.source_steps(name), total, study.arms.eval_freq)
    return arm.take(np.flatnonzero(np.isin(result.seeds, seeds)))
