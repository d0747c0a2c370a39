"""A file of tables, under a name that the user chooses, which says what they were made of."""

import os
import re
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy.typing as npt

from curricle.archives.saved_file import read_saved, write_saved
from curricle.archives.sealed_json import digest_of
from curricle.errors import StoreError
from curricle.interop.tabulation.assembling import Tables
from curricle.interop.tabulation.fingerprint import fingerprint
from curricle.interop.tabulation.observation_table import ObservationTable
from curricle.interop.tabulation.state_access import Environment, layers_of
from curricle.interop.tabulation.tabulated_task import TabulationRecord
from curricle.tasks.spaces import Component, Space

KIND = "TabulatedTask"
OBSERVED = "observed "
"""Begins the names of arrays of observations."""
ARRAYS = ("probability", "next_state", "reward", "terminal", "start", "first")
Made = tuple[Tables, TabulationRecord]


def read_tables(path: Path, made_of: dict[str, Any]) -> Made | None:
    """Return the tables of a file, None if there is no file.

    Raises
    ------
    StoreError
        When the file is damaged, its tables were made of something else than `made_of`, or a new
        file could not be written, before any tables are made.
    """
    if not path.exists():
        if not os.access(path.parent, os.W_OK):
            raise StoreError(f"a cache must be a file in a folder that can be written to: {path}")
        return None
    file = read_saved(path, KIND)
    for what, value in made_of.items():
        if file.about.get(what) != value:
            raise StoreError(
                f"a cache must hold tables of the same {what}, or another file be named: {path} "
                f"has {file.about.get(what)}, got {value}"
            )
    try:
        return _tables(file.arrays, file.about)
    except (KeyError, TypeError, ValueError) as error:
        raise StoreError(f"{path} is not as tabulate() writes it: {error!r}") from None


def write_tables(
    path: Path, made_of: dict[str, Any], tables: Tables, record: TabulationRecord
) -> None:
    """Write tables, and what they were made of."""
    arrays: dict[str, npt.NDArray[Any]] = {name: getattr(tables, name) for name in ARRAYS}
    if tables.states.points is not None:
        arrays["points"] = tables.states.points
    if tables.observations is not None:
        for part, array in tables.observations.parts.items():
            arrays[OBSERVED + part] = array
    about = {
        "components": [asdict(component) for component in tables.states.components],
        "observed": tables.observations is not None,
        "record": asdict(record),
    }
    write_saved(path, KIND, arrays, about | made_of)


def made_of(
    env: Environment, name: str, seeds: Sequence[int], ways: Sequence[Any]
) -> dict[str, Any]:
    """Return what tables are made of, as JSON has it: not the code of environments or functions.

    `ways` are how states are saved and outcomes found. The environment is reset.
    """
    layers = layers_of(env)
    classes = [f"{type(layer).__module__}.{type(layer).__qualname__}" for layer in layers]
    content = b""  # arguments are in it too, of an environment that is no id but a function or made
    for seed in seeds:
        env.reset(seed=seed)
        content += fingerprint(layers, {"_np_random_seed"})
    packages = {"curricle", "gymnasium", type(env.unwrapped).__module__.partition(".")[0]}
    shown = [getattr(way, "__qualname__", repr(way)) for way in ways]
    # MiniGrid's space of missions prints a function with its address, another in every process.
    spaces = re.sub(r" at 0x\w+", "", f"{env.observation_space} {env.action_space}")
    return {
        "environment": name,
        "classes": classes,
        "spaces": spaces,
        "content after a reset": digest_of(content),
        "seeds": list(seeds),
        "settings": shown,
        "versions": {
            package: str(getattr(sys.modules[package], "__version__", ""))
            for package in sorted(packages)
        },
    }


def _tables(arrays: dict[str, npt.NDArray[Any]], about: Any) -> Made:
    """Return tables and their record; KeyError, TypeError or ValueError where they are none."""
    components = [
        Component(**{**component, "labels": component["labels"] and tuple(component["labels"])})
        for component in about["components"]
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
