"""The kernel: draws as in plain Python, and machine code kept while no compiled code changes."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numba import njit

import curricle
from curricle.errors import TaskError
from curricle.tasks import bernoulli, integers, kernel, splitmix64, uniform

BITS, NAN = st.integers(0, 2**64 - 1), float("nan")


@njit
def compiled(bits, n, probability):
    return splitmix64(bits), uniform(bits), integers(bits, n), bernoulli(bits, probability)


@given(BITS, st.integers(1, 2**32), st.floats(0, 1))
def test_plain_and_compiled_draws_are_the_same(bits, n, probability):
    plain = splitmix64(bits), uniform(bits), integers(bits, n), bernoulli(bits, probability)
    assert plain == compiled(np.uint64(bits), n, probability)
    assert 0 <= plain[1] < 1
    assert 0 <= plain[2] < n
    assert splitmix64(np.uint64(bits)) == splitmix64(bits)


BITLESS = [-1, 2**64, 10**100, 0.5, True, None, "x", [1], np.zeros(2)]


@pytest.mark.parametrize(
    ("draw", "wrong", "says"),
    [
        *[(draw, BITLESS, r"must be a whole number in 0\.\.2\^64 - 1") for draw in (
            uniform, splitmix64, lambda bits: integers(bits, 3))],
        (lambda n: integers(1, n), [0, -1, 2**32 + 1, 2**70, 0.5, NAN, None, "x"], "n must"),
        (lambda chance: bernoulli(1, chance), [-0.1, 1.1, NAN, None, "x"], "probability must"),
    ],
)  # fmt: skip
def test_what_is_no_argument_of_a_draw_is_refused(draw, wrong, says):
    for value in wrong:
        with pytest.raises(TaskError, match=says):
            draw(value)


def test_calls_from_python_do_not_end_the_interpreter():
    """They did by a segmentation fault, so this runs in a process of its own."""
    calls = "import curricle.tasks as t; t.uniform(7); t.integers(7, 3); t.splitmix64(7)"
    ended = subprocess.run([sys.executable, "-c", calls + "; t.bernoulli(7, 0.5)"], check=False)
    assert ended.returncode == 0


def test_no_public_name_is_a_compiled_function():
    """Those of the library have no entry from Python: calling one ends the process."""
    for face in curricle.tasks, curricle.planning, curricle.learning, curricle.transfer, curricle:
        for name in face.__all__:
            assert not hasattr(getattr(face, name), "py_func"), name


# -- machine code on disk --------------------------------------------------------------------------

PACKAGE = Path(curricle.__file__).parent
BACK_UP = """
import numpy as np
from curricle.planning.models import OutcomeRows, back_up_rows
one, rows = np.ones((1, 1)), np.zeros(1)
outcomes = OutcomeRows(one[0], one, np.zeros((1, 1), np.uint32), np.array([False]), 0.5)
back_up_rows(outcomes, np.array([8.0]), rows)
hits, misses = back_up_rows.stats.cache_hits, back_up_rows.stats.cache_misses
print(rows[0], "from disk" if hits else "compiled" if misses else "")
"""
COMPILED, FROM_DISK = "5.0 compiled\n", "5.0 from disk\n"


@pytest.fixture
def copied(tmp_path):
    """A copy of the library, and a function that backs up a value with it in a new process."""
    copy = tmp_path / "curricle"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))

    def backed_up(**environment):
        where = {**os.environ, "PYTHONPATH": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}
        where.pop("NUMBA_CACHE_DIR", None)
        run = subprocess.run(
            [sys.executable, "-c", BACK_UP],
            env={**where, **environment},
            capture_output=True,
            text=True,
            check=True,
        )
        return run.stdout

    return copy, backed_up


def test_a_change_in_another_file_makes_machine_code_stale(copied):
    copy, backed_up = copied
    assert backed_up() == COMPILED
    assert backed_up() == FROM_DISK
    factored = copy / "planning" / "policy_evaluation.py"  # compiled, and not called here
    factored.write_text(factored.read_text() + "\n# changed\n")
    assert backed_up() == COMPILED
    plain = copy / "planning" / "solution.py"  # not compiled
    plain.write_text(plain.read_text() + "\n# changed\n")
    assert backed_up() == FROM_DISK
    # An index that cannot be read is written anew.
    for index in (copy / "planning" / "__pycache__").glob("*.nbi"):
        whole = index.read_bytes()
        index.write_bytes(whole.replace(b"OutcomeRows", b"OutcomeRowz"))  # a type that is gone
        assert index.read_bytes() != whole or "rows" not in index.name
    assert backed_up() == COMPILED
    assert backed_up() == FROM_DISK


def test_without_a_folder_to_write_to_loops_are_compiled_in_each_process(copied):
    copy, backed_up = copied
    for place in copy.rglob("*"):
        if place.is_dir():
            (place / "__pycache__").write_text("a file in the place of the folder")
    nowhere = {"HOME": "/proc/none", "XDG_CACHE_HOME": "/proc/none"}
    assert backed_up(**nowhere) == COMPILED
    assert backed_up(**nowhere) == COMPILED


def test_every_file_with_compiled_code_counts():
    """A file of compiled code without a mark would not make machine code stale."""
    marks = ("inlined", "compiled_once", "njit", "body(", "compiled_as")
    for file in PACKAGE.rglob("*.py"):
        text = file.read_text()
        lines = [line for line in text.splitlines() if line.startswith("@")]
        if any(mark in line for mark in marks for line in lines):
            assert any(mark.decode() in text for mark in kernel.MARKS), file
