"""A Dask scheduler and three workers, each a command of its own, in a folder of their own."""

import os
import socket
import subprocess
import sys
import time

import pytest

DASK = [sys.executable, "-m", "dask"]
OWN_STUDY = """
name = "own"
seeds = 6
seeds_per_unit = 1
[tasks.corner]
type = "factory"
factory = "rules:corner"
budget = 2_000
[tasks.maze]
type = "factory"
factory = "rules:maze"
budget = BUDGET
[[transfers]]
source = "corner"
target = "maze"
factory = "rules:same"
"""
RULES = """
from .maps import ROWS
import curricle as cr

def maze():
    return cr.GridWorld(ROWS, time_limit=30)

def corner():
    return maze().crop(rows=(0, 2), columns=(2, 5))

def same(target, source):
    return cr.same_position(target, source)
"""


class Cluster:
    """Commands of Dask on loopback, ended one by one."""

    def __init__(self, folder):
        self.folder = folder
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.on = f"dask://127.0.0.1:{self.port}"
        self.scheduler = self._start("scheduler", "--host", "127.0.0.1", "--port", str(self.port))
        self.workers = [self.add_worker() for _ in range(3)]

    def _start(self, *command):
        with (self.folder / "log.txt").open("a") as log:
            return subprocess.Popen([*DASK, *command], cwd=self.folder, stdout=log, stderr=log)

    def add_worker(self, *options):
        where = f"tcp://127.0.0.1:{self.port}"
        single = ("--nthreads", "1", "--no-nanny", "--no-dashboard")
        return self._start("worker", where, *single, *options)

    def ready(self, workers=3):
        from distributed import Client

        with Client(f"tcp://127.0.0.1:{self.port}", timeout=60) as client:
            client.wait_for_workers(workers, timeout=60)

    def close(self):
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


@pytest.fixture
def dask(tmp_path_factory):
    pytest.importorskip("distributed")
    cluster = Cluster(tmp_path_factory.mktemp("elsewhere"))
    try:
        cluster.ready()
        yield cluster
    finally:
        cluster.close()


@pytest.fixture
def study(tmp_path):
    """Return a function: budget -> a study whose modules are beside it."""

    def write(budget=3_000):
        folder = tmp_path / "study"
        folder.mkdir(exist_ok=True)
        (folder / "study.toml").write_text(OWN_STUDY.replace("BUDGET", str(budget)))
        (folder / "rules.py").write_text(RULES)
        (folder / "maps.py").write_text('ROWS = ["....T", ".PPP.", "S...."]\n')
        return folder / "study.toml"

    return write


def begun(study, out, *options):
    """A run of the command line, in the study's folder."""
    command = [sys.executable, "-m", "curricle", "run", str(study), "--out", str(out), *options]
    quiet = {**os.environ, "RAY_USAGE_STATS_ENABLED": "0"}
    return subprocess.Popen(
        command, cwd=study.parent, env=quiet, stdout=-1, stderr=subprocess.STDOUT, text=True
    )


def finished(study, out, *options):
    """What a run printed, and its exit code."""
    running = begun(study, out, *options)
    printed, _ = running.communicate(timeout=240)
    return printed, running.returncode


def arrays_and_tables(folder):
    """The bytes of every array and table of a folder, by path."""
    files = [path for end in ("npz", "parquet") for path in folder.rglob(f"*.{end}")]
    return {path.relative_to(folder): path.read_bytes() for path in files}


def wait_until(true, seconds=120.0):
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        time.sleep(0.02)


def units_in(folder):
    return list(folder.glob("units/*/*.npz"))
