"""Runs of other programs as a :class:`Comparison`: files become arms, which are judged like ours.

A run is one training with one seed. Its checkpoints, the episodes of its evaluations and its
parallel environments are parts of it, and never count as runs.
"""

import json
import math
import os
import re
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain, combinations, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from curricle.arrays import FloatArray, IntArray
from curricle.checks import fit_name, listed, number, one_of, whole_number
from curricle.comparison.comparison import Comparison
from curricle.comparison.measures import STATED, Arm, Reference
from curricle.comparison.plan import seed_ranges
from curricle.errors import SettingError, StoreError, reason
from curricle.files import ArrayArchive, opened_regular
from curricle.statistics.curves import SCRATCH, Curve

MONITOR = "monitor.csv"  # ends the name of a file of episodes, one for each environment of a run
KINDS = ("evaluations.npz", f"*{MONITOR}", "*.csv", "*.parquet")
"""Files of a folder, of which the first kind that there is counts."""
NEEDED = ("arm", "seed", "step", "return")
IN_FOLDER = re.compile(r"(\d+\.)?monitor\.csv|evaluations\.npz")  # whose folder is the run's path
RUN = re.compile(r"(.*?)[/_-]+(?:seed|run|s)?[_-]?(\d{1,9})")  # the path of a run: arm and seed
LARGEST, MOST_STEPS, MOST_BYTES = 1e100, 2**53, 2**30  # return, steps of a run, arrays of a file
WINDOW, MOST_WINDOWS = 5, 100  # checkpoints that are smoothed over; windows of steps

Rows = Iterator[tuple[str, dict[str, Any]]]  # a place for messages; column -> cell


class Result(NamedTuple):
    """A return of a run at a step; `episode` if the return is the mean of several."""

    step: int
    value: float
    charged: int
    episode: bool
    place: str


@dataclass(frozen=True)
class Run:
    """One training of an arm; `steps` and `returns` are (T,)."""

    arm: str
    seed: int
    charged: int
    steps: IntArray
    returns: FloatArray

    def __str__(self) -> str:
        return f"seed {self.seed} of {self.arm!r}"

    @property
    def end(self) -> int:
        """All steps of the run, those charged included."""
        return int(self.steps[-1]) + self.charged


# -- Reading files ---------------------------------------------------------------------------------


def _rows(path: Path) -> Rows:
    """Yield the rows of a table, or the episodes of ``evaluations.npz``."""
    place = ""
    try:
        with opened_regular(path) as (file, size):
            rows: Iterable[dict[str, Any]]
            if path.suffix == ".npz":
                zipped, parts = zipfile.ZipFile(file), ("timesteps", "results")
                archive = ArrayArchive(zipped, size, size)
                arrays = archive.read(*parts, compressed=parts, most=MOST_BYTES)
                pairs = zip(*(arrays[part] for part in parts), strict=True)
                episodes = ((step, value) for step, values in pairs for value in values)
                rows = ({"step": s, "return": value, "episode": ""} for s, value in episodes)
            else:
                head = json.loads(file.readline()[1:]) if path.name.endswith(MONITOR) else {}
                table = (pa_csv.read_csv if path.suffix == ".csv" else pq.read_table)(file)
                if len({*table.column_names}) < table.num_columns:
                    raise ValueError("two columns have one name")
                rows = ({**head, **row} for part in table.to_batches() for row in part.to_pylist())
            for n, row in enumerate(rows, start=1):
                yield (place := f"{path}, row {n}"), row
    except Exception as error:  # readers of formats raise many kinds on what they do not expect
        why = f"{type(error).__name__}, {reason(error)}".partition(". ")[0]
        raise StoreError(f"{path} cannot be read as a file of runs: {why}") from None
    if not place:
        raise StoreError(f"a file of runs must hold results: {path} has none")


def _episodes(paths: Sequence[Path]) -> Rows:
    """Yield the episodes of all environments of a run as they ended, at the run's steps."""
    ends, steps = list[tuple[float, int, Any, str]](), 0
    for place, row in chain.from_iterable(map(_rows, paths)):
        time = sum(_real(part, row.get(part), place) for part in ("t_start", "t"))
        ends.append((time, _whole("l", row.get("l"), place, 1), row.get("r"), place))
    for _, length, value, place in sorted(ends, key=lambda end: end[0]):
        steps += length
        yield place, {"step": steps, "return": value}


def _real(column: str, cell: Any, place: str, largest: float = math.inf) -> float:
    with suppress(TypeError, ValueError, OverflowError):
        cell = float(cell)
    return number(f"{column} in {place}", cell, StoreError, -largest, largest)


