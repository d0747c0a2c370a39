"""The C++ reference: compiled into a temporary folder, given its tables, run."""

import json
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from curricle.paper.mazes import maze

SOURCE = Path(__file__).with_name("reference.cpp")
FLAGS = ("-std=c++17", "-O3", "-march=native")


@dataclass(frozen=True)
class Reference:
    """The compiled program and the tables of W1."""

    program: Path
    tables: Path

    def run(self, task: str, variant: str, dtype: str, steps: int) -> dict[str, float]:
        """Return what the program prints: `ns_per_step` and `greedy_return`."""
        return json.loads(self._start(task, variant, dtype, steps).communicate()[0])

    def rate(self, task: str, variant: str, dtype: str, steps: int) -> float:
        """Return steps a second of processor time."""
        return 1e9 / self.run(task, variant, dtype, steps)["ns_per_step"]

    def side_by_side(self, copies: int, steps: int) -> None:
        """Run so many copies of cached W1 at once: what the machine's cores are good for."""
        for copy in [self._start("W1", "cached", "float32", steps) for _ in range(copies)]:
            copy.communicate()

    def _start(self, task: str, variant: str, dtype: str, steps: int) -> subprocess.Popen[str]:
        command = [self.program, task, variant, dtype, str(steps)]
        command += [self.tables] if task == "W1" else []
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


@contextmanager
def reference() -> Iterator[Reference | None]:
    """Compile the reference for as long as it is needed; None where there is no compiler."""
    compiler = shutil.which("g++") or shutil.which("c++")
    if compiler is None:
        yield None
        return
    with tempfile.TemporaryDirectory() as folder:
        built = Reference(Path(folder, "reference"), Path(folder, "w1.bin"))
        subprocess.run([compiler, *FLAGS, "-o", built.program, SOURCE], check=True)
        write_tables(built.tables)
        yield built


def write_tables(path: Path) -> None:
    """Write W1 as `Maze` in the C++ reads it."""
    mdp = maze(-5).mdp
    row = mdp.outcome_row
    head = [*row.shape, mdp.start_states[0], mdp.time_limit]
    with path.open("wb") as file:
        file.write(np.array(head, np.int32).tobytes())
        file.write(np.array([mdp.discount], np.float64).tobytes())
        file.write(mdp.next_state[row, 0].astype(np.int32).tobytes())
        file.write(mdp.reward[row, 0].astype(np.float64).tobytes())
        file.write(mdp.terminal.astype(np.uint8).tobytes())
