"""What the benchmarks share: rates measured in turns, and the table that holds them to bars.

Both sides of a comparison take turns in one run, and what counts is the median of the turns'
ratios: absolute rates change with the machine and its load. Work on one
thread is measured in processor time for the same reason, work on several in wall time.
"""

import argparse
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from statistics import median

import curricle as cr

LEARNER = cr.QLearning(learning_rate=0.1, epsilon=0.1)
GLIMPSE = cr.GreedyEvaluation(method="rollouts", episodes=1)
"""An evaluation that costs next to nothing, so that what is timed is learning."""

Rates = dict[str, list[float]]


def rate(work: Callable[[], object], steps: int, clock: Callable[[], float]) -> float:
    """Return steps a second by `clock`: `time.process_time` or `time.perf_counter`."""
    begin = clock()
    work()
    return steps / (clock() - begin)


def on_one_thread(work: Callable[[], object], steps: int) -> float:
    return rate(work, steps, time.process_time)


def by_the_wall(work: Callable[[], object], steps: int) -> float:
    return rate(work, steps, time.perf_counter)


def in_turns(contestants: Mapping[str, Callable[[], float]], turns: int) -> Rates:
    """Return the rates of each contestant, one a turn: the better of two in a row.

    The first wakes the processor, which has waited for the other side's process.
    """
    rates: Rates = {name: [] for name in contestants}
    for _ in range(turns):
        for name, measure in contestants.items():
            rates[name].append(max(measure(), measure()))
    return rates


@dataclass
class Board:
    """The table of bars, printed row by row."""

    missed: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        head = f"{'steps a second':<50}{'ours':>14}{'theirs':>14}{'ratio':>9}{'bar':>9}"
        print(f"{head}\n{'-' * len(head)}")

    def compare(
        self,
        what: str,
        rates: Rates,
        ours: str,
        theirs: str,
        bar: float | None = None,
        note: str = "",
    ) -> None:
        """Print the median ratio of two contestants beside its bar, if there is one."""
        if theirs in rates:
            ratio = median(a / b for a, b in zip(rates[ours], rates[theirs], strict=True))
            self.row(what, median(rates[ours]), median(rates[theirs]), ratio, bar, note)

    def row(
        self,
        what: str,
        ours: float,
        theirs: float | None,
        ratio: float,
        bar: float | None,
        note: str = "",
    ) -> None:
        other = "" if theirs is None else f"{theirs:,.0f}"
        line = f"{what:<50}{ours:>14,.0f}{other:>14}{ratio:>8,.{_digits(ratio)}f}x"
        if bar is not None:
            line += f"{bar:>8,.{_digits(bar)}f}x {'ok' if ratio >= bar else 'MISS'}"
            self.missed += [what] if ratio < bar else []
        print(f"{line:<112}{note}".rstrip(), flush=True)

    def skip(self, what: str, why: str) -> None:
        print(f"{what:<50}skipped: {why}", flush=True)

    def close(self) -> None:
        print(f"missed: {', '.join(self.missed)}" if self.missed else "no bar missed")


def _digits(ratio: float) -> int:
    return 2 if ratio < 10 else 0


def arguments(doc: str | None) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a tenth of the steps, fewer turns")
    parser.add_argument("--turns", type=int, help="turns a side")
    return parser
