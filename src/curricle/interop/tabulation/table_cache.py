"""Tables kept on disk, found again by a hash of all that they were made from."""

import hashlib
import inspect
import io
import json
import sys
import zipfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from curricle.errors import StoreError, TaskError
from curricle.files import read_bounded, write_whole
from curricle.interop.tabulation.assembling import Tables
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
    folder : Path
        Made when the first tables are kept.
    """

    folder: Path

    def __post_init__(self) -> None:
        object.__setattr__(self, "folder", Path(self.folder))
        if self.folder.exists() and not self.folder.is_dir():
            raise StoreError(f"a cache must be a folder: {self.folder} is a file")

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
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            write_whole(self.folder / f"{name}.npz", packed.getvalue())
            # Last: without it there is nothing to be found.
            write_whole(self.folder / f"{name}.json", json.dumps(about, indent=1).encode())
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

    It stands for what the environment holds after each reset, the files that its classes and those
    of the functions given are in, the versions of the packages they belong to, and the `ways`: all
    else that the tables depend on.

    Raises
    ------
    TaskError
        When something in the environment cannot be read.
    """
    told = hashlib.blake2b(digest_size=20)
    told.update(repr((FORMAT, tuple(seeds), str(env.observation_space))).encode())
    told.update(str(env.action_space).encode())
    layers: list[Any] = [env]
    while isinstance(layers[-1], gym.Wrapper):
        layers.append(layers[-1].env)
    for owner in [*layers, *ways]:
        for module in _modules(owner):
            told.update(_source(module))
    try:
        told.update(fingerprint(list(ways)))
        for seed in seeds:
            env.reset(seed=seed)
            told.update(fingerprint(layers, {"_np_random_seed"}))
    except TaskError as error:
        raise TaskError(
            f"an environment must be readable to be cached, all that it holds: {error}"
        ) from error
    return told.hexdigest()


def _modules(owner: Any) -> list[str]:
    """Return the modules of an object's classes, or of a function."""
    kinds = type(owner).__mro__ if not inspect.isfunction(owner) else (owner,)
    names = [getattr(kind, "__module__", None) or "" for kind in kinds]
    return [name for name in names if name not in ("", "builtins", "typing", "abc")]


@cache
def _source(module: str) -> bytes:
    """Return a digest of a module's file, and of the version of its package."""
    top = sys.modules.get(module.partition(".")[0])
    file = getattr(sys.modules.get(module), "__file__", None)
    content = Path(file).read_bytes() if file and Path(file).is_file() else b""
    version = str(getattr(top, "__version__", ""))
    return hashlib.blake2b(f"{module} {version} ".encode() + content).digest()


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