def _whole(column: str, cell: Any, place: str, least: int = 0) -> int:
    value = _real(column, cell, place, MOST_STEPS)
    return whole_number(f"{column} in {place}", value, least, StoreError)


def _by_path(paths: Sequence[Path]) -> dict[str, dict[str, Path]]:
    """Return the path of each run, or table of runs -> its files."""
    runs: dict[str, dict[str, Path]] = {}
    for path in paths:
        inside = (sorted(path.rglob(kind)) for kind in KINDS)
        for file in next(filter(None, inside), [path]):
            at = Path(os.path.abspath(file))
            run = at.parent if IN_FOLDER.fullmatch(at.name) else at.with_suffix("")
            runs.setdefault(run.as_posix().removesuffix(".monitor"), {})[str(at)] = file
    return runs


def read_runs(paths: Sequence[Path]) -> list[Run]:
    """Return the runs in files; StoreError with the file and the row of a mistake."""
    results: dict[tuple[str, int], list[Result]] = {}
    by_path = _by_path(paths)
    matches = {path: RUN.fullmatch(path) for path in by_path}
    named = {path: match.groups() if match else (path, None) for path, match in matches.items()}
    root = os.path.commonpath([os.path.dirname(arm) for arm, _ in named.values()])
    for path, of_path in by_path.items():
        files = [*of_path.values()]
        arm, seed = named[path]
        usual = {"arm": os.path.relpath(arm, root), "seed": seed, "charged": 0}
        episodes = files[0].name.endswith(MONITOR)
        for place, row in _episodes(files) if episodes else chain.from_iterable(map(_rows, files)):
            cells = usual | row
            if lacking := [part for part in NEEDED if cells.get(part) is None]:
                raise StoreError(
                    f"results need {listed(NEEDED)}, where the path of a run may name the first "
                    f"two as ARM/7 or ARM_7: {place} has no {listed(lacking)}"
                )
            name: Any = cells["arm"] if isinstance(cells["arm"], bytes) else str(cells["arm"])
            fit_name(f"an arm in {place}", name, StoreError)
            run = name, _whole("seed", cells["seed"], place)
            step, charged = (_whole(part, cells[part], place) for part in ("step", "charged"))
            value = _real("return", cells["return"], place, LARGEST)
            result = Result(step, value, charged, "episode" in cells, place)
            results.setdefault(run, []).append(result)
    return [_run(*run, of_run) for run, of_run in results.items()]


def _run(arm: str, seed: int, results: Sequence[Result]) -> Run:
    """Return the run of some results; the episodes of an evaluation are averaged."""
    for before, result in pairwise(results):
        if result.charged != before.charged or result.step < before.step + (not result.episode):
            raise StoreError(
                "steps of a run must increase, and those charged be the same: seed "
                f"{seed} of {arm!r} has step {before.step:,} after {before.charged:,} in "
                f"{before.place}, then {result.step:,} after {result.charged:,} in {result.place}; "
                'give two runs two seeds, and episodes of an evaluation a column "episode"'
            )
    steps, rows = np.unique([result.step for result in results], return_inverse=True)
    totals = np.bincount(rows, [result.value for result in results])
    return Run(arm, seed, results[0].charged, steps, totals / np.bincount(rows))


# -- Arms of runs, on one axis ---------------------------------------------------------------------


