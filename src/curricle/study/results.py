"""The results of a study, read from its folder."""

import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from curricle.arrays import FloatArray, IntArray
from curricle.checks import one_of
from curricle.comparison.comparison import Comparison
from curricle.comparison.measures import STATED, Arm
from curricle.comparison.plan import Failures, arms_of
from curricle.comparison.task_differences import summary_differences
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.result import SourceValues, source_values, sources_read
from curricle.deep.learning import policies_of
from curricle.errors import (
    CurricleError,
    CurriculumError,
    EngineError,
    StoreError,
    StudyError,
    in_words,
)
from curricle.files import Place
from curricle.learning.record import MAX_SNAPSHOT_BYTES
from curricle.learning.result import (
    LearningResult,
    check_result_arrays,
    curve_columns,
    joined_results,
)
from curricle.learning.stopping import UNLEARNT
from curricle.statistics.curves import SCRATCH
from curricle.study.record import (
    Analysis,
    FailureRecord,
    FailuresRecord,
    RunRecord,
    RunsRecord,
    StudyRecord,
    TaskRecord,
)
from curricle.study.store import (
    ANALYSIS,
    GROUPS,
    RUN,
    RUNS,
    SNAPSHOTS,
    STUDY,
    DecisionRow,
    Finished,
    StoredUnit,
    StudyStore,
    UnitContent,
)
from curricle.text import counted, shortened, visible

# -- Failed units: arms that need a failed unit are left out, the other arms are compared ----------

FAILURES = "failures.json"  # the failed units of the last run; no file if no unit failed


def failure_records(failures: Failures) -> tuple[FailureRecord, ...]:
    """Return the records of failed units; none if the executor failed, since no arm caused that."""
    errors = failures.errors if not failures.executor_failed else ()
    texts = ((unit, f"{unit.label}: {without_folders(in_words(error))}") for unit, error in errors)
    return tuple(FailureRecord(key=unit.key, seeds=unit.seeds, error=text) for unit, text in texts)


def failure_error(failures: Failures) -> StudyError:
    """Return an error that names all failures; its cause is the first error of foreign code."""
    (unit, first), *later = failures.errors
    text = f"{unit.label} failed, and all that is stored is whole: {in_words(first)}"
    for other, error in later:
        if not isinstance(error, EngineError):  # a lost cluster is reported once
            text += f"; {other.label} failed too: {in_words(error)}"
    errors = [error for _, error in failures.errors]
    lost = any(isinstance(error, EngineError) for error in errors)
    whole = EngineError(text) if lost else StudyError(text)
    foreign = (error for error in errors if not isinstance(error, CurricleError))
    whole.__cause__ = next(foreign, None)
    return whole


def without_folders(text: str) -> str:
    """Return an error's text without folders, which mean nothing on other machines."""
    quoted = re.sub(r"""(['"])(?:[A-Za-z]:)?[/\\][^'"\n]*[/\\]([^'"\n/\\]+)\1""", r"\1\2\1", text)
    return re.sub(r"(?<![\w.:/\\])(?:[A-Za-z]:)?[/\\](?:[^\s:'\"/\\]*[/\\]+)+", "", quoted)


def write_failures(store: StudyStore, failures: tuple[FailureRecord, ...]) -> None:
    """Replace the stored failures of the previous run by those of this run."""
    if failures:
        store.write_record(FAILURES, FailuresRecord(failures=failures))
    else:
        store.remove([store.path / FAILURES])


# -- Tables of many units, written in parts, because a whole table may not fit in memory -----------

ROWS = 2**17  # rows of a row group in a Parquet file


def apart(units: Iterable[StoredUnit]) -> Iterator[list[StoredUnit]]:
    """Yield lists of units in order: all seeds of a list precede the seeds of the next list."""
    group, highest = list[StoredUnit](), -1
    for unit in sorted(units, key=lambda unit: min(unit.seeds)):
        if group and min(unit.seeds) > highest:
            yield group
            group = []
        group.append(unit)
        highest = max(highest, *unit.seeds)
    if group:
        yield group


