"""Worker processes: none outlives the process that started it, and none says a word about it."""

import os
import signal
import subprocess
import sys

import pytest

from curricle.study import workers

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals are POSIX's")

PARENT = """
import os
import signal
import sys
import time

from curricle.study.workers import WorkerProcesses


def work():
    os.write(1, b"w")
    time.sleep(600)


if __name__ == "__main__":
    # What runs in the background is started with some of these ignored.
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    pool = WorkerProcesses(2)
    pool.submit(work)
    pool.submit(work)
    try:
        time.sleep(600)
    except KeyboardInterrupt:
        os._exit(130)
"""
ENDS = {
    "SIGTERM": lambda parent: parent.send_signal(signal.SIGTERM),
    "SIGHUP": lambda parent: parent.send_signal(signal.SIGHUP),
    "SIGQUIT": lambda parent: parent.send_signal(signal.SIGQUIT),
    "SIGKILL": lambda parent: parent.send_signal(signal.SIGKILL),
    "Ctrl-C": lambda parent: os.killpg(parent.pid, signal.SIGINT),  # as a terminal sends it
}


def test_workers_end_with_their_parent_in_silence(tmp_path):
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    command = [sys.executable, script]
    parents = {
        how: subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True
        )
        for how in ENDS
    }
    for how, parent in parents.items():
        assert parent.stdout.read(2) == b"ww", how  # both are at work
        ENDS[how](parent)
    # The pipe ends when the last process that writes to it does; test_kills.py says how soon.
    outputs = {how: parent.communicate(timeout=60)[0] for how, parent in parents.items()}
    assert outputs == dict.fromkeys(ENDS, b"")


WHOLE = """
from curricle.study.workers import WorkerProcesses

if __name__ == "__main__":
    with WorkerProcesses(1) as pool:
        print(pool.submit(pow, 2, 10).result())
"""


def test_a_run_that_ends_leaves_no_process_and_no_pipe_open(tmp_path):
    script = tmp_path / "whole.py"
    script.write_text(WHOLE)
    command = [sys.executable, "-W", "always::ResourceWarning", script]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert (ended.stdout, ended.stderr) == ("1024\n", "")


@pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="the reaper needs Linux")
def test_a_run_goes_on_without_its_reaper():
    with workers._reaper(os.getpid()) as reaper:
        reaper.kill()
        reaper.wait()
        with workers.WorkerProcesses(1) as pool:
            assert pool.submit(pow, 2, 10).result() == 1024
    workers._reaper.cache_clear()
