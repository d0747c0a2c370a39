"""Workers die and join, requests to the store fail, the driver dies twice: the same bytes.

`CHAOS=20 make cluster ARGS=tests/cluster/test_chaos.py` plays 20 runs.
"""

import os
import random
import time
from collections import Counter
from threading import Event, Thread

import pytest

from curricle.study import StudyResults
from tests.cluster.conftest import LONG, begun, whole
from tests.cluster.test_s3_studies import ROWS, copied

RUNS = int(os.environ.get("CHAOS", "1"))
KILLED_DRIVERS = 2
LASTS = 12.0
"""Seconds in which workers die and join, about as long as a run alone takes."""


def happening(events, draws, stop):
    """A thread in which each event happens at a random moment, in their order."""
    moments = sorted(draws.uniform(0.0, LASTS) for _ in events)

    def play():
        start = time.monotonic()
        for moment, event in zip(moments, events, strict=True):
            if stop.wait(max(0.0, start + moment - time.monotonic())):
                return
            event()

    return Thread(target=play)


@pytest.mark.parametrize("seed", range(RUNS))
def test_nothing_is_lost_or_stored_twice(study, s3_proxy, request, seed, tmp_path):
    draws, file, url = random.Random(seed), study(2 * LONG), s3_proxy("--every", "50") + "/study"
    settings = ("--set", "seeds=12")
    if seed % 2:  # the workers write each unit themselves
        (file.parent / "maps.py").write_text(f"ROWS = {ROWS!r}\n")
        settings = ("--set", "seeds=30", "--set", "seeds_per_unit=5")
    wanted = whole(file, tmp_path / "threads", *settings)
    cluster = request.getfixturevalue("dask")  # after the proxy, which its processes go through
    doomed, on = draws.sample(cluster.workers, 2), cluster.on
    events = [doomed[0].kill, cluster.add_worker, doomed[1].kill]
    stop = Event()
    thread = happening(events, draws, stop)
    thread.start()
    try:
        for _ in range(KILLED_DRIVERS):
            driver = begun(file, url, "--on", on, "--resume", *settings)
            time.sleep(draws.uniform(2.0, LASTS / 2))
            driver.kill()
            driver.communicate()
        driver = begun(file, url, "--on", on, "--resume", *settings)
        printed, _ = driver.communicate(timeout=240)
    finally:
        stop.set()
        thread.join()
    assert driver.returncode == 0, printed
    assert copied(url, tmp_path / "copied") == wanted
    stored = Counter(
        (unit.key, seed) for unit in StudyResults(url).store.units() for seed in unit.seeds
    )
    assert set(stored.values()) == {1}