def decisions_table(rows: Sequence[DecisionRow]) -> pa.Table:
    """Return a unit's decisions as a table."""
    kinds = {int: pa.int64(), float: pa.float64(), bool: pa.bool_(), str: pa.string()}
    schema = pa.schema([(name, kinds[of]) for name, of in DecisionRow.__annotations__.items()])
    return pa.Table.from_arrays(
        [*map(pa.array, zip(*rows, strict=True), schema.types)], schema=schema
    )


def parquet_of(parts: Iterable[pa.Table]) -> bytes:
    """Return the tables joined in a Parquet file; its bytes do not depend on the division."""
    sink, writer, rest, rows = pa.BufferOutputStream(), None, list[pa.Table](), 0
    for part in parts:
        writer = writer or pq.ParquetWriter(sink, part.schema)
        rest.append(part)
        rows += len(part)
        if rows >= ROWS:
            whole = pa.concat_tables(rest).combine_chunks()
            full = len(whole) // ROWS * ROWS
            writer.write_table(whole[:full], row_group_size=ROWS)
            rest, rows = [whole[full:]], len(whole) - full
    assert writer is not None
    writer.write_table(pa.concat_tables(rest).combine_chunks())
    writer.close()
    return bytes(sink.getvalue().to_pybytes())


# -- The results of a study, read from its folder --------------------------------------------------

RESULTS, CURVES, DECISIONS = "results.parquet", "curves.parquet", "decisions.parquet"
MOST_CHECKPOINTS = 10_000_000  # most checkpoints of a curve in a comparison: 80 MB a seed
SPENT = ("source_steps", "steps_used")  # names of arrays of steps
HEADERS, FLOAT32 = 2**16, 4  # most bytes of headers; bytes of a number in a snapshot


