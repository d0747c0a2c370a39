"""Clusters and an S3 server, each process a command of its own, and runs of the command line."""

import os
import socket
import subprocess
import sys
import time
from contextlib import suppress

import pytest

from curricle.study.store import StoredUnit

LONG = 3_000_000
"""Steps of a unit that takes about a third of a second."""
DASK = [sys.executable, "-m", "dask"]
OWN_STUDY = """
name = "own"
opponents = []
seeds = 6
seeds_per_unit = 1
tasks.corner = { type = "factory", factory = "rules:corner", budget = 2_000 }
tasks.maze = { type = "factory", factory = "rules:maze", budget = BUDGET }
transfers = [{ source = "corner", target = "maze", factory = "rules:same" }]
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


def free_port():
    """A port of loopback that nobody listens on now."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


class Cluster:
    """Commands of Dask on loopback, ended one by one."""

    def __init__(self, folder):
        self.folder = folder
        self.port = free_port()
        self.on = f"dask://127.0.0.1:{self.port}"
        self.scheduler = self._start("scheduler", "--host", "127.0.0.1", "--port", str(self.port))
        self.workers = list[subprocess.Popen]()
        for _ in range(3):
            self.add_worker()

    def _start(self, *command, **environment):
        with (self.folder / "log.txt").open("a") as log:
            return subprocess.Popen(
                [*DASK, *command],
                cwd=self.folder,
                env={**os.environ, **environment},
                stdout=log,
                stderr=log,
            )

    def add_worker(self, **environment):
        where = f"tcp://127.0.0.1:{self.port}"
        single = ("--nthreads", "1", "--no-nanny", "--no-dashboard")
        process = self._start("worker", where, *single, **environment)
        self.workers.append(process)
        return process

    def ready(self, workers=3):
        from distributed import Client

        with Client(f"tcp://127.0.0.1:{self.port}", timeout=60) as client:
            client.wait_for_workers(workers, timeout=60)

    def kill_busy_worker(self):
        """Kill a worker while all have a call: one that has just ended waits for its next."""
        from distributed import Client

        with Client(f"tcp://127.0.0.1:{self.port}", timeout=60) as client:
            wait_until(lambda: all(client.processing().values()))
            self.workers[0].kill()

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
def s3(tmp_path, monkeypatch):
    """The URL of an empty bucket of moto's server; where that is stands in the environment.

    Ask for it before a cluster, whose processes take the environment that they find.
    """
    pytest.importorskip("moto")
    from s3fs import S3FileSystem
    from upath import UPath

    port = free_port()
    for name, value in (
        ("AWS_ENDPOINT_URL", f"http://127.0.0.1:{port}"),
        *(("AWS_ACCESS_KEY_ID", "nobody"), ("AWS_SECRET_ACCESS_KEY", "nothing")),
        ("AWS_DEFAULT_REGION", "us-east-1"),
    ):
        monkeypatch.setenv(name, value)
    S3FileSystem.clear_instance_cache()  # those of this process may go to another server
    code = "from moto.server import main; main()"
    command = [sys.executable, "-c", code, "-H", "127.0.0.1", "-p", str(port)]
    with (tmp_path / "s3.txt").open("w") as log:
        server = subprocess.Popen(command, stdout=log, stderr=log)

    def listens():
        assert server.poll() is None, (tmp_path / "s3.txt").read_text()
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
            return True

    wait_until(listens)
    place = UPath("s3://bucket/", use_listings_cache=False)
    place.fs.mkdir(place.path)
    yield "s3://bucket"
    server.kill()
    server.wait()


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


def begun(study, out, *options, **how):
    """A run of the command line, in the study's folder."""
    command = [sys.executable, "-m", "curricle", "run", str(study), "--out", str(out), *options]
    return subprocess.Popen(
        command, cwd=study.parent, stdout=-1, stderr=subprocess.STDOUT, text=True, **how
    )


def finished(study, out, *options):
    """What a run printed, and its exit code."""
    running = begun(study, out, *options)
    printed, _ = running.communicate(timeout=240)
    return printed, running.returncode


def whole(study, out, *options):
    """The arrays and tables of a run that ended well."""
    printed, code = finished(study, out, *options)
    assert code == 0, printed
    found = arrays_and_tables(out)
    assert any(path.suffix == ".npz" for path in found)
    return found


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
    """The seeds of all tasks that are stored, each a unit."""
    files = folder.glob("units/*/*.npz")
    return [seed for file in files for seed in StoredUnit.at(file).seeds]
