"""Six hundred bad calls end no interpreter, hang nowhere, and raise what may be raised."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

SEED, CALLS, BATCH = 1, 600, 50
LONGEST = 10.0
"""Seconds of processor time of a call that is no hang; compiling loops takes up to five."""
STUCK = 600
"""Seconds after which a batch is ended: calls in it wait for something, or work for ever."""


def batch(first, calls=BATCH):
    """Return what became of some calls, a dict each, and how their process ended."""
    script = Path(__file__).with_name("bad_calls.py")
    command = [sys.executable, script, SEED, first, calls]
    ended = subprocess.run(
        [str(word) for word in command],
        capture_output=True,
        text=True,
        timeout=STUCK,
        check=False,
        env={**os.environ, "MPLBACKEND": "Agg"},
    )
    found = {}
    for line in ended.stdout.splitlines():
        if line.startswith("{"):
            one = json.loads(line)
            found.setdefault(one["call"], {}).update(one)
    return list(found.values()), ended


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, CALLS, BATCH))
def test_bad_calls_are_refused_and_end_nothing(first):
    calls, ended = batch(first)
    assert ended.returncode == 0, (
        f"{calls[-1]}: ended by {ended.returncode}: {ended.stderr[-2000:]}"
    )
    assert len(calls) == BATCH
    assert [one for one in calls if not one["allowed"]] == []
    assert [one for one in calls if one["seconds"] > LONGEST] == []


@pytest.mark.slow
def test_a_few_bad_calls_are_drawn_alike_in_every_process():
    one, other = (batch(10**6, 2)[0] for _ in range(2))
    names = [[(call["name"], call["error"]) for call in calls] for calls in (one, other)]
    assert names[0] == names[1]
    assert len(names[0]) == 2