class StudyResults:
    """The results in a study's folder, which may still be running.

    Only plain data are read: no module that the study names is imported, no task is made, and no
    pickle is loaded. So any machine can read a folder, and reading a stranger's folder is safe.
    StoreError when the folder holds no study, or a file in it is damaged.

    Attributes
    ----------
    store : StudyStore
        The folder.
    record : StudyRecord
        The study.
    """

    def __init__(self, path: str | Place | StudyStore, record: StudyRecord | None = None):
        self.store = path if isinstance(path, StudyStore) else StudyStore(path)
        study = self.store.description
        if "plan" not in study:
            raise StoreError(f"{self.store.path} holds results that are not those of a study")
        # Units, and groups of their arrays, that were found to be as they must.
        self._checked = set[tuple[StoredUnit, tuple[str, ...]]]()
        self.record = record or self.store.checked(
            STUDY, lambda: StudyRecord.of(study.get("configuration"), study["plan"])
        )

    def __repr__(self) -> str:
        arms, whole = counted(len(self.record.arms), "arm"), counted(len(self.record.seeds), "seed")
        so_far = f"{arms}, {len(self.seeds)} of {whole} complete"
        return shortened(f"StudyResults({self.record.name!r}, {so_far})")

    @property
    def is_part(self) -> bool:
        """Whether arms of the folder's study are left out, as they are not trained yet."""
        return len(self.record.arms) < len(self.store.description["plan"]["arms"])

    @cached_property
    def stored(self) -> Finished:
        """The unit that holds each seed, by key and seed."""
        return self.store.finished()

    @cached_property
    def failed(self) -> dict[str, str]:
        """Arm -> its error, for arms that failed in the last run and were not trained since."""
        needs = self.record.keys | {
            (name, f"/{arm.control_of}"): self.record.keys[arm.control_of, self.record.target]
            for name, arm in self.record.arms.items()
            if arm.control_of
        }
        errors = dict[str, str]()
        for failure in self.store.record(FAILURES, FailuresRecord).failures:
            if not set(failure.seeds) <= set(self.stored.get(failure.key, ())):
                for arm in sorted(arms_of(needs, [failure.key])):
                    errors.setdefault(arm, visible(failure.error))
        return errors

    @cached_property
    def seeds(self) -> tuple[int, ...]:
        """The seeds for which all arms without a failure are complete."""
        keys = [key for (arm, _), key in self.record.keys.items() if arm not in self.failed]
        stored = [self.stored.get(key, {}) for key in keys]
        return tuple(sorted(set(self.record.seeds).intersection(*stored)))

    def task(self, arm: str, task: str) -> TaskRecord:
        """Return the record of a task of an arm; StoreError if there is none."""
        one_of("an arm", arm, self.record.arms, StoreError)
        one_of(f"a task of arm {arm!r}", task, self.record.arms[arm].nodes, StoreError)
        return self.record.task(arm, task)

    def result(
        self, arm: str, task: str, *, values: bool = False, seeds: Collection[int] | None = None
    ) -> LearningResult:
        """Return the learning result of one task of an arm, without ``task`` and ``learner``.

        With `values` the learnt values are read too, which may be large. The values of a network
        are a dict of arrays for each seed, from which :meth:`trained` makes networks. The result
        holds `seeds` and all seeds in the same files. StoreError when there is no result yet.
        """
        if not (units := self._units(arm, task, seeds)):
            raise StoreError(f"{self.store.path} holds no result of {task!r} in arm {arm!r} yet")
        groups = GROUPS if values else ()
        contents = [self._content(arm, task, unit, *groups) for unit in units]
        return joined_results([LearningResult.of_arrays(content.arrays) for content in contents])

    def _content(self, arm: str, name: str, unit: StoredUnit, *groups: str) -> UnitContent:
        """Return the content of a unit of an arm, checked against the shapes in the record.

        By default it has snapshots if its task has a picture: a file is read once, whoever asks.
        """
        task = self.record.task(arm, name)
        groups = groups or (RUN, *[SNAPSHOTS] * (task.view is not None))
        content = self.store.content(unit, name, groups, self.most_bytes)
        if (unit, groups) not in self._checked:  # several arms may share it
            expected = content.arrays, unit.seeds, (task.states, task.actions), SPENT
            self.store.checked(unit.path, lambda: check_result_arrays(*expected))
            self._checked.add((unit, groups))
        return content

    @property
    def most_bytes(self) -> int:
        """An upper bound on the bytes of the snapshots of a task that has a picture."""
        # A damaged record may state any size, so the largest size that a run writes is a bound too.
        pairs = [task.states * task.actions for task in self.record.tasks if task.view is not None]
        stated = HEADERS + FLOAT32 * (self.record.snapshots + 2) * max(pairs, default=0)
        return min(stated, HEADERS + MAX_SNAPSHOT_BYTES)

    def trained(
        self, arm: str, curriculum: Curriculum, seeds: Sequence[int] | None = None
    ) -> dict[str, SourceValues]:
        """Return the values that an arm's sources learnt, as :meth:`Curriculum.train` takes them.

        The folder holds no curriculum: pass ``read_study(file).curriculum(arm)``. By default the
        seeds are those that all arms have finished. StoreError when a source lacks a seed.
        """
        seeds = self.seeds if seeds is None else tuple(seeds)
        return self._values(arm, curriculum, seeds, curriculum.ancestors(curriculum.target))

    def policies(
        self,
        arm: str,
        curriculum: Curriculum,
        seeds: Sequence[int] | None = None,
        *,
        task: str | None = None,
    ) -> tuple[Any, ...]:
        """Return the policy of each seed of a task of an arm, by default of its target.

        Policies are :class:`TabularPolicy`, or :class:`TrainedPolicy` for a network. Arguments and
        errors are as in :meth:`trained`; SettingError when the values were not saved.
        """
        seeds = self.seeds if seeds is None else tuple(seeds)
        name = curriculum.target if task is None else task
        if not curriculum.node(name).deep:
            self._units_of(arm, name, seeds)
            whole = replace(self.result(arm, name, values=True), task=curriculum.tasks[name])
            return tuple(whole.policies[whole.seeds.index(seed)] for seed in seeds)
        learnt = self._values(arm, curriculum, seeds, [*curriculum.ancestors(name), name])[name]
        learner = curriculum.setting("learner", name)
        return policies_of(learnt.task, learner, learnt.values, learnt.steps_used)

    def _values(
        self, arm: str, curriculum: Curriculum, seeds: tuple[int, ...], names: Sequence[str]
    ) -> dict[str, SourceValues]:
        """Return the values of seeds in some tasks of an arm; StoreError if a value is missing."""
        last, stored = names[-1] if names else curriculum.target, {}
        read = {*sources_read(curriculum, curriculum.target), *sources_read(curriculum, last), last}
        for name in names:
            units = self._units_of(arm, name, seeds)
            stored[name] = self.store.source_values(name, units, seeds, read=name in read)
        return source_values(curriculum, stored)

    def _units_of(self, arm: str, name: str, seeds: Sequence[int]) -> dict[int, StoredUnit]:
        """Return the unit of each seed; StoreError if a unit is missing."""
        units = {seed: unit for unit in self._units(arm, name) for seed in unit.seeds}
        for seed in seeds:
            if seed not in units:
                raise StoreError(
                    f"{self.store.path} holds no result of {name!r} in arm {arm!r} for seed "
                    f"{seed} yet"
                )
        return units

    def _units(self, arm: str, task: str, seeds: Collection[int] | None = None) -> list[StoredUnit]:
        """Return the units of a task."""
        self.task(arm, task)
        by_seed = self.stored.get(self.record.keys[arm, task], {}).items()
        return [*dict.fromkeys(unit for seed, unit in by_seed if seeds is None or seed in seeds)]

    @cached_property
    def results(self) -> dict[str, dict[str, LearningResult]]:
        """The learning results so far, without values: arm -> task -> result."""
        results: dict[str, dict[str, LearningResult]] = {arm: {} for arm in self.record.arms}
        for (arm, task), key in self.record.keys.items():
            if key in self.stored:
                results[arm][task] = self.result(arm, task)
        return results

    @property
    def has_baseline(self) -> bool:
        """Whether the study also learns the target from scratch, for as many steps."""
        return self.record.total is not None and SCRATCH in self.record.arms

    @cached_property
    def comparison(self) -> Comparison:
        """The comparison of the arms with learning from scratch (:func:`compare_studies`)."""
        return compare_studies([self])

    @property
    def analysis(self) -> Analysis | None:
        """Certificates and episodes; None before the run has ended."""
        analysis = self.store.record(ANALYSIS, Analysis)
        return analysis if analysis.of else None

    @cached_property
    def runs(self) -> tuple[RunRecord, ...]:
        """The records of all runs so far."""
        return self.store.record(RUNS, RunsRecord).runs

    @property
    def looks(self) -> tuple[int, ...]:
        """The numbers of seeds with which there were results when a run added further seeds."""
        return tuple(sorted({run.finished_before for run in self.runs} - {0}))

    def initial_values(self, arm: str) -> FloatArray | None:
        """Return the initial Q of each seed, (K,); None unless the arm is a constant."""
        return self._of_seeds(arm, self.record.target, "initial_values")

    def source_steps(self, arm: str, task: str | None = None) -> IntArray:
        """Return the steps that each seed of an arm spent before a task, by default its target."""
        steps = self._of_seeds(arm, task or self.record.target, "source_steps")
        assert steps is not None, "units without them are refused"
        return steps

    def _of_seeds(self, arm: str, task: str, name: str) -> npt.NDArray[Any] | None:
        """Return an array of a task besides its results, (K,), seeds ascending; None without it."""
        runs = [self._content(arm, task, unit).arrays for unit in self._units(arm, task)]
        if not runs:
            raise StoreError(f"{self.store.path} holds no result of {task!r} in arm {arm!r} yet")
        if not all(name in run for run in runs):
            return None
        seeds, numbers = (np.concatenate([run[key] for run in runs]) for key in ("seeds", name))
        return numbers[np.argsort(seeds)]

    def table(self, name: str) -> pa.Table:
        """Return the curves or the decisions of all units, `name` a file, with a column of arms."""
        one_of("a table of a study", name, (CURVES, DECISIONS), StoreError)
        if not (parts := [*self._parts(name)]):
            raise StoreError(f"{self.store.path} holds no results yet")
        return pa.concat_tables(parts)

    def _parts(self, name: str) -> Iterator[pa.Table]:
        """Yield a table in parts: by arm and task, then by seed and step."""
        for arm, task in self.record.keys:
            for units in apart(self._units(arm, task)):
                contents = [self._content(arm, task, unit, RUN) for unit in units]
                tables = [
                    pa.table(curve_columns(content.arrays, task))
                    if name == CURVES
                    else decisions_table(content.decisions)
                    for content in contents
                ]
                part = pa.concat_tables(tables)
                if len(units) > 1:
                    part = part.sort_by([("seed", "ascending"), ("steps", "ascending")])
                yield part.add_column(0, "arm", pa.array([arm] * len(part)))

    def write_tables(self) -> None:
        """Write ``results.parquet`` and ``decisions.parquet`` of all units, if there are any."""
        for file, name in (RESULTS, CURVES), (DECISIONS, DECISIONS):
            if any(key in self.stored for key in self.record.keys.values()):
                self.store.write(file, parquet_of(self._parts(name)))

    def decisions(self, arm: str, task: str, column: str = "reason") -> dict[int, list[str]]:
        """Return seed -> the reasons for the decisions in a task, as sentences."""
        values: dict[int, list[str]] = {}
        for unit in self._units(arm, task):
            for row in self._content(arm, task, unit).decisions:
                values.setdefault(row.seed, []).append(getattr(row, column))
        return dict(sorted(values.items()))

    def ended_by(self, arm: str, task: str) -> dict[int, str]:
        """Return seed -> the reason why its training in a task ended, one of a few fixed texts."""
        criteria = self.decisions(arm, task, "criterion")
        return {seed: of_seed[-1] for seed, of_seed in criteria.items()}


