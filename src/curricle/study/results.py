"""The results of a study, read from its folder."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from curricle.array_types import IntArray
from curricle.checks import one_of
from curricle.comparison.arms import Arm
from curricle.comparison.comparing import check_comparable, default_threshold
from curricle.comparison.comparison import Comparison
from curricle.curriculum.curriculum import CurriculumResult
from curricle.errors import CurriculumError, StoreError, StudyError
from curricle.learning.result import LearningResult, joined_results
from curricle.statistics.curves import SCRATCH
from curricle.study.arms import Arms
from curricle.study.config.study_config import StudyConfig
from curricle.study.failures import failed_arms, read_failures
from curricle.study.serialization import CURVES, DECISIONS, RUN, SNAPSHOTS, VALUES, result_of
from curricle.study.source_values import source_values, sources_read
from curricle.study.store import StoredUnit, StudyStore
from curricle.transfer.observation_rollouts import target_of

RESULTS, ALL_DECISIONS = "results.parquet", "decisions.parquet"


class StudyResults:
    """The results in a study's folder, also while the study is still running.

    Parameters
    ----------
    path : path

    Raises
    ------
    StoreError
        When the folder holds no study, or a file in it is damaged.

    Attributes
    ----------
    store : StudyStore
        The folder.
    config : StudyConfig
        The study.
    """

    def __init__(self, path: str | Path):
        self.store = StudyStore(path)
        study = self.store.description
        if "configuration" not in study:
            raise StoreError(f"{path} holds results that are not those of a study")
        self.config = StudyConfig.from_data(study["configuration"], Path(study["folder"]))

    @cached_property
    def arms(self) -> Arms:
        """The arms as they are trained."""
        return Arms.of(self.config)

    @cached_property
    def stored(self) -> dict[str, dict[int, StoredUnit]]:
        """The unit that holds each seed, by key and seed."""
        return self.store.finished()

    @cached_property
    def failed(self) -> dict[str, str]:
        """The error of each arm that failed in the last run and has not been trained since."""
        return failed_arms(read_failures(self.store), self.arms.keys, self.stored)

    @cached_property
    def seeds(self) -> tuple[int, ...]:
        """The seeds for which every arm that has not failed is complete."""
        keys = [key for (arm, _), key in self.arms.keys.items() if arm not in self.failed]
        each = [self.stored.get(key, {}) for key in keys]
        return tuple(sorted(set(self.config.seeds).intersection(*each)))

    def result(self, arm: str, task: str, *, values: bool = False) -> LearningResult:
        """Return the learning result of one task of an arm.

        Parameters
        ----------
        arm, task : str
        values : bool
            Whether to read the learnt values too, which may be large. Rebuilding networks needs
            Stable-Baselines3.

        Raises
        ------
        StoreError
            When there is no result yet, or a file is damaged.
        """
        units = self._units(arm, task)
        curriculum = self.arms.curricula[arm]
        if not units:
            raise StoreError(f"{self.store.path} holds no result of {task!r} in arm {arm!r} yet")
        node, names = curriculum.node(task), (RUN, SNAPSHOTS, *[VALUES] * values)
        found = joined_results([result_of(node, self.store.arrays(one, *names)) for one in units])
        if values and node.deep:
            found = replace(found, values=self._networks(arm, task, found.seeds))
        return found

    def _networks(self, arm: str, task: str, seeds: tuple[int, ...]) -> Any:
        """Return the values of each seed's network, with the potential that it learnt on."""
        curriculum = self.arms.curricula[arm]
        read = {task} | sources_read(curriculum, task)
        sources = {
            name: self.store.source_values(
                self.stored[self.arms.keys[arm, name]], seeds, read=name in read
            )
            for name in (*curriculum.ancestors(task), task)
        }
        return source_values(curriculum, seeds, sources)[task].values

    def _units(self, arm: str, task: str) -> list[StoredUnit]:
        """Return the units of a task; StoreError if there is no such arm, or task in it."""
        one_of("an arm", arm, self.arms.curricula, StoreError)
        one_of(f"a task of arm {arm!r}", task, self.arms.curricula[arm].tasks, StoreError)
        by_seed = self.stored.get(self.arms.keys[arm, task], {})
        return list(dict.fromkeys(by_seed.values()))

    @cached_property
    def results(self) -> dict[str, CurriculumResult]:
        """The curriculum result of each arm as far as it is trained, without values."""
        found = {}
        for arm, curriculum in self.arms.curricula.items():
            nodes = {
                task: self.result(arm, task)
                for task in curriculum.order
                if self.arms.keys[arm, task] in self.stored
            }
            found[arm] = CurriculumResult(curriculum, nodes, {})
        return found

    @property
    def comparison(self) -> Comparison:
        """The arms compared with learning from scratch, over the seeds that all have finished.

        Raises
        ------
        StoreError
            When the study has no scratch baseline, or no seed has finished in every arm.
        """
        return compare_studies([self])

    def source_steps(self, arm: str) -> IntArray:
        """Return the steps each seed of an arm spent before its target, (K,), seeds ascending."""
        runs = [self.store.arrays(unit, RUN) for unit in self._units(arm, self.arms.target)]
        seeds = np.concatenate([run["seeds"] for run in runs])
        steps: IntArray = np.concatenate([run["source_steps"] for run in runs])
        return steps[np.argsort(seeds)]

    # -- tables --------------------------------------------------------------------------------

    def table(self, name: str) -> pa.Table:
        """Return ``curves.parquet`` or ``decisions.parquet`` of all units, with their arms."""
        one_of("a table of a study", name, (CURVES, DECISIONS), StoreError)
        tables = []
        for arm, curriculum in self.arms.curricula.items():
            for task in curriculum.order:
                if parts := [self.store.table(unit, name) for unit in self._units(arm, task)]:
                    whole = pa.concat_tables(parts)
                    whole = whole.sort_by([("seed", "ascending"), ("steps", "ascending")])
                    tables.append(whole.add_column(0, "arm", pa.array([arm] * len(whole))))
        if not tables:
            raise StoreError(f"{self.store.path} holds no results yet")
        return pa.concat_tables(tables)

    def write_tables(self) -> None:
        """Write ``results.parquet`` and ``decisions.parquet`` of all units."""
        if self.stored:
            self.store.write_table(RESULTS, self.table(CURVES))
            self.store.write_table(ALL_DECISIONS, self.table(DECISIONS))

    def decisions(self, arm: str, task: str) -> dict[int, list[str]]:
        """Return the reason for each decision in a task, as sentences by seed."""
        return self._by_seed(arm, task, "reason")

    def ended_by(self, arm: str, task: str) -> dict[int, str]:
        """Return what ended the training of each seed in a task, in a few fixed words."""
        return {seed: each[-1] for seed, each in self._by_seed(arm, task, "criterion").items()}

    def _by_seed(self, arm: str, task: str, column: str) -> dict[int, list[str]]:
        """Return a column of the decisions in a task by seed."""
        found: dict[int, list[str]] = {}
        for unit in self._units(arm, task):
            rows: list[Mapping[str, Any]] = self.store.table(unit, DECISIONS).to_pylist()
            for row in rows:
                found.setdefault(row["seed"], []).append(row[column])
        return dict(sorted(found.items()))


