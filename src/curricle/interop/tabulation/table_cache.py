"""Tables kept on disk, found again by a hash of all that they were made from."""

import hashlib
import io
import json
import re
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from curricle.errors import SettingError, StoreError, TaskError
from curricle.files import part_in, read_bounded, write_whole
from curricle.interop.tabulation.assembling import Tables
from curricle.interop.tabulation.code_in_memory import code_digest
from curricle.interop.tabulation.fingerprint import fingerprint
from curricle.interop.tabulation.observation_table import ObservationTable
from curricle.interop.tabulation.state_access import Environment
from curricle.interop.tabulation.tabulated_task import TabulationRecord
from curricle.tasks.spaces import Component, Space

FORMAT = 1
"""Of the files, and of what tabulating makes of an environment; files of another are not found."""
OBSERVED = "observed "
"""Begins the names of arrays of observations."""
LARGEST_JSON, LARGEST_TABLES = 2**28, 2**34
"""Bytes of a file at most."""
ARRAYS = ("probability", "next_state", "reward", "terminal", "start", "first")


@dataclass(frozen=True)
class TableCache:
    """A folder of tables: NAME.npz with arrays and NAME.json with the rest, no pickle.

    A file is there whole or not at all. One that is damaged, or of another format, is as if it were
    not there.

    Parameters
    ----------
    folder : str or Path
        Made when the first tables are kept.
    """

    folder: Any

    def __post_init__(self) -> None:
        if not isinstance(self.folder, str | Path) or not str(self.folder):
            raise SettingError(f"cache must be the path of a folder: got {self.folder!r}")
        folder = Path(self.folder)
        if folder.exists() and not folder.is_dir():
            raise StoreError(f"a cache must be a folder: {folder} is a file")
        object.__setattr__(self, "folder", folder)

    def find(self, name: str) -> tuple[Tables, TabulationRecord] | None:
        """Return the tables kept under a name, and how they came about; None if there are none."""
        with suppress(OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile):
            text = read_bounded(self.folder / f"{name}.json", LARGEST_JSON)
            content = read_bounded(self.folder / f"{name}.npz", LARGEST_TABLES)
            about = json.loads(text)
            if about["format"] == FORMAT and about["sha256"] == _sha256(content):
                with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
                    return _read(about, dict(arrays))
        return None

    def keep(self, name: str, tables: Tables, record: TabulationRecord) -> None:
        """Keep tables under a name.

        Raises
        ------
        StoreError
            When the folder cannot be written to.
        """
        arrays: dict[str, npt.NDArray[Any]] = {each: getattr(tables, each) for each in ARRAYS}
        if tables.states.points is not None:
            arrays["points"] = tables.states.points
        if tables.observations is not None:
            for part, array in tables.observations.parts.items():
                arrays[OBSERVED + part] = array
        packed = io.BytesIO()
        np.savez_compressed(packed, allow_pickle=False, **arrays)
        about = {
            "format": FORMAT,
            "sha256": _sha256(packed.getvalue()),
            "components": [asdict(component) for component in tables.states.components],
            "observed": tables.observations is not None,
            "record": asdict(record),
        }
        with self._writing():
            self.folder.mkdir(parents=True, exist_ok=True)
            write_whole(self.folder / f"{name}.npz", packed.getvalue())
            # Last: without it there is nothing to be found.
            write_whole(self.folder / f"{name}.json", json.dumps(about, indent=1).encode())

    def require_writable(self) -> None:
        """Raise StoreError where tables could not be kept, before any are made."""
        absolute = self.folder.absolute()
        there = next(each for each in (absolute, *absolute.parents) if each.exists())
        with self._writing():
            trial = part_in(there)
            trial.touch()
            trial.unlink()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise StoreError(
                f"a cache must be a folder that can be written to: {self.folder} failed with "
                f"{type(error).__name__}: {error}"
            ) from error


def _read(about: Any, arrays: dict[str, npt.NDArray[Any]]) -> tuple[Tables, TabulationRecord]:
    """Return the tables and their record; KeyError, TypeError or ValueError where they are none."""
    components = [
        Component(**{**each, "labels": each["labels"] and tuple(each["labels"])})
        for each in about["components"]
    ]
    observations = None
    if about["observed"]:
        parts = {
            name.removeprefix(OBSERVED): array
            for name, array in arrays.items()
            if name.startswith(OBSERVED)
        }
        observations = ObservationTable(parts, arrays["terminal"])
    states = Space(components, arrays.get("points"))
    plain: dict[str, Any] = {name: arrays[name] for name in ARRAYS}
    tables = Tables(states=states, observations=observations, **plain)
    record = TabulationRecord(**{**about["record"], "seeds": tuple(about["record"]["seeds"])})
    return tables, replace(record, cached=True)


def name_of(env: Environment, seeds: Sequence[int], ways: Sequence[Any]) -> str:
    """Return a name that other tables would not have.

    It stands for what the environment holds after each reset, the code of its classes and of the
    functions given (:func:`code_digest`), and the `ways`: all else that the tables depend on.

    Raises
    ------
    TaskError
        When something in the environment cannot be read.
    """
    told = hashlib.blake2b(digest_size=20)
    # MiniGrid's space of missions prints a function with its address, another in every process.
    spaces = re.sub(r" at 0x\w+", "", f"{env.observation_space} {env.action_space}")
    told.update(repr((FORMAT, tuple(seeds), spaces)).encode())
    layers: list[Any] = [env]
    while isinstance(layers[-1], gym.Wrapper):
        layers.append(layers[-1].env)
    try:
        told.update(code_digest([*layers, *ways]))
        told.update(fingerprint(list(ways)))
        for seed in seeds:
            env.reset(seed=seed)
            told.update(fingerprint(layers, {"_np_random_seed"}))
    except TaskError as error:
        raise TaskError(
            f"an environment must be readable to be cached, all that it holds: {error}"
        ) from error
    return told.hexdigest()


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
