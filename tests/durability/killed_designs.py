"""Design a recipe again and again in a process that is killed at random moments, until it is whole.

Usage: python killed_designs.py DESIGN.toml FOLDER KILLS SEED. Prints how many runs were killed for
each recipe FOLDER/0.toml, FOLDER/1.toml, ... that was written. FOLDER/whole.toml is the recipe of a
design in one go.
"""

import os
import random
import signal
import sys
import time
from pathlib import Path

from curricle.study.recipes.designing import run_design

BUDGET = 150_000


def design(file, out):
    run_design(file, "miniatures", out, budget=BUDGET, workers=2, resume=True)


def killed(file, out, delay):
    """Whether a design in another process was killed after so many seconds; else it is done."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            design(file, out)
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
    assert os.WEXITSTATUS(status) == 0, "the design failed"
    return False


def main(file, folder, kills, seed):
    design(file, folder / "whole.toml")  # compiles
    started = time.perf_counter()
    assert not killed(file, folder / "warm.toml", 600.0)
    lasted = time.perf_counter() - started
    draws, done, attempt = random.Random(seed), 0, 0
    while done < kills:
        here = 0
        while killed(file, folder / f"{attempt}.toml", draws.uniform(0.0, 1.3 * lasted)):
            here += 1
            assert here < 1000, "the design does not get on"
        print(here, flush=True)
        done, attempt = done + here, attempt + 1


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), *map(int, sys.argv[3:5]))
