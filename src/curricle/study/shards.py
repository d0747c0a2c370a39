"""Splitting a study over machines, and putting the parts together."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from curricle.errors import StoreError
from curricle.study.arms import Arms
from curricle.study.config.study_config import StudyConfig
from curricle.study.results import StudyResults
from curricle.study.store import StudyStore
from curricle.study.stored_sources import finished
from curricle.study.units import Unit, units_of


def units_to_do(
    study: StudyConfig,
    arms: Arms,
    done: Mapping[str, Collection[int]],
    shard: tuple[int, int],
) -> list[Unit]:
    """Return the units of a shard, (i, n), for the seeds that are not done, sources first."""
    part, parts = shard
    seeds = [seed for seed in study.seeds if seed // study.seeds_per_unit % parts == part - 1]
    return units_of(arms, seeds, study.seeds_per_unit, done, study.snapshots)


def merge(path: str | Path, parts: Sequence[str | Path]) -> StudyResults:
    """Merge the parts of a study, run in several folders, into one folder; return its results.

    The parts are left as they are. A unit that several have is taken once: equal work gives equal
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
    if not parts:
        raise StoreError("there must be at least one folder to merge: got none")
    stores = [StudyStore(part) for part in parts]
    found = [store.units() for store in stores]
    for store, units in zip(stores, found, strict=True):
        stores[0].check(store.description)
        for unit in units:
            store.result(unit, unit.seeds)  # damage is found before anything is written
    for store, units in zip(stores, found, strict=True):
        with StudyStore.opened(path, store.description, resume=True) as target:
            done = {key: set(there) for key, there in finished(target.units()).items()}
            for run in store.runs():
                target.add_run(run)
            for unit in units:
                there = done.setdefault(unit.key, set())
                new = tuple(seed for seed in unit.seeds if seed not in there)
                if new:
                    there |= set(new)
                    taken = Unit(unit.key, "", unit.task, new, {}, 0)
                    target.write_unit(taken, store.result(unit, new))
            StudyResults(path).write_tables()
    return StudyResults(path)
