"""Run a study again and again in a process that is killed at a random moment, until it is whole.

Usage: python killed.py STUDY.toml FOLDER KILLS SEED [processes]. Prints how many runs were killed
for each folder FOLDER/0, FOLDER/1, ... that came to its end, and at last how many processes that
they had started do not end. FOLDER/whole is the study run in one go.
"""

import os
import random
import signal
import sys
import time
from pathlib import Path

from curricle.study import WorkerProcesses, read_study, run_study

MARK = "CURRICLE_KILLED_RUN"
"""A variable in the environment of processes that a run starts: which run."""
GRACE = 60.0
"""Seconds in which the last of them have to end: less than one where nobody uses the machine."""


def run(study, folder, processes):
    pool = WorkerProcesses(2) if processes else None
    run_study(study, folder, resume=True, workers=2, executor=pool)
    if pool is not None:
        pool.shutdown()


def killed_run(study, folder, processes, mark, delay):
    """Whether a run in a process of its own was killed after so many seconds; else it is done."""
    child = os.fork()
    if child == 0:
        os.environ[MARK] = mark
        code = 1
        try:
            run(study, folder, processes)
            code = 0
        finally:
            os._exit(code)
    end = time.perf_counter() + delay
    while time.perf_counter() < end:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            break
        time.sleep(0.002)
    else:
        os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        return True
    assert os.WEXITSTATUS(status) == 0, "the run failed"
    return False


def alive(mark):
    """How many processes are alive that runs started whose names begin so."""
    found = 0
    for place in Path("/proc").glob("[0-9]*"):
        try:
            environment = (place / "environ").read_bytes().split(b"\0")
        except OSError:  # it has just ended
            continue
        found += any(of.startswith(f"{MARK}={mark}".encode()) for of in environment)
    return found


def main(file, folder, kills, seed, processes):
    study = read_study(file)
    run_study(study, folder / "whole", workers=2)  # compiles
    started = time.perf_counter()
    assert not killed_run(study, folder / "warm", processes, "warm", 600.0)
    lasted = time.perf_counter() - started
    draws, done, attempt = random.Random(seed), 0, 0
    while done < kills:
        here, whole = 0, False
        while not whole:
            assert here < 1000, "the study does not get on"
            mark = f"{os.getpid()}-{attempt}-{here}"
            delay = draws.uniform(0.0, 1.5 * lasted)  # so that a run gets to its end, too
            whole = not killed_run(study, folder / str(attempt), processes, mark, delay)
            here += not whole
        print(here, flush=True)
        done, attempt = done + here, attempt + 1
    end = time.perf_counter() + GRACE
    while (left := alive(f"{os.getpid()}-")) and time.perf_counter() < end:
        time.sleep(0.1)
    print(left, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), *map(int, sys.argv[3:5]), "processes" in sys.argv)
