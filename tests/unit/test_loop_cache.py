"""Machine code on disk: kept while no compiled code changes, never a reason to fail."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import curricle
from curricle.tasks import loop_cache

PACKAGE = Path(curricle.__file__).parent
BACK_UP = """
import numpy as np
from curricle.planning.backups import OutcomeRows, back_up_rows
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


def test_an_index_that_cannot_be_read_is_written_anew(copied):
    copy, backed_up = copied
    backed_up()
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
    """A file of compiled code in another package would not make machine code stale."""
    marks = ("inlined", "compiled_once", "njit", "body(", "compiled_as")
    for file in PACKAGE.rglob("*.py"):
        text = file.read_text()
        lines = [line for line in text.splitlines() if line.startswith("@")]
        if any(mark in line for mark in marks for line in lines):
            assert file.relative_to(PACKAGE).parts[0] in loop_cache.PACKAGES, file
            assert any(mark.decode() in text for mark in loop_cache.MARKS), file
