"""Small units of a task in one file: how many seeds it holds, when it is written and merged.

A unit of some kilobytes costs more to store and to read than to train. So those that end within a
second are written together, and a file holds a block of seeds in the end. What the folder holds
after a run does not depend on when its units ended: each block is one file then.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from time import monotonic
from typing import Any

import numpy.typing as npt

from curricle.curriculum.node import Node
from curricle.errors import StoreError
from curricle.study.record import CurriculaRecord
from curricle.study.serialization import UnitResult, joined_units
from curricle.study.store import StoredUnit, StudyStore, read_errors, write_errors
from curricle.study.units import Unit
from curricle.tasks.mdp import generative_model

FULL = 2**22
"""Bytes of a file of several units, about: it is read in some milliseconds."""
NUMBER, TABLES, CURVES = 8, 2, 5
"""Bytes of a number, and how many a seed has for each pair (S x A) and for each checkpoint."""
BETWEEN = 1.0
"""Seconds between two writes, while small units end faster: as much as a killed run repeats."""
MOST_FILES = 32
"""Of a block of seeds until they are merged during a run."""
REMEMBERED = 8
"""Files of several units whose arrays are kept: more of their seeds are asked for next."""

Block = tuple[str, int]
"""A unit's key, and the number of its block of seeds."""
Taken = tuple[Unit, UnitResult | StoredUnit]
"""A unit, and its result or the file to which its worker has written it."""


def seeds_per_file(node: Node) -> int:
    """Return how many seeds of a task a file holds; 1 for networks and large tables.

    It depends on the study alone: on the pairs (S x A) of the task and its checkpoints.
    """
    return 1 if node.deep else max(1, FULL // bytes_a_seed(node))


def bytes_a_seed(node: Node) -> int:
    """Return the bytes of what a seed learns in tables, and of its curves, at most."""
    model = generative_model(node.task)
    tables = TABLES * model.states.size * model.actions.size
    checkpoints = node.most_steps // node.eval_freq + 1
    return NUMBER * (tables + CURVES * checkpoints)


def files_of(record: CurriculaRecord) -> dict[str, int]:
    """Return how many seeds a file of each key of a study holds."""
    nodes = (node for arm in record.arms.values() for node in arm.nodes.values())
    return {node.key: node.seeds_per_file for node in nodes}


class Packing:
    """The units of a run on their way into files.

    `done`, key -> seed -> unit, gets those that are stored; `per_file` is as :func:`files_of`.
    """

    def __init__(
        self,
        store: StudyStore,
        done: dict[str, dict[int, StoredUnit]],
        per_file: Mapping[str, int],
    ):
        self.store, self.done, self.per_file = store, done, per_file
        self._waiting = dict[Block, list[tuple[Unit, UnitResult]]]()
        self._receipts = list[tuple[Unit, StoredUnit]]()
        self._files = dict[Block, list[StoredUnit]]()
        """Those that this run has written."""
        self._large = False
        self._written = -BETWEEN
        self._remembered = lru_cache(REMEMBERED)(store.arrays)

    def arrays(self, stored: StoredUnit, *groups: str) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays of some groups of a file, as :meth:`StudyStore.arrays`."""
        large = self.is_large(stored.key, stored.seeds)
        return (self.store.arrays if large else self._remembered)(stored, *groups)

    def is_large(self, key: str, seeds: Sequence[int]) -> bool:
        """Return whether so many seeds have a file for themselves."""
        return self.per_file[key] <= len(seeds)

    def add(self, unit: Unit, result: UnitResult | StoredUnit) -> None:
        """Take a unit that was trained; StoreError if its worker wrote it to another place."""
        if isinstance(result, UnitResult):
            self._waiting.setdefault(_block(unit, self.per_file), []).append((unit, result))
        else:
            with read_errors(result.path):
                if not result.path.exists():
                    raise StoreError(
                        f"workers must write to the place of the run: {result.path} is not there"
                    )
            self._receipts.append((unit, result))
        self._large |= self.is_large(unit.key, unit.seeds)

    @property
    def seconds(self) -> float:
        """How long the units that were taken may still wait; 0 for those of large tables."""
        left = 0.0 if self._large else self._written + BETWEEN - monotonic()
        return max(0.0, left)

    def write(self) -> list[Taken]:
        """Write what was taken, and return it."""
        if not self:
            return []
        waiting, self._waiting, self._large = self._waiting, {}, False
        receipts, self._receipts = self._receipts, []
        for unit, stored in receipts:
            self.done.setdefault(unit.key, {}).update(dict.fromkeys(unit.seeds, stored))
        for block, taken in waiting.items():
            unit = taken[0][0]
            result = joined_units([result for _, result in taken])
            self._store(block, unit, result)
        self._written = monotonic()
        return [*receipts, *(one for taken in waiting.values() for one in taken)]

    def __bool__(self) -> bool:
        return bool(self._waiting or self._receipts)

    def _store(self, block: Block, unit: Unit, result: UnitResult) -> None:
        files = self._files.setdefault(block, [])
        files.append(self.store.write_unit(unit, result))
        if len(files) > MOST_FILES:
            files[:] = [merged_files(self.store, files)]
        self.done.setdefault(block[0], {}).update(dict.fromkeys(files[-1].seeds, files[-1]))


def pack(store: StudyStore, per_file: Mapping[str, int]) -> None:
    """Merge the files of each block of seeds in a folder into one; `per_file` is as `files_of`."""
    blocks = dict[Block, list[StoredUnit]]()
    for file in store.units():
        if file.key in per_file:
            blocks.setdefault(_block(file, per_file), []).append(file)
    for files in blocks.values():
        if len(files) > 1:
            merged_files(store, files)


def merged_files(store: StudyStore, files: Sequence[StoredUnit]) -> StoredUnit:
    """Write the units of some files of a block as one, delete the others and return it.

    A seed that several have, as after a run that was killed here, is taken once.
    """
    parts, taken = list[UnitResult](), set[int]()
    for file in files:
        if new := set(file.seeds) - taken:
            parts.append(store.result(file, new))
            taken |= new
    found = store.write_unit(files[0].about, joined_units(parts))
    with write_errors(store.path):
        for file in files:
            if file.path != found.path:
                file.path.unlink()
    return found


def _block(unit: Any, per_file: Mapping[str, int]) -> Block:
    return unit.key, min(unit.seeds) // per_file[unit.key]
