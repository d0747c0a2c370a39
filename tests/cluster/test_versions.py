"""A worker with another version trains nothing; it is named in one sentence."""

import os

import pytest

from tests.cluster.conftest import LONG, begun, units_in, wait_until, whole

OLDER = """
from importlib import metadata
installed = metadata.version
metadata.version = lambda name: "0.1" if name == "numba" else installed(name)
"""
"""What Python runs first in a process that has it on its path."""
SENTENCE = "has numba 0.1 and the run has"


@pytest.fixture
def older(tmp_path):
    """The environment of a worker that seems to have another Numba."""
    folder = tmp_path / "older"
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(OLDER)
    return {"PYTHONPATH": os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])}


def test_another_version_that_joins_late_trains_nothing(study, dask, older, tmp_path):
    wanted, out = whole(study(3 * LONG), tmp_path / "threads"), tmp_path / "dask"
    running = begun(study(3 * LONG), out, "--on", dask.on)
    wait_until(lambda: len(units_in(out)) >= 2)
    others = list(dask.workers)
    late = dask.add_worker(**older)
    for worker in others:  # so that all that is left is sent to it
        worker.kill()
    printed, _ = running.communicate(timeout=240)
    assert running.returncode == 3, printed
    assert printed.count(SENTENCE) == 1
    assert "Traceback" not in printed
    late.kill()
    dask.add_worker()
    dask.ready(1)
    assert whole(study(3 * LONG), out, "--resume", "--on", dask.on) == wanted
