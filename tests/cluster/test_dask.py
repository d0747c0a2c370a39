"""A study has the same results on threads, processes and Dask, whatever dies meanwhile."""

import os
import re
import signal

import psutil
import pytest

from tests.cluster.conftest import (
    LONG,
    arrays_and_tables,
    begun,
    finished,
    units_in,
    wait_until,
    whole,
)
from tests.support.studies import HUNT


@pytest.fixture
def hunt(tmp_path):
    (tmp_path / "hunt.toml").write_text(HUNT)
    return tmp_path / "hunt.toml"


def test_dask_changes_nothing(hunt, dask, tmp_path):
    wanted = whole(hunt, tmp_path / "threads")
    assert whole(hunt, tmp_path / "processes", "--processes", "--workers", "1") == wanted
    assert whole(hunt, tmp_path / "dask", "--on", dask.on) == wanted
    assert whole(hunt, tmp_path / "local", "--on", "dask", "--workers", "2") == wanted


def test_a_killed_worker_changes_nothing(study, dask, tmp_path):
    wanted, out = whole(study(LONG), tmp_path / "threads"), tmp_path / "dask"
    running = begun(study(LONG), out, "--on", dask.on)
    wait_until(lambda: len(units_in(out)) >= 2)
    assert running.poll() is None
    dask.kill_busy_worker()
    printed, _ = running.communicate(timeout=240)
    assert running.returncode == 0, printed
    assert arrays_and_tables(out) == wanted


def test_a_lost_scheduler_is_one_sentence_and_resume_goes_on(study, dask, tmp_path):
    wanted, out = whole(study(LONG), tmp_path / "threads"), tmp_path / "dask"
    running = begun(study(LONG), out, "--on", dask.on)
    wait_until(lambda: len(units_in(out)) >= 2)
    dask.scheduler.kill()
    printed, _ = running.communicate(timeout=120)
    assert running.returncode == 3, printed
    assert re.search("was lost( or cancelled it)?: go on with --resume", printed)
    assert "Traceback" not in printed
    assert len(units_in(out)) >= 2
    assert whole(study(LONG), out, "--resume") == wanted


def test_an_interrupt_leaves_the_cluster(study, dask, tmp_path):
    out = tmp_path / "dask"
    running = begun(study(LONG), out, "--on", dask.on)
    wait_until(lambda: units_in(out))
    running.send_signal(signal.SIGINT)
    printed, _ = running.communicate(timeout=60)
    assert running.returncode == 130, printed
    dask.ready()
    assert all(process.poll() is None for process in (dask.scheduler, *dask.workers))
    assert finished(study(LONG), out, "--resume", "--on", dask.on)[1] == 0


def test_an_interrupt_ends_the_processes_that_were_started(study, tmp_path):
    pytest.importorskip("distributed")
    wanted, out = whole(study(LONG), tmp_path / "threads"), tmp_path / "dask"
    local = ("--on", "dask", "--workers", "2")
    running = begun(study(LONG), out, *local, start_new_session=True)
    wait_until(lambda: len(units_in(out)) >= 2)
    started = psutil.Process(running.pid).children(recursive=True)
    assert len(started) >= 2
    os.killpg(running.pid, signal.SIGINT)  # a terminal interrupts the whole group
    printed, _ = running.communicate(timeout=60)
    assert running.returncode == 130, printed
    assert "Traceback" not in printed
    _, left = psutil.wait_procs(started, timeout=10)
    assert not left
    assert whole(study(LONG), out, "--resume") == wanted


def test_nobody_at_the_address_is_one_sentence(study, tmp_path):
    pytest.importorskip("distributed")
    printed, code = finished(study(), tmp_path / "out", "--on", "dask://127.0.0.1:9")
    assert code == 1
    assert "dask://127.0.0.1:9 cannot be reached" in printed
    assert "Traceback" not in printed
    assert not (tmp_path / "out").exists()