def compare_files(
    paths: Sequence[Path],
    charge: Mapping[str, str],
    curricula: Sequence[str] = (),
    threshold: float | None = None,
) -> Comparison:
    """Return the comparison of runs in files, as ``curricle verdict`` prints it.

    Arms with steps charged and arms in `curricula` are judged; the others are their opponents. All
    are compared over the steps that every run has. StoreError or SettingError if they cannot be.
    """
    arms: dict[str, list[Run]] = {}
    for run in sorted(read_runs(paths), key=lambda run: run.seed):
        steps = _whole("charge", charge.get(run.arm, run.charged), f"--charge {run.arm}")
        arms.setdefault(run.arm, []).append(replace(run, charged=steps))
    for name in (*charge, *curricula):
        one_of("an arm", name, arms, SettingError)
    judged = [name for name in arms if name in curricula or any(run.charged for run in arms[name])]
    rivals = sorted(arms.keys() - {*judged}, key=[SCRATCH, *arms].index)
    if not (judged and rivals):
        raise SettingError(
            "a verdict needs an opponent, and a curriculum with steps charged (--charge ARM=STEPS) "
            f"or named as one (--curriculum ARM): {listed(arms)} are all "
            f"{'curricula' if judged else 'opponents'}"
        )
    if SCRATCH in judged:
        raise SettingError(
            f"an arm called {SCRATCH!r} is the learner without a source, and no curriculum: give "
            "the judged arm another name"
        )
    pairing, runs = _pairing(arms), [*chain.from_iterable(arms.values())]
    at, shared = _checkpoints(runs)
    made = dict[str, Arm]()
    for name in (*rivals, *judged):
        values = np.stack([_values(run, at, shared) for run in arms[name]])
        charged = np.array([run.charged for run in arms[name]])
        made[name] = Arm(Curve(at, values, charged), scratch=name in rivals)
    first, total = made[rivals[0]], int(at[-1])
    budget = min(total, *(int(run.steps[-1]) for run in runs))
    if threshold is None:
        reference = Reference(None, f"midpoint of {rivals[0]}'s curve").after(first.curve)
    else:
        reference = Reference(number("--threshold", threshold, SettingError), STATED)
    means = f"; at means over {len(at) - 1} windows, as checkpoints differ" * (not shared)
    cut = f", where {min(runs, key=lambda run: run.end)} ends" * (
        len({int(run.steps[-1]) for run in runs}) > 1
    )
    free = [name for name in judged if not any(run.charged for run in arms[name])]
    remarks = [
        f"a run is one seed, {len(arms[judged[0]])} an arm, paired {pairing}: intervals and tests "
        "are over these, and episodes and environments of a run are no runs",
        "compared over the steps that every run has, pretraining included: from "
        f"{at[0]:,} to {total:,}{cut}{means}",
        *[f"no steps are charged to {listed(free)}: state any pretraining"] * bool(free),
    ]
    window = min(WINDOW, int(np.searchsorted(at, budget, side="right")))
    target = Path(os.path.commonpath([os.path.abspath(path) for path in paths])).stem
    return Comparison(target, made, budget, total, reference, window, remarks=tuple(remarks))


def _checkpoints(runs: Sequence[Run]) -> tuple[IntArray, bool]:
    """Return the checkpoints at which runs are compared, (T,), and whether they are the runs'."""
    start, total = max(int(run.steps[0]) for run in runs), min(run.end for run in runs)
    inside = [run.steps[(start <= run.steps) & (run.steps <= total)] for run in runs]
    most, fewest = max(inside, key=len), min(map(len, inside))
    shared = all(np.array_equal(steps, most[: len(steps)]) for steps in inside)
    windows = np.linspace(start, max(start, total), min(MOST_WINDOWS, max(2, fewest)) + 1)
    at = most if shared else np.unique(windows.round().astype(np.int64))
    for run, steps in zip(runs, inside, strict=True):
        if len(steps) < 2 or run.steps[-1] < at[1] or run.charged + start >= total:
            raise StoreError(
                "a run needs two results or more, and a step after its pretraining, within the "
                f"steps that every run has, {start:,} to {total:,}: {run}, charged {run.charged:,},"
                f" has {len(steps)} there and ends at {run.end:,}"
            )
    return at, shared


def _values(run: Run, at: IntArray, shared: bool) -> FloatArray:
    """Return the returns of a run at checkpoints, (T,), its last after its end."""
    if shared:
        return np.asarray(np.interp(at, run.steps, run.returns))
    # Between its checkpoints a curve is a straight line. The window of a checkpoint reaches halfway
    # to its neighbours, so that the trapezoid rule gives the means the area of the curve.
    edges = np.minimum([at[0], *(at[1:] + at[:-1]) / 2, at[-1]], run.steps[-1])
    knots = np.union1d(run.steps, edges)
    heights = np.interp(knots, run.steps, run.returns)
    areas = np.cumsum([0.0, *np.diff(knots) * (heights[1:] + heights[:-1]) / 2])
    inside = np.diff(edges) > 0
    means = np.diff(np.interp(edges, knots, areas))[inside] / np.diff(edges)[inside]
    return np.asarray(np.interp(at, at[inside], means))


def _pairing(arms: Mapping[str, Sequence[Run]]) -> str:
    """Return how the seeds of arms are paired; StoreError if they cannot be."""
    seeds = {name: {run.seed for run in runs} for name, runs in arms.items()}
    for (name, of_name), (other, of_other) in combinations(seeds.items(), 2):
        if of_name != of_other and (of_name & of_other or len(of_name) != len(of_other)):
            raise StoreError(
                "arms must have the same seeds, or as many and none in common: of "
                f"{name!r} and {other!r} one alone has {seed_ranges(sorted(of_name ^ of_other))}"
            )
    same = len({*map(frozenset, seeds.values())}) == 1
    return "by number" if same else "in order, as arms have different seeds"