def compare_studies(studies: Sequence[StudyResults]) -> Comparison:
    """Compare the arms of all studies with learning from scratch in the first.

    Seeds are those that every arm has finished; arms that failed are left out.
    Where studies gave their arms different totals,
    all are compared at the smallest: what was learnt by then does not depend on what came after.

    Parameters
    ----------
    studies : sequence of StudyResults
        Arms of several are named ``study: arm``.

    Raises
    ------
    StoreError
        When a study has no scratch baseline, or there is no seed that all have finished.
    CurriculumError
        When the targets differ as tasks or in how they are learnt; the message names what differs.
    """
    for study in studies:
        if study.arms.total is None or SCRATCH not in study.arms.curricula:
            raise StoreError(
                "a comparison needs the target learnt from scratch, for a number of steps: "
                f"{study.store.path} holds a study without it"
            )
        if SCRATCH in study.failed:
            raise StoreError(
                f"a comparison needs the target learnt from scratch, which failed in "
                f"{study.store.path}: {study.failed[SCRATCH]}"
            )
    first, arms, total = studies[0], studies[0].arms, min(one.arms.total or 0 for one in studies)
    _check(studies, total)
    seeds = sorted(set.intersection(*(set(study.seeds) for study in studies)))
    if not seeds:
        raise StoreError(
            "a comparison needs a seed that every arm has finished: "
            f"{' and '.join(str(study.store.path) for study in studies)} have none yet"
        )
    found = {SCRATCH: _arm(first, SCRATCH, total, seeds)}
    failed: dict[str, Exception] = {}
    for study in studies:
        for name in study.arms.curricula:
            label = f"{study.config.name}: {name}" if len(studies) > 1 else name
            if name in study.failed:
                failed[label] = StudyError(study.failed[name])
            elif name != SCRATCH:
                found[label] = _arm(study, name, total, seeds)
    threshold = first.config.threshold
    if threshold is None:
        node = arms.curricula[SCRATCH].node(arms.target)
        threshold = default_threshold(target_of(node.task, node.evaluation), found[SCRATCH])
    budget = min(study.arms.budget or 0 for study in studies)
    window = min(first.config.window, budget // arms.eval_freq + 1)
    return Comparison(arms.target, found, budget, total, threshold, window, failed)


def _check(studies: Sequence[StudyResults], total: int) -> None:
    """Raise CurriculumError unless the targets are one task, learnt and evaluated alike."""
    names = [study.config.name for study in studies]
    if len(set(names)) < len(names):
        raise CurriculumError(f"studies that are compared need different names: got {names}")
    first = {
        name: study.arms.curricula[SCRATCH].replace(study.arms.target, budget=total)
        for name, study in zip(names, studies, strict=True)
    }
    check_comparable(first)


def _arm(study: StudyResults, name: str, total: int, seeds: Sequence[int]) -> Arm:
    result = study.results[name][study.arms.target]
    arm = Arm.of(result, study.source_steps(name), total, study.arms.eval_freq)
    return arm.take(np.flatnonzero(np.isin(result.seeds, seeds)))
