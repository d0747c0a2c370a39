"""What a run finds in its folder: the units that it uses, and why it does not use others."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from curricle.files import Place, place_at
from curricle.study.arms import Arms
from curricle.study.config.study_config import StudyConfig
from curricle.study.dependencies import changes_of, key_in, key_of, replaced_keys, settings_key_of
from curricle.study.folders import holds_study, write_errors
from curricle.study.record import RunRecord
from curricle.study.store import StoredUnit, StudyStore
from curricle.study.tuning import digest_of, tuned_study
from curricle.study.tuning_record import tuning_at
from curricle.study.units import numbered_seeds

Done = dict[str, dict[int, StoredUnit]]
"""Key -> seed -> unit."""


def arms_in(study: StudyConfig, path: str | Place, *, keep_stale: bool) -> Arms:
    """Return a study's arms; the keys are those of stale units in a folder if these are kept."""
    if not (keep_stale and holds_study(place_at(path))):
        return Arms.of(study)
    store = StudyStore(path)
    return Arms.of(study, key_in(store.finished(without=store.damaged_units())))


def tuned_before(
    study: StudyConfig,
    arms: Arms,
    path: str | Place,
    report: Callable[[str], Any],
    *,
    keep_stale: bool,
) -> tuple[StudyConfig, Arms]:
    """Return a study and its arms as a folder says that it was tuned; as they are if it does not.

    A tuning counts if it is complete and depended on what it depends on now, code and Curricle's
    version aside where stale units are kept. `report` is called with a sentence about a stale one.
    """
    there = None if study.tune is None else tuning_at(place_at(path))
    if there is None:
        return study, arms
    if there.of != digest_of(study):
        if not keep_stale or there.of_settings != digest_of(study, settings_key_of):
            report("the tuning is stale and made again: what it depends on has changed")
            return study, arms
        report(
            "the tuning is stale and kept: its trials are of other code, or of another version of "
            "Curricle"
        )
    tuned = tuned_study(study, there)
    return tuned, arms_in(tuned, path, keep_stale=keep_stale)


def usable_units(store: StudyStore, arms: Arms, *, remove_damaged: bool) -> tuple[Done, list[str]]:
    """Return the units that are whole, and a sentence about each task with others.

    Damaged units are deleted if asked for; stale ones stay, and are found again if what they depend
    on is as it was.
    """
    damaged = store.damaged_units()
    remarks = [f"{file} is damaged: its units are trained again" for file in damaged]
    if remove_damaged:
        with write_errors(store.path):
            for file in damaged:
                file.unlink()
    done = store.finished(without=damaged)
    return done, [*remarks, *_stale(arms, done)]


def _stale(arms: Arms, done: Done) -> Iterator[str]:
    places: dict[str, tuple[str, str]] = {}
    for place, key in arms.keys.items():
        places.setdefault(key, place)  # of arms that share units, the first
    depends = {key: arms.dependencies[place] for key, place in places.items()}
    kept = {key: key for key in places if key in done and key != key_of(depends[key])}
    stale = replaced_keys(depends, done) | kept
    for key, place in places.items():
        if key in stale:
            units = done[stale[key]]
            fate = "kept" if key in kept else "trained again"
            why = "; ".join(changes_of(units, depends[key]))
            label = f"{': '.join(place)}, {numbered_seeds(sorted(units))}"
            yield f"{label}, is stale and {fate}: {why}"


def different_versions(runs: Iterable[RunRecord], run: RunRecord) -> Iterator[str]:
    """Yield a sentence for each library that had another version in earlier runs into a folder."""
    for library, version in run.versions.items():
        others = {one.versions[library] for one in runs if library in one.versions} - {version}
        if others and library != "curricle":
            yield (
                f"{library} was {' and '.join(sorted(others))} in earlier runs and is {version}: "
                "their units are used, and may differ from today's in the last bits"
            )
