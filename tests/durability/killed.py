"""Run a study again and again in a process that is killed at a random moment, until it is whole.

Usage: python killed.py STUDY.toml FOLDER KILLS. Prints how many runs were killed for each folder
FOLDER/0, FOLDER/1, ... that came to its end; FOLDER/whole is the study run in one go.
"""

import os
import random
import signal
import sys
import time
from pathlib import Path

from curricle.study import read_study, run_study


def killed_run(study, folder, delay):
    """Whether a run in a process of its own was killed after so many seconds; else it is done."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            run_study(study, folder, resume=True, workers=2)
            code = 0
        finally:
            os._exit(code)
    time.sleep(delay)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        return True
    assert os.WEXITSTATUS(status) == 0, "the run failed"
    return False


def main(file, folder, kills):
    study = read_study(file)
    run_study(study, folder / "warm", workers=2)  # compiles
    started = time.perf_counter()
    run_study(study, folder / "whole", workers=2)
    lasted = time.perf_counter() - started
    draws, done, attempt = random.Random(0), 0, 0
    while done < kills:
        here = 0
        while killed_run(study, folder / str(attempt), draws.uniform(0.0, lasted)):
            here += 1
            assert here < 1000, "the study does not get on"
        print(here, flush=True)
        done, attempt = done + here, attempt + 1


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
