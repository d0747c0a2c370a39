"""What a unit costs the process that runs a study, for 1,000 to 100,000 units of trivial work.

A study of a maze of five states and 20 steps a task has three units a seed: the target without a
source, a source and the target after it. For each number of units it is run with 99 % of its
seeds, resumed with all of them, and resumed again with nothing left. Printed are

- driver: processor time of the main thread a unit, from the first unit's start until the last is
  stored. Units are trained in one other thread (or on a cluster), whose time is not in it;
- wall: time that passes a unit, over the same span;
- tables: wall time a unit after it, for the tables and the analysis of all units;
- memory: the most that the process held, and how much the run added to that (with threads,
  training is part of it);
- resume: until it is known what is left, and until all is over, with 1 % left and with nothing;
- show: `StudyResults(...).comparison`.

With --ratio, the same units are trained in two threads and on a cluster of two workers that is
there (--on dask://host:8786), in turn. Units last a second, and ten milliseconds; printed is the
wall time that passes on the cluster as a multiple of the threads'.

    python benchmarks/bench_cluster.py [--quick] [--units N ...] [--on dask] [--ratio]
"""

import argparse
import resource
import sys
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import perf_counter, thread_time
from typing import Any

from curricle.study import StudyResults, read_study, run_study
from curricle.study.running import Progress
from curricle.study.workers import dask_cluster

UNITS = (1_000, 10_000, 100_000)
UNITS_A_SEED = 3
STUDY = """
name = "many"
seeds_per_unit = 1
budget = 20
learner = { learning_rate = 0.5, epsilon = 0.1 }
tasks.near = { type = "maze", map = "..S.T" }
tasks.far = { type = "maze", map = "S...T" }
transfers = [{ source = "near", target = "far", mapping = "same_position" }]
"""


@dataclass
class Run:
    """A run of the study: its start, the first unit's, the last one's end and (wall) its own."""

    seeds: int
    path: Path
    on: str | None
    budget: int = 20
    workers: int = 1
    wall: list[float] = field(default_factory=list)
    driver: list[float] = field(default_factory=list)
    units: int = 0

    def note(self, progress: Progress) -> None:
        self.units = len(progress.units)
        self.wall[1:] = [*self.wall[1:2], perf_counter()]
        self.driver[1:] = [*self.driver[1:2], thread_time()]

    def run(self) -> "Run":
        self.path.parent.joinpath("many.toml").write_text(STUDY)
        study = read_study(
            self.path.parent / "many.toml", set=[f"seeds={self.seeds}", f"budget={self.budget}"]
        )
        self.wall.append(perf_counter())
        self.driver.append(thread_time())
        how: dict[str, Any] = {"resume": True, "progress": self.note, "report": _silent}
        with dask_cluster(self.on) if self.on else nullcontext() as cluster:
            if cluster is not None:
                how |= {"executor": cluster.executor}
            run_study(study, self.path, workers=cluster.workers if cluster else self.workers, **how)
        self.wall.append(perf_counter())
        return self


def _silent(sentence: str) -> None:
    """Drop a remark."""


def peak() -> float:
    """Return the most memory that this process held so far, in MB."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20


def report(units: int, on: str | None) -> None:
    seeds = -(-units // UNITS_A_SEED)
    with TemporaryDirectory() as folder:
        path, before = Path(folder) / "results", peak()
        first = Run(seeds - max(1, seeds // 100), path, on).run()
        each = 1e3 / first.units
        print(f"{first.units:,} units of {seeds * UNITS_A_SEED:,}, on {on or 'threads'}")
        print(f"  driver {(first.driver[-1] - first.driver[1]) * each:9.2f} ms a unit")
        print(f"  wall   {(first.wall[-2] - first.wall[1]) * each:9.2f} ms a unit")
        print(f"  tables {(first.wall[-1] - first.wall[-2]) * each:9.2f} ms a unit")
        print(f"  memory {peak():9.0f} MB, {peak() - before:.0f} MB more than before")
        for left in ("1 % left", "nothing left"):
            one = Run(seeds, path, on).run()
            known, over = one.wall[1] - one.wall[0], one.wall[-1] - one.wall[0]
            print(f"  resume {known:9.2f} s until it is known that {left}, {over:.2f} s in all")
        print(f"  show   {timed(lambda: StudyResults(path).comparison):9.2f} s")
        print(f"  memory {peak():9.0f} MB at the end", flush=True)


PAIRS = 5
"""Runs in threads and on the cluster, in turn."""
LONG = 10_000_000
"""Steps by which the time of a step is measured."""


def ratio(seconds: float, seeds: int, on: str) -> None:
    """Print how much longer units take on a cluster of two workers than in two threads."""
    with TemporaryDirectory() as folder:
        one = Run(1, Path(folder) / "results", None, LONG).run()
    step = (one.wall[-2] - one.wall[1]) / UNITS_A_SEED / LONG
    found = []
    for _ in range(PAIRS):
        taken = []
        for where in (None, on):
            with TemporaryDirectory() as folder:
                run = Run(seeds, Path(folder) / "results", where, int(seconds / step), workers=2)
                run.run()
            taken.append(run.wall[-2] - run.wall[1])
        found.append((taken[1] / taken[0], *taken))
    each, threads, cluster = (median(column) for column in zip(*found, strict=True))
    ratios = sorted(one[0] for one in found)
    print(
        f"{seeds * UNITS_A_SEED} units of {1e3 * seconds:.0f} ms: {threads:.2f} s in two threads, "
        f"{cluster:.2f} s on {on}; ratio {each:.2f} [{ratios[0]:.2f}, {ratios[-1]:.2f}]",
        flush=True,
    )


def timed(action: Callable[[], Any]) -> float:
    begun = perf_counter()
    action()
    return perf_counter() - begun


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="1,000 units only")
    parser.add_argument("--units", type=int, nargs="+", default=UNITS)
    parser.add_argument("--on", help="a Dask cluster: dask, or one at an address")
    parser.add_argument("--ratio", action="store_true", help="the cluster against two threads")
    given = parser.parse_args()
    with TemporaryDirectory() as folder:  # compiles
        Run(2, Path(folder) / "results", given.on).run()
    if given.ratio:
        ratio(1.0, 14, given.on)
        ratio(0.01, 400, given.on)
        return
    for units in UNITS[:1] if given.quick else given.units:
        report(units, given.on)


if __name__ == "__main__":
    main()
