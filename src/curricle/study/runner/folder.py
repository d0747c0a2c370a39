"""A study's folder: its configuration, and units that are either whole or absent."""

import hashlib
import io
import json
import os
import re
import shutil
import tempfile
import zipfile
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq
from filelock import FileLock, Timeout

from curricle.errors import StoreError
from curricle.files import PART, write_whole
from curricle.study.runner.serialization import of_seeds
from curricle.study.runner.unit import Trained, Unit, seed_words
from curricle.study.store import as_json, as_parquet, read_json

STUDY, ENVIRONMENT, LOCK = "study.json", "environment.json", ".lock"
CHECKPOINTS = ".checkpoints"
"""Where networks that are being trained are saved, to go on from."""
UNITS, MANIFEST = "units", "unit.json"
RUN, VALUES, FILM, CURVES, DECISIONS = (
    "run.npz",
    "values.npz",
    "snapshots.npz",
    "curves.parquet",
    "decisions.parquet",
)
OF_READING = ("name", "seeds", "seeds_per_unit", "threshold", "window", "snapshots")
"""What may change without making results others'."""


class Stored(NamedTuple):
    """A unit that is there: where, and for which seeds of which key."""

    path: Path
    key: str
    node: str
    seeds: tuple[int, ...]


class StudyFolder:
    """The folder of one study; refuses those of others.

    Everything is written beside its place and moved there when it is complete and on disk, so that
    a run killed at any moment leaves whole units only.

    Parameters
    ----------
    path : path

    Raises
    ------
    StoreError
        When there is no study in the folder.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        if not (self.path / STUDY).is_file():
            raise StoreError(f"a study's folder holds a {STUDY}: {self.path} has none")
        self.study = self._unsealed(self.path / STUDY)

    @classmethod
    @contextmanager
    def opened(
        cls, path: str | Path, study: Mapping[str, Any], *, resume: bool
    ) -> Iterator["StudyFolder"]:
        """Open the folder for a study, made if need be, with other processes kept out.

        The lock goes with the process, however that ends.

        Parameters
        ----------
        path : path
        study : dict
            ``curricle`` (version), ``folder`` (of the study's modules), ``configuration``.
        resume : bool
            Whether it may hold results of this study already.

        Raises
        ------
        StoreError
            When it is in use, or holds another study, other files, or this study unless it is to
            be resumed.
        """
        path = Path(path)
        if path.exists() and not path.is_dir():
            raise StoreError(f"results need a folder: {path} is a file")
        ours = (path / STUDY).exists() or not path.exists() or (resume and (path / UNITS).is_dir())
        if not ours and any(_foreign(entry) for entry in path.iterdir()):
            raise StoreError(
                f"results need an empty folder or one of this study: {path} holds other files"
            )
        lock = FileLock(path / LOCK)
        with explained(path):
            path.mkdir(parents=True, exist_ok=True)
            try:
                lock.acquire(timeout=0)
            except Timeout:
                raise StoreError(
                    f"only one run at a time can work on a study: another is at work on {path}"
                ) from None
        try:
            yield cls._claimed(path, study, resume)
        finally:
            lock.release()

    @classmethod
    def _claimed(cls, path: Path, study: Mapping[str, Any], resume: bool) -> "StudyFolder":
        if (path / STUDY).exists():
            folder = cls(path)
            folder.check(study)
            if not resume and (units := folder.units()):
                raise StoreError(
                    f"{path} already holds this study, {len(units)} units of it: go on "
                    "with --resume, or choose another folder"
                )
            seeds = {*folder.study["configuration"]["seeds"], *study["configuration"]["seeds"]}
            study = {**study, "configuration": {**study["configuration"], "seeds": sorted(seeds)}}
        for part in (*path.glob(f".*{PART}"), *path.glob(f"{UNITS}/*/.*{PART}")):
            # A killed run's: it means nothing.
            shutil.rmtree(part) if part.is_dir() else part.unlink()
        with explained(path):
            write_whole(path / STUDY, _sealed(study))
        return cls(path)

    def check(self, study: Mapping[str, Any]) -> None:
        """Raise StoreError if results of a study, given as :meth:`opened` takes it, differ."""
        here = json.loads(json.dumps(study))
        for name, (mine, yours) in _apart(self.study, here):
            raise StoreError(
                f"{self.path} holds another study: {name} is {_shown(mine)} there and "
                f"{_shown(yours)} here; choose another folder"
            )

    def note(self, environment: Mapping[str, Any]) -> None:
        """Add a run's environment to those of earlier runs."""
        with explained(self.path):
            write_whole(self.path / ENVIRONMENT, as_json([*self.environments(), environment]))

    def environments(self) -> list[dict[str, Any]]:
        """Return the environment of each run so far."""
        path = self.path / ENVIRONMENT
        found: list[dict[str, Any]] = read_json(path) if path.exists() else []
        return found

    # -- units ---------------------------------------------------------------------------------

    def units(self) -> list[Stored]:
        """Return what is there, by path.

        Raises
        ------
        StoreError
            Naming a unit that is damaged.
        """
        manifests = self.path.glob(f"{UNITS}/*/*/{MANIFEST}")
        found = [path for path in manifests if not path.parent.name.endswith(PART)]
        return [self._stored(path) for path in sorted(found)]

    def _stored(self, manifest: Path) -> Stored:
        found = self._unsealed(manifest)
        for name, (size, _) in found["files"].items():
            file = manifest.parent / name
            if not file.is_file() or file.stat().st_size != size:
                raise self._damage(file)
        return Stored(manifest.parent, found["key"], found["node"], tuple(found["seeds"]))

    def _damage(self, file: Path) -> StoreError:
        if file.name == STUDY:
            return StoreError(
                f"{file} is damaged, or not one that curricle wrote: where {UNITS} are beside it, "
                "delete it and run the study again with --resume"
            )
        return StoreError(
            f"{file} is damaged: it is not as it was written; delete the folder {file.parent} and "
            "run the study again with --resume, which does only what is missing"
        )

    def write(self, unit: Unit, trained: Trained) -> Stored:
        """Store what a unit left, all at once, and return where it is.

        Raises
        ------
        StoreError
            When the disk is full, say; what is there already stays.
        """
        name = re.sub(r"[^\w-]+", "_", unit.node)[:40]
        place = self.path / UNITS / f"{name}-{unit.key}" / _short(unit.seeds)
        files = _files(unit, trained)
        sizes = {file: [len(content), _digest(content)] for file, content in files.items()}
        manifest = {
            "key": unit.key,
            "node": unit.node,
            "seeds": unit.seeds,
            "calibrations": trained.calibrations,
            "files": sizes,
        }
        with explained(self.path):
            place.parent.mkdir(parents=True, exist_ok=True)
            part = Path(tempfile.mkdtemp(dir=place.parent, prefix=".", suffix=PART))
            try:
                for file, content in {**files, MANIFEST: _sealed(manifest)}.items():
                    write_whole(part / file, content)
                os.chmod(part, 0o755)
                shutil.rmtree(place, ignore_errors=True)  # without a manifest it means nothing
                os.replace(part, place)
                shutil.rmtree(self.saves(unit), ignore_errors=True)
            except BaseException:
                shutil.rmtree(part, ignore_errors=True)
                raise
        return Stored(place, unit.key, unit.node, unit.seeds)

    def saves(self, unit: Unit) -> Path:
        """Return where a unit's training may be saved until it is stored."""
        return self.path.resolve() / CHECKPOINTS / unit.key / _short(unit.seeds)

    def read(self, stored: Stored, name: str) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays of a unit's file, such as ``run.npz``; none where it has no such file.

        Raises
        ------
        StoreError
            When the file is damaged.
        """
        file = stored.path / name
        if not file.exists():
            return {}
        content = self._content(file)
        try:
            with np.load(io.BytesIO(content)) as arrays:
                return {key: arrays[key] for key in arrays.files}
        except (ValueError, OSError, zipfile.BadZipFile):
            raise self._damage(file) from None

    def table(self, stored: Stored, name: str) -> pa.Table:
        """Return a unit's Parquet table."""
        return pq.read_table(io.BytesIO(self._content(stored.path / name)))

    def _content(self, file: Path) -> bytes:
        content = file.read_bytes()
        if _digest(content) != self._unsealed(file.parent / MANIFEST)["files"][file.name][1]:
            raise self._damage(file)
        return content

    def calibrations(self, stored: Stored) -> list[dict[str, Any]]:
        """Return what was fitted for each of a unit's seeds; empty unless it was."""
        return list(self._unsealed(stored.path / MANIFEST)["calibrations"])

    def trained(self, stored: Stored, seeds: Collection[int]) -> Trained:
        """Return what a unit left for some of its seeds; StoreError if any of it is damaged."""
        names = (RUN, VALUES, FILM)
        arrays = {k: v for name in names for k, v in self.read(stored, name).items()}
        self._content(stored.path / CURVES)
        rows = self.table(stored, DECISIONS).to_pylist()
        fitted = self.calibrations(stored)
        return Trained(
            of_seeds(arrays, seeds),
            [row for row in rows if row["seed"] in seeds],
            [one for one, seed in zip(fitted, stored.seeds, strict=False) if seed in seeds],
        )

    def _unsealed(self, file: Path) -> dict[str, Any]:
        """Return what :func:`_sealed` was called on; StoreError if it is not as it was."""
        try:
            found = json.loads(file.read_text(encoding="utf-8"))
            digest = found.pop("digest")
        except (ValueError, AttributeError, TypeError, KeyError, IndexError):
            raise self._damage(file) from None
        if digest != _digest(as_json(found)):
            raise self._damage(file)
        return dict(found)


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Turn a failure to write into one sentence that says what is safe."""
    try:
        yield
    except OSError as error:
        raise StoreError(
            f"results cannot be written to {path} ({error.strerror}): what was stored before is "
            "whole; run again with --resume when there is room"
        ) from error


def _foreign(entry: Path) -> bool:
    """Return whether a file is none that a killed run may leave in a new folder."""
    return entry.suffix != PART and entry.name != LOCK


def _apart(mine: Any, yours: Any, name: str = "") -> Iterator[tuple[str, tuple[Any, Any]]]:
    """Yield where two configurations differ in what results depend on."""
    if not (isinstance(mine, dict) and isinstance(yours, dict)):
        if mine != yours:
            yield name, (mine, yours)
        return
    for key in sorted({*mine, *yours}):
        place = f"{name}.{key}" if name and name != "configuration" else key
        if not (name == "configuration" and key in OF_READING) and place != "folder":
            yield from _apart(mine.get(key), yours.get(key), place)


def _shown(value: Any) -> str:
    text = json.dumps(value)
    return "absent" if value is None else text if len(text) < 60 else text[:56] + " ..."


def _short(seeds: tuple[int, ...]) -> str:
    words = "seeds-" + seed_words(seeds)
    return words if len(words) < 60 else words[:40] + "-" + _digest(words.encode())


def _digest(content: bytes) -> str:
    return hashlib.blake2b(content, digest_size=16).hexdigest()


def _sealed(value: Mapping[str, Any]) -> bytes:
    """Return JSON that tells whether it is as it was written."""
    return as_json({**value, "digest": _digest(as_json(value))})


def _files(unit: Unit, trained: Trained) -> dict[str, bytes]:
    """Return a unit's files: curves and what was spent, tables, snapshots, and the same as Parquet."""
    arrays = trained.arrays
    tables = {k: v for k, v in arrays.items() if re.fullmatch(r"(values|states)(_\d+(/.*)?)?", k)}
    snapshots = {k: v for k, v in arrays.items() if k.startswith("film_")}
    run = {k: v for k, v in arrays.items() if k not in tables and k not in snapshots}
    files = {
        RUN: _npz(np.savez, run),
        CURVES: as_parquet(curve_table(unit.node, arrays)),
        DECISIONS: as_parquet(pa.Table.from_pylist(trained.decisions)),
    }
    if tables:
        files[VALUES] = _npz(np.savez, tables)
    if snapshots:
        files[FILM] = _npz(np.savez_compressed, snapshots)
    return files


def curve_table(node: str, arrays: Mapping[str, npt.NDArray[Any]]) -> pa.Table:
    """Return a unit's curves as a tidy table, each seed up to its own end."""
    steps = arrays["steps"]
    shown = steps[None, :] <= arrays["steps_used"][:, None]
    seed, checkpoint = np.nonzero(shown)
    columns = {
        "node": [node] * len(seed),
        "seed": arrays["seeds"][seed],
        "checkpoint": checkpoint,
        "steps": steps[checkpoint],
        "source_steps": arrays["source_steps"][seed],
    }
    for name in ("training_return", "greedy_return", "trust", "episodes"):
        columns[name] = arrays[name][shown]
    return pa.table(columns)


def _npz(save: Any, arrays: Mapping[str, npt.NDArray[Any]]) -> bytes:
    buffer = io.BytesIO()
    save(buffer, **arrays)
    return buffer.getvalue()
