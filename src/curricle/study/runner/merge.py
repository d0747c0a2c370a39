"""Putting together what several machines did of one study."""

import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

from curricle.errors import StoreError
from curricle.study.runner.folder import UNITS, Stored, StudyFolder, explained
from curricle.study.runner.run import finished
from curricle.study.runner.study import Study
from curricle.study.store import PART


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
    found = [folder.units() for folder in folders]  # damage is found before anything is written
    for folder, units in zip(folders, found, strict=True):
        with StudyFolder.opened(path, folder.study, resume=True) as target:
            done = finished(target.units())
            for environment in folder.environments():
                target.note(environment)
            for unit in units:
                there = done.setdefault(unit.key, {})
                if not set(unit.seeds) <= set(there):
                    there |= dict.fromkeys(unit.seeds, _copied(unit, target))
            Study(path).write_tables()
    return Study(path)


def _copied(unit: Stored, target: StudyFolder) -> Stored:
    """Return a unit as it stands in another folder, copied there in one move."""
    place = target.path / UNITS / unit.path.parent.name / unit.path.name
    with explained(target.path):
        place.parent.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(dir=place.parent, prefix=".", suffix=PART))
        try:
            shutil.copytree(unit.path, part, dirs_exist_ok=True)
            part.replace(place)
        except BaseException:
            shutil.rmtree(part, ignore_errors=True)
            raise
    return unit._replace(path=place)
