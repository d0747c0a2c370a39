"""Putting together what several machines did of one study."""

from collections.abc import Sequence
from pathlib import Path

from curricle.errors import StoreError
from curricle.study.runner.folder import StudyFolder
from curricle.study.runner.stored_sources import finished
from curricle.study.runner.study import Study
from curricle.study.runner.unit import Unit


def merge(path: str | Path, parts: Sequence[str | Path]) -> Study:
    """Return the study whose parts were run in several folders, put together in another.

    Parts are left as they are. A unit that several have is taken once: equal work gives equal
    results.

    Parameters
    ----------
    path : path
        Made if need be; or a folder of the same study, whose units stay.
    parts : sequence of path

    Raises
    ------
    StoreError
        When folders hold different studies, or one is damaged or in use; what was merged so far is
        whole then.
    """
    if not parts:
        raise StoreError("there must be at least one folder to merge: got none")
    folders = [StudyFolder(part) for part in parts]
    found = [folder.units() for folder in folders]
    for folder, units in zip(folders, found, strict=True):
        folders[0].check(folder.study)
        for unit in units:
            folder.trained(unit, unit.seeds)  # damage is found before anything is written
    for folder, units in zip(folders, found, strict=True):
        with StudyFolder.opened(path, folder.study, resume=True) as target:
            done = {key: set(there) for key, there in finished(target.units()).items()}
            for environment in folder.environments():
                target.note(environment)
            for unit in units:
                there = done.setdefault(unit.key, set())
                new = tuple(seed for seed in unit.seeds if seed not in there)
                if new:
                    there |= set(new)
                    taken = Unit(unit.key, "", unit.node, new, {}, 0)
                    target.write(taken, folder.trained(unit, new))
            Study(path).write_tables()
    return Study(path)