# -- The arms of one or several studies, compared --------------------------------------------------

SAME_TOTAL = "give their targets budgets with which the totals are equal"
"""The advice for studies that cannot be compared at the smallest total."""


def compare_studies(studies: Sequence[StudyResults]) -> Comparison:
    """Return the comparison of all studies' arms with learning from scratch in the first study.

    It has the seeds that all arms without a failure have finished. While seeds of the plan are
    missing there is no verdict and no p-value. Studies with different totals are compared at the
    smallest total, if learning up to it does not depend on the total.

    Arms of several studies are named ``study: arm``; studies of equal names by their folder.

    Raises
    ------
    StoreError
        When a study does not learn the target from scratch, or no seed is finished in all arms.
    CurriculumError
        When the targets differ as tasks or in their settings, when learning in an arm depended on a
        larger total, or when an arm's sources took more than the smallest total.
    """
    total = _shared_total(studies)
    first, paths = studies[0].record, [study.store.path for study in studies]
    seeds = sorted(set.intersection(*(set(study.seeds) for study in studies)))
    if not seeds:
        raise StoreError(
            "a comparison needs a seed that every arm has finished: there is none yet in "
            f"{' and '.join(map(str, paths))}"
        )
    names = [study.record.name for study in studies], [path.name for path in paths], paths
    differing = [texts for texts in names if len({*texts}) == len(texts)]
    if not differing:
        raise CurriculumError(
            f"studies that are compared need different folders: got {', '.join(map(str, paths))}"
        )
    prefixes = [f"{text}: " for text in differing[0]] if len(studies) > 1 else [""]
    arms = {SCRATCH: _arm(studies[0], SCRATCH, total, seeds)}
    failed: dict[str, Exception] = {}
    for study, prefix in zip(studies, prefixes, strict=True):
        for name, arm in study.record.arms.items():
            label = f"{prefix}{name}"
            if arm.control_of in study.failed:
                continue
            if name in study.failed:
                failed[label] = StudyError(study.failed[name])
            elif name != SCRATCH:
                of = arm.control_of and f"{prefix}{arm.control_of}"
                arms[label] = _arm(study, name, total, seeds, of)
    budget = min(study.record.budget or 0 for study in studies)
    planned = set.intersection(*(set(study.record.seeds) for study in studies))
    lacking, interim = any(study.is_part for study in studies), ""
    if lacking or len(seeds) < len(planned):
        some = " of some arms" * lacking
        interim = f"interim, {len(seeds)} of {len(planned)} seeds{some}: no verdict"
    window = min(first.window, budget // first.eval_freq + 1)
    reference = first.reference.after(arms[SCRATCH].curve)
    looks = tuple(sorted(set().union(*(study.looks for study in studies))))
    return Comparison(first.target, arms, budget, total, reference, window, failed, interim, looks)


def _shared_total(studies: Sequence[StudyResults]) -> int:
    """Return the total at which studies can be compared, or raise as `compare_studies` does."""
    for study in studies:
        if not study.has_baseline:
            raise StoreError(
                "a comparison needs the target learnt from scratch, at one total of steps: "
                f"{study.store.path} has scratch = false, compared = false or another budget"
            )
        if SCRATCH in study.failed:
            raise StoreError(
                f"a comparison needs the target learnt from scratch, which failed in "
                f"{study.store.path}: {study.failed[SCRATCH]}"
            )
        checkpoints = (study.record.total or 0) // study.record.eval_freq
        if checkpoints > MOST_CHECKPOINTS:
            raise StoreError(
                f"a comparison has at most {MOST_CHECKPOINTS:,} checkpoints: {study.store.path} "
                f"states {checkpoints:,}"
            )
        _check_shared_target(studies[0].record, study.record)
        if not study.record.problem.projections and _code(study) != _code(studies[0]):
            raise CurriculumError(
                "studies must share their target: without tables its code tells, which is not the "
                f"same in {studies[0].store.path} and {study.store.path}; run one of them again"
            )
    total = min(study.record.total or 0 for study in studies)
    for study in studies:
        for name, arm in study.record.arms.items():
            if arm.depends_on_total == "" or study.record.total == total or name in study.failed:
                continue
            why = arm.depends_on_total or "another version of Curricle did not note whether it does"
            raise CurriculumError(
                f"arms are compared at one total of steps where what they learn depends on it: arm "
                f"{name!r} of {study.store.path} had {study.record.total:,} steps and the smallest "
                f"total is {total:,} ({why}); {SAME_TOTAL}"
            )
    return total


def _code(study: StudyResults) -> object:
    """Return the digests of the user's code that learning the target from scratch ran."""
    key = study.record.keys[SCRATCH, study.record.target]
    units = (unit for unit in study.store.units() if unit.key == key)
    return next((unit.about.dependencies["code"] for unit in units), None)


def _check_shared_target(first: StudyRecord, other: StudyRecord) -> None:
    """Raise CurriculumError unless two targets are the same task with the same settings."""
    pair = f"{first.name!r} and {other.name!r}"
    if first.target != other.target:
        raise CurriculumError(
            f"studies must share their target: {pair} have {first.target!r} and {other.target!r}"
        )
    if different := summary_differences(first.problem, other.problem):
        raise CurriculumError(
            f"studies must share their target: those of {pair} differ in {'; '.join(different)}"
        )
    stated, also_stated = (
        record.reference.threshold if record.reference.threshold_from == STATED else None
        for record in (first, other)
    )
    if stated != also_stated:
        words = ["none stated" if value is None else value for value in (stated, also_stated)]
        raise CurriculumError(
            f"studies must share their target's threshold: {pair} have {words[0]} and "
            f"{words[1]}; state one in both files, and resume"
        )
    for which in ("evaluation", "learner", "eval_freq"):
        value, other_value = (
            record.arms[SCRATCH].nodes[record.target].settings.get(which)
            for record in (first, other)
        )
        if value != other_value:
            raise CurriculumError(
                f"studies must share their target's {which}: {pair} have {value} and {other_value}"
            )


def _arm(
    study: StudyResults, name: str, total: int, seeds: Sequence[int], curriculum: str = ""
) -> Arm:
    """Return an arm of a study for a comparison at a total of steps; it may change `curriculum`."""
    record = study.record
    result = study.results[name][record.target]
    spent = study.source_steps(name)
    place, most = f"arm {name!r} of {study.store.path}", int(spent.max())
    if most > (record.total or 0):
        raise StoreError(
            f"{place} must spend at most {record.total:,} steps on its sources: it states {most:,}"
        )
    if most > total:
        raise CurriculumError(
            f"an arm must have steps left for its target: {place} took {most:,} of its "
            f"{record.total:,} in its sources, and the smallest total is {total:,}; {SAME_TOTAL}"
        )
    arm = record.arms[name]
    return Arm.of(
        result,
        spent,
        (total, record.eval_freq),
        seeds,
        initial_values=study.initial_values(name),
        unlearnt={
            task: np.array([ended.get(seed) == UNLEARNT for seed in result.seeds])
            for task in arm.nodes
            if not curriculum and task != record.target and (ended := study.ended_by(name, task))
        },
        scratch=arm.scratch,
        curriculum=curriculum,
        knows_target=arm.knows_target,
        network=record.task(name, record.target).actions == 0,
    )
