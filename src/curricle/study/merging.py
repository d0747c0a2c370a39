"""Merging the parts of a study that were run in several folders."""

from collections.abc import Sequence
from itertools import chain

from curricle.checks import BEYOND_64_BITS
from curricle.errors import StoreError
from curricle.files import Place
from curricle.study.packing import files_of, pack
from curricle.study.results import ANALYSIS, StudyResults
from curricle.study.running import Done
from curricle.study.serialization import SNAPSHOTS, group_of
from curricle.study.store import StoredUnit, StudyStore, read_failures, write_failures
from curricle.study.tuning import TUNING, read_tuning


def merge(path: str | Place, parts: Sequence[str | Place]) -> StudyResults:
    """Merge the parts of a study, run in several folders, into one folder; return its results.

    The parts do not change. A unit that several have is taken once, since equal units have equal
    results.

    Parameters
    ----------
    path : path
        Made if need be; or a folder of the same study, whose units stay.
    parts : sequence of path

    Raises
    ------
    StoreError
        When folders hold different studies, or one is damaged or in use; what was merged before is
        whole then.
    """
    if isinstance(parts, str | Place):
        raise StoreError(f"folders to merge must be a list: got {str(parts)!r} alone")
    if not parts:
        raise StoreError("there must be at least one folder to merge: got none")
    studies = [StudyResults(part) for part in parts]
    stores = [study.store for study in studies]
    found = [store.units() for store in stores]
    for study, units in zip(studies, found, strict=True):
        stores[0].check(study.store.description)
        if study.record.keys != studies[0].record.keys:
            raise StoreError(
                f"{study.store.path} holds units of other code, kept with --keep-stale: parts that "
                "are merged must be of the same"
            )
        for unit in units:  # damage is found before anything is written
            study.store.result(unit, unit.seeds, study.most_bytes)
    # That of the first seeds, which a part has finished, is that of all.
    by_seed = sorted(studies, key=lambda study: min(study.seeds, default=BEYOND_64_BITS))
    analysis = next((one.analysis for one in by_seed if one.analysis), None)
    with StudyStore.opened(path, stores[0].description, resume=True) as target:
        failures, before = read_failures(target), target.runs()
        done = target.finished()
        stored = [*done.values(), *(unit.seeds for units in found for unit in units)]
        first = min(chain.from_iterable(stored), default=0)
        for store, units in zip(stores, found, strict=True):
            target = target.redescribed(store.description)
            for run in store.runs():
                if run not in before:  # it is there where this part was merged before
                    target.add_run(run)
            _take(target, done, store, units, first)
            failures += [row for row in read_failures(store) if row not in failures]
        target = target.redescribed(stores[0].description)  # with the seeds of all parts
        pack(target, files_of(studies[0].record))
        merged = StudyResults(path)
        merged.write_tables()
        if analysis is not None:
            target.write_record(ANALYSIS, analysis)
        if (tuning := read_tuning(stores[0])) is not None:
            target.write_record(TUNING, tuning)
        write_failures(target, failures)
    return StudyResults(path)


def _take(
    target: StudyStore, done: Done, store: StudyStore, units: Sequence[StoredUnit], first: int
) -> None:
    """Copy the seeds of a part's units that a folder lacks; `first` is the first seed of all."""
    for unit in units:
        there = done.setdefault(unit.key, {})
        new = tuple(seed for seed in unit.seeds if seed not in there)
        if new:
            result = store.result(unit, new)
            if first not in new:  # a study keeps the snapshots of its first seed alone
                learnt = {k: v for k, v in result.arrays.items() if group_of(k) != SNAPSHOTS}
                result = result._replace(arrays=learnt)
            there |= dict.fromkeys(new, target.write_unit(unit.about, result))
