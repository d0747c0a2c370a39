"""Bad calls and odd arguments of the command end nothing, hang nowhere, and say a sentence."""

import contextlib
import io
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from curricle.cli.app import main
from tests.support.studies import LINES

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


ODD = [
    *("", " ", "-1", "0", "2", str(2**63), "1" + "0" * 5000, "nan", "1e400", "x" * 300, "²", "٣"),
    *("\u202ex", "a\0b", "pipe", "..", "1/2", "2/1", "0/0", f"{'9' * 30}/9", "é"),
    *("a=b", "=", "seeds=", "a.b.c=1", '"=1', "tasks=5", "arms=1", "transfers.0=1"),
    *("transfers.x.y=1", 'tasks."\u202e".x=1', f"budget={2**63}", f"{'a.' * 3000}b=1"),
]
COMMANDS = [
    *(["check", "?"], ["check", "s.toml", "--seeds", "?"], ["check", "s.toml", "--set", "?"]),
    *(["run", "?"], ["run", "s.toml", "--dry-run", "--out", "?"], ["show", "?"], ["report", "?"]),
    ["run", "s.toml", "--dry-run", "--shard", "?"],
    ["run", "s.toml", "--dry-run", "--workers", "?"],
    ["run", "s.toml", "--out", "made", "--track", "?"],
    ["show", "done", "--arm", "?"],
    ["show", "done", "--task", "?"],
    ["show", "done", "--decisions", "--seed", "?"],
    *(["report", "done", "--out", "?"], ["compare", "?", "done"], ["merge", "made", "?"]),
    *(["new", "?"], ["new", "maze", "?"], ["paper", "--figure", "?", "--out", "made"]),
    ["paper", "--figure", "1", "--out", "made", "--seeds", "?"],
]


def told(arguments):
    """Return the exit code of the command and what it writes to standard error."""
    before, sys.argv = sys.argv, ["curricle", *arguments]
    errors = io.StringIO()
    try:
        with (
            contextlib.redirect_stderr(errors),
            contextlib.redirect_stdout(io.StringIO()),
            pytest.raises(SystemExit) as ended,
        ):
            main()
    finally:
        sys.argv = before
    return ended.value.code or 0, errors.getvalue()


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_odd_arguments_are_refused_in_a_sentence(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("s.toml").write_text(LINES)
    os.mkfifo("pipe")  # no device: a mistake of the command's would cost the machine one
    assert told(["run", "s.toml", "--out", "done"])[0] == 0
    for odd in ODD:
        code, errors = told([odd if one == "?" else one for one in command])
        assert code in (0, 1, 2), (odd[:40], errors)
        assert "Traceback" not in errors
        assert bool(errors) >= (code > 0)
        shutil.rmtree("made", ignore_errors=True)
        assert Path("pipe").is_fifo()
